"""Loops that put points in Morton order: their extent, keys of a turned grid, a radix sort.

A key interleaves the bits of the three grid coordinates, so that every cube of an octree is a run
of sorted keys and a shift by three bits goes one level up. The grid is turned against the axes: a
wall that lies along a face of its cubes would be cut into two sheets, and walls love axes.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import compiled, in_order, inlined

LEVELS = 21  # bits of a grid coordinate
NO_KEY = np.uint64(0xFFFFFFFFFFFFFFFF)  # of a point that is not finite or too far off
DIGIT = 11  # bits a pass of the sort
# Rows are the axes of the grid: no axis of the cloud is near one of them.
TURN = np.array([[2.0, 2.0, -1.0], [-1.0, 2.0, 2.0], [2.0, -1.0, 2.0]]) / 3.0


@inlined
def spread(x):  # type: ignore[no-untyped-def]
    """Bits of a number of 21 bits, two zeros between them."""
    x = np.uint64(x)
    x = (x | (x << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    x = (x | (x << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x1249249249249249)


@inlined
def gather(x):  # type: ignore[no-untyped-def]
    """Every third bit of a key: the inverse of `spread`."""
    x = np.uint64(x) & np.uint64(0x1249249249249249)
    x = (x | (x >> np.uint64(2))) & np.uint64(0x10C30C30C30C30C3)
    x = (x | (x >> np.uint64(4))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x >> np.uint64(8))) & np.uint64(0x1F0000FF0000FF)
    x = (x | (x >> np.uint64(16))) & np.uint64(0x1F00000000FFFF)
    return (x | (x >> np.uint64(32))) & np.uint64(0x1FFFFF)


@in_order
def extent(points, first, last, part, low, high, count):  # type: ignore[no-untyped-def]
    """Least and largest coordinates of the finite ones of points[first:last], and their number.

    Writes row `part` of low and high (parts, 3) and count (parts,).
    """
    for e in range(3):
        low[part, e], high[part, e] = np.inf, -np.inf
    found = 0
    for i in range(first, last):
        x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        if np.isfinite(x + y + z):
            found += 1
            low[part, 0], high[part, 0] = min(low[part, 0], x), max(high[part, 0], x)
            low[part, 1], high[part, 1] = min(low[part, 1], y), max(high[part, 1], y)
            low[part, 2], high[part, 2] = min(low[part, 2], z), max(high[part, 2], z)
    count[part] = found


@compiled
def point_keys(points, centre, side, turn, first, last, keys):  # type: ignore[no-untyped-def]
    """Morton keys of points[first:last] in a turned grid of cubes `side` about the centre."""
    scale = 1.0 / side
    middle, most = float(1 << (LEVELS - 1)), float((1 << LEVELS) - 1)
    for i in range(first, last):
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        u = (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z) * scale + middle
        v = (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z) * scale + middle
        w = (turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z) * scale + middle
        # A comparison with NaN is false.
        if min(u, v, w) >= 0.0 and max(u, v, w) < most:
            keys[i] = spread(u) | (spread(v) << np.uint64(1)) | (spread(w) << np.uint64(2))
        else:
            keys[i] = NO_KEY


@in_order
def count_digits(keys, shift, first, last, counts):  # type: ignore[no-untyped-def]
    """Count the digits (``DIGIT`` bits from `shift` on) of keys[first:last]."""
    counts[:] = 0
    mask = np.uint64((1 << DIGIT) - 1)
    for i in range(first, last):
        counts[(keys[i] >> np.uint64(shift)) & mask] += 1


@in_order
def scatter(keys, order, shift, first, last, places, sorted_keys, sorted_order):  # type: ignore[no-untyped-def]
    """Move keys[first:last] and their order to where their digits belong, places (2^DIGIT,)."""
    mask = np.uint64((1 << DIGIT) - 1)
    for i in range(first, last):
        digit = (keys[i] >> np.uint64(shift)) & mask
        at = places[digit]
        places[digit] = at + 1
        sorted_keys[at] = keys[i]
        sorted_order[at] = order[i]


@in_order
def separations(keys, counts):  # type: ignore[no-untyped-def]
    """Count neighbours in sorted keys by the level at which they part.

    counts (LEVELS + 1,): at [l], pairs whose cubes of level l - 1 (side 2^(l - 1)) differ and whose
    cubes of level l are one; [0] are equal keys.
    """
    counts[:] = 0
    for i in range(1, keys.size):
        differ = keys[i] ^ keys[i - 1]
        level = 0
        while differ:
            differ >>= np.uint64(3)
            level += 1
        counts[level] += 1


@in_order
def run_starts(keys, shift, starts):  # type: ignore[no-untyped-def]
    """Where each run of keys that are equal above `shift` bits begins; returns how many."""
    found = 0
    before = NO_KEY
    for i in range(keys.size):
        key = keys[i] >> np.uint64(shift)
        if i == 0 or key != before:
            starts[found] = i
            found += 1
            before = key
    return found
