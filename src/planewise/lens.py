"""Radial-tangential distortion of a lens, and how it is undone.

Coefficients are (k1, k2, p1, p2[, k3]) as OpenCV and ROS ("plumb_bob") order them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Coefficients = tuple[float, ...]

_STEPS = 50
_SHARES = 100  # places on the way to the corner of an image
_TOLERANCE = 1e-9


def distort(distortion: Coefficients, u: Array, v: Array) -> tuple[Array, Array]:
    """Where the ray (u, v, 1) is seen by the lens, on the plane z = 1."""
    k1, k2, p1, p2, k3 = (*distortion, 0.0)[:5]
    r2 = u * u + v * v
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u),
        v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v,
    )


def _stretch(distortion: Coefficients, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Derivatives of `distort`: du'/du, dv'/dv, and du'/dv, which is dv'/du."""
    k1, k2, p1, p2, k3 = (*distortion, 0.0)[:5]
    r2 = u * u + v * v
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    steeper = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
    return (
        radial + u * u * steeper + 2 * p1 * v + 6 * p2 * u,
        radial + v * v * steeper + 6 * p1 * v + 2 * p2 * u,
        u * v * steeper + 2 * p1 * u + 2 * p2 * v,
    )


def _unfolded(distortion: Coefficients, u: Array, v: Array) -> bool:
    xx, yy, xy = _stretch(distortion, u, v)
    return bool(((xx > 0) & (xx * yy > xy * xy)).all())


def undistort(distortion: Coefficients, u: Array, v: Array) -> tuple[Array, Array]:
    """Invert the distortion by Newton's method, where it does not fold the image.

    Raises
    ------
    ValueError
        If it does.
    """
    x, y = u, v
    with np.errstate(all="ignore"):  # where there is no inverse, steps lead anywhere
        for _ in range(_STEPS):
            du, dv = distort(distortion, x, y)
            du, dv = u - du, v - dv
            if max(np.abs(du).max(), np.abs(dv).max()) < _TOLERANCE:
                break
            xx, yy, xy = _stretch(distortion, x, y)
            determinant = xx * yy - xy * xy
            x, y = x + (yy * du - xy * dv) / determinant, y + (xx * dv - xy * du) / determinant
        else:
            x = np.full_like(x, np.nan)
        # Nor is there a fold between the middle of the image and its farthest place.
        far = np.unravel_index(np.argmax(x * x + y * y), x.shape)
        shares = np.linspace(0.0, 1.0, _SHARES)
        if _unfolded(distortion, x, y) and _unfolded(distortion, shares * x[far], shares * y[far]):
            return x, y
    raise ValueError(
        f"camera: distortion {distortion} cannot be undone over the whole image; "
        "are the coefficients in the order k1, k2, p1, p2, k3?"
    )
