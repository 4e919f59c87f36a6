"""Loop over readings: a plane in inverse depth for every cell, and how far its readings are off."""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import add_reading
from planewise.kernels.jit import in_order

SUMS = 10  # of 1, x, y, x x, x y, y y, w, x w, y w, w w
PLANE = 7  # count, centroid x and y, w there, slopes along x and y, sum of squared residuals


@in_order
def cell_planes(index, depth, rays, focal, width, side, columns, sums, planes):  # type: ignore[no-untyped-def]
    """Least-squares plane w = w0 + wx (x - cx) + wy (y - cy) of every cell of side x side pixels.

    index (k,) in rising order, depth (k,), rays (3, k): readings of an image of this width; focal:
    lengths in pixels along x and y, so that x and y are pixels about the principal point. sums
    (cells, 10) is room to work in. Writes planes (cells, 7): count, cx, cy, w0, wx, wy and the sum
    of squared residuals; NaN beyond the count where the readings do not determine a plane.
    """
    sums[:] = 0.0
    column = np.empty(width, np.int64)
    for j in range(width):
        column[j] = j // side
    row, start = 0, 0  # of the pixel row that reading k lies in
    for k in range(index.size):
        while index[k] >= start + width:
            start += width
            row += 1
        m = sums[(row // side) * columns + column[index[k] - start]]
        x, y, w = rays[0, k] * focal[0], rays[1, k] * focal[1], 1.0 / depth[k]
        add_reading(m, 1.0, x, y, w)
    for c in range(sums.shape[0]):
        m, out = sums[c], planes[c]
        out[:] = np.nan
        out[0] = m[0]
        if m[0] < 4.0:
            continue
        cx, cy, mean = m[1] / m[0], m[2] / m[0], m[6] / m[0]
        xx, xy, yy = m[3] - cx * m[1], m[4] - cx * m[2], m[5] - cy * m[2]
        xw, yw = m[7] - cx * m[6], m[8] - cy * m[6]
        determinant = xx * yy - xy * xy
        if determinant <= 1e-6 * xx * yy:
            continue
        tx, ty = (yy * xw - xy * yw) / determinant, (xx * yw - xy * xw) / determinant
        out[1], out[2], out[3], out[4], out[5] = cx, cy, mean, tx, ty
        out[6] = max(m[9] - mean * m[6] - tx * xw - ty * yw, 0.0)
