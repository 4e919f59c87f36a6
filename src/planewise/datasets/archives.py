"""A folder of NumPy archives, one frame each: depth, intrinsics, picture and true labels."""

from __future__ import annotations

import zipfile
from pathlib import Path

from planewise.camera import PinholeCamera
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.depth_files import natural_order, read_depth
from planewise.errors import PlanewiseError
from planewise.label_files import read_labels

_MILLIMETRE = 0.001


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

    def _read(self, frame: str) -> DatasetFrame:
        path = self.folder / f"{frame}.npz"
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
            rgb=seen.rgb,
            labels=read_labels(path).labels if _has_labels(path) else None,
        )


def _has_labels(path: Path) -> bool:
    with zipfile.ZipFile(path) as archive:
        return not {"gt.npy", "labels.npy"}.isdisjoint(archive.namelist())
