"""ScanNet scenes, exported from their ``.sens`` recordings as files.

Dai, Chang, Savva, Halber, Funkhouser, Niessner, "ScanNet: richly-annotated 3D reconstructions of
indoor scenes", CVPR 2017.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from planewise import sensors
from planewise.camera import PinholeCamera
from planewise.datasets.paths import matrix_of
from planewise.datasets.picture_folder import PictureFolder, depth_and_colour
from planewise.errors import PlanewiseError

DEPTH_SCALE = 0.001
"""Metres per unit."""

_INTRINSICS = "intrinsic/intrinsic_depth.txt", "intrinsics_depth.txt"  # the second of 25k frames


class ScanNetFolder(PictureFolder):
    """Folder with ``depth/``, ``color/``, ``pose/`` and ``intrinsic/intrinsic_depth.txt``.

    In the subset of 25,000 frames, the last is ``intrinsics_depth.txt`` in the folder itself.
    Pictures are larger than the depth images. Poses of infinities, where tracking was lost, are
    left out.

    Parameters
    ----------
    folder : path
        As ScanNet's exporter writes it; ids are the numbers of the frames.
    camera : PinholeCamera, optional
        Of the depth images, instead of the one in the file.
    """

    kind: ClassVar[str] = "scannet"
    holds: ClassVar[str] = (
        "a folder with depth/, color/ and intrinsic/ or intrinsics_depth.txt (ScanNet, exported)"
    )
    sensor = sensors.STRUCTURE

    def __init__(self, folder: str | Path, *, camera: PinholeCamera | None = None) -> None:
        root = Path(folder)
        poses = {path.name for path in (root / "pose").iterdir()} if _has(root, "pose") else set()
        frames = [
            replace(each, pose=f"pose/{name}") if name in poses else each
            for each in depth_and_colour(root, ("color",))
            for name in [f"{Path(each.depth).stem}.txt"]
        ]
        name = next((name for name in _INTRINSICS if (root / name).is_file()), _INTRINSICS[0])
        known = camera or camera_of(matrix_of(root, name, (4, 3)))
        super().__init__(root, frames, known, DEPTH_SCALE)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has depth/ and the intrinsics of the depth camera."""
        return _has(path, "depth") and any((path / name).is_file() for name in _INTRINSICS)


def camera_of(
    matrix: np.ndarray, width: int | None = None, height: int | None = None
) -> PinholeCamera:
    """Camera of ScanNet's 4 x 4 (or a 3 x 3) matrix of intrinsics.

    Raises
    ------
    PlanewiseError
        If it is no such matrix.
    """
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    try:
        return PinholeCamera(fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height)
    except ValueError as error:
        raise PlanewiseError(f"the intrinsics are damaged ({error})") from None


def _has(root: Path, name: str) -> bool:
    return (root / name).is_dir()
