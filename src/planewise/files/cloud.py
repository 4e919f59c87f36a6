"""Open point clouds in files: PLY, PCD, XYZ and CSV, NumPy, PTX, LAS and LAZ, E57.

Files are not trusted: what a header claims is held against the size of the file before anything is
allocated for it, and nothing in them is ever executed.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from planewise.errors import PlanewiseError
from planewise.point_cloud import CloudFile, PointCloud, readable

_FORMATS = {
    ".ply": "ply.open_ply",
    ".pcd": "pcd.open_pcd",
    **dict.fromkeys((".xyz", ".txt", ".csv", ".asc", ".pts"), "xyz.open_xyz"),
    ".npy": "npz.open_npy",
    ".npz": "npz.open_npz",
    ".ptx": "ptx.open_ptx",
    ".las": "las.open_las",
    ".laz": "las.open_las",
    ".e57": "e57.open_e57",
}

KINDS = tuple(_FORMATS)
"""Endings of the files that can be read."""


def open_cloud(path: str | Path) -> CloudFile:
    """Open a point cloud without reading all of it.

    Parameters
    ----------
    path : path
        ``.ply``, ``.pcd``, ``.xyz``, ``.txt``, ``.csv``, ``.asc``, ``.pts``, ``.npy``, ``.npz``,
        ``.ptx``, ``.las``, ``.laz`` or ``.e57``; the last three need the extra 'cloud'.

    Returns
    -------
    CloudFile
        With ``chunks(size)`` for files larger than memory, and ``read()``.

    Raises
    ------
    PlanewiseError
        If the file is missing, damaged, or of no known kind.
    MissingExtraError
        If its format needs a package that is not installed.
    """
    path = Path(path)
    if not path.exists():
        raise PlanewiseError(f"cloud: there is no file {path}")
    if not path.is_file():
        raise PlanewiseError(f"cloud: {path} is not a file")
    place = _FORMATS.get(path.suffix.lower())
    if place is None:
        raise PlanewiseError(
            f"cloud: {path.name} is of no known kind; expected one of {', '.join(KINDS)}"
        )
    module, name = place.split(".")
    opener: Callable[[Path], CloudFile] = getattr(import_module(f"planewise.files.{module}"), name)
    with readable(path):
        if not path.stat().st_size:
            raise PlanewiseError("is empty")
        return opener(path)


def read_cloud(path: str | Path) -> PointCloud:
    """Read a point cloud; the same as ``open_cloud(path).read()``."""
    return open_cloud(path).read()
