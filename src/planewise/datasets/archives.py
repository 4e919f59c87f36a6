"""A folder of NumPy archives, one frame each: depth, intrinsics, picture and true labels."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import ClassVar

from planewise.camera import PinholeCamera
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.paths import inside
from planewise.depth_files import natural_order, read_depth
from planewise.errors import PlanewiseError
from planewise.label_files import read_labels

_MILLIMETRE = 0.001
_LABELS = {"gt.npy", "labels.npy"}


class ArchiveFolder(Dataset):
    """Folder of ``.npz`` files with ``depth``, ``K`` (fx, fy, cx, cy), ``rgb`` and ``gt``.

    What each key may hold is said in `planewise.depth_files.read_depth` and
    `planewise.label_files.read_labels`. Integer depth without ``depth_scale`` is millimetres.

    Parameters
    ----------
    folder : path
        Ids are the names of its files without ending.
    camera : PinholeCamera, optional
        For archives without ``K``.
    """

    kind: ClassVar[str] = "archives"
    holds: ClassVar[str] = "a folder of .npz files, each with depth, K and, where known, rgb and gt"

    def __init__(self, folder: str | Path, *, camera: PinholeCamera | None = None) -> None:
        self.folder, self.camera = Path(folder), camera
        if not self.folder.is_dir():
            raise PlanewiseError(f"data: {folder} is not a folder")
        paths = (
            path
            for path in self.folder.iterdir()
            if path.suffix.lower() == ".npz" and not path.name.startswith(".") and path.is_file()
        )
        super().__init__(self.folder.name, [path.stem for path in sorted(paths, key=natural_order)])

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder holds archives, the first of which has depth."""
        first = next(iter(sorted(path.glob("*.npz"))), None) if path.is_dir() else None
        return first is not None and zipfile.is_zipfile(first) and "depth.npy" in _names(first)

    @property
    def labelled(self) -> tuple[str, ...]:
        """All ids: which archives hold labels is known when they are read."""
        return self.ids

    def _read(self, frame: str) -> DatasetFrame:
        path = inside(self.folder, f"{frame}.npz")
        seen = read_depth(path)
        camera = seen.camera or self.camera
        if camera is None:
            raise PlanewiseError("camera: the file does not hold K, fx, fy, cx, cy")
        scale = seen.depth_scale
        if seen.depth.dtype.kind != "f" and scale is None:
            scale = _MILLIMETRE
        return DatasetFrame(
            id=frame,
            depth=seen.depth,
            camera=camera,
            depth_scale=scale,
            rgb=seen.rgb if self.pictures else None,
            labels=read_labels(path).labels if _LABELS & _names(path) else None,
        )


def _names(path: Path) -> set[str]:
    with zipfile.ZipFile(path) as archive:
        return set(archive.namelist())
