"""Segments that are broken by steps: what stands off a plane by a step all along its border.

Surfaces lean (`planewise.flatness`): the discord of a wide segment with what stands a little off it
stops to grow with both, and their border does not cost enough to keep them apart. But units on its
two sides are in clear discord wherever they meet: no surface goes on there, of whatever shape the
border is. Units across it, which are on both, are on neither plane.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planewise.components import components
from planewise.kernels import splits as kernels
from planewise.kernels.cells import COUNT
from planewise.spatial.cells import Cells
from planewise.spatial.parts import (
    CLEAR,
    chi2_of,
    chi2_of_cubic,
    divided,
    is_small,
    joined,
    points_of_segments,
    widths,
)
from planewise.spatial.segments import Segments, affine_planes

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Bools = NDArray[np.bool_]

_BROKEN = 11.34  # discord of units side by side: chi^2 of three, 99 %
_MIXED = 1.5  # times as uncertain as the unit beside it, for as many readings: across a step
_LEFT = 0.25  # most of a segment that may be units across steps
_WIDE = 3.0  # units: less is a row of them along a step


def at_steps(
    cells: Cells, segments: Segments, planes: Array, chosen: Bools, sides: Index, price: float
) -> Segments:
    """Divide those of the chosen segments that are broken by steps; the same where none is.

    planes (n, 3): of all segments; sides (., 2): of units within the chosen ones; the rest as
    `planewise.spatial.splitting.split` takes it. The widest part stays in the place of its segment,
    the others are behind all, and behind those of each what lies across the steps.
    """
    root, out = _unbroken(cells.rows, sides), segments
    for s, units, points, mine in points_of_segments(cells, segments, planes, chosen, sides):
        pieces = np.unique(root[units], return_inverse=True)[1]
        if (found := _parts(points, pieces, mine, price)) is not None:
            out = divided(out, s, *found, cells, price) or out
    return out


def _unbroken(rows: Array, sides: Index) -> Index:
    """The first of the units (units,) that hang together by sides (m, 2) that no step breaks."""
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
    goes_on = (discord <= _BROKEN) & (worse <= _MIXED) & (worse * _MIXED >= 1.0)
    return components(len(rows), sides[goes_on])


def _parts(points: Array, piece: Index, sides: Index, price: float) -> tuple[Index, Bools] | None:
    """Part of every point (m, 4) of a segment in pieces (m,), and which are units across steps.

    None if it is one part. sides (., 2): points side by side.
    """
    size = np.bincount(piece)
    large = ~is_small(piece) & (widths(points, sides, _sums(points, piece)) >= _WIDE)
    mine = large[piece]
    if np.count_nonzero(large) < 2 or np.count_nonzero(~mine) > _LEFT * len(piece):
        return None
    widest_first = np.argsort(-np.where(large, size, 0), kind="stable")
    some, part = points[mine], np.argsort(widest_first, kind="stable")[piece[mine]]
    pairs = np.stack(np.triu_indices(part.max() + 1, 1), axis=1)
    part = joined(part, _sums(some, part), pairs, CLEAR * price)
    chi2 = chi2_of(_sums(some, part))
    for a, b in combinations(range(len(chi2)), 2):
        if chi2_of_cubic(some[(part == a) | (part == b)]) <= chi2[a] + chi2[b]:
            return None  # a smooth surface goes on all the same
    if len(chi2) < 2:
        return None
    out = np.full(len(piece), len(chi2))
    out[mine] = part
    return out, np.arange(out.max() + 1) == len(chi2)


def _sums(points: Array, part: Index) -> Array:
    """Sums (parts, SUMS) over the points (m, 4) of every part."""
    sums = np.empty((int(part.max()) + 1, kernels.SUMS))
    kernels.correlate(points, part, np.empty((0, 2), np.intp), sums, np.empty((len(sums), 3)))
    return sums
