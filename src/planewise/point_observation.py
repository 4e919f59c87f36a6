"""Free points in n dimensions as an observation, and checks of how they are given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import LEAST_LENGTH, MOST_LENGTH, checked_metres, checked_points
from planewise.noise import AUTO, is_constant
from planewise.observation import Array, Observation, read_only
from planewise.sensor import Sensor, checked_sensor
from planewise.wording import counted

if TYPE_CHECKING:
    from planewise.clouds.noise import CloudNoise

UNTOLD = 0.025
"""Variance of a slope, square radians, from which on points do not tell it.

Of n points that scatter alike in two directions, about a line, the principal axes say less in one
of exp(1 / (8 UNTOLD)) cases, 0.7 %, whatever n is.
"""

_FARTHEST = 1e150  # metres; squares of coordinates beyond are no numbers
_STRAY = 100.0  # times the range: a point that is so far off is none of the others'


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class PointObservation(Observation):
    """Free points in n dimensions.

    Attributes
    ----------
    points : ndarray, shape (n, k)
        Relative to `origin`, metres.
    origin : ndarray, shape (n,)
        Centre of the points; kept apart so that large coordinates lose no precision.
    errors : ndarray, shape (k,)
        Standard deviation of each point, normal to the plane, in metres.
    rows : ndarray of int, shape (k,)
        Where each point stood in the input.
    estimate : CloudNoise, optional
        Where `errors` come from, if they were estimated from these points.
    """

    points: Array
    origin: Array
    errors: Array
    rows: NDArray[np.int64]
    estimate: CloudNoise | None = None

    @property
    def sigma(self) -> Array:
        """Standard deviation of each point in metres, shape (k,); read-only."""
        return read_only(self.errors)

    @property
    def index(self) -> NDArray[np.int64]:
        """Row of the input that each point stood in, shape (k,)."""
        return self.rows

    @property
    def note(self) -> str:
        """Why there are too few points, where that is so; else empty."""
        if self.count >= self.dimension:
            return ""
        return f"{counted(self.count, 'finite point')}; {self.dimension} are needed for a plane"

    @property
    def dimension(self) -> int:
        """Dimension n of the space."""
        return int(self.points.shape[0])

    @property
    def freedom(self) -> int:
        """Return n: a free point has all its coordinates to itself."""
        return int(self.points.shape[0])

    def residuals(self, plane: ArrayLike) -> Array:
        """delta = n . x + d: orthogonal distance (paper, eq. 2)."""
        plane = np.asarray(plane, dtype=np.float64)
        normal, distance = plane[:-1], plane[-1]
        return np.asarray(normal @ self.points + (distance + normal @ self.origin))

    def positions(self) -> Array:
        """Return the points, shape (k, n), metres."""
        return self.points.T + self.origin


def observe_points(points: ArrayLike, sensor: Sensor) -> PointObservation:
    """Turn free points into an observation.

    Parameters
    ----------
    points : array_like, shape (k, n)
        Metres, n >= 2; rows that are not finite are no reading. Any origin.
    sensor : Sensor
        Its range is R, the extent a coordinate may take; its noise is evaluated at the distance of
        each point from the origin of the coordinates; "auto" is estimated from the points, in
        space (`planewise.estimate_cloud_noise`). Unless it is a constant, points at the origin are
        no reading, either. Its depth limits do not apply.

    Returns
    -------
    PointObservation
        The valid points.

    Raises
    ------
    ValueError
        If `points` is not a 2-D array of numbers with two or more columns, or the noise is "auto"
        and they have not three.
    """
    array, estimate = checked_points(points), None
    asked = checked_sensor(sensor).noise
    if asked == AUTO:
        from planewise.clouds.noise import estimate_cloud_noise

        if array.shape[1] != 3:
            raise ValueError(
                "noise='auto' needs a depth image or points of shape (k, 3), "
                f"got {array.shape}; give it as metres, such as noise=0.005"
            )
        estimate = estimate_cloud_noise(array, sensor)
        sensor = estimate.sensor(sensor)
    array = array.astype(np.float64)
    there = (np.abs(array) <= _FARTHEST).all(axis=1)  # as NaN is not
    if not is_constant(asked):
        there &= array.any(axis=1)  # a missing return, as in `clouds.missing`
    index = np.flatnonzero(there)
    valid = array[index]
    origin = valid.mean(axis=0) if index.size else np.zeros(array.shape[1])
    if np.abs(valid - origin).max(initial=0.0) > _STRAY * sensor.range:
        origin = np.median(valid, axis=0)  # which strays do not move
    return PointObservation(
        errors=sensor.sigma(np.linalg.norm(valid, axis=1)),
        rows=index,
        shape=(array.shape[0],),
        range=sensor.range,
        resolution=sensor.resolution,
        points=np.ascontiguousarray((valid - origin).T),
        origin=origin,
        estimate=estimate,
    )


def checked_sigma(sigma: ArrayLike | None, count: int) -> Array | None:
    """Standard deviations of so many points as an array."""
    if sigma is None:
        return None
    errors = checked_metres("sigma", sigma)
    if errors.shape != (count,):
        raise ValueError(
            f"sigma must hold one number a point: expected shape {(count,)}, got {errors.shape}"
        )
    if count and not (errors.min() >= LEAST_LENGTH and errors.max() <= MOST_LENGTH):  # nor is NaN
        raise ValueError(
            f"sigma must be positive and finite (metres, {LEAST_LENGTH:g} to {MOST_LENGTH:g}), got "
            f"{errors.min()} to {errors.max()}"
        )
    return errors


def checked_origin(origin: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.float64] | None:
    """Where the scanner stood as an array, for points of a shape."""
    if origin is None:
        return None
    place = checked_metres("origin", origin)
    if place.shape not in ((3,), shape):
        raise ValueError(
            f"origin must be one place or one a point: expected shape (3,) or {shape}, "
            f"got {place.shape}"
        )
    if place.size and not np.abs(place).max() <= MOST_LENGTH:  # as that of NaN is not
        raise ValueError(
            f"origin must be finite (metres, at most {MOST_LENGTH:g}), got {place.min()} to "
            f"{place.max()}"
        )
    return place
