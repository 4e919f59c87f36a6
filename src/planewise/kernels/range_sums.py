"""Sums over the readings of every plane of a label image of ranges, in sectors."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import compiled

_FAR = 1 << 31  # beyond any row: where no pixels begin


@compiled
def range_sums(  # type: ignore[no-untyped-def]
    labels, place, w, ratio, column, rays, solid, planes, first, last, ranked, sums, rows, columns
):
    """Rank labels, and sum over the readings of every plane normal . x + distance = 0.

    In rows first ... last - 1. labels, w and ratio (H, W'): in sectors, 0 where there is no
    reading, inverse depth and c = z / range; column (W',): of the image, -1 for none; place (.):
    what becomes of each label, 0 for none; rays (3, H W), solid (H, W): unit direction and area at
    range 1 of every pixel; planes (N, 4), ranked. Writes ranked (H, W) uint16; sums (N, 7): count,
    0, squared distance to the plane, range^3 solid, x, y, z; rows (N, 2): first and last + 1.
    Marks columns (N, W) in which a plane has readings.
    """
    sums[:] = 0.0
    rows[:, 0], rows[:, 1] = _FAR, 0
    width = ranked.shape[1]
    for i in range(first, last):
        label, inverse, c = labels[i], w[i], ratio[i]
        for k in range(column.size):
            j = column[k]
            if j < 0:
                continue
            rank = place[label[k]]
            ranked[i, j] = rank
            if rank == 0:
                continue
            n = np.intp(rank) - 1
            at = i * width + j
            s = 1.0 / (np.float64(inverse[k]) * c[k])
            x, y, z = s * rays[0, at], s * rays[1, at], s * rays[2, at]
            off = planes[n, 0] * x + planes[n, 1] * y + planes[n, 2] * z + planes[n, 3]
            total = sums[n]
            total[0] += 1.0
            total[2] += off * off
            total[3] += s * s * s * solid[i, j]
            total[4] += x
            total[5] += y
            total[6] += z
            rows[n, 0] = min(rows[n, 0], i)
            rows[n, 1] = i + 1
            columns[n, j] = True
