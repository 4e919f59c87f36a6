"""Segments of a frame: neighbouring cells that are one plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import borders
from planewise.kernels import planes as plane_loops
from planewise.kernels.cells import MISFIT
from planewise.runtime.workspace import Workspace

Array = NDArray[np.float64]

_MATRIX = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # entries of a row that make P


@dataclass(frozen=True)
class Segments:
    """Segments of a frame.

    Attributes
    ----------
    rows : ndarray, shape (n, 13)
        What each is (`kernels.cells`).
    drift, offset_prior, slope_prior : ndarray, shape (n,)
        As of `spatial.cells.Cells`.
    home : ndarray of int32, shape (n,)
        Sector in whose coordinates each is.
    of_unit : ndarray of int32, shape (units,)
        Segment of every unit.
    """

    rows: Array
    drift: Array
    offset_prior: Array
    slope_prior: Array
    home: NDArray[np.int32]
    of_unit: NDArray[np.int32]

    def kept(self, roots: NDArray[np.int32], segment: NDArray[np.int32]) -> Segments:
        """Only those that others were merged into, or none; segment (n,): which of them each is."""
        return Segments(
            rows=self.rows.take(roots, axis=0),
            drift=self.drift.take(roots),
            offset_prior=self.offset_prior.take(roots),
            slope_prior=self.slope_prior.take(roots),
            home=self.home.take(roots),
            of_unit=segment.take(self.of_unit),
        )

    def divided(
        self, pieces: Segments, chosen: NDArray[np.intp], units: NDArray[np.intp], rows: Array
    ) -> Segments:
        """With some of their units segments of their own, behind all that there were.

        pieces: segments of `units`, of which the chosen ones count; rows (., 13): of all units.
        """
        of_unit, mine = self.of_unit.copy(), self.rows.copy()
        for number, piece in enumerate(chosen, len(mine)):
            taken = units[pieces.of_unit == piece]
            np.subtract.at(mine[:, :MISFIT], of_unit[taken], rows[taken, :MISFIT])
            of_unit[taken] = number
        mine = np.concatenate((mine, pieces.rows[chosen]))
        return Segments(
            rows=mine,
            drift=np.concatenate((self.drift, pieces.drift[chosen])),
            offset_prior=np.concatenate((self.offset_prior, pieces.offset_prior[chosen])),
            slope_prior=np.concatenate((self.slope_prior, pieces.slope_prior[chosen])),
            home=np.concatenate((self.home, pieces.home[chosen])),
            of_unit=of_unit,
        )

    def of_cell(self, grid: NDArray[np.int32], workspace: Workspace) -> NDArray[np.int32]:
        """Segment of every cell of a grid of units, -1 where there is none."""
        out: NDArray[np.int32] = workspace.empty(grid.shape, np.int32)
        borders.segments_of_cells(grid, self.of_unit, out)
        return out


def information_matrices(rows: Array) -> Array:
    """P (N, 3, 3) of segment rows, which begin with its upper triangle."""
    return rows.take(_MATRIX, axis=1)


def affine_planes(rows: Array) -> Array:
    """(t0, t1, t2) of w = t0 + t1 x + t2 y: the plane of every segment row."""
    planes = np.empty((len(rows), 3))
    plane_loops.affine_planes(rows, planes)
    return planes


def narrow_sides(rows: Array) -> Array:
    """Across its narrow direction how wide each row, or sums, would be as a rectangle (n,)."""
    _, x, y, xx, xy, yy = rows.T[:6] / rows[:, 0]
    xx, xy, yy = xx - x * x, xy - x * y, yy - y * y
    narrow = 0.5 * (xx + yy - np.hypot(xx - yy, 2 * xy))
    # A rectangle has a twelfth of the square of its side for variance.
    return np.asarray(np.sqrt(12 * np.maximum(narrow, 0)))


def planes_by_label(rows: Array) -> Array:
    """`affine_planes` by label: a row of zeros for none before them."""
    planes = np.zeros((len(rows) + 1, 3))
    plane_loops.affine_planes(rows, planes[1:])
    return planes


def kept_planes(
    planes: Array, owner: NDArray[np.int64], kept: NDArray[np.intp]
) -> tuple[Array, NDArray[np.int64]]:
    """Some of the planes (K, N, .), and their numbers among these in place of those among all.

    owner: number of a plane, or -1 for none, as it is for all others then.
    """
    place = np.full(planes.shape[1] + 1, -1)  # the last is that of -1
    place[kept] = np.arange(len(kept))
    return planes[:, kept], place[owner]


def with_none(affine: Array) -> Array:
    """Planes by label: a row of zeros for none before them."""
    planes = np.zeros((len(affine) + 1, 3))
    planes[1:] = affine
    return planes
