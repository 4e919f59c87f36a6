"""A depth image as a sensor gives it: raw values, and the few thousand levels that occur in it.

Everything that depends on depth alone (inverse depth, noise, quantisation) is a function of the
level, so it is worked out once per level instead of once per pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import checked_scale, unmasked
from planewise.runtime import threads
from planewise.runtime.workspace import Workspace
from planewise.sensor import Sensor
from planewise.wild import wild_readings

Array = NDArray[np.float64]

_GRID = 0.1  # of the sensor's resolution: readings in metres closer than that are one level
_MOST_LEVELS = 1 << 18
_MOST_UNITS = (1 << 16) - 1  # of integer depth
_LEAST_DEPTH = 1e-6  # metres
_ROUNDED = 4  # in the last place: a reading at the sensor's limit may lie so far beyond
_CLIPPED = 0.01  # of the readings are at the limit, at least, where others are there, too
_TELLING = 4  # readings of a level on the mean: quantised ones meet again and again
_WINDOW = 9  # gaps between levels over which the step is a median


@dataclass(frozen=True, kw_only=True)
class DepthImage:
    """A depth image, its unit, and its levels.

    Attributes
    ----------
    values : ndarray of uint16 or float, shape (H, W)
        Units of `scale`.
    scale : float
        Metres per unit.
    low, high : float
        Smallest and largest value that is a reading.
    per_metre : float
        Levels per metre: the level of a depth z is round(per_metre z).
    levels : ndarray of int, shape (n,)
        Levels that occur, in rising order.
    depth : ndarray, shape (n,)
        A reading of each of them, in metres.
    count, present : int
        Readings, and values that are not missing, outside the sensor's range or not.
    unit : float, optional
        Metres per unit of an image that came in integers.
    coarse : bool
        Whether levels are farther apart than the sensor's resolution, for there are no more of
        them: then gaps between them are no steps of its readings.
    """

    values: NDArray[Any]
    scale: float
    low: float
    high: float
    per_metre: float
    levels: NDArray[np.int64]
    depth: Array
    count: int
    present: int
    unit: float | None = None
    coarse: bool = False

    @classmethod
    def of(
        cls,
        depth: ArrayLike,
        sensor: Sensor,
        depth_scale: float | None,
        workspace: Workspace | None = None,
    ) -> DepthImage:
        """Check an image and find its levels.

        Raises
        ------
        ValueError
            If it is not a 2-D array of numbers with at least two rows and columns, or holds
            negative depths.
        """
        image, unit = _checked(depth), None
        if image.dtype.kind != "f":
            scale = checked_scale(depth_scale) or sensor.resolution
            if image.dtype.kind == "i" and (image < 0).any():
                raise _negative(image)
            if image.dtype.itemsize <= 2 or image.max() <= _MOST_UNITS:
                low, high = _limits_in_units(sensor, scale)
                high = min(high, _MOST_UNITS)
                values = np.ascontiguousarray(image, np.uint16)
                return cls._of_levels(values, scale, low, high)._unclipped(sensor.max_depth)
            image, unit = image * scale, scale
        elif depth_scale is not None:
            raise ValueError("depth_scale is for integer depth; floating-point depth is in metres")
        image = np.ascontiguousarray(image, _precision(image))
        nearest, farthest = map(float, _limits_in_metres(sensor, image))
        deepest = sensor.max_depth
        if deepest > _MOST_LEVELS * sensor.resolution:
            # Levels of all that the sensor may see would be coarser than what it tells apart.
            deepest = farthest = float(np.max(image, where=image <= farthest, initial=nearest))
        grid = max(_GRID * sensor.resolution, deepest / _MOST_LEVELS)
        return cls._of_metres(
            image,
            nearest,
            farthest,
            1.0 / grid,
            workspace or Workspace(),
            unit,
            coarse=grid > sensor.resolution,
        )._unclipped(sensor.max_depth)

    @classmethod
    def _of_levels(
        cls, values: NDArray[np.uint16], scale: float, low: int, high: int
    ) -> DepthImage:
        from planewise.kernels import images as kernels  # loads Numba

        seen = np.zeros(_MOST_UNITS + 1, np.bool_)
        count, present = kernels.mark_levels(values.reshape(-1), low, high, seen)
        levels = low + seen[low : high + 1].nonzero()[0]
        return cls(
            values=values,
            scale=scale,
            low=low,
            high=high,
            per_metre=1.0 / scale,
            levels=levels,
            depth=levels * np.float64(scale),
            count=count,
            present=present,
            unit=scale,
        )

    @classmethod
    def _of_metres(
        cls,
        values: NDArray[np.floating],
        low: float,
        high: float,
        per_metre: float,
        workspace: Workspace,
        unit: float | None,
        *,
        coarse: bool,
    ) -> DepthImage:
        from planewise.kernels import images as kernels

        with workspace.stage():
            reading = workspace.empty(int(high * per_metre) + 2)
            reading[:] = 0
            count, present, negative = kernels.mark_depths(values, low, high, per_metre, reading)
            if negative and (values[values < 0] > -np.inf).any():  # -inf: too near (ROS, REP 117)
                raise _negative(values)
            levels = np.flatnonzero(reading)
            depth = reading[levels]
        return cls(
            values=values,
            scale=1.0,
            low=low,
            high=high,
            per_metre=per_metre,
            levels=levels,
            depth=depth,
            count=count,
            present=present,
            unit=unit,
            coarse=coarse,
        )

    @cached_property
    def tame(self) -> DepthImage:
        """The same without wild readings; itself where there are next to none."""
        level = 1.0 if self.values.dtype == np.uint16 else 1.0 / self.per_metre
        wild = wild_readings(self.values, self.low, self.high, level)
        return self if wild is None else self.without(wild)

    def _unclipped(self, limit: float) -> DepthImage:
        """The same without readings at the sensor's limit, if depth beyond was clipped to it."""
        if not self.levels.size or self.levels[-1] < int(self.per_metre * limit + 0.5):
            return self
        clipped = self.values >= limit / self.scale * (1.0 - _ROUNDED * np.finfo(np.float32).eps)
        clipped &= self.values <= self.high
        many = _CLIPPED * self.count <= np.count_nonzero(clipped) < self.count
        return self.without(clipped) if many else self

    def without(self, pixels: NDArray[np.bool_]) -> DepthImage:
        """Return the same without the readings of some pixels, a mask (H, W)."""
        values = np.where(pixels, self.values.dtype.type(0), self.values)
        if values.dtype == np.uint16:
            return self._of_levels(values, self.scale, int(self.low), int(self.high))
        limits, work = (self.low, self.high, self.per_metre), Workspace()
        return self._of_metres(values, *limits, work, self.unit, coarse=self.coarse)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.values.shape[0], self.values.shape[1]

    def readings(self) -> tuple[NDArray[np.int64], Array]:
        """Place in the flattened image and depth in metres of every reading, in raster order."""
        flat = self.values.reshape(-1)
        index = np.flatnonzero((flat >= self.low) & (flat <= self.high))
        return index, flat.take(index) * np.float64(self.scale)

    def steps(self) -> Array:
        """Quantisation step at every level in metres; 0 where readings are too few to tell."""
        if self.coarse or self.count < _TELLING * self.levels.size:
            return np.zeros(self.levels.size)  # gaps are between readings, not between steps
        return reading_steps(self.levels) / self.per_metre

    def spread(self, precision: Array, w: NDArray[np.float32], p: NDArray[np.float32]) -> None:
        """Write inverse depth, and its precision given per level, into images; 0 for no reading."""
        from planewise.kernels import images as kernels

        table = np.zeros(self.levels[-1] + 2 if self.levels.size else 1, np.float32)
        table[self.levels] = precision
        if self.values.dtype == np.uint16:
            inverse = np.zeros(table.size, np.float32)
            inverse[self.levels] = 1.0 / self.depth

            def look_up(a: int, b: int) -> None:
                kernels.look_up_levels(self.values[a:b], inverse, table, w[a:b], p[a:b])
        else:

            def look_up(a: int, b: int) -> None:
                kernels.look_up_depths(
                    self.values[a:b], self.low, self.high, self.per_metre, table, w[a:b], p[a:b]
                )

        threads.halves(look_up, self.shape[0])


def reading_steps(levels: NDArray[np.integer]) -> Array:
    """Quantisation step at every level that occurs in a frame, in levels.

    Parameters
    ----------
    levels : ndarray of int, shape (n,)
        In rising order.

    Returns
    -------
    ndarray, shape (n,)
        Running median of the gaps, so that a level that no pixel hit does not count; 0 where there
        are too few to tell.

    Examples
    --------
    >>> reading_steps(1000 + 3 * np.arange(20))[[0, -1]]
    array([3., 3.])
    >>> reading_steps(np.append(1000, 1195 + np.arange(20)))[:1]  # a wall, and another behind it
    array([1.])
    """
    if levels.size < _WINDOW:
        return np.zeros(levels.size)
    from planewise.kernels import images as kernels  # loads Numba

    steps = np.empty(levels.size)
    kernels.running_medians(levels[1:] - levels[:-1], _WINDOW // 2, steps[:-1])
    steps[-1] = steps[-2]
    return steps


def within_range(depth: NDArray[Any], sensor: Sensor, depth_scale: float | None) -> NDArray[Any]:
    """A depth image with 0 in place of what its sensor cannot have read; itself where it can.

    So what marks missing readings is looked past, be it 65535 or 100 m.
    """
    if depth.dtype.kind == "f":
        low, high = _limits_in_metres(sensor, depth)
    elif depth.dtype.kind in "iu":
        low, high = _limits_in_units(sensor, checked_scale(depth_scale) or sensor.resolution)
    else:
        return depth
    most = np.fmax.reduce(depth, axis=None, initial=0)  # not NaN
    if most <= high and sensor.min_depth == 0:
        return depth
    with np.errstate(invalid="ignore"):
        beyond = (depth > high) | (depth >= 0) & (depth < low)  # what is negative is refused
        return np.where(beyond, depth.dtype.type(0), depth)


def _limits_in_units(sensor: Sensor, scale: float) -> tuple[int, int]:
    """Smallest and largest reading of a sensor in units of so many metres."""
    nearest, farthest = sensor.min_depth / scale, sensor.max_depth / scale
    return max(1, math.ceil(nearest - 1e-9)), math.floor(farthest + 1e-9)


def _limits_in_metres(sensor: Sensor, image: NDArray[Any]) -> tuple[Any, Any]:
    """The same in metres, in the precision of an image, in which readings may be rounded."""
    precision = _precision(image)
    rounding = _ROUNDED * float(np.finfo(precision).eps)
    nearest = max(sensor.min_depth, _LEAST_DEPTH) * (1.0 - rounding)
    return precision(nearest), precision(sensor.max_depth * (1.0 + rounding))


def _precision(image: NDArray[Any]) -> type[np.float32 | np.float64]:
    """Of readings in metres: NumPy compares in that of an image, loops in double."""
    return np.float32 if image.dtype == np.float32 else np.float64


def _checked(depth: ArrayLike) -> NDArray[Any]:
    image = unmasked("depth", depth)
    if image.ndim != 2 or min(image.shape) < 2:
        found = f"shape {image.shape}" if image.ndim else type(image.item()).__name__
        raise ValueError(
            f"depth must be a 2-D image with at least 2 rows and 2 columns, got {found}"
        )
    if image.dtype.kind not in "fiu":
        raise ValueError(f"depth must be metres (float) or integer units, got dtype {image.dtype}")
    return image


def _negative(image: NDArray[Any]) -> ValueError:
    first = image[(image < 0) & (image > -np.inf)].flat[0]
    return ValueError(f"depth must not be negative, got {first}; mark missing readings 0")
