"""Wild readings: single ones, or a few, that have nothing to do with the surface about them.

Speckle, multipath and mismatches of stereo put depths of any size among the others. A few in a
hundred are enough for no cell of 6 x 6 pixels to be without one, and of those each looks like an
edge. What tells them is that next to none of the 24 readings about one agrees with it, which those
of a surface do even where it is narrow, or has an edge or a corner. So they can be set aside before
anything is known of the noise.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MATERIAL = 1 / 200  # of the readings: edges of real frames have up to half of that
_STRIDE = 16  # rows of which one stands for all
_APART = 8  # pixels between pairs that stand for all
_PASSES = 4  # wild readings hide one another
_WIDTHS = 5.0  # of the narrowest half of readings, 1.35 standard deviations where they are normal
_LEAST = 0.01  # of its depth is a wild reading off, as is a Kinect's step 4 m away
_SIDE = 6.0, 0.4  # times this quantile of differences side by side: 4.4 standard deviations
_FAR = 3.0  # times that: noise that differs from place to place ends before


def wild_readings(
    values: NDArray[Any], low: float, high: float, level: float
) -> NDArray[np.bool_] | None:
    """Which readings of a depth image are wild; ``None`` if so few that cells can do with them.

    Parameters
    ----------
    values : ndarray, shape (H, W)
        Depth in any unit.
    low, high : float
        Smallest and largest value that is a reading.
    level : float
        Readings closer than that are equal.

    Returns
    -------
    ndarray of bool, shape (H, W), or None
    """
    from planewise.kernels import wild as kernels  # loads Numba

    left, out = values, None
    for _ in range(_PASSES):
        within = _within(left, low, high, level)
        some = np.zeros((-(-values.shape[0] // _STRIDE), values.shape[1]), np.bool_)
        wider = within if out is not None else tuple(_FAR * each for each in within)
        seen, few = kernels.mark_wild(left, low, high, *wider, _STRIDE, some)
        if few <= _MATERIAL * seen:
            break
        found = np.zeros(values.shape, np.bool_)
        kernels.mark_wild(left, low, high, *within, 1, found)
        left = np.where(found, values.dtype.type(0), left)
        out = found if out is None else out | found
    return out


def _within(values: NDArray[Any], low: float, high: float, level: float) -> tuple[float, float]:
    """By how much readings that agree may differ, as `kernels.wild` takes it.

    Equal ones side by side do not count: what differs does so by a step or more.
    """
    from planewise.kernels import medians
    from planewise.kernels import wild as kernels

    off = np.empty(-(-values.shape[0] // _APART) * -(-values.shape[1] // _APART) + 1)
    found = kernels.differences(values, low, high, level, _APART, off)
    if not found:
        return math.inf, _WIDTHS
    times, quantile = _SIDE
    side = medians.smallest(off[:found], int(quantile * found), np.empty(found))
    return max(times * float(side), _LEAST), _WIDTHS
