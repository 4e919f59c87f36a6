"""Many datasets below one folder as one: scenes, sequences, drives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Self

from planewise.datasets.frames import (
    Dataset,
    DatasetFrame,
    Frame,
    Frames,
    PointDataset,
    PointFrame,
)
from planewise.errors import PlanewiseError

BETWEEN = "--"
"""Stands between the name of a part and the id of its frame."""


class _Joined(Frames[Frame]):
    """Frames of several datasets; ids are ``part--id``.

    Parameters
    ----------
    name : str
        Of the whole.
    parts : mapping of str to dataset or str
        By their names; what could not be opened is there by what is wrong with it, and counts as
        one frame, of the part's name, that cannot be read.
    """

    kind: ClassVar[str] = "collection"
    holds: ClassVar[str] = "a folder of such files and folders"

    def __init__(self, name: str, parts: Mapping[str, Frames[Frame] | str]) -> None:
        self.parts: dict[str, Frames[Frame] | str] = dict(parts)
        super().__init__(name, list(self._names()))
        self._count = len(self.ids)

    def _names(self) -> Iterator[str]:
        for name, part in self.parts.items():
            if isinstance(part, str):
                yield name
            else:
                yield from (f"{name}{BETWEEN}{each}" for each in part.ids)

    def __contains__(self, frame: object) -> bool:
        if len(self.ids) < self._count:  # only some were chosen
            return super().__contains__(frame)
        if not isinstance(frame, str):
            return False
        return isinstance(self.parts.get(frame), str) or self._place(frame) is not None

    def without_pictures(self) -> Self:
        """Return the same frames, whose pictures are not read."""
        bare = super().without_pictures()
        bare.parts = self._changed(lambda part: part.without_pictures())
        return bare

    def without_poses(self) -> Self:
        """Return the same frames, whose poses are not read."""
        bare = super().without_poses()
        bare.parts = self._changed(lambda part: part.without_poses())
        return bare

    def _changed(
        self, change: Callable[[Frames[Frame]], Frames[Frame]]
    ) -> dict[str, Frames[Frame] | str]:
        parts = self.parts.items()
        return {name: part if isinstance(part, str) else change(part) for name, part in parts}

    def _read(self, frame: str) -> Frame:
        place = self._place(frame)
        if place is None:
            raise PlanewiseError(self.parts[frame])  # what is wrong with a part
        part, each = place
        return replace(part[each], id=frame)

    def _place(self, frame: str) -> tuple[Frames[Frame], str] | None:
        """Part and id of a frame; no table is kept of them, for there may be millions."""
        at = frame.find(BETWEEN)
        while at >= 0:
            part, each = self.parts.get(frame[:at], ""), frame[at + len(BETWEEN) :]
            if not isinstance(part, str) and each in part:
                return part, each
            at = frame.find(BETWEEN, at + 1)
        return None


class Collection(_Joined[DatasetFrame], Dataset):
    """Depth images of several datasets; ids are ``part--id``.

    Parameters
    ----------
    name : str
        Of the whole.
    parts : mapping of str to Dataset or str
        By their names; what could not be opened is there by what is wrong with it, and counts as
        one frame, of the part's name, that cannot be read.
    folder : Path, optional
        Where the parts lie.
    """

    def __init__(
        self, name: str, parts: Mapping[str, Dataset | str], folder: Path | None = None
    ) -> None:
        super().__init__(name, parts)
        self.folder = folder
        sensors = [part.sensor for part in parts.values() if not isinstance(part, str)]
        self.sensor = sensors[0] if all(each == sensors[0] for each in sensors) else None
        self.registered = all(isinstance(part, str) or part.registered for part in parts.values())

    @property
    def labelled(self) -> tuple[str, ...]:
        """Ids of the frames that have true planes."""
        parts = ((name, part) for name, part in self.parts.items() if isinstance(part, Dataset))
        names = (f"{name}{BETWEEN}{each}" for name, part in parts for each in part.labelled)
        return tuple(each for each in names if each in self)


class PointCollection(_Joined[PointFrame], PointDataset):
    """Points of several datasets; see `Collection`."""
