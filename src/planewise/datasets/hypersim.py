"""Hypersim: rendered rooms, whose depth is the distance from the camera.

Roberts, Ramapuram, Ranjan, Kumar, Bautista, Paczan, Webb, Susskind, "Hypersim: a photorealistic
synthetic dataset for holistic indoor scene understanding", ICCV 2021. Its usual camera sees 60
degrees; scenes with another one, which their ``metadata_camera_parameters.csv`` states, need it to
be given. Poses, which are in units of each scene, are not read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planewise.camera import PinholeCamera
from planewise.datasets.hdf5 import array_of, load_h5py, opened, rows_of
from planewise.datasets.paths import inside, listed
from planewise.datasets.picture_folder import FrameFiles, PictureFolder
from planewise.errors import PlanewiseError
from planewise.files.depth import natural_order

CAMERA = PinholeCamera(
    fx=886.81, fy=886.81, cx=511.5, cy=383.5, width=1024, height=768, radial=True
)
"""The usual camera of 60 degrees, as the dataset's authors state it."""

_GEOMETRY = re.compile(r"scene_(cam_\d+)_geometry_hdf5")
_FOLDERS = "geometry_hdf5", "final_preview"
_DISTANCES = re.compile(r"frame\.(\d+)\.depth_meters\.hdf5")


class Hypersim(PictureFolder):
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
        load_h5py("Hypersim")
        root = Path(folder)
        frames = list(_frames(root))
        if not frames:
            raise PlanewiseError(f"{root} holds no frame.0000.depth_meters.hdf5")
        super().__init__(root, frames, replace(camera or CAMERA, radial=True), None)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has one of geometry below its images."""
        return any(_cameras(path))

    def _depth(self, path: Path) -> NDArray[np.float32]:
        with opened(path) as file:
            array = array_of(file, "dataset", 2, "f")
            distance = rows_of(array, slice(0, array.shape[0]))
        return np.where(np.isfinite(distance), distance, 0).astype(np.float32)


def _cameras(folder: Path) -> Iterator[str]:
    """Names of cameras, such as cam_00, of which the scene has geometry."""
    images = folder / "images"
    for path in sorted(images.iterdir(), key=natural_order) if images.is_dir() else ():
        if (name := _GEOMETRY.fullmatch(path.name)) and path.is_dir():
            yield name[1]


def _frames(folder: Path) -> Iterator[FrameFiles]:
    for camera in _cameras(folder):
        place, pictures = (f"images/scene_{camera}_{each}" for each in _FOLDERS)
        for path in listed(inside(folder, place), _has_distances):
            number = _DISTANCES.sub(r"\1", path.name)
            picture = f"{pictures}/frame.{number}.tonemap.jpg"
            yield FrameFiles(
                id=f"{camera}.{number}",
                depth=f"{place}/{path.name}",
                rgb=picture if (folder / picture).is_file() else None,
            )


def _has_distances(path: Path) -> bool:
    return _DISTANCES.fullmatch(path.name) is not None and path.is_file()
