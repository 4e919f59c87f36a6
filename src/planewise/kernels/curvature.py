"""Loops over segments of an image: how they bend, and whether they go on across their borders.

The quadric of a segment, w = t . (1, x, y) + c . (1, dx, dy, dx^2, dx dy, dy^2) at d from its
centroid, is fitted to its units: a row (t, centroid, c, extent, size, bent), size the Frobenius
norm of the second derivative; bent: what `kernels.quadrics.fit_quadric` says.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import COUNT, UNIT
from planewise.kernels.jit import compiled, inlined
from planewise.kernels.planes import affine_planes
from planewise.kernels.quadrics import (
    FLAT,
    GOES_ON,
    HEIGHTS,
    LEFT,
    OWN,
    PARTLY,
    TOLD_U,
    TOLD_V,
    UNTOLD,
    add_height,
    fit_quadric,
)

QUADRIC = 14
CENTRE, C, EXTENT, SIZE, BENT = 3, 5, 11, 12, 13


@compiled
def quadrics_of(units, of_unit, rows, drift, chosen, quadrics):  # type: ignore[no-untyped-def]
    """Fit a quadric to every chosen segment: writes quadrics (n, QUADRIC); returns how many bend.

    units (m, 13), of_unit (m,): rows and segments of units; rows (n, 13), drift (n,), chosen (n,):
    of segments.
    """
    count = rows.shape[0]
    sums, cells = np.empty((count, HEIGHTS)), np.empty(count, np.int64)
    planes, factor, t = np.empty((count, 3)), np.empty((6, 6)), np.empty(6)
    affine_planes(rows, planes)
    for s in range(count):
        q, row = quadrics[s], rows[s]
        q[0], q[1], q[2] = planes[s, 0], planes[s, 1], planes[s, 2]
        q[CENTRE], q[CENTRE + 1] = row[1] / row[0], row[2] / row[0]
        for e in range(C, QUADRIC):
            q[e] = 0.0
        q[EXTENT], q[BENT] = np.sqrt(row[COUNT]) / UNIT, UNTOLD
        cells[s] = 0
        for e in range(HEIGHTS):
            sums[s, e] = 0.0
    for k in range(of_unit.size):
        s = of_unit[k]
        if not chosen[s]:
            continue
        row, q = units[k], quadrics[s]
        w, inverse, scale = row[0], 1.0 / row[0], 1.0 / q[EXTENT]
        x, y = row[1] * inverse, row[2] * inverse
        z = row[6] * inverse - q[0] - q[1] * x - q[2] * y
        x, y = scale * (x - q[CENTRE]), scale * (y - q[CENTRE + 1])
        add_height(sums[s], w, x, y, z)
        cells[s] += 1
    bent = 0
    for s in range(count):
        q = quadrics[s]
        if chosen[s]:
            n, square = rows[s, COUNT], 1.0 / max(cells[s], 1)  # in roots of the segment's area
            q[BENT] = fit_quadric(sums[s], cells[s], square, n, drift[s], q[EXTENT], factor, t)
        if q[BENT] == UNTOLD:
            continue
        scale = 1.0 / q[EXTENT]
        q[C], q[C + 1], q[C + 2] = t[0], scale * t[1], scale * t[2]
        for e in range(3, 6):
            q[C + e] = scale * scale * t[e]
        q[SIZE] = np.sqrt(4.0 * q[C + 3] ** 2 + 2.0 * q[C + 4] ** 2 + 4.0 * q[C + 5] ** 2)
        bent += q[BENT] > 0.0
    return bent


@inlined
def _surface(q, x, y):  # type: ignore[no-untyped-def]
    """w of a quadric at a point, and its slopes."""
    dx, dy = x - q[CENTRE], y - q[CENTRE + 1]
    w = q[0] + q[1] * x + q[2] * y + q[C] + q[C + 1] * dx + q[C + 2] * dy
    w += q[C + 3] * dx * dx + q[C + 4] * dx * dy + q[C + 5] * dy * dy
    along = q[1] + q[C + 1] + 2.0 * q[C + 3] * dx + q[C + 4] * dy
    return w, along, q[2] + q[C + 2] + q[C + 4] * dx + 2.0 * q[C + 5] * dy


@compiled
def surface_borders(ends, units, rows, quadrics, slope, border, pairs, points, states):  # type: ignore[no-untyped-def]
    """Find where the surfaces of segments may go on, from the sides of cells between them.

    ends, units (m, 2): segments and units of both cells; rows (., 13) of units; slope: of w, per w,
    of a surface at 45 degrees. Sides where one surface is in front of the other are no borders;
    others are counted in border (n,) of either segment. Writes of each whose segments may be one
    curved surface the segments (., 2), points (.), which are 1, and states (.): GOES_ON if half way
    between the cells the quadrics, the step from one to the other included, turn by at most half of
    what the planes do, or if one is told in part and the other no more; TOLD_U, TOLD_V of a segment
    whose own quadric makes a fair share of that, or is not told. Returns how many there are.
    """
    found = 0
    for e in range(ends.shape[0]):
        u, v = ends[e, 0], ends[e, 1]
        a, b, i, j = quadrics[u], quadrics[v], rows[units[e, 0]], rows[units[e, 1]]
        one, other = 1.0 / i[0], 1.0 / j[0]
        x, y = 0.5 * (i[1] * one + j[1] * other), 0.5 * (i[2] * one + j[2] * other)
        dx, dy = i[1] * one - j[1] * other, i[2] * one - j[2] * other
        d1, d2 = a[1] - b[1], a[2] - b[2]
        level = slope * (a[0] + a[1] * x + a[2] * y)
        step = abs(a[0] - b[0] + d1 * x + d2 * y)
        if not step * step <= level * level * (dx * dx + dy * dy):
            continue
        border[u] += 1.0
        border[v] += 1.0
        told = max(a[BENT], b[BENT])
        if told in (FLAT, UNTOLD):
            continue
        turn, extents = d1 * d1 + d2 * d2, a[EXTENT] + b[EXTENT]
        least, near = OWN * np.sqrt(turn) / extents, turn <= level * level
        state = 0
        if near if a[BENT] < 0.0 else a[SIZE] >= least:
            state |= TOLD_U
        if near if b[BENT] < 0.0 else b[SIZE] >= least:
            state |= TOLD_V
        if state == 0:
            continue
        over, ux, uy = _surface(a, x, y)
        under, vx, vy = _surface(b, x, y)
        jump = 2.0 * (over - under) / extents
        left = (ux - vx) ** 2 + (uy - vy) ** 2 + jump * jump
        if told == PARTLY or left <= LEFT * LEFT * turn:
            state |= GOES_ON
        pairs[found, 0], pairs[found, 1] = u, v
        points[found], states[found] = 1.0, state
        found += 1
    return found
