"""How densely readings lie in an image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

LEAST_READINGS = 5
"""Of a cell: two more than a plane takes."""


def has_reading(depth: NDArray[Any]) -> Mask:
    """Where depth is neither missing (0, NaN) nor infinite."""
    there = depth != 0
    return np.asarray(there & np.isfinite(depth) if depth.dtype.kind == "f" else there)


def middle_rows(image: NDArray[Any], count: int) -> NDArray[Any]:
    """So many rows of an image, from its middle."""
    first = max(0, image.shape[0] // 2 - count // 2)
    return image[first : first + count]


def spread_rows(image: NDArray[Any], count: int) -> NDArray[Any]:
    """So many rows of an image, or a few more, as far apart as may be."""
    step = spread(image.shape[0], count)
    return image[step // 2 :: step]


def spread(rows: int, count: int) -> int:
    """How far apart `spread_rows` are; the first is half as far from the edge."""
    return max(1, rows // count)


def cell_counts(there: Mask, side: int) -> NDArray[np.intp]:
    """How many pixels of every whole cell of so many to a side are there."""
    rows, columns = (n // side for n in there.shape)
    cells = there[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.asarray(cells.sum(axis=(1, 3)))


def usual_count(readings: NDArray[Any]) -> int:
    """Readings of the median cell that has any: fewer than all where they are missing all over.

    Examples
    --------
    >>> usual_count(np.array([36, 36, 36, 0, 0, 0, 0])), usual_count(np.array([9, 8, 12, 0]))
    (36, 9)
    """
    return usual_size(np.bincount(readings.astype(np.intp).reshape(-1), minlength=2))


def usual_size(sizes: NDArray[np.int64]) -> int:
    """`usual_count` where so many cells have 0, 1 ... readings."""
    so_many = sizes[1:].cumsum()
    return 1 + int(so_many.searchsorted(max((int(so_many[-1]) + 1) // 2, 1)))
