"""Loop over lines of an image that was interpolated: what they were before, by least squares."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import compiled

_LEAST = 1e-6  # pivot of what the readings tell


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
