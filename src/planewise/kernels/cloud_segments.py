"""Loops over segments of a cloud: merging neighbours while that saves nats.

A segment is a row (`kernels.cloud_rows`); joining segments is adding rows. Which are neighbours is
a graph: pairs of segments and the points along their common border.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.borders import falling
from planewise.kernels.cloud_cells import stacked
from planewise.kernels.cloud_rows import (
    APART,
    AREA,
    CELLS,
    COUNT,
    MISFIT,
    NX,
    NY,
    NZ,
    add_row,
    compare,
    tempered,
    write_normal,
)
from planewise.kernels.edges import append_half, find_edge, list_edges, unite_edges, write_roots
from planewise.kernels.heap import SPARE, clear, update
from planewise.kernels.jit import compiled, in_order, inlined, internal

_PARALLEL = 0.9  # least cosine between normals of rows seen through a gap
_LONGEST = 6.0  # times a plane's parameters: all that a merge saves of a border
_STEP = 200.0  # discord above which neighbours that are nearly parallel are no one plane


@compiled
def border_prices(rows, ends, sides, wander, merge, plane, first, last, saved, price):  # type: ignore[no-untyped-def]
    """Nats of the borders of pairs[first:last] of rows, by their discord.

    merge, plane: (low, high, knee) of what a merge saves (saved) and what a plane pays (price). A
    merge across a step saves nothing: of sheets that lie over each other all cells are a border.
    """
    for e in range(first, last):
        discord, _ = compare(rows, ends[e, 0], ends[e, 1], wander, 0.0, 0.0)
        step = _STEP < discord < APART
        saved[e] = 0.0 if step else sides[e] * falling(discord, merge)
        price[e] = sides[e] * falling(discord, plane)


@compiled
def join_siblings(keys, rows, wander, limit, first, last, root):  # type: ignore[no-untyped-def]
    """Join cells of one cube, twice as wide as theirs, that are clearly one plane.

    keys (n,): of the first cube of each cell, sorted. Cells beside each other (`stacked`) whose
    discord is at most `limit` are joined, of the cubes that begin in cells[first:last]. rows (n,
    18) are changed; root (n,): the cell whose row has taken each in.
    """
    begin = first
    while 0 < begin < last and keys[begin] >> np.uint64(3) == keys[begin - 1] >> np.uint64(3):
        begin += 1
    for cell in range(begin, keys.size):
        if keys[cell] >> np.uint64(3) != keys[begin] >> np.uint64(3):
            begin = cell
        if begin >= last:
            break
        root[cell] = cell
        for other in range(begin, cell):
            if root[other] == other and _join_alike(rows, other, cell, wander, limit):
                root[cell] = other
                break


@internal
def _join_alike(rows, u, v, wander, limit):  # type: ignore[no-untyped-def]
    """Make row v part of row u if they lie beside each other and are clearly one plane."""
    if stacked(rows, u, v):
        return False
    discord, _ = compare(rows, u, v, wander, 0.0, 0.0)
    if discord > limit:
        return False
    misfit = tempered(discord, min(rows[u, COUNT], rows[v, COUNT]))
    add_row(rows[u], rows[v])
    rows[u, MISFIT] += misfit
    write_normal(rows[u])
    return True


@compiled
def value_pairs(rows, ends, wander, prior, first, last, discords, evidence):  # type: ignore[no-untyped-def]
    """Discord and evidence of pairs[first:last] of rows; of APART, no evidence."""
    for e in range(first, last):
        u, v = ends[e, 0], ends[e, 1]
        offset = _offset_prior(rows, u, v, prior)
        discords[e], evidence[e] = compare(rows, u, v, wander, offset, prior[1])


@internal
def _offset_prior(rows, u, v, prior):  # type: ignore[no-untyped-def]
    """Variance of the offset of two planes that have nothing to do with each other."""
    area = min(rows[u, AREA] / rows[u, CELLS], rows[v, AREA] / rows[v, CELLS])
    return prior[0] * area + prior[2]


@inlined
def _gain(evidence, misfit, boundary, most):  # type: ignore[no-untyped-def]
    """Nats saved by a join: evidence, at most a plane's parameters, and boundary, less its misfit.

    Surfaces lean, so that discord stops to grow with the segments, and so does what their border is
    worth.
    """
    return min(evidence, most) - 0.5 * misfit + min(boundary, _LONGEST * most)


@internal
def _merge_gain(rows, u, v, boundary, wander, prior, most):  # type: ignore[no-untyped-def]
    """Nats saved by joining two segments, and the misfit of the join."""
    small = u if rows[u, COUNT] < rows[v, COUNT] else v
    discord, evidence = compare(rows, u, v, wander, _offset_prior(rows, u, v, prior), prior[1])
    if discord >= APART:
        return -APART, 0.0
    misfit = tempered(discord, rows[small, COUNT])
    return _gain(evidence, misfit, boundary, most), misfit


@compiled
def agglomerate(ends, discords, evidence, boundary, rows, wander, prior, most, waits, root):  # type: ignore[no-untyped-def]
    """Merge neighbouring segments, what saves most first, while a merge saves anything.

    ends (m, 2): pairs of neighbours; discords and evidence (m,): what `value_pairs` says of them,
    of which evidence counts up to `most`; boundary (m,): the nats that a merge saves besides, which
    is changed; prior: variance of the offset of an unrelated plane in areas of a cell, of its
    slopes, and of the offset in m^2. rows (n, 18) are changed: that of a root holds its segment.
    waits (n,): segments that are left alone, which is changed: what would merge with one of them
    before all others waits, too. Writes the root of every segment.

    Gains are valued lazily: an edge at the top whose segments have changed since is valued again;
    one whose gain has risen meanwhile comes up late. The edges of a segment are a linked list of
    half-edges, 2 e and 2 e + 1.
    """
    # A twin of `segments.agglomerate`: what they weigh differs, and a loop that is given functions
    # is not kept in Numba's cache. What they do to the graph is the same: `kernels.edges`.
    count, edges = rows.shape[0], boundary.size
    following = np.empty(2 * edges, np.int64)
    head, tail = np.empty(count, np.int64), np.empty(count, np.int64)
    seen = np.empty(count, np.int64)
    degree, version = np.zeros(count, np.int64), np.zeros(count, np.int64)
    alive = np.ones(edges, np.bool_)
    valued = np.zeros(edges, np.int64)
    misfit, place = np.zeros(edges), np.empty(edges, np.int64)
    keys, items = np.empty(edges + SPARE), np.empty(edges + SPARE, np.int64)
    list_edges(ends, edges, head, tail, following)
    unite_edges(ends, boundary, alive, head, following, seen)
    for u in range(count):
        root[u] = u
    clear(keys, place)
    size = np.intp(0)
    for edge in range(edges):
        if alive[edge]:
            u, v = ends[edge, 0], ends[edge, 1]
            degree[u] += 1
            degree[v] += 1
            if discords[edge] < APART:
                count_of = min(rows[u, COUNT], rows[v, COUNT])
                misfit[edge] = tempered(discords[edge], count_of)
                gain = _gain(evidence[edge], misfit[edge], boundary[edge], most)
                size = update(keys, items, place, size, edge, gain)
    while size > 0:
        edge, gain = items[0], 0.0
        u, v = ends[edge, 0], ends[edge, 1]
        old = valued[edge] != version[u] + version[v]
        if old:
            valued[edge] = version[u] + version[v]
            gain, misfit[edge] = _merge_gain(rows, u, v, boundary[edge], wander, prior, most)
        size = update(keys, items, place, size, edge, gain)
        if old:
            continue
        if waits[u] or waits[v]:
            waits[u] = waits[v] = True
            continue
        if rows[u, COUNT] < rows[v, COUNT]:
            u, v = v, u
        add_row(rows[u], rows[v])
        rows[u, MISFIT] += misfit[edge]
        write_normal(rows[u])
        version[u] += version[v] + 1
        root[v] = u
        alive[edge] = False
        degree[u] -= 1
        # The edges of v become u's; where both had one to the same neighbour they become one.
        half = head[v]
        while half >= 0:
            after, moved = following[half], half >> 1
            other = ends[moved, 1 - (half & 1)]
            if alive[moved]:
                # An edge between u and the neighbour is in both lists: look into the shorter one.
                walked, wanted = (other, u) if degree[other] < degree[u] else (u, other)
                kept = find_edge(walked, wanted, ends, alive, head, tail, following)
                if kept >= 0:
                    boundary[kept] += boundary[moved]
                    alive[moved] = False
                    degree[other] -= 1
                    # Its gain has risen: it must come up before anything it may now beat.
                    valued[kept] = version[u] + version[other]
                    gain, misfit[kept] = _merge_gain(
                        rows, u, other, boundary[kept], wander, prior, most
                    )
                    size = update(keys, items, place, size, moved, 0.0)
                    size = update(keys, items, place, size, kept, gain)
                else:
                    ends[moved, half & 1] = u
                    degree[u] += 1
                    append_half(u, half, head, tail, following)
            half = after
    write_roots(root)


@compiled
def join_parts(rows, part):  # type: ignore[no-untyped-def]
    """Add every row to the first one of its part, part (n,), as if it did not lean against that."""
    for k in range(part.size):
        if part[k] != k:
            add_row(rows[part[k]], rows[k])
    for k in range(part.size):
        if part[k] == k:
            write_normal(rows[k])


@compiled
def pairs_through_gaps(rows, wander, prior, least, planes, ends, gains):  # type: ignore[no-untyped-def]
    """Pairs of a plane (the first rows) and a later row that may be one plane through a gap.

    prior: as of `agglomerate`; least: nats that a pair has to save. Returns how many there are;
    ends (., 2) and gains (.) take as many as they have room for.
    """
    found = 0
    for i in range(planes):
        for j in range(i + 1, rows.shape[0]):
            cosine = rows[i, NX] * rows[j, NX] + rows[i, NY] * rows[j, NY]
            if abs(cosine + rows[i, NZ] * rows[j, NZ]) < _PARALLEL:
                continue
            discord, evidence = compare(rows, i, j, wander, prior[2], prior[1])
            gain = evidence - 0.5 * discord
            if gain > least:
                if found < gains.size:
                    ends[found, 0], ends[found, 1], gains[found] = i, j, gain
                found += 1
    return found


@in_order
def segment_borders(segment, ends, prices, border, pairs, nats):  # type: ignore[no-untyped-def]
    """Nats of the borders of every segment, and of each pair of them.

    segment (n,): of every cell; ends (m, 2): neighbouring cells. Adds to border; returns how many
    pairs there are.
    """
    found = 0
    for e in range(prices.size):
        u, v = segment[ends[e, 0]], segment[ends[e, 1]]
        if u == v:
            continue
        border[u] += prices[e]
        border[v] += prices[e]
        pairs[found, 0], pairs[found, 1], nats[found] = u, v, prices[e]
        found += 1
    return found
