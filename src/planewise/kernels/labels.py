"""Loops over pixels: labels near the borders of segments, and the lines where planes meet.

Planes are rows (t0, t1, t2) of inverse depth w = t0 + t1 x + t2 y; row 0 is no plane. w, p, x, y,
slow (H, W): inverse depth, its weight (0 without a reading), coordinates, and the variance that
readings share.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_FAST = {"reassoc", "contract", "arcp", "nsz"}
_compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)


@_compiled
def label_pixels(label, settled, side, w, p, x, y, slow, planes, lateral, null, differing, sweeps):  # type: ignore[no-untyped-def]
    """Sweeps of local moves over the pixels of cells that are not settled.

    A pixel takes the label, among those of its eight neighbours and none, of least

        (w - plane)^2 / (2 (1 / p + slow + lateral))  [null for none]
        + differing * (neighbours with another label, diagonal ones 0.7).

    label (H, W) int32 is changed in place; settled (rows, columns) per cell; lateral (planes,):
    variance of w by errors across the image. Returns the number of changes of the last sweep.
    After the first sweep only pixels beside a change can change.
    """
    height, width = label.shape
    stirred = np.ones((height, width), np.bool_)
    candidates = np.empty(10, np.int32)
    weight = np.empty(10)
    changed = 0
    for sweep in range(sweeps):
        changed = 0
        for step_i in range(height):
            i = step_i if sweep % 2 == 0 else height - 1 - step_i
            for step_j in range(width):
                j = step_j if sweep % 2 == 0 else width - 1 - step_j
                if not stirred[i, j]:
                    continue
                stirred[i, j] = False
                if p[i, j] <= 0.0 or settled[i // side, j // side]:
                    continue
                mine = label[i, j]
                # Distinct labels around, and how much each weighs there.
                candidates[0], weight[0] = mine, 0.0
                found, around = 1, 0.0
                for a in range(max(i - 1, 0), min(i + 2, height)):
                    for b in range(max(j - 1, 0), min(j + 2, width)):
                        if (a == i and b == j) or p[a, b] <= 0.0:
                            continue
                        share = 1.0 if a == i or b == j else 0.7
                        around += share
                        n = 0
                        while n < found and candidates[n] != label[a, b]:
                            n += 1
                        if n == found:
                            candidates[n], weight[n] = label[a, b], 0.0
                            found += 1
                        weight[n] += share
                if mine == 0 and found == 1:
                    continue
                n = 0
                while n < found and candidates[n] != 0:
                    n += 1
                if n == found:
                    candidates[n], weight[n] = 0, 0.0
                    found += 1
                best, lowest = mine, np.inf
                for n in range(found):
                    plane = candidates[n]
                    if plane == 0:
                        cost = null
                    else:
                        t = planes[plane]
                        e = w[i, j] - t[0] - t[1] * x[i, j] - t[2] * y[i, j]
                        cost = 0.5 * e * e / (1.0 / p[i, j] + slow[i, j] + lateral[plane])
                    cost += differing * (around - weight[n])
                    if cost < lowest - 1e-9:
                        best, lowest = plane, cost
                if best != mine:
                    label[i, j] = best
                    stirred[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2] = True
                    changed += 1
        if changed == 0:
            break
    return changed


@_compiled
def crease_kinds(label, planes, p, x, y, reach, kinds):  # type: ignore[no-untyped-def]
    """How two planes that touch in the image meet: 1 convex, -1 concave, 0 they do not.

    `reach` pixels on either side of their border, or less where there is no reading, on a convex
    edge each side's plane is the nearer of the two, on a concave one the farther; where one surface
    passes in front of the other, neither.
    Writes kinds (planes, planes) int8.
    """
    height, width = label.shape
    count = planes.shape[0]
    votes, touching = np.zeros((count, count)), np.zeros((count, count))
    for i in range(height):
        for j in range(width):
            here = label[i, j]
            for k in range(2):
                row, column = i + k, j + 1 - k
                if here == 0 or row >= height or column >= width:
                    continue
                there = label[row, column]
                if there == 0 or there == here:
                    continue
                # Differences of the two planes on this side and on the other.
                back = min(reach, i if k == 1 else j)
                while p[i - k * back, j - (1 - k) * back] <= 0.0:
                    back -= 1
                ia, ja = i - k * back, j - (1 - k) * back
                on = min(reach, height - 1 - row if k == 1 else width - 1 - column)
                while p[row + k * on, column + (1 - k) * on] <= 0.0:
                    on -= 1
                ib, jb = row + k * on, column + (1 - k) * on
                s, t = planes[here], planes[there]
                near = s[0] - t[0] + (s[1] - t[1]) * x[ia, ja] + (s[2] - t[2]) * y[ia, ja]
                far = t[0] - s[0] + (t[1] - s[1]) * x[ib, jb] + (t[2] - s[2]) * y[ib, jb]
                a, b = min(here, there), max(here, there)
                touching[a, b] += 1.0
                if near > 0.0 and far > 0.0:
                    votes[a, b] += 1.0
                elif near < 0.0 and far < 0.0:
                    votes[a, b] -= 1.0
    kinds[:] = 0
    for a in range(count):
        for b in range(a + 1, count):
            if touching[a, b] >= 8.0 and abs(votes[a, b]) > 0.6 * touching[a, b]:
                kinds[a, b] = kinds[b, a] = 1 if votes[a, b] > 0.0 else -1


@_compiled
def crease_band(label, kinds, radius, band):  # type: ignore[no-untyped-def]
    """band (H, W): pixels within `radius` of a border between two planes that meet."""
    height, width = label.shape
    band[:] = False
    for i in range(height):
        for j in range(width):
            here = label[i, j]
            for k in range(2):
                row, column = i + k, j + 1 - k
                if here == 0 or row >= height or column >= width:
                    continue
                there = label[row, column]
                if there > 0 and there != here and kinds[here, there] != 0:
                    top, left = max(0, i - radius), max(0, j - radius)
                    band[top : row + radius + 1, left : column + radius + 1] = True


@_compiled
def crease_offsets(label, planes, kinds, w, p, x, y, slow, lateral, unit, reach, sigma, offset):  # type: ignore[no-untyped-def]
    """Where along its normal the border between two planes that meet most likely lies, in pixels.

    offset = argmin over t of sum_{s > t} (cost_a - cost_b) + t^2 / (2 sigma^2), s the distance to
    the line of intersection, positive on a's side: slow errors of the planes move the line.
    unit: pixels per unit of x and y. Writes offset (planes, planes) for a < b.
    """
    height, width = label.shape
    count, bins = planes.shape[0], 10
    length = 2 * reach * bins + 1
    histogram = np.zeros((count, count, length))
    for i in range(height):
        for j in range(width):
            here = label[i, j]
            for k in range(2):
                row, column = i + k, j + 1 - k
                if here == 0 or row >= height or column >= width:
                    continue
                there = label[row, column]
                if there == 0 or there == here or kinds[here, there] == 0:
                    continue
                a, b = min(here, there), max(here, there)
                s, t = planes[a], planes[b]
                slope = np.sqrt((s[1] - t[1]) ** 2 + (s[2] - t[2]) ** 2) / unit
                for direction in range(2):
                    for n in range(reach + 2):
                        m = n + 1 if direction == 1 else -n
                        r, c = i + k * m, j + (1 - k) * m
                        if r < 0 or c < 0 or r >= height or c >= width:
                            break
                        if (label[r, c] != a and label[r, c] != b) or p[r, c] <= 0.0:
                            break
                        wa = s[0] + s[1] * x[r, c] + s[2] * y[r, c]
                        wb = t[0] + t[1] * x[r, c] + t[2] * y[r, c]
                        place = int(np.round((wa - wb) * kinds[a, b] / slope * bins)) + reach * bins
                        if 0 <= place < length:
                            v = 1.0 / p[r, c] + slow[r, c]
                            cost_a = min(0.5 * (w[r, c] - wa) ** 2 / (v + lateral[a]), 8.0)
                            cost_b = min(0.5 * (w[r, c] - wb) ** 2 / (v + lateral[b]), 8.0)
                            histogram[a, b, place] += cost_a - cost_b
    offset[:] = 0.0
    for a in range(count):
        for b in range(a + 1, count):
            if kinds[a, b] == 0:
                continue
            cost, lowest = 0.0, np.inf
            for place in range(length - 1, -1, -1):
                shift = (place + 0.5 - reach * bins) / bins
                total = cost + 0.5 * shift * shift / (sigma * sigma)
                if total < lowest:
                    lowest, offset[a, b] = total, shift
                cost += histogram[a, b, place]


@_compiled
def snap_creases(label, band, planes, kinds, offset, p, x, y, slow, unit, reach, far, sweeps):  # type: ignore[no-untyped-def]
    """Where two planes meet, make their line of intersection the border.

    A pixel beside the other label goes to the side on which it lies, as long as it is less than
    `far` pixels from the line, the two planes differ there by less than `reach` standard deviations
    of a reading, and the slow error moves the line by less than a pixel.
    """
    height, width = label.shape
    for sweep in range(sweeps):
        changed = 0
        for step_i in range(height):
            i = step_i if sweep % 2 == 0 else height - 1 - step_i
            for step_j in range(width):
                j = step_j if sweep % 2 == 0 else width - 1 - step_j
                here = label[i, j]
                if here == 0 or not band[i, j] or p[i, j] <= 0.0:
                    continue
                for k in range(4):
                    r, c = i + (k == 2) - (k == 3), j + (k == 0) - (k == 1)
                    if r < 0 or c < 0 or r >= height or c >= width:
                        continue
                    there = label[r, c]
                    if there == 0 or there == here or kinds[here, there] == 0:
                        continue
                    a, b = min(here, there), max(here, there)
                    s, t = planes[a], planes[b]
                    e = s[0] - t[0] + (s[1] - t[1]) * x[i, j] + (s[2] - t[2]) * y[i, j]
                    slope = np.sqrt((s[1] - t[1]) ** 2 + (s[2] - t[2]) ** 2) / unit
                    place = e * kinds[a, b] / slope - offset[a, b]
                    wanted = a if place > 0.0 else b
                    hidden = e * e < reach * reach * (1.0 / p[i, j] + slow[i, j])
                    if wanted != here and abs(place) < far and slow[i, j] < slope**2 and hidden:
                        label[i, j] = wanted
                        changed += 1
                        break
        if changed == 0:
            break


@_compiled
def units_inside(label, unit, side, columns, inside):  # type: ignore[no-untyped-def]
    """Label of every unit whose pixels all have it, 0 of the others; unit as in `kernels.cells`."""
    height, width = label.shape
    inside[:] = -1
    for i in range(height):
        for j in range(width):
            k = unit[(i // side) * columns + j // side]
            if k >= 0:
                if inside[k] < 0:
                    inside[k] = label[i, j]
                elif inside[k] != label[i, j]:
                    inside[k] = 0
    for k in range(inside.size):
        inside[k] = max(inside[k], 0)
