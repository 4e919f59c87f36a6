"""Loops over lines of an image: whether it may have been enlarged, and what it was before.

What is 0 or not finite is no reading.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import compiled, in_order, inlined

_LEAST = 1e-6  # pivot of what the readings tell
_TINY = float(np.finfo(np.float64).tiny)


@inlined
def _is_reading(value):  # type: ignore[no-untyped-def]
    """Whether a pixel has a reading."""
    return value != 0 and np.isfinite(value)


@in_order
def lines_tell(pixels, first, count, size, apart, step):  # type: ignore[no-untyped-def]
    """Whether any of so many lines side by side is like the one before, and whether any is empty.

    pixels (H W,): of an image; `size` of a line, `step` apart, lines `apart`. Missing readings are
    alike as far as they are marked alike.
    """
    alike = empty = False
    for line in range(first, first + count):
        same, some, at = line > first, False, line * apart
        for _ in range(size):
            value = pixels[at]
            some |= _is_reading(value)
            if same:
                other = pixels[at - apart]
                same = value == other or (value != value and other != other)  # NaN, too
            elif some:
                break
            at += step
        alike |= same
        empty |= not some
    return alike, empty


@in_order
def bends_along(image, first, step, signals):  # type: ignore[no-untyped-def]
    """What second differences along columns of image (H, W) show, of every `step`-th column.

    Writes signals (2, H - 4): how alike those of every row and the one before are, -1 to 1; and
    what share of the energy of three rows is that of the middle one. Returns how many readings
    there are, and how many second differences.
    """
    height = image.shape[0]
    energy, product = np.empty(height), np.empty(height)
    for i in range(height):
        energy[i], product[i] = _TINY, 0.0
    readings = bends = 0
    for column in range(first, image.shape[1], step):
        above = slope = bend = np.nan
        for i in range(height):
            value = image[i, column]
            here = np.float64(value) if _is_reading(value) else np.nan
            last_slope, last_bend, slope = slope, bend, here - above
            bend, above = slope - last_slope, here
            readings += np.isfinite(here)
            if np.isfinite(bend):
                bends += 1
                energy[i] += bend * bend
                if np.isfinite(last_bend):
                    product[i] += bend * last_bend
    for k in range(signals.shape[1]):
        i = k + 3
        two = energy[i] + energy[i - 1]
        signals[0, k] = 2.0 * product[i] / two
        signals[1, k] = energy[i] / (two + energy[i + 1])
    return readings, bends


@compiled
def own_readings(lines, above, share, own):  # type: ignore[no-untyped-def]
    """Readings of which straight lines between neighbours come nearest to those of a line.

    lines (L, N): NaN where there is no reading. Reading i lies `share` of the way from own one
    above[i] to the next. Writes own (L, n), NaN where readings do not tell. The normal equations
    have three diagonals: they are eliminated downwards and solved upwards.
    """
    n = own.shape[1]
    square, product, right = np.empty(n), np.empty(n), np.empty(n)
    for line in range(lines.shape[0]):
        square[:], product[:], right[:] = 0.0, 0.0, 0.0
        for i in range(lines.shape[1]):
            x = lines[line, i]
            if not np.isnan(x):
                k, b = above[i], share[i]
                a = 1.0 - b
                square[k] += a * a
                square[k + 1] += b * b
                product[k] += a * b
                right[k] += a * x
                right[k + 1] += b * x
        for k in range(1, n):
            if square[k - 1] > _LEAST:
                factor = product[k - 1] / square[k - 1]
                square[k] -= factor * product[k - 1]
                right[k] -= factor * right[k - 1]
        behind = 0.0
        for k in range(n - 1, -1, -1):
            if square[k] > _LEAST:
                if product[k] > 0.0:  # NaN stays NaN, but where it has no part in this one
                    right[k] -= product[k] * behind
                behind = right[k] / square[k]
            else:
                behind = np.nan
            own[line, k] = behind
