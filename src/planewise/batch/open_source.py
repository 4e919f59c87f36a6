"""From what a user names to a source: a folder of depth images, or any dataset."""

from __future__ import annotations

from pathlib import Path

from planewise.batch.source import DepthFolder, Source
from planewise.camera import Camera
from planewise.datasets.archives import ArchiveFolder
from planewise.datasets.frames import PointDataset, check_text
from planewise.datasets.opening import holds_depth_images, open_offered, reader_of
from planewise.datasets.ros import TOPICS
from planewise.errors import PlanewiseError
from planewise.files.depth import is_depth_file
from planewise.sensor import Sensor
from planewise.wording import counted


def open_source(
    path: str | Path,
    kind: str | None = None,
    *,
    camera: Camera | None = None,
    depth_scale: float | None = None,
    topic: str | None = None,
    camera_topic: str | None = None,
    pictures: bool = False,
    poses: bool = False,
) -> Source:
    """Open frames of any kind.

    Parameters
    ----------
    path : path
        A folder of depth images, or what `planewise.datasets.open` opens.
    kind : str, optional
        Of dataset; ``None`` means whichever the contents look like.
    camera : Camera, optional
        For kinds of dataset that do not state one.
    depth_scale : float, optional
        Metres per unit, likewise.
    topic, camera_topic : str, optional
        Of a bag: those of its depth images and of their CameraInfo.
    pictures, poses : bool
        Read the pictures and poses of a dataset, too.

    Raises
    ------
    PlanewiseError
        If it is of no known kind, cannot be used, holds points, or frames whose names are no text.
    ValueError
        If a topic is given for what is no bag.
    """
    path = Path(path)
    reader = reader_of(path) if kind is None and path.exists() else None
    recipe = {"camera": camera, "depth_scale": depth_scale}  # is used whatever the kind states
    given = recipe | dict(zip(TOPICS, (topic, camera_topic), strict=True))
    if kind is None and reader is None and holds_depth_images(path):
        for name in TOPICS:
            if given[name] is not None:
                raise ValueError(f"{name} is no option of a folder of depth images")
        return _storable(DepthFolder(path))
    if reader is ArchiveFolder:
        _check_alone(path)
    opened = open_offered(path, kind, given, list(recipe))
    if isinstance(opened, PointDataset):
        raise PlanewiseError(f"data: {opened.name} holds points; depth images are needed")
    opened = opened if poses else opened.without_poses()
    return _storable(opened if pictures else opened.without_pictures())


def _storable(source: Source) -> Source:
    """Refuse ids that no table can hold: names of files with bytes that are no text."""
    for each in source.ids:
        check_text(source.name, each)
    return source


def _check_alone(archives: Path) -> None:
    """Refuse a folder of archives among other depth images, which would be left out."""
    others = [each.name for each in archives.iterdir() if is_depth_file(each)]
    others = [name for name in others if not name.endswith(".npz")]
    if others:
        raise PlanewiseError(
            f"data: {archives} holds archives (.npz) and "
            f"{counted(len(others), 'other depth image')} such as {min(others)}; give each a "
            "folder of their own, or --kind archives to take the archives alone"
        )


def sensor_of_source(source: Source) -> Sensor | None:
    """Sensor that took the frames, where the dataset tells."""
    sensor = getattr(source, "sensor", None)
    return sensor if isinstance(sensor, Sensor) else None
