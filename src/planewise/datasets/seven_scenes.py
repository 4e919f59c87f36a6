"""7-Scenes: Kinect frames of seven rooms.

Shotton, Glocker, Zach, Izadi, Criminisi, Fitzgibbon, "Scene coordinate regression forests for
camera relocalization in RGB-D images", CVPR 2013.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

from planewise import sensors
from planewise.camera import PinholeCamera
from planewise.datasets.paths import listed
from planewise.datasets.picture_folder import FrameFiles, PictureFolder

CAMERA = PinholeCamera(fx=585.0, fy=585.0, cx=320.0, cy=240.0, width=640, height=480)
"""Depth camera, as the dataset's page states it."""

NO_READING = 65535

_DEPTH = re.compile(r"(frame-\d+)\.depth\.png")


class SevenScenes(PictureFolder):
    """One sequence: ``frame-000000.depth.png``, ``.color.png`` and ``.pose.txt`` in one folder.

    Depth is in millimetres, 65535 where there is no reading. Pictures are not registered to it: the
    cameras are some centimetres apart. Ids are ``frame-000000`` and so on.

    Parameters
    ----------
    folder : path
        Such as ``chess/seq-01``.
    camera : PinholeCamera, optional
        ``None`` means `CAMERA`.
    """

    kind: ClassVar[str] = "7-scenes"
    holds: ClassVar[str] = "a folder of frame-000000.depth.png and so on (7-Scenes)"
    sensor = sensors.KINECT_V1
    registered = False

    def __init__(self, folder: str | Path, *, camera: PinholeCamera | None = None) -> None:
        root = Path(folder)
        super().__init__(root, _frames(root), camera or CAMERA, 0.001, invalid=NO_READING)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder holds a file named like its depth images."""
        return path.is_dir() and any(_DEPTH.fullmatch(each.name) for each in path.iterdir())


def _frames(root: Path) -> Iterator[FrameFiles]:
    there = {path.name for path in root.iterdir()} if root.is_dir() else set()
    for path in listed(root, lambda path: _DEPTH.fullmatch(path.name) is not None):
        frame = path.name.removesuffix(".depth.png")
        colour, pose = f"{frame}.color.png", f"{frame}.pose.txt"
        yield FrameFiles(
            id=frame,
            depth=path.name,
            rgb=colour if colour in there else None,
            pose=pose if pose in there else None,
        )
