"""How frames get into a store, so that each is there once, whenever the process is killed.

1. A label image is written to the staging folder.
2. A group of them is brought to the disk and moved into place; a label image without a row counts
   for nothing, and is replaced when its frame is done again.
3. The rows of the group are added to the journal. With that, its frames are in the store.
4. A long journal becomes Parquet (see `segments`).

Steps 2 to 4 are a thread's, so that frames go on coming in while the disk works.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

from planewise.batch.frame_work import Outcome
from planewise.batch.journal import Journal
from planewise.batch.segments import Segment, own_segments
from planewise.batch.staging import Staging, move_whole, refuse_links, sync_folder

_FRAMES_A_SEGMENT = 2000
_SECONDS_A_GROUP = 1.0  # frames of so much time are done again after a kill
_LARGEST_GROUP = 256
_SYNCS = 8  # at a time: file systems bring many files to the disk for little more than one


class StoreWriter:
    """Adds frames to a store that is locked; use `opened`."""

    def __init__(self, store: Path, writer: str, staging: Staging) -> None:
        self._store, self._writer, self._staging = store, writer, staging
        self._group: list[tuple[Outcome, Path | None]] = []
        self._started = time.monotonic()
        self._folders: set[Path] = set()
        self._committer = ThreadPoolExecutor(1, thread_name_prefix="commit")
        self._syncs = ThreadPoolExecutor(_SYNCS, thread_name_prefix="sync")
        self._committed: Future[None] | None = None
        self._journal = self._open_journal()

    def add(self, outcome: Outcome) -> None:
        """Take a frame; it is in the store some `_SECONDS_A_GROUP` later.

        One without a record has its rows there, and only its label image is replaced.

        Raises
        ------
        OSError
            If there is no room, for this frame or an earlier one.
        """
        file = None
        if outcome.label_file is not None:
            file = self._staging.write(outcome.label_file[1])
        self._group.append((outcome, file))
        busy = self._committed is not None and not self._committed.done()
        full = len(self._group) >= _LARGEST_GROUP
        if full or (not busy and time.monotonic() - self._started > _SECONDS_A_GROUP):
            self._hand_over()

    def flush(self) -> None:
        """Wait until all frames that were taken are in the store."""
        self._hand_over()
        self._wait()

    def close(self, *, seal: bool) -> None:
        """Let go of the store; with `seal`, what is still a journal becomes Parquet."""
        try:
            if seal:
                self.flush()
                self._seal(None)
        finally:
            self._committer.shutdown(wait=True)
            self._syncs.shutdown(wait=True)
            self._journal.close()

    def _hand_over(self) -> None:
        self._wait()
        group, self._group, self._started = self._group, [], time.monotonic()
        if group:
            self._committed = self._committer.submit(self._commit, group)

    def _wait(self) -> None:
        if self._committed is not None:
            committed, self._committed = self._committed, None
            committed.result()

    def _commit(self, group: list[tuple[Outcome, Path | None]]) -> None:
        moves = [
            (file, self._store / outcome.label_file[0])
            for outcome, file in group
            if file is not None and outcome.label_file is not None
        ]
        folders = {target.parent for _, target in moves}
        for folder in folders - self._folders:
            self._make_folder(folder)
        list(self._syncs.map(lambda move: move_whole(*move), moves))
        list(self._syncs.map(sync_folder, folders))
        self._journal.add([outcome.record for outcome, _ in group if outcome.record])
        if self._journal.count >= _FRAMES_A_SEGMENT:
            self._seal(self._segment(self._segment_open.number + 1))

    def _make_folder(self, folder: Path) -> None:
        below = folder.relative_to(self._store)
        refuse_links(self._store / part for part in (below, *below.parents[:-1]))
        folder.mkdir(parents=True, exist_ok=True)
        self._folders.add(folder)
        while folder != self._store:
            folder = folder.parent
            sync_folder(folder)

    def _open_journal(self) -> Journal:
        """Go on with the last journal, and seal what should have been."""
        last = None
        for segment in own_segments(self._store, self._writer):
            last = segment
            if segment.frames_file.exists():
                segment.seal(self._staging)
        if last is None or last.frames_file.exists():
            last = self._segment(1 if last is None else last.number + 1)
        self._segment_open = last
        return Journal(last.journal)

    def _segment(self, number: int) -> Segment:
        return Segment(self._store, f"{self._writer}-{number:06}")

    def _seal(self, following: Segment | None) -> None:
        self._segment_open.seal(self._staging)
        if following is not None:
            sealed, self._journal = self._journal, Journal(following.journal)
            self._segment_open = following
            sealed.close()


@contextmanager
def opened(store: Path, writer: str, staging: Staging) -> Iterator[StoreWriter]:
    """Write to a store; at the end, also after an error, what was taken is committed."""
    writer_ = StoreWriter(store, writer, staging)
    try:
        yield writer_
    except BaseException:
        with suppress(Exception):  # the first error says more; what is lost is done again
            writer_.flush()
        with suppress(Exception):
            writer_.close(seal=False)
        raise
    writer_.close(seal=True)
