"""Distortion of a lens, radial and tangential, and how it is undone.

Coefficients are (k1, k2, p1, p2[, k3[, k4, k5, k6]]) as OpenCV and ROS order them ("plumb_bob", and
with all eight "rational_polynomial").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Coefficients = tuple[float, ...]

COUNTS = 0, 4, 5, 8
"""How many coefficients there may be."""

ORDER = "k1, k2, p1, p2[, k3[, k4, k5, k6]]"

_STEPS = 50
_TOLERANCE = 1e-9
_RADII = np.tan(np.linspace(0.0, 1.55, 2000))  # of rays up to 89 degrees off the axis
_SHIFT = 1.1  # a tangential part moves the fold of the radial one by less


def distort(distortion: Coefficients, u: Array, v: Array) -> tuple[Array, Array]:
    """Where the ray (u, v, 1) is seen by the lens, on the plane z = 1."""
    _, _, p1, p2 = distortion[:4]
    r2 = u * u + v * v
    radial, _ = _radial(distortion, r2)
    return (
        u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u),
        v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v,
    )


def undistort(distortion: Coefficients, u: Array, v: Array) -> tuple[Array, Array]:
    """Invert the distortion by Newton's method.

    A lens may fold: what it sees moves outwards with the ray up to some angle, and back beyond. The
    inverse is the ray on this side of the fold, NaN where there is none.

    Parameters
    ----------
    distortion : tuple of float
    u, v : ndarray
        Of one shape.

    Returns
    -------
    x, y : ndarray
        Of the same shape.
    """
    with np.errstate(all="ignore"):  # where there is no inverse, steps lead anywhere
        seen = _RADII * _radial(distortion, _RADII * _RADII)[0]
        rises = np.diff(seen) > 0  # not beyond a fold or a pole
        count = seen.size if rises.all() else int(rises.argmin()) + 1
        distance = np.hypot(u, v)
        start = np.interp(distance, seen[:count], _RADII[:count])
        share = np.divide(start, distance, out=np.ones_like(distance), where=distance > 0)
        x, y = (np.ravel(each * share) for each in (u, v))
        u, v, left = np.ravel(u), np.ravel(v), np.arange(x.size)
        for _ in range(_STEPS):
            du, dv = distort(distortion, x[left], y[left])
            du, dv = u[left] - du, v[left] - dv
            far = ~(np.maximum(np.abs(du), np.abs(dv)) < _TOLERANCE)
            left, du, dv = left[far], du[far], dv[far]
            if not left.size:
                break
            xx, yy, xy = _stretch(distortion, x[left], y[left])
            determinant = xx * yy - xy * xy
            x[left] += (yy * du - xy * dv) / determinant
            y[left] += (xx * dv - xy * du) / determinant
        xx, yy, xy = _stretch(distortion, x, y)
        good = (xx > 0) & (xx * yy > xy * xy)
        if count < seen.size:
            good &= np.hypot(x, y) < _SHIFT * _RADII[count - 1]
        good[left] = False
    x[~good] = y[~good] = np.nan
    return x.reshape(distance.shape), y.reshape(distance.shape)


def _radial(distortion: Coefficients, r2: Array) -> tuple[Array, Array]:
    """Factor of the radial part, and its derivative by r^2."""
    k1, k2, _, _, k3, k4, k5, k6 = (*distortion, *(0.0,) * 4)[:8]
    above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    steeper = k1 + r2 * (2 * k2 + 3 * r2 * k3)
    if not any((k4, k5, k6)):
        return above, steeper
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    factor = above / below
    return factor, (steeper - factor * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / below


def _stretch(distortion: Coefficients, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Derivatives of `distort`: du'/du, dv'/dv, and du'/dv, which is dv'/du."""
    _, _, p1, p2 = distortion[:4]
    radial, steeper = _radial(distortion, u * u + v * v)
    steeper = 2 * steeper
    return (
        radial + u * u * steeper + 2 * p1 * v + 6 * p2 * u,
        radial + v * v * steeper + 6 * p1 * v + 2 * p2 * u,
        u * v * steeper + 2 * p1 * u + 2 * p2 * v,
    )
