"""Loop over pixels: which readings hardly any reading about them agrees with."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import in_order, inlined, internal

REACH = 2  # pixels about a reading that are looked at
AGREEING = 6.0  # one in so many of them, at least, agrees with a reading of a surface
_ENOUGH = 4.0  # that agree among the eight nearest: a sixth of all 24
_FEWEST = 6  # of which one is a sixth


@inlined
def _count_near(row, other, shift, low, share, near):  # type: ignore[no-untyped-def]
    """Count readings of another row, shifted by so many columns, that agree: adds to near (W,)."""
    first, last = max(0, -shift), row.size - max(0, shift)
    a, b, out = row[first:last], other[first + shift : last + shift], near[first:last]
    for j in range(out.size):
        z, far = np.float32(a[j]), np.float32(b[j])
        out[j] += np.float32(1.0) if (abs(z - far) <= share * z) & (far >= low) else np.float32(0.0)


@internal
def _stands_alone(z, i, j, low, high, share, widths, about):  # type: ignore[no-untyped-def]
    """Whether fewer readings about a pixel agree with its own than do on a surface."""
    value, size = np.float64(z[i, j]), 0
    for k in range(max(i - REACH, 0), min(i + REACH + 1, z.shape[0])):
        for n in range(max(j - REACH, 0), min(j + REACH + 1, z.shape[1])):
            other = np.float64(z[k, n])
            if low <= other <= high and (k != i or n != j):
                place = size
                while place > 0 and about[place - 1] > other:
                    about[place] = about[place - 1]
                    place -= 1
                about[place] = other
                size += 1
    if size < _FEWEST:
        return False
    half, width = size // 2, np.inf
    for k in range(size - half):
        width = min(width, about[k + half] - about[k])
    agreeing, within = 0, max(share * value, widths * width)
    for k in range(size):
        agreeing += abs(about[k] - value) <= within
    return AGREEING * agreeing < size


@in_order
def mark_wild(  # type: ignore[no-untyped-def]
    z, low, high, share, widths, stride, wild
):
    """Mark readings with which fewer than one in six about them agree.

    z (H, W): depth in any unit, of which low <= z <= high are readings. Another agrees if it
    is no farther off than this `share` of the reading, or than so many `widths` of the narrowest
    half of those about. Every so many rows are looked at. Writes wild (rows looked at, W), where it
    is True; returns how many readings were looked at, and how many of them are wild.
    """
    near, about = np.empty(z.shape[1], np.float32), np.empty((2 * REACH + 1) * (2 * REACH + 1))
    least, bound = np.float32(low), np.float32(share)
    seen = found = 0
    for i in range(0, z.shape[0], stride):
        row = z[i]
        near[:] = np.float32(-1.0)  # with itself each agrees
        for k in range(max(i - 1, 0), min(i + 2, z.shape[0])):
            for shift in (-1, 0, 1):
                _count_near(row, z[k], shift, least, bound, near)
        for j in range(row.size):
            if low <= row[j] <= high:
                seen += 1
                if near[j] < _ENOUGH and _stands_alone(z, i, j, low, high, share, widths, about):
                    wild[i // stride, j] = True
                    found += 1
    return seen, found


@in_order
def differences(z, low, high, level, apart, off):  # type: ignore[no-untyped-def]
    """By how much readings side by side differ, as a share, `apart` pixels from pair to pair.

    z, low, high: `mark_wild`. Writes off (n,), of those a `level` apart or more; returns how many.
    """
    found = 0
    for i in range(0, z.shape[0], apart):
        for j in range(0, z.shape[1] - 1, apart):
            a, b = np.float64(z[i, j]), np.float64(z[i, j + 1])
            off[found] = abs(a / b - 1.0)
            found += (low <= a <= high) & (low <= b <= high) & (abs(a - b) >= level)
    return found
