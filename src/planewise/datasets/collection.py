"""Many datasets below one folder as one: scenes, sequences, drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar, TypeVar

from planewise.datasets.frames import Dataset, DatasetFrame, PointDataset, PointFrame
from planewise.errors import PlanewiseError

BETWEEN = "--"
"""Stands between the name of a part and the id of its frame."""

Unreadable = str
"""Why a part cannot be opened."""

Part = TypeVar("Part", Dataset, PointDataset)


class Collection(Dataset):
    """Depth images of several datasets; ids are ``part--id``.

    Parameters
    ----------
    name : str
        Of the whole.
    parts : mapping of str to Dataset or str
        By their names; what could not be opened is there by what is wrong with it, and counts as
        one frame, of the part's name, that cannot be read.
    """

    kind: ClassVar[str] = "collection"
    holds: ClassVar[str] = "a folder of such files and folders"

    def __init__(self, name: str, parts: Mapping[str, Dataset | Unreadable]) -> None:
        self.parts = dict(parts)
        super().__init__(name, _ids(parts))
        sensors = [each.sensor for each in parts.values() if isinstance(each, Dataset)]
        self.sensor = sensors[0] if all(each == sensors[0] for each in sensors) else None

    @property
    def labelled(self) -> tuple[str, ...]:
        """Ids of the frames that have true planes."""
        chosen = [
            f"{name}{BETWEEN}{each}"
            for name, part in self.parts.items()
            if isinstance(part, Dataset)
            for each in part.labelled
        ]
        return tuple(each for each in chosen if each in self)

    def _read(self, frame: str) -> DatasetFrame:
        part, each = _place(self.parts, frame)
        return replace((part if self.pictures else part.without_pictures())[each], id=frame)


class PointCollection(PointDataset):
    """Points of several datasets; see `Collection`."""

    kind: ClassVar[str] = Collection.kind
    holds: ClassVar[str] = Collection.holds

    def __init__(self, name: str, parts: Mapping[str, PointDataset | Unreadable]) -> None:
        self.parts = dict(parts)
        super().__init__(name, _ids(parts))

    def _read(self, frame: str) -> PointFrame:
        part, each = _place(self.parts, frame)
        return replace(part[each], id=frame)


def _ids(
    parts: Mapping[str, Dataset | Unreadable] | Mapping[str, PointDataset | Unreadable],
) -> Sequence[str]:
    ids: list[str] = []
    for name, part in parts.items():
        if isinstance(part, Unreadable):
            ids.append(name)
        else:
            ids += [f"{name}{BETWEEN}{each}" for each in part.ids]
    return ids


def _place(parts: Mapping[str, Part | Unreadable], frame: str) -> tuple[Part, str]:
    """Part and id of a frame; ids are not kept a second time, for there may be millions."""
    at = frame.find(BETWEEN)
    while at >= 0:
        part = parts.get(frame[:at])
        if part is not None and not isinstance(part, Unreadable):
            each = frame[at + len(BETWEEN) :]
            if each in part:
                return part, each
        at = frame.find(BETWEEN, at + 1)
    raise PlanewiseError(str(parts[frame]))
