"""Loops over segments of an image: how they bend, and whether they go on across their borders.

The quadric of a segment, w = t . (1, x, y) + c . (1, dx, dy, dx^2, dx dy, dy^2) at d from its
centroid, is fitted to its units: a row (t, centroid, c, extent, size, bent), size the Frobenius
norm of the second derivative; bent: what `kernels.quadrics.fit_quadric` says.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import COUNT, SIDE, UNIT, own_plane
from planewise.kernels.jit import compiled, inlined
from planewise.kernels.pairs import first_of_pairs
from planewise.kernels.planes import affine_planes
from planewise.kernels.quadrics import (
    FLAT,
    GOES_ON,
    HEIGHTS,
    LEFT,
    OWN,
    PARTLY,
    SURE,
    TOLD_U,
    TOLD_V,
    UNTOLD,
    add_height,
    fit_quadric,
)
from planewise.kernels.roots import root_of

QUADRIC = 14
CENTRE, C, EXTENT, SIZE, BENT = 3, 5, 11, 12, 13
APART, MEET, NEAR, ROUND = 0, 1, 2, 3  # how segments are at a side of two cells
OUTWARD, INWARD = 32, 64  # of a pair of segments: which way it clearly turns

_TURN = 0.5  # cosine of 60 degrees: edges turn by more, as a rule
_CLEAR = 0.9976  # cosine of 4 degrees: noise turns narrow segments by less, as a rule
_SAME_WAY = 0.9  # of the sides within a surface that is round: those that turn one way
_ROUND = 4  # segments of one, at least, of which none is wide enough to tell
_INTO = 0.1  # of the width of a segment
_BEYOND, _TWICE = 2.0, 2.0  # standard deviations; sides of cells come in pairs between units


@compiled
def quadrics_of(units, of_unit, rows, drift, chosen, quadrics):  # type: ignore[no-untyped-def]
    """Fit a quadric to every chosen segment: writes quadrics (n, QUADRIC).

    units (m, 13), of_unit (m,): rows and segments of units, -1 for those that do not count; rows
    (n, 13), drift (n,), chosen (n,): of segments.
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
        if s < 0 or not chosen[s]:
            continue
        row, q = units[k], quadrics[s]
        w, inverse, scale = row[0], 1.0 / row[0], 1.0 / q[EXTENT]
        x, y = row[1] * inverse, row[2] * inverse
        z = row[6] * inverse - q[0] - q[1] * x - q[2] * y
        x, y = scale * (x - q[CENTRE]), scale * (y - q[CENTRE + 1])
        add_height(sums[s], w, x, y, z)
        cells[s] += 1
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
        xx, xy, yy = q[C + 3], q[C + 4], q[C + 5]
        q[SIZE] = np.sqrt(4.0 * xx * xx + 2.0 * xy * xy + 4.0 * yy * yy)


@compiled
def inner_units(grid, of_unit, out):  # type: ignore[no-untyped-def]
    """Segments of units, -1 of those with a cell beside another segment or none: writes out (m,).

    grid (rows, columns): unit of every cell, -1 for none; of_unit (m,): segments of units.
    """
    rows, columns = grid.shape
    out[:] = of_unit
    for i in range(rows):
        for j in range(columns):
            u = grid[i, j]
            for k in range(2):
                row, column = i + k, j + 1 - k
                if row >= rows or column >= columns:
                    continue
                v = grid[row, column]
                if u == v or (u >= 0 and v >= 0 and of_unit[u] == of_unit[v]):
                    continue
                if u >= 0:
                    out[u] = -1
                if v >= 0:
                    out[v] = -1


@inlined
def _surface(q, x, y):  # type: ignore[no-untyped-def]
    """w of a quadric at a point, and its slopes."""
    dx, dy = x - q[CENTRE], y - q[CENTRE + 1]
    w = q[0] + q[1] * x + q[2] * y + q[C] + q[C + 1] * dx + q[C + 2] * dy
    w += q[C + 3] * dx * dx + q[C + 4] * dx * dy + q[C + 5] * dy * dy
    along = q[1] + q[C + 1] + 2.0 * q[C + 3] * dx + q[C + 4] * dy
    return w, along, q[2] + q[C + 2] + q[C + 4] * dx + 2.0 * q[C + 5] * dy


@inlined
def _half_way(i, j):  # type: ignore[no-untyped-def]
    """Point half way between two cells of unit rows, and from one to the other."""
    one, other = 1.0 / i[0], 1.0 / j[0]
    xi, yi, xj, yj = one * i[1], one * i[2], other * j[1], other * j[2]
    return 0.5 * (xi + xj), 0.5 * (yi + yj), xi - xj, yi - yj


@inlined
def _unit_beyond(at, far, grid, wraps):  # type: ignore[no-untyped-def]
    """Unit some cells from the first one of a side, across it; -1 where there is none."""
    rows, columns = grid.shape
    cell, down = at >> 1, at & 1
    i, j = cell // columns + far * down, cell % columns + far * (1 - down)
    if wraps:
        j %= columns
    return grid[i, j] if 0 <= i < rows and 0 <= j < columns else np.int32(-1)


@compiled
def meet(ends, units, rows, quadrics, slope, how, turns):  # type: ignore[no-untyped-def]
    """Say how the planes of segments meet, at every side of cells between two of them.

    ends, units (m, 2): segments and units of both cells; rows (., 13) of units; quadrics (n, .) of
    segments; slope: of w, per w, of a surface at 45 degrees. Writes how (m,): APART if one surface
    is in front of the other; else NEAR if they turn by less than 60 degrees, and MEET if by more;
    and turns (m,): OUTWARD or INWARD where planes that are NEAR clearly turn so, else 0.
    """
    for e in range(ends.shape[0]):
        a, b = quadrics[ends[e, 0]], quadrics[ends[e, 1]]
        x, y, dx, dy = _half_way(rows[units[e, 0]], rows[units[e, 1]])
        level = slope * (a[0] + a[1] * x + a[2] * y)
        step = a[0] - b[0] + (a[1] - b[1]) * x + (a[2] - b[2]) * y
        # (t1, t2, r t0) is normal to a plane, r = `slope`.
        ra, rb = slope * a[0], slope * b[0]
        along = a[1] * b[1] + a[2] * b[2] + ra * rb
        of_a, of_b = a[1] * a[1] + a[2] * a[2] + ra * ra, b[1] * b[1] + b[2] * b[2] + rb * rb
        how[e], turns[e] = APART, 0
        if step * step <= level * level * (dx * dx + dy * dy):
            near = along > 0.0 and along * along > _TURN * _TURN * of_a * of_b
            how[e] = NEAR if near else MEET
            if near and along * along < _CLEAR * _CLEAR * of_a * of_b:
                # 1 / z is largest at an edge that points to the camera.
                inward = (a[1] - b[1]) * dx + (a[2] - b[2]) * dy > 0.0
                turns[e] = INWARD if inward else OUTWARD


@compiled
def find_round(ends, at, grid, of_unit, rows, quadrics, chosen, wraps, how):  # type: ignore[no-untyped-def]
    """Find where chosen segments that are NEAR have no edge: how (m,) of such sides is ROUND.

    ends (m, 2), at (m,): segments and places of both cells (`borders.segment_borders`); grid: unit
    of every cell, -1 for none; of_unit (.,), rows (., 13): of units; quadrics (n, .), chosen (n,):
    of segments; wraps: whether the last column is beside the first.

    There cells a tenth of the width into both turn by clearly less than half of what the planes do,
    on average of all sides between the same two; edges that are rounded are so by less than that.
    """
    size, count = ends.shape[0], quadrics.shape[0]
    first, sides = np.empty(size, np.int32), np.empty(count)
    first_of_pairs(ends, count, first)
    sides[:] = 0.0
    for e in range(size):
        sides[ends[e, 0]] += 1.0
        sides[ends[e, 1]] += 1.0
    total, mean = np.empty(size), np.empty(size)  # by where the pair comes first
    total[:] = mean[:] = 0.0
    for e in range(size):
        u, v = ends[e, 0], ends[e, 1]
        if how[e] != NEAR or not (chosen[u] and chosen[v]):
            continue
        a, b = quadrics[u], quadrics[v]
        # Pixels are twice the width times the border, and those of a square its extent^2.
        scale = _INTO * 2.0 * (UNIT / SIDE) * (UNIT / SIDE)
        left = scale * a[EXTENT] * a[EXTENT] / sides[u]
        right = scale * b[EXTENT] * b[EXTENT] / sides[v]
        i = _unit_beyond(at[e], -int(left), grid, wraps)
        j = _unit_beyond(at[e], 1 + int(right), grid, wraps)
        if i < 0 or j < 0 or of_unit[i] != u or of_unit[j] != v:
            continue
        _, _, _, i1, i2, ixx, ixy, iyy, _ = own_plane(rows[i])
        _, _, _, j1, j2, jxx, jxy, jyy, _ = own_plane(rows[j])
        # The mean, by precision, of what they turn by against what the planes do.
        d1, d2 = a[1] - b[1], a[2] - b[2]
        turn = d1 * d1 + d2 * d2
        variance = (ixx + jxx) * d1 * d1 + (iyy + jyy) * d2 * d2 + 2.0 * (ixy + jxy) * d1 * d2
        weight = turn * turn / variance
        if weight > 0.0 and weight < np.inf:
            total[first[e]] += weight
            mean[first[e]] += weight * ((i1 - j1) * d1 + (i2 - j2) * d2) / turn
    for e in range(size):
        if how[e] != NEAR or total[first[e]] == 0.0:
            continue
        weight = total[first[e]]
        if mean[first[e]] / weight + _BEYOND * np.sqrt(_TWICE / weight) < LEFT:
            how[e] = ROUND


@inlined
def _least(a, b):  # type: ignore[no-untyped-def]
    """By how much, at least, either of two quadrics bends if their surface goes on."""
    d1, d2 = a[1] - b[1], a[2] - b[2]
    return OWN * np.sqrt(d1 * d1 + d2 * d2) / (a[EXTENT] + b[EXTENT])


@inlined
def _state(a, b, i, j, near):  # type: ignore[no-untyped-def]
    """State of a side, by quadrics of parts and unit rows of cells; 0 if they say nothing."""
    told = max(a[BENT], b[BENT])
    if told in (FLAT, UNTOLD):
        return 0
    d1, d2 = a[1] - b[1], a[2] - b[2]
    turn, extents = d1 * d1 + d2 * d2, a[EXTENT] + b[EXTENT]
    least, state = _least(a, b), 0
    if near if a[BENT] < 0.0 else a[SIZE] >= least:
        state |= TOLD_U
    if near if b[BENT] < 0.0 else b[SIZE] >= least:
        state |= TOLD_V
    if state == 0:
        return state
    if told == PARTLY:
        return state | GOES_ON
    x, y, _, _ = _half_way(i, j)
    over, ux, uy = _surface(a, x, y)
    under, vx, vy = _surface(b, x, y)
    jump = 2.0 * (over - under) / extents
    turn_x, turn_y = ux - vx, uy - vy
    if turn_x * turn_x + turn_y * turn_y + jump * jump <= LEFT * LEFT * turn:
        state |= GOES_ON | SURE
    return state


@compiled
def surface_borders(  # type: ignore[no-untyped-def]
    ends, units, rows, quadrics, segment, how, turns, border, pairs, points, states
):
    """Find where the surfaces of segments may go on, from the sides of cells between them.

    ends, units (m, 2): parts of segments and units of both cells; rows (., 13) of units; segment:
    of every part; how, turns (m,): `meet`. Sides where they meet are counted in border (n,) of
    either segment. Writes of each whose segments may be one curved surface the segments (., 2),
    points (.), which are 1, and states (.): GOES_ON, SURE if it is ROUND or if half way between the
    cells the quadrics, the step from one to the other included, turn by at most half of what the
    planes do; GOES_ON alone if one is told in part and the other no more; TOLD_U, TOLD_V of a part
    whose own quadric makes a fair share of that, or is not told, or of what is ROUND bends in any
    way; and what turns says. Returns how many there are.
    """
    found = 0
    border[:] = 0.0
    for e in range(ends.shape[0]):
        if how[e] == APART:
            continue
        u, v = ends[e, 0], ends[e, 1]
        border[segment[u]] += 1.0
        border[segment[v]] += 1.0
        a, b = quadrics[u], quadrics[v]
        if how[e] == ROUND:  # but where noise moved the edge of what is flat elsewhere
            least, state = _least(a, b), GOES_ON | SURE
            if a[BENT] != FLAT or a[SIZE] >= least:
                state |= TOLD_U
            if b[BENT] != FLAT or b[SIZE] >= least:
                state |= TOLD_V
        else:
            state = _state(a, b, rows[units[e, 0]], rows[units[e, 1]], how[e] == NEAR)
        if state == 0:
            continue
        pairs[found, 0], pairs[found, 1] = segment[u], segment[v]
        points[found], states[found] = 1.0, state | turns[e]
        found += 1
    return found


@compiled
def leave_out(pairs, states, together, curved):  # type: ignore[no-untyped-def]
    """Of curved segments leave those that are, side by side, at most two, or are with none SURE.

    Unless these are more than three and turn one way all over, as the strips of a pillar do.

    pairs (m, 2), states (m,): as `surface_borders` writes them; together (n,): those that count,
    curved ones among them; curved (n,), which may be the same array.
    """
    group, size = np.empty(curved.size, np.int64), np.empty(curved.size, np.int64)
    sure, sides = np.empty(curved.size, np.bool_), np.empty((3, curved.size))
    for s in range(curved.size):
        group[s], size[s], sure[s] = s, 0, False
        sides[0, s] = sides[1, s] = sides[2, s] = 0.0
    for e in range(pairs.shape[0]):
        u, v = pairs[e, 0], pairs[e, 1]
        if together[u] and together[v]:
            group[root_of(group, u)] = root_of(group, v)
    for e in range(pairs.shape[0]):
        u, v = pairs[e, 0], pairs[e, 1]
        if together[u] and together[v]:
            root = root_of(group, u)
            sure[root] |= states[e] & SURE != 0
            sides[0, root] += 1.0
            sides[1, root] += states[e] & OUTWARD != 0
            sides[2, root] += states[e] & INWARD != 0
    for s in range(curved.size):
        size[root_of(group, s)] += together[s]
    for s in range(curved.size):
        root = root_of(group, s)
        one_way = max(sides[1, root], sides[2, root]) > _SAME_WAY * sides[0, root]
        curved[s] &= (sure[root] and size[root] > 2) or (one_way and size[root] >= _ROUND)
