"""NYU-v2's raw recordings: folders of ``d-TIME-TICKS.pgm`` and ``r-TIME-TICKS.ppm``.

Silberman, Hoiem, Kohli, Fergus, "Indoor segmentation and support inference from RGBD images",
ECCV 2012. The numbers below are those of its toolbox (camera_params.m).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from planewise import sensors
from planewise.camera import PinholeCamera
from planewise.datasets.association import nearest
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.paths import inside, listed
from planewise.errors import PlanewiseError
from planewise.files.colour import read_colour
from planewise.files.depth import read_depth

DEPTH_CAMERA = PinholeCamera(
    fx=582.62448167737955,
    fy=582.69103270988637,
    cx=313.04475870804731,
    cy=238.44389626620386,
    width=640,
    height=480,
    distortion=(
        -0.099897236553084481,
        0.39065324602765344,
        0.0019290592870229277,
        -0.0019422022475975055,
        -0.51031725053400578,
    ),
)
"""The infrared camera, k1, k2, p1, p2, k3."""

_FURTHEST = 10.0  # metres; the toolbox sets what is beyond to that, here it is no reading
_ALPHA, _BETA = 351.3, 1092.5  # depth = alpha / (beta - reading)
_LARGEST = 2047  # readings have 11 bits
_APART = 0.1  # seconds between a depth image and its picture
_NAME = re.compile(r"[dr]-(\d+\.\d+)-\d+\.p[gp]m")


class NyuRaw(Dataset):
    """One raw recording, as the Kinect gave it: depth in its own camera, not the picture's.

    Depth is metres, from the Kinect's 11-bit readings; without reading it is 0. Pictures are those
    nearest in time, within 0.1 s, and are not registered. Ids are ``d-TIME-TICKS``.

    Parameters
    ----------
    folder : path
        Such as ``kitchen_0001``.
    camera : PinholeCamera, optional
        ``None`` means `DEPTH_CAMERA`.
    """

    kind: ClassVar[str] = "nyu-raw"
    holds: ClassVar[str] = "a folder of d-TIME-TICKS.pgm (NYU-v2, raw)"
    sensor = sensors.NYU
    registered = False

    def __init__(self, folder: str | Path, *, camera: PinholeCamera | None = None) -> None:
        self.folder, self.camera = Path(folder), camera or DEPTH_CAMERA
        depth = sorted(_timed(self.folder, "d-"))
        pictures = sorted(_timed(self.folder, "r-"))
        times = [time for time, _ in pictures]
        self._times = {Path(name).stem: time for time, name in depth}
        near = {Path(name).stem: nearest(times, time, _APART) for time, name in depth}
        self._colour = {frame: pictures[at][1] for frame, at in near.items() if at is not None}
        super().__init__(self.folder.name, list(self._times))

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder holds a file named like its depth images."""
        return path.is_dir() and any(
            each.name.startswith("d-") and _NAME.fullmatch(each.name) for each in path.iterdir()
        )

    def _read(self, frame: str) -> DatasetFrame:
        readings = read_depth(inside(self.folder, f"{frame}.pgm")).depth
        picture = self._colour.get(frame) if self.pictures else None
        return DatasetFrame(
            id=frame,
            depth=metres(readings),
            camera=self.camera,
            rgb=None if picture is None else read_colour(inside(self.folder, picture)),
            timestamp=self._times[frame],
        )


def metres(readings: NDArray[Any]) -> NDArray[np.float32]:
    """Depth of the Kinect's readings, shape (H, W); 0 for those that are none.

    Parameters
    ----------
    readings : ndarray of uint16, shape (H, W)
        Of 11 bits. The bytes of most files are in the order that PGM does not have; the order is
        the one in which all readings have 11 bits.

    Raises
    ------
    PlanewiseError
        If they have more in either order.
    """
    if readings.max(initial=0) > _LARGEST:
        readings = readings.byteswap()
    if readings.max(initial=0) > _LARGEST:
        raise PlanewiseError("the depth image is damaged: its readings have more than 11 bits")
    depth = _ALPHA / (_BETA - readings.astype(np.float64))
    depth[(depth < 0) | (depth > _FURTHEST) | (readings == 0)] = 0
    return depth.astype(np.float32)


def _timed(folder: Path, start: str) -> list[tuple[float, str]]:
    def wanted(path: Path) -> bool:
        return path.name.startswith(start) and _NAME.fullmatch(path.name) is not None

    names = (path.name for path in listed(folder, wanted))
    return [(float(name.split("-")[1]), name) for name in names]
