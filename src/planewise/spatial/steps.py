"""Segments of depth images that are broken by steps (`planewise.levels`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.cells import COUNT
from planewise.levels import CLEARLY, parts_at_steps
from planewise.spatial.cells import Cells
from planewise.spatial.dividing import divided, points_of_segments
from planewise.spatial.segments import Segments, affine_planes

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Bools = NDArray[np.bool_]

_MIXED = 1.5  # times as uncertain as the unit beside it, for as many readings: across a step


def at_steps(
    cells: Cells, segments: Segments, planes: Array, chosen: Bools, sides: Index, price: float
) -> Segments:
    """Divide those of the chosen segments that are broken by steps; the same where none is.

    planes (n, 3): of all segments; sides (., 2): of units within the chosen ones; the rest as
    `planewise.spatial.splitting.split` takes it. The widest part stays in the place of its segment,
    the others are behind all, and behind those of each what lies across the steps.
    """
    out = segments
    for s, units, points, mine in points_of_segments(cells, segments, planes, chosen, sides):
        found = parts_at_steps(points, _discords(cells.rows[units], mine), mine, price)
        if found is not None:
            out = divided(out, s, *found, cells, price, all_pay=False) or out
    return out


def _discords(rows: Array, sides: Index) -> Array:
    """Discord (m,) across sides (m, 2) of units with rows (n, 13); clear, where one is mixed."""
    p, count = rows[:, 0], rows[:, COUNT]
    x, y = rows[:, 1] / p, rows[:, 2] / p
    planes, (u, v) = affine_planes(rows), sides.T
    own = 1.0 / np.column_stack((p, rows[:, 3] - x * rows[:, 1], rows[:, 5] - y * rows[:, 2]))
    both, step = own[u] + own[v], planes[u] - planes[v]
    # Their offset where they meet, in the middle, and their slopes.
    half = 0.5 * np.column_stack((x[u] - x[v], y[u] - y[v]))
    both[:, 0] += (both[:, 1:] * half * half).sum(axis=1)
    step[:, 0] += step[:, 1] * 0.5 * (x[u] + x[v]) + step[:, 2] * 0.5 * (y[u] + y[v])
    discord = (step * step / both).sum(axis=1)
    worse = (count[u] * p[v]) / (count[v] * p[u])
    mixed = (worse > _MIXED) | (worse * _MIXED < 1.0)
    return np.asarray(np.where(mixed, CLEARLY, discord))
