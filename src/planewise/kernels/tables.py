"""Tables by depth, as `spatial.frame.ErrorTable` has them."""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.jit import inlined


@inlined
def between(table, row, last):  # type: ignore[no-untyped-def]
    """Value of a table at a row, linear between rows; at `last`, the last but one, beyond it."""
    row = min(row, last)
    whole = int(row)
    below = np.uintp(whole)
    return table[below] + (row - whole) * (table[below + np.uintp(1)] - table[below])


@inlined
def squared_stretch(ranging, x, y):  # type: ignore[no-untyped-def]
    """(range / z)^2 in a direction, 1 where depth is z; ranging: of `spatial.frame.ErrorTable`.

    There a reading of inverse depth w has row ranging[0] / w times the root of it, and variances
    times it.
    """
    return 1.0 + ranging[1] * x * x + ranging[2] * y * y


@inlined
def row_and_stretch(ranging, w, x, y):  # type: ignore[no-untyped-def]
    """Row of a reading of inverse depth w at a place, and `squared_stretch` there."""
    row, stretch = ranging[0] / w, 1.0
    if ranging[1] + ranging[2] > 0.0:  # a root takes long
        stretch = squared_stretch(ranging, x, y)
        row *= math.sqrt(stretch)
    return row, stretch


@inlined
def reading_variance(variance, ranging, w, x, y):  # type: ignore[no-untyped-def]
    """Variance of a reading of inverse depth w at a place, from that by depth."""
    row, stretch = row_and_stretch(ranging, w, x, y)
    return stretch * variance[np.uintp(min(int(row + 0.5), variance.size - 1))]
