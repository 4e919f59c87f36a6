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
from planewise.kernels.cells import COUNT, FREE
from planewise.parts import (
    CLEAR,
    bends,
    chi2_of,
    chi2_of_cubic,
    is_small,
    is_wide,
    joined,
    polynomial,
    side_by_side,
)
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells
from planewise.spatial.dividing import divided, points_of_segments, sides_within
from planewise.spatial.segments import Segments, affine_planes
from planewise.spatial.steps import at_steps
from planewise.spatial.units import BENT, residual_correlation

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Bools = NDArray[np.bool_]

_WHITE = 0.1, 2.0  # correlation of residuals side by side, and standard deviations of it by chance
_FEWEST = 12  # units of a part
_MANY = 2000  # of which some can stand for all
_SHARP = 0.5  # times the price: how much worse a smooth surface fits at the border of two planes
_ALL_BUT = 0.95  # of the points of a part: its reach
_LEFT = 0.1  # most of a segment that may stay bent: cells along edges, with some beside them
_MOST = 64  # parts of a segment, before those of one plane are joined: half a millisecond each
_SMOOTH = 0.85, 0.7  # of the misfit of a plane and of two, but for noise: what is round has less
_ROUND = 0.5, 2.0  # radians that it turns by: walls turn by less, and an edge would by more


def split(
    cells: Cells,
    segments: Segments,
    accepted: Bools,
    sectors: Sectors,
    price: float,
) -> tuple[Segments, Bools]:
    """Split those segments of a frame that are several planes, and find those that are round.

    Parameters
    ----------
    cells : Cells
        Of a frame whose error is all but white.
    segments : Segments
        Of its units.
    accepted : ndarray of bool, shape (n,)
        Those that are planes. Wide ones that are none are divided at steps only: they are too far
        off one plane, or curved, with what stands off them.
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
    chosen = accepted | is_wide(segments.rows[:, COUNT])
    bent, planes, excess = _bends(cells, segments, chosen, sectors, price)
    if not bent.any():
        return segments, bent
    sides = sides_within(cells, segments.of_unit, bent)
    whole = at_steps(cells, segments, planes, bent, sides, price)
    if whole is not segments:  # what bends now is one of those that did, or a part of it
        fewer = whole.rows[: len(accepted), COUNT] < segments.rows[:, COUNT]
        accepted = np.append(accepted | fewer, whole.rows[len(accepted) :, FREE] > 0.0)
        bent, planes, excess = _bends(cells, whole, accepted, sectors, price)
    bent &= accepted
    out, curved = whole, np.zeros(len(whole.rows), np.bool_)
    for s, units, points, mine in points_of_segments(cells, whole, planes, bent, sides):
        found = _parts(points, mine, price) if excess[s] > 2 * CLEAR * price else None
        if found is None:
            curved[s] = _is_round(points, cells.rows[units], planes[s], sectors, price)
        else:
            out = divided(out, s, *found, cells, CLEAR * price) or out
    return out, curved


def _bends(
    cells: Cells,
    segments: Segments,
    chosen: Bools,
    sectors: Sectors,
    price: float,
) -> tuple[Bools, Array, Array]:
    """Which planes among segments have residuals that are no white noise.

    And the planes (n, 3) of all, and what their chi^2 (n,) is more than noise would make it.
    """
    planes, off = affine_planes(segments.rows), np.empty((len(segments.rows), 2))
    kernels.residual_squares(cells.rows, segments.of_unit, planes, off)
    chi2, count = off.T
    excess = chi2 - count
    bent = chosen & bends(excess, count, price)
    if bent.any():
        correlation = residual_correlation(cells, segments.of_unit + np.int32(1), planes, sectors)
        bent &= correlation > BENT  # not where it is NaN
    return bent, planes, excess


def _parts(points: Array, sides: Index, price: float) -> tuple[Index, Bools] | None:
    """Part of every point of a bent segment that is several planes, and which parts are none.

    None if it is not. sides (m, 2): points side by side, each as often as they share a side of a
    cell.
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
    part = joined(part, sums, side_by_side(part, sides), price)
    is_bent, sums = _bent(points, part, sides)
    mixed = is_small(part) | is_bent
    if np.count_nonzero(is_bent[part]) > _LEFT * len(part) or np.count_nonzero(~mixed) < 2:
        return None
    return (part, mixed) if _has_edges(points, part, sides, sums, mixed, price) else None


def _bent(points: Array, part: Index, sides: Index) -> tuple[Bools, Array]:
    """Whether residuals of every part are correlated, as those of small ones may be; its sums."""
    count = int(part.max()) + 1
    sums, out = np.empty((count, kernels.SUMS)), np.empty((count, 3))
    kernels.correlate(points, part, sides, sums, out)
    product, square, pairs = out.T
    share, chance = _WHITE
    limit = share + chance / np.sqrt(np.maximum(pairs, 1.0))
    return (product > limit * square) & ~is_small(part), sums


def _has_edges(
    points: Array, part: Index, sides: Index, sums: Array, mixed: Bools, price: float
) -> bool:
    """Whether two planes fit any two parts side by side better than a smooth surface does.

    A strip of a rounded edge and the wall beside it are no smooth surface, but are one near where
    they meet.
    """
    chi2 = chi2_of(sums)
    for a, b in side_by_side(part, sides).tolist():
        if mixed[a] or mixed[b]:
            continue
        if chi2_of_cubic(points[(part == a) | (part == b)]) <= chi2[a] + chi2[b]:
            return False
        one, other = _about_border(points, part, sides, a, b)
        planes = polynomial(one, 3)[0] + polynomial(other, 3)[0]
        if chi2_of_cubic(np.concatenate((one, other))) - planes <= _SHARP * price:
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


def _is_round(points: Array, units: Array, plane: Array, sectors: Sectors, price: float) -> bool:
    """Whether a bent segment is a smooth surface that turns by more than walls do.

    A smooth surface through two faces of a box would turn by more than what is seen of a sphere.
    """
    flat, smooth = float(np.vdot(points[:, 3], points[:, 2] ** 2)), chi2_of_cubic(points)
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
    c, scale = polynomial(points, 6)[1], np.hypot(u.std(), v.std())
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
    return polynomial(points[side], 3)[0] + polynomial(points[~side], 3)[0]
