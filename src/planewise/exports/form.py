"""What all formats of export have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import ClassVar, TextIO

from planewise.batch.source import SourceFrame
from planewise.batch.store import Store, StoredFrame


class Form(ABC):
    """Writes frames, one at a time, in one format.

    Parameters
    ----------
    folder : Path
        Empty; it gets its name when all is written.
    store : Store
        Where the frames are from.
    ids : sequence of str
        Of all frames that may come, in the order of the source; they come in any.
    pictures : bool
        Write the frames' pictures, too, where the format has a place for them.

    Attributes
    ----------
    needs_source : bool
        Whether a frame cannot be written without its readings.
    places_pictures : bool
        Whether the format has a place for pictures that may stay empty.
    """

    needs_source: ClassVar[bool] = False
    places_pictures: ClassVar[bool] = False

    def __init__(
        self, folder: Path, store: Store, ids: Sequence[str], *, pictures: bool = False
    ) -> None:
        self.folder, self.store, self.ids = folder, store, tuple(ids)
        self.pictures = pictures
        self._files = ExitStack()

    @abstractmethod
    def add(self, frame: StoredFrame, seen: SourceFrame | None) -> None:
        """Write a frame whole; raise `PlanewiseError` before anything of it is written."""

    def left_out(self, frame: StoredFrame) -> None:  # noqa: B027 (most formats need not know)
        """Take note that a frame is not written."""

    @abstractmethod
    def finish(self) -> None:
        """Write what is only known at the end."""

    def close(self) -> None:
        """Close all files, also after an error."""
        self._files.close()

    def path(self, name: str) -> Path:
        """Path of a file in `folder`, whose own folder is made."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def text(self, name: str) -> TextIO:
        """Text file in `folder` that stays open until `close`; it can be read again, too."""
        file = self.path(name).open("w+", newline="", encoding="utf-8", errors="surrogateescape")
        return self._files.enter_context(file)
