"""Loops over groups: the readings of one label in one square block of cells.

Where a block has one label its moments are those of its cells. Elsewhere the readings of cells with
several labels are added up one by one. Groups are columns of an array of moments (`kernels.cells`)
whose last entry is the sum of 1/2 ln(2 pi sigma_z^2 / eps^2): first one for every block, empty
where the block has several labels, then those of blocks with several.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cells import COUNT, PRODUCT, SIDE
from planewise.kernels.elementary import logarithm
from planewise.kernels.jit import compiled, internal

# Threes of pixels and of cells are written out below, which makes them vector code.
BLOCK = 3 * SIDE  # pixels of a block, whose readings share an offset and a tilt
NORM, CELL = PRODUCT, PRODUCT + 1
NONE, SEVERAL = np.int32(-1), np.int32(-2)  # instead of the label of a cell or block
LAST = np.uint16(65535)
# Unsigned indices spare the check for negative ones.
_0, _1, _PRODUCT = np.uintp(0), np.uintp(1), np.uintp(PRODUCT)


@internal
def thirds(least, most, low, high):  # type: ignore[no-untyped-def]
    """Smallest and largest of every three labels."""
    for j in range(low.size):
        low[j] = min(least[3 * j], min(least[3 * j + 1], least[3 * j + 2]))
        high[j] = max(most[3 * j], max(most[3 * j + 1], most[3 * j + 2]))


@compiled
def label_cells(labels, p, cell, block, work):  # type: ignore[no-untyped-def]
    """Label of all readings of every cell and of every block, NONE or SEVERAL.

    labels (H, W) uint16, p (H, W) float32. Writes cell (rows, columns) and block, a third as large;
    works in work (6, 9 * columns of block) uint16. Returns how many cells and blocks have SEVERAL.
    """
    several_cells = several_blocks = 0
    height, width = labels.shape
    rows, columns = cell.shape
    wide = block.shape[1]
    least, most = work[0], work[1]
    low, high, lows, highs = (
        work[2, : 3 * wide],
        work[3, : 3 * wide],
        work[4, : 3 * wide],
        work[5, : 3 * wide],
    )
    for i in range(block.shape[0]):
        for j in range(lows.size):
            lows[j], highs[j] = LAST, 0
        for a in range(3 * i, min(3 * i + 3, rows)):
            for x in range(least.size):
                least[x], most[x] = LAST, 0
            for y in range(SIDE * a, min(SIDE * (a + 1), height)):
                row, weight = labels[y], p[y]
                for x in range(width):
                    label, smallest = row[x], least[x]
                    least[x] = min(smallest, label if weight[x] > 0.0 else LAST)
                for x in range(width):
                    label, largest = row[x], most[x]
                    most[x] = max(largest, label if weight[x] > 0.0 else np.uint16(0))
            thirds(least, most, low, high)
            for j in range(low.size):
                lows[j], highs[j] = min(lows[j], low[j]), max(highs[j], high[j])
            out = cell[a]
            for j in range(columns):
                one = np.int32(low[j]) if low[j] == high[j] else SEVERAL
                out[j] = NONE if low[j] > high[j] else one
                several_cells += out[j] == SEVERAL
        thirds(lows, highs, low[:wide], high[:wide])
        for j in range(wide):
            one = np.int32(low[j]) if low[j] == high[j] else SEVERAL
            block[i, j] = NONE if low[j] > high[j] else one
            several_blocks += block[i, j] == SEVERAL
    return several_cells, several_blocks


@compiled
def sum_blocks(cells, white, constant, moments):  # type: ignore[no-untyped-def]
    """Moments (12, blocks) of all readings of every block, be they one group or several.

    cells, white, constant: as `sum_groups` takes them.
    """
    rows, _, columns = cells.shape
    wide = -(-columns // 3)
    line = np.empty(3 * wide)
    line[columns:] = 0.0
    for i in range(-(-rows // 3)):
        start = i * wide
        for e in range(NORM + 1):
            for j in range(columns):
                line[j] = 0.0
            for a in range(3 * i, min(3 * i + 3, rows)):
                row = cells[a, e]
                if e == PRODUCT:
                    for j in range(columns):
                        line[j] += logarithm(row[j])
                else:
                    for j in range(columns):
                        line[j] += row[j]
            scale = -0.5 if e == NORM else 1.0 if e == COUNT else 1.0 / white
            out = moments[e, start : start + wide]
            for j in range(wide):
                out[j] = scale * (line[3 * j] + line[3 * j + 1] + line[3 * j + 2])
    norm, count = moments[NORM], moments[COUNT]
    for g in range(norm.size):
        norm[g] += 0.5 * constant * count[g]


@internal
def _place(names, found, label):  # type: ignore[no-untyped-def]
    """Place of a label among those found in a block; the next one if it is not yet."""
    for k in range(found):
        if names[k] == label:
            return k
    names[found] = label
    return found


@internal
def _add_reading(m, p, a, b, w):  # type: ignore[no-untyped-def]
    """Add a reading of inverse depth w at (a, b) to a row of moments and a product of p w^4."""
    weight, v = np.float64(p), np.float64(w)
    pa, pb, pv = weight * a, weight * b, weight * v
    m[0] += weight
    m[1] += pa
    m[2] += pb
    m[3] += pa * a
    m[4] += pa * b
    m[5] += pb * b
    m[6] += pv
    m[7] += pv * a
    m[8] += pv * b
    m[9] += pv * v
    m[COUNT] += 1.0
    m[CELL] *= weight * v * v * v * v


@compiled
def sum_groups(  # type: ignore[no-untyped-def]
    labels, w, p, x, y, cells, cell, block, white, constant, first, moments, label, readings
):
    """Moments and labels of all groups.

    w, p, x, y as of `kernels.labels`; cells (rows, 12, columns): moments of cells; white: noise of
    the frame against its description; constant: ln(2 pi white / eps^2). moments (12, .) begins with
    those of `sum_blocks`, of which only the count is changed: there is no group where a block has
    several. Writes first (blocks with several labels + 1,), where the groups of each begin and end;
    adds to readings (N + 1,) those of every label.
    """
    height, width = labels.shape
    rows, columns = cell.shape
    own = _1 if x.shape[0] > 1 else _0
    names = np.empty(BLOCK * BLOCK, np.int32)
    sums = np.empty((names.size, NORM + 2))
    for k in range(names.size):
        for e in range(NORM + 1):
            sums[k, e] = 0.0
        sums[k, CELL] = 1.0  # product of p w^4 in one cell
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
            for a in range(3 * i, min(3 * i + 3, rows)):
                for b in range(3 * j, min(3 * j + 3, columns)):
                    r, c = np.uintp(a), np.uintp(b)
                    one = cell[r, c]
                    if one >= 0:
                        k = _place(names, found, one)
                        found = max(found, k + _1)
                        for e in range(NORM):
                            sums[k, e] += cells[r, np.uintp(e), c]
                        sums[k, NORM] += math.log(cells[r, _PRODUCT, c])
                    elif one == SEVERAL:
                        for v in range(SIDE * a, min(SIDE * (a + 1), height)):
                            for u in range(SIDE * b, min(SIDE * (b + 1), width)):
                                r, c = np.uintp(v), np.uintp(u)
                                if p[r, c] > 0.0:
                                    k = _place(names, found, np.int32(labels[r, c]))
                                    found = max(found, k + _1)
                                    across, down = x[own * r, c], y[r, own * c]
                                    _add_reading(sums[k], p[r, c], across, down, w[r, c])
                        for k in range(found):
                            sums[k, NORM] += math.log(sums[k, CELL])
                            sums[k, CELL] = 1.0
            first[blocks] = end
            blocks += 1
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


@compiled
def block_means(moments, means):  # type: ignore[no-untyped-def]
    """Mean x, y and w of the readings of every block, 1 where there are none: means (3, blocks)."""
    weight = moments[0]
    for e, out in ((1, means[0]), (2, means[1]), (6, means[2])):
        row = moments[e]
        for g in range(out.size):
            out[g] = row[g] / weight[g] if weight[g] > 0.0 else 1.0


@compiled
def correct_blocks(moments, factor, finer):  # type: ignore[no-untyped-def]
    """Multiply w by a factor (blocks,), and add finer (blocks or 0,) to every reading's norm."""
    for e, power in ((6, 1), (7, 1), (8, 1), (9, 2)):
        row = moments[e]
        for g in range(factor.size):
            row[g] *= factor[g] if power == 1 else factor[g] * factor[g]
    for g in range(finer.size):
        moments[NORM, g] += moments[COUNT, g] * finer[g]


@compiled
def correct_groups(moments, first, block, factor, finer):  # type: ignore[no-untyped-def]
    """`correct_blocks` for the groups of blocks with several; first, block: `sum_groups`."""
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
