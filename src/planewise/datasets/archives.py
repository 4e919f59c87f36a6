"""A folder of NumPy archives, one frame each: depth, intrinsics, picture and true labels."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import ClassVar

from planewise.camera import PinholeCamera
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.paths import inside, listed
from planewise.errors import PlanewiseError
from planewise.files.depth import read_depth
from planewise.files.labels import read_labels

_MILLIMETRE = 0.001
_LABELS = {"gt.npy", "labels.npy"}
_LOOKED_AT = 10  # archives, to recognise a folder of them


class ArchiveFolder(Dataset):
    """Folder of ``.npz`` files with ``depth``, ``K`` (fx, fy, cx, cy), ``rgb`` and ``gt``.

    What each key may hold is said in `planewise.files.depth.read_depth` and
    `planewise.files.labels.read_labels`. Integer depth without ``depth_scale`` is millimetres.

    Parameters
    ----------
    folder : path
        Ids are the names of its files without ending.
    camera : PinholeCamera, optional
        Instead of ``K``.
    """

    kind: ClassVar[str] = "archives"
    holds: ClassVar[str] = "a folder of .npz files, each with depth, K and, where known, rgb and gt"

    def __init__(self, folder: str | Path, *, camera: PinholeCamera | None = None) -> None:
        self.folder, self.camera = Path(folder), camera
        if not self.folder.is_dir():
            raise PlanewiseError(f"data: {folder} is not a folder")
        super().__init__(self.folder.name, [path.stem for path in _archives(self.folder)])

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder holds archives, one of the first of which has depth."""
        first = _archives(path)[:_LOOKED_AT] if path.is_dir() else []
        return any("depth.npy" in _names(each) for each in first)

    @property
    def labelled(self) -> tuple[str, ...]:
        """All ids: which archives hold labels is known when they are read."""
        return self.ids

    def _read(self, frame: str) -> DatasetFrame:
        path = inside(self.folder, f"{frame}.npz")
        seen = read_depth(path)
        camera = self.camera or seen.camera
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


def _archives(folder: Path) -> list[Path]:
    return listed(folder, lambda path: path.suffix == ".npz" and path.is_file())


def _names(path: Path) -> set[str]:
    """Names of an archive's members, none where it is damaged."""
    try:
        with zipfile.ZipFile(path) as archive:
            return set(archive.namelist())
    except (zipfile.BadZipFile, OSError, ValueError):
        return set()
