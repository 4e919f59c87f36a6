"""ICL-NUIM: rendered living room and office, as pictures or as its renderer wrote them.

Handa, Whelan, McDonald, Davison, "A benchmark for RGB-D visual odometry, 3D reconstruction and
SLAM", ICRA 2014. Its camera has fy = -480, for its y axis points up. Here y points down as
everywhere, so fy is 480, and its poses, made for the other axes, are not read.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from planewise.camera import PinholeCamera
from planewise.datasets.association import ASSOCIATIONS, are_timed, associations, states_times
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.paths import inside, listed
from planewise.datasets.picture_folder import FrameFiles, PictureFolder
from planewise.errors import PlanewiseError
from planewise.files.colour import read_colour

CAMERA = PinholeCamera(fx=481.2, fy=480.0, cx=319.5, cy=239.5, width=640, height=480)
"""The renderer's camera, y down."""

DEPTH_SCALE = 1 / 5000
"""Metres per unit of the pictures."""

_DISTANCES = re.compile(r"scene_\d+_\d+\.depth")
_LONGEST_NUMBER = 32  # characters that are read for each distance, at most


class IclNuim(PictureFolder):
    """Folder with ``associations.txt`` and the ``depth/`` and ``rgb/`` pictures that it lists.

    Lines are "number depth number picture", or pictures come first. Names of depth images become
    ids, their numbers times, at 30 frames a second.

    Parameters
    ----------
    folder : path
        Such as ``living_room_traj0_frei_png``.
    camera : PinholeCamera, optional
        ``None`` means `CAMERA`.
    """

    kind: ClassVar[str] = "icl-nuim"
    holds: ClassVar[str] = "a folder with associations.txt, depth/ and rgb/ (ICL-NUIM)"

    def __init__(self, folder: str | Path, *, camera: PinholeCamera | None = None) -> None:
        root = Path(folder)
        super().__init__(root, _frames(root), camera or CAMERA, DEPTH_SCALE)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has the list, of no clock's times, and the folders of pictures."""
        if not all((path / name).is_dir() for name in ("depth", "rgb")):
            return False
        return (path / ASSOCIATIONS).is_file() and not states_times(path)


class IclNuimRendered(Dataset):
    """Folder of ``scene_00_0000.depth`` and ``.png`` files, as the renderer wrote them.

    The first hold distances from the centre of the camera as text, 640 x 480 of them; depth is made
    of these. Ids are the names without ending.

    Parameters
    ----------
    folder : path
        Such as ``living_room_traj0_loop``.
    camera : PinholeCamera, optional
        ``None`` means `CAMERA`; it has to know the size of its images.
    """

    kind: ClassVar[str] = "icl-nuim-rendered"
    holds: ClassVar[str] = "a folder of scene_00_0000.depth (ICL-NUIM, as rendered)"

    def __init__(self, folder: str | Path, *, camera: PinholeCamera | None = None) -> None:
        self.folder, self.camera = Path(folder), camera or CAMERA
        if self.camera.width is None or self.camera.height is None:
            raise PlanewiseError("camera: width and height must be given, the files do not tell")
        self._shape = (self.camera.height, self.camera.width)
        files = listed(self.folder, _has_distances)
        super().__init__(self.folder.name, [path.stem for path in files])

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder holds a file named like its distances."""
        return path.is_dir() and any(map(_has_distances, path.iterdir()))

    def _read(self, frame: str) -> DatasetFrame:
        path = inside(self.folder, f"{frame}.depth")
        count = self._shape[0] * self._shape[1]
        if path.stat().st_size > _LONGEST_NUMBER * count:
            raise PlanewiseError(f"{path.name} is too large for {count:,} distances")
        words = path.read_bytes().split()
        if len(words) != count:
            raise PlanewiseError(f"{path.name} holds {len(words):,} distances, expected {count:,}")
        distance = np.array(words, np.float64).reshape(self._shape)
        # |(u, v, 1)| z = distance
        depth = distance / np.linalg.norm(self.camera.rays(self._shape), axis=-1)
        picture = inside(self.folder, f"{frame}.png")
        return DatasetFrame(
            id=frame,
            depth=depth.astype(np.float32),
            camera=self.camera,
            rgb=read_colour(picture) if self.pictures and picture.is_file() else None,
        )


def _has_distances(path: Path) -> bool:
    return _DISTANCES.fullmatch(path.name) is not None and path.is_file()


def _frames(root: Path) -> list[FrameFiles]:
    frames = associations(root)
    if are_timed(frames):
        return frames
    return [replace(each, timestamp=(each.timestamp or 0.0) / 30) for each in frames]
