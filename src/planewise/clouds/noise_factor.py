"""How much more points err than the quiet ones among them: models with different noise compare.

Where many points lie in cubes that are rougher than the quiet ones, as near a scanner, along its
lines, or on a facade beside ground that it grazes, noise of these is not that of the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.model import cloud_model
from planewise.model import MAX_PLANES, PlaneModel
from planewise.noise import Polynomial
from planewise.sensor import Sensor

_DOUBLED = 4  # times at most
_CONFIRMED = 0.25, 1.5  # share of points on planes, and times its variance, that confirm noise


def noise_factor(
    points: NDArray[np.floating],
    sensor: Sensor,
    noise: Polynomial,
    origin: NDArray[np.float64] | None,
    noise_of: Callable[[NDArray[np.floating]], float],
    workers: int,
    least: float = 0.0,
) -> float:
    """Power of two that noise is multiplied by for the lowest Phi.

    None where a good part of the points is on planes and errs by no more than that: Phi falls for
    larger noise, too, where layers of what fills space, such as crowns of trees, pay then. But
    where what is on no plane is flat and errs twice as much, it has planes of its own, and Phi may
    rise before it falls by these.

    noise_of: returns the standard deviation of points if most lie on something flat, else 0; least:
    of noise that was assumed, which planes do not confirm, share of the points that these have to
    hold for it to be multiplied at all.
    """

    def lost(model: PlaneModel, sigma: float) -> bool:
        return origin is None and noise_of(points[model.labels == 0]) >= 2.0 * sigma

    best, lowest = 0, math.inf
    for power in range(_DOUBLED + 1):
        model = cloud_model(
            points, replace(sensor, noise=noise.scaled(2.0**power)), None, origin,
            instances=False, significance=0.0, max_planes=MAX_PLANES, settings={},
            workers=workers, rng=np.random.default_rng(0),
        )  # fmt: skip
        if not power and np.count_nonzero(model.labels) < least * model.readings:
            break
        sigma = 2.0**power * noise.constant
        enough = not model.information < lowest
        if not enough:
            best, lowest = power, model.information
            enough = not power and not least and origin is None and _confirms(model, sigma)
        if enough and not lost(model, sigma):
            break
    return 2.0**best


def _confirms(model: PlaneModel, sigma: float) -> bool:
    """Whether there are many on planes, and points err by sigma on that of the median one."""
    share, larger = _CONFIRMED
    planes = sorted(model.planes, key=lambda plane: plane.rms)
    places = np.cumsum([plane.count for plane in planes])
    if not planes or places[-1] < share * model.readings:
        return False
    usual = planes[int(np.searchsorted(places, 0.5 * places[-1]))].rms
    return usual**2 <= larger * sigma**2
