"""Loops over the cubes of a cloud: which of them lie beside each other."""

from __future__ import annotations

import numpy as np

from planewise.kernels.cloud_keys import gather, spread
from planewise.kernels.jit import in_order

BLOCK = 4  # levels of a block of cubes that find those about them together


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
    shift, at = np.uint64(3 * level), hint
    for step in range(27):
        # Nearly in the order of the keys: each is sought from where the one before was.
        i, j, k = step % 3 - 1, step // 3 % 3 - 1, step // 9 - 1
        direction = 9 * i + 3 * j + k + 13
        out[direction] = -1
        if min(u + i, v + j, w + k) < 0:
            continue
        key = spread(u + i) | (spread(v + j) << np.uint64(1)) | (spread(w + k) << np.uint64(2))
        at = first_at_least(keys, key << shift, at)
        if at < keys.size and keys[at] >> shift == key:
            out[direction] = at


@in_order
def cubes_about(keys, first, last, out):  # type: ignore[no-untyped-def]
    """Where the cubes about cubes[first:last] are, -1 for none.

    keys (n,) of the cubes, sorted. Writes out (n, 27) int32: [13] is the cube itself, [26 - d] lies
    opposite [d].

    A block of 16 x 16 x 16 cubes is a run of keys. It and what is beside it of the 26 blocks about
    it are put into a grid, where all its cubes find theirs.
    """
    below = np.uint64((1 << 3 * BLOCK) - 1)  # bits of a key inside a block
    axes = np.uint64(0x1249) & below, np.uint64(0x2492) & below, np.uint64(0x4924) & below
    wide = (1 << BLOCK) + 2
    place = np.empty(1 << 3 * BLOCK, np.int32)  # of a cube of a block, without its rim
    for k in range(place.size):
        u, v = gather(k), gather(np.uint64(k) >> np.uint64(1))
        w = gather(np.uint64(k) >> np.uint64(2))
        place[k] = (np.int64(u) * wide + np.int64(v)) * wide + np.int64(w)
    most = wide * wide * wide
    grid, filled = np.full(most, -1, np.int32), np.empty(most, np.int32)
    cube = first
    while cube < last:
        block = keys[cube] >> np.uint64(3 * BLOCK)
        u = np.int64(gather(block))
        v = np.int64(gather(block >> np.uint64(1)))
        w = np.int64(gather(block >> np.uint64(2)))
        end, size = cube, 0
        for direction in range(27):
            step = direction // 9 - 1, direction // 3 % 3 - 1, direction % 3 - 1
            i, j, k = step
            if min(u + i, v + j, w + k) < 0:
                continue
            key = spread(u + i) | (spread(v + j) << np.uint64(1)) | (spread(w + k) << np.uint64(2))
            # What is beside the block has no bits of an axis if it lies beyond it, all if before.
            bits = alike = np.uint64(0)
            for axis in range(3):
                if step[axis] != 0:
                    bits |= axes[axis]
                    alike |= axes[axis] if step[axis] < 0 else np.uint64(0)
            shift = (((i << BLOCK) + 1) * wide + (j << BLOCK) + 1) * wide + (k << BLOCK) + 1
            at = first_at_least(keys, key << np.uint64(3 * BLOCK), cube)
            while at < keys.size and keys[at] >> np.uint64(3 * BLOCK) == key:
                if keys[at] & bits == alike:
                    filled[size] = shift + place[keys[at] & below]
                    grid[filled[size]] = at
                    size += 1
                at += 1
            if direction == 13:
                end = min(at, last)
        for at in range(cube, end):
            middle = place[keys[at] & below] + (wide + 1) * wide + 1
            for direction in range(27):
                i, j, k = direction // 9 - 1, direction // 3 % 3 - 1, direction % 3 - 1
                out[at, direction] = grid[middle + (i * wide + j) * wide + k]
        for k in range(size):
            grid[filled[k]] = -1
        cube = end
