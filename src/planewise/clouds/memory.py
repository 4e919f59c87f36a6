"""Where the arrays of a cloud lie: in memory, or in files without a name that are mapped into it.

A mapped array is an array like any other. `release` gives the memory of its pages back, which are
read again from the file when they are next looked at: loops that go through an array part by part
and release between parts hold one part at a time.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from planewise.errors import NO_ROOM, PlanewiseError


class Memory:
    """Arrays in memory."""

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Array of any content."""
        return np.empty(shape, dtype)

    def release(self) -> None:
        """Say that what was looked at so far is not needed for now."""

    def growing(self, dtype: DTypeLike, width: int = 0) -> Growing:
        """Array whose length is not known yet; width: numbers of a row, 0 for plain numbers."""
        return Growing(np.dtype(dtype), width)


class Disk(Memory):
    """Arrays in files without a name, which vanish with the arrays, even if the process is killed.

    Parameters
    ----------
    folder : Path, optional
        Where there is room for them; the system's folder for temporary files by default.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._maps: weakref.WeakSet[Any] = weakref.WeakSet()

    def file(self) -> Any:
        """Open a new file without a name."""
        try:
            return tempfile.TemporaryFile(dir=self._folder, prefix=".planewise-")
        except OSError as error:
            raise PlanewiseError(
                f"folder: {self._folder or tempfile.gettempdir()} takes no temporary files "
                f"({error.strerror or error})"
            ) from None

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Array of any content, in a file."""
        size = math.prod(shape) if isinstance(shape, tuple) else shape
        with self.file() as stream:
            _reserve(stream, size * np.dtype(dtype).itemsize)
            return self.mapped(stream, np.dtype(dtype)).reshape(shape)

    def mapped(self, stream: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
        """All of a file as an array."""
        size = stream.seek(0, 2)
        if not size:
            return np.empty(0, dtype)
        block = mmap.mmap(stream.fileno(), size)  # keeps the file
        self._maps.add(block)
        return np.frombuffer(block, dtype)

    def release(self) -> None:
        """Give back the memory of all pages; what was written stays in the files."""
        advice = getattr(mmap, "MADV_DONTNEED", None)  # not on Windows
        if advice is not None:
            for block in list(self._maps):
                block.madvise(advice)

    def growing(self, dtype: DTypeLike, width: int = 0) -> Growing:
        """Array in a file whose length is not known yet."""
        return Growing(np.dtype(dtype), width, self)


class Growing:
    """Array that is put together part by part; on a disk where one is given."""

    def __init__(self, dtype: np.dtype[Any], width: int, disk: Disk | None = None) -> None:
        self._dtype, self._width, self._disk = dtype, width, disk
        self._parts: list[NDArray[Any]] = []
        self._stream: Any = None
        if disk is not None:
            self._stream = disk.file()
            weakref.finalize(self, self._stream.close)

    def append(self, part: NDArray[Any]) -> None:
        """Add rows of its type."""
        if self._stream is None:
            self._parts.append(part)
        else:
            _checked(self._stream.write, np.ascontiguousarray(part, self._dtype).data)

    def array(self) -> NDArray[Any]:
        """All rows; nothing can be added any more."""
        shape = (-1, self._width) if self._width else (-1,)
        if self._stream is None or self._disk is None:
            parts, self._parts = self._parts, []
            if len(parts) == 1:
                return parts[0]
            empty = np.empty((0, self._width) if self._width else 0, self._dtype)
            return np.concatenate([empty, *parts])
        with self._stream as stream:
            _checked(stream.flush)
            return self._disk.mapped(stream, self._dtype).reshape(shape)

    def taken(self) -> NDArray[Any]:
        """Copy of all rows in memory; nothing can be added any more."""
        return np.array(self.array())


def _reserve(stream: Any, size: int) -> None:
    """Make a file so long, and sure that its content has room: a full disk is said here."""
    _checked(stream.truncate, size)
    if size and hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(stream.fileno(), 0, size)
        except OSError as error:
            if error.errno in NO_ROOM:
                raise _unwritable(error) from None


def _checked(write: Callable[..., object], *arguments: object) -> None:
    try:
        write(*arguments)
    except OSError as error:
        raise _unwritable(error) from None


def _unwritable(error: OSError) -> PlanewiseError:
    return PlanewiseError(f"folder: a temporary file cannot be written ({error.strerror or error})")
