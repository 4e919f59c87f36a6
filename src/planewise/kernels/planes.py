"""Loops over planes: what rows of information tell, what they are in space, which are near."""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cells import SIDE, UNIT
from planewise.kernels.jit import compiled, in_order
from planewise.kernels.tables import between
from planewise.kernels.walk import FIELD, PLANE_SLOPE


@in_order
def affine_planes(rows, planes):  # type: ignore[no-untyped-def]
    """(t0, t1, t2) of w = t0 + t1 x + t2 y from rows (n, 9 or more) of segments (`kernels.cells`).

    P t = q is solved by Cholesky's way, P scaled to unit diagonal. Writes planes (n, 3), not finite
    where P is singular.
    """
    for k in range(planes.shape[0]):
        row, out = rows[k], planes[k]
        s0, s1, s2 = 1.0 / math.sqrt(row[0]), 1.0 / math.sqrt(row[3]), 1.0 / math.sqrt(row[5])
        a, b, c = row[1] * s0 * s1, row[2] * s0 * s2, row[4] * s1 * s2
        d1 = 1.0 - a * a
        e = (c - a * b) / d1
        d2 = 1.0 - b * b - e * e * d1
        y0, y1 = row[6] * s0, row[7] * s1 - a * row[6] * s0
        y2 = row[8] * s2 - b * y0 - e * y1
        z2 = y2 / d2
        z1 = y1 / d1 - e * z2
        z0 = y0 - a * z1 - b * z2
        out[0], out[1], out[2] = s0 * z0, s1 * z1, s2 * z2


@in_order
def in_space(  # type: ignore[no-untyped-def]
    affine, information, drift, per_metre, factor, extent, turn, rows, covariances
):
    """Normal and distance of planes w = t0 + t1 x + t2 y, and their covariance.

    affine (n, 3), information (n, 3, 3): t, and P on it; turn (3, 3): (normal, distance) =
    (-theta, 1) / |theta|, theta = turn t. With J its derivatives by t and P = S^-1 L L' S^-1, S
    diagonal, the covariance of random errors is V' V with L V = S J'. drift (L,): D of the error's
    walk by depth, per_metre rows a metre, times factor; it moves a plane as a whole, in an image of
    that extent (`FIELD`), and tilts it (`PLANE_SLOPE`). Writes rows (n, 4) and covariances
    (n, 4, 4), which are not finite where P is singular.
    """
    half, last = np.empty((6, 4)), drift.size - 2
    for k in range(affine.shape[0]):
        t, p = affine[k], information[k]
        middle_x, middle_y = p[0, 1] / p[0, 0], p[0, 2] / p[0, 0]
        xx = p[1, 1] / p[0, 0] - middle_x * middle_x
        yy = p[2, 2] / p[0, 0] - middle_y * middle_y
        xy = p[1, 2] / p[0, 0] - middle_x * middle_y
        # Side of a square whose readings spread as much.
        side = max(math.sqrt(12.0 * math.sqrt(max(xx * yy - xy * xy, 0.0))), SIDE / UNIT)
        w = t[0] + t[1] * middle_x + t[2] * middle_y
        walk = factor * between(drift, per_metre / w, last) if w > 0.0 else 0.0
        offset, slope = (
            math.sqrt(FIELD * walk * extent),
            math.sqrt(PLANE_SLOPE * walk / side),
        )
        x, y, z = 0.0, 0.0, 0.0
        for j in range(3):
            x, y, z = x + turn[0, j] * t[j], y + turn[1, j] * t[j], z + turn[2, j] * t[j]
        distance = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * distance, y * distance, z * distance
        rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3] = -x, -y, -z, distance
        s = 1.0 / math.sqrt(p[0, 0]), 1.0 / math.sqrt(p[1, 1]), 1.0 / math.sqrt(p[2, 2])
        for j in range(3):
            along = x * turn[0, j] + y * turn[1, j] + z * turn[2, j]
            half[j, 0] = -distance * (turn[0, j] - along * x)
            half[j, 1] = -distance * (turn[1, j] - along * y)
            half[j, 2] = -distance * (turn[2, j] - along * z)
            half[j, 3] = -distance * distance * along
        for m in range(4):
            half[3, m] = offset * half[0, m]
            half[4, m] = slope * (half[1, m] - middle_x * half[0, m])
            half[5, m] = slope * (half[2, m] - middle_y * half[0, m])
            for j in range(3):
                half[j, m] *= s[j]
        a, b, c = p[0, 1] * s[0] * s[1], p[0, 2] * s[0] * s[2], p[1, 2] * s[1] * s[2]
        second = math.sqrt(1.0 - a * a)
        e = (c - a * b) / second
        third = math.sqrt(1.0 - b * b - e * e)
        for m in range(4):
            half[1, m] = (half[1, m] - a * half[0, m]) / second
            half[2, m] = (half[2, m] - b * half[0, m] - e * half[1, m]) / third
        for m in range(4):
            for n in range(4):
                total = 0.0
                for j in range(6):
                    total += half[j, m] * half[j, n]
                covariances[k, m, n] = total


@compiled
def nearest_planes(planes, information, nearest, far):  # type: ignore[no-untyped-def]
    """For every plane (N, 3) with the information on it (N, 3, 3) the one that is nearest by it.

    Writes nearest (N,), the plane itself if it is the only one, and far (N,), half the squared
    distance to it.
    """
    for n in range(planes.shape[0]):
        p = information[n]
        nearest[n], far[n] = n, np.inf
        for m in range(planes.shape[0]):
            x, y = planes[m, 0] - planes[n, 0], planes[m, 1] - planes[n, 1]
            z = planes[m, 2] - planes[n, 2]
            square = p[0, 0] * x * x + p[1, 1] * y * y + p[2, 2] * z * z
            half = 0.5 * square + p[0, 1] * x * y + p[0, 2] * x * z + p[1, 2] * y * z
            if m != n and half < far[n]:
                nearest[n], far[n] = m, half
