"""Loops over the pixels of a depth image: which depths occur, and images of inverse depth.

Depths are told apart by their level: the raw value of integer depth, round(per_metre z) of metres.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import in_order, inlined

_STRIP = 8192  # pixels that a 16-bit number can count


@in_order
def mark_levels(raw, low, high, seen):  # type: ignore[no-untyped-def]
    """seen[v] = True for every value v of raw (pixels,) uint16; seen (65536,) bool.

    Returns how many values are low <= v <= high, and how many are not zero; 0 < low, high < 65536.
    """
    count = present = 0
    least, most = np.uint16(min(low, high)), np.uint16(high)
    for start in range(0, raw.size, _STRIP):
        strip = raw[start : start + _STRIP]
        inside = there = np.uint16(0)  # narrow counts are narrow lanes
        for j in range(strip.size):
            there = np.uint16(there + (strip[j] > 0))
            inside = np.uint16(inside + ((least <= strip[j]) & (strip[j] <= most)))
        count += int(inside)
        present += int(there)
        for j in range(strip.size):
            # Most have been seen before, which is easy to foresee, and stores are dear.
            if not seen[strip[j]]:
                seen[strip[j]] = True
    return (count if low <= high else 0), present


@in_order
def mark_depths(z, low, high, per_metre, reading):  # type: ignore[no-untyped-def]
    """Write one depth of every level into reading.

    Returns how many depths are in range, how many finite and positive, and how many negative.
    """
    count = present = negative = 0
    for i in range(z.shape[0]):
        row = z[i]
        for j in range(row.size):
            count += low <= row[j] <= high
            present += 0.0 < row[j] < np.inf
            negative += row[j] < 0.0
        for j in range(row.size):
            if low <= row[j] <= high:
                reading[int(per_metre * np.float64(row[j]) + 0.5)] = row[j]
    return count, present, negative


@in_order
def look_up_levels(raw, inverse, precision, w, p):  # type: ignore[no-untyped-def]
    """Inverse depth w and its precision p (H, W) from tables by level, 0 for no reading."""
    last = precision.size - 1
    for i in range(raw.shape[0]):
        row = raw[i]
        for j in range(row.size):
            level = row[j] if row[j] < last else last
            w[i, j] = inverse[level]
            p[i, j] = precision[level]


@in_order
def look_up_depths(z, low, high, per_metre, precision, w, p):  # type: ignore[no-untyped-def]
    """`look_up_levels` for metres, of which low <= z <= high are readings."""
    for i in range(z.shape[0]):
        row = z[i]
        for j in range(row.size):
            w[i, j] = p[i, j] = 0.0
            if low <= row[j] <= high:
                depth = np.float64(row[j])
                w[i, j] = 1.0 / depth
                p[i, j] = precision[int(per_metre * depth + 0.5)]


@in_order
def fill_between(levels, values, table):  # type: ignore[no-untyped-def]
    """Values (E, n) at levels to a table (E, .) of all levels: linear between, constant beyond."""
    last = levels.size - 1
    for e in range(values.shape[0]):
        row = table[e]
        for k in range(levels[0]):
            row[k] = values[e, 0]
        for n in range(last):
            low, rise = values[e, n], values[e, n + 1] - values[e, n]
            gap = levels[n + 1] - levels[n]
            for k in range(gap):
                row[levels[n] + k] = low + rise * (k / gap)
        for k in range(levels[last], row.size):
            row[k] = values[e, last]


@in_order
def running_medians(values, half, out):  # type: ignore[no-untyped-def]
    """Medians of the 2 half + 1 values about every one, mirrored at the ends: writes out (n,).

    values (n,): whole numbers, n > half.
    """
    size, window = values.size, np.empty(2 * half + 1, np.int64)
    for k in range(-half, half + 1):
        _insert(window, k + half, values[abs(k)])
    out[0] = window[half]
    for n in range(1, size):
        gone, new = abs(n - half - 1), n + half
        new = new if new < size else 2 * (size - 1) - new
        at = 0
        while window[at] != values[gone]:
            at += 1
        for k in range(at, 2 * half):
            window[k] = window[k + 1]
        _insert(window, 2 * half, values[new])
        out[n] = window[half]


@inlined
def _insert(window, size, value):  # type: ignore[no-untyped-def]
    """Insert a value among the first ones, which are in rising order."""
    while size > 0 and window[size - 1] > value:
        window[size] = window[size - 1]
        size -= 1
    window[size] = value
