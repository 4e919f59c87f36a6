"""Loops over the edges of a graph of segments, each a pair of neighbours.

The edges of a segment are a linked list of half-edges: ends[e] = (u, v) is half-edge 2 e of u and
2 e + 1 of v; head and tail are the first and last of each segment, -1 where there is none. All but
`list_edges` are inlined: as calls they would cost the merges a third of their time.
"""

from __future__ import annotations

from planewise.kernels.jit import inlined, internal


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
