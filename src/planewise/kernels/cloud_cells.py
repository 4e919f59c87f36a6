"""Loops from sorted points to cells: patches of an octree that have a plane.

Nodes of one level are in the order of their keys. The state of a node: too few points to tell a
plane; one plane; or neither it nor what is above it is one plane.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cloud_keys import LEVELS, gather, spread
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
from planewise.kernels.jit import compiled, in_order, internal

FEW, PLANE, MIXED = 0, 1, 2
NEIGHBOURS = 18  # of a cube: across faces and edges
_TOUCH = 0.8  # of the sum of their extents: cells whose centroids are farther apart do not touch


@compiled
def local_points(points, rows, keys, starts, shift, side, turn, centre, first, last, local, nodes):  # type: ignore[no-untyped-def]
    """Points of nodes[first:last] relative to the middle of their node, and the nodes' moments.

    Sorted keys (k,) and rows (k,) of points; starts (n + 1,) of the nodes; shift: bits of a key
    below a node; side: of the finest cubes. Writes local (k, 3) float32, and weights of 1, centroid
    (relative to the centre), scatter and count of nodes (n, 18).
    """
    half = 0.5 * (1 << (shift // 3))
    middle = float(1 << (LEVELS - 1))
    for node in range(first, last):
        begin, end = starts[node], starts[node + 1]
        key = (keys[begin] >> np.uint64(shift)) << np.uint64(shift)
        u = (gather(key) + half - middle) * side
        v = (gather(key >> np.uint64(1)) + half - middle) * side
        w = (gather(key >> np.uint64(2)) + half - middle) * side
        # The turn is orthogonal: its inverse is its transpose.
        x0 = turn[0, 0] * u + turn[1, 0] * v + turn[2, 0] * w
        y0 = turn[0, 1] * u + turn[1, 1] * v + turn[2, 1] * w
        z0 = turn[0, 2] * u + turn[1, 2] * v + turn[2, 2] * w
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
def roughness(nodes, tilt, least, ratios):  # type: ignore[no-untyped-def]
    """chi^2 of nodes about their planes over its lower quartile for so many points.

    Of nodes whose points tell a plane; writes ratios (n,), returns how many.
    """
    found = 0
    row = np.empty(ROW)
    for node in range(nodes.shape[0]):
        count = nodes[node, COUNT]
        if count < least:
            continue
        for e in range(ROW):
            row[e] = nodes[node, e]
        chi2, _, middle = write_normal(row)
        if middle > 0.0 and 1.0 / middle < tilt:
            freedom = count - 3.0
            # Wilson and Hilferty
            spread_ = 2.0 / (9.0 * freedom)
            quartile = freedom * (1.0 - spread_ - 0.6745 * math.sqrt(spread_)) ** 3
            ratios[found] = chi2 / quartile
            found += 1
    return found


@internal
def _state(row, limits):  # type: ignore[no-untyped-def]
    white, hopeless, tilt, least, offset_share, prior = limits
    found = make_plane(row, white, hopeless, tilt, least, offset_share, prior)
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
def grow_cells(nodes, keys, levels, limits, firsts, lasts, cells, spans, level_of):  # type: ignore[no-untyped-def]
    """Find the smallest cubes whose points tell a plane.

    nodes (n, 18) and keys (n,) of the least cubes; both are overwritten. limits: white, hopeless,
    tilt, least, offset_share, prior (`make_plane`). firsts, lasts (n,): to work in.

    Writes rows of cells (n, 18), the least cubes spans (n, 2) each consists of and its level.
    Returns how many cells there are.
    """
    count, found = keys.size, 0
    states = np.empty(count, np.int8)
    for k in range(count):
        firsts[k], lasts[k] = k, k + 1
        states[k] = _state(nodes[k], limits)
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
def owners(spans, owner):  # type: ignore[no-untyped-def]
    """Cell that every least cube is part of, -1 for none."""
    owner[:] = -1
    for cell in range(spans.shape[0]):
        for k in range(spans[cell, 0], spans[cell, 1]):
            owner[k] = cell


@in_order
def first_at_least(keys, key, hint):  # type: ignore[no-untyped-def]
    """Where the first of sorted keys stands that is not less than a key, sought from a hint on."""
    step = 1
    if hint < keys.size and keys[hint] < key:
        low = hint + 1
        while hint + step < keys.size and keys[hint + step] < key:
            low = hint + step + 1
            step *= 2
        high = min(hint + step, keys.size)
    else:
        high = hint
        while hint - step >= 0 and keys[hint - step] >= key:
            high = hint - step
            step *= 2
        low = max(hint - step + 1, 0)
    while low < high:
        middle = (low + high) >> 1
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@in_order
def beside(keys, cube, level, hint, out):  # type: ignore[no-untyped-def]
    """Least cubes in the 26 neighbours of a cube `level` levels up, the first of each, or -1.

    keys (n,) of the least cubes, sorted; cube: key at its level; hint: where to look first. Writes
    out (27,), [13] is itself.
    """
    u = np.int64(gather(cube))
    v = np.int64(gather(cube >> np.uint64(1)))
    w = np.int64(gather(cube >> np.uint64(2)))
    shift = np.uint64(3 * level)
    for direction in range(27):
        i, j, k = direction // 9 - 1, direction // 3 % 3 - 1, direction % 3 - 1
        out[direction] = -1
        if min(u + i, v + j, w + k) < 0:
            continue
        key = spread(u + i) | (spread(v + j) << np.uint64(1)) | (spread(w + k) << np.uint64(2))
        at = first_at_least(keys, key << shift, hint)
        if at < keys.size and keys[at] >> shift == key:
            out[direction] = at


@in_order
def cubes_about(keys, first, last, out):  # type: ignore[no-untyped-def]
    """Where the cubes about cubes[first:last] are, and they in theirs.

    keys (n,) of the cubes, sorted. Writes out (n, 27) int32, which holds -1: [13] is the cube
    itself, [26 - d] lies opposite [d].
    """
    for cube in range(first, last):
        key = keys[cube]
        u = np.int64(gather(key))
        v = np.int64(gather(key >> np.uint64(1)))
        w = np.int64(gather(key >> np.uint64(2)))
        out[cube, 13] = cube
        for direction in range(14, 27):
            i, j, k = direction // 9 - 1, direction // 3 % 3 - 1, direction % 3 - 1
            if min(u + i, v + j, w + k) < 0:
                continue
            wanted = (
                spread(u + i) | (spread(v + j) << np.uint64(1)) | (spread(w + k) << np.uint64(2))
            )
            at = first_at_least(keys, wanted, cube)
            if at < keys.size and keys[at] == wanted:
                out[cube, direction] = at
                out[at, 26 - direction] = cube


@compiled
def absorb(nodes, about, cells, white, owner, first, last, chosen):  # type: ignore[no-untyped-def]
    """Cells on whose plane the points of loose cubes[first:last] beside them lie, -1 for none.

    about (n, 27): `cubes_about`.
    """
    for cube in range(first, last):
        chosen[cube] = -1
        if owner[cube] >= 0:
            continue
        near = about[cube]
        n = nodes[cube, COUNT]
        least = white * (n + 3.0 * math.sqrt(2.0 * n) + 1.0)
        for direction in range(27):
            if near[direction] < 0 or owner[near[direction]] < 0:
                continue
            cell = owner[near[direction]]
            misfit = misfit_beside(cells[cell], nodes[cube], white)
            if misfit < least:
                least, chosen[cube] = misfit, cell


@compiled
def take_in(nodes, white, chosen, cells, owner):  # type: ignore[no-untyped-def]
    """Make loose cubes part of the cells chosen for them; returns how many."""
    found = 0
    for cube in range(owner.size):
        if owner[cube] < 0 and chosen[cube] >= 0:
            owner[cube] = chosen[cube]
            add_points(cells[chosen[cube]], nodes[cube], white)
            found += 1
    return found


@internal
def _stacked(a, b):  # type: ignore[no-untyped-def]
    """Whether one of two cells lies over the other rather than beside it."""
    dx, dy, dz = b[CX] - a[CX], b[CY] - a[CY], b[CZ] - a[CZ]
    over = max(abs(dx * a[NX] + dy * a[NY] + dz * a[NZ]), abs(dx * b[NX] + dy * b[NY] + dz * b[NZ]))
    square = dx * dx + dy * dy + dz * dz
    reach = _TOUCH * (math.sqrt(a[AREA]) + math.sqrt(b[AREA]))
    return over * over > 0.5 * square or square > reach * reach


@compiled
def neighbours(keys, about, owner, level_of, nodes, cells, first, last, ends, sides):  # type: ignore[no-untyped-def]
    """Pairs of cells that cubes[first:last] lie between.

    keys (n,), about (n, 27) and owner (n,) of the least cubes, and level_of (m,) of cells: cubes of
    a larger cell look as far as it is large. Writes ends (18 (last - first), 2) and sides: the
    points along the border, 0 where there is no neighbour.
    """
    wide = np.empty(27, np.int32)
    at = 0
    for cube in range(first, last):
        cell = owner[cube]
        end = at + NEIGHBOURS
        if cell >= 0:
            level = level_of[cell]
            near = about[cube]
            if level > 0:
                beside(keys, keys[cube] >> np.uint64(3 * level), level, cube, wide)
                near = wide
            for direction in range(27):
                if direction == 13 or near[direction] < 0:
                    continue
                other = owner[near[direction]]
                if other < 0 or other == cell or level_of[other] < level:
                    continue
                if level_of[other] == level and near[direction] < cube:
                    continue  # found from there
                corner = (direction // 9 != 1) + (direction // 3 % 3 != 1) + (direction % 3 != 1)
                if corner == 3 or _stacked(cells[cell], cells[other]):
                    continue
                weight = 0.5 if corner == 1 else 0.25
                ends[at, 0], ends[at, 1] = cell, other
                sides[at] = weight * math.sqrt(
                    min(nodes[cube, COUNT], nodes[near[direction], COUNT])
                )
                at += 1
        while at < end:
            sides[at] = 0.0
            at += 1


@in_order
def compact(ends, sides):  # type: ignore[no-untyped-def]
    """Move pairs that are neighbours to the front; returns how many."""
    found = 0
    for e in range(sides.size):
        if sides[e] > 0.0:
            ends[found, 0], ends[found, 1], sides[found] = ends[e, 0], ends[e, 1], sides[e]
            found += 1
    return found


@compiled
def pair_discords(rows, ends, drift, out):  # type: ignore[no-untyped-def]
    """Discord of every pair of rows."""
    for e in range(out.size):
        out[e] = compare(rows[ends[e, 0]], rows[ends[e, 1]], drift, 0.0, 0.0)[0]


@compiled
def sibling_pairs(nodes, keys, limits, ends):  # type: ignore[no-untyped-def]
    """Make planes of nodes (n, 18), and find those that share a face and a parent.

    Writes ends (., 2); returns how many pairs there are.
    """
    states = np.empty(keys.size, np.int8)
    for k in range(keys.size):
        states[k] = _state(nodes[k], limits)
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
