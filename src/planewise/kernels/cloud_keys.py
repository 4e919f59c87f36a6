"""Loops that put points in Morton order: extent, how many cubes, keys of a turned grid, a sort.

A key interleaves the bits of the three grid coordinates, so that every cube of an octree is a run
of sorted keys and a shift by three bits goes one level up. The grid is turned against the axes: a
wall that lies along a face of its cubes would be cut into two sheets, and walls love axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.jit import compiled, in_order, inlined

LEVELS = 21  # bits that a grid coordinate has at most


def _turned(z: float, y: float, x: float) -> NDArray[np.float64]:
    """Rotation by such angles about the axes, that about x first."""
    (a, b, c), (d, e, f) = np.cos((z, y, x)), np.sin((z, y, x))
    return np.array(
        [
            [a * b, a * e * f - d * c, a * e * c + d * f],
            [d * b, d * e * f + a * c, d * e * c - a * f],
            [-e, b * f, b * c],
        ]
    )


TURN = _turned(0.3, 0.6, 1.1)
"""Rows are the axes of the grid. No axis of the cloud is near one of them, and cubes lie at all
heights against floors and walls along the axes: at (2, 2, -1) / 3 and the like they lie at three,
and two floors close to each other may share a cube wherever there is one."""


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


@inlined
def middle_of(key, side, middle, turn):  # type: ignore[no-untyped-def]
    """Middle of a cube, relative to the centre of its grid.

    side: of a cube; middle: coordinate of the centre, in cubes; turn: rows are the axes.
    """
    u = (np.float64(gather(key)) + 0.5 - middle) * side
    v = (np.float64(gather(key >> np.uint64(1))) + 0.5 - middle) * side
    w = (np.float64(gather(key >> np.uint64(2))) + 0.5 - middle) * side
    # The turn is orthogonal: its inverse is its transpose.
    return (
        turn[0, 0] * u + turn[1, 0] * v + turn[2, 0] * w,
        turn[0, 1] * u + turn[1, 1] * v + turn[2, 1] * w,
        turn[0, 2] * u + turn[1, 2] * v + turn[2, 2] * w,
    )


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
def mark_cubes(points, centre, side, levels, reach, turn, first, last, bits, again):  # type: ignore[no-untyped-def]
    """Set the bits of the cubes that points[first:last] are in; returns how many are in the grid.

    bits, again (m,) uint64, m a power of two: which of them is a cube's is a hash of where it is;
    it is set in `again` as well with the cube's second point.
    """
    found, scale, mask = 0, 1.0 / side, np.uint64(64 * bits.size - 1)
    middle = float(1 << (levels - 1))
    for i in range(first, last):
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        u = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z
        v = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z
        w = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z
        if min(u, v, w) >= -reach and max(u, v, w) <= reach:
            u, v, w = u * scale + middle, v * scale + middle, w * scale + middle
            bit = np.uint64(u) * np.uint64(0x9E3779B97F4A7C15)
            bit += np.uint64(v) * np.uint64(0xC2B2AE3D27D4EB4F)
            bit += np.uint64(w) * np.uint64(0x165667B19E3779F9)
            bit = (bit ^ (bit >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
            bit = (bit ^ (bit >> np.uint64(32))) & mask
            word, one = bit >> np.uint64(6), np.uint64(1) << (bit & np.uint64(63))
            again[word] |= bits[word] & one
            bits[word] |= one
            found += 1
    return found


@in_order
def count_bits(bits):  # type: ignore[no-untyped-def]
    """How many bits of words (m,) uint64 are set."""
    found = 0
    for k in range(bits.size):
        word = bits[k]
        while word:
            word &= word - np.uint64(1)  # without its lowest bit
            found += 1
    return found


@compiled
def point_keys(points, centre, side, levels, reach, turn, first, last, keys):  # type: ignore[no-untyped-def]
    """Morton keys of points[first:last] in a turned grid of 2^levels cubes along an axis.

    Points that are not finite or lie beyond its reach have the key 8^levels.
    """
    scale, none = 1.0 / side, np.uint64(1) << np.uint64(3 * levels)
    middle = float(1 << (levels - 1))
    for i in range(first, last):
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        u = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z
        v = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z
        w = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z
        # A comparison with NaN is false.
        if min(u, v, w) >= -reach and max(u, v, w) <= reach:
            u, v, w = u * scale + middle, v * scale + middle, w * scale + middle
            keys[i] = spread(u) | (spread(v) << np.uint64(1)) | (spread(w) << np.uint64(2))
        else:
            keys[i] = none


@in_order
def count_digits(keys, shift, first, last, counts):  # type: ignore[no-untyped-def]
    """Count the digits of keys[first:last]; one is as many bits, from `shift` on, as counts say."""
    counts[:] = 0
    mask = np.uint64(counts.size - 1)
    for i in range(first, last):
        counts[(keys[i] >> np.uint64(shift)) & mask] += 1


@in_order
def scatter(keys, rows, shift, first, last, places, sorted_keys, sorted_rows):  # type: ignore[no-untyped-def]
    """Move keys[first:last] and their rows to the places (digits,) of their digits."""
    mask = np.uint64(places.size - 1)
    for i in range(first, last):
        digit = (keys[i] >> np.uint64(shift)) & mask
        at = places[digit]
        places[digit] = at + 1
        sorted_keys[at] = keys[i]
        sorted_rows[at] = rows[i]


@in_order
def run_starts(keys, shift, starts):  # type: ignore[no-untyped-def]
    """Where each run of keys that are equal above `shift` bits begins; returns how many."""
    found = 0
    before = np.uint64(0)
    for i in range(keys.size):
        key = keys[i] >> np.uint64(shift)
        if i == 0 or key != before:
            starts[found] = i
            found += 1
            before = key
    return found
