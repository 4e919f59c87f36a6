"""How much more points err than the quiet ones among them: models with different noise compare.

Where most cubes are rougher than the noise of the quiet ones, as near a scanner or along its lines,
that is not the noise of the rest.
"""

from __future__ import annotations

import math
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
    workers: int,
) -> float:
    """Power of two that noise is multiplied by for the lowest Phi.

    None where a good part of the points is on planes and errs by no more than that: Phi falls for
    larger noise, too, where layers of what fills space, such as crowns of trees, pay then.
    """
    best, lowest = 0, math.inf
    for power in range(_DOUBLED + 1):
        model = cloud_model(
            points, replace(sensor, noise=noise.scaled(2.0**power)), None, origin,
            instances=False, significance=0.0, max_planes=MAX_PLANES, settings={},
            workers=workers, rng=np.random.default_rng(0),
        )  # fmt: skip
        if not model.information < lowest:
            break
        if not power and origin is None and _confirms(model, noise.constant):
            break
        best, lowest = power, model.information
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
