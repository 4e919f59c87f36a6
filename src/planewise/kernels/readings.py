"""Loops over readings: scores, assignments, least squares, sums.

Readings on rays are whitened so that a plane theta (theta . x = 1) is scored without sigma:

    a = r sigma sqrt(2),  s = z / (sigma sqrt(2)),  delta^2 / (2 sigma^2) = (s - 1 / (theta . a))^2

Free points are whitened homogeneous coordinates x' = (x, 1) / (sigma sqrt(2)), and a plane
h = (n, d) has delta^2 / (2 sigma^2) = (h . x')^2. In both cases a reading's gain is that square
minus tau.

Loops run over blocks of readings that fit the first-level cache, planes outside readings, so that
the innermost loop is one vector expression. Blocks are slices: indices that start at zero need no
check for negative ones, which would keep the loop from being vectorised. NaN is honoured (a NaN
plane gains nothing), hence not the whole of ``fastmath``.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import compiled, internal

_BLOCK = 512
PART = 8_192  # readings that are summed together, whatever the number of threads


@compiled
def gather_rays(a, s, tau, chosen, first, last, out):  # type: ignore[no-untyped-def]
    """out (5, n) = a, s, tau (3 + 1 + 1, k) of the readings chosen[first:last]."""
    for axis in range(3):
        for i in range(first, last):
            out[axis, i] = a[axis, chosen[i]]
    for i in range(first, last):
        out[3, i], out[4, i] = s[chosen[i]], tau[chosen[i]]


@compiled
def score_rays(theta, a, s, ceiling, first, last, total):  # type: ignore[no-untyped-def]
    """total[h] = sum_i min(0, (s_i - 1 / (theta_h . a_i))^2 - ceiling_i) for first <= h < last.

    theta (T, 3), a (3, k), s (k,), ceiling (k,): float32; total (T,): float64.
    """
    zero = np.float32(0.0)
    one = np.float32(1.0)
    for h in range(first, last):
        total[h] = 0.0
    for start in range(0, s.size, _BLOCK):
        stop = min(start + _BLOCK, s.size)
        x, y, z = a[0, start:stop], a[1, start:stop], a[2, start:stop]
        d, c = s[start:stop], ceiling[start:stop]
        for h in range(first, last):
            t0, t1, t2 = theta[h, 0], theta[h, 1], theta[h, 2]
            part = zero
            for i in range(d.size):
                e = d[i] - one / (t0 * x[i] + t1 * y[i] + t2 * z[i])
                g = e * e - c[i]
                part += g if g < zero else zero
            total[h] += part


@compiled
def score_points(h, x, ceiling, first, last, total):  # type: ignore[no-untyped-def]
    """total[j] = sum_i min(0, (h_j . x_i)^2 - ceiling_i) for first <= j < last.

    h (T, n + 1), x (n + 1, k), ceiling (k,): float32; total (T,): float64.
    """
    zero = np.float32(0.0)
    work = np.empty(_BLOCK, np.float32)
    for j in range(first, last):
        total[j] = 0.0
    for start in range(0, ceiling.size, _BLOCK):
        stop = min(start + _BLOCK, ceiling.size)
        c, e = ceiling[start:stop], work[: stop - start]
        for j in range(first, last):
            e[:] = zero
            for axis in range(x.shape[0]):
                weight, row = h[j, axis], x[axis, start:stop]
                for i in range(e.size):
                    e[i] += weight * row[i]
            part = zero
            for i in range(e.size):
                g = e[i] * e[i] - c[i]
                part += g if g < zero else zero
            total[j] += part


@internal
def _keep_best(g, plane, best, second, mark):  # type: ignore[no-untyped-def]
    """Enter the gains of one plane into the best and second-best of a block; sum the best."""
    part = 0.0
    for i in range(g.size):
        old = best[i]
        low = g[i] < old
        second[i] = old if low else min(second[i], g[i])
        mark[i] = plane if low else mark[i]
        new = g[i] if low else old
        best[i] = new
        part += new
    return part


@compiled
def assign_rays(theta, a, s, tau, first, last, best, second, label, cumulative):  # type: ignore[no-untyped-def]
    """Give the readings of parts first <= p < last to the plane of lowest gain below zero, or none.

    theta (N, 3), a (3, k), s, tau (k,): float64. Writes best and second-best gain (k,), label (k,)
    uint16 with 0 for none, and cumulative (parts, N + 1): the sum of best gains with the first
    0 ... N planes alone.
    """
    work = np.empty(_BLOCK)
    marks = np.empty(_BLOCK, np.int32)
    cumulative[first:last] = 0.0
    for start in range(first * PART, min(last * PART, s.size), _BLOCK):
        stop = min(start + _BLOCK, s.size)
        x, y, z = a[0, start:stop], a[1, start:stop], a[2, start:stop]
        d, c, g = s[start:stop], tau[start:stop], work[: stop - start]
        b, b2, m = best[start:stop], second[start:stop], marks[: stop - start]
        sums = cumulative[start // PART]
        b[:] = 0.0
        b2[:] = 0.0
        m[:] = 0
        for j in range(theta.shape[0]):
            t0, t1, t2 = theta[j, 0], theta[j, 1], theta[j, 2]
            for i in range(g.size):
                e = d[i] - 1.0 / (t0 * x[i] + t1 * y[i] + t2 * z[i])
                g[i] = e * e - c[i]
            sums[j + 1] += _keep_best(g, np.int32(j + 1), b, b2, m)
        label[start:stop] = m


@compiled
def assign_points(h, x, tau, first, last, best, second, label, cumulative):  # type: ignore[no-untyped-def]
    """`assign_rays` for free points: h (N, n + 1), x (n + 1, k) float64."""
    work = np.empty(_BLOCK)
    marks = np.empty(_BLOCK, np.int32)
    cumulative[first:last] = 0.0
    for start in range(first * PART, min(last * PART, tau.size), _BLOCK):
        stop = min(start + _BLOCK, tau.size)
        c, g = tau[start:stop], work[: stop - start]
        b, b2, m = best[start:stop], second[start:stop], marks[: stop - start]
        sums = cumulative[start // PART]
        b[:] = 0.0
        b2[:] = 0.0
        m[:] = 0
        for j in range(h.shape[0]):
            g[:] = 0.0
            for axis in range(x.shape[0]):
                weight, row = h[j, axis], x[axis, start:stop]
                for i in range(g.size):
                    g[i] += weight * row[i]
            for i in range(g.size):
                g[i] = g[i] * g[i] - c[i]
            sums[j + 1] += _keep_best(g, np.int32(j + 1), b, b2, m)
        label[start:stop] = m


@compiled
def claim(label, best, plane, free, first, last, at, labels, gains, left, still):  # type: ignore[no-untyped-def]
    """Give the readings first <= i < last that a plane explains to it, and list the others.

    label, best (n,): gains on that plane alone; free (n,): which readings these are. Writes labels
    and gains (k,) of all readings; and, from the place `at` on, left (m,): the places of those
    without a label, and still (m,): which readings those are.
    """
    for i in range(first, last):
        if label[i] > 0:
            labels[free[i]], gains[free[i]] = plane, best[i]
        else:
            left[at], still[at] = i, free[i]
            at += 1


@compiled
def normal_sums(theta, a, s, label, first, last, sums):  # type: ignore[no-untyped-def]
    """Sums of one least-squares step of every plane on its readings in parts first <= p < last.

    With q = theta . a the residual is e = s - 1 / q, and de / dtheta = a / q^2. Writes sums
    (parts, N, 9): the upper triangle of sum a a' / q^4, then sum a e / q^2.
    """
    sums[first:last] = 0.0
    work = np.empty(_BLOCK)
    for start in range(first * PART, min(last * PART, s.size), _BLOCK):
        stop = min(start + _BLOCK, s.size)
        x, y, z = a[0, start:stop], a[1, start:stop], a[2, start:stop]
        d, marks, on = s[start:stop], label[start:stop], work[: stop - start]
        most = np.uint16(0)
        for i in range(marks.size):
            most = max(most, marks[i])
        for j in range(most):
            mark = np.uint16(j + 1)
            count = np.uint16(0)
            for i in range(marks.size):
                count += np.uint16(marks[i] == mark)
            if count == 0:
                continue
            for i in range(on.size):
                on[i] = 1.0 if marks[i] == mark else 0.0
            t0, t1, t2 = theta[j, 0], theta[j, 1], theta[j, 2]
            m00 = m01 = m02 = m11 = m12 = m22 = v0 = v1 = v2 = 0.0
            for i in range(on.size):
                q = t0 * x[i] + t1 * y[i] + t2 * z[i]
                r = 1.0 / (q if on[i] > 0.0 else 1.0)
                w = on[i] * r * r
                e = d[i] - r
                # Rows of the Jacobian; on is 0 or 1, so its square is itself.
                p0, p1, p2 = w * x[i], w * y[i], w * z[i]
                m00 += p0 * p0
                m01 += p0 * p1
                m02 += p0 * p2
                m11 += p1 * p1
                m12 += p1 * p2
                m22 += p2 * p2
                v0 += p0 * e
                v1 += p1 * e
                v2 += p2 * e
            _add(sums[start // PART, j], m00, m01, m02, m11, m12, m22, v0, v1, v2)


@compiled
def offer_sums(theta, a, s, ceiling, first, last, sums, saved):  # type: ignore[no-untyped-def]
    """`normal_sums` of one plane theta (1, 3) on the readings that it takes: e^2 < ceiling.

    Writes sums (parts, 1, 9) and saved (parts,): sum of min(0, e^2 - ceiling).
    """
    sums[first:last] = 0.0
    saved[first:last] = 0.0
    work = np.empty(_BLOCK)
    t0, t1, t2 = theta[0, 0], theta[0, 1], theta[0, 2]
    for start in range(first * PART, min(last * PART, s.size), _BLOCK):
        stop = min(start + _BLOCK, s.size)
        x, y, z = a[0, start:stop], a[1, start:stop], a[2, start:stop]
        d, c = s[start:stop], ceiling[start:stop]
        taken = work[: stop - start]
        total = 0.0
        for i in range(taken.size):
            r = 1.0 / (t0 * x[i] + t1 * y[i] + t2 * z[i])
            e = d[i] - r
            g = e * e - c[i]
            total += g if g < 0.0 else 0.0
            taken[i] = r if g < 0.0 else 0.0
        m00 = m01 = m02 = m11 = m12 = m22 = v0 = v1 = v2 = 0.0
        for i in range(taken.size):
            r = taken[i]
            w, e = r * r, d[i] - r
            p0, p1, p2 = w * x[i], w * y[i], w * z[i]
            m00 += p0 * p0
            m01 += p0 * p1
            m02 += p0 * p2
            m11 += p1 * p1
            m12 += p1 * p2
            m22 += p2 * p2
            v0 += p0 * e
            v1 += p1 * e
            v2 += p2 * e
        _add(sums[start // PART, 0], m00, m01, m02, m11, m12, m22, v0, v1, v2)
        saved[start // PART] += total


@internal
def _add(row, m00, m01, m02, m11, m12, m22, v0, v1, v2):  # type: ignore[no-untyped-def]
    row[0] += m00
    row[1] += m01
    row[2] += m02
    row[3] += m11
    row[4] += m12
    row[5] += m22
    row[6] += v0
    row[7] += v1
    row[8] += v2


@compiled
def gauss_newton(theta, sums, matrix, moved):  # type: ignore[no-untyped-def]
    """One least-squares step of every plane from its sums (parts, N, 9).

    Writes matrix (N, 3, 3) = sum a a' / q^4 and moved (N, 3) = theta - matrix^-1 sum a e / q^2, NaN
    where the readings do not fix a plane. As e^2 = delta^2 / (2 sigma^2), 2 * matrix is the Fisher
    information of theta.
    """
    for j in range(theta.shape[0]):
        total = np.zeros(9)
        for part in range(sums.shape[0]):
            total += sums[part, j]
        m, v = matrix[j], total[6:]
        m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2] = total[:6]
        m[1, 0], m[2, 0], m[2, 1] = m[0, 1], m[0, 2], m[1, 2]
        # Scaled to unit diagonal, a 3 x 3 determinant tells whether there is a plane.
        p, q, r = 1.0 / np.sqrt(m[0, 0]), 1.0 / np.sqrt(m[1, 1]), 1.0 / np.sqrt(m[2, 2])
        f, g, h = m[0, 1] * p * q, m[0, 2] * p * r, m[1, 2] * q * r
        determinant = 1.0 - f * f - g * g - h * h + 2.0 * f * g * h
        if not determinant > 1e-14:
            moved[j, :] = np.nan
            continue
        u, v, w = -v[0] * p, -v[1] * q, -v[2] * r
        moved[j, 0] = (
            theta[j, 0] + p * ((1.0 - h * h) * u + (g * h - f) * v + (f * h - g) * w) / determinant
        )
        moved[j, 1] = (
            theta[j, 1] + q * ((g * h - f) * u + (1.0 - g * g) * v + (f * g - h) * w) / determinant
        )
        moved[j, 2] = (
            theta[j, 2] + r * ((f * h - g) * u + (f * g - h) * v + (1.0 - f * f) * w) / determinant
        )


@compiled
def scatter(x, label, matrix):  # type: ignore[no-untyped-def]
    """matrix[j] = sum of x x' over the readings of plane j; x (n + 1, k)."""
    matrix[:] = 0.0
    size = x.shape[0]
    for i in range(label.size):
        j = label[i]
        if j == 0:
            continue
        for p in range(size):
            for q in range(p + 1):
                matrix[j - 1, p, q] += x[p, i] * x[q, i]
    for j in range(matrix.shape[0]):
        for p in range(size):
            for q in range(p):
                matrix[j, q, p] = matrix[j, p, q]


@compiled
def cell_moments(a, s, index, width, side, columns, moments):  # type: ignore[no-untyped-def]
    """Moments of the least-squares plane of every square cell of `side` pixels.

    Linear in inverse depth: theta minimises sum (theta . a s - 1)^2 s^2, the residual of 1 / z with
    its first-order weight. Writes moments (cells, 11): the upper triangle of sum b b' with
    b = a s^2, then sum b s, sum s^2 and the count.
    """
    moments[:] = 0.0
    for i in range(s.size):
        row = index[i] // width
        cell = (row // side) * columns + (index[i] - row * width) // side
        w = s[i] * s[i]
        x, y, z = a[0, i] * w, a[1, i] * w, a[2, i] * w
        m = moments[cell]
        m[0] += x * x
        m[1] += x * y
        m[2] += x * z
        m[3] += y * y
        m[4] += y * z
        m[5] += z * z
        m[6] += x * s[i]
        m[7] += y * s[i]
        m[8] += z * s[i]
        m[9] += w
        m[10] += 1.0


@compiled
def summarise(label, gain, square, direction, depth, solid, index, width, first, last, sums, box):  # type: ignore[no-untyped-def]
    """Sums over the readings of every plane in parts first <= p < last.

    A reading is at direction * depth (n, k) and covers depth^3 solid / distance of its plane;
    square is its squared residual; index, its place in the image, ascends. Writes sums (parts, N,
    4 + n): count, gain, delta^2, depth^3 solid, position; and box (parts, N, 4): first row and
    column, last row and column + 1.
    """
    sums[first:last] = 0.0
    box[first:last, :, :2] = np.iinfo(np.int64).max
    box[first:last, :, 2:] = 0
    start, stop = first * PART, min(last * PART, label.size)
    while start < stop:
        # A run of one label in one row of the image: all its sums are taken at once.
        of, part = label[start], start // PART
        row = index[start] // width
        before, end = (row + 1) * width, start + 1
        until = min((part + 1) * PART, stop)
        while end < until and label[end] == of and index[end] < before:
            end += 1
        if of > 0:
            z, total, extent = depth[start:end], sums[part, of - 1], box[part, of - 1]
            saved, square_of, area = gain[start:end], square[start:end], solid[start:end]
            s0 = s1 = s2 = 0.0
            for i in range(z.size):
                s0 += saved[i]
                s1 += square_of[i]
                s2 += z[i] * z[i] * z[i] * area[i]
            total[0] += z.size
            total[1] += s0
            total[2] += s1
            total[3] += s2
            for axis in range(direction.shape[0]):
                along, s3 = direction[axis, start:end], 0.0
                for i in range(z.size):
                    s3 += along[i] * z[i]
                total[4 + axis] += s3
            extent[0] = min(extent[0], row)
            extent[1] = min(extent[1], index[start] - row * width)
            extent[2] = max(extent[2], row + 1)
            extent[3] = max(extent[3], index[end - 1] - row * width + 1)
        start = end
