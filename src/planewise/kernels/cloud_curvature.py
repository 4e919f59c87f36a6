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
from planewise.kernels.quadrics import (
    FEWEST,
    GOES_ON,
    LEFT,
    NO_EDGE,
    OWN,
    TOLD_U,
    TOLD_V,
    UNTOLD,
    add_height,
    fit_quadric,
)

QUADRIC = 12
K, TILT, OFFSET, BENT = 0, 6, 9, 10  # K: xx, xy, xz, yy, yz, zz; BENT: 1, 0, or -1 where unknown
SIZE = 11  # Frobenius norm of K
_STEEP = 0.5  # least cosine between a segment that tells no quadric and what it may be part of


@in_order
def add_heights(cells, of_cell, rows, sums):  # type: ignore[no-untyped-def]
    """Add cells (m, 18) to the sums (N, HEIGHTS) of their segments, rows (N, 18).

    x and y along the axes of a segment, in roots of its area; z along its normal.
    """
    for cell in range(of_cell.size):
        s = of_cell[cell]
        if rows[s, CELLS] < FEWEST:
            continue
        ex, ey, ez, fx, fy, fz = plane_axes(rows[s, NX], rows[s, NY], rows[s, NZ])
        scale = 1.0 / math.sqrt(rows[s, AREA])
        dx, dy = cells[cell, CX] - rows[s, CX], cells[cell, CY] - rows[s, CY]
        dz = cells[cell, CZ] - rows[s, CZ]
        x, y = scale * (dx * ex + dy * ey + dz * ez), scale * (dx * fx + dy * fy + dz * fz)
        z = dx * rows[s, NX] + dy * rows[s, NY] + dz * rows[s, NZ]
        add_height(sums[s], cells[cell, WEIGHT], x, y, z)


@compiled
def quadrics_of(sums, rows, drift, quadrics):  # type: ignore[no-untyped-def]
    """Fit a quadric to every segment: quadrics (N, QUADRIC), from sums (N, HEIGHTS)."""
    factor, t = np.empty((6, 6)), np.empty(6)
    for s in range(rows.shape[0]):
        for e in range(QUADRIC):
            quadrics[s, e] = 0.0
        quadrics[s, BENT] = UNTOLD
        extent = math.sqrt(rows[s, AREA])
        cells, readings = rows[s, CELLS], rows[s, COUNT]
        bent = fit_quadric(sums[s], cells, 0.0, readings, drift, extent, factor, t)
        if bent < 0.0:
            continue
        ex, ey, ez, fx, fy, fz = plane_axes(rows[s, NX], rows[s, NY], rows[s, NZ])
        scale = 1.0 / extent
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
        out[OFFSET], out[BENT] = t[0], bent
        out[SIZE] = math.sqrt(a * a + 2.0 * b * b + c * c)


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
def borders_of(  # type: ignore[no-untyped-def]
    ends, sides, of_cell, cells, rows, quadrics, edge, border, pairs, points, states
):
    """Find where the surfaces of segments may go on, from pairs of cells side by side.

    ends (m, 2), sides (m,): cells, and the points along their border, which are added to border
    (N,) of either segment, but where neither tells a quadric: that says nothing.
    Writes of each pair of cells whose segments may be one curved surface the segments (., 2),
    points (.) and states (.): GOES_ON if half way between the cells the quadrics, the step from one
    to the other included, turn by at most half the angle of the planes; NO_EDGE if they turn, and
    step, by at most `edge`; TOLD_U, TOLD_V of a segment whose own K makes a fair share of the angle
    of the planes, or is not known.
    Returns how many there are.
    """
    found = 0
    for e in range(sides.size):
        i, j = ends[e, 0], ends[e, 1]
        u, v = of_cell[i], of_cell[j]
        if u == v:
            continue
        cosine = rows[u, NX] * rows[v, NX] + rows[u, NY] * rows[v, NY] + rows[u, NZ] * rows[v, NZ]
        sign = 1.0 if cosine > 0.0 else -1.0
        near = sign * cosine > _STEEP
        if near and quadrics[u, BENT] < 0.0 and quadrics[v, BENT] < 0.0:
            continue
        border[u] += sides[e]
        border[v] += sides[e]
        if quadrics[u, BENT] <= 0.0 and quadrics[v, BENT] <= 0.0:
            continue
        turn = 2.0 - 2.0 * sign * cosine
        extents = math.sqrt(rows[u, AREA]) + math.sqrt(rows[v, AREA])
        least = OWN * math.sqrt(max(turn, 0.0)) / extents
        state = 0
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
        left = dx * dx + dy * dy + dz * dz
        if left + step * step <= LEFT * LEFT * turn:
            state |= GOES_ON
        if left <= edge[0] * edge[0] and abs(step) <= edge[1]:
            state |= NO_EDGE
        pairs[found, 0], pairs[found, 1] = u, v
        points[found], states[found] = sides[e], state
        found += 1
    return found
