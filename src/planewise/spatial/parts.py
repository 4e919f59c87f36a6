"""Parts of a segment: its units as points, and parts of these as segments of their own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import splits as kernels
from planewise.kernels.cells import COUNT, FREE, MISFIT
from planewise.spatial.cells import Cells
from planewise.spatial.segments import Segments, affine_planes

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

CLEAR = 10.0  # times the price: what the misfit of a segment costs, and each part of it saves
_SMALL = 24, 0.02  # units, and share of the segment: fewer may be mixed cells along an edge


def sides_within(cells: Cells, of_unit: NDArray[np.int32], chosen: Bools) -> Index:
    """Units (m, 2) on both sides of all sides of cells within one of the chosen segments."""
    grid, found = cells.grid, []
    number = np.where(chosen[of_unit], of_unit, np.int32(-1))
    segment = np.append(number, np.int32(-1)).take(grid)  # -1 is the last
    for here, there in (
        ((slice(None), slice(-1)), (slice(None), slice(1, None))),
        ((slice(-1),), (slice(1, None),)),
    ):
        same = (segment[here] == segment[there]) & (segment[here] >= 0)
        same &= grid[here] != grid[there]
        found.append(np.column_stack((grid[here][same], grid[there][same])))
    return np.concatenate(found).astype(np.intp)


def points_of_segments(
    cells: Cells, segments: Segments, planes: Array, chosen: Bools, sides: Index
) -> Iterator[tuple[int, Index, Array, Index]]:
    """Every chosen segment with its units (m,), their points (m, 4), and sides (., 2) of these.

    planes (n, 3): of all segments; sides (., 2): of units, those within each chosen one among them.
    """
    place = np.empty(len(cells.rows), np.intp)
    first, second = segments.of_unit[sides].T
    for s in np.flatnonzero(chosen).tolist():
        units = np.flatnonzero(segments.of_unit == s)
        place[units] = np.arange(len(units))
        within = (first == s) & (second == s)
        yield s, units, _points_of(cells.rows[units], planes[s]), place[sides[within]]


def _points_of(rows: Array, plane: Array) -> Array:
    """Points (m, 4) of `kernels.splits`, x and y in roots of their variance about their mean."""
    p = rows[:, 0]
    x, y, w = rows[:, [1, 2, 6]].T / p
    height = w - plane[0] - plane[1] * x - plane[2] * y
    x, y = x - x.mean(), y - y.mean()
    scale = np.sqrt((x * x + y * y).mean())
    return np.column_stack((x / scale, y / scale, height, p))


def is_small(part: Index) -> Bools:
    """Which parts may be mixed cells along an edge."""
    few, share = _SMALL
    return np.asarray(np.bincount(part) < max(few, share * len(part)))


def chi2_of(sums: Array) -> Array:
    """chi^2 (n,) of the planes of sums over points (n, SUMS)."""
    out = np.empty(len(sums))
    kernels.misfits(sums, out)
    return out


def cubic_terms(points: Array) -> Array:
    """Terms of a polynomial of the third degree at points (n, 4), and their heights: (n, 11)."""
    x, y, height, _ = points.T
    xx, xy, yy = x * x, x * y, y * y
    return np.column_stack(
        (np.ones_like(x), x, y, xx, xy, yy, xx * x, xx * y, x * yy, yy * y, height)
    )


def normal_equations(terms: Array, weight: Array) -> Array:
    """Those (11, 11) of the polynomial through points of these `cubic_terms` and weights (n,)."""
    return np.asarray((terms * weight[:, None]).T @ terms)


def best_fit(normal: Array, terms: int = 10) -> tuple[float, Array]:
    """chi^2 of the best polynomial of 3, 6 or 10 terms, and its coefficients."""
    right = normal[:terms, -1]
    fitted = np.asarray(np.linalg.lstsq(normal[:terms, :terms], right, rcond=None)[0], np.float64)
    return float(normal[-1, -1] - right @ fitted), fitted


def polynomial(points: Array, terms: int) -> tuple[float, Array]:
    """`best_fit` to points (n, 4)."""
    return best_fit(normal_equations(cubic_terms(points), points[:, 3]), terms)


def chi2_of_cubic(points: Array) -> float:
    """chi^2 of the best polynomial of the third degree."""
    return polynomial(points, 10)[0]


def side_by_side(part: Index, sides: Index) -> Index:
    """Pairs (n, 2) of parts that share a side of a cell."""
    ends = part[sides]
    return np.unique(np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1), axis=0)


def joined(part: Index, sums: Array, pairs: Index, price: float) -> Index:
    """The same with those of these pairs of parts (n, 2) that are one plane as one part.

    sums (parts, SUMS): of their points; price: nats that a part has to save.
    """
    root, sums = np.arange(len(sums)), sums.copy()
    while len(pairs := np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)):
        first, second = pairs.T
        chi2 = chi2_of(sums)
        lost = 0.5 * (chi2_of(sums[first] + sums[second]) - chi2[first] - chi2[second])
        least = int(lost.argmin())
        if lost[least] > price:
            break
        a, b = pairs[least]
        root[root == b], pairs[pairs == b] = a, a
        sums[a] += sums[b]
    return np.unique(root[part], return_inverse=True)[1]


def divided(
    whole: Segments,
    segment: int,
    part: Index,
    small: Bools,
    cells: Cells,
    least: float,
    *,
    all_pay: bool = True,
) -> Segments | None:
    """With parts of one segment as segments, the first in its place, the others behind all.

    part (m,): of each of its units, small (parts,): those that are no planes. None where one that
    is saves less than `least`; else, if not all have to, that is none, either, and there is no
    division where fewer than two are left.
    """
    units = np.flatnonzero(whole.of_unit == segment)
    parts = _segments_of(part, cells.rows[units], whole, segment)
    rows = parts.rows
    poor = ~small & (rows[:, FREE] - 0.5 * rows[:, MISFIT] <= least)
    if poor.any() if all_pay else np.count_nonzero(~small & ~poor) < 2:
        return None
    rows[small | poor, FREE] = 0.0
    out = whole.divided(parts, np.arange(1, len(rows)), units, cells.rows)
    out.rows[segment] = rows[0]
    return out


def _segments_of(part: Index, units: Array, segments: Segments, segment: int) -> Segments:
    """Parts (m,) of the units of a segment, whose rows are (m, 13), as segments like it."""
    whole = segments.rows[segment]
    like = np.full(part.max() + 1, segment)
    return Segments(
        rows=np.array([_row(units[part == k], whole) for k in range(len(like))]),
        drift=segments.drift[like],
        offset_prior=segments.offset_prior[like],
        slope_prior=segments.slope_prior[like],
        home=segments.home[like],
        of_unit=part.astype(np.int32),
    )


def _row(units: Array, whole: Array) -> Array:
    """Row (13,) of a part, from those of its units (m, 13) and of the segment it is a part of."""
    row = units.sum(axis=0)
    own, plane = affine_planes(units), affine_planes(row[None])[0]
    row[MISFIT] = np.vdot(own, units[:, 6:9]) - plane @ row[6:9]
    row[FREE] = whole[FREE] * row[COUNT] / whole[COUNT]
    return np.asarray(row)
