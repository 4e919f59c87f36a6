"""Loops over pairs of patches that are neighbours."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import in_order


@in_order
def pairs_once(ends, values, count):  # type: ignore[no-untyped-def]
    """Keep every pair once, where it comes first, and add up its values. Returns how many are left.

    ends (m, 2): of 0 ... count - 1, in either order; values (m,). Both are changed.
    """
    head = np.full(count, -1, np.int32)  # of a list of the pairs whose smaller end it is
    first = np.full(count, -1, np.int32)  # the last pair found whose larger end it is
    following = np.empty(values.size, np.int32)
    for e in range(values.size - 1, -1, -1):
        u = min(ends[e, 0], ends[e, 1])
        following[e] = head[u]
        head[u] = e
    for u in range(count):
        e = head[u]
        while e >= 0:
            v = max(ends[e, 0], ends[e, 1])
            k = first[v]
            if k >= 0 and min(ends[k, 0], ends[k, 1]) == u:
                values[k] += values[e]
                ends[e, 0] = ends[e, 1] = count  # comes again
            else:
                first[v] = e
            e = following[e]
    found = 0
    for e in range(values.size):
        if ends[e, 0] < count:
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
            sums[j, 1] += 0.5 * weights[e] * (values[u] ** 2 + values[v] ** 2)
            sums[j, 2] += weights[e]
