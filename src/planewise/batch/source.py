"""What a batch reads frames from, and which of them it takes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import is_whole, make_counts
from planewise.camera import Camera
from planewise.errors import PlanewiseError
from planewise.files.depth import DepthFile, list_depth_files, read_depth


class SourceFrame(Protocol):
    """A depth image and what is known of it, such as `planewise.datasets.DatasetFrame`.

    It may have a `timestamp`, in seconds.
    """

    @property
    def depth(self) -> NDArray[Any]:
        """Readings, shape (H, W): integer units of `depth_scale`, or floating-point metres."""
        ...

    @property
    def camera(self) -> Camera | None:
        """Intrinsics, where they are known."""
        ...

    @property
    def depth_scale(self) -> float | None:
        """Metres per unit of integer depth, where it is known."""
        ...

    @property
    def rgb(self) -> NDArray[np.uint8] | None:
        """Picture of the view, where there is one."""
        ...


class Source(Protocol):
    """Frames by id; every `planewise.datasets.Dataset` is one.

    A source is copied to other processes and machines, which have to reach what it reads. Where it
    has an attribute `registered` that is false, its pictures do not show the view of the depth.
    """

    @property
    def name(self) -> str:
        """What it is called in messages."""
        ...

    @property
    def ids(self) -> Sequence[str]:
        """Of all frames, unique, in their order; the same whenever and wherever they are asked."""
        ...

    def __getitem__(self, frame: str) -> SourceFrame:
        """Read one frame; raise `ValueError` or `OSError` where it cannot be read."""
        ...


def is_registered(source: Source) -> bool:
    """Whether the pictures of a source show the view of its depth images."""
    return bool(getattr(source, "registered", True))


def path_of(source: Source) -> Path | None:
    """Where a source lies, if it says so: pictures can be shown beside its labels then."""
    path = getattr(source, "folder", None) or getattr(source, "path", None)
    return None if path is None else Path(path)


def is_gone(source: Source) -> bool:
    """Whether what a source reads is there no more, or an empty folder as of a share unmounted."""
    path = path_of(source)
    if path is None:
        return False
    try:
        return not (path.is_file() or any(path.iterdir()))
    except OSError:
        return True


class DepthFolder:
    """Depth images of a folder in natural order; a frame's id is its file name without ending.

    Where two files differ in nothing else, the ending is part of the id.

    Parameters
    ----------
    folder : path
        Holds files that `planewise.files.depth.read_depth` reads, or links to such, wherever they
        lead.

    Raises
    ------
    PlanewiseError
        If it is no folder, or holds no depth file.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).absolute()
        self.name = self.folder.name
        paths = list_depth_files(folder)
        stems = [path.stem for path in paths]
        unique = len(set(stems)) == len(stems)
        self._files = {path.stem if unique else path.name: path.name for path in paths}
        self.ids = tuple(self._files)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def may_state_cameras(self) -> bool:
        """Whether there is a file of a kind that can hold its camera."""
        return any(name.lower().endswith(".npz") for name in self._files.values())

    def __iter__(self) -> Iterator[DepthFile]:
        return map(self.__getitem__, self.ids)

    def __getitem__(self, frame: str) -> DepthFile:
        """Read one frame.

        Raises
        ------
        PlanewiseError
            If there is none of that id, or it is damaged, or no depth image.
        """
        if frame not in self._files:
            raise PlanewiseError(f"data: {self.name} has no frame {frame!r}")
        return read_depth(self.folder / self._files[frame])


@dataclass(frozen=True, kw_only=True)
class Selection:
    """Which frames of a source are taken.

    Parameters
    ----------
    every : int
        One of so many, from the first.
    shard : tuple of int
        (i, n): of those, the i-th of n parts, counted from 1. The parts are disjoint and together
        all; neighbours go to different ones.
    limit : int, optional
        Of those, the first so many.
    """

    every: int = 1
    shard: tuple[int, int] = (1, 1)
    limit: int | None = None

    def __post_init__(self) -> None:
        make_counts(self, "every")
        if self.limit is not None:
            make_counts(self, "limit")
        match self.shard:
            case (part, parts) if is_whole(part) and is_whole(parts):
                if not 1 <= part <= parts:
                    raise PlanewiseError(f"shard must be i/n with 1 <= i <= n, got {part}/{parts}")
            case _:
                raise PlanewiseError(f"shard must be two whole numbers (i, n), got {self.shard!r}")

    def of(self, ids: Sequence[str]) -> list[tuple[int, str]]:
        """Number and id of the frames that are taken, in their order."""
        part, parts = self.shard
        numbers = range(0, len(ids), self.every)[part - 1 :: parts]
        return [(number, ids[number]) for number in numbers[: self.limit]]


def parse_shard(text: str) -> tuple[int, int]:
    """Read ``i/n``.

    Raises
    ------
    PlanewiseError
        If it is of another form.
    """
    part, slash, parts = text.partition("/")
    if not (slash and part.isdecimal() and parts.isdecimal()):
        raise PlanewiseError(f"shard must be i/n such as 3/8, got {text!r}")
    return int(part), int(parts)
