"""Cells of a grid that hold points: when they are small enough to tell, and large enough to close.

Cells make a surface once most of them have five of the eight neighbours that a border has at least,
and few empty ones are enclosed; smaller cells have gaps between points, or lie in lines.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_CELLS = 3000  # along one side of the grid
FEWEST = 10  # points whose density can be told
_FIRST = 1.5  # smallest cells that are tried: 2.25 points on the mean in those that hold any
_LADDER = math.sqrt(2.0)
_STRIP, _ROWS = 4.0, 3.0  # length over width; cells across, of which fewer are two
_FILLED = 0.95  # of two rows of cells, in which nothing encloses a gap
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


def derive_cells(local: Array, most_cells: int = MOST_CELLS) -> Array:
    """Sides of the cells that points cover without gaps, in their unit, shape (2,).

    They are squares, but where the points make a strip as narrow as that: then two lie across.

    Parameters
    ----------
    local : ndarray, shape (k, 2)
        Points, from zero on; x is along the longer side of their rectangle.
    most_cells : int
        Along a third of that side.
    """
    extent = local.max(axis=0)
    largest, half = float(extent.max()) / 3, 0.5 * float(extent.min())
    smallest = _sparse(local, float(extent.prod()), largest / most_cells)
    best, most = np.array((smallest, smallest)), -1.0
    for side in _sides(smallest, largest):
        two_rows = np.array((min(side * side / half, largest), half))
        narrow = 2.0 * half < min(_ROWS * side, extent.max() / _STRIP)
        if narrow and (counts(local, two_rows)[1:-1, 1:3] > 0).mean() >= _FILLED:
            return two_rows
        sides = np.array((side, side)) if side < half else two_rows
        share, closed = share_in_surfaces(counts(local, sides) > 0)
        if closed and not narrow:
            return sides
        share += closed  # ragged, but better than none that is closed
        if share > most:
            best, most = sides, share
    return best


def held_area(local: Array, most_cells: int) -> float:
    """Area of the cells that hold points, with cells and parameters as of `derive_cells`."""
    sides = derive_cells(local, most_cells)
    return float(np.count_nonzero(counts(local, sides)) * sides.prod())


def _sparse(local: Array, area: float, least: float) -> float:
    """Side of cells of which those that hold points have some two, wherever the points lie."""
    side = math.inf
    while True:
        finer = max(_FIRST * math.sqrt(area / len(local)), least)
        if finer > side / _LADDER:
            return min(side, finer)
        side = finer
        area = np.count_nonzero(counts(local, np.array((side, side)))) * side**2


def _sides(smallest: float, largest: float) -> Iterator[float]:
    side = smallest
    while side <= largest:
        yield side
        side *= _LADDER


def counts(local: Array, sides: Array) -> NDArray[np.int64]:
    """Points in each cell, with a margin of one empty cell; axis 0 is x."""
    cell = (local / sides).astype(np.int64) + 1
    shape = cell.max(axis=0) + 2
    flat = cell[:, 0] * shape[1] + cell[:, 1]
    return np.bincount(flat, minlength=int(shape.prod())).reshape(shape)
