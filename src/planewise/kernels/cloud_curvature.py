"""Loops over segments of a cloud: how they bend, and whether they go on across their borders.

The quadric of a segment is a height over its plane, z = offset + tilt . d + d' K d / 2 at d from
its centroid, fitted to the centroids of its cells: K, 3 x 3, is zero along the normal.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cloud_rows import (
    AREA,
    CELLS,
    COUNT,
    CX,
    CY,
    CZ,
    NX,
    NY,
    NZ,
    WEIGHT,
    plane_axes,
)
from planewise.kernels.jit import compiled, in_order, internal

HEIGHTS = 22  # sums over the cells of a segment: of x^i y^j to the fourth order; of z; of z^2
OF_Z, OF_ZZ = 15, 21  # where those of z x^i y^j, to the second order, and of z^2 begin
QUADRIC = 12
K, TILT, OFFSET, BENT = 0, 6, 9, 10  # K: xx, xy, xz, yy, yz, zz; BENT: 1, 0, or -1 where unknown
SIZE = 11  # Frobenius norm of K
GOES_ON, TOLD_U, TOLD_V = 1, 2, 4  # of a pair of segments

_FEWEST = 7  # cells that tell a quadric, which has six parameters
_POWERS = np.array([[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]])
_SINGULAR = 1e-9  # of a diagonal element: a smaller pivot is zero
_MODE = 1.0 / 80.0  # D L: what a random walk on a square of side L has in each mode of K
_REST = 6.0  # times as much that it has about the quadric
_LEFT = 0.5  # of the turn between two planes: what quadrics that go on leave of it, at most
_OWN = 0.5  # of the turn: what a segment's own K has to make of it over both extents
_STEEP = 0.5  # least cosine between a segment that tells no quadric and what it may be part of


@in_order
def add_heights(cells, of_cell, rows, sums):  # type: ignore[no-untyped-def]
    """Add cells (m, 18) to the sums (N, HEIGHTS) of their segments, rows (N, 18).

    x and y along the axes of a segment, in roots of its area; z along its normal.
    """
    for cell in range(of_cell.size):
        s = of_cell[cell]
        if rows[s, CELLS] < _FEWEST:
            continue
        ex, ey, ez, fx, fy, fz = plane_axes(rows[s, NX], rows[s, NY], rows[s, NZ])
        scale = 1.0 / math.sqrt(rows[s, AREA])
        dx, dy = cells[cell, CX] - rows[s, CX], cells[cell, CY] - rows[s, CY]
        dz = cells[cell, CZ] - rows[s, CZ]
        x, y = scale * (dx * ex + dy * ey + dz * ez), scale * (dx * fx + dy * fy + dz * fz)
        z = dx * rows[s, NX] + dy * rows[s, NY] + dz * rows[s, NZ]
        w = cells[cell, WEIGHT]
        xx, xy, yy, wz = x * x, x * y, y * y, w * z
        out = sums[s]
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


@compiled
def quadrics_of(sums, rows, drift, quadrics):  # type: ignore[no-untyped-def]
    """Fit a quadric to every segment: quadrics (N, QUADRIC), from sums (N, HEIGHTS).

    A segment is bent if the three parameters of K save more than their 3/2 ln n nats; a random walk
    makes K as large as `drift` says, or what is left about the quadric, whichever is less.
    """
    factor, t = np.empty((6, 6)), np.empty(6)
    for s in range(rows.shape[0]):
        for e in range(QUADRIC):
            quadrics[s, e] = 0.0
        quadrics[s, BENT] = -1.0
        if rows[s, CELLS] < _FEWEST or not _solve(sums[s], factor, t):
            continue
        told, rest = 0.0, sums[s, OF_ZZ]
        for e in range(6):
            told += t[e] * t[e] if e > 2 else 0.0
            rest -= t[e] * t[e]
        walk = _MODE * drift * math.sqrt(rows[s, AREA]) * sums[s, 0]
        walk = min(walk, max(rest - (rows[s, CELLS] - 6.0), 0.0) / _REST)
        bent = 0.5 * told / (1.0 + walk) > 1.5 * math.log(rows[s, COUNT])
        for e in range(5, -1, -1):
            for g in range(e + 1, 6):
                t[e] -= factor[g, e] * t[g]
            t[e] /= factor[e, e]
        ex, ey, ez, fx, fy, fz = plane_axes(rows[s, NX], rows[s, NY], rows[s, NZ])
        scale = 1.0 / math.sqrt(rows[s, AREA])
        a, b, c = 2.0 * t[3] * scale * scale, t[4] * scale * scale, 2.0 * t[5] * scale * scale
        u, v = t[1] * scale, t[2] * scale
        out = quadrics[s]
        out[0] = a * ex * ex + 2.0 * b * ex * fx + c * fx * fx
        out[1] = a * ex * ey + b * (ex * fy + ey * fx) + c * fx * fy
        out[2] = a * ex * ez + b * (ex * fz + ez * fx) + c * fx * fz
        out[3] = a * ey * ey + 2.0 * b * ey * fy + c * fy * fy
        out[4] = a * ey * ez + b * (ey * fz + ez * fy) + c * fy * fz
        out[5] = a * ez * ez + 2.0 * b * ez * fz + c * fz * fz
        out[6], out[7], out[8] = u * ex + v * fx, u * ey + v * fy, u * ez + v * fz
        out[OFFSET], out[BENT] = t[0], 1.0 if bent else 0.0
        out[SIZE] = math.sqrt(a * a + 2.0 * b * b + c * c)


@internal
def _solve(sums, factor, t):  # type: ignore[no-untyped-def]
    """Cholesky factor L of the normal matrix of 1, x, y, x^2, x y, y^2, and L^-1 of its right side.

    t^2 is what each of the six saves after those before. Returns whether all are told.
    """
    for i in range(6):
        for j in range(i + 1):
            p, q = _POWERS[i, 0] + _POWERS[j, 0], _POWERS[i, 1] + _POWERS[j, 1]
            total = sums[(p + q) * (p + q + 1) // 2 + q]
            least = _SINGULAR * total
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = total / factor[j, j]
            elif not total > least:
                return False
            else:
                factor[i, i] = math.sqrt(total)
        total = sums[OF_Z + i]
        for k in range(i):
            total -= factor[i, k] * t[k]
        t[i] = total / factor[i, i]
    return True


@internal
def _surface(rows, quadrics, s, x, y, z):  # type: ignore[no-untyped-def]
    """Normal of the quadric of a segment near a point, and the height of the point over it."""
    dx, dy, dz = x - rows[s, CX], y - rows[s, CY], z - rows[s, CZ]
    q = quadrics[s]
    kx = q[0] * dx + q[1] * dy + q[2] * dz
    ky = q[1] * dx + q[3] * dy + q[4] * dz
    kz = q[2] * dx + q[4] * dy + q[5] * dz
    nx, ny, nz = rows[s, NX], rows[s, NY], rows[s, NZ]
    height = (nx - q[6] - 0.5 * kx) * dx + (ny - q[7] - 0.5 * ky) * dy + (nz - q[8] - 0.5 * kz) * dz
    return nx - q[6] - kx, ny - q[7] - ky, nz - q[8] - kz, height - q[OFFSET]


@in_order
def borders_of(ends, sides, of_cell, cells, rows, quadrics, border, pairs, points, states):  # type: ignore[no-untyped-def]
    """Find where the surfaces of segments may go on, from pairs of cells side by side.

    ends (m, 2), sides (m,): cells, and the points along their border, which are added to border
    (N,) of either segment. Writes of each pair of cells whose segments may be one curved surface
    the segments (., 2), points (.) and states (.): GOES_ON if half way between the cells the
    quadrics, the step from one to the other included, turn by at most half the angle of the planes;
    TOLD_U, TOLD_V of a segment whose own K makes a fair share of that angle, or is not known.
    Returns how many there are.
    """
    found = 0
    for e in range(sides.size):
        i, j = ends[e, 0], ends[e, 1]
        u, v = of_cell[i], of_cell[j]
        if u == v:
            continue
        border[u] += sides[e]
        border[v] += sides[e]
        if quadrics[u, BENT] <= 0.0 and quadrics[v, BENT] <= 0.0:
            continue
        cosine = rows[u, NX] * rows[v, NX] + rows[u, NY] * rows[v, NY] + rows[u, NZ] * rows[v, NZ]
        sign = 1.0 if cosine > 0.0 else -1.0
        turn = 2.0 - 2.0 * sign * cosine
        extents = math.sqrt(rows[u, AREA]) + math.sqrt(rows[v, AREA])
        least = _OWN * math.sqrt(max(turn, 0.0)) / extents
        state = 0
        near = sign * cosine > _STEEP
        if quadrics[u, SIZE] >= least or (quadrics[u, BENT] < 0.0 and near):
            state |= TOLD_U
        if quadrics[v, SIZE] >= least or (quadrics[v, BENT] < 0.0 and near):
            state |= TOLD_V
        if state == 0:
            continue
        x = 0.5 * (cells[i, CX] + cells[j, CX])
        y = 0.5 * (cells[i, CY] + cells[j, CY])
        z = 0.5 * (cells[i, CZ] + cells[j, CZ])
        ux, uy, uz, over = _surface(rows, quadrics, u, x, y, z)
        vx, vy, vz, under = _surface(rows, quadrics, v, x, y, z)
        dx, dy, dz = sign * vx - ux, sign * vy - uy, sign * vz - uz
        step = 2.0 * (sign * under - over) / extents
        if dx * dx + dy * dy + dz * dz + step * step <= _LEFT * _LEFT * turn:
            state |= GOES_ON
        pairs[found, 0], pairs[found, 1] = u, v
        points[found], states[found] = sides[e], state
        found += 1
    return found


@in_order
def spread(border, pairs, points, states, curved):  # type: ignore[no-untyped-def]
    """Find the segments whose surface goes on across most of their border.

    border (N,); pairs (m, 2), points (m,), states (m,): of `borders_of`. Besides where it goes on a
    border counts where the neighbour is curved: so what lies among pieces of a curved surface is
    one of them. Writes curved (N,).
    """
    across = np.zeros(border.size)
    curved[:] = False
    more = True
    while more:
        across[:] = 0.0
        for e in range(points.size):
            u, v, on = pairs[e, 0], pairs[e, 1], states[e] & GOES_ON != 0
            if states[e] & TOLD_U != 0 and (on or curved[v]):
                across[u] += points[e]
            if states[e] & TOLD_V != 0 and (on or curved[u]):
                across[v] += points[e]
        more = False
        for s in range(border.size):
            if not curved[s] and 2.0 * across[s] > border[s]:
                curved[s] = more = True
