"""Loops over pixels near the borders of segments: which plane each of them is on.

Planes are rows (t0, t1, t2) of inverse depth w = t0 + t1 x + t2 y; row 0 is no plane. w, p, x, y
(H, W): inverse depth, its weight (0 without a reading), coordinates; x (1, W) and y (H, 1) where
all rows or columns are alike (`Sectors.coordinates`), which spares the cache. The variance of a
reading is looked up by its depth, or range (`kernels.tables`).

While they change, labels have a margin of a pixel and are `NONE` there and wherever there is no
reading. An image of the same layout holds the pixels' states: 0, waiting for a look, `FIXED`, or
both. A flag of `busy` or `seen` stands for `CHUNK` pixels of such a row. Unsigned indices spare the
check for negative ones.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import SIDE
from planewise.kernels.jit import compiled, internal
from planewise.kernels.tables import reading_variance

NONE = np.int16(-1)
CHUNK = 16

WAITING, FIXED = np.uint8(1), np.uint8(2)

_CHUNK = np.uintp(CHUNK)
_0, _1, _2 = np.uintp(0), np.uintp(1), np.uintp(2)
_ONES = np.uint64(0x0101010101010101)
_ALL = 68  # what the eight neighbours of a pixel weigh, in tenths


@compiled
def lay_out(grid, number, count, p, first, last, coarse, apart, label, state):  # type: ignore[no-untyped-def]
    """Write every cell's label onto its pixels, in rows first ... last - 1 of cells.

    The label of a cell is number[grid], 0 where grid is -1; count (rows, columns): its readings.
    Writes coarse (rows + 2, columns + 2): these labels, those at the edge twice; apart (rows,
    columns): cells beside another label; label (H + 2, at least W + 1 + SIDE), but for its first
    and last row; and state alike: fixed without a reading and on a plane, in a cell among others of
    that plane, 0 elsewhere.
    """
    height, width = p.shape
    rows, columns = grid.shape
    for r in range(first, last + 2):
        row, cells = coarse[r], grid[min(max(r - 1, 0), rows - 1)]
        for c in range(columns):
            row[c + 1] = number[cells[c]] if cells[c] >= 0 else 0
        row[0], row[columns + 1] = row[1], row[columns]
    filled, fixed = np.empty(columns, np.int16), np.empty(columns, np.uint8)
    for r in range(first, last):
        above, row, below = coarse[r], coarse[r + 1], coarse[r + 2]
        readings, others = count[r], apart[r]
        for c in range(columns):
            mine = row[c + 1]
            same = (row[c] == mine) & (row[c + 2] == mine)
            same &= (above[c] == mine) & (above[c + 1] == mine) & (above[c + 2] == mine)
            same &= (below[c] == mine) & (below[c + 1] == mine) & (below[c + 2] == mine)
            others[c] = not same
            there = readings[c] > 0
            filled[c] = mine if there else NONE
            fixed[c] = FIXED if (same & (mine > 0)) | (not there) else 0
        top, bottom = r * SIDE, min((r + 1) * SIDE, height)
        labels, states = label[top + 1], state[top + 1]
        # Threes written out, which makes them vector code.
        for c in range(columns):
            k = SIDE * c
            labels[k + 1] = labels[k + 2] = labels[k + 3] = filled[c]
        for c in range(columns):
            k = SIDE * c
            states[k + 1] = states[k + 2] = states[k + 3] = fixed[c]
        labels[0], states[0] = NONE, FIXED
        for j in range(width + 1, labels.size):
            labels[j], states[j] = NONE, FIXED
        for i in range(top + 2, bottom + 1):
            copy, copied = label[i], state[i]
            for j in range(labels.size):
                copy[j], copied[j] = labels[j], states[j]
        for c in range(columns):
            if 0 < readings[c] < SIDE * SIDE:
                for i in range(top, bottom):
                    for j in range(c * SIDE, min((c + 1) * SIDE, width)):
                        if p[i, j] <= 0.0:
                            label[i + 1, j + 1], state[i + 1, j + 1] = NONE, FIXED


@compiled
def find_waiting(coarse, apart, w, p, x, y, planes, bound, first, last, state, busy):  # type: ignore[no-untyped-def]
    """Let pixels wait for a look that lie beside a cell of another label, or off their own plane.

    In rows first ... last - 1 of cells.
    Those off it have (w - plane)^2 p / 2 > bound. coarse, apart, state as in `lay_out`; sets busy
    for chunks that hold pixels that wait.
    """
    height, width = w.shape
    columns, alike = apart.shape[1], x.shape[0] == 1
    listed = np.empty(columns, np.uintp)
    for r in range(first, last):
        found, others = 0, apart[r]
        for c in range(columns):
            listed[found] = c
            found += others[c]
        top = r * SIDE
        for i in range(top, min(top + SIDE, height)):
            row = coarse[r + 1]
            other = coarse[r + 2] if i == top + SIDE - 1 else coarse[r] if i == top else row
            ws, ps, states, flags = w[i], p[i], state[i + 1], busy[i + 1]
            xs, ys = x[0 if alike else i], y[i]
            for n in range(found):
                c = listed[n]
                mine = row[c + _1]
                t = np.uintp(mine)
                t0, t1, t2 = planes[t, _0], planes[t, _1], planes[t, _2]
                limit = bound if mine > 0 else np.inf
                beyond = other[c + _1] != mine
                left = beyond | (row[c] != mine) | (other[c] != mine)
                right = beyond | (row[c + _2] != mine) | (other[c + _2] != mine)
                start = c * np.uintp(SIDE)
                for k in range(min(SIDE, width - np.intp(start))):
                    j = start + np.uintp(k)
                    e = ws[j] - t0 - t1 * xs[j] - t2 * ys[_0 if alike else j]
                    waits = left if k == 0 else right if k == SIDE - 1 else beyond
                    waits |= 0.5 * e * e * ps[j] > limit
                    waits &= states[j + _1] != FIXED
                    states[j + _1] = WAITING if waits else states[j + _1]
                    flags[(j + _1) // _CHUNK] |= waits


@internal
def _weight(label, straight, diagonal):  # type: ignore[no-untyped-def]
    """What a label weighs among a pixel's neighbours, in tenths."""
    n, e, s, w = straight
    ne, se, sw, nw = diagonal
    beside = (n == label) + (e == label) + (s == label) + (w == label)
    across = (ne == label) + (se == label) + (sw == label) + (nw == label)
    return 10 * beside + 7 * across


@compiled
def label_pixels(  # type: ignore[no-untyped-def]
    label, state, busy, seen, margin, w, x, y, width, variance, ranging, planes, lateral, null,
    differing, sweeps,
):  # fmt: skip
    """Sweeps of local moves over the pixels that wait, in raster order and backwards by turns.

    A pixel takes the label, among those of its eight neighbours and none, of least

        (w - plane)^2 / (2 (variance + lateral))  [null for none]
        + differing * (neighbours with another label, diagonal ones 0.7).

    lateral (planes,): variance of w by errors across the image. label, state and busy as `lay_out`
    leaves them; they are changed in place. Beside a change pixels wait again, but for those that
    have the new label already: it has become cheaper for them, and no other has. Sets seen for
    chunks beside a change. Returns the number of changes of the last sweep.
    """
    stride, chunks = np.uintp(margin), np.uintp(margin // CHUNK)
    height, alike = w.size // width, x.size < w.size
    tenth = 0.1 * differing
    eights = state.view(np.uint64)
    changed = 0
    for sweep in range(sweeps):
        changed = 0
        ahead = sweep % 2 == 0
        step = _1 if ahead else ~_0  # unsigned numbers wrap around
        for n in range(height):
            i = np.uintp(n + 1 if ahead else height - n)
            anything = False
            for k in range(chunks):
                anything |= busy[i * chunks + np.uintp(k)]
            if not anything:
                continue
            chunk = i * chunks + (_0 if ahead else chunks - _1) - step
            for _ in range(chunks):
                chunk += step
                if not busy[chunk]:
                    continue
                busy[chunk] = False
                # Sixteen states at once: most chunks beside a change hold none that waits.
                left, right = eights[chunk << _1], eights[(chunk << _1) + _1]
                if ((left & ~(left >> _1)) | (right & ~(right >> _1))) & _ONES == _0:
                    continue
                at = i * stride + (chunk - i * chunks) * _CHUNK
                at += (_0 if ahead else _CHUNK - _1) - step
                for _ in range(CHUNK):
                    at += step
                    if state[at] != WAITING:
                        continue
                    state[at] = 0
                    up, down = at - stride, at + stride
                    straight = label[up], label[at + _1], label[down], label[at - _1]
                    diagonal = label[up + _1], label[down + _1], label[down - _1], label[up - _1]
                    mine, other = label[at], np.int16(0)
                    for k in straight:
                        other = max(other, k if k != mine else np.int16(0))
                    for k in diagonal:
                        other = max(other, k if k != mine else np.int16(0))
                    if mine == 0 and other == 0:
                        continue
                    of_mine = _weight(mine, straight, diagonal)
                    of_other = _weight(other, straight, diagonal) if other > 0 else 0
                    around, of_none, several = _ALL, of_mine if mine == 0 else 0, False
                    if of_mine + of_other != _ALL:
                        around -= _weight(NONE, straight, diagonal)
                        of_none = _weight(np.int16(0), straight, diagonal)
                        several = of_other + of_none + (of_mine if mine > 0 else 0) != around

                    j = at - i * stride
                    r = (i - _1) * np.uintp(width) + j - _1
                    value, xj = np.float64(w[r]), np.float64(x[j - _1 if alike else r])
                    yj = np.float64(y[i - _1 if alike else r])
                    v = reading_variance(variance, ranging, value, xj, yj)
                    none = null + tenth * (around - of_none)
                    t = np.uintp(mine)
                    e = value - planes[t, _0] - planes[t, _1] * xj - planes[t, _2] * yj
                    own = 0.5 * e * e / (v + lateral[t]) + tenth * (around - of_mine)
                    best, lowest = mine, own if mine > 0 else none
                    if several:
                        for k in (
                            diagonal[3], straight[0], diagonal[0], straight[3],
                            straight[1], diagonal[2], straight[2], diagonal[1],
                        ):  # fmt: skip
                            if k <= 0 or k == mine:
                                continue
                            t = np.uintp(k)
                            e = value - planes[t, _0] - planes[t, _1] * xj - planes[t, _2] * yj
                            cost = 0.5 * e * e / (v + lateral[t])
                            cost += tenth * (around - _weight(k, straight, diagonal))
                            if cost < lowest - 1e-9:
                                best, lowest = k, cost
                    elif other > 0:
                        t = np.uintp(other)
                        e = value - planes[t, _0] - planes[t, _1] * xj - planes[t, _2] * yj
                        cost = 0.5 * e * e / (v + lateral[t]) + tenth * (around - of_other)
                        if cost < lowest - 1e-9:
                            best, lowest = other, cost
                    if none < lowest - 1e-9:
                        best = np.int16(0)
                    if best == mine:
                        continue
                    label[at] = best
                    changed += 1
                    left, right = (j - _1) // _CHUNK, (j + _1) // _CHUNK
                    corner, flag = up - _1, (i - _1) * chunks
                    for _ in range(3):
                        busy[flag + left] = busy[flag + right] = True
                        seen[flag + left] = seen[flag + right] = True
                        for k in range(3):
                            near = corner + np.uintp(k)
                            state[near] |= WAITING if label[near] != best else 0
                        corner, flag = corner + stride, flag + chunks
        if changed == 0:
            break
    return changed


@compiled
def without_margin(label, out):  # type: ignore[no-untyped-def]
    """Copy labels into out (H, W): without their margin, 0 for `NONE`."""
    for i in range(out.shape[0]):
        row, source = out[i], label[i + 1]
        for j in range(row.size):
            row[j] = source[j + 1] if source[j + 1] > 0 else 0


@compiled
def rename(label, place, out):  # type: ignore[no-untyped-def]
    """Write out (pixels,): place of every label."""
    for k in range(label.size):
        out[k] = place[np.uintp(label[k])]
