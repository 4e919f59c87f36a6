"""Loops over cells: moments, which cells are planes, and what their shared error leaves of them.

On a plane inverse depth w = 1 / z is affine in the image: w = t0 + t1 X + t2 Y, where X and Y are
undistorted pixel coordinates divided by `UNIT`. A row of moments holds, for readings of weight p,

    [sum p, pX, pY, pXX, pXY, pYY, pw, pXw, pYw, pww, count]

and says all about any plane on its readings. A row of a segment has the same layout: its first nine
entries are the information P on the plane's parameters once the error that neighbouring readings
share is integrated out, and P t; adding rows joins segments. Two entries follow: the misfit of the
joins so far, and what the cells would cost as a free smooth surface.
"""

from __future__ import annotations

import numpy as np
from numba import njit

UNIT = 100.0  # pixels per unit of X and Y
MOMENTS = 11
COUNT, MISFIT, FREE = 10, 11, 12  # entries of a segment beyond the moments'
SEGMENT = 13

# Of an error that wanders like a random walk, D |r| the variance of a difference over a distance r;
# for squares side by side (docs/method.md derives them):
PLANE_OFFSET = 0.13  # variance of the offset of two planes where they meet: D times the larger side
PLANE_BEND = (0.9, 0.3)  # of their slopes: D over the smaller and the larger side
PLANE_RESIDUAL = 0.113  # mean variance about the plane of a square of side 1

_FAST = {"reassoc", "contract", "arcp", "nsz"}
_compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)


@_compiled
def _add_reading(m, weight, a, b, v):  # type: ignore[no-untyped-def]
    """Add a reading of inverse depth v at (a, b) to a row of moments."""
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
    m[10] += 1.0


@_compiled
def spread(index, values, images):  # type: ignore[no-untyped-def]
    """Write values (E, k) of readings into images (E, H * W) that are zero elsewhere."""
    images[:] = 0.0
    for e in range(values.shape[0]):
        for i in range(index.size):
            images[e, index[i]] = values[e, i]


@_compiled
def cell_moments(w, p, x, y, side, moments):  # type: ignore[no-untyped-def]
    """Moments of every cell of side x side pixels; w, p, x, y (H, W), p = 0 without a reading."""
    height, width = w.shape
    columns = (width + side - 1) // side
    moments[:] = 0.0
    for i in range(height):
        row = (i // side) * columns
        for j in range(width):
            weight = p[i, j]
            if weight > 0.0:
                m = moments[row + j // side]
                _add_reading(m, weight, x[i, j], y[i, j], w[i, j])


@_compiled
def _own_misfit(m):  # type: ignore[no-untyped-def]
    """chi^2 of the best plane of a row of moments."""
    if m[0] <= 0.0:
        return 0.0
    cx, cy, mean = m[1] / m[0], m[2] / m[0], m[6] / m[0]
    xx, xy, yy = m[3] - cx * m[1], m[4] - cx * m[2], m[5] - cy * m[2]
    xw, yw = m[7] - cx * m[6], m[8] - cy * m[6]
    square = m[9] - mean * m[6]
    determinant = xx * yy - xy * xy
    if determinant <= 1e-9 * xx * yy:
        return max(square, 0.0)
    tx, ty = (yy * xw - xy * yw) / determinant, (xx * yw - xy * xw) / determinant
    return max(square - tx * xw - ty * yw, 0.0)


@_compiled
def own_misfits(moments, out):  # type: ignore[no-untyped-def]
    """chi^2 of the best plane of every row of moments."""
    for i in range(moments.shape[0]):
        out[i] = _own_misfit(moments[i])


@_compiled
def merge_quarters(moments, rows, columns, side, white, split, hopeless, filled, unit, units, size):  # type: ignore[no-untyped-def]
    """Join 2 x 2 cells where one plane explains them, else keep each that has a plane of its own.

    white: chi^2 per degree of freedom of white noise in this frame; split: F above which four
    planes are needed; hopeless: chi^2 per degree of freedom, in units of white, above which there
    is none; filled: least share of a cell's pixels. Writes unit (rows * columns): index of the unit
    of every cell or -1; units (., 11) their moments; size (.): 2 or 1. Returns the number of units.
    """
    full = float(side * side)
    found = 0
    m = np.empty(MOMENTS)
    unit[:] = -1
    for top in range(0, rows, 2):
        for left in range(0, columns, 2):
            m[:] = 0.0
            apart = 0.0
            for i in range(top, min(top + 2, rows)):
                for j in range(left, min(left + 2, columns)):
                    m += moments[i * columns + j]
                    apart += _own_misfit(moments[i * columns + j])
            together = _own_misfit(m)
            freedom = m[COUNT] - 3.0
            whole = m[COUNT] >= 4 * filled * full and together <= hopeless * white * freedom
            if whole and together > white * freedom:
                # F of the nine further parameters of four planes: free of the noise's scale.
                apart = max(apart, 0.5 * white * (freedom - 9.0))
                whole = (together - apart) * (freedom - 9.0) <= split * 9.0 * apart
            for i in range(top, min(top + 2, rows)):
                for j in range(left, min(left + 2, columns)):
                    c = i * columns + j
                    count = moments[c, COUNT]
                    if whole:
                        if count > 0.0:
                            unit[c] = found
                        continue
                    bound = hopeless * white * (count - 3.0)
                    if count >= max(filled * full, 8.0) and _own_misfit(moments[c]) <= bound:
                        unit[c] = found
                        units[found] = moments[c]
                        size[found] = 1.0
                        found += 1
            if whole:
                units[found] = m
                size[found] = 2.0
                found += 1
    return found


@_compiled
def marginalise(units, offset, tilt, segments):  # type: ignore[no-untyped-def]
    """Information of every unit on a plane, its own random effect N(0, Sigma) integrated out.

    P = (A^-1 + Sigma)^-1 about the unit's centroid, A its weighted normal equations, divided by its
    chi^2 per degree of freedom where that exceeds one. offset, tilt (units,): Sigma is diagonal,
    the variances of the offset and of either slope.
    """
    for k in range(units.shape[0]):
        m, out = units[k], segments[k]
        cx, cy, mean = m[1] / m[0], m[2] / m[0], m[6] / m[0]
        inflated = max(1.0, _own_misfit(m) / (m[COUNT] - 3.0))
        a = m[0] / inflated
        xx = (m[3] - cx * m[1]) / inflated
        xy = (m[4] - cx * m[2]) / inflated
        yy = (m[5] - cy * m[2]) / inflated
        xw, yw = (m[7] - cx * m[6]) / inflated, (m[8] - cy * m[6]) / inflated
        determinant = xx * yy - xy * xy
        vxx, vxy, vyy = yy / determinant, -xy / determinant, xx / determinant
        tx, ty = vxx * xw + vxy * yw, vxy * xw + vyy * yw
        level = 1.0 / (1.0 / a + offset[k])
        cxx, cyy = vxx + tilt[k], vyy + tilt[k]
        determinant = cxx * cyy - vxy * vxy
        pxx, pxy, pyy = cyy / determinant, -vxy / determinant, cxx / determinant
        qx, qy = pxx * tx + pxy * ty, pxy * tx + pyy * ty
        out[0], out[1], out[2] = level, level * cx, level * cy
        out[3], out[4] = level * cx * cx + pxx, level * cx * cy + pxy
        out[5] = level * cy * cy + pyy
        out[6], out[7], out[8] = level * mean, level * mean * cx + qx, level * mean * cy + qy
        out[9] = level * mean * mean + qx * tx + qy * ty
        out[COUNT], out[MISFIT], out[FREE] = m[COUNT], 0.0, 0.0


@_compiled
def label_groups(label, p, side, columns, planes, place):  # type: ignore[no-untyped-def]
    """Number the pairs of cell and label that occur: place (cells, planes + 1), -1 elsewhere."""
    height, width = label.shape
    place[:] = -1
    for i in range(height):
        for j in range(width):
            if p[i, j] > 0.0:
                place[(i // side) * columns + j // side, label[i, j]] = 0
    found = 0
    for cell in range(place.shape[0]):
        for n in range(planes + 1):
            if place[cell, n] == 0:
                place[cell, n] = found
                found += 1
    return found


@_compiled
def group_moments(label, w, p, x, y, extra, side, columns, place, moments):  # type: ignore[no-untyped-def]
    """Moments of every group of one cell and one label, and the sums of further images.

    extra (E, H, W). Writes moments (groups, 11 + E).
    """
    height, width = label.shape
    moments[:] = 0.0
    for i in range(height):
        for j in range(width):
            weight = p[i, j]
            if weight > 0.0:
                m = moments[place[(i // side) * columns + j // side, label[i, j]]]
                _add_reading(m, weight, x[i, j], y[i, j], w[i, j])
                for k in range(extra.shape[0]):
                    m[MOMENTS + k] += extra[k, i, j]
