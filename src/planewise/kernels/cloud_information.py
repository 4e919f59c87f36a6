"""Loops over groups of a cloud: their nats on planes and on none.

A group is the points of one label in one least cube, a row (`kernels.cloud_rows`) whose scatter is
whole. Only what lies across the plane is told apart: the other two coordinates of a point take the
same nats in any case.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cloud_rows import (
    COUNT,
    CUT,
    CX,
    CY,
    CZ,
    ROW,
    WEIGHT,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
    add_row,
    plane_axes,
    scatter_along,
    write_normal,
)
from planewise.kernels.jit import compiled, in_order, internal
from planewise.kernels.mixture import of_either
from planewise.kernels.walk import PLANE_BEND


@internal
def _on_none(row, norm, prior):  # type: ignore[no-untyped-def]
    """Nats of a group on none: a smooth surface or anything at all, whichever is shorter.

    prior: variance of a surface's slopes, nats of its offset, and of any point's.
    """
    chi2, largest, middle = write_normal(row)
    smooth = prior[1] + norm + 0.5 * chi2
    smooth += 0.5 * math.log((1.0 + prior[0] * largest) * (1.0 + prior[0] * max(middle, 0.0)))
    anything = row[COUNT] * prior[2]
    # Written so that a surface that is no number counts as none.
    return math.log(2.0) + (smooth if smooth < anything else anything)


@internal
def _on_plane(rows, g, planes, j, offset, tilt, norm, anything):  # type: ignore[no-untyped-def]
    """Nats of a group on a plane, its random offset and tilt integrated out."""
    nx, ny, nz = planes[j, 0], planes[j, 1], planes[j, 2]
    ex, ey, ez, fx, fy, fz = plane_axes(nx, ny, nz)
    sx = rows[g, XX] * nx + rows[g, XY] * ny + rows[g, XZ] * nz
    sy = rows[g, XY] * nx + rows[g, YY] * ny + rows[g, YZ] * nz
    sz = rows[g, XZ] * nx + rows[g, YZ] * ny + rows[g, ZZ] * nz
    square = nx * sx + ny * sy + nz * sz
    xw, yw = ex * sx + ey * sy + ez * sz, fx * sx + fy * sy + fz * sz
    xx, xy, yy = scatter_along(rows, g, ex, ey, ez, fx, fy, fz)
    a, b, c = 1.0 + tilt * xx, tilt * xy, 1.0 + tilt * yy
    determinant = max(a * c - b * b, 1.0)  # which rounding may hide
    u, v = tilt * (c * xw - b * yw) / determinant, tilt * (a * yw - b * xw) / determinant
    # Across the tilted plane, as on none.
    square = (square - u * xw - v * yw) / (1.0 + u * u + v * v)
    off = nx * rows[g, CX] + ny * rows[g, CY] + nz * rows[g, CZ] + planes[j, 3]
    wide = 1.0 + offset * rows[g, WEIGHT]
    chi2 = square + rows[g, WEIGHT] * off * off / wide
    on = 0.5 * (chi2 + math.log(wide * determinant)) + norm
    return math.log(2.0) + min(on, rows[g, COUNT] * anything)


@internal
def _norm(count, weight, resolution):  # type: ignore[no-untyped-def]
    """Nats of the densities of so many points at their mean, a cell of the resolution each."""
    return 0.5 * count * math.log(2.0 * math.pi * count / (weight * resolution * resolution))


@compiled
def groups_alone(groups, resolution, prior, first, last, alone):  # type: ignore[no-untyped-def]
    """Nats of groups[first:last] (m, 18) on none (`_on_none`)."""
    row = np.empty(ROW)
    for g in range(first, last):
        for e in range(ROW):
            row[e] = groups[g, e]
        alone[g] = _on_none(row, _norm(row[COUNT], row[WEIGHT], resolution), prior)


@compiled
def group_data(  # type: ignore[no-untyped-def]
    groups, label, alone, planes, error, side, resolution, anything, first, last, data
):  # fmt: skip
    """Nats of groups[first:last] as labelled.

    groups (m, 18), label (m,); alone (m,): of each on none; planes (N, 5): (normal, distance) and
    the variance of points about them; error: share of the white variance that the points of a group
    share, and how it wanders (`cloud_rows.compare`); side: of a cube; anything: nats of any point.
    Writes data (m,).
    """
    shared, drift, lean = error
    for g in range(first, last):
        nats, j = alone[g], label[g] - 1
        if j >= 0:
            count, weight = groups[g, COUNT], groups[g, WEIGHT]
            norm = _norm(count, weight, resolution)
            offset = shared * count / weight + planes[j, 4]
            own = count / weight / (side * side)
            tilt = PLANE_BEND[0] * drift / side + lean + CUT * own * own
            on = _on_plane(groups, g, planes, j, offset, tilt, norm, anything)
            nats = of_either(on, nats)
        data[g] = nats


@in_order
def sum_nats(groups, label, alone, data, anything, worth, saved):  # type: ignore[no-untyped-def]
    """Add data - alone to worth (N + 1,), and to saved (N + 1,) data less `anything` a point.

    Returns the sum of data.
    """
    total = 0.0
    for g in range(label.size):
        total += data[g]
        worth[label[g]] += data[g] - alone[g]
        saved[label[g]] += data[g] - groups[g, COUNT] * anything
    return total


@compiled
def groups_left(  # type: ignore[no-untyped-def]
    groups, label, places, place, resolution, prior, alone, data, first, last, left
):  # fmt: skip
    """What groups of cubes[first:last] have more when their plane goes, after those behind it.

    Points of a plane that is gone join those on none in their cube, so place (N + 1,), 1 ... N of
    every plane, says in which order. Writes left (m,).
    """
    row, work = np.empty(ROW), np.empty(ROW)
    for cube in range(first, last):
        paid, there = 0.0, False
        for g in range(places[cube], places[cube + 1]):
            if label[g] == 0:
                for e in range(ROW):
                    row[e] = groups[g, e]
                paid, there, left[g] = data[g], True, 0.0
        behind = np.int64(place.size)
        while True:
            gone, at = np.int64(0), 0
            for g in range(places[cube], places[cube + 1]):
                rank = np.int64(place[label[g]])
                if gone < rank < behind:
                    gone, at = rank, g
            if gone == 0:
                break
            if there:
                add_row(row, groups[at])
                for e in range(ROW):
                    work[e] = row[e]
                now = _on_none(work, _norm(row[COUNT], row[WEIGHT], resolution), prior)
            else:
                for e in range(ROW):
                    row[e] = groups[at, e]
                now, there = alone[at], True
            left[at] = now - paid - data[at]
            paid, behind = now, gone


@in_order
def add_residuals(groups, label, planes, out):  # type: ignore[no-untyped-def]
    """Add up the points of groups on each of planes (N, 4), and how far they lie from it.

    Adds to out (N, 5): number of points, sum of their squared distances and of their coordinates.
    """
    for g in range(label.size):
        j = label[g] - 1
        if j < 0:
            continue
        x, y, z = planes[j, 0], planes[j, 1], planes[j, 2]
        count = groups[g, COUNT]
        off = x * groups[g, CX] + y * groups[g, CY] + z * groups[g, CZ] + planes[j, 3]
        across = x * x * groups[g, XX] + y * y * groups[g, YY] + z * z * groups[g, ZZ]
        across += 2.0 * x * (y * groups[g, XY] + z * groups[g, XZ]) + 2.0 * y * z * groups[g, YZ]
        out[j, 0] += count
        out[j, 1] += count * (across / groups[g, WEIGHT] + off * off)
        out[j, 2] += count * groups[g, CX]
        out[j, 3] += count * groups[g, CY]
        out[j, 4] += count * groups[g, CZ]


@compiled
def plane_rows(groups, label, alone, data, error, drift_of, pieces, out, weights):  # type: ignore[no-untyped-def]
    """Add the groups on every plane to rows (N, 18), which begin as zeros, as do weights (N, 2).

    Each group counts with the information that its random offset leaves, times the probability
    that it is on its plane: none where it is shorter as a surface of its own. pieces: whether
    groups are pieces of thick sheets, whose offsets cancel in the sum and do not count. Adds to
    weights those that count, and those with offsets.
    """
    shared = 0.0 if pieces else error
    row = np.empty(ROW)
    for g in range(label.size):
        j = label[g] - 1
        if j < 0:
            continue
        for e in range(ROW):
            row[e] = groups[g, e]
        variance, weight = row[COUNT] / row[WEIGHT], row[WEIGHT]
        on = 1e-3 if data[g] >= alone[g] else 1.0
        share = on / (1.0 + (shared * variance + drift_of[j]) * weight)
        weights[j, 0] += weight * share
        weights[j, 1] += weight * on / (1.0 + (error * variance + drift_of[j]) * weight)
        row[WEIGHT] *= share
        for e in range(XX, ZZ + 1):
            row[e] *= share
        if out[j, COUNT] == 0.0:
            for e in range(ROW):
                out[j, e] = row[e]
        else:
            add_row(out[j], row)
