"""Loops over groups: the readings of one label in one square block of cells.

Where a block has one label its moments are those of a tile of cells (`kernels.cells`). Elsewhere
its readings are added up one by one. Groups are columns of an array of moments whose last entry is
the sum of 1/2 ln(2 pi sigma_z^2 / eps^2): first one for every block, empty where the block has
several labels, then those of blocks with several.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cells import COUNT, PRODUCT, SIDE, add_reading
from planewise.kernels.jit import called, compiled, internal

# Threes of pixels and of cells are written out below, which makes them vector code.
BLOCK = 3 * SIDE  # pixels of a block, whose readings share an offset and a tilt
NORM, ROW = PRODUCT, PRODUCT + 1
NONE, SEVERAL = np.int32(-1), np.int32(-2)  # instead of the label of a cell or block
LAST = np.uint16(65535)
# Unsigned indices spare the check for negative ones.
_0, _1 = np.uintp(0), np.uintp(1)


@called
def thirds(least, most, low, high):  # type: ignore[no-untyped-def]
    """Smallest and largest of every three labels."""
    for j in range(low.size):
        low[j] = min(least[3 * j], min(least[3 * j + 1], least[3 * j + 2]))
        high[j] = max(most[3 * j], max(most[3 * j + 1], most[3 * j + 2]))


@compiled
def label_blocks(labels, p, block, work):  # type: ignore[no-untyped-def]
    """Label of all readings of every block, NONE or SEVERAL; returns how many have SEVERAL.

    labels (H, W) uint16, p (H, W) float32. Writes block (rows, columns); works in work (6, 9
    columns) uint16.
    """
    several = 0
    height, width = labels.shape
    wide = block.shape[1]
    least, most = work[0], work[1]
    low, high = work[2, : 3 * wide], work[3, : 3 * wide]
    lows, highs = work[4, :wide], work[5, :wide]
    for i in range(block.shape[0]):
        for x in range(least.size):
            least[x], most[x] = LAST, 0
        for y in range(BLOCK * i, min(BLOCK * (i + 1), height)):
            row, weight = labels[y], p[y]
            for x in range(width):
                label, smallest = row[x], least[x]
                least[x] = min(smallest, label if weight[x] > 0.0 else LAST)
            for x in range(width):
                label, largest = row[x], most[x]
                most[x] = max(largest, label if weight[x] > 0.0 else np.uint16(0))
        thirds(least, most, low, high)
        thirds(low, high, lows, highs)
        for j in range(wide):
            one = np.int32(lows[j]) if lows[j] == highs[j] else SEVERAL
            block[i, j] = NONE if lows[j] > highs[j] else one
            several += block[i, j] == SEVERAL
    return several


@internal
def _place(names, found, label):  # type: ignore[no-untyped-def]
    """Place of a label among those found in a block; the next one if it is not yet."""
    for k in range(found):
        if names[k] == label:
            return k
    names[found] = label
    return found


@compiled
def sum_groups(  # type: ignore[no-untyped-def]
    labels, w, p, x, y, block, white, constant, first, moments, label, readings
):
    """Moments and labels of all groups; returns their number, or -1 if there is no room for them.

    w, p, x, y as of `kernels.labels`; white: noise of the frame against its description; constant:
    ln(2 pi white / eps^2). moments (12, .) begins with those of `correct_tiles`, of which only the
    count is changed: there is no group where a block has several. Writes first (blocks with several
    labels + 1,), where the groups of each begin and end; readings (N + 1,): those of every label.
    """
    height, width = labels.shape
    own = _1 if x.shape[0] > 1 else _0
    names = np.empty(BLOCK * BLOCK, np.int32)
    sums = np.empty((names.size, NORM + 2))
    for k in range(names.size):
        for e in range(NORM + 1):
            sums[k, e] = 0.0
        sums[k, ROW] = 1.0  # product of p w^4 in a row of a block
    for k in range(readings.size):
        readings[k] = 0
    blocks, end = 0, block.size
    for i in range(block.shape[0]):
        for j in range(block.shape[1]):
            g, mine = i * block.shape[1] + j, block[i, j]
            label[g] = mine if mine > 0 else 0
            if mine >= 0:
                readings[mine] += np.int64(moments[COUNT, g])
            else:
                moments[COUNT, g] = 0.0
            if mine != SEVERAL:
                continue
            found = _0
            for v in range(BLOCK * i, min(BLOCK * (i + 1), height)):
                for u in range(BLOCK * j, min(BLOCK * (j + 1), width)):
                    r, c = np.uintp(v), np.uintp(u)
                    if p[r, c] > 0.0:
                        k = _place(names, found, np.int32(labels[r, c]))
                        found = max(found, k + _1)
                        add_reading(sums[k], p[r, c], x[own * r, c], y[r, own * c], w[r, c])
                        sums[k, COUNT] += 1.0
                        square = np.float64(w[r, c]) * w[r, c]
                        sums[k, ROW] *= p[r, c] * square * square
                for k in range(found):
                    sums[k, NORM] += math.log(sums[k, ROW])
                    sums[k, ROW] = 1.0
            first[blocks] = end
            blocks += 1
            if end + np.int64(found) > label.size:
                return -1
            for k in range(found):
                moments[NORM, end] = 0.5 * (constant * sums[k, COUNT] - sums[k, NORM])
                sums[k, NORM] = 0.0
                for e in range(NORM):
                    moments[e, end] = sums[k, e] if e == COUNT else sums[k, e] / white
                    sums[k, e] = 0.0
                label[end] = names[k]
                readings[names[k]] += np.int64(moments[COUNT, end])
                end += 1
    first[blocks] = end
    return end


@compiled
def tile_means(tiles, means):  # type: ignore[no-untyped-def]
    """Mean x, y and w of the readings of every block, 1 where there are none: means (3, blocks).

    tiles: as `kernels.cells.cell_moments` writes them.
    """
    wide = tiles.shape[2]
    for i in range(tiles.shape[0]):
        weight = tiles[i, 0]
        for e, out in ((1, means[0]), (2, means[1]), (6, means[2])):
            row = tiles[i, e]
            for j in range(wide):
                out[i * wide + j] = row[j] / weight[j] if weight[j] > 0.0 else 1.0


@compiled
def correct_tiles(tiles, white, constant, factor, finer, moments):  # type: ignore[no-untyped-def]
    """Moments (12, blocks) of all readings of every block, be they one group or several.

    tiles: as `kernels.cells.cell_moments` writes them; white, constant: as `sum_groups` takes them;
    factor (blocks,): what w is multiplied by; finer (blocks or 0,): added to every reading's norm.
    """
    wide = tiles.shape[2]
    for i in range(tiles.shape[0]):
        for e in range(moments.shape[0]):
            row, count = tiles[i, e], tiles[i, COUNT]
            for j in range(wide):
                g = i * wide + j
                value = row[j] / white
                if e >= 6:
                    value *= factor[g] if e < 9 else factor[g] * factor[g]
                if e == COUNT:
                    value = row[j]
                if e == NORM:
                    value = 0.5 * (constant * count[j] - row[j])
                moments[e, g] = value
    for g in range(finer.size):
        moments[NORM, g] += moments[COUNT, g] * finer[g]


@compiled
def correct_groups(moments, first, block, factor, finer):  # type: ignore[no-untyped-def]
    """`correct_tiles` for the groups of blocks with several; first, block: `sum_groups`."""
    several = 0
    blocks = block.reshape(-1)
    for b in range(blocks.size):
        if blocks[b] != SEVERAL:
            continue
        for g in range(first[several], first[several + 1]):
            for e in range(6, 9):
                moments[e, g] *= factor[b]
            moments[9, g] *= factor[b] * factor[b]
            if finer.size > 0:
                moments[NORM, g] += moments[COUNT, g] * finer[b]
        several += 1


@compiled
def merge_groups(moments, label, first, place):  # type: ignore[no-untyped-def]
    """Give groups other labels, place (N + 1,) of those that they have; all as of `sum_groups`.

    Of the groups of a block that then have the same label the first takes over the readings.
    """
    for g in range(first[-1]):
        label[g] = place[np.uintp(label[g])]
    for b in range(first.size - 1):
        for g in range(first[b], first[b + 1]):
            for other in range(g + 1, first[b + 1]):
                if label[other] == label[g]:
                    for e in range(NORM + 1):
                        moments[e, g] += moments[e, other]
                        moments[e, other] = 0.0
