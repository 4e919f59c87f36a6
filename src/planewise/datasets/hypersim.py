"""Hypersim: rendered rooms, whose depth is the distance from the camera.

Roberts, Ramapuram, Ranjan, Kumar, Bautista, Paczan, Webb, Susskind, "Hypersim: a photorealistic
synthetic dataset for holistic indoor scene understanding", ICCV 2021. Its usual camera sees 60
degrees; scenes with another one, which their ``metadata_camera_parameters.csv`` states, need it to
be given. Poses, which are in units of each scene, are not read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from planewise.camera import PinholeCamera
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.hdf5 import array_of, opened, rows_of
from planewise.datasets.paths import inside, listed
from planewise.errors import PlanewiseError, needs
from planewise.files.colour import read_colour
from planewise.files.depth import natural_order

CAMERA = PinholeCamera(
    fx=886.81, fy=886.81, cx=511.5, cy=383.5, width=1024, height=768, radial=True
)
"""The usual camera of 60 degrees, as the dataset's authors state it."""

_GEOMETRY = re.compile(r"scene_(cam_\d+)_geometry_hdf5")
_DISTANCES = re.compile(r"frame\.(\d+)\.depth_meters\.hdf5")


@dataclass(frozen=True, kw_only=True, slots=True)
class _Files:
    """Files of one frame, as paths below the scene's folder."""

    distances: str
    picture: str


class Hypersim(Dataset):
    """Scene with ``images/scene_cam_00_geometry_hdf5/frame.0000.depth_meters.hdf5`` and so on.

    Distances are read as they are, by a camera that is radial; pictures are those of
    ``scene_cam_00_final_preview``. Ids are ``cam_00.0000`` and so on. Needs h5py, extra
    ``datasets``.

    Parameters
    ----------
    folder : path
        Such as ``ai_001_001``.
    camera : PinholeCamera, optional
        ``None`` means `CAMERA`; what it says of `radial` does not matter.
    """

    kind: ClassVar[str] = "hypersim"
    holds: ClassVar[str] = "a folder with images/scene_cam_00_geometry_hdf5/ (Hypersim)"

    def __init__(self, folder: str | Path, *, camera: PinholeCamera | None = None) -> None:
        with needs("h5py", "reading Hypersim", "datasets"):
            import h5py  # type: ignore[import-untyped, import-not-found, unused-ignore]  # noqa: F401
        self.folder, self.camera = Path(folder), replace(camera or CAMERA, radial=True)
        self._files = dict(_frames(self.folder))
        if not self._files:
            raise PlanewiseError(f"{self.folder} holds no frame.0000.depth_meters.hdf5")
        super().__init__(self.folder.name or str(self.folder), list(self._files))

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has one of geometry below its images."""
        return any(_cameras(path))

    def _read(self, frame: str) -> DatasetFrame:
        files = self._files[frame]
        with opened(inside(self.folder, files.distances)) as file:
            array = array_of(file, "dataset", 2, "f")
            distance = rows_of(array, slice(0, array.shape[0]))
        picture = inside(self.folder, files.picture)
        return DatasetFrame(
            id=frame,
            depth=np.where(np.isfinite(distance), distance, 0).astype(np.float32),
            camera=self.camera,
            rgb=read_colour(picture) if self.pictures and picture.is_file() else None,
        )


def _cameras(folder: Path) -> Iterator[str]:
    """Names of cameras, such as cam_00, of which the scene has geometry."""
    images = folder / "images"
    for path in sorted(images.iterdir(), key=natural_order) if images.is_dir() else ():
        if (name := _GEOMETRY.fullmatch(path.name)) and path.is_dir():
            yield name[1]


def _frames(folder: Path) -> Iterator[tuple[str, _Files]]:
    """Ids of the frames of a scene, and their files."""
    for camera in _cameras(folder):
        place = f"images/scene_{camera}_geometry_hdf5"
        for path in listed(inside(folder, place), _has_distances):
            number = _DISTANCES.sub(r"\1", path.name)
            picture = f"images/scene_{camera}_final_preview/frame.{number}.tonemap.jpg"
            files = _Files(distances=f"{place}/{path.name}", picture=picture)
            yield f"{camera}.{number}", files


def _has_distances(path: Path) -> bool:
    return _DISTANCES.fullmatch(path.name) is not None and path.is_file()
