"""Loops that find where the units of one segment are two planes, on either side of a line.

A point is x, y, its height over some plane, and the precision of that; sums over points are the
first ten of a row of moments (`kernels.cells`), which tell chi^2 of their plane.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cells import add_reading, own_plane, row_misfits
from planewise.kernels.jit import called, compiled, internal

SUMS = 10
_BINS = 64  # places of a line of one direction
_DIRECTIONS, _FINER = 8, 3  # that are tried, and how often the angle between them is halved then
_STEPS = 8  # of the line towards where its two planes meet


@compiled
def residual_squares(rows, of_unit, planes, out):  # type: ignore[no-untyped-def]
    """Add up how far units lie off the plane of their segment: writes out (n, 2).

    Squares of residuals in standard deviations, and units. rows (m, 13), of_unit (m,): of units;
    planes (n, 3): (t0, t1, t2) of w = t0 + t1 x + t2 y.
    """
    out[:] = 0.0
    for k in range(of_unit.size):
        s, m = of_unit[k], rows[k]
        off = m[6] - planes[s, 0] * m[0] - planes[s, 1] * m[1] - planes[s, 2] * m[2]
        out[s, 0] += off * off / m[0]
        out[s, 1] += 1.0


@internal
def sum_side(points, side, chosen, sums):  # type: ignore[no-untyped-def]
    """Write sums (SUMS,) over the points (n, 4) of one side, True or False; how many these are."""
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = 0.0
    count = 0
    for k in range(side.size):  # without a branch: vector code
        x, y, w, p = points[k, 0], points[k, 1], points[k, 2], points[k, 3]
        p = p if side[k] == chosen else 0.0
        count += side[k] == chosen
        px, py, pw = p * x, p * y, p * w
        s0 += p
        s1 += px
        s2 += py
        s3 += px * x
        s4 += px * y
        s5 += py * y
        s6 += pw
        s7 += pw * x
        s8 += pw * y
        s9 += pw * w
    sums[0], sums[1], sums[2], sums[3], sums[4] = s0, s1, s2, s3, s4
    sums[5], sums[6], sums[7], sums[8], sums[9] = s5, s6, s7, s8, s9
    return count


@called
def _try_lines(points, step, angle, fewest, bins, sides, best):  # type: ignore[no-untyped-def]
    """Try lines at right angles to a direction; every `step` points one counts.

    bins (_BINS, SUMS + 1), sides (2, SUMS + 2, _BINS): room to work in; best (4,): chi^2 of the
    best line so far, and those x cos + y sin = c it is: cos, sin and c.
    """
    cos, sin = math.cos(angle), math.sin(angle)
    left, right = sides[0], sides[1]
    low, high = np.inf, -np.inf
    for k in range(0, points.shape[0], step):
        at = cos * points[k, 0] + sin * points[k, 1]
        low, high = min(low, at), max(high, at)
    scale = _BINS / (high - low) if high > low else 0.0
    bins[:] = 0.0
    for k in range(0, points.shape[0], step):
        x, y, w, p = points[k, 0], points[k, 1], points[k, 2], points[k, 3]
        b = min(int((cos * x + sin * y - low) * scale), _BINS - 1)
        add_reading(bins[b], p, x, y, w)
        bins[b, SUMS] += step
    for e in range(SUMS + 1):
        here = 0.0
        for b in range(_BINS):
            here += bins[b, e]
            left[e, b] = here
        for b in range(_BINS):
            right[e, b] = here - left[e, b]
    for n in range(2):
        row_misfits(sides[n], sides[n, SUMS + 1])
    for b in range(_BINS - 1):
        if min(left[SUMS, b], right[SUMS, b]) >= fewest:
            chi2 = left[SUMS + 1, b] + right[SUMS + 1, b]
            if chi2 < best[0]:
                best[0], best[1], best[2], best[3] = chi2, cos, sin, low + (b + 1) / scale


@compiled
def halve(points, fewest, many, side):  # type: ignore[no-untyped-def]
    """Find the line on either side of which points (n, 4) lie on a plane: writes side (n,), bool.

    The best one that is tried on so many points of all, and then where its two planes meet, as long
    as that is better. Returns whether there is one with `fewest` points, at least, on each side.
    """
    size, best, sums = points.shape[0], np.empty(4), np.empty((3, SUMS))
    bins, sides = np.empty((_BINS, SUMS + 1)), np.empty((2, SUMS + 2, _BINS))
    one, other, both, tried = sums[0], sums[1], sums[2], np.empty(size, np.bool_)
    best[0], best[1], best[2], best[3] = np.inf, 1.0, 0.0, 0.0
    step = (size // many) | 1  # odd: an even one may have a factor in common with rows of cells
    turn = math.pi / _DIRECTIONS
    for k in range(_DIRECTIONS):
        _try_lines(points, step, k * turn, fewest, bins, sides, best)
    for _ in range(_FINER):
        turn *= 0.5
        middle = math.atan2(best[2], best[1])
        _try_lines(points, step, middle - turn, fewest, bins, sides, best)
        _try_lines(points, step, middle + turn, fewest, bins, sides, best)
    if best[0] == np.inf:
        return False
    # side is where d0 + d1 x + d2 y > 0.
    d0, d1, d2, least = -best[3], best[1], best[2], np.inf
    for k in range(size):
        tried[k] = False
    sum_side(points, tried, np.bool_(False), both)
    for trial in range(_STEPS):
        for k in range(size):
            tried[k] = d0 + d1 * points[k, 0] + d2 * points[k, 1] > 0.0
        count = sum_side(points, tried, np.bool_(True), one)
        for e in range(SUMS):
            other[e] = both[e] - one[e]
        ax, ay, aw, a1, a2, _, _, _, first = own_plane(one)
        bx, by, bw, b1, b2, _, _, _, second = own_plane(other)
        chi2 = first + second
        if trial and (min(count, size - count) < fewest or chi2 >= least):
            break
        least = chi2
        for k in range(size):
            side[k] = tried[k]
        d0, d1, d2 = aw - bw - a1 * ax - a2 * ay + b1 * bx + b2 * by, a1 - b1, a2 - b2
        if d1 * (ax - bx) + d2 * (ay - by) < 0.0:  # `one` is where it is larger
            d0, d1, d2 = -d0, -d1, -d2
    return True


@compiled
def correlate(points, part, sides, sums, out):  # type: ignore[no-untyped-def]
    """Sums over the points (n, 4) of every part (n,): writes sums (parts, SUMS) and out (parts, 3).

    out: over pairs of points within it, sides (m, 2), of residuals about its plane in standard
    deviations: the product, the mean square; and of pairs.
    """
    sums[:] = 0.0
    for k in range(part.size):
        x, y, w, p = points[k, 0], points[k, 1], points[k, 2], points[k, 3]
        add_reading(sums[part[k]], p, x, y, w)
    off, planes = np.empty(part.size), np.empty((out.shape[0], 5))
    for j in range(out.shape[0]):
        cx, cy, mean, tx, ty, _, _, _, _ = own_plane(sums[j])
        planes[j, 0], planes[j, 1], planes[j, 2], planes[j, 3], planes[j, 4] = cx, cy, mean, tx, ty
    for k in range(part.size):
        x, y, w, p = points[k, 0], points[k, 1], points[k, 2], points[k, 3]
        t = planes[part[k]]
        off[k] = math.sqrt(p) * (w - t[2] - t[3] * (x - t[0]) - t[4] * (y - t[1]))
    out[:] = 0.0
    for e in range(sides.shape[0]):
        a, b = sides[e, 0], sides[e, 1]
        if part[a] == part[b]:
            out[part[a], 0] += off[a] * off[b]
            out[part[a], 1] += 0.5 * (off[a] * off[a] + off[b] * off[b])
            out[part[a], 2] += 1.0


@compiled
def misfits(sums, out):  # type: ignore[no-untyped-def]
    """chi^2 of the planes of sums over points (n, SUMS): writes out (n,)."""
    for j in range(out.size):
        out[j] = own_plane(sums[j])[8]
