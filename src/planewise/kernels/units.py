"""Loops over the units of a frame (`spatial.cells.Cells`) once pixels have labels.

label (H, W) uint16: 0 for no plane, p (H, W) float32: 0 without a reading; grid (rows, columns):
unit of every cell, -1 for none; rows (units, 13): their segments (`kernels.cells`); inside
(units,): label of every unit whose pixels all have it, 0 of the others. Unsigned indices spare the
check for negative ones.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import SIDE
from planewise.kernels.groups import LAST
from planewise.kernels.jit import compiled

_NONE = np.int32(0)
_0, _1, _2 = np.uintp(0), np.uintp(1), np.uintp(2)


@compiled
def units_inside(label, p, holes, grid, inside):  # type: ignore[no-untyped-def]
    """Write inside; holes: whether pixels without a reading count, as on no plane."""
    width = label.shape[1]
    rows, columns = grid.shape
    least, most = np.empty((2, SIDE * columns + 2), label.dtype)
    same = np.empty(SIDE * columns, label.dtype)
    for k in range(inside.size):
        inside[k] = -1
    for r in range(rows):
        for j in range(least.size):
            least[j], most[j] = LAST, 0
        for i in range(r * SIDE, min((r + 1) * SIDE, label.shape[0])):
            row, weight = label[i], p[i]
            for j in range(width):
                most[j] = max(most[j], row[j])
            if holes:
                for j in range(width):
                    least[j] = min(least[j], row[j])
            else:
                for j in range(width):
                    least[j] = min(least[j], row[j] if weight[j] > 0.0 else LAST)
        # Of any three pixels side by side, which is cheaper than to pick out every third.
        for j in range(same.size):
            low = min(least[j], min(least[j + 1], least[j + 2]))
            high = max(most[j], max(most[j + 1], most[j + 2]))
            same[j] = low if low == high else np.uint16(0)
        units = grid[r]
        for c in range(columns):
            if units[c] >= 0:
                unit, mine = np.uintp(units[c]), np.int32(same[SIDE * c])
                before = inside[unit]
                inside[unit] = mine if (before < 0) | (before == mine) else _NONE


@compiled
def sum_units(rows, inside, sums, count):  # type: ignore[no-untyped-def]
    """Add the units' rows up by label: sums (labels, .) and how many there are, count (labels,)."""
    for label in range(count.size):
        count[label] = 0
        for e in range(sums.shape[1]):
            sums[label, e] = 0.0
    for k in range(inside.size):
        mine, row = np.uintp(inside[k]), rows[k]
        for e in range(row.size):
            sums[mine, np.uintp(e)] += row[e]
        count[mine] += 1


@compiled
def correlate(grid, rows, inside, planes, off, out):  # type: ignore[no-untyped-def]
    """Sums over units side by side inside the same label: writes out (labels, 3).

    Of their residuals in standard deviations: the product, the mean square; and of pairs. planes
    (labels, 3): (t0, t1, t2) of w = t0 + t1 x + t2 y; off (units,): room to work in.
    """
    for k in range(off.size):
        if inside[k] == 0:
            continue
        m, mine = rows[k], np.uintp(inside[k])
        t0, t1, t2 = planes[mine, _0], planes[mine, _1], planes[mine, _2]
        off[k] = (m[6] - t0 * m[0] - t1 * m[1] - t2 * m[2]) / np.sqrt(m[0])
    for n in range(out.shape[0]):
        out[n, 0] = out[n, 1] = out[n, 2] = 0.0
    height, width = grid.shape
    grid = grid.reshape(-1)
    current, product, square, pairs = np.int32(0), 0.0, 0.0, 0.0
    for r in range(height):
        for down in range(2 if r + 1 < height else 1):
            at, step = np.uintp(r * width), np.uintp(width if down else 1)
            for _ in range(width - 1 + down):
                a, b = grid[at], grid[at + step]
                at += _1
                here = np.uintp(max(a, 0))
                label = inside[here]
                if label == 0 or a == b or a < 0 or b < 0:
                    continue
                there = np.uintp(b)
                if inside[there] == label:
                    if label != current:
                        out[current, 0], out[current, 1], out[current, 2] = product, square, pairs
                        product, square, pairs = out[label, 0], out[label, 1], out[label, 2]
                        current = label
                    s, t = off[here], off[there]
                    product += s * t
                    square += 0.5 * (s * s + t * t)
                    pairs += 1.0
    out[current, 0], out[current, 1], out[current, 2] = product, square, pairs
