"""What was measured: readings on known rays (depth images), or free points in n dimensions.

An observation holds only valid readings, in raster order, with the sigma of each. Everything the
objective needs of the geometry is two functions of it: the residual of every reading to a plane,
and the number of coordinates a reading leaves free (one on a ray, n in space).

Hyperplanes are rows (normal, distance) with normal . x + distance = 0 and |normal| = 1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.camera import PinholeCamera
from planewise.noise import AUTO, ErrorParts
from planewise.sensor import Sensor

if TYPE_CHECKING:
    from planewise.noise_estimate import NoiseEstimate

Array = NDArray[np.float64]

_TABLE_ROWS = 65_536  # raw depths up to 16 bit are looked up, not computed


@dataclass(frozen=True, kw_only=True)
class Observation(ABC):
    """Readings of a sensor, ready for the objective.

    Attributes
    ----------
    sigma : ndarray, shape (k,)
        Standard deviation of each reading in metres.
    index : ndarray of int, shape (k,)
        Where each reading stood in the flattened input.
    shape : tuple of int
        Shape of the input, and of its label image.
    range, resolution : float
        R and eps of the paper in metres.
    note : str
        Why there are few readings or none, where that is so.
    """

    sigma: Array
    index: NDArray[np.int64]
    shape: tuple[int, ...]
    range: float
    resolution: float
    note: str = ""

    @property
    def count(self) -> int:
        """Number of readings, k of the paper."""
        return self.sigma.size

    @property
    @abstractmethod
    def dimension(self) -> int:
        """Dimension n of the space; a hyperplane has n free parameters."""

    @property
    @abstractmethod
    def freedom(self) -> int:
        """Coordinates a reading leaves free: n in space, one on a known ray."""

    @abstractmethod
    def residuals(self, plane: ArrayLike) -> Array:
        """Signed residual delta of every reading to one plane.

        Parameters
        ----------
        plane : array_like, shape (n + 1,)
            Unit normal and distance.

        Returns
        -------
        ndarray, shape (k,)
            Metres.
        """

    @abstractmethod
    def positions(self) -> Array:
        """Return the readings as points in space, shape (k, n), metres."""

    def unflatten(self, labels: NDArray[np.integer]) -> NDArray[np.uint16]:
        """Spread one label per reading over the shape of the input, 0 where there is none."""
        out = np.zeros(self.shape, np.uint16)
        out.reshape(-1)[self.index] = labels
        return out


@dataclass(frozen=True, kw_only=True)
class RayObservation(Observation):
    """Readings along known rays from one centre.

    Attributes
    ----------
    rays : ndarray, shape (3, k)
        Direction of each reading in the sensor frame, scaled so that the point is depth * ray.
    depth : ndarray, shape (k,)
        Readings in metres.
    solid : ndarray, shape (k,)
        Area that each pixel covers on the plane z = 1, in square metres.
    pixel_size : (float, float)
        Width and height of a pixel on the plane z = 1, in metres: 1 / fx, 1 / fy.
    parts : ErrorParts, optional
        How much of the error neighbouring readings share.
    estimate : NoiseEstimate, optional
        Where `sigma` and `parts` come from, if they were estimated from these readings.
    """

    rays: Array
    depth: Array
    solid: Array
    pixel_size: tuple[float, float]
    parts: ErrorParts | None = None
    estimate: NoiseEstimate | None = None

    @property
    def dimension(self) -> int:
        """Dimension of space, 3."""
        return 3

    @property
    def freedom(self) -> int:
        """Return 1: a reading can only move along its ray."""
        return 1

    def residuals(self, plane: ArrayLike) -> Array:
        """delta = z + d / (n . r): distance along the ray, measured in depth (paper, eq. 9)."""
        plane = np.asarray(plane, dtype=np.float64)
        return np.asarray(self.depth + plane[3] / (plane[:3] @ self.rays))

    def positions(self) -> Array:
        """Return the readings as points in space, shape (k, 3), metres."""
        return (self.rays * self.depth).T


@dataclass(frozen=True, kw_only=True)
class PointObservation(Observation):
    """Free points in n dimensions.

    Attributes
    ----------
    points : ndarray, shape (n, k)
        Relative to `origin`, metres.
    origin : ndarray, shape (n,)
        Centre of the points; kept apart so that large coordinates lose no precision.
    """

    points: Array
    origin: Array

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


def observe(
    depth: ArrayLike,
    camera: PinholeCamera,
    sensor: Sensor,
    *,
    depth_scale: float | None = None,
) -> RayObservation:
    """Turn a depth image into readings on rays.

    Parameters
    ----------
    depth : array_like, shape (H, W)
        Floating point: metres. Integer: units of `depth_scale`. 0, NaN, infinity and readings
        outside the sensor's range are "no reading".
    camera : PinholeCamera
        Its intrinsics.
    sensor : Sensor
        Its range, resolution and noise. The noise of integer depth is evaluated once per value;
        noise "auto" is estimated from the image (`planewise.estimate_noise`).
    depth_scale : float, optional
        Metres per unit of integer depth; ``None`` means the sensor's resolution.

    Returns
    -------
    RayObservation
        The valid readings.

    Raises
    ------
    ValueError
        If the image is not a 2-D array of numbers with at least two rows and columns, holds
        negative depths, or cannot belong to the camera.
    """
    if sensor.noise == AUTO:
        from planewise.noise_estimate import resolved

        plain = observe(depth, camera, replace(sensor, noise=1.0), depth_scale=depth_scale)
        estimate, sensor = resolved(plain, sensor)
        sigma = sensor.sigma(plain.depth)
        return replace(plain, sigma=sigma, parts=sensor.parts, estimate=estimate)
    image = _depth_image(depth)
    shape: tuple[int, int] = (image.shape[0], image.shape[1])
    camera.check(shape)
    raw = image.reshape(-1)
    if raw.dtype.kind == "f":
        if depth_scale is not None:
            raise ValueError("depth_scale is for integer depth; floating-point depth is in metres")
        z_all = raw.astype(np.float64)
        there = np.isfinite(z_all) & (z_all > 0)
        index = np.flatnonzero(there & (z_all >= sensor.min_depth) & (z_all <= sensor.max_depth))
        z = z_all[index]
        sigma = sensor.sigma(z)
        present = int(np.count_nonzero(there))
    else:
        scale = sensor.resolution if depth_scale is None else float(depth_scale)
        if not (np.isfinite(scale) and scale > 0):
            raise ValueError(f"depth_scale must be a positive number of metres, got {depth_scale}")
        index, z, sigma = _look_up(raw, scale, sensor)
        present = int(np.count_nonzero(raw))
    return RayObservation(
        sigma=sigma,
        index=index,
        shape=shape,
        range=sensor.range,
        resolution=sensor.resolution,
        note=_note(index.size, present, sensor),
        rays=camera.ray_rows(shape).take(index, axis=1),
        depth=z,
        solid=camera.pixel_area(shape).take(index),
        pixel_size=(1.0 / camera.fx, 1.0 / camera.fy),
        parts=sensor.parts,
    )


def observe_points(points: ArrayLike, sensor: Sensor) -> PointObservation:
    """Turn free points into an observation.

    Parameters
    ----------
    points : array_like, shape (k, n)
        Metres, n >= 2; rows that are not finite are no reading. Any origin.
    sensor : Sensor
        Its range is R, the extent a coordinate may take; its noise is evaluated at the distance of
        each point from the origin of the coordinates. Its depth limits do not apply.

    Returns
    -------
    PointObservation
        The valid points.

    Raises
    ------
    ValueError
        If `points` is not a 2-D array of numbers with two or more columns, or the noise is "auto",
        which needs a depth image.
    """
    if sensor.noise == AUTO:
        raise ValueError(
            "noise='auto' needs a depth image, whose cells show the noise; for points give it as "
            "metres, such as noise=0.005, or as a function of the distance"
        )
    array = np.asarray(points)
    if array.ndim != 2 or array.shape[1] < 2 or array.dtype.kind not in "fiu":
        raise ValueError(
            "points must be real numbers of shape (k, n) with n >= 2, one point a row, "
            f"got shape {array.shape} of {array.dtype}"
        )
    array = array.astype(np.float64)
    index = np.flatnonzero(np.isfinite(array).all(axis=1))
    valid = array[index]
    origin = valid.mean(axis=0) if index.size else np.zeros(array.shape[1])
    note = ""
    if index.size < array.shape[1]:
        note = f"{index.size} finite points; {array.shape[1]} are needed for a plane"
    return PointObservation(
        sigma=sensor.sigma(np.linalg.norm(valid, axis=1)),
        index=index,
        shape=(array.shape[0],),
        range=sensor.range,
        resolution=sensor.resolution,
        note=note,
        points=np.ascontiguousarray((valid - origin).T),
        origin=origin,
    )


def _depth_image(depth: ArrayLike) -> NDArray[Any]:
    image = np.asarray(depth)
    if image.ndim != 2 or min(image.shape) < 2:
        raise ValueError(
            f"depth must be a 2-D image with at least 2 rows and 2 columns, got shape {image.shape}"
        )
    if image.dtype.kind not in "fiu":
        raise ValueError(f"depth must be metres (float) or integer units, got dtype {image.dtype}")
    if image.dtype.kind != "u" and (image < 0).any():
        raise ValueError(
            f"depth must not be negative, got {image[image < 0].flat[0]}; mark missing readings 0"
        )
    return image


def _look_up(
    raw: NDArray[Any], scale: float, sensor: Sensor
) -> tuple[NDArray[np.int64], Array, Array]:
    """Depth and sigma of integer readings, each evaluated once per distinct value."""
    low = max(1, int(np.ceil(sensor.min_depth / scale - 1e-9)))
    high = int(min(np.floor(sensor.max_depth / scale + 1e-9), np.iinfo(raw.dtype).max))
    if high < low:
        return np.empty(0, np.int64), np.empty(0), np.empty(0)
    index = np.flatnonzero((raw >= low) & (raw <= high))
    values = raw[index].astype(np.int64)
    if high < _TABLE_ROWS:
        z_table = np.arange(high + 1, dtype=np.float64) * scale
        # Only values that occur are evaluated: a model need not be defined elsewhere.
        seen = np.bincount(values, minlength=high + 1) > 0
        sigma_table = np.zeros(high + 1)
        sigma_table[seen] = sensor.sigma(z_table[seen])
        return index, z_table[values], sigma_table[values]
    distinct, row = np.unique(values, return_inverse=True)
    z = distinct.astype(np.float64) * scale
    return index, z[row], sensor.sigma(z)[row]


def _note(valid: int, present: int, sensor: Sensor) -> str:
    if valid >= 3:
        return ""
    if present > valid:
        return (
            f"{valid} valid readings: {present - valid} lie outside the sensor's range of "
            f"{sensor.min_depth:g} to {sensor.max_depth:g} m; is the depth in metres?"
        )
    return f"{valid} valid readings; 3 are needed for a plane"
