"""Folders of LiDAR sweeps as KITTI has them: raw float32, x, y, z and reflectance of each point.

nuScenes has the ring of each point besides.

Geiger, Lenz, Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite",
CVPR 2012. Caesar et al., "nuScenes: A multimodal dataset for autonomous driving", CVPR 2020.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import ClassVar

import numpy as np

from planewise.datasets.frames import PointDataset, PointFrame
from planewise.datasets.paths import inside, listed, text_of
from planewise.errors import PlanewiseError
from planewise.files.depth import check_size

_PLACES = ("", "velodyne", "velodyne_points/data")
_NUSCENES = ".pcd.bin"  # how its names end
_TIMES = ("times.txt", "timestamps.txt", "velodyne_points/timestamps.txt")


class LidarFolder(PointDataset):
    """Sweeps ``*.bin`` in a folder, in its ``velodyne/``, or in its ``velodyne_points/data/``.

    Ids are the names without ending. Times are those of ``times.txt`` (seconds) or
    ``timestamps.txt`` (dates) beside them, where there are as many as sweeps.

    Parameters
    ----------
    folder : path
        Such as ``sequences/00`` of the odometry set, or a ``..._sync`` drive of the raw data.
    columns : int, optional
        Numbers of each point, x, y, z and intensity first. ``None`` means 5 for sweeps
        ``*.pcd.bin``, which are nuScenes', and 4 for others.
    """

    kind: ClassVar[str] = "lidar"
    holds: ClassVar[str] = "a folder of .bin sweeps, or with velodyne/ (KITTI, nuScenes)"

    def __init__(self, folder: str | Path, *, columns: int | None = None) -> None:
        self.folder = Path(folder)
        if columns is not None and columns < 3:
            raise PlanewiseError(f"columns must be at least 3 (x, y, z), got {columns}")
        self.columns = columns
        self._place = next((place for place in _PLACES if _sweeps(self.folder / place)), "")
        sweeps = _sweeps(inside(self.folder, self._place))
        self._names = {path.stem: path.name for path in sweeps}
        times = _times(self.folder, len(sweeps))
        self._time = dict(zip(self._names, times, strict=True)) if times else {}
        super().__init__(self.folder.name, [path.stem for path in sweeps])

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether there are sweeps in one of the usual places."""
        return any(_sweeps(path / place) for place in _PLACES)

    def _read(self, frame: str) -> PointFrame:
        path = inside(self.folder, f"{self._place}/{self._names[frame]}".lstrip("/"))
        columns = self.columns or (5 if path.name.lower().endswith(_NUSCENES) else 4)
        row, size = 4 * columns, path.stat().st_size
        if size % row:
            raise PlanewiseError(
                f"{path.name} is cut short or has other columns: its {size:,} bytes are no "
                f"multiple of {row}"
            )
        check_size(size // row)
        rows = np.fromfile(path, "<f4").reshape(-1, columns)
        return PointFrame(
            id=frame,
            points=np.ascontiguousarray(rows[:, :3], np.float32),
            intensity=rows[:, 3].astype(np.float32) if columns > 3 else None,
            timestamp=self._time.get(frame),
        )


def _sweeps(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return listed(folder, lambda path: path.suffix.lower() == ".bin" and path.is_file())


def _times(folder: Path, count: int) -> list[float]:
    """Seconds of all sweeps, or none where there is no list that fits."""
    name = next((name for name in _TIMES if (folder / name).is_file()), None)
    if name is None:
        return []
    lines = text_of(folder, name).split("\n")
    try:
        times = [_seconds(line.strip()) for line in lines if line.strip()]
    except ValueError:
        raise PlanewiseError(f"{name} must hold a time on each line") from None
    return times if len(times) == count else []


def _seconds(text: str) -> float:
    """Seconds, written as such or as a date with nanoseconds (UTC)."""
    if "-" not in text[1:] or ":" not in text:
        return float(text)
    whole, _, fraction = text.partition(".")
    return datetime.fromisoformat(f"{whole}+00:00").timestamp() + float(f"0.{fraction or 0}")
