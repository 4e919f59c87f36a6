"""Memory that a stream of frames needs again and again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_ALIGNED = 64  # bytes: of a cache line


class Workspace:
    """One piece of memory, handed out in parts: to the end of a frame, or of a stage of it.

    What lasts as long as the frame is taken from the bottom, what lasts as long as a stage from the
    top. What does not fit is allocated, and the memory is larger for the next frame. Arrays hold
    what their last user left in them. A workspace serves one frame at a time.
    """

    def __init__(self) -> None:
        self._memory: NDArray[np.uint8] = np.empty(0, np.uint8)
        self._kept = self._lent = self._most = 0

    @contextmanager
    def frame(self) -> Iterator[None]:
        """All memory is free for a frame."""
        if self._most > self._memory.nbytes:
            self._memory = np.empty(self._most + _ALIGNED, np.uint8)
            start = -self._memory.ctypes.data % _ALIGNED
            self._memory = self._memory[start : start + self._most]
        self._kept = self._lent = 0
        yield

    @contextmanager
    def stage(self) -> Iterator[None]:
        """What `empty` hands out until the end of the block is free after it."""
        lent = self._lent
        yield
        self._lent = lent

    def kept(self, shape: int | tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return an array that lasts as long as the frame, with arbitrary content.

        Parameters
        ----------
        shape, dtype
            As of `numpy.empty`.
        """
        start = self._kept
        self._kept += self._size(shape, dtype)
        return self._part(start, shape, dtype)

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return an array that lasts as long as the stage, with arbitrary content."""
        self._lent += self._size(shape, dtype)
        return self._part(self._memory.nbytes - self._lent, shape, dtype)

    def copy(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return a copy that lasts as long as the stage."""
        out = self.empty(array.shape, array.dtype)
        out[...] = array
        return out

    @property
    def nbytes(self) -> int:
        """Memory held."""
        return self._memory.nbytes

    @staticmethod
    def _size(shape: int | tuple[int, ...], dtype: DTypeLike) -> int:
        count = shape if isinstance(shape, int) else math.prod(shape)
        return -(-count * np.dtype(dtype).itemsize // _ALIGNED) * _ALIGNED

    def _part(self, start: int, shape: int | tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        self._most = max(self._most, self._kept + self._lent)
        if self._kept + self._lent > self._memory.nbytes:
            return np.empty(shape, dtype)
        return np.ndarray(shape, dtype, self._memory.data, start)
