"""Loops over pairs of patches or segments that are neighbours."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import in_order, internal


@internal
def first_of_pairs(ends, count, first):  # type: ignore[no-untyped-def]
    """Find where every pair comes for the first time: writes first (m,).

    ends (m, 2): of 0 ... count - 1, in either order.
    """
    head = np.empty(count, np.int32)  # of a list of the pairs whose smaller end it is
    latest = np.empty(count, np.int32)  # the last new pair whose larger end it is
    head[:] = latest[:] = -1
    for e in range(first.size - 1, -1, -1):
        u = min(ends[e, 0], ends[e, 1])
        first[e], head[u] = head[u], e  # first: until its turn comes, what follows in the list
    for u in range(count):
        e = head[u]
        while e >= 0:
            v, following = max(ends[e, 0], ends[e, 1]), first[e]
            k = latest[v]
            if k < 0 or min(ends[k, 0], ends[k, 1]) != u:
                k = latest[v] = e
            first[e] = k
            e = following


@in_order
def pairs_once(ends, values, count):  # type: ignore[no-untyped-def]
    """Keep every pair once, where it comes first, and add up its values. Returns how many are left.

    ends (m, 2): of 0 ... count - 1, in either order; values (m,). Both are changed.
    """
    first = np.empty(values.size, np.int32)
    first_of_pairs(ends, count, first)
    for e in range(values.size):
        if first[e] != e:
            values[first[e]] += values[e]
    found = 0
    for e in range(values.size):
        if first[e] == e:
            ends[found, 0], ends[found, 1], values[found] = ends[e, 0], ends[e, 1], values[e]
            found += 1
    return found


@in_order
def pairs_between(ends, values, part_of, out, out_values):  # type: ignore[no-untyped-def]
    """Pairs of what the ends of pairs are part of, without those inside one; returns how many."""
    found = 0
    for e in range(values.size):
        u, v = part_of[ends[e, 0]], part_of[ends[e, 1]]
        if u != v:
            out[found, 0], out[found, 1], out_values[found] = u, v, values[e]
            found += 1
    return found


@in_order
def add_products(ends, weights, part_of, values, sums):  # type: ignore[no-untyped-def]
    """Add up, of pairs inside one part, the products of their values and the mean squares.

    ends (m, 2) and weights (m,) of pairs; part_of (n,): -1 for none; values (n,). Adds to sums (N,
    3), of every part; the last of them is the sum of the weights.
    """
    for e in range(weights.size):
        u, v = ends[e, 0], ends[e, 1]
        j = part_of[u]
        if j >= 0 and j == part_of[v]:
            sums[j, 0] += weights[e] * values[u] * values[v]
            sums[j, 1] += 0.5 * weights[e] * (values[u] * values[u] + values[v] * values[v])
            sums[j, 2] += weights[e]
