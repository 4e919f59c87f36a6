"""How the rows of a store lie on the disk.

They come in segments, whose names have the writer and a number. A segment is a journal at first
(``journal/NAME.jsonl``), and Parquet later (``planes/NAME.parquet``, ``frames/NAME.parquet``). It
counts as Parquet from the moment its frames are there, which are written last; until then, its
journal counts and nothing else of it. So it is never both, whenever a process is killed.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING

from planewise.batch.columns import FAILED, FRAMES, PLANES
from planewise.batch.journal import line_of, read_records
from planewise.batch.staging import Staging, sync_folder
from planewise.batch.tables import arrow, lacking, parquet_of, read_table, tables_of
from planewise.errors import PlanewiseError, SetupError, in_one_line

if TYPE_CHECKING:
    import pyarrow as pa

FOLDERS = ("labels", "frames", "planes", "journal")
_JOURNAL, _PARQUET = ".jsonl", ".parquet"


@dataclass(frozen=True)
class Segment:
    """A segment of the store in a folder."""

    store: Path
    name: str

    @property
    def writer(self) -> str:
        """Name of who writes it."""
        return self.name.rpartition("-")[0]

    @property
    def number(self) -> int:
        """Its number among those of its writer."""
        return int(self.name.rpartition("-")[2])

    @property
    def journal(self) -> Path:
        """File of records."""
        return self.store / "journal" / (self.name + _JOURNAL)

    @property
    def frames_file(self) -> Path:
        """Parquet file of frames; the segment is sealed where it exists."""
        return self.store / "frames" / (self.name + _PARQUET)

    @property
    def planes_file(self) -> Path:
        """Parquet file of planes."""
        return self.store / "planes" / (self.name + _PARQUET)

    @property
    def remedy(self) -> str:
        """What to do where its Parquet is damaged; its label images are written again, too."""
        return (
            f"once {self.name}{_PARQUET} of frames/ and planes/ is deleted, the 'planewise batch' "
            "that made the store does its frames again"
        )

    def tables(
        self, frames: Sequence[str] = tuple(FRAMES), planes: Sequence[str] = tuple(PLANES)
    ) -> tuple[pa.Table, pa.Table]:
        """Frames and planes, or some columns of them; of frames their status is one."""
        records = read_records(self.journal)  # first: once its Parquet is there, it goes
        if not self.frames_file.exists():
            found, on_them = self._of_journal(records)
            return found.select(list(frames)), on_them.select(list(planes))
        try:
            found = read_table(self.frames_file, {name: FRAMES[name] for name in frames})
            if name := lacking(found):
                raise PlanewiseError(f"store: {self.frames_file} is damaged: a frame lacks {name}")
            of_planes = {name: PLANES[name] for name in planes}
            return found, read_table(self.planes_file, of_planes) if planes else arrow().table({})
        except SetupError:
            raise
        except PlanewiseError as error:
            raise PlanewiseError(f"{error}; {self.remedy}") from None

    def _of_journal(self, records: Sequence[bytes]) -> tuple[pa.Table, pa.Table]:
        damaged = f"store: {self.journal} is damaged"
        try:
            frames, planes = tables_of(records)
        except SetupError:
            raise
        except Exception as error:  # records are JSON, of anything
            raise PlanewiseError(f"{damaged} ({in_one_line(error)})") from None
        if name := lacking(frames):
            raise PlanewiseError(f"{damaged}: a frame lacks {name}")
        return frames, planes

    def holds_frames(self) -> bool:
        """Whether any frame is in it, be it one that failed."""
        return self.frames_file.exists() or bool(read_records(self.journal))

    def seal(self, staging: Staging) -> None:
        """Turn the journal into Parquet."""
        records = read_records(self.journal)
        if records and not self.frames_file.exists():
            frames, planes = self._of_journal(records)
            staging.publish(parquet_of(planes), self.planes_file)
            staging.publish(parquet_of(frames), self.frames_file)
        self.journal.unlink(missing_ok=True)
        sync_folder(self.journal.parent)

    def forget_failed(self, again: Collection[str], staging: Staging) -> None:
        """Drop those of these frames that failed, which have no planes; they are to do then."""

        def stays(frame: str, status: str) -> bool:
            return status != FAILED or frame not in again

        if self.frames_file.exists():
            frames = read_table(self.frames_file, FRAMES)
            columns = (frames[name].to_pylist() for name in ("frame", "status"))
            kept = frames.filter(arrow().array(list(map(stays, *columns))))
            if len(kept) < len(frames):
                staging.publish(parquet_of(kept), self.frames_file)
            return
        records = read_records(self.journal)
        rows = (json.loads(record)["frame"] for record in records)
        stay = [stays(row["frame"], row["status"]) for row in rows]
        if not all(stay):
            staging.publish(b"".join(map(line_of, compress(records, stay))), self.journal)


def segments_of(store: Path) -> list[Segment]:
    """Segments of a store by name.

    While another process writes: journals are looked for first, for a segment that is sealed in
    between is then found as Parquet.
    """
    names = {path.stem for path in sorted((store / "journal").glob(f"*{_JOURNAL}"))}
    names |= {path.stem for path in sorted((store / "frames").glob(f"*{_PARQUET}"))}
    return [Segment(store, name) for name in sorted(names)]


def own_segments(store: Path, writer: str) -> Iterator[Segment]:
    """Those of one writer, in their order."""
    for segment in segments_of(store):
        if segment.writer == writer:
            yield segment
