"""Memory that a stream of frames needs again and again."""

from __future__ import annotations

import math
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.runtime.forks import in_child

Type = type[np.generic] | np.dtype[Any]

_ALIGNED = 64  # bytes: of a cache line
_made: weakref.WeakSet[Workspace] = weakref.WeakSet()


class Workspace:
    """One piece of memory, handed out in parts: to the end of a frame, or of a stage of it.

    What lasts as long as the frame is taken from the bottom, what lasts as long as a stage from the
    top. What does not fit is allocated, and the memory is larger for the next frame. Arrays hold
    what their last user left in them. A workspace serves one frame at a time.
    """

    def __init__(self) -> None:
        self._memory: NDArray[np.uint8] = np.empty(0, np.uint8)
        self._held = self._kept = self._lent = self._most = 0
        self._in_use = threading.Lock()
        _made.add(self)

    @contextmanager
    def frame(self) -> Iterator[None]:
        """All memory is free for a frame.

        Raises
        ------
        RuntimeError
            If another frame still works in it.
        """
        if not self._in_use.acquire(blocking=False):
            raise RuntimeError(
                "this Detector is still at work on another frame; it serves one thread at a time, "
                "so give every thread a Detector of its own"
            )
        try:
            if self._most > self._held:
                memory = np.empty(self._most + _ALIGNED, np.uint8)
                start = -memory.ctypes.data % _ALIGNED
                self._memory, self._held = memory[start : start + self._most], self._most
            self._kept = self._lent = 0
            yield
        finally:
            self._in_use.release()

    def stage(self) -> _Stage:
        """What `empty` hands out until the end of the block is free after it."""
        return _Stage(self)

    def kept(self, shape: int | tuple[int, ...], dtype: Type = np.float64) -> NDArray[Any]:
        """Return an array that lasts as long as the frame, with arbitrary content.

        Parameters
        ----------
        shape, dtype
            As of `numpy.empty`; dtype a class such as `numpy.int32`.
        """
        kind, start = np.dtype(dtype), self._kept
        self._kept += _size(shape, kind.itemsize)
        return self._part(start, shape, kind)

    def empty(self, shape: int | tuple[int, ...], dtype: Type = np.float64) -> NDArray[Any]:
        """Return an array that lasts as long as the stage, with arbitrary content."""
        kind = np.dtype(dtype)
        self._lent += _size(shape, kind.itemsize)
        return self._part(self._held - self._lent, shape, kind)

    def copy(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return a copy that lasts as long as the stage."""
        out = self.empty(array.shape, array.dtype)
        out[...] = array
        return out

    def _part(self, start: int, shape: int | tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
        used = self._kept + self._lent
        if used > self._held:
            self._most = max(self._most, used)
            return np.empty(shape, dtype)
        return np.ndarray(shape, dtype, self._memory, start)


class _Stage:
    """A block at the end of which a workspace takes back what it lent since."""

    __slots__ = ("lent", "workspace")

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace

    def __enter__(self) -> None:
        self.lent = self.workspace._lent

    def __exit__(self, *_: object) -> None:
        self.workspace._lent = self.lent


def _size(shape: int | tuple[int, ...], item: int) -> int:
    """Bytes of an array, in whole lines of the cache."""
    size = item * (shape if isinstance(shape, int) else math.prod(shape))
    return size + -size % _ALIGNED


def _free_all() -> None:
    """Let a forked process use what a thread of its parent was using, which it does not have."""
    for each in _made:
        each._in_use = threading.Lock()


in_child(_free_all)
