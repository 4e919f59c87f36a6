"""Segments that are broken by steps: what stands off a plane by a step all along its border.

Surfaces lean (`planewise.flatness`): the discord of a wide segment with what stands a little off it
stops to grow with both, and their border does not cost enough to keep them apart. But units on its
two sides are in clear discord wherever they meet, or lie on, above or below the smooth surface that
most of the segment is on: no surface goes on there, of whatever shape the border is. Units across
it, which are on both, are on neither plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.components import components
from planewise.kernels import splits as kernels
from planewise.kernels.cells import COUNT
from planewise.spatial.cells import Cells
from planewise.spatial.parts import (
    CLEAR,
    best_fit,
    chi2_of,
    cubic_terms,
    divided,
    joined,
    normal_equations,
    points_of_segments,
    side_by_side,
)
from planewise.spatial.segments import Segments, affine_planes

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Bools = NDArray[np.bool_]

_BROKEN = 11.34  # discord of units side by side, or with a surface: chi^2 of three, 99 %
_CLEAR = 2 * _BROKEN  # discord at least, of a unit across a step with what is on one side of it
_STEP = 5.0  # mean discord along a step, at least; where there is none it is 3
_MIXED = 1.5  # times as uncertain as the unit beside it, for as many readings: across a step
_LEFT = 0.25  # most of a segment that may be units across steps
_FEWEST = 12  # units of a part; what has none inside it is a row of them along a step
_MOST = 64  # parts that are looked at, the largest
_SETTLED = 10  # steps in which the surface of most is found


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
        piece = _pieces(_level(points), _discords(cells.rows[units], mine), mine)
        if (found := _parts(points, piece, mine, price)) is not None:
            out = divided(out, s, *found, cells, price, all_pay=False) or out
    return out


def _pieces(level: Index, discord: Array, sides: Index) -> Index:
    """Pieces (m,) of units on levels (m,) that hang together by sides (., 2) no step breaks.

    A level ends in a step if units beside each other are in discord all along its border, and not
    where a surface bends.
    """
    goes_on, apart = discord <= _BROKEN, level[sides[:, 0]] != level[sides[:, 1]]
    piece = components(len(level), sides[goes_on & ~apart])
    border = np.unique(np.sort(piece[sides[apart]], axis=1), axis=0, return_inverse=True)[1]
    mean = np.bincount(border, discord[apart]) / np.maximum(np.bincount(border), 1)
    goes_on[apart] &= mean[border] <= _STEP
    return np.unique(components(len(level), sides[goes_on]), return_inverse=True)[1]


def _level(points: Array) -> Index:
    """Where points (n, 4) lie by the smooth surface of most: -1 below it, 1 above it, 0 on it."""
    terms, p = cubic_terms(points), points[:, 3]
    weight = p
    for _ in range(_SETTLED):
        _, surface = best_fit(normal_equations(terms, weight))
        off = np.sqrt(p) * (terms[:, -1] - terms[:, :-1] @ surface)
        # The weights of Geman and McClure, for as much as the middle half is off.
        usual = max(1.0, float(np.median(np.abs(off))) / 0.6745)
        weight = p / (1 + (off / usual) ** 2) ** 2
    return np.where(off * off > _BROKEN * usual * usual, np.sign(off), 0.0).astype(np.intp)


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
    return np.asarray(np.where(mixed, np.maximum(discord, _CLEAR), discord))


def _parts(points: Array, piece: Index, sides: Index, price: float) -> tuple[Index, Bools] | None:
    """Part of every point (m, 4) of a segment in pieces (m,), and which are units across steps.

    None if it is one part. sides (., 2): points side by side.
    """
    inside = np.ones(len(piece), np.bool_)
    inside[sides[piece[sides[:, 0]] != piece[sides[:, 1]]]] = False
    size = np.bincount(piece)
    size[(size < _FEWEST) | (np.bincount(piece, inside) == 0)] = 0
    widest_first = np.argsort(-size, kind="stable")
    size[widest_first[_MOST:]] = 0
    mine = size[piece] > 0
    if np.count_nonzero(size) < 2 or np.count_nonzero(~mine) > _LEFT * len(piece):
        return None
    some, part = points[mine], np.argsort(widest_first, kind="stable")[piece[mine]]
    pairs = np.stack(np.triu_indices(part.max() + 1, 1), axis=1)
    part = joined(part, _sums(some, part), pairs, CLEAR * price)
    chi2 = chi2_of(_sums(some, part))
    across = len(chi2)
    out = np.full(len(piece), across)
    out[mine] = part
    terms, p = cubic_terms(some), some[:, 3]
    cubic = [normal_equations(terms[part == k], p[part == k]) for k in range(across)]
    for a, b in side_by_side(_with_steps(out, across, sides), sides).tolist():
        if b < across and best_fit(cubic[a] + cubic[b])[0] <= chi2[a] + chi2[b]:
            return None  # a smooth surface goes on all the same
    return (out, np.arange(out.max() + 1) == across) if across > 1 else None


def _with_steps(part: Index, across: int, sides: Index) -> Index:
    """Parts (m,) with those units across steps that are next to one, or next to such."""
    out, both = part.copy(), np.concatenate((sides, sides[:, ::-1]))
    for _ in range(2):
        here, there = both[(out[both[:, 0]] == across) & (out[both[:, 1]] != across)].T
        out[here] = out[there]
    return out


def _sums(points: Array, part: Index) -> Array:
    """Sums (parts, SUMS) over the points (m, 4) of every part."""
    sums = np.empty((int(part.max()) + 1, kernels.SUMS))
    kernels.correlate(points, part, np.empty((0, 2), np.intp), sums, np.empty((len(sums), 3)))
    return sums
