"""Loop over rows of information: the planes that they tell."""

from __future__ import annotations

import math

from planewise.kernels.jit import in_order


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
