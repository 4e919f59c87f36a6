"""Cells of a grid that hold points: when they are small enough to tell, and large enough to close.

Cells make a surface once most of them have five of the eight neighbours that a border has at least,
and few empty ones are enclosed; smaller cells have gaps between points, or lie in lines.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

_SURFACE = 0.5  # share of the cells that must have five neighbours or more
_GAPS = 0.03  # enclosed empty cells against those that hold points, at most


def neighbours(cells: Mask) -> NDArray[np.uint8]:
    """How many of the eight cells around each are set, shape (n, m)."""
    padded = np.pad(cells, 1).astype(np.uint8)
    n, m = cells.shape
    around = sum(padded[i : i + n, j : j + m] for i in range(3) for j in range(3))
    return np.asarray(around - padded[1:-1, 1:-1], np.uint8)


def share_in_surfaces(held: Mask) -> tuple[float, bool]:
    """Share of the cells with points that have five neighbours or more; whether it is a surface.

    Parameters
    ----------
    held : ndarray of bool, shape (n, m)
        Cells that hold points.
    """
    around = neighbours(held)
    number = max(int(np.count_nonzero(held)), 1)
    share = int(np.count_nonzero(held & (around >= 5))) / number
    gaps = int(np.count_nonzero(~held & (around >= 6))) / number
    return share, share >= _SURFACE and gaps <= _GAPS
