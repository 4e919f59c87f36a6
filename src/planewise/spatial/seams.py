"""Seams between sectors: the cells of an image side by side, as if there were no sectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import forms as comparing
from planewise.kernels.cells import SIDE
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells

Array = NDArray[np.float64]
Grid = NDArray[np.int32]


@dataclass(frozen=True)
class Neighbours:
    """Which cells are beside each other.

    Attributes
    ----------
    grid : ndarray of int32, shape (rows, columns)
        Unit of every cell of the image, -1 where there is no plane, without gaps between sectors.
    discords : ndarray, shape (2, rows, columns)
        Across every side that two units of different segments share, to the right and below; -1 for
        no such side.
    sides : int
        Number of those.
    wraps : bool
        Whether the last column is beside the first.
    """

    grid: Grid
    discords: Array
    sides: int
    wraps: bool


def neighbours(
    cells: Cells,
    grid: Grid,
    of_unit: NDArray[np.int32],
    discords: Array,
    sides: int,
    sectors: Sectors,
) -> Neighbours:
    """Put the sectors' cells side by side, with discords across the seams.

    Parameters
    ----------
    cells : Cells
        Of the frame.
    grid : ndarray of int32, shape (rows, columns)
        Theirs, or only those that matter.
    of_unit : ndarray of int32, shape (units,)
        Segment of every unit.
    discords : ndarray, shape (2, rows, columns)
        Of the cells of all sectors and the gaps between them.
    sides : int
        Discords that are not -1.
    sectors : Sectors
        Of the frame.

    Returns
    -------
    Neighbours
    """
    if sectors.count == 1:
        return Neighbours(grid, discords, sides, False)
    # Cells at the end that are too narrow for planes are left out: only squares reach into them.
    first, last = sectors.start // SIDE, sectors.stop // SIDE
    if (first == last).any():
        return Neighbours(grid, discords, sides, False)
    columns = np.concatenate([np.arange(*each) for each in zip(first, last, strict=True)])
    grid, across = grid[:, columns], discords[:, :, columns]
    ends = np.cumsum(last - first)
    for k in range(sectors.count if sectors.wraps else sectors.count - 1):
        beside = np.stack((grid[:, ends[k] - 1], grid[:, ends[k] % grid.shape[1]]), axis=1)
        across[0, :, ends[k] - 1] = found = _discords(cells, of_unit, beside, sectors, k)
        sides += int(np.count_nonzero(found >= 0))
    return Neighbours(grid, across, sides, sectors.wraps)


def _discords(
    cells: Cells, of_unit: NDArray[np.int32], beside: Grid, sectors: Sectors, k: int
) -> Array:
    """Discords (rows,) of units (rows, 2) across the seam behind sector k; -1 for no such side.

    They are compared in the coordinates about the seam.
    """
    rows = np.flatnonzero(
        (beside >= 0).all(axis=1) & (of_unit[beside[:, 0]] != of_unit[beside[:, 1]])
    )
    forms, found = np.empty((2, len(rows), comparing.FORM)), np.empty(len(rows))
    for side, sector in enumerate((k, (k + 1) % sectors.count)):
        units = beside[rows, side]
        home = np.full(len(units), sector)
        about_seam = sectors.turned(cells.rows[units], home, sectors.seam_turns[:, k])
        comparing.write_forms(about_seam, cells.drift[units], sectors.lean, forms[side])
    comparing.discords_of(*forms, found)
    discords = np.full(len(beside), -1.0)
    discords[rows] = found
    return discords
