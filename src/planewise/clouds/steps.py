"""Segments of clouds that are broken by steps (`planewise.levels`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import PRIOR, CloudCells, residual_correlation
from planewise.clouds.gaps import pair_values
from planewise.clouds.memory import Memory
from planewise.clouds.rows import planes_of
from planewise.kernels import cloud_cells as kernels
from planewise.kernels.cloud_planes import add_rows
from planewise.kernels.cloud_rows import CELLS, COUNT, CX, CZ, FREE, MISFIT, NX, NZ, WEIGHT
from planewise.levels import parts_at_steps
from planewise.parts import Bools, Index, bends, is_wide, points_of

Array = NDArray[np.float64]

_BENT = 0.1  # correlation of residuals side by side: of what is no plane
_MOST = 1_000_000  # cells of a segment that is divided


def at_steps(
    cells: CloudCells,
    rows: Array,
    of_cell: NDArray[np.int64],
    curved: Bools,
    cost: float,
    workers: int,
    at_once: int,
    memory: Memory,
) -> tuple[Array, NDArray[np.int64]]:
    """Divide segments that are broken by steps; the same where none is.

    Of those that are pieces of curved surfaces only wide ones, which may be curved with what stands
    off them.

    Parameters
    ----------
    cells : CloudCells
        Of the cloud.
    rows : ndarray, shape (N, 18)
        Of the segments.
    of_cell : ndarray of int, shape (m,)
        Segment of every cell.
    curved : ndarray of bool, shape (N,)
        Segments that are pieces of curved surfaces.
    cost : float
        Nats of the parameters of a plane.
    workers : int
        Threads.
    at_once : int
        Pairs of cells that are looked at together.
    memory : Memory
        Where large arrays lie.

    Returns
    -------
    rows, of_cell
        The widest part in the place of each that is divided, the others behind all.
    """
    bent = _bends(cells, rows, of_cell, ~curved | is_wide(rows[:, COUNT]), cost)
    if not bent.any():
        return rows, of_cell
    ends, place = _pairs_within(cells, of_cell, bent, at_once, memory), np.empty(len(of_cell), int)
    owner = of_cell[ends[:, 0]]
    all_rows, all_of = [rows.copy()], of_cell.copy()
    count = len(rows)
    for s in np.flatnonzero(bent).tolist():
        mine, sides = np.flatnonzero(of_cell == s), ends[owner == s]
        place[mine] = np.arange(len(mine))
        discord, _ = pair_values(cells.rows, sides, (0.0, 0.0), (*PRIOR, 0.0), workers)
        points = _points_of(cells.rows[mine], rows[s])
        found = parts_at_steps(points, discord, place[sides], cost)
        if found is None:
            continue
        part, across = found
        parts = _divided(cells.rows[mine], rows[s], part, across, cost)
        if parts is None:
            continue
        all_rows[0][s] = parts[0]
        all_rows.append(parts[1:])
        all_of[mine] = np.where(part == 0, s, count - 1 + part)
        count += len(parts) - 1
    return np.concatenate(all_rows), all_of


def _bends(
    cells: CloudCells, rows: Array, of_cell: NDArray[np.int64], chosen: Bools, cost: float
) -> Bools:
    """Which chosen segments have cells off their plane beyond noise, and alike where they touch."""
    planes, residual = planes_of(rows), np.empty(len(of_cell))
    kernels.cell_residuals(cells.rows, of_cell, planes, residual)
    count = rows[:, CELLS]
    excess = np.bincount(of_cell, residual * residual, len(rows)) - count
    bent = chosen & bends(excess, count, cost) & (count <= _MOST)
    if bent.any():
        bent &= residual_correlation(cells, of_cell, planes) > _BENT  # not where it is NaN
    return bent


def _pairs_within(
    cells: CloudCells, of_cell: NDArray[np.int64], chosen: Bools, at_once: int, memory: Memory
) -> NDArray[np.int32]:
    """Pairs (n, 2) of cells side by side within one of the chosen segments."""
    found = []
    for first in range(0, len(cells.ends), at_once):
        ends = cells.ends[first : first + at_once]
        u, v = of_cell[ends].T
        found.append(ends[(u == v) & chosen[u]])
        memory.release()
    return np.concatenate(found)


def _points_of(units: Array, whole: Array) -> Array:
    """Points (m, 4) of `planewise.parts` of cells, over the plane of their segment."""
    normal, centres = whole[NX : NZ + 1], units[:, CX : CZ + 1] - whole[CX : CZ + 1]
    axes = np.linalg.svd(normal[None])[2][1:]
    x, y = axes @ centres.T
    return points_of(x, y, centres @ normal, units[:, WEIGHT])


def _divided(units: Array, whole: Array, part: Index, across: Bools, cost: float) -> Array | None:
    """Rows (parts, 18) of the parts of a segment's cells; those that save too little are no planes.

    None where fewer than two are left.
    """
    rows, residual = np.zeros((int(part.max()) + 1, units.shape[1])), np.empty(len(units))
    add_rows(units, part, rows)
    kernels.cell_residuals(units, part, planes_of(rows), residual)
    excess = np.bincount(part, residual * residual) - rows[:, CELLS]
    rows[:, MISFIT] = whole[MISFIT] * rows[:, CELLS] / whole[CELLS] + np.maximum(excess, 0.0)
    none = across | (rows[:, FREE] - 0.5 * rows[:, MISFIT] <= cost)
    rows[none, FREE] = 0.0
    return rows if np.count_nonzero(~none) > 1 else None
