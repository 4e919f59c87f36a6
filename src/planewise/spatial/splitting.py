"""Segments that are several planes: they are split where these meet.

Across the edge between walls at 178 degrees a surface is as flat as readings can tell, for as long
as segments are narrow; once these have grown across it, the rest of either wall is joined to them
bit by bit. Then residuals of what should be one plane are no white noise: such a segment is split
along lines until those of all its parts are. A smooth surface would fall into as many parts as
noise lets one see; there a polynomial of the third degree fits two parts side by side better than
two planes do, and the segment stays as it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import splits as kernels
from planewise.kernels.cells import COUNT, FREE, MISFIT
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells
from planewise.spatial.labels import affine_planes, residual_correlation
from planewise.spatial.segments import Segments

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_CLEAR = 10.0  # times the price: what the misfit of a segment costs, and each part of it saves
_CORRELATED = 0.5  # residuals side by side of a segment that may be several planes
_WHITE = 0.1, 2.0  # correlation of residuals side by side, and standard deviations of it by chance
_FEWEST = 12  # units of a part
_SMALL = 24, 0.02  # units, and share of the segment: fewer may be mixed cells along an edge
_NARROW = 7.0  # units across: strips of rounded edges are as flat as planes
_MOST = 12  # parts of a segment


def split(
    cells: Cells,
    segments: Segments,
    accepted: NDArray[np.bool_],
    sectors: Sectors,
    price: float,
) -> Segments:
    """Split those segments of a frame that are several planes.

    Parameters
    ----------
    cells : Cells
        Of a frame whose error is all but white.
    segments : Segments
        Of its units.
    accepted : ndarray of bool, shape (n,)
        Those that are planes.
    sectors : Sectors
        Of the frame; one.
    price : float
        Nats that a part has to save to be a plane of its own.

    Returns
    -------
    Segments
        The same where none is; else with the parts of each, the first of them in its place.
    """
    planes, off = affine_planes(segments.rows), np.empty((len(segments.rows), 2))
    kernels.residual_squares(cells.rows, segments.of_unit, planes, off)
    chi2, count = off.T
    doubtful = accepted & (chi2 - count > 2 * _CLEAR * price) & (count >= 2 * _SMALL[0])
    if doubtful.any():
        correlation = residual_correlation(cells, segments.of_unit + np.int32(1), planes, sectors)
        doubtful &= correlation > _CORRELATED  # not where it is NaN
    if not doubtful.any():
        return segments
    bent, place, out = np.flatnonzero(doubtful), np.empty(len(cells.rows), np.intp), segments
    sides = _sides(cells, segments.of_unit, bent)
    for s in bent.tolist():
        units = np.flatnonzero(segments.of_unit == s)
        place[units] = np.arange(len(units))
        mine = place[sides[segments.of_unit[sides[:, 0]] == s]]
        part = _parts(_points(cells.rows[units], planes[s]), mine, price)
        if part is not None:
            parts = _segments_of(part, cells.rows[units], segments, s)
            rows, small = parts.rows, _is_small(part)
            saved = rows[:, FREE] - 0.5 * rows[:, MISFIT]
            if (saved[~small] > _CLEAR * price).all():
                rows[small, FREE] = 0.0  # mixed cells are no plane
                out = out.divided(parts, np.arange(1, len(rows)), units, cells.rows)
                out.rows[s] = rows[0]
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


def _sides(cells: Cells, of_unit: NDArray[np.int32], chosen: Index) -> Index:
    """Units (m, 2) on both sides of all sides of cells within one of these segments."""
    grid, found = cells.grid, []
    number = np.where(np.isin(of_unit, chosen), of_unit, np.int32(-1))
    segment = np.append(number, np.int32(-1)).take(grid)  # -1 is the last
    for here, there in (
        ((slice(None), slice(-1)), (slice(None), slice(1, None))),
        ((slice(-1),), (slice(1, None),)),
    ):
        same = (segment[here] == segment[there]) & (segment[here] >= 0)
        same &= grid[here] != grid[there]
        found.append(np.column_stack((grid[here][same], grid[there][same])))
    return np.concatenate(found).astype(np.intp)


def _points(rows: Array, plane: Array) -> Array:
    """Points (m, 4) of `kernels.splits`, x and y in roots of their variance about their mean."""
    p = rows[:, 0]
    x, y, w = rows[:, [1, 2, 6]].T / p
    height = w - plane[0] - plane[1] * x - plane[2] * y
    x, y = x - x.mean(), y - y.mean()
    scale = np.sqrt((x * x + y * y).mean())
    return np.column_stack((x / scale, y / scale, height, p))


def _parts(points: Array, sides: Index, price: float) -> Index | None:
    """Part of every point of a bent segment that is several planes; None if it is not.

    sides (m, 2): points side by side, each as often as they share a side of a cell.
    """
    part, count, bent = np.zeros(len(points), np.intp), 1, [0]
    while bent:
        fresh = []
        for k in bent:
            mine = np.flatnonzero(part == k)
            side = np.empty(len(mine), np.bool_)
            if kernels.halve(points[mine], _FEWEST, side):
                part[mine[side]] = count
                fresh += [k, count]
                count += 1
        if count > _MOST:
            return None
        is_bent, sums = _bent(points, part, sides)
        bent = [k for k in fresh if is_bent[k]]
    part = _joined(part, sums, sides, price)
    is_bent, sums = _bent(points, part, sides)
    large = ~_is_small(part)
    if (
        is_bent.any()
        or np.count_nonzero(large) < 2
        or _widths(points, sides, sums)[large].min() < _NARROW
    ):
        return None
    return part if _has_edges(points, part, sides, sums) else None


def _is_small(part: Index) -> NDArray[np.bool_]:
    """Which parts may be mixed cells along an edge."""
    few, share = _SMALL
    return np.asarray(np.bincount(part) < max(few, share * len(part)))


def _bent(points: Array, part: Index, sides: Index) -> tuple[NDArray[np.bool_], Array]:
    """Whether residuals of every part are correlated, as those of small ones may be; its sums."""
    count = int(part.max()) + 1
    sums, out = np.empty((count, kernels.SUMS)), np.empty((count, 3))
    kernels.correlate(points, part, sides, sums, out)
    product, square, pairs = out.T
    share, chance = _WHITE
    limit = share + chance / np.sqrt(np.maximum(pairs, 1.0))
    return (product > limit * square) & ~_is_small(part), sums


def _joined(part: Index, sums: Array, sides: Index, price: float) -> Index:
    """The same with parts side by side that are one plane as one part; sums: of their points."""
    part, sums = part.copy(), sums.copy()
    while pairs := _side_by_side(part, sides):
        first, second = np.array(pairs).T
        chi2 = _chi2(sums)
        lost = 0.5 * (_chi2(sums[first] + sums[second]) - chi2[first] - chi2[second])
        least = int(lost.argmin())
        if lost[least] > price:
            break
        a, b = pairs[least]
        part[part == b] = a
        sums[a] += sums[b]
    return np.unique(part, return_inverse=True)[1]


def _chi2(sums: Array) -> Array:
    """chi^2 (n,) of the planes of sums over points (n, SUMS)."""
    out = np.empty(len(sums))
    kernels.misfits(sums, out)
    return out


def _widths(points: Array, sides: Index, sums: Array) -> Array:
    """Units that every part is wide across its narrow direction, as if it were a rectangle."""
    a, b = points[sides[:, 0]], points[sides[:, 1]]
    apart = np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1]).mean()
    x, y, xx, xy, yy = sums[:, 1:6].T / sums[:, 0]
    xx, xy, yy = xx - x * x, xy - x * y, yy - y * y
    narrow = 0.5 * (xx + yy - np.hypot(xx - yy, 2 * xy))
    return np.asarray(np.sqrt(12 * np.maximum(narrow, 0)) / apart)


def _has_edges(points: Array, part: Index, sides: Index, sums: Array) -> bool:
    """Whether two planes fit any two parts side by side better than a smooth surface does."""
    large, chi2 = ~_is_small(part), _chi2(sums)
    return all(
        _chi2_of_cubic(points[(part == a) | (part == b)]) > chi2[a] + chi2[b]
        for a, b in _side_by_side(part, sides)
        if large[a] and large[b]
    )


def _chi2_of_cubic(points: Array) -> float:
    """chi^2 of the best polynomial of the third degree."""
    x, y, height, p = points.T
    xx, xy, yy = x * x, x * y, y * y
    columns = np.ones_like(x), x, y, xx, xy, yy, xx * x, xx * y, x * yy, yy * y, height
    table = np.sqrt(p)[:, None] * np.column_stack(columns)
    normal = table.T @ table
    right = normal[:-1, -1]
    return float(normal[-1, -1] - right @ np.linalg.lstsq(normal[:-1, :-1], right, rcond=None)[0])


def _side_by_side(part: Index, sides: Index) -> list[tuple[int, int]]:
    """Pairs of parts that share a side of a cell."""
    ends = part[sides]
    ends = np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1)
    return [(a, b) for a, b in np.unique(ends, axis=0).tolist()]
