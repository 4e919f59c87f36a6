"""Segments as points, one a unit, and parts of these as segments of their own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.cells import COUNT, FREE, MISFIT
from planewise.parts import points_of
from planewise.spatial.cells import Cells
from planewise.spatial.segments import Segments, affine_planes

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]


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
    p = rows[:, 0]
    x, y, w = rows[:, [1, 2, 6]].T / p
    return points_of(x, y, w - plane[0] - plane[1] * x - plane[2] * y, p)


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
