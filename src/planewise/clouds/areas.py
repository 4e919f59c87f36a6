"""How much of its plane a few points cover.

What they scatter over is more: a roof has gaps, and walls of two rooms may lie in one plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_HELD = 4.0  # points in a square that has any
_FOUND = 0.94  # of the area of random points: by chance some squares are empty
_FEWEST = 20  # points that can tell
_STEPS = 30


def covered_area(points: Array, normal: Array) -> float:
    """Area in square metres of the squares of a grid on a plane in which its points lie.

    Squares are as large as to hold four points each, so that few between points are empty. Those at
    the rim are covered by half.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        On the plane, in metres.
    normal : ndarray, shape (3,)
        Of length one.

    Returns
    -------
    float
        NaN for fewer points than can tell, and for points in a line.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> walls = [rng.uniform((x, 0, 0), (x + 1, 1, 0), (1000, 3)) for x in (0, 6)]
    >>> round(covered_area(np.vstack(walls), np.array([0.0, 0.0, 1.0])), 1)
    2.0
    """
    if len(points) < _FEWEST:
        return float("nan")
    centred = points - points.mean(axis=0)
    centred = centred - np.outer(centred @ normal, normal)
    _, lengths, axes = np.linalg.svd(centred, full_matrices=False)
    inside = centred @ axes[:2].T
    extent = np.ptp(inside, axis=0)
    if not lengths[1] > 1e-6 * lengths[0]:
        return float("nan")
    side = float(np.sqrt(_HELD * extent.prod() / len(points)))
    for _ in range(_STEPS):
        filled = _filled(inside, side)
        wanted = side * np.sqrt(_HELD * np.count_nonzero(filled) / len(points))
        if abs(wanted - side) < 0.01 * side:
            break
        side = float(np.sqrt(wanted * side))
    beside = filled[:-2, 1:-1] & filled[2:, 1:-1] & filled[1:-1, :-2] & filled[1:-1, 2:]
    rim = filled[1:-1, 1:-1] & ~beside
    return side**2 / _FOUND * float(np.count_nonzero(filled) - 0.5 * np.count_nonzero(rim))


def _filled(inside: Array, side: float) -> NDArray[np.bool_]:
    """Squares of a grid that hold points, with an empty rim about them."""
    places = np.floor((inside - inside.min(axis=0)) / side + 0.5).astype(np.intp) + 1
    out = np.zeros(places.max(axis=0) + 2, np.bool_)
    out[tuple(places.T)] = True
    return out
