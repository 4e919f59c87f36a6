"""A store as it is read: labels, planes and statistics of many frames.

>>> from planewise.batch import Store
>>> def steepest(path):
...     for frame in Store(path):
...         yield frame.id, frame.planes[:, 1].min(initial=0.0)
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planewise.batch.columns import DONE, FAILED, FRAMES, PLANES
from planewise.batch.frame_names import label_path
from planewise.batch.segments import Segment, segments_of
from planewise.batch.store_info import read_info
from planewise.batch.tables import arrow, schema_of
from planewise.errors import PlanewiseError, SetupError
from planewise.files.coco_rle import decode_mask
from planewise.wording import counted

if TYPE_CHECKING:
    import pyarrow as pa

_MENDED = "; {}the 'planewise batch' that made the store makes it again"
_PARAMETERS = ("normal_x", "normal_y", "normal_z", "distance")


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class StoredFrame:
    """A frame of a store.

    Attributes
    ----------
    id : str
        Name in its dataset.
    row : Mapping
        Its row of the table of frames.
    plane_table : pyarrow.Table
        Its rows of the table of planes, best first.
    store : Store
        Where it is from.
    """

    id: str
    row: Mapping[str, Any]
    plane_table: pa.Table
    store: Store

    @property
    def planes(self) -> NDArray[np.float64]:
        """Rows (normal, distance), shape (N, 4); row j - 1 is that of label j."""
        columns = [self.plane_table[name].to_numpy() for name in _PARAMETERS]
        return np.stack(columns, axis=1)

    @property
    def labels(self) -> NDArray[np.uint16]:
        """Label image, shape (H, W): 0 for no plane."""
        if self.row["labels"] is not None:
            labels = self.store.read_label_file(self.id)
            size, planes = (self.row["height"], self.row["width"]), len(self.plane_table)
            if labels.shape != size or labels.max(initial=0) > planes:
                raise PlanewiseError(
                    f"store: frame {self.id}: its label file is of another frame: {labels.shape} "
                    f"with labels up to {labels.max(initial=0)}, in place of {size} and {planes}"
                    f"{_MENDED.format('once it is deleted, ')}"
                )
            return labels
        labels = np.zeros((self.row["height"], self.row["width"]), np.uint16)
        for label, mask in enumerate(self.plane_table["rle"].to_pylist(), start=1):
            labels[decode_mask(mask or "", (labels.shape[0], labels.shape[1]))] = label
        return labels


@dataclass(frozen=True)
class _Content:
    """Frames of a segment that are done, with the places of their first planes."""

    segment: Segment
    rows: dict[str, tuple[dict[str, Any], int]]
    planes: pa.Table


class Store:
    """Labels and planes of many frames, as ``planewise batch`` writes them.

    It may be read while another process adds more; `ids` are those of the first time they are
    asked for.

    Parameters
    ----------
    path : path
        Folder.

    Attributes
    ----------
    info : dict
        Content of ``store.json``: options, versions, source.

    Raises
    ------
    PlanewiseError
        If it is no store, or one of another version.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.info = read_info(self.path)
        # Of each writer the last segment asked for: neighbours are of different shards.
        self._read: dict[str, _Content] = {}

    @cached_property
    def _statuses(self) -> dict[str, tuple[str, str]]:
        """Status of every frame, and the segment it is in."""
        found: dict[str, tuple[int, str, str]] = {}
        for segment in segments_of(self.path):
            frames, _ = segment.tables(("frame", "number", "status"), ())
            columns = (frames[name].to_pylist() for name in frames.column_names)
            for frame, number, status in zip(*columns, strict=True):
                found[frame] = (number, status, segment.name)
        ordered = sorted(found.items(), key=lambda item: item[1][0])
        return {frame: (status, name) for frame, (_, status, name) in ordered}

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Frames that are done, in the order of the source."""
        return tuple(each for each, (status, _) in self._statuses.items() if status == DONE)

    @cached_property
    def failed(self) -> tuple[str, ...]:
        """Frames that could not be done."""
        return tuple(each for each, (status, _) in self._statuses.items() if status == FAILED)

    @property
    def known(self) -> tuple[str, ...]:
        """Frames that are done or failed, in the order of the source."""
        return tuple(self._statuses)

    def failures(self) -> Iterator[tuple[int, str, str]]:
        """Number, id and reason of every frame that failed, a segment at a time in memory."""
        for segment in segments_of(self.path):
            frames, _ = segment.tables(("number", "frame", "status", "reason"), ())
            for row in frames.to_pylist():
                if row["status"] == FAILED:
                    yield row["number"], row["frame"], row["reason"]

    def chosen(self, ids: Collection[str]) -> Iterator[StoredFrame]:
        """Frames of these ids as they lie in the store, which is the fastest order."""
        wanted = {each for each in ids if each in self}
        for frame in self if wanted else ():
            if frame.id in wanted:
                yield frame
                wanted.remove(frame.id)
                if not wanted:
                    return

    def __len__(self) -> int:
        return len(self.ids)

    def __contains__(self, frame: object) -> bool:
        return frame in self._statuses and self._statuses[str(frame)][0] == DONE

    def __iter__(self) -> Iterator[StoredFrame]:
        """Frames that are done as they lie in the store, a segment at a time in memory.

        That is the order of the source where one run has done them; shards lie one after another.
        """
        for segment in segments_of(self.path):
            content = _content_of(segment)
            for frame in content.rows:
                yield self._frame(content, frame)

    def __getitem__(self, frame: str) -> StoredFrame:
        """Read one frame.

        Raises
        ------
        PlanewiseError
            If it is not in the store, or failed.
        """
        if frame not in self:
            others = f"it has {counted(len(self), 'other')}"
            held = "it failed" if frame in self._statuses else others
            raise PlanewiseError(f"store: {self.path} does not hold the frame {frame!r}; {held}")
        segment = Segment(self.path, self._statuses[frame][1])
        content = self._read.get(segment.writer)
        if content is None or content.segment != segment:
            content = self._read[segment.writer] = _content_of(segment)
        return self._frame(content, frame)

    def labels(self, frame: str) -> NDArray[np.uint16]:
        """Label image of a frame, shape (H, W): 0 for no plane, j for the j-th best.

        Raises
        ------
        PlanewiseError
            If the frame is not in the store, or its label file is damaged.
        """
        return self[frame].labels

    @property
    def frames(self) -> pa.Table:
        """All frames, failed ones too, one row each; see docs/batch.md for the columns."""
        return self._table(0, FRAMES)

    @property
    def planes(self) -> pa.Table:
        """All planes, one row each; see docs/batch.md for the columns."""
        return self._table(1, PLANES)

    def _table(self, which: int, columns: dict[str, str]) -> pa.Table:
        parts = [segment.tables()[which] for segment in segments_of(self.path)]
        empty = schema_of(columns).empty_table()
        return arrow().concat_tables([empty, *parts])

    def _frame(self, content: _Content, frame: str) -> StoredFrame:
        row, first = content.rows[frame]
        found = content.planes.slice(first, row["planes"])
        return StoredFrame(id=frame, row=row, plane_table=found, store=self)

    def read_label_file(self, frame: str) -> NDArray[np.uint16]:
        """Read the label image of a frame that has one."""
        from planewise.files.labels import read_labels

        try:
            labels = read_labels(self.label_file(frame)).labels
        except SetupError:
            raise
        except PlanewiseError as error:
            first = "once it is deleted, " if self.label_file(frame).exists() else ""
            raise PlanewiseError(f"store: frame {frame}: {error}{_MENDED.format(first)}") from None
        return labels.astype(np.uint16)

    def label_file(self, frame: str) -> Path:
        """Path of a frame's label image, where the store has such files."""
        return self.path / label_path(frame)


def _content_of(segment: Segment) -> _Content:
    frames, planes = segment.tables()
    compute = arrow().compute
    counts = frames.filter(compute.equal(frames["status"], DONE))["planes"]
    of_frames = compute.sum(counts).as_py() or 0
    if of_frames != len(planes) or (compute.min(counts).as_py() or 0) < 0:
        held = f"it holds {counted(len(planes), 'plane')} in place of {of_frames:,}"
        raise PlanewiseError(f"store: {segment.planes_file} is damaged: {held}; {segment.remedy}")
    rows = {}
    first = 0  # planes lie in the order of their frames
    for row in frames.to_pylist():
        if row["status"] == DONE:
            rows[row["frame"]] = row, first
            first += row["planes"]
    return _Content(segment, rows, planes)
