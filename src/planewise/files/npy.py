"""What the header of a NumPy array (`.npy`) says."""

from __future__ import annotations

from collections.abc import Callable
from typing import IO, Any

import numpy as np

from planewise.errors import PlanewiseError

_LARGEST_ITEM = 16  # bytes of one number


def array_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape of the array that follows, whether its columns lie one after another, and its type.

    Raises
    ------
    PlanewiseError
        If it holds pickled objects, or a shape or type that no array has.
    """
    version = np.lib.format.read_magic(stream)
    read_header: Callable[[IO[bytes]], tuple[tuple[int, ...], bool, np.dtype[Any]]] = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, fortran, dtype = read_header(stream)
    if dtype.hasobject:
        raise PlanewiseError("holds pickled Python objects, which are never loaded")
    if min(shape, default=0) < 0 or dtype.itemsize > _LARGEST_ITEM:
        raise PlanewiseError(f"claims an array of shape {shape} and type {dtype}")
    return shape, fortran, dtype
