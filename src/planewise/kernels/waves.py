"""Loops over blocks in a row: their bends, sums of a spectrum of them, and taking waves off."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import compiled, in_order, inlined
from planewise.kernels.tables import between, squared_stretch


@inlined
def _opposite(w, p, side, i, j):  # type: ignore[no-untyped-def]
    """Sums of w and p over pixels of a block whose opposite has a reading, too, and their count."""
    value, weight, n = 0.0, 0.0, 0
    first, last = side * i, side * i + side - 1
    left, right = side * j, side * j + side - 1
    for k in range(side):
        for m in range(side):
            here = p[first + k, left + m]
            if here > 0.0 and p[last - k, right - m] > 0.0:
                value += w[first + k, left + m]
                weight += here
                n += 1
    return value, weight, n


@in_order
def block_readings(w, p, side, out):  # type: ignore[no-untyped-def]
    """Mean inverse depth and precision of blocks, so many pixels to a side: out (2, rows, columns).

    Where readings are missing, of pairs opposite each other about the middle of the block alone,
    whose mean is on a plane what it is there; 0 where these are less than half of its pixels.
    """
    _, rows, columns = out.shape
    work = np.empty((3, columns * side))
    total, precision, least = work[0], work[1], work[2]
    for i in range(rows):
        total[:], precision[:], least[:] = 0.0, 0.0, np.inf
        for k in range(side * i, side * i + side):  # column by column first: vector code
            of_w, of_p = w[k], p[k]
            for j in range(total.size):
                total[j] += of_w[j]
                precision[j] += of_p[j]
                least[j] = min(least[j], of_p[j])
        for j in range(columns):
            value, weight, smallest = 0.0, 0.0, np.inf
            for k in range(side * j, side * j + side):
                value += total[k]
                weight += precision[k]
                smallest = min(smallest, least[k])
            n = side * side
            if smallest <= 0.0 < weight:
                value, weight, n = _opposite(w, p, side, i, j)
            there = 2 * n >= side * side
            out[0, i, j] = value / n if there else 0.0
            out[1, i, j] = weight / (side * side) if there else 0.0


@in_order
def blocks_in_a_row(blocks, lags, every, around, index, bend, variance, lean, ends):  # type: ignore[no-untyped-def]
    """Three blocks a, b, c in a row, so many apart: 2 w_b - w_a - w_c, 0 on a plane but for error.

    blocks (2, rows, columns): `block_readings`; lags: how far apart; every so many rows, and
    columns, are looked at. Writes their places in the flattened grid, index (3, n), bend (n,), what
    it is, variance (n,) by independent errors, lean (2, n), by how much w differs so many blocks
    `around` the middle one along rows and along columns, and ends, where those of every lag end.
    """
    w, p = blocks[0], blocks[1]
    rows, columns = w.shape
    n = 0
    for e in range(lags.size):
        lag = lags[e]
        for axis in range(2):
            down, right = (lag, 0) if axis else (0, lag)
            for i in range(down, rows - down, 1 if axis else every):
                for j in range(right, columns - right, every if axis else 1):
                    a, b, c = w[i - down, j - right], w[i, j], w[i + down, j + right]
                    if a <= 0.0 or b <= 0.0 or c <= 0.0:
                        continue
                    place = i * columns + j
                    step = lag * columns if axis else lag
                    index[0, n], index[1, n], index[2, n] = place - step, place, place + step
                    bend[n] = 2.0 * b - a - c
                    variance[n] = (
                        4.0 / p[i, j] + 1.0 / p[i - down, j - right] + 1.0 / p[i + down, j + right]
                    )
                    lean[0, n] = lean[1, n] = 0.0
                    if around <= i < rows - around and around <= j < columns - around:
                        left, right_one = w[i, j - around], w[i, j + around]
                        up, below = w[i - around, j], w[i + around, j]
                        if min(min(left, right_one), min(up, below)) > 0.0:
                            lean[0, n], lean[1, n] = right_one - left, below - up
                    n += 1
        ends[e] = n


@in_order
def spectrum_sums(index, place, rate, bend, weight, sums, apart, together, own):  # type: ignore[no-untyped-def]
    """What tells, of every frequency, how far a sine and a cosine explain bends.

    The bend of three blocks by an error g of their coordinates is 2 r_b g_b - r_a g_a - r_c g_c,
    r = dw/dg. Of knots k of the coordinate, in which g is constant, it is a linear function, and
    the normal equations of any g are in its sums, of which a wave needs these alone: those on
    knots, M_kl by k - l, and by k + l. place, rate (blocks,): knot and r. Writes sums (K,),
    apart (K,), together (2 K,), and own (K,), how much of squared bends is the noise of which
    block, if all of them are noise: 4, 1 and 1 sixths.
    """
    own[:] = 0.0
    sums[:] = 0.0
    apart[:] = 0.0
    together[:] = 0.0
    for n in range(bend.size):
        a, b, c = index[0, n], index[1, n], index[2, n]
        i, j, k = place[a], place[b], place[c]
        x, y, z = -rate[a], 2.0 * rate[b], -rate[c]
        p, q = weight[n], weight[n] * bend[n]
        sums[i] += x * q
        sums[j] += y * q
        sums[k] += z * q
        apart[0] += p * (x * x + y * y + z * z)
        together[2 * i] += p * x * x
        together[2 * j] += p * y * y
        together[2 * k] += p * z * z
        q *= bend[n] / 6.0
        own[i] += q
        own[j] += 4.0 * q
        own[k] += q
        for m, u in ((abs(i - j), x * y), (abs(j - k), y * z), (abs(i - k), x * z)):
            apart[m] += 2.0 * p * u
        together[i + j] += 2.0 * p * x * y
        together[j + k] += 2.0 * p * y * z
        together[i + k] += 2.0 * p * x * z


@compiled
def take_off(w, x, y, inverse, ranging, first, error, out):  # type: ignore[no-untyped-def]
    """Inverse depth (H, W) without an error that is a function of a coordinate.

    inverse: of inverse depth, else of range, in metres; x, y: coordinates of pixels, of full size
    or a row and a column; error (K,): of a coordinate at first + k / ranging[0], linear between;
    ranging: also what `tables.squared_stretch` takes, as where depth is z if it takes the place of
    range.
    """
    last = np.float64(error.size - 2)
    height, width = w.shape
    column = np.zeros(width)
    for i in range(height):
        of_w, of_x, of_out = w[i], x[i if x.shape[0] > 1 else 0], out[i]
        if inverse:
            for j in range(width):
                at = max((of_w[j] - first) * ranging[0], 0.0)
                of_out[j] = of_w[j] - between(error, at, last) if of_w[j] > 0.0 else 0.0
            continue
        for j in range(width):
            column[j] = y[i, j if y.shape[1] > 1 else 0]
        for j in range(width):
            z = 1.0 / np.float64(of_w[j] if of_w[j] > 0.0 else 1.0)
            stretch = np.sqrt(squared_stretch(ranging, of_x[j], column[j]))
            off = between(error, max((z * stretch - first) * ranging[0], 0.0), last)
            of_out[j] = 1.0 / (z - off / stretch) if of_w[j] > 0.0 else 0.0
