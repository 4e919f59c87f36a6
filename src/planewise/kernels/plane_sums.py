"""Sums over the readings of every plane of a label image, run by run."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import called, compiled
from planewise.kernels.masks import list_runs, room_for_runs

_FAR = 1 << 31  # beyond any row or column: where the box of no pixels begins


@compiled
def plane_sums(  # type: ignore[no-untyped-def]
    labels, place, w, x, y, straight, planes, solid, ratio, first, last, ranked, sums, boxes
):
    """Rank labels, and sum over the readings of every plane w = t0 + t1 x + t2 y.

    In rows first ... last - 1.
    labels (H, W) uint16, 0 where there is no reading; place (.): what becomes of each, 0 for none;
    w, x, y (H, W) float32, straight as in `kernels.cells`; planes (N, 3), ranked; solid: area of
    every pixel where readings are 1, (H, W), or of them all, (1, 1); ratio: c = z / reading (H, W),
    or (1, 1) where readings are z. Writes ranked (H, W) uint16; sums (N, 7): count, 0, delta^2, s^3
    solid, z x, z y, z, with z = 1 / w, s = z / c and delta = s - 1 / (c t . (1, x, y)); and boxes
    (N, 4): first row and column, last row and column + 1.
    """
    sums[:] = 0.0
    boxes[:, :2] = _FAR
    boxes[:, 2:] = 0
    line = np.empty(labels.shape[1], y.dtype)
    ends, places = room_for_runs(line.size)
    _add_up(
        labels, place, w, x, y, straight, planes, solid, ratio, first, last, line, ends, places,
        ranked, sums, boxes,
    )  # fmt: skip


@called
def _add_up(  # type: ignore[no-untyped-def]
    labels, place, w, x, y, straight, planes, solid, ratio, first, last, line, ends, places,
    ranked, sums, boxes,
):  # fmt: skip
    """`plane_sums`, with room for a row."""
    for i in range(first, last):
        row, stop = labels[i], 0
        line[:] = y[i, 0]
        for n in range(list_runs(row, ends, places)):
            start, stop = stop, int(places[n]) + 1
            rank = place[row[start]]
            ranked[i, start:stop] = rank
            if rank == 0:
                continue
            j = rank - 1
            t0, t1, t2 = planes[j, 0], planes[j, 1], planes[j, 2]
            v, a = w[i, start:stop], x[0 if straight else i, start:stop]
            b = line[start:stop] if straight else y[i, start:stop]
            square = cube = across = down = along = 0.0
            for k in range(v.size):
                inverse, c, d = np.float64(v[k]), np.float64(a[k]), np.float64(b[k])
                q = t0 + t1 * c + t2 * d
                r = 1.0 / (inverse * q)
                z = q * r
                delta = (q - inverse) * r
                square += delta * delta
                cube += z * z * z
                across += z * c
                down += z * d
                along += z
            if ratio.size > 1:
                area, less = solid[i, start:stop], ratio[i, start:stop]
                square = cube = 0.0
                for k in range(v.size):
                    inverse, c, d = np.float64(v[k]), np.float64(a[k]), np.float64(b[k])
                    q = t0 + t1 * c + t2 * d
                    r = 1.0 / (inverse * q * less[k])
                    s, delta = q * r, (q - inverse) * r
                    square += delta * delta
                    cube += s * s * s * area[k]
            elif solid.size > 1:
                area = solid[i, start:stop]
                cube = 0.0
                for k in range(v.size):
                    z = 1.0 / np.float64(v[k])
                    cube += z * z * z * area[k]
            else:
                cube *= solid[0, 0]
            total, box = sums[j], boxes[j]
            total[0] += v.size
            total[2] += square
            total[3] += cube
            total[4] += across
            total[5] += down
            total[6] += along
            box[0], box[1] = min(box[0], i), min(box[1], start)
            box[2], box[3] = i + 1, max(box[3], stop)
