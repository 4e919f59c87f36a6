"""Loops over the edges of a graph of segments, each a pair of neighbours.

The edges of a segment are a linked list of half-edges: ends[e] = (u, v) is half-edge 2 e of u and
2 e + 1 of v; head and tail are the first and last of each segment, -1 where there is none. What the
merges ask again and again is inlined: as calls it would cost them a third of their time.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.borders import border_price, list_apart
from planewise.kernels.jit import called, inlined, internal


@inlined
def _add_side(u, v, nats, latest, k, place, ends, boundary, alive, sides):  # type: ignore[no-untyped-def]
    """Add a side between segments u and v to the latest edge, or list it as one of its own."""
    edge = latest[k, place]
    if edge >= 0 and ends[edge, 0] == u and ends[edge, 1] == v:
        boundary[edge] += nats
        return sides
    ends[sides, 0], ends[sides, 1] = u, v
    boundary[sides], alive[sides] = nats, 1
    latest[k, place] = sides
    return sides + 1


@called
def list_sides(  # type: ignore[no-untyped-def]
    unit, discords, price, wraps, ends, boundary, alive, latest, marked, places
):
    """Sides between cells of two segments, as edges with the nats that a merge saves there.

    A side that goes on where the one above it, or to its left, ended is part of the same edge.
    latest (2, columns): edges across the last sides in their direction; marked, places:
    `masks.room_for_runs` of so many.
    """
    rows, columns = unit.shape
    sides = np.intp(0)
    latest[0, :] = latest[1, 0] = -1
    for i in range(rows):
        for n in range(list_apart(unit[i], unit[min(i + 1, rows - 1)], marked, places)):
            j = np.intp(places[n])
            u, column = unit[i, j], j + 1
            if u < 0:
                continue
            if wraps and column == columns:
                column = np.intp(0)
            if column < columns:
                v = unit[i, column]
                if v >= 0 and v != u:
                    nats = border_price(discords[0, i, j], price)
                    sides = _add_side(u, v, nats, latest, 0, j, ends, boundary, alive, sides)
            if i + 1 < rows:
                v = unit[i + 1, j]
                if v >= 0 and v != u:
                    nats = border_price(discords[1, i, j], price)
                    sides = _add_side(u, v, nats, latest, 1, 0, ends, boundary, alive, sides)
    return sides


@inlined
def keep_alive(ends, boundary, alive, sides):  # type: ignore[no-untyped-def]
    """Move the edges that are left to the front. Returns how many there are."""
    edges = np.intp(0)
    for side in range(sides):
        if alive[side]:
            ends[edges, 0], ends[edges, 1] = ends[side, 0], ends[side, 1]
            boundary[edges], alive[edges] = boundary[side], 1
            edges += 1
    return edges


@internal
def list_edges(ends, edges, head, tail, following):  # type: ignore[no-untyped-def]
    """List the half-edges of every segment, in rising order."""
    head[:] = tail[:] = -1
    following[: 2 * edges] = -1
    for half in range(2 * edges):
        u = ends[half >> 1, half & 1]
        if head[u] < 0:
            head[u] = half
        else:
            following[tail[u]] = half
        tail[u] = half


@inlined
def unite_edges(ends, boundary, alive, head, following, seen):  # type: ignore[no-untyped-def]
    """Make one edge of all between the same two segments: boundary adds up, alive is 0 of others.

    seen (n,): room to work in, the edge to each neighbour.
    """
    seen[:] = -1
    for u in range(head.size):
        half = head[u]
        while half >= 0:
            edge = half >> 1
            other = ends[edge, 1 - (half & 1)]
            if alive[edge]:
                if seen[other] >= 0:
                    boundary[seen[other]] += boundary[edge]
                    alive[edge] = 0
                else:
                    seen[other] = edge
            half = following[half]
        half = head[u]
        while half >= 0:
            seen[ends[half >> 1, 1 - (half & 1)]] = -1
            half = following[half]


@inlined
def find_edge(u, v, ends, alive, head, tail, following):  # type: ignore[no-untyped-def]
    """Edge of segment u to v, -1 where there is none. Dead edges on the way leave the list of u."""
    found = -1
    link, before = head[u], -1
    while link >= 0 and found < 0:
        if not alive[link >> 1]:
            if before < 0:
                head[u] = following[link]
            else:
                following[before] = following[link]
            if tail[u] == link:
                tail[u] = before
        else:
            before = link
            if ends[link >> 1, 1 - (link & 1)] == v:
                found = link >> 1
        link = following[link]
    return found


@inlined
def append_half(u, half, head, tail, following):  # type: ignore[no-untyped-def]
    """Put a half-edge at the end of the list of segment u."""
    following[half] = -1
    if tail[u] < 0:
        head[u] = half
    else:
        following[tail[u]] = half
    tail[u] = half


@inlined
def write_roots(root):  # type: ignore[no-untyped-def]
    """Replace what each segment has become part of by the root of it."""
    for u in range(root.size):
        top = root[u]
        while root[top] != top:
            top = root[top]
        root[u] = top
