"""Loops that tell how segments bend, of clouds and of images alike.

The quadric of a segment is a height over its plane, z = t . (1, x, y, x^2, x y, y^2), x and y in
roots of its area about its centroid, fitted to its cells.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.jit import in_order, inlined, internal

HEIGHTS = 22  # sums over the cells of a segment: of x^i y^j to the fourth order; of z; of z^2
OF_Z, OF_ZZ = 15, 21  # where those of z x^i y^j, to the second order, and of z^2 begin
FEWEST = 7  # cells that tell a quadric, which has six parameters
BENDS, FLAT, PARTLY, UNTOLD = 1.0, 0.0, -0.5, -1.0  # what `fit_quadric` says of a segment
GOES_ON, TOLD_U, TOLD_V = 1, 2, 4  # of a pair of segments
SURE = 8  # it goes on as far as what is bent tells
NO_EDGE = 16  # it turns by less than people see an edge by
LEFT = 0.5  # of the turn between two planes: what quadrics that go on leave of it, at most
OWN = 0.5  # of the turn: what a segment's own K has to make of it over both extents

_AMONG = 0.25  # of the whole border of a segment, beside others of a curved surface
_POWERS = np.array([[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]])
_SINGULAR = 1e-9  # of a diagonal element: a smaller pivot is zero
_NARROW = 0.1  # of a squared width of cells: x spreads by 1/4 in two columns, and x^2 by nothing
_MODE = 1.0 / 80.0  # D L: what a random walk on a square of side L has in each mode of K
_REST = 6.0  # times as much that it has about the quadric


@inlined
def add_height(out, w, x, y, z):  # type: ignore[no-untyped-def]
    """Add a cell of weight w to the sums (HEIGHTS,) of its segment."""
    xx, xy, yy, wz = x * x, x * y, y * y, w * z
    out[0] += w
    out[1] += w * x
    out[2] += w * y
    out[3] += w * xx
    out[4] += w * xy
    out[5] += w * yy
    out[6] += w * xx * x
    out[7] += w * xx * y
    out[8] += w * yy * x
    out[9] += w * yy * y
    out[10] += w * xx * xx
    out[11] += w * xx * xy
    out[12] += w * xx * yy
    out[13] += w * xy * yy
    out[14] += w * yy * yy
    out[15] += wz
    out[16] += wz * x
    out[17] += wz * y
    out[18] += wz * xx
    out[19] += wz * xy
    out[20] += wz * yy
    out[21] += wz * z


@internal
def fit_quadric(sums, cells, square, readings, drift, extent, factor, t):  # type: ignore[no-untyped-def]
    """Fit a quadric to a segment of so many cells and readings: writes t; factor is work space.

    square: squared width of a cell, 0 where they are not side by side in rows. Returns UNTOLD if
    its cells are too few, or PARTLY so if they do not tell all of it; what is not told is 0. Else
    whether it BENDS or is FLAT: the three parameters K of second order save more than their
    3/2 ln n nats; a random walk makes K as large as `drift` says, or what is left about the
    quadric, whichever is less.
    """
    if cells < FEWEST:
        return UNTOLD
    left = _solve(sums, square, factor, t)
    told, rest = 0.0, sums[OF_ZZ]
    for e in range(6):
        told += t[e] * t[e] if e > 2 else 0.0
        rest -= t[e] * t[e]
    walk = _MODE * drift * extent * sums[0]
    walk = min(walk, max(rest - (cells - 6.0), 0.0) / _REST)
    for e in range(5, -1, -1):
        for g in range(e + 1, 6):
            t[e] -= factor[g, e] * t[g]
        t[e] /= factor[e, e]
    if left:
        return PARTLY
    return BENDS if 0.5 * told / (1.0 + walk) > 1.5 * math.log(readings) else FLAT


@internal
def _solve(sums, square, factor, t):  # type: ignore[no-untyped-def]
    """Cholesky factor L of the normal matrix of 1, x, y, x^2, x y, y^2, and L^-1 of its right side.

    t^2 is what each of the six saves after those before, 0 if it is left out, for it varies next to
    nothing from cell to cell. Returns whether any of them is.
    """
    left = False
    for i in range(6):
        narrow = _NARROW * sums[0] * (1.0 if i == 0 else square if i < 3 else square * square)
        for j in range(i + 1):
            p, q = _POWERS[i, 0] + _POWERS[j, 0], _POWERS[i, 1] + _POWERS[j, 1]
            total = sums[(p + q) * (p + q + 1) // 2 + q]
            least = max(_SINGULAR * total, narrow)
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = total / factor[j, j]
            elif total > least:
                factor[i, i] = math.sqrt(total)
            else:
                factor[i, i] = math.inf
                left = True
        total = sums[OF_Z + i]
        for k in range(i):
            total -= factor[i, k] * t[k]
        t[i] = total / factor[i, i]
    return left


@in_order
def spread(border, whole, pairs, points, states, curved):  # type: ignore[no-untyped-def]
    """Find the segments whose surface goes on across most of their border.

    border, whole (N,): where segments meet others, and all of it; pairs (m, 2), points (m,), states
    (m,): of `borders_of`. What lies among pieces of a curved surface is one of them: where the
    neighbour is curved a border counts as if the surface went on, if it is enough of the whole.
    Writes curved (N,).
    """
    across, more = np.empty((2, border.size)), True  # where it goes on, and beside curved ones, too
    for s in range(border.size):
        curved[s] = False
    while more:
        for s in range(border.size):
            across[0, s] = across[1, s] = 0.0
        for e in range(points.size):
            u, v, on = pairs[e, 0], pairs[e, 1], states[e] & GOES_ON != 0
            if states[e] & TOLD_U != 0:
                across[0, u] += points[e] if on else 0.0
                across[1, u] += points[e] if on or curved[v] else 0.0
            if states[e] & TOLD_V != 0:
                across[0, v] += points[e] if on else 0.0
                across[1, v] += points[e] if on or curved[u] else 0.0
        more = False
        for s in range(border.size):
            among = 2.0 * across[1, s] > border[s] and across[1, s] > _AMONG * whole[s]
            if not curved[s] and (2.0 * across[0, s] > border[s] or among):
                curved[s] = more = True
