"""What was measured: any observation, and readings on known rays (depth images).

An observation holds only valid readings, in raster order, with the sigma of each. Everything the
objective needs of the geometry is two functions of it: the residual of every reading to a plane,
and the number of coordinates a reading leaves free (one on a ray, n in space).

Hyperplanes are rows (normal, distance) with normal . x + distance = 0 and |normal| = 1. Free points
are in `point_observation`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import unmasked
from planewise.camera import RIG, Camera
from planewise.depth_image import DepthImage
from planewise.noise import AUTO
from planewise.own_camera import check_own, checked_camera
from planewise.runtime.threads import halves
from planewise.runtime.workspace import Workspace
from planewise.sensor import Sensor, checked_sensor
from planewise.wording import counted

if TYPE_CHECKING:
    from planewise.calibration.estimate import NoiseEstimate

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation(ABC):
    """Readings of a sensor, ready for the objective.

    Attributes
    ----------
    shape : tuple of int
        Shape of the input, and of its label image.
    range, resolution : float
        R and eps of the paper in metres.
    """

    shape: tuple[int, ...]
    range: float
    resolution: float

    @property
    @abstractmethod
    def sigma(self) -> Array:
        """Standard deviation of each reading in metres, shape (k,)."""

    def of_sigma(self, function: Callable[[Array], Array]) -> Array:
        """`function` of every reading's sigma, shape (k,), which may not depend on the others."""
        return function(self.sigma)

    @property
    @abstractmethod
    def index(self) -> NDArray[np.int64]:
        """Where each reading stood in the flattened input, shape (k,)."""

    @property
    @abstractmethod
    def note(self) -> str:
        """Why there are few readings or none, where that is so; else empty."""

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


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class RayObservation(Observation):
    """Readings along known rays from one centre; arrays by reading are made when asked for.

    Attributes
    ----------
    image : DepthImage
        What the readings are of.
    camera, sensor
        What took it; the noise of the sensor is known.
    estimate : NoiseEstimate, optional
        Where that noise comes from, if it was estimated from these readings.
    """

    shape: tuple[int, int]
    image: DepthImage
    camera: Camera
    sensor: Sensor
    estimate: NoiseEstimate | None = None

    @property
    def count(self) -> int:
        """Number of readings, k of the paper."""
        return self.image.count

    @cached_property
    def tame(self) -> RayObservation:
        """The same without wild readings (`planewise.wild`), itself where these are few."""
        image = self.image.tame
        return self if image is self.image else replace(self, image=image)

    @cached_property
    def _readings(self) -> tuple[NDArray[np.int64], Array]:
        return self.image.readings()

    @property
    def index(self) -> NDArray[np.int64]:
        """Where each reading stood in the flattened image, shape (k,)."""
        return self._readings[0]

    @property
    def depth(self) -> Array:
        """Readings in metres, shape (k,)."""
        return self._readings[1]

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of each reading in metres, shape (k,); read-only."""
        if self.image.values.dtype.kind == "f":
            return read_only(self.sensor.sigma(self.depth))
        return read_only(self.of_sigma(lambda sigma: sigma))

    def of_sigma(self, function: Callable[[Array], Array]) -> Array:
        """`function` of every reading's sigma, shape (k,): of integers once per level."""
        if self.image.values.dtype.kind == "f":
            return function(self.sigma)
        by_level: Array = np.zeros(self.image.levels[-1] + 1 if self.count else 0)
        by_level[self.image.levels] = function(self.level_sigma)
        return _gathered(by_level, self._levels)

    @cached_property
    def _levels(self) -> NDArray[np.intp]:
        return _gathered(self.image.values.reshape(-1), self.index).astype(np.intp)

    @cached_property
    def level_sigma(self) -> Array:
        """Standard deviation in metres at every level of the image."""
        return self.sensor.sigma(self.image.depth)

    @cached_property
    def rays(self) -> Array:
        """Direction of each reading, shape (3, k): the point is depth * ray."""
        return _gathered(self.camera.ray_rows(self.shape), self.index)

    @property
    def ranges(self) -> bool:
        """Whether depth is the range of a LiDAR."""
        return self.camera.sectors(self.shape).column is not None

    def in_sectors(self) -> tuple[Array, Array]:
        """Rays as (u, v, 1) in the sector of each, shape (3, k), and depth along its axis, (k,)."""
        sectors = self.camera.sectors(self.shape)
        if sectors.ratio is None:
            axes = sectors.axes[0]
            turned = not np.array_equal(axes, np.eye(3))  # as those of no pinhole camera are
            return axes.T @ self.rays if turned else self.rays, self.depth
        x, y, ratio = (
            _gathered(sectors.image(image).reshape(-1), self.index).astype(np.float64)
            for image in (sectors.x, sectors.y, sectors.ratio)
        )
        u, v = sectors.metres(x, y)
        return np.stack((u, v, np.ones(self.count))), self.depth * ratio

    @cached_property
    def solid(self) -> Array:
        """Area that each pixel covers where readings are 1, in square metres, shape (k,)."""
        return _gathered(self.camera.pixel_area(self.shape).reshape(-1), self.index)

    @property
    def pixel_size(self) -> tuple[float, float]:
        """Width and height of a pixel at one metre, in metres."""
        return self.camera.pixel_size

    @property
    def note(self) -> str:
        """Why there are fewer than three readings, where that is so; else empty."""
        if self.count >= self.dimension:
            return ""
        if self.image.present > self.count:
            return f"{counted(self.count, 'valid reading')}: {self.out_of_range}"
        return f"{counted(self.count, 'valid reading')}; 3 are needed for a plane"

    @property
    def out_of_range(self) -> str:
        """How many readings the sensor cannot have taken, and what may be the reason."""
        scale, beyond = self.image.unit, self.image.present - self.count
        if scale is None:
            unit = "is the depth in metres?"
        elif scale > 1:
            unit = f"depth_scale is metres per unit: {1 / scale:g} rather than {scale:g}?"
        else:
            unit = f"units were taken for {1000 * scale:g} mm (depth_scale = {scale:g})"
            unit += "; are they 1/5000 m (depth_scale = 0.0002)?" if scale == 0.001 else ""
        return (
            f"{beyond} of {self.image.present} lie outside the sensor's range of "
            f"{self.sensor.min_depth:g} to {self.sensor.max_depth:g} m; {unit}"
        )

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
        # Infinite where the ray does not meet the plane, NaN where it lies in it.
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.depth + plane[3] / (plane[:3] @ self.rays))

    def positions(self) -> Array:
        """Return the readings as points in space, shape (k, 3), metres."""
        return (self.rays * self.depth).T


def read_only(array: Array) -> Array:
    """View of an array, which may be somebody else's, that nobody can write through."""
    view = array.view()
    view.flags.writeable = False
    return view


def _gathered(rows: NDArray[Any], index: NDArray[np.integer]) -> NDArray[Any]:
    """Take rows[..., index], each half on a thread of its own where two are allowed."""
    out = np.empty((*rows.shape[:-1], index.size), rows.dtype)

    def gather(first: int, last: int) -> None:
        for row, part in zip(np.atleast_2d(rows), np.atleast_2d(out), strict=True):
            # Any other mode would write to a copy first; all places are in the image.
            row.take(index[first:last], out=part[first:last], mode="clip")

    halves(gather, index.size)
    return out


@lru_cache(maxsize=RIG)
def _without_rays(camera: Camera, shape: tuple[int, int]) -> NDArray[np.bool_] | None:
    """Pixels that the lens of a camera cannot have seen, (H, W); ``None`` where there are none."""
    blind = np.isnan(camera.ray_rows(shape)).any(axis=0)
    return blind.reshape(shape) if blind.any() else None


def checked_observation(observation: object) -> None:
    """Refuse what is no observation, such as the depth image itself.

    Raises
    ------
    ValueError
        If it is not an `Observation`.
    """
    if not isinstance(observation, Observation):
        raise ValueError(
            "observation must be what planewise.observe or observe_points returned, "
            f"got a {type(observation).__name__}"
        )


def observe(
    depth: ArrayLike,
    camera: Camera,
    sensor: Sensor,
    *,
    depth_scale: float | None = None,
    workspace: Workspace | None = None,
) -> RayObservation:
    """Turn a depth image into readings on rays.

    Parameters
    ----------
    depth : array_like, shape (H, W)
        Floating point: metres. Integer: units of `depth_scale`. 0, NaN, infinity and readings
        outside the sensor's range are "no reading".
    camera : Camera
        Its rays. Where it has none, as where a lens folds the image, is "no reading", too.
    sensor : Sensor
        Its range, resolution and noise. The noise of integer depth is evaluated once per value;
        noise "auto" is estimated from the image (`planewise.estimate_noise`).
    depth_scale : float, optional
        Metres per unit of integer depth; ``None`` means the sensor's resolution. Presets of
        LiDARs have steps of their own, such as 12 mm: 0.001 says that ranges are in millimetres.
    workspace : Workspace, optional
        Memory to work in; the observation lasts until it is used again, and as long as the image
        stays as it is. Without one it has a copy of the image.

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
    from planewise import compilation  # loads Numba

    compilation.announce("depth image")
    if workspace is None:
        depth = unmasked("depth", depth).copy()  # the caller may change what it is of
    image = DepthImage.of(depth, checked_sensor(sensor), depth_scale, workspace)
    checked_camera(camera).check(image.shape)
    check_own(camera, image.shape)
    if camera.bends and (blind := _without_rays(camera, image.shape)) is not None:
        image = image.without(blind)
    seen = RayObservation(
        shape=image.shape,
        range=sensor.range,
        resolution=sensor.resolution,
        image=image,
        camera=camera,
        sensor=sensor,
    )
    if sensor.noise == AUTO:
        from planewise.calibration.estimate import resolved

        estimate, sensor = resolved(seen, sensor)
        seen = replace(seen, sensor=sensor, estimate=estimate)
    seen.level_sigma  # noqa: B018 - a bad noise is refused here
    return seen
