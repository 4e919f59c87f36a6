"""Arrays that a stream of frames needs again and again."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class Workspace:
    """Arrays by name, made once and handed out again as long as they are large enough.

    What is handed out holds what its last user left in it, and is overwritten by the next. A
    workspace serves one frame at a time.
    """

    def __init__(self) -> None:
        self._held: dict[str, NDArray[Any]] = {}

    def empty(
        self, name: str, shape: int | tuple[int, ...], dtype: DTypeLike = np.float64
    ) -> NDArray[Any]:
        """Return an array with arbitrary content.

        Parameters
        ----------
        name : str
            Whoever asks for the same name gets the same memory.
        shape, dtype
            As of `numpy.empty`.
        """
        dtype = np.dtype(dtype)
        size = shape if isinstance(shape, int) else math.prod(shape)
        held = self._held.get(name)
        if held is None or held.size < size or held.dtype != dtype:
            held = self._held[name] = np.empty(size, dtype)
        return held[:size].reshape(shape)

    def copy(self, name: str, array: NDArray[Any]) -> NDArray[Any]:
        """Return a copy of an array in memory of a name."""
        out = self.empty(name, array.shape, array.dtype)
        out[...] = array
        return out

    @property
    def nbytes(self) -> int:
        """Memory held."""
        return sum(array.nbytes for array in self._held.values())
