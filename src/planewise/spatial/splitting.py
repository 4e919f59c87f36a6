"""Segments that bend: they are split where several planes meet, and are none if they are round.

Across the edge between walls at 178 degrees a surface is as flat as readings can tell, for as long
as segments are narrow; once these have grown across it, the rest of either wall is joined to them
bit by bit. Then residuals of what should be one plane are no white noise: such a segment is split
along lines until those of all its parts are. A smooth surface would fall into as many parts as
noise lets one see; there a polynomial of the third degree fits two parts side by side better than
two planes do, and the segment stays as it is. If it turns by more than walls bulge, it is no plane,
but a facet of something round, as large as noise lets it be.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import splits as kernels
from planewise.kernels.cells import COUNT, FREE, MISFIT
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells
from planewise.spatial.segments import Segments, affine_planes
from planewise.spatial.units import BENT, residual_correlation

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_CLEAR = 10.0  # times the price: what the misfit of a segment costs, and each part of it saves
_WHITE = 0.1, 2.0  # correlation of residuals side by side, and standard deviations of it by chance
_FEWEST = 12  # units of a part
_MANY = 2000  # of which some can stand for all
_SMALL = 24, 0.02  # units, and share of the segment: fewer may be mixed cells along an edge
_NARROW = 7.0  # units across: strips of rounded edges are as flat as planes ...
_SHARP = 0.5  # ... unless a smooth surface fits worse by so many times the price at their border
_ALL_BUT = 0.95  # of the points of a part: its reach
_MOST = 12  # parts of a segment
_SMOOTH = 0.85, 0.7  # of the misfit of a plane and of two, but for noise: what is round has less
_ROUND = 0.5, 2.0  # radians that it turns by: walls turn by less, and an edge would by more


def split(
    cells: Cells,
    segments: Segments,
    accepted: NDArray[np.bool_],
    sectors: Sectors,
    price: float,
) -> tuple[Segments, NDArray[np.bool_]]:
    """Split those segments of a frame that are several planes, and find those that are round.

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
    ndarray of bool, shape (n,)
        Those that are pieces of something round.
    """
    planes, off = affine_planes(segments.rows), np.empty((len(segments.rows), 2))
    kernels.residual_squares(cells.rows, segments.of_unit, planes, off)
    chi2, count = off.T
    curved = np.zeros(len(accepted), np.bool_)
    doubtful = accepted & (chi2 - count > 2 * price) & (count >= 2 * _SMALL[0])
    if doubtful.any():
        correlation = residual_correlation(cells, segments.of_unit + np.int32(1), planes, sectors)
        doubtful &= correlation > BENT  # not where it is NaN
    if not doubtful.any():
        return segments, curved
    bent, place, out = np.flatnonzero(doubtful), np.empty(len(cells.rows), np.intp), segments
    sides = _sides(cells, segments.of_unit, bent)
    for s in bent.tolist():
        units = np.flatnonzero(segments.of_unit == s)
        place[units] = np.arange(len(units))
        mine = place[sides[segments.of_unit[sides[:, 0]] == s]]
        points = _points(cells.rows[units], planes[s])
        part = _parts(points, mine, price) if chi2[s] - count[s] > 2 * _CLEAR * price else None
        if part is None:
            curved[s] = _is_round(points, cells.rows[units], planes[s], sectors, price)
            continue
        parts = _segments_of(part, cells.rows[units], segments, s)
        rows, small = parts.rows, _is_small(part)
        saved = rows[:, FREE] - 0.5 * rows[:, MISFIT]
        if (saved[~small] > _CLEAR * price).all():
            rows[small, FREE] = 0.0  # mixed cells are no plane
            out = out.divided(parts, np.arange(1, len(rows)), units, cells.rows)
            out.rows[s] = rows[0]
    return out, curved


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
            if kernels.halve(points[mine], _FEWEST, _MANY, side):
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
    if is_bent.any() or np.count_nonzero(large) < 2:
        return None
    return part if _has_edges(points, part, sides, sums, price) else None


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


def _has_edges(points: Array, part: Index, sides: Index, sums: Array, price: float) -> bool:
    """Whether two planes fit any two parts side by side better than a smooth surface does.

    A strip of a rounded edge and the wall beside it are no smooth surface, but are one near where
    they meet.
    """
    chi2, narrow, small = _chi2(sums), _widths(points, sides, sums) < _NARROW, _is_small(part)
    for a, b in _side_by_side(part, sides):
        if small[a] or small[b]:
            continue
        if _chi2_of_cubic(points[(part == a) | (part == b)]) <= chi2[a] + chi2[b]:
            return False
        if narrow[a] or narrow[b]:
            one, other = _about_border(points, part, sides, a, b)
            planes = _polynomial(one, 3)[0] + _polynomial(other, 3)[0]
            if _chi2_of_cubic(np.concatenate((one, other))) - planes <= _SHARP * price:
                return False
    return True


def _about_border(points: Array, part: Index, sides: Index, a: int, b: int) -> tuple[Array, Array]:
    """Points of two parts no farther from the line between them than either part reaches."""
    ends = part[sides]
    across = ((ends == a) | (ends == b)).all(axis=1) & (ends[:, 0] != ends[:, 1])
    border = points[sides[across], :2].mean(axis=1)
    middle = border.mean(axis=0)
    normal = np.linalg.eigh((border - middle).T @ (border - middle))[1][:, 0]
    distance = np.abs((points[:, :2] - middle) @ normal)
    near = distance <= min(np.quantile(distance[part == k], _ALL_BUT) for k in (a, b))
    return points[near & (part == a)], points[near & (part == b)]


def _chi2_of_cubic(points: Array) -> float:
    """chi^2 of the best polynomial of the third degree."""
    return _polynomial(points, 10)[0]


def _polynomial(points: Array, terms: int) -> tuple[float, Array]:
    """chi^2 of the best polynomial of 3, 6 or 10 terms, and its coefficients."""
    x, y, height, p = points.T
    xx, xy, yy = x * x, x * y, y * y
    columns = np.ones_like(x), x, y, xx, xy, yy, xx * x, xx * y, x * yy, yy * y
    table = np.sqrt(p)[:, None] * np.column_stack((*columns[:terms], height))
    normal = table.T @ table
    right = normal[:-1, -1]
    fitted = np.linalg.lstsq(normal[:-1, :-1], right, rcond=None)[0]
    return float(normal[-1, -1] - right @ fitted), fitted


def _is_round(points: Array, units: Array, plane: Array, sectors: Sectors, price: float) -> bool:
    """Whether a bent segment is a smooth surface that turns by more than walls do.

    A smooth surface through two faces of a box would turn by more than what is seen of a sphere.
    """
    flat, smooth = float(np.vdot(points[:, 3], points[:, 2] ** 2)), _chi2_of_cubic(points)
    noise, (of_one, of_two), (least, most) = len(points), _SMOOTH, _ROUND
    if flat - smooth <= max(2 * price, of_one * (flat - noise)):
        return False
    if not least < _turn(points, units, plane, sectors) < most:
        return False
    two = _chi2_of_two(points)
    return two - smooth > of_two * max(two - noise, 0.0)


def _turn(points: Array, units: Array, plane: Array, sectors: Sectors) -> float:
    """Radians that the quadric of a segment turns by from end to end, if it does so evenly."""
    (x, y), (u, v) = points[:, :2].T, (units[:, 1:3] / units[:, :1]).T
    c, scale = _polynomial(points, 6)[1], np.hypot(u.std(), v.std())
    w = plane[0] + plane[1] * u + plane[2] * v
    w += c[0] + c[1] * x + c[2] * y + c[3] * x * x + c[4] * x * y + c[5] * y * y
    along = plane[1] + (c[1] + 2 * c[3] * x + c[4] * y) / scale
    down = plane[2] + (c[2] + c[4] * x + 2 * c[5] * y) / scale
    normals = sectors.turn[0] @ np.stack((w - along * u - down * v, along, down))
    normals /= np.linalg.norm(normals, axis=0)
    # A mean of unit vectors is shorter by half their variance, which is a twelfth of its square.
    return math.sqrt(24 * max(1 - float(np.linalg.norm(normals.mean(axis=1))), 0.0))


def _chi2_of_two(points: Array) -> float:
    """chi^2 of the planes on either side of the best line."""
    side = np.empty(len(points), np.bool_)
    if not kernels.halve(points, _FEWEST, _MANY, side):
        return np.inf
    return _polynomial(points[side], 3)[0] + _polynomial(points[~side], 3)[0]


def _side_by_side(part: Index, sides: Index) -> list[tuple[int, int]]:
    """Pairs of parts that share a side of a cell."""
    ends = part[sides]
    ends = np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1)
    return [(a, b) for a, b in np.unique(ends, axis=0).tolist()]
