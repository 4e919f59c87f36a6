"""Loops of the exact search for the lowest score: order readings, bound runs of them, score runs.

A run is `RUN` readings that lie near to each other. A reading a, s gains on a plane theta where
|s - 1 / q| < sqrt(tau) with q = theta . a (see `planewise.kernels.readings`). Hence no reading of
a run gains unless, for the q of the box around its a,

    q low < 1 and q high > 1,   low = min(s - sqrt(tau)), high = max(s + sqrt(tau)),

and it saves no more than its worth, the sum of tau, if one might. What is skipped gains nothing in
single precision either: with one rounding u = 2^-24, the ends of the range of q and the q of a
reading differ from their exact values by no more than 9 u sum |theta_i| max |a_i|, the ends of its
interval by 6 u (s + sqrt(tau)), and box and interval are widened by 16 u.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import compiled, internal

RUN = 64
_BLOCK = 32  # runs that fit the first-level cache
STRIP = 32_768  # readings that are ordered together
_CELL = 512  # readings of a cell on average
_DEPTHS = 64  # parts of a cell in depth
_SLACK = 1e-6  # relative, more than 16 u
_EVERYTHING = 1e30


@compiled
def order_rays(a, s, first, last, order):  # type: ignore[no-untyped-def]
    """Order the readings of strips first <= p < last, each for itself, by a counting sort.

    It goes by cells of the image, and by depth within a cell; from one cell to the next the order
    in depth is turned around, so that a run across both stays small. a (3, k) of rays (u, v, 1),
    s (k,): float64; writes order (k,) int32.
    """
    for strip in range(first, last):
        _order_strip(a, s, strip * STRIP, min((strip + 1) * STRIP, s.size), order)


@internal
def _order_strip(a, s, start, stop, order):  # type: ignore[no-untyped-def]
    u0 = v0 = z0 = np.inf
    u1 = v1 = z1 = -np.inf
    # Every 16th reading tells the extent well enough: the others are put in the outer cells.
    for i in range(start, stop, 16):
        u, v, z = a[0, i] / a[2, i], a[1, i] / a[2, i], s[i] * a[2, i]
        u0, v0, z0 = min(u0, u), min(v0, v), min(z0, z)
        u1, v1, z1 = max(u1, u), max(v1, v), max(z1, z)
    width, height = max(u1 - u0, 1e-9), max(v1 - v0, 1e-9)
    cells = max(1, (stop - start) // _CELL)
    columns = min(max(1, int(np.sqrt(cells * width / height))), cells)
    rows = max(1, cells // columns)
    across, down = columns / width, rows / height
    deep = _DEPTHS / max(z1 - z0, 1e-9)
    key = np.empty(stop - start, np.int32)
    place = np.zeros(rows * columns * _DEPTHS + 1, np.int32)
    place[0] = start
    for i in range(start, stop):
        inverse = 1.0 / a[2, i]
        column = int(max(0.0, min((a[0, i] * inverse - u0) * across, columns - 1.0)))
        row = int(max(0.0, min((a[1, i] * inverse - v0) * down, rows - 1.0)))
        part = int(max(0.0, min((s[i] * a[2, i] - z0) * deep, _DEPTHS - 1.0)))
        cell = row * columns + column
        part = _DEPTHS - 1 - part if cell % 2 else part
        key[i - start] = cell * _DEPTHS + part
        place[cell * _DEPTHS + part + 1] += 1
    for j in range(1, place.size):
        place[j] += place[j - 1]
    for i in range(start, stop):
        order[place[key[i - start]]] = i
        place[key[i - start]] += 1


@compiled
def pack_rays(a, s, tau, order, first, last, data, box, worth):  # type: ignore[no-untyped-def]
    """Gather runs first <= j < last and bound them.

    Writes data (R, 5, RUN) float32: a, s and tau of the readings of every run; box (8, R) float32:
    centre and half size of a, low and high; worth (R,) int32: the sum of tau, rounded up.
    """
    for j in range(first, last):
        part = data[j]
        least, most = np.full(3, np.inf), np.full(3, -np.inf)
        low, high, total = np.inf, -np.inf, 0.0
        for i in range(RUN):
            # The last run is filled up with readings that cannot gain.
            there = j * RUN + i < order.size
            n = order[j * RUN + i] if there else order[j * RUN]
            for axis in range(3):
                part[axis, i] = a[axis, n]
                least[axis], most[axis] = min(least[axis], a[axis, n]), max(most[axis], a[axis, n])
            part[3, i], part[4, i] = s[n], tau[n] if there else 0.0
            if there and tau[n] > 0.0:
                reach = np.sqrt(tau[n])
                slack = _SLACK * (s[n] + reach)
                low, high = min(low, s[n] - reach - slack), max(high, s[n] + reach + slack)
                total += tau[n]
        for axis in range(3):
            size = max(abs(least[axis]), abs(most[axis]))
            box[axis, j] = 0.5 * (least[axis] + most[axis])
            box[3 + axis, j] = 0.5 * (most[axis] - least[axis]) + _SLACK * size
        if low <= 0.0:
            # Planes behind the sensor are near enough too: no bound.
            low, high = 1.0 / _EVERYTHING, _EVERYTHING
            box[3:6, j] = _EVERYTHING
        box[6, j], box[7, j] = low, high
        worth[j] = np.ceil(total * (1.0 + 10.0 * _SLACK))


@compiled
def bound_rays(theta, box, worth, first, last, rest):  # type: ignore[no-untyped-def]
    """rest[h] = sum of the worth of all runs that might gain on plane h, first <= h < last."""
    zero, one = np.int32(0), np.float32(1.0)
    for h in range(first, last):
        rest[h] = 0
    for start in range(0, worth.size, 16 * _BLOCK):
        stop = min(start + 16 * _BLOCK, worth.size)
        x, y, z = box[0, start:stop], box[1, start:stop], box[2, start:stop]
        u, v, w = box[3, start:stop], box[4, start:stop], box[5, start:stop]
        low, high, value = box[6, start:stop], box[7, start:stop], worth[start:stop]
        for h in range(first, last):
            t0, t1, t2 = theta[h, 0], theta[h, 1], theta[h, 2]
            s0, s1, s2 = abs(t0), abs(t1), abs(t2)
            part = zero
            for j in range(value.size):
                q = t0 * x[j] + t1 * y[j] + t2 * z[j]
                r = s0 * u[j] + s1 * v[j] + s2 * w[j]
                near = ((q - r) * low[j] < one) & ((q + r) * high[j] > one)
                part += value[j] if near else zero
            rest[h] += part


@compiled
def score_runs(theta, data, box, worth, chosen, best, first, last, rest, total):  # type: ignore[no-untyped-def]
    """Scores of the planes chosen[first:last], given up as soon as they must exceed `best`.

    total[h] goes from 0 to the score of plane h while rest[h], from `bound_rays`, goes to 0:
    total - rest bounds the score from below all the time. What is given up is left with a total
    above `best`.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    work = np.empty(_BLOCK, np.int32)
    for start in range(0, worth.size, _BLOCK):
        stop = min(start + _BLOCK, worth.size)
        x, y, z = box[0, start:stop], box[1, start:stop], box[2, start:stop]
        u, v, w = box[3, start:stop], box[4, start:stop], box[5, start:stop]
        low, high, value = box[6, start:stop], box[7, start:stop], worth[start:stop]
        near = work[: stop - start]
        for n in range(first, last):
            h = chosen[n]
            if total[h] - rest[h] > best:
                continue
            t0, t1, t2 = theta[h, 0], theta[h, 1], theta[h, 2]
            s0, s1, s2 = abs(t0), abs(t1), abs(t2)
            part = np.int32(0)
            for j in range(near.size):
                q = t0 * x[j] + t1 * y[j] + t2 * z[j]
                r = s0 * u[j] + s1 * v[j] + s2 * w[j]
                there = ((q - r) * low[j] < one) & ((q + r) * high[j] > one)
                near[j] = value[j] if there else np.int32(0)
                part += near[j]
            if part == 0:
                continue
            rest[h] -= part
            gain = np.float64(0.0)
            for j in range(near.size):
                if near[j] > 0:
                    d = data[start + j]
                    saved = zero
                    for i in range(RUN):
                        e = d[3, i] - one / (t0 * d[0, i] + t1 * d[1, i] + t2 * d[2, i])
                        g = e * e - d[4, i]
                        saved += g if g < zero else zero
                    gain += saved
            total[h] += gain
