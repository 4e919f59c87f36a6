"""Wild readings: single ones, or a few, that have nothing to do with the surface about them.

Speckle, multipath and mismatches of stereo put depths of any size among the others. A few in a
hundred are enough for no cell of 6 x 6 pixels to be without one, and of those each looks like an
edge. What tells them is that next to none of the 24 readings about one agrees with it, which those
of a surface do even where it is narrow, or has an edge or a corner. So they can be set aside before
anything is known of the noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise import threads

_MATERIAL = 1 / 200  # of the readings: edges of real frames have up to half of that
_STRIDE = 16  # rows of which one stands for all
_APART = 8  # pixels between pairs that stand for all
_PASSES = 4  # wild readings hide one another
_QUARTER = 6.0  # times the lower quartile of differences side by side: 2.7 standard deviations


def wild_readings(
    values: NDArray[Any], low: float, high: float
) -> NDArray[np.bool_] | None:
    """Which readings of a depth image are wild; ``None`` if so few that cells can do with them.

    Parameters
    ----------
    values : ndarray, shape (H, W)
        Depth in any unit.
    low, high : float
        Smallest and largest value that is a reading.

    Returns
    -------
    ndarray of bool, shape (H, W), or None
    """
    from planewise.kernels import wild as kernels  # loads Numba

    left, out = values, None
    for _ in range(_PASSES):
        floors = _floors(left, low, high)
        if floors is None:
            break
        found = np.zeros(values.shape, np.bool_)
        seen, few = kernels.mark_wild(left, low, high, *floors, 0, len(left), _STRIDE, found)
        if few <= _MATERIAL * seen:
            break

        def mark(first: int, last: int) -> None:
            kernels.mark_wild(left, low, high, *floors, first, last, 1, found)

        threads.halves(mark, len(left))
        left = np.where(found, values.dtype.type(0), left)
        out = found if out is None else out | found
    return out


def _floors(values: NDArray[Any], low: float, high: float) -> tuple[float, float] | None:
    """By how much depths side by side may differ anyhow: in depth, and in inverse depth.

    Noise of sensors grows with depth like something between a constant and the square. Equal
    readings do not count: steps of rounding are no less than the least that differ. ``None`` where
    all are equal.
    """
    a, b = (values[::_APART, k::_APART].astype(np.float64) for k in (0, 1))
    a = a[:, : b.shape[1]]
    there = (a >= low) & (a <= high) & (b >= low) & (b <= high) & (a != b)
    if not there.any():
        return None
    a, b = a[there], b[there]
    off = np.stack((np.abs(a - b), np.abs(1 / a - 1 / b)))
    quarter = off.shape[1] // 4
    in_depth, inverse = _QUARTER * np.partition(off, quarter, axis=1)[:, quarter]
    return float(in_depth), float(inverse)
