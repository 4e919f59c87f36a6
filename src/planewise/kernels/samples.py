"""Loop over random samples: the planes through three readings."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import in_order

_COLLINEAR = 1e-18  # squared sine of an angle that spans no plane
_THROUGH = 1e-24  # squared determinant of unit rays in a plane, as those of a row of pixels are


@in_order
def planes_through_rays(a, s, chosen, first, last, theta):  # type: ignore[no-untyped-def]
    """theta . p = 1 of the planes through three readings p = s a: samples first ... last - 1.

    theta is the sum of cross products over the determinant. a (3, k), s (k,), chosen (T, 3): which
    readings. Writes theta (T, 3), NaN where the three are in a line, or in a plane with the sensor.
    """
    for t in range(first, last):
        i, j, k = chosen[t, 0], chosen[t, 1], chosen[t, 2]
        x, y, z = a[0, i] * s[i], a[1, i] * s[i], a[2, i] * s[i]
        ux, uy, uz = a[0, j] * s[j] - x, a[1, j] * s[j] - y, a[2, j] * s[j] - z
        vx, vy, vz = a[0, k] * s[k] - x, a[1, k] * s[k] - y, a[2, k] * s[k] - z
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        # |normal| = |u| |v| sin of the angle between them.
        size = nx * nx + ny * ny + nz * nz
        apart = a[0, i] * (a[1, j] * a[2, k] - a[2, j] * a[1, k])
        apart += a[1, i] * (a[2, j] * a[0, k] - a[0, j] * a[2, k])
        apart += a[2, i] * (a[0, j] * a[1, k] - a[1, j] * a[0, k])
        long = a[0, i] * a[0, i] + a[1, i] * a[1, i] + a[2, i] * a[2, i]
        long *= a[0, j] * a[0, j] + a[1, j] * a[1, j] + a[2, j] * a[2, j]
        long *= a[0, k] * a[0, k] + a[1, k] * a[1, k] + a[2, k] * a[2, k]
        span = (ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz)
        determinant = nx * x + ny * y + nz * z
        p, q, r = nx / determinant, ny / determinant, nz / determinant
        in_plane = size <= _COLLINEAR * span or apart * apart <= _THROUGH * long
        if in_plane or not (np.isfinite(p + q) and np.isfinite(r)):
            p = q = r = np.nan
        theta[t, 0], theta[t, 1], theta[t, 2] = p, q, r
