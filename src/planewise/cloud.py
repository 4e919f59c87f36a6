"""A cloud of free points as the spatial search sees it: sorted, in cubes, with their variances."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise import threads
from planewise.cloud_order import Order, extent_of, order_of, positions
from planewise.kernels import cloud_cells as kernels
from planewise.kernels import cloud_keys
from planewise.kernels.cloud_rows import ROW
from planewise.noise import Polynomial
from planewise.sensor import Sensor

Array = NDArray[np.float64]

POINTS = 7.0  # mean number in an occupied cube, where noise allows cubes that small
_THICK = 8.0  # standard deviations that the side of a cube has at least
_FINER = 2  # levels of the order below the cubes
_LEAST_PART = 2_000  # cubes that are worth a thread
_PART = 1_000_000  # points whose noise is evaluated at once
_GRAZING = 0.1  # least cos^2 between a ray and a normal that noise is foreshortened by
STEEPEST = 0.06  # variance of a slope that a cell's points have to tell better
FEWEST = 6.0  # points of a cell


@dataclass(frozen=True)
class Cloud:
    """Points in the order of their cubes.

    Attributes
    ----------
    order : Order
        Sorted keys and where each point stood.
    centre : ndarray, shape (3,)
        What all coordinates here are relative to.
    local : ndarray of float32, shape (k, 3)
        Points relative to the middle of their cube.
    starts : ndarray of int, shape (n + 1,)
        Where the points of each cube begin.
    cubes : ndarray of uint64, shape (n,)
        Keys of the occupied cubes, sorted.
    about : ndarray of int32, shape (n, 27)
        Cubes about each, -1 for none (`kernels.cloud_cells.cubes_about`).
    nodes : ndarray, shape (n, 18)
        Moments of the points of each (`kernels.cloud_rows`).
    variance : ndarray, shape (n,)
        Mean variance of its points as the sensor says, square metres.
    side : float
        Of a cube, metres.
    shift : int
        Bits of a point's key below its cube.
    workers : int
        Threads.
    on_rays : bool
        Whether the rays of the points are known: two of their coordinates.
    """

    order: Order
    local: NDArray[np.float32]
    starts: NDArray[np.int64]
    cubes: NDArray[np.uint64]
    about: NDArray[np.int32]
    nodes: Array
    variance: Array
    side: float
    shift: int
    workers: int
    on_rays: bool = False

    @property
    def centre(self) -> Array:
        """What all coordinates are relative to, shape (3,)."""
        return self.order.centre

    def positions(self) -> Array:
        """Return the sorted points relative to the centre, shape (k, 3)."""
        grid = [positions(self.cubes, axis) for axis in (0, 1, 2)]
        middle = (np.column_stack(grid) + 0.5) * self.side
        middle -= 0.5 * (1 << cloud_keys.LEVELS) * self.order.side
        return np.asarray(
            np.repeat(middle @ cloud_keys.TURN, np.diff(self.starts), axis=0) + self.local
        )

    def over_cubes(self, work: object) -> None:
        """``work(first, last)`` on parts of the cubes, one a thread."""
        threads.over_chunks(work, len(self.cubes), self.workers, _LEAST_PART)  # type: ignore[arg-type]


def cloud_of(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: Array | None,
    workers: int,
    held: float = POINTS,
    origin: Array | None = None,
) -> Cloud | None:
    """Sort points into cubes; ``None`` if fewer than three are finite.

    Parameters
    ----------
    points : ndarray of float, shape (k, 3)
        Metres, any origin. Points farther from the others than R and two million standard
        deviations are no reading, like those that are not finite.
    sensor : Sensor
        Its noise is evaluated at the distance from the origin of the coordinates.
    sigma : ndarray, shape (k,), optional
        Standard deviations of the points, in place of the sensor's.
    workers : int
        Threads.
    held : float
        Points in an occupied cube, on average, where noise allows cubes that small.
    origin : ndarray, shape (3,) or (k, 3), optional
        Where the scanner stood: noise is along the rays from there, and depends on the range.
    """
    low, high, count = extent_of(points, workers)
    if count < 3:
        return None
    centre = 0.5 * (low + high)
    reach = max(0.5 * float(np.linalg.norm(high - low)), 1e-9)
    from_where = np.zeros(3) if origin is None else origin
    typical = _typical(points, sensor, sigma, from_where)
    farthest = max(
        sensor.range, float(1 << (cloud_keys.LEVELS - 1)) * _THICK * typical / (1 << _FINER)
    )
    if reach > farthest:
        # Points far off must not make cubes larger than noise does.
        there = np.isfinite(points).all(axis=1)
        centre, reach = np.median(points[there], axis=0).astype(np.float64), farthest
    order = order_of(points, centre, reach, 4.0 * typical, workers)
    side = max(_side_for(order, held), _THICK * typical)
    order = order_of(points, centre, reach, side / (1 << _FINER), workers)
    if len(order.keys) < 3:
        return None
    side, shift = order.side * (1 << _FINER), 3 * _FINER

    starts = np.empty(len(order.keys) + 1, np.int64)
    n = cloud_keys.run_starts(order.keys, shift, starts)
    starts = starts[: n + 1].copy()
    starts[n] = len(order.keys)
    local = np.empty((len(order.keys), 3), np.float32)
    nodes = np.empty((n, ROW))
    threads.over_chunks(
        lambda first, last: kernels.local_points(
            points, order.rows, order.keys, starts, shift, order.side, cloud_keys.TURN,
            centre, first, last, local, nodes,
        ),
        n, workers, _LEAST_PART,
    )  # fmt: skip
    variance = _variances(points, sensor, sigma, order, starts, from_where)
    if origin is not None:
        seen_from = _mean_origins(origin, order, starts) - centre
        kernels.foreshorten(nodes, seen_from, STEEPEST, FEWEST, _GRAZING, variance)
    kernels.weigh(nodes, variance)
    cubes = order.keys[starts[:-1]] >> np.uint64(shift)
    about = np.full((n, 27), -1, np.int32)
    threads.over_chunks(
        lambda first, last: kernels.cubes_about(cubes, first, last, about),
        n, workers, _LEAST_PART,
    )  # fmt: skip
    return Cloud(
        order, local, starts, cubes, about, nodes, variance, side, shift, workers,
        on_rays=origin is not None,
    )  # fmt: skip


def _side_for(order: Order, points: float) -> float:
    """Side of cubes that hold so many points on average, between powers of two."""
    counts = np.empty(cloud_keys.LEVELS + 1, np.int64)
    cloud_keys.separations(order.keys, counts)
    cubes = np.maximum(len(order.keys) - np.cumsum(counts), 1)
    held = np.log(len(order.keys) / cubes)
    level = float(np.interp(math.log(points), held, np.arange(len(held), dtype=float)))
    return float(order.side * 2.0**level)


def _is_constant(sensor: Sensor) -> bool:
    noise = sensor.noise
    return isinstance(noise, Polynomial) and not noise.linear and not noise.quadratic


def _typical(
    points: NDArray[np.floating], sensor: Sensor, sigma: Array | None, origin: Array
) -> float:
    """Standard deviation of most points."""
    if sigma is not None:
        return float(np.median(sigma))
    if _is_constant(sensor):
        return float(sensor.sigma(np.zeros(1))[0])
    step = 1 + len(points) // 10_000
    sample = points[::step] - (origin if origin.ndim == 1 else origin[::step])
    sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample):
        return float(sensor.sigma(np.ones(1))[0])
    return float(np.median(sensor.sigma(np.linalg.norm(sample, axis=1))))


def _variances(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: Array | None,
    order: Order,
    starts: NDArray[np.int64],
    origin: Array,
) -> Array:
    """Mean variance of the points of each cube."""
    if sigma is None and _is_constant(sensor):
        return np.full(len(starts) - 1, float(sensor.sigma(np.zeros(1))[0]) ** 2)
    if sigma is None:
        out: Array = np.empty(len(points))
        for first in range(0, len(points), _PART):
            part = points[first : first + _PART].astype(np.float64)
            part -= origin if origin.ndim == 1 else origin[first : first + _PART]
            there = np.isfinite(part).all(axis=1)
            distance = np.sqrt((part * part).sum(axis=1))
            out[first : first + len(part)] = sensor.sigma(np.where(there, distance, 0.0))
        sigma = out
    squares = np.asarray(np.square(sigma))
    return np.asarray(np.add.reduceat(squares[order.rows], starts[:-1]) / np.diff(starts))


def _mean_origins(origin: Array, order: Order, starts: NDArray[np.int64]) -> Array:
    """Where the rays of the points of each cube begin, on average: shape (1 or n, 3)."""
    if origin.ndim == 1:
        return origin[None]
    sums = np.add.reduceat(origin[order.rows], starts[:-1], axis=0)
    return np.asarray(sums / np.diff(starts)[:, None])
