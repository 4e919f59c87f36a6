"""Units of planes: which lie wholly inside a label, and what they tell of its plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import units as unit_loops
from planewise.kernels.cells import COUNT, SIDE
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells
from planewise.spatial.frame import Frame
from planewise.spatial.segments import information_matrices, with_none

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

BENT = 0.5  # `residual_correlation` beyond which a surface bends

_FEWEST_PURE = 4  # cells wholly inside a label that are needed to refit its plane
_FEWEST_PAIRS = 10  # of cells side by side that tell how white a plane's residuals are


def units_inside(frame: Frame, cells: Cells, labels: Labels) -> NDArray[np.int32]:
    """Label of every unit that lies wholly inside one, 0 of the others.

    Beside holes are mixed pixels, but not where readings are missing all over.
    """
    inside = np.empty(len(cells.rows), np.int32)
    unit_loops.units_inside(labels, frame.p, not cells.thinned, cells.grid, inside)
    return inside


def sector_of_units(cells: Cells, sectors: Sectors) -> NDArray[np.int32]:
    """Sector that every unit lies in, shape (units,)."""
    out = np.zeros(len(cells.rows) + 1, np.int32)  # the last one of cells without a plane
    for k, (start, stop) in enumerate(zip(sectors.start, sectors.stop, strict=True)):
        if k:
            out[cells.grid[:, start // SIDE : -(-stop // SIDE)]] = k
    return out[:-1]


def planes_of_units(
    frame: Frame, cells: Cells, labels: Labels, planes: Array
) -> tuple[Array, Array]:
    """Rows of the planes once more, from the units that lie wholly inside their label.

    And how many readings there are in these, shape (N,).
    """
    sums, count = _sums(cells, units_inside(frame, cells, labels), len(planes))
    sectors = frame.sectors
    enough = sectors.repeated(sectors.summed(count) >= _FEWEST_PURE)
    rows = np.where(enough[:, None], sectors.together(sums), planes)
    return rows, sectors.summed(sums[:, COUNT])


def _sums(cells: Cells, inside: NDArray[np.int32], planes: int) -> tuple[Array, NDArray[np.int64]]:
    """Rows of the units of every label (N K, 13) together, and how many they are."""
    sums, count = np.empty((planes + 1, cells.rows.shape[1])), np.empty(planes + 1, int)
    unit_loops.sum_units(cells.rows, inside, sums, count)
    return sums[1:], count[1:]


def pure_information(frame: Frame, cells: Cells, labels: Labels, planes: int) -> Array:
    """Information (N, 3, 3) on planes, from the units that lie wholly inside their label.

    Where these are few, from all readings as if they erred apart.
    """
    sums, count = _sums(cells, units_inside(frame, cells, labels), planes)
    out = information_matrices(sums)
    for j in np.flatnonzero(count < _FEWEST_PURE):
        mine = labels == j + 1
        x = np.stack((np.ones(np.count_nonzero(mine)), frame.x[mine], frame.y[mine]))
        out[j] = (x * (frame.p[mine] / cells.error.white)) @ x.T
    return out


def residual_correlation(
    cells: Cells, inside: NDArray[np.int32], affine: Array, sectors: Sectors
) -> Array:
    """Correlation of the residuals of cells side by side on every plane, shape (N,).

    Residuals are those of mean inverse depth in standard deviations of the cell's own error. Where
    the surface is a plane and the error white it is about 0; a surface that bends, or an error that
    drifts, brings it towards 1. NaN with fewer than ten pairs of cells. inside (units,): label of
    each (`units_inside`), 0 for none; affine (N K, 3): the planes in every sector.
    """
    sums, off = np.empty((len(affine) + 1, 3)), np.empty(len(inside))
    unit_loops.correlate(cells.grid, cells.rows, inside, with_none(affine), off, sums)
    together, apart, pairs = sectors.summed(sums[1:]).T
    told = (pairs >= _FEWEST_PAIRS) & (apart > 0)
    return np.where(told, together / np.where(told, apart, 1.0), np.nan)
