"""Scenes as PlaneRCNN's training reads them (its ``datasets/scannet_scene.py``, ScanNet v2).

    scenes.txt                                  names of the scenes, one a line
    frames.csv                                  scene and index of every frame that is written
    scans/SCENE/SCENE.txt                       sizes, intrinsics, number of frames
    scans/SCENE/frames/color/INDEX.jpg          picture
    scans/SCENE/frames/depth/INDEX.png          16 bit, millimetres
    scans/SCENE/frames/pose/INDEX.txt           4 x 4, camera to world
    scans/SCENE/annotation/planes.npy           (N, 3) float64, world
    scans/SCENE/annotation/plane_info.npy       N lists
    scans/SCENE/annotation/segmentation/INDEX.png   8-bit colour

A row of ``planes.npy`` is the point of a plane that is nearest to the origin of the world,
-distance x normal. A pixel of plane i of its scene has the colour 100 (i + 1), red the highest
byte; black is no plane. Planes are of one frame each: a wall that two frames see is two planes.
The frames of a scene have the indices 0, 1, ... without a gap: the reader counts to their number.
"""

from __future__ import annotations

import csv
import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planewise.batch.frame_names import safe_name
from planewise.batch.source import SourceFrame
from planewise.batch.store import Store, StoredFrame
from planewise.batch.stored_source import metres
from planewise.datasets.collection import BETWEEN
from planewise.errors import PlanewiseError, needs
from planewise.exports.form import Form
from planewise.results.image import write_image
from planewise.wording import counted

Array = NDArray[np.float64]

_LOG = logging.getLogger("planewise")

_FRAMES_A_SCENE = 2000  # the training counts frames of a scene up to 9,999, planes up to 167,770
_MOST_PLANES = 167_770
_FARTHEST = 65_535  # millimetres that 16 bits hold; what is beyond is no reading
_STEP = 100  # of colours, from plane to plane
_UNANNOTATED = 41  # class of planes of no known object
_JPEG_QUALITY = 95
_CAMERA = {  # columns of frames by what a scene calls them
    "depthWidth": "width", "depthHeight": "height", "fx_depth": "fx", "fy_depth": "fy",
    "mx_depth": "cx", "my_depth": "cy",
}  # fmt: skip
_FILES = (
    "frames/color/{}.jpg",
    "frames/depth/{}.png",
    "frames/pose/{}.txt",
    "annotation/segmentation/{}.png",
)


@dataclass
class _Scene:
    """A scene that is being written."""

    name: str
    expected: int
    camera: dict[str, float] | None = None
    handled: int = 0
    written: list[int] = field(default_factory=list)
    planes: list[Array] = field(default_factory=list)
    count: int = 0
    lost: int = 0  # frames without a pose


class PlaneRcnnExport(Form):
    """See the module, and `Form`."""

    needs_source = True

    def __init__(
        self, folder: Path, store: Store, ids: Sequence[str], *, pictures: bool = False
    ) -> None:
        super().__init__(folder, store, ids, pictures=pictures)
        self._places: dict[str, tuple[str, int]] = {}
        sizes: dict[str, int] = {}
        for each in ids:
            whole = _scene_of(each, store.info["source"]["name"])
            seen = sizes.get(whole, 0)
            sizes[whole] = seen + 1
            part, index = divmod(seen, _FRAMES_A_SCENE)
            name = f"{whole}%part{part}" if part else whole  # no other scene is named so
            self._places[each] = (name, index)
        expected = Counter(name for name, _ in self._places.values())
        self._scenes = {name: _Scene(name, count) for name, count in expected.items()}
        self._names: list[str] = []
        self._bent = 0  # frames through a lens with distortion
        self._unposed = 0  # scenes of which no pose is known

    def add(self, frame: StoredFrame, seen: SourceFrame | None) -> None:
        """See `Form`."""
        assert seen is not None
        name, index = self._places[frame.id]
        scene, labels, planes = self._scenes[name], frame.labels, frame.planes
        self._check(scene, frame, seen)
        depth = np.nan_to_num(np.round(1000 * metres(frame, seen)))
        depth[depth > _FARTHEST] = 0
        scene.camera = scene.camera or _camera(frame, seen)
        known = _pose(seen)
        pose = np.eye(4) if known is None else known  # then the world is the camera's own
        colour_file, depth_file, pose_file, labels_file = (
            self._file(name, each, index) for each in _FILES
        )
        _write_jpeg(colour_file, seen.rgb)
        write_image(depth_file, depth.astype(np.uint16))
        np.savetxt(pose_file, pose, fmt="%.9g")
        write_image(labels_file, _colours(labels, scene.count))
        scene.planes.append(nearest_points(planes, pose))
        scene.count += len(planes)
        scene.written.append(index)
        scene.lost += known is None
        self._bent += any(frame.row["distortion"] or ())
        self._handled(scene)

    def left_out(self, frame: StoredFrame) -> None:
        """See `Form`."""
        self._handled(self._scenes[self._places[frame.id][0]])

    def finish(self) -> None:
        """See `Form`."""
        text = "".join(f"{name}\n" for name in sorted(self._names))
        self.path("scenes.txt").write_text(text, encoding="ascii")
        now = {each.name: _numbers(each) for each in self._scenes.values()}
        rows = csv.writer(self.text("frames.csv"))
        rows.writerow(("scene", "index", "frame"))
        for frame, (name, index) in self._places.items():
            if index in now[name]:
                rows.writerow((name, now[name][index], frame))
        if self._unposed:
            _LOG.warning(
                f"no pose is known of {counted(self._unposed, 'scene')}: all are the identity, and "
                "losses that compare neighbouring frames mean nothing"
            )
        if self._bent:
            _LOG.warning(
                f"the lens of {counted(self._bent, 'frame')} has a distortion, which the format "
                "does not state and its reader takes for none: pixels are where the lens put them"
            )

    @staticmethod
    def _check(scene: _Scene, frame: StoredFrame, seen: SourceFrame) -> None:
        if seen.rgb is None:
            raise PlanewiseError(f"frame {frame.id}: the source has no picture of it")
        if frame.row["fx"] is None:
            raise PlanewiseError(f"frame {frame.id}: its readings are no depth of a pinhole camera")
        if scene.camera not in (None, _camera(frame, seen)):
            raise PlanewiseError(
                f"frame {frame.id}: it has another camera than its scene, or a picture of "
                "another size"
            )
        if scene.count + len(frame.planes) > _MOST_PLANES:
            raise PlanewiseError(f"frame {frame.id}: its scene has too many planes")

    def _handled(self, scene: _Scene) -> None:
        """Write what is of the whole scene once its last frame is there, and forget it."""
        scene.handled += 1
        if scene.handled < scene.expected or scene.camera is None:
            return
        for before, index in _numbers(scene).items():  # upwards, so that none is written over
            for each in _FILES if before != index else ():
                self._file(scene.name, each, before).rename(self._file(scene.name, each, index))
        at = f"scans/{scene.name}"
        planes = np.concatenate(scene.planes)
        np.save(self.path(f"{at}/annotation/planes.npy"), planes)
        info = np.empty(len(planes), object)  # of lists, whose lengths may differ
        info[:] = [[(number, _UNANNOTATED, _UNANNOTATED)] for number in range(len(planes))]
        np.save(self.path(f"{at}/annotation/plane_info.npy"), info, allow_pickle=True)
        count = len(scene.written)
        lines = scene.camera | {"numColorFrames": count, "numDepthFrames": count}
        text = "".join(f"{key} = {value}\n" for key, value in lines.items())
        self.path(f"{at}/{scene.name}.txt").write_text(text, encoding="ascii")
        self._names.append(scene.name)
        self._unposed += scene.lost == count
        if 0 < scene.lost < count:
            _LOG.warning(
                f"scene {scene.name}: the poses of {scene.lost:,} of {counted(count, 'frame')} are "
                "not known and are the identity, as if they were taken at the world's origin"
            )
        scene.planes = []

    def _file(self, scene: str, name: str, index: int) -> Path:
        return self.path(f"scans/{scene}/{name.format(index)}")


def _numbers(scene: _Scene) -> dict[int, int]:
    """Indices of the written frames by those they were written with, which leave gaps."""
    return {before: index for index, before in enumerate(sorted(scene.written))}


def nearest_points(planes: Array, pose: Array) -> Array:
    """Points of planes that are nearest to the origin of the world, shape (N, 3).

    Parameters
    ----------
    planes : ndarray, shape (N, 4)
        Rows (normal, distance) in the camera's frame.
    pose : ndarray, shape (4, 4)
        Camera to world.
    """
    normal = planes[:, :3] @ pose[:3, :3].T
    distance = planes[:, 3] - normal @ pose[:3, 3]
    return np.asarray(-distance[:, None] * normal)


def _scene_of(frame: str, dataset: str) -> str:
    """Name of the scene: the part of a collection that a frame is of, or the whole."""
    part, between, _ = frame.rpartition(BETWEEN)
    if not between:
        part, between, _ = frame.rpartition("/")
    name = safe_name(part if between else dataset, "").replace("/", "%2F")
    # The reader replaces these wherever they are in the path of a picture.
    return name.replace("color", "%63olor").replace(".jpg", "%2Ejpg")


def _camera(frame: StoredFrame, seen: SourceFrame) -> dict[str, float]:
    """Sizes and intrinsics, which all frames of a scene have in common."""
    assert seen.rgb is not None
    height, width, _ = seen.rgb.shape
    of_depth = {name: frame.row[column] for name, column in _CAMERA.items()}
    return {"colorWidth": width, "colorHeight": height} | of_depth


def _pose(seen: SourceFrame) -> Array | None:
    """Pose of a frame, where it is known."""
    pose = getattr(seen, "pose", None)
    return None if pose is None or not np.isfinite(pose).all() else np.asarray(pose)


def _colours(labels: NDArray[np.uint16], before: int) -> NDArray[np.uint8]:
    numbers = np.where(labels > 0, (labels.astype(np.int64) + before) * _STEP, 0)
    return np.stack([numbers >> 16, numbers >> 8 & 255, numbers & 255], axis=-1).astype(np.uint8)


def _write_jpeg(path: Path, rgb: NDArray[np.uint8] | None) -> None:
    with needs("pillow", "writing pictures"):
        from PIL import Image
    assert rgb is not None
    Image.fromarray(rgb).save(path, quality=_JPEG_QUALITY, subsampling=0)
