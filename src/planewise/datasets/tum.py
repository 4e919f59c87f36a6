"""TUM RGB-D: Kinect sequences with the times of their depth images and pictures in two lists.

Sturm, Engelhard, Endres, Burgard, Cremers, "A benchmark for the evaluation of RGB-D SLAM systems",
IROS 2012.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planewise import sensors
from planewise.camera import PinholeCamera
from planewise.cameras import KINECT_V1
from planewise.datasets.association import (
    APART,
    ASSOCIATIONS,
    associations,
    nearest,
    numbered_words,
    states_times,
    timed_list,
)
from planewise.datasets.picture_folder import FrameFiles, PictureFolder
from planewise.wording import counted

_LOG = logging.getLogger("planewise")

DEPTH_SCALE = 1 / 5000
"""Metres per unit."""

TRAJECTORY = "groundtruth.txt"


class TumSequence(PictureFolder):
    """Folder with ``depth.txt``, ``rgb.txt`` and the files that they list.

    Frames are the lines of ``depth.txt``, with the picture (and the pose of ``groundtruth.txt``)
    nearest in time, where one is within `apart`. Without these lists, frames and pictures are those
    of ``associations.txt``. Ids are the names of the depth images.

    Parameters
    ----------
    folder : path
        The sequence.
    camera : PinholeCamera, optional
        ``None`` means `planewise.cameras.KINECT_V1`, for which the driver registered the depth
        images, and which the dataset's authors recommend over their calibrations of the lenses.
    apart : float
        Seconds.
    """

    kind: ClassVar[str] = "tum"
    holds: ClassVar[str] = (
        "a folder with depth.txt and rgb.txt, or associations.txt of times (TUM RGB-D)"
    )
    sensor = sensors.KINECT_V1

    def __init__(
        self, folder: str | Path, *, camera: PinholeCamera | None = None, apart: float = APART
    ) -> None:
        root = Path(folder)
        self._times, self._poses = _trajectory(root)
        self._apart = apart
        super().__init__(root, _frames(root, apart), camera or KINECT_V1, DEPTH_SCALE)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has both lists, or that of pairs by their times."""
        return _has_lists(path) or states_times(path, named=True)

    def _pose(self, files: FrameFiles) -> NDArray[np.float64] | None:
        assert files.timestamp is not None
        at = nearest(self._times, files.timestamp, self._apart)
        return None if at is None else rigid(self._poses[at])


def _has_lists(root: Path) -> bool:
    return all((root / name).is_file() for name in ("depth.txt", "rgb.txt"))


def _frames(root: Path, apart: float) -> Iterator[FrameFiles]:
    if not _has_lists(root) and (root / ASSOCIATIONS).is_file():
        yield from associations(root)
        return
    pictures = timed_list(root, "rgb.txt")
    times = [time for time, _ in pictures]
    for time, words in timed_list(root, "depth.txt"):
        at = nearest(times, time, apart)
        yield FrameFiles(
            id=Path(words[0]).stem,
            depth=words[0],
            rgb=None if at is None else pictures[at][1][0],
            timestamp=time,
        )


def _trajectory(root: Path) -> tuple[list[float], list[NDArray[np.float64]]]:
    """Times and rows tx, ty, tz, qx, qy, qz, qw of the true trajectory, where it is there."""
    if not (root / TRAJECTORY).is_file():
        return [], []
    lines = [words for _, words in numbered_words(root, TRAJECTORY)]
    rows = sorted(filter(None, map(_timed_pose, lines)), key=lambda row: row[0])
    if len(rows) < len(lines):
        _LOG.warning(
            f"{root.name}: {counted(len(lines) - len(rows), 'line')} of {TRAJECTORY} cannot be "
            "read as a time and seven numbers, and left out"
        )
    return [time for time, _ in rows], [row for _, row in rows]


def _timed_pose(words: list[str]) -> tuple[float, NDArray[np.float64]] | None:
    try:
        time, *row = map(float, words)
    except ValueError:
        return None
    return (time, np.array(row)) if len(row) == 7 and math.isfinite(time) else None


def rigid(row: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Pose of a place and a quaternion (x, y, z, w); ``None`` if that is zero, or one is NaN."""
    length = np.linalg.norm(row[3:])
    if not (0 < length < np.inf and np.isfinite(row).all()):
        return None
    x, y, z, w = row[3:] / length
    pose = np.eye(4)
    pose[:3, 3] = row[:3]
    pose[:3, :3] = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return pose
