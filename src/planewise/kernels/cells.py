"""Loops over cells: moments, which cells are planes, and what their shared error leaves of them.

On a plane inverse depth w = 1 / z is affine in the image: w = t0 + t1 X + t2 Y, where X and Y are
undistorted pixel coordinates divided by `UNIT`. A row of moments holds, for readings of weight p,

    [sum p, pX, pY, pXX, pXY, pYY, pw, pXw, pYw, pww, count, product of p w^4]

and says all about any plane on its readings. Those of cells are used where they are made, and not
kept: they are three times as large as the images, and few are asked for again.

A row of a segment has the layout of the first eleven: its first nine entries are the information P
on the plane's parameters once the error that neighbouring readings share is integrated out, and
P t; adding rows joins segments. Two entries follow: the misfit of the joins so far, and what the
cells would cost as a free smooth surface.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.elementary import logarithm
from planewise.kernels.jit import called, compiled, inlined, internal

UNIT = 100.0  # pixels per unit of X and Y
SIDE = 3  # pixels of the finest cell; 2 x 2 of them are one where one plane explains them
STRIP = 6  # cells to a side of whole blocks of 2 x 2 and whole tiles of 3 x 3 of them
MOMENTS = 11
COUNT, PRODUCT = 10, 11  # entries of a row of moments; of tiles, the logarithm of the product
MISFIT, FREE = 11, 12  # entries of a segment beyond the moments'
SEGMENT = 13
LINE = 0.01  # 1 - r^2, or a variance in pixels^2, of the coordinates of readings in a line
_BATCH = 216  # cells whose moments are added up at once
PLANE = 10  # numbers that `merge_quarters` tells of a unit
_0, _1 = np.uintp(0), np.uintp(1)  # unsigned indices spare the check for negative ones


@inlined
def _row_moments(w, p, x, y, straight, row, sums, line, out):  # type: ignore[no-untyped-def]
    """Moments (12, columns) of a row of cells.

    Pixels are added up column by column first, a few sums at a time, so that every loop is one
    vector expression. sums (12, 3 columns) and line (W,) are room to work in.
    """
    height, width = w.shape
    sums[:] = 0.0
    sums[PRODUCT] = 1.0
    for i in range(row * SIDE, min((row + 1) * SIDE, height)):
        weight, value = p[i], w[i]
        a, b = x[0 if straight else i], y[i]
        if straight:
            line[:] = y[i, 0]
            b = line
        s, t, u = sums[0], sums[1], sums[2]
        for j in range(width):
            q = np.float64(weight[j])
            s[j] += q
            t[j] += q * a[j]
            u[j] += q * b[j]
        s, t, u = sums[3], sums[4], sums[5]
        for j in range(width):
            q, qa = np.float64(weight[j]), np.float64(weight[j]) * a[j]
            s[j] += qa * a[j]
            t[j] += qa * b[j]
            u[j] += q * b[j] * b[j]
        s, t, u = sums[6], sums[7], sums[8]
        for j in range(width):
            q = np.float64(weight[j]) * value[j]
            s[j] += q
            t[j] += q * a[j]
            u[j] += q * b[j]
        s, t, u = sums[9], sums[COUNT], sums[PRODUCT]
        for j in range(width):
            v = np.float64(value[j])
            q = weight[j] * v * v
            s[j] += q
            t[j] += 1.0 if weight[j] > 0.0 else 0.0
            u[j] *= q * v * v if weight[j] > 0.0 else 1.0
    for e in range(out.shape[0] - 1):
        s, m = sums[e], out[e]
        for k in range(m.size):
            m[k] = s[SIDE * k] + s[SIDE * k + 1] + s[SIDE * k + 2]
    s, m = sums[PRODUCT], out[PRODUCT]
    for k in range(m.size):
        m[k] = s[SIDE * k] * s[SIDE * k + 1] * s[SIDE * k + 2]


@internal
def _split(row, a, b, c):  # type: ignore[no-untyped-def]
    """Put the first, second and third of every three entries apart; what is missing is 0."""
    full = min(a.size, row.size // SIDE)
    for k in range(full):
        a[k], b[k], c[k] = row[SIDE * k], row[SIDE * k + 1], row[SIDE * k + 2]
    if full < a.size:
        left = row.size - SIDE * full
        a[full] = row[SIDE * full] if left > 0 else 0.0
        b[full] = row[SIDE * full + 1] if left > 1 else 0.0
        c[full] = 0.0


@internal
def _column_sums(p0, p1, p2, w0, w1, w2, y0, y1, y2):  # type: ignore[no-untyped-def]
    """Sums of p, pY, pYY, pw, pYw, pww, count, and the product of p w^4, over three readings."""
    a, b, c = np.float64(p0), np.float64(p1), np.float64(p2)
    u, v, w = np.float64(w0), np.float64(w1), np.float64(w2)
    ay, by, cy, au, bv, cw = a * y0, b * y1, c * y2, a * u, b * v, c * w
    auu, bvv, cww = au * u, bv * v, cw * w
    product = (auu * u * u if a > 0.0 else 1.0) * (bvv * v * v if b > 0.0 else 1.0)
    product *= cww * w * w if c > 0.0 else 1.0
    count = (1.0 if a > 0.0 else 0.0) + (1.0 if b > 0.0 else 0.0) + (1.0 if c > 0.0 else 0.0)
    square = ay * y0 + by * y1 + cy * y2
    across = au * y0 + bv * y1 + cw * y2
    return a + b + c, ay + by + cy, square, au + bv + cw, across, auu + bvv + cww, count, product


@inlined
def _straight_row_moments(w, p, x, y, row, columns, pixels, sums, out):  # type: ignore[no-untyped-def]
    """`_row_moments` where x is the same in every row, y in every column, and rows are three.

    In batches of cells whose left, middle and right pixels are put apart first: pixels (21, _BATCH)
    float32 and sums (12, _BATCH) are one piece of memory each, which lets the loop be vector code.
    """
    top = SIDE * row
    y0, y1, y2 = np.float64(y[top, 0]), np.float64(y[top + 1, 0]), np.float64(y[top + 2, 0])
    for start in range(0, columns, _BATCH):
        n, first = min(_BATCH, columns - start), SIDE * start
        for i in range(2 * SIDE + 1):
            image = p[top + i] if i < SIDE else w[top + i - SIDE] if i < 2 * SIDE else x[0]
            j = SIDE * i
            _split(image[first:], pixels[j, :n], pixels[j + 1, :n], pixels[j + 2, :n])
        for k in range(n):
            a, ay, ayy, aw, ayw, aww, count_a, product_a = _column_sums(
                pixels[0, k], pixels[3, k], pixels[6, k],
                pixels[9, k], pixels[12, k], pixels[15, k], y0, y1, y2,
            )  # fmt: skip
            b, by, byy, bw, byw, bww, count_b, product_b = _column_sums(
                pixels[1, k], pixels[4, k], pixels[7, k],
                pixels[10, k], pixels[13, k], pixels[16, k], y0, y1, y2,
            )  # fmt: skip
            c, cy, cyy, cw, cyw, cww, count_c, product_c = _column_sums(
                pixels[2, k], pixels[5, k], pixels[8, k],
                pixels[11, k], pixels[14, k], pixels[17, k], y0, y1, y2,
            )  # fmt: skip
            r, s, t = (
                np.float64(pixels[18, k]),
                np.float64(pixels[19, k]),
                np.float64(pixels[20, k]),
            )
            ar, bs, ct = a * r, b * s, c * t
            sums[0, k], sums[1, k], sums[2, k] = a + b + c, ar + bs + ct, ay + by + cy
            sums[3, k], sums[4, k] = ar * r + bs * s + ct * t, ay * r + by * s + cy * t
            sums[5, k], sums[6, k], sums[7, k] = (
                ayy + byy + cyy,
                aw + bw + cw,
                aw * r + bw * s + cw * t,
            )
            sums[8, k], sums[9, k] = ayw + byw + cyw, aww + bww + cww
            sums[COUNT, k] = count_a + count_b + count_c
            sums[PRODUCT, k] = product_a * product_b * product_c
        for e in range(out.shape[0]):
            moment, batch = out[e, start : start + n], sums[e]
            for k in range(n):
                moment[k] = batch[k]


@inlined
def _pair_up(upper, lower, out):  # type: ignore[no-untyped-def]
    """Moments (11, columns / 2) of blocks of 2 x 2 cells from two rows of cells (12, .)."""
    for e in range(out.shape[0]):
        a, b, m = upper[e], lower[e], out[e]
        for k in range(m.size):
            m[k] = a[2 * k] + a[2 * k + 1] + b[2 * k] + b[2 * k + 1]


@internal
def row_misfits(m, out):  # type: ignore[no-untyped-def]
    """chi^2 of the best plane of every column of moments (10 or more, columns)."""
    m0, m1, m2, m3, m4, m5 = m[0], m[1], m[2], m[3], m[4], m[5]
    m6, m7, m8, m9 = m[6], m[7], m[8], m[9]
    for k in range(out.size):
        there = m0[k] > 0.0
        scale = 1.0 / (m0[k] if there else 1.0)
        cx, cy, mean = m1[k] * scale, m2[k] * scale, m6[k] * scale
        xx, xy, yy = m3[k] - cx * m1[k], m4[k] - cx * m2[k], m5[k] - cy * m2[k]
        xw, yw = m7[k] - cx * m6[k], m8[k] - cy * m6[k]
        square = m9[k] - mean * m6[k]
        determinant = xx * yy - xy * xy
        plane = there and determinant > 1e-9 * xx * yy
        fitted = (yy * xw * xw - 2.0 * xy * xw * yw + xx * yw * yw) / (
            determinant if plane else 1.0
        )
        out[k] = max(square - (fitted if plane else 0.0), 0.0)


@internal
def _add_to_tiles(row, new, logs, out):  # type: ignore[no-untyped-def]
    """Add a row of cells (12, .) to the tiles (12, columns / 3) that they are in.

    new: whether nothing was added to them before; logs (.): room for the products' logarithms.
    """
    product = row[PRODUCT]
    for k in range(logs.size):
        logs[k] = logarithm(product[k])
    for e in range(out.shape[0]):
        s, t = logs if e == PRODUCT else row[e], out[e]
        for j in range(t.size):
            t[j] = s[3 * j] + s[3 * j + 1] + s[3 * j + 2] + (0.0 if new else t[j])


@inlined
def _tell_of_rows(top, pair, logs, count, misfits, blocks, together, tiles):  # type: ignore[no-untyped-def]
    """All that is kept of two rows of cells, or the last one: pair (2, 12, .).

    Behind the last column there are cells without a reading, up to a whole block and tile.
    """
    there = min(2, misfits.shape[0] - top)
    for k in range(there):
        row = top + k
        for j in range(count.shape[1]):
            count[row, j] = pair[k, COUNT, j]
        row_misfits(pair[k], misfits[row])
        _add_to_tiles(pair[k], row % 3 == 0, logs, tiles[row // 3])
    if there == 1:
        pair[1] = 0.0
    _pair_up(pair[0], pair[1], blocks[top // 2])
    row_misfits(blocks[top // 2], together[top // 2])


@compiled
def cell_moments(w, p, x, y, straight, first, last, count, misfits, blocks, together, tiles):  # type: ignore[no-untyped-def]
    """Moments of blocks of 2 x 2 and tiles of 3 x 3 cells; chi^2 of the planes of cells and blocks.

    Of strips first ... last - 1 of `STRIP` rows. w, p, x, y (H, W), p = 0 without a reading;
    straight: whether x is the same in every row and y in every column, of which only the first need
    then be read. Writes count and misfits (rows, columns) of cells; blocks (rows / 2, 11, columns /
    2) and together (rows / 2, columns / 2); tiles (rows / 3, 12, columns / 3), all rounded up.
    """
    rows, room = misfits.shape[0], -(-misfits.shape[1] // STRIP) * STRIP
    sums, pair = np.empty((MOMENTS + 1, SIDE * room)), np.empty((2, tiles.shape[1], room))
    line, logs = np.empty(w.shape[1], y.dtype), np.empty(room)
    for top in range(first * STRIP, min(last * STRIP, rows), 2):
        for k in range(min(2, rows - top)):
            _row_moments(w, p, x, y, straight, top + k, sums, line, pair[k])
        _tell_of_rows(top, pair, logs, count, misfits, blocks, together, tiles)


@compiled
def straight_moments(w, p, x, y, first, last, count, misfits, blocks, together, tiles):  # type: ignore[no-untyped-def]
    """`cell_moments` of a straight image where all cells have three rows, in half the time.

    A loop of its own: few cameras need both, and each takes a second or two to compile.
    """
    rows, columns = misfits.shape
    room = -(-columns // STRIP) * STRIP
    pixels, batch = np.empty((7 * SIDE, _BATCH), p.dtype), np.empty((MOMENTS + 1, _BATCH))
    pair, logs = np.empty((2, tiles.shape[1], room)), np.empty(room)
    pair[:] = 0.0
    pair[:, PRODUCT] = 1.0
    for top in range(first * STRIP, min(last * STRIP, rows), 2):
        for k in range(min(2, rows - top)):
            _straight_row_moments(w, p, x, y, top + k, columns, pixels, batch, pair[k])
        _tell_of_rows(top, pair, logs, count, misfits, blocks, together, tiles)


@compiled
def whole_misfits(count, misfits, blocks, out, sizes):  # type: ignore[no-untyped-def]
    """List chi^2 of every other whole cell in every other row; returns how many there are.

    count, misfits, blocks as `cell_moments` writes them. Writes sizes (n,): blocks with 0, 1 ...
    readings.
    """
    for n in range(sizes.size):
        sizes[n] = 0
    for i in range(blocks.shape[0]):
        readings = blocks[i, COUNT]
        for j in range(readings.size):
            sizes[np.intp(readings[j])] += 1
    found = 0
    for i in range(0, misfits.shape[0], 2):
        whole, row = count[i], misfits[i]
        for j in range(0, row.size, 2):
            out[found] = row[j]
            found += whole[j] == SIDE * SIDE
    return found


@internal
def add_reading(m, p, a, b, w):  # type: ignore[no-untyped-def]
    """Add a reading of inverse depth w at (a, b) to the first ten entries of a row of moments."""
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


@internal
def _sum_cell(w, p, x, y, row, column, out):  # type: ignore[no-untyped-def]
    """Moments (11,) of one cell."""
    own = _1 if x.shape[0] > 1 else _0
    for e in range(MOMENTS):
        out[e] = 0.0
    for i in range(row * SIDE, min((row + 1) * SIDE, w.shape[0])):
        for j in range(column * SIDE, min((column + 1) * SIDE, w.shape[1])):
            r, c = np.uintp(i), np.uintp(j)
            if p[r, c] > 0.0:
                add_reading(out, p[r, c], x[own * r, c], y[r, own * c], w[r, c])
                out[COUNT] += 1.0


@internal
def own_plane(m):  # type: ignore[no-untyped-def]
    """Best plane of a row of moments: centroid, w there, slopes, their covariance, and chi^2."""
    cx, cy, mean = m[1] / m[0], m[2] / m[0], m[6] / m[0]
    xx, xy, yy = m[3] - cx * m[1], m[4] - cx * m[2], m[5] - cy * m[2]
    xw, yw = m[7] - cx * m[6], m[8] - cy * m[6]
    square = m[9] - mean * m[6]
    determinant = xx * yy - xy * xy
    if determinant <= 1e-9 * xx * yy:  # readings in a line
        return cx, cy, mean, 0.0, 0.0, np.inf, 0.0, np.inf, max(square, 0.0)
    vxx, vxy, vyy = yy / determinant, -xy / determinant, xx / determinant
    tx, ty = vxx * xw + vxy * yw, vxy * xw + vyy * yw
    return cx, cy, mean, tx, ty, vxx, vxy, vyy, max(square - tx * xw - ty * yw, 0.0)


@internal
def _is_spread(m):  # type: ignore[no-untyped-def]
    """Whether readings are not all but in a line: few may be, or those of one row of pixels."""
    xx, xy, yy = m[0] * m[3] - m[1] * m[1], m[0] * m[4] - m[1] * m[2], m[0] * m[5] - m[2] * m[2]
    pixel = m[0] * m[0] / (UNIT * UNIT)
    return min(xx, yy) > LINE * pixel and xx * yy - xy * xy > LINE * xx * yy


@called
def _write_unit(m, white, side, k, planes, readings, size):  # type: ignore[no-untyped-def]
    """Write what `merge_quarters` tells of unit k, of moments m (11,)."""
    cx, cy, mean, tx, ty, vxx, vxy, vyy, misfit = own_plane(m)
    planes[0, k], planes[1, k], planes[2, k] = cx, cy, mean
    planes[3, k], planes[4, k], planes[5, k], planes[6, k] = tx, ty, misfit / white, m[0] / white
    planes[7, k], planes[8, k], planes[9, k] = white * vxx, white * vxy, white * vyy
    readings[k], size[k] = m[COUNT], side


@compiled
def merge_quarters(  # type: ignore[no-untyped-def]
    w, p, x, y, count, misfits, blocks, together, white, split, hopeless, filled, unit, squares,
    planes, readings, size,
):  # fmt: skip
    """Join 2 x 2 cells where one plane explains them, else keep each that has a plane of its own.

    w, p, x, y as of `kernels.labels`; count, misfits, blocks, together as `cell_moments` writes
    them; white: chi^2 per degree of freedom of white noise in this frame; split: F above which four
    planes are needed; hopeless: chi^2 per degree of freedom, in units of white, above which there
    is none; filled: least share of a cell's pixels. Writes unit (rows, columns): index of the unit
    of every cell or -1; squares (rows / 2, columns / 2), up: of every 2 x 2 cells, -1 where they
    are not one; of each unit its plane, planes (10, n), how many readings (n,) it has, and size
    (n,), 2 or 1. Returns the number of units, or -1 if they are more than n.

    Of a plane: centroid x, y; w there and its slopes along x and y; chi^2; the information on w;
    and the covariance xx, xy, yy of the slopes; all for the white noise of this frame.
    """
    rows, columns = misfits.shape
    full = float(SIDE * SIDE)
    m = np.empty(MOMENTS)
    found = 0
    for row in range(blocks.shape[0]):
        for column in range(blocks.shape[2]):
            top, left = 2 * row, 2 * column
            bottom, right = min(top + 2, rows), min(left + 2, columns)
            freedom = blocks[row, COUNT, column] - 3.0
            chi2 = together[row, column]
            whole = freedom + 3.0 >= 4 * filled * full and chi2 <= hopeless * white * freedom
            whole = whole and _is_spread(blocks[row, :, column])
            if whole and chi2 > white * freedom:
                # F of the nine further parameters of four planes: free of the noise's scale.
                apart = 0.0
                for i in range(top, bottom):
                    for j in range(left, right):
                        apart += misfits[i, j]
                apart = max(apart, 0.5 * white * (freedom - 9.0))
                whole = (chi2 - apart) * (freedom - 9.0) <= split * 9.0 * apart
            if found + 4 > size.size:
                return -1
            squares[row, column] = found if whole else -1
            if whole:
                for e in range(MOMENTS):
                    m[e] = blocks[row, e, column]
                _write_unit(m, white, 2.0, found, planes, readings, size)
                for i in range(top, bottom):
                    for j in range(left, right):
                        unit[i, j] = found if count[i, j] > 0 else -1
                found += 1
                continue
            for i in range(top, bottom):
                for j in range(left, right):
                    there = np.float64(count[i, j])
                    unit[i, j] = -1
                    if there < max(filled * full, 8.0):
                        continue
                    if misfits[i, j] <= hopeless * white * (there - 3.0):
                        unit[i, j] = found
                        _sum_cell(w, p, x, y, i, j, m)
                        _write_unit(m, white, 1.0, found, planes, readings, size)
                        found += 1
    return found


@compiled
def marginalise(planes, count, inflation, offset, tilt, segments):  # type: ignore[no-untyped-def]
    """Information of every unit on a plane, its own random effect N(0, Sigma) integrated out.

    P = (A^-1 + Sigma)^-1 about the unit's centroid, A its weighted normal equations divided by its
    inflation. planes (10, .), count (units,) as `merge_quarters` writes them; offset, tilt
    (units,): Sigma is diagonal, the variances of the offset and of either slope. Writes segments
    (units, 13).
    """
    for k in range(count.size):
        cx, cy, mean, tx, ty = planes[0, k], planes[1, k], planes[2, k], planes[3, k], planes[4, k]
        larger = inflation[k]
        level = 1.0 / (larger / planes[6, k] + offset[k])
        cxx, cxy = larger * planes[7, k] + tilt[k], larger * planes[8, k]
        cyy = larger * planes[9, k] + tilt[k]
        scale = 1.0 / (cxx * cyy - cxy * cxy)
        pxx, pxy, pyy = cyy * scale, -cxy * scale, cxx * scale
        qx, qy = pxx * tx + pxy * ty, pxy * tx + pyy * ty
        out = segments[k]
        out[0], out[1], out[2] = level, level * cx, level * cy
        out[3], out[4] = level * cx * cx + pxx, level * cx * cy + pxy
        out[5] = level * cy * cy + pyy
        out[6], out[7], out[8] = level * mean, level * mean * cx + qx, level * mean * cy + qy
        out[9] = level * mean * mean + qx * tx + qy * ty
        out[COUNT], out[MISFIT], out[FREE] = count[k], 0.0, 0.0
