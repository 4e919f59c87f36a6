"""Loops from sorted points to cells: patches of an octree that have a plane.

Nodes of one level are in the order of their keys. The state of a node: too few points to tell a
plane; one plane; or neither it nor what is above it is one plane.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cloud_keys import middle_of
from planewise.kernels.cloud_rows import (
    AREA,
    COUNT,
    CX,
    CY,
    CZ,
    NX,
    NY,
    NZ,
    ROW,
    WEIGHT,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
    add_points,
    add_row,
    compare,
    make_plane,
    misfit_beside,
    write_normal,
)
from planewise.kernels.cubes import beside
from planewise.kernels.jit import compiled, in_order, internal

FEW, PLANE, MIXED = 0, 1, 2
NEIGHBOURS = 18  # of a cube: across faces and edges
FACES_EDGES = np.array([1, 3, 4, 5, 7, 9, 10, 11, 12, 14, 15, 16, 17, 19, 21, 22, 23, 25])
_TOUCH = 0.8  # of the sum of their extents: cells whose centroids are farther apart do not touch


@compiled
def local_points(  # type: ignore[no-untyped-def]
    points, rows, starts, cubes, side, middle, turn, centre, first, last, local, nodes
):  # fmt: skip
    """Points of cubes[first:last] relative to the middle of their cube, and the cubes' moments.

    rows (k,) of the sorted points; starts (n + 1,) and keys (n,) of the cubes; side: of a cube;
    middle: coordinate of the centre in the grid of cubes. Writes local (k, 3) float32, and weights
    of 1, centroid (relative to the centre), scatter and count of nodes (n, 18).
    """
    for node in range(first, last):
        begin, end = starts[node], starts[node + 1]
        x0, y0, z0 = middle_of(cubes[node], side, middle, turn)
        sx = sy = sz = xx = xy = xz = yy = yz = zz = 0.0
        for i in range(begin, end):
            row = rows[i]
            x = (points[row, 0] - centre[0]) - x0
            y = (points[row, 1] - centre[1]) - y0
            z = (points[row, 2] - centre[2]) - z0
            local[i, 0], local[i, 1], local[i, 2] = x, y, z
            sx, sy, sz = sx + x, sy + y, sz + z
            xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
            yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
        count = float(end - begin)
        cx, cy, cz = sx / count, sy / count, sz / count
        out = nodes[node]
        for e in range(ROW):
            out[e] = 0.0
        out[WEIGHT] = out[COUNT] = count
        out[CX], out[CY], out[CZ] = x0 + cx, y0 + cy, z0 + cz
        out[XX], out[XY], out[XZ] = xx - sx * cx, xy - sx * cy, xz - sx * cz
        out[YY], out[YZ], out[ZZ] = yy - sy * cy, yz - sy * cz, zz - sz * cz


@compiled
def weigh(nodes, variance):  # type: ignore[no-untyped-def]
    """Divide the weights of nodes by the mean variance (n,) of their points."""
    for node in range(variance.size):
        scale = 1.0 / variance[node]
        nodes[node, WEIGHT] *= scale
        for e in range(XX, ZZ + 1):
            nodes[node, e] *= scale


@compiled
def foreshorten(nodes, origins, tilt, least, steepest, variance):  # type: ignore[no-untyped-def]
    """Make the variance (n,) of points along their rays that across the planes of their nodes.

    nodes (n, 18), their weights the number of points; origins (1 or n, 3): where their rays begin.
    Of nodes whose points tell a plane, times cos^2 of the angle between its normal and the ray, at
    least `steepest`; of others it stays.
    """
    row = np.empty(ROW)
    for node in range(variance.size):
        if nodes[node, COUNT] < least:
            continue
        for e in range(ROW):
            row[e] = nodes[node, e]
        _, _, middle = write_normal(row)
        if not middle > 0.0 or variance[node] / middle > tilt:
            continue
        origin = origins[min(node, origins.shape[0] - 1)]
        x, y, z = row[CX] - origin[0], row[CY] - origin[1], row[CZ] - origin[2]
        across = x * row[NX] + y * row[NY] + z * row[NZ]
        square = x * x + y * y + z * z
        if square > 0.0:
            variance[node] *= max(across * across / square, steepest)


@compiled
def roughness(nodes, tilt, wide, least, first, last, ratios):  # type: ignore[no-untyped-def]
    """chi^2 of nodes[first:last] about their planes over its lower quartile for so many points.

    tilt: largest variance of a slope; wide: least ratio of the two variances in the plane, for
    lines of a scanner, one above the other, lie in a plane that is no surface; least: number of
    points. Writes ratios (n,), -1 where the points of a node tell no plane.
    """
    row = np.empty(ROW)
    for node in range(first, last):
        ratios[node] = -1.0
        count = nodes[node, COUNT]
        if count < least:
            continue
        for e in range(ROW):
            row[e] = nodes[node, e]
        chi2, largest, middle = write_normal(row)
        if middle > wide * largest and 1.0 / middle < tilt:
            freedom = count - 3.0
            # Wilson and Hilferty
            spread_ = 2.0 / (9.0 * freedom)
            root = 1.0 - spread_ - 0.6745 * math.sqrt(spread_)
            ratios[node] = chi2 / (freedom * root * root * root)


@internal
def _state(row, limits):  # type: ignore[no-untyped-def]
    white, hopeless, tilt, least, offset_share, prior, wider = limits
    found = make_plane(row, white, hopeless, tilt, least, offset_share, prior, wider)
    return PLANE if found == 1 else MIXED if found < 0 else FEW


@internal
def _join_children(rows, states, first, last, out, limits):  # type: ignore[no-untyped-def]
    """Write the row of a parent of children; returns its state."""
    for k in range(first, last):
        if states[k] != FEW:
            return MIXED
    for e in range(ROW):
        out[e] = rows[first, e]
    for k in range(first + 1, last):
        add_row(out, rows[k])
    return _state(out, limits)


@compiled
def node_states(nodes, limits, first, last, states):  # type: ignore[no-untyped-def]
    """Write the states of nodes[first:last] (n, 18), and make those of a plane rows of it.

    limits: white, hopeless, tilt, least, offset_share, prior, wider (`make_plane`).
    """
    for k in range(first, last):
        states[k] = _state(nodes[k], limits)


@compiled
def grow_cells(nodes, states, keys, levels, limits, firsts, lasts, cells, spans, level_of):  # type: ignore[no-untyped-def]
    """Find the smallest cubes whose points tell a plane.

    nodes (n, 18), states (n,) and keys (n,) of the least cubes (`node_states`); all are
    overwritten. firsts, lasts (n,): to work in.

    Writes rows of cells (n, 18), the least cubes spans (n, 2) each consists of and its level.
    Returns how many cells there are.
    """
    count, found = keys.size, 0
    for k in range(count):
        firsts[k], lasts[k] = k, k + 1
    row = np.empty(ROW)
    for level in range(levels + 1):
        parents, k = 0, 0
        last_level = level == levels
        while k < count:
            end = k + 1
            key = keys[k] >> np.uint64(3)
            while end < count and keys[end] >> np.uint64(3) == key:
                end += 1
            state = MIXED if last_level else _join_children(nodes, states, k, end, row, limits)
            if state == MIXED:
                for child in range(k, end):
                    if states[child] == PLANE:
                        for e in range(ROW):
                            cells[found, e] = nodes[child, e]
                        spans[found, 0], spans[found, 1] = firsts[child], lasts[child]
                        level_of[found] = level
                        found += 1
            first, last = firsts[k], lasts[end - 1]
            for e in range(ROW):
                nodes[parents, e] = row[e]
            firsts[parents], lasts[parents] = first, last
            keys[parents], states[parents] = key, state
            parents += 1
            k = end
        count = parents
    return found


@in_order
def owners(spans, before, owner):  # type: ignore[no-untyped-def]
    """Cell that every least cube is part of, -1 for none; `before` cells come before these."""
    owner[:] = -1
    for cell in range(spans.shape[0]):
        for k in range(spans[cell, 0], spans[cell, 1]):
            owner[k] = before + cell


@compiled
def absorb(nodes, about, cells, white, owner, first, last, chosen):  # type: ignore[no-untyped-def]
    """Cells on whose plane the points of loose cubes[first:last] beside them lie, -1 for none.

    about (n, 27): `cubes_about`.
    """
    beside_it = np.empty(28, np.int64)
    for cube in range(first, last):
        chosen[cube] = -1
        if owner[cube] >= 0:
            continue
        size = 0  # of what there is, listed without a branch that nobody could foresee
        for direction in range(27):
            near = about[cube, direction]
            cell = owner[max(near, 0)]
            beside_it[size] = cell
            size += (near >= 0) & (cell >= 0)
        n = nodes[cube, COUNT]
        least = white * (n + 3.0 * math.sqrt(2.0 * n) + 1.0)
        before = np.int64(-1)
        for k in range(size):
            cell = beside_it[k]
            if cell != before:
                misfit = misfit_beside(cells, cell, nodes, cube, white)
                if misfit < least:
                    least, chosen[cube] = misfit, cell
            before = cell


@compiled
def take_in(nodes, white, shared, chosen, cells, owner):  # type: ignore[no-untyped-def]
    """Make loose cubes part of the cells chosen for them (`add_points`); returns how many."""
    found = 0
    for cube in range(owner.size):
        if owner[cube] < 0 and chosen[cube] >= 0:
            owner[cube] = chosen[cube]
            add_points(cells[chosen[cube]], nodes[cube], white, shared)
            found += 1
    return found


@internal
def stacked(rows, i, j):  # type: ignore[no-untyped-def]
    """Whether one of two rows lies over the other rather than beside it, or far away."""
    dx, dy, dz = rows[j, CX] - rows[i, CX], rows[j, CY] - rows[i, CY], rows[j, CZ] - rows[i, CZ]
    over = abs(dx * rows[i, NX] + dy * rows[i, NY] + dz * rows[i, NZ])
    over = max(over, abs(dx * rows[j, NX] + dy * rows[j, NY] + dz * rows[j, NZ]))
    square = dx * dx + dy * dy + dz * dz
    # square > (_TOUCH (sqrt(A) + sqrt(B)))^2 without its roots
    a, b = rows[i, AREA], rows[j, AREA]
    apart = max(square / (_TOUCH * _TOUCH) - a - b, 0.0)
    return over * over > 0.5 * square or apart * apart > 4.0 * a * b


@compiled
def neighbours(keys, about, owner, level_of, nodes, cells, first, last, ends, sides):  # type: ignore[no-untyped-def]
    """Pairs of cells that cubes[first:last] lie between; returns how many.

    keys (n,), about (n, 27) and owner (n,) of the least cubes, and level_of (m,) of cells: cubes of
    a larger cell look as far as it is large. Writes ends (., 2) and sides (.), the points along the
    border: up to 18 a cube, and the same pair again and again.
    """
    near, there = np.empty(27, np.int32), np.empty(NEIGHBOURS + 1, np.int64)
    found = 0
    for cube in range(first, last):
        cell = owner[cube]
        if cell < 0:
            continue
        level = level_of[cell]
        if level > 0:
            beside(keys, keys[cube] >> np.uint64(3 * level), level, cube, near)
        size = 0  # of neighbours, as in `absorb`; cubes of one level are found from one side
        for step in range(FACES_EDGES.size):
            direction = FACES_EDGES[step]
            place = near[direction] if level > 0 else about[cube, direction]
            other = owner[max(place, 0)]
            above = level_of[max(other, 0)]
            there[size] = direction
            later = (above > level) | ((above == level) & (direction > 13))
            size += (place >= 0) & (other >= 0) & (other != cell) & later
        for k in range(size):
            direction = there[k]
            place = near[direction] if level > 0 else about[cube, direction]
            other = owner[place]
            if stacked(cells, cell, other):
                continue
            corner = (direction // 9 != 1) + (direction // 3 % 3 != 1) + (direction % 3 != 1)
            weight = 0.5 if corner == 1 else 0.25
            ends[found, 0], ends[found, 1] = cell, other
            sides[found] = weight * math.sqrt(min(nodes[cube, COUNT], nodes[place, COUNT]))
            found += 1
    return found


@compiled
def cell_residuals(cells, plane_of, planes, out):  # type: ignore[no-untyped-def]
    """Distance of each cell (m, 18) from its plane, of planes (N, 4), in standard deviations."""
    for cell in range(plane_of.size):
        j = plane_of[cell]
        out[cell] = 0.0
        if j >= 0:
            off = planes[j, 0] * cells[cell, CX] + planes[j, 1] * cells[cell, CY]
            off += planes[j, 2] * cells[cell, CZ] + planes[j, 3]
            out[cell] = off * math.sqrt(cells[cell, WEIGHT])


@compiled
def pair_discords(rows, ends, wander, out):  # type: ignore[no-untyped-def]
    """Discord of every pair of rows."""
    for e in range(out.size):
        out[e] = compare(rows, ends[e, 0], ends[e, 1], wander, 0.0, 0.0)[0]


@compiled
def sibling_pairs(states, keys, ends):  # type: ignore[no-untyped-def]
    """Find nodes that are planes and share a face and a parent.

    states (n,), keys (n,). Writes ends (., 2); returns how many pairs there are.
    """
    found = 0
    for k in range(keys.size):
        if states[k] != PLANE:
            continue
        other = k + 1
        while other < keys.size and keys[other] >> np.uint64(3) == keys[k] >> np.uint64(3):
            bits = keys[k] ^ keys[other]
            side = bits == np.uint64(1) or bits == np.uint64(2) or bits == np.uint64(4)
            if states[other] == PLANE and side and found < ends.shape[0]:
                ends[found, 0], ends[found, 1] = k, other
                found += 1
            other += 1
    return found


@compiled
def parents_of(nodes, keys, out, out_keys):  # type: ignore[no-untyped-def]
    """Nodes one level up; returns how many."""
    found = -1
    for k in range(keys.size):
        key = keys[k] >> np.uint64(3)
        if found >= 0 and out_keys[found] == key:
            add_row(out[found], nodes[k])
        else:
            found += 1
            out_keys[found] = key
            for e in range(ROW):
                out[found, e] = nodes[k, e]
    return found + 1
