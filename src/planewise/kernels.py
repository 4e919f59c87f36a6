"""The compiled loops. Nothing else in the package is compiled, and these call nothing outside.

Readings on rays are whitened so that a plane theta (theta . x = 1) is scored without sigma:

    a = r sigma sqrt(2),   s = z / (sigma sqrt(2)),   delta^2 / (2 sigma^2) = (s - 1 / (theta . a))^2

Free points are whitened homogeneous coordinates x' = (x, 1) / (sigma sqrt(2)), and a plane h = (n, d)
has delta^2 / (2 sigma^2) = (h . x')^2. In both cases a reading's gain is that square minus tau.

Loops run over blocks of readings that fit the first-level cache, planes outside readings, so that
the innermost loop is one vector expression. Blocks are slices: indices that start at zero need no
check for negative ones, which would keep the loop from being vectorised. NaN is honoured (a NaN plane gains nothing), hence not
the whole of ``fastmath``.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_BLOCK = 1024
_FAST = {"reassoc", "contract", "arcp", "nsz"}
_OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": _FAST}


@njit(**_OPTIONS)
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


@njit(**_OPTIONS)
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


@njit(**_OPTIONS)
def _keep_best(g, plane, best, second, label):  # type: ignore[no-untyped-def]
    """Enter the gains of one plane into the best and second-best of a block; sum the best."""
    part = 0.0
    for i in range(g.size):
        low = g[i] < best[i]
        second[i] = best[i] if low else min(second[i], g[i])
        label[i] = plane if low else label[i]
        best[i] = g[i] if low else best[i]
        part += best[i]
    return part


@njit(**_OPTIONS)
def assign_rays(theta, a, s, tau, best, second, label, cumulative):  # type: ignore[no-untyped-def]
    """Give every reading to the plane of lowest gain below zero, else to none.

    theta (N, 3), a (3, k), s, tau (k,): float64. Writes best and second-best gain (k,), label (k,)
    uint16 with 0 for none, and cumulative (N + 1,): the sum of best gains with the first 0 ... N
    planes alone.
    """
    work = np.empty(_BLOCK)
    best[:] = 0.0
    second[:] = 0.0
    label[:] = 0
    cumulative[:] = 0.0
    for start in range(0, s.size, _BLOCK):
        stop = min(start + _BLOCK, s.size)
        x, y, z = a[0, start:stop], a[1, start:stop], a[2, start:stop]
        d, c, g = s[start:stop], tau[start:stop], work[: stop - start]
        for j in range(theta.shape[0]):
            t0, t1, t2 = theta[j, 0], theta[j, 1], theta[j, 2]
            for i in range(g.size):
                e = d[i] - 1.0 / (t0 * x[i] + t1 * y[i] + t2 * z[i])
                g[i] = e * e - c[i]
            cumulative[j + 1] += _keep_best(
                g, np.uint16(j + 1), best[start:stop], second[start:stop], label[start:stop]
            )


@njit(**_OPTIONS)
def assign_points(h, x, tau, best, second, label, cumulative):  # type: ignore[no-untyped-def]
    """`assign_rays` for free points: h (N, n + 1), x (n + 1, k) float64."""
    work = np.empty(_BLOCK)
    best[:] = 0.0
    second[:] = 0.0
    label[:] = 0
    cumulative[:] = 0.0
    for start in range(0, tau.size, _BLOCK):
        stop = min(start + _BLOCK, tau.size)
        c, g = tau[start:stop], work[: stop - start]
        for j in range(h.shape[0]):
            g[:] = 0.0
            for axis in range(x.shape[0]):
                weight, row = h[j, axis], x[axis, start:stop]
                for i in range(g.size):
                    g[i] += weight * row[i]
            for i in range(g.size):
                g[i] = g[i] * g[i] - c[i]
            cumulative[j + 1] += _keep_best(
                g, np.uint16(j + 1), best[start:stop], second[start:stop], label[start:stop]
            )


@njit(**_OPTIONS)
def normal_equations(theta, a, s, label, matrix, vector):  # type: ignore[no-untyped-def]
    """Gauss-Newton equations of every plane on its readings.

    With q = theta . a the residual is e = s - 1 / q and de / dtheta = a / q^2. Writes matrix
    (N, 3, 3) = sum a a' / q^4 and vector (N, 3) = -sum a e / q^2. As e^2 = delta^2 / (2 sigma^2),
    2 * matrix is the Fisher information of theta.
    """
    matrix[:] = 0.0
    vector[:] = 0.0
    for i in range(s.size):
        j = label[i]
        if j == 0:
            continue
        j -= 1
        x, y, z = a[0, i], a[1, i], a[2, i]
        r = 1.0 / (theta[j, 0] * x + theta[j, 1] * y + theta[j, 2] * z)
        w = r * r
        e = s[i] - r
        x, y, z = x * w, y * w, z * w
        matrix[j, 0, 0] += x * x
        matrix[j, 0, 1] += x * y
        matrix[j, 0, 2] += x * z
        matrix[j, 1, 1] += y * y
        matrix[j, 1, 2] += y * z
        matrix[j, 2, 2] += z * z
        vector[j, 0] -= x * e
        vector[j, 1] -= y * e
        vector[j, 2] -= z * e
    for j in range(matrix.shape[0]):
        matrix[j, 1, 0] = matrix[j, 0, 1]
        matrix[j, 2, 0] = matrix[j, 0, 2]
        matrix[j, 2, 1] = matrix[j, 1, 2]


@njit(**_OPTIONS)
def scatter(x, label, matrix):  # type: ignore[no-untyped-def]
    """matrix[j] = sum of x x' over the readings of plane j: x (n + 1, k), matrix (N, n + 1, n + 1)."""
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


@njit(**_OPTIONS)
def cell_moments(a, s, index, width, side, columns, moments):  # type: ignore[no-untyped-def]
    """Moments of the least-squares plane of every square cell of `side` pixels.

    Linear in inverse depth: theta minimises sum (theta . a s - 1)^2 s^2, the residual of 1 / z with
    its first-order weight. Writes moments (cells, 10): the upper triangle of sum b b' with
    b = a s^2, then sum b s, then the count.
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
        m[9] += 1.0


@njit(**_OPTIONS)
def summarise(label, gain, square, position, area, index, width, sums, box):  # type: ignore[no-untyped-def]
    """Sums over the readings of every plane in one pass.

    position (n, k); the rest (k,). Writes sums (N, 4 + n): count, gain, squared residual, area,
    position; and box (N, 4): first row and column, last row and column + 1.
    """
    sums[:] = 0.0
    for j in range(box.shape[0]):
        box[j, 0] = box[j, 1] = np.iinfo(np.int64).max
        box[j, 2] = box[j, 3] = 0
    for i in range(label.size):
        if label[i] == 0:
            continue
        j = label[i] - 1
        sums[j, 0] += 1.0
        sums[j, 1] += gain[i]
        sums[j, 2] += square[i]
        sums[j, 3] += area[i]
        for axis in range(position.shape[0]):
            sums[j, 4 + axis] += position[axis, i]
        row = index[i] // width
        column = index[i] - row * width
        box[j, 0] = min(box[j, 0], row)
        box[j, 1] = min(box[j, 1], column)
        box[j, 2] = max(box[j, 2], row + 1)
        box[j, 3] = max(box[j, 3], column + 1)
