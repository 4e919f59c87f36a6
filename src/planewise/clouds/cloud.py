"""A cloud of free points as the spatial search sees it: sorted, in cubes, with their variances."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.memory import Memory
from planewise.clouds.order import Grid, Keys, Order, extent_of, held_by, order_of, positions
from planewise.kernels import cloud_cells as kernels
from planewise.kernels import cloud_keys
from planewise.kernels import cubes as cube_loops
from planewise.kernels.cloud_rows import ROW
from planewise.noise import is_constant
from planewise.runtime import threads
from planewise.sensor import Sensor

Array = NDArray[np.float64]

POINTS = 7.0  # mean number in an occupied cube, where noise allows cubes that small
THICK = 8.0  # standard deviations that the side of a cube has at least
_LONELY = 1.1  # times as wide may cubes be as without lonely points; those of even density are 1.02
SLICED = 16.0  # up to as many wide cubes cut many sheets into slices
FINER = 2  # levels of the order below the cubes
SHIFT = 3 * FINER  # bits of a key below its cube
_LEAST_PART = 2_000  # cubes that are worth a thread
_SAMPLED = 1_000_000  # points that stand for more
_STRAY = 100.0  # times the median distance: a point that is so far off says nothing of most
_PART = 1 << 16  # points whose noise is evaluated at once: arrays of them fit the cache
_GRAZING = 0.1  # least cos^2 between a ray and a normal that noise is foreshortened by
WIDE = 0.15  # least ratio of the variances in a plane: points of a line lie in one that is none
STEEPEST = 0.06  # variance of a slope that a cell's points have to tell better
FEWEST = 6.0  # points of a cell
FEWEST_TOLD = 50  # cells, or pairs of them, that can tell
LEVELS = 5  # sizes of cubes that a sample of them has whole
_CUBES = 40_000  # that stand for a cloud


@dataclass(frozen=True)
class Cloud:
    """Points in the order of their cubes.

    Attributes
    ----------
    grid : Grid
        Of the cubes. All coordinates here are relative to its centre.
    rows : ndarray of uint32, shape (k,)
        Row of the input that each point stood in.
    local : ndarray of float32, shape (k, 3)
        Points relative to the middle of their cube.
    starts : ndarray of int, shape (n + 1,)
        Where the points of each cube begin.
    cubes : ndarray of uint64, shape (n,)
        Keys of the occupied cubes, sorted.
    about : ndarray of int32, shape (n, 27)
        Cubes about each, -1 for none (`kernels.cubes.cubes_about`).
    nodes : ndarray, shape (n, 18)
        Moments of the points of each (`kernels.cloud_rows`).
    variance : ndarray, shape (n,)
        Mean variance of its points as the sensor says, square metres.
    workers : int
        Threads.
    on_rays : bool
        Whether the rays of the points are known: two of their coordinates.
    louder : float
        Times the described standard deviation that `variance` is of.
    memory : Memory
        Where its large arrays lie.
    parts : tuple of (int, int)
        Runs of cubes, first and end, that are worked on one after the other; all by default.
    """

    grid: Grid
    rows: NDArray[np.uint32]
    local: NDArray[np.float32]
    starts: NDArray[np.int64]
    cubes: NDArray[np.uint64]
    about: NDArray[np.int32]
    nodes: Array
    variance: Array
    workers: int
    on_rays: bool = False
    louder: float = 1.0
    memory: Memory = field(default_factory=Memory)
    parts: tuple[tuple[int, int], ...] = ()

    @property
    def centre(self) -> Array:
        """What all coordinates are relative to, shape (3,)."""
        return self.grid.centre

    @property
    def side(self) -> float:
        """Of a cube, metres."""
        return self.grid.side

    def cuts_sheets(self, white: float) -> bool:
        """Whether sheets are so thick beside cubes that many are cut; white: against `variance`.

        By what was described: where that is far too little, nothing says what a sheet is.
        """
        widest = self.louder * self.side / SLICED
        return bool(white * float(np.median(self.variance)) > widest * widest)

    def positions(self) -> Array:
        """Return the sorted points relative to the centre, shape (k, 3)."""
        middle = np.column_stack([positions(self.cubes, axis) for axis in (0, 1, 2)]) + 0.5
        middle = (middle - self.grid.middle) * self.side
        return np.asarray(
            np.repeat(middle @ cloud_keys.TURN, np.diff(self.starts), axis=0) + self.local
        )

    @cached_property
    def sample(self) -> tuple[Array, Keys]:
        """Cubes that stand for the cloud: whole blocks of an octree, drawn by a hash of their keys.

        Their nodes and keys.
        """
        stride = np.uint64(1 + len(self.cubes) // _CUBES)
        block = (self.cubes >> np.uint64(3 * (LEVELS - 1))) * np.uint64(0x9E3779B97F4A7C15)
        chosen = (block >> np.uint64(32)) % stride == 0
        if stride == 1 or not chosen.any():
            return self.nodes, self.cubes
        return self.nodes[chosen], self.cubes[chosen]

    @cached_property
    def roughness(self) -> float | None:
        """`roughness_of` the sample."""
        return roughness_of(self.sample[0], self.workers)

    def runs(self) -> Iterator[tuple[int, int]]:
        """Runs of cubes to work on one after the other."""
        for first, last in self.parts or ((0, len(self.cubes)),):
            yield first, last
            self.memory.release()

    def rename(self, labels: NDArray[np.uint16], place: NDArray[np.uint16]) -> None:
        """Change the labels of the sorted points to what place (N + 1,) says of each."""
        for first, last in self.runs():
            part = slice(self.starts[first], self.starts[last])
            labels[part] = place[labels[part]]

    def over_cubes(self, work: Callable[[int, int], None]) -> None:
        """``work(first, last)`` on parts of the cubes, one a thread."""
        for first, last in self.runs():
            over_part(work, first, last, self.workers, _LEAST_PART)


def over_part(
    work: Callable[[int, int], None], first: int, last: int, workers: int, least: int
) -> None:
    """``work`` on parts of first ... last, one a thread (`threads.over_chunks`)."""
    threads.over_chunks(
        lambda begin, end: work(first + begin, first + end), last - first, workers, least
    )


def roughness_of(nodes: Array, workers: int) -> float | None:
    """Variance about their planes, against the description, of the quietest quarter of nodes.

    ``None`` where too few tell a plane.
    """
    ratios = np.empty(len(nodes))
    over_part(
        lambda first, last: kernels.roughness(
            nodes, STEEPEST, WIDE, FEWEST + 2.0, first, last, ratios
        ),
        0, len(nodes), workers, _LEAST_PART,
    )  # fmt: skip
    ratios = ratios[ratios >= 0.0]
    return float(np.quantile(ratios, 0.25)) if len(ratios) >= FEWEST_TOLD else None


def cloud_of(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: Array | None,
    workers: int,
    held: float = POINTS,
    origin: Array | None = None,
    louder: float = 1.0,
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
    louder : float
        Times the described standard deviation.
    """
    low, high, count = extent_of(points, workers)
    if count < 3:
        return None
    centre, reach, typical = grid_about(points, low, high, sensor, sigma, origin)
    side = side_for(points, centre, reach, THICK * louder * typical, held, workers)
    order = order_of(points, Grid.reaching(centre, reach, side / (1 << FINER)), workers)
    if len(order.keys) < 3:
        return None
    starts, cubes, local, nodes, variance = summed(
        points, order, sensor, sigma, origin, workers, louder
    )
    about = np.empty((len(cubes), 27), np.int32)
    write_about(cubes, 0, len(cubes), about, workers)
    return Cloud(
        coarse(order.grid), order.rows, local, starts, cubes, about, nodes, variance, workers,
        on_rays=origin is not None, louder=louder,
    )  # fmt: skip


def grid_about(
    points: NDArray[np.floating],
    low: Array,
    high: Array,
    sensor: Sensor,
    sigma: Array | None,
    origin: Array | None,
) -> tuple[Array, float, float]:
    """Middle and reach of the grid of points between low and high, and their typical sigma."""
    typical = _typical(points, sensor, sigma, np.zeros(3) if origin is None else origin)
    farthest = max(
        sensor.range, float(1 << (cloud_keys.LEVELS - 1)) * THICK * typical / (1 << FINER)
    )
    return *middle_of(points, low, high, farthest), typical


def middle_of(
    points: NDArray[np.floating], low: Array, high: Array, farthest: float
) -> tuple[Array, float]:
    """Middle of points between low and high, and how far they reach, at most `farthest`."""
    with np.errstate(over="ignore"):  # of a point at 1e300
        centre = 0.5 * (low + high)
        reach = max(0.5 * float(np.linalg.norm(high - low)), 1e-9)
    if reach > farthest:
        # Points far off must not make cubes larger than noise does.
        some = points[:: 1 + len(points) // _SAMPLED]
        there = np.isfinite(some).all(axis=1)
        centre, reach = np.median(some[there], axis=0).astype(np.float64), farthest
    return centre, reach


def summed(
    points: NDArray[np.floating],
    order: Order,
    sensor: Sensor,
    sigma: Array | None,
    origin: Array | None,
    workers: int,
    louder: float = 1.0,
) -> tuple[NDArray[np.int64], Keys, NDArray[np.float32], Array, Array]:
    """Starts, keys, local points, moments and variances of the cubes of sorted points (`Cloud`)."""
    starts = order.starts(SHIFT)
    n = len(starts) - 1
    cubes = order.keys[starts[:-1]] >> np.uint64(SHIFT)
    local = np.empty((len(order.keys), 3), np.float32)
    nodes = np.empty((n, ROW))
    grid = coarse(order.grid)
    threads.over_chunks(
        lambda first, last: kernels.local_points(
            points, order.rows, starts, cubes, grid.side, grid.middle, cloud_keys.TURN,
            grid.centre, first, last, local, nodes,
        ),
        n, workers, _LEAST_PART,
    )  # fmt: skip
    seen_from = np.zeros(3) if origin is None else origin
    variance = louder**2 * _variances(points, sensor, sigma, order, starts, seen_from)
    if origin is not None:
        rays = mean_origins(origin, order, starts) - grid.centre
        kernels.foreshorten(nodes, rays, STEEPEST, FEWEST, _GRAZING, variance)
    kernels.weigh(nodes, variance)
    return starts, cubes, local, nodes, variance


def coarse(grid: Grid) -> Grid:
    """Grid of the cubes, of that of the order."""
    return Grid(grid.centre, grid.side * (1 << FINER), grid.levels - FINER, grid.reach)


def write_about(
    cubes: NDArray[np.uint64], first: int, last: int, about: NDArray[np.int32], workers: int
) -> None:
    """Write the cubes about cubes[first:last] to about (`kernels.cubes.cubes_about`)."""
    over_part(
        lambda begin, end: cube_loops.cubes_about(cubes, begin, end, about),
        first, last, workers, _LEAST_PART,
    )  # fmt: skip


def side_for(
    points: NDArray[np.floating],
    centre: Array,
    reach: float,
    least: float,
    held: float,
    workers: int,
    memory: Memory | None = None,
) -> float:
    """Side of cubes that hold so many points on average, at least `least`.

    Lonely points (`held_by`) would make cubes the larger the more of them there are: cubes are at
    most `_LONELY` times as wide as those that hold so many without them.

    Between its doubles the logarithm of the number is interpolated. centre, reach: of the grid;
    memory: where the points lie.
    """
    first, known = Grid.reaching(centre, reach, least).side, dict[int, tuple[float, float]]()
    doublings = max(0, math.ceil(math.log2(2.0 * reach / first)))  # one cube is enough for all

    def excess(which: int, power: int) -> float:  # grows with the side
        if power not in known:
            grid = Grid.reaching(centre, reach, first * 2.0**power)
            known[power] = held_by(points, grid, workers, memory or Memory())
        return math.log(known[power][which] / held)

    of_all, without_lonely = (_zero(partial(excess, which), doublings) for which in (0, 1))
    return float(first * min(2.0**of_all, _LONELY * 2.0**without_lonely))


def _zero(excess: Callable[[int], float], most: int) -> float:
    """Where a function that grows is zero, between 0 and `most`."""
    low, high = -1, 0
    while high < most and excess(high) < 0.0:
        low, high = high, max(high + 1, 2 * high)  # as a rule few doublings do
    high = min(high, most)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if excess(middle) < 0.0 else (low, middle)
    if high in (0, most):
        return float(high)
    now, before = excess(high), excess(high - 1)
    return high + now / (before - now)


def _typical(
    points: NDArray[np.floating], sensor: Sensor, sigma: Array | None, origin: Array
) -> float:
    """Standard deviation of most points."""
    if sigma is not None:
        return float(np.median(sigma[:: 1 + len(sigma) // _SAMPLED]))
    if is_constant(sensor.noise):
        return float(sensor.sigma(np.zeros(1))[0])
    step = 1 + len(points) // 10_000
    distances = _distances(points[::step], origin if origin.ndim == 1 else origin[::step])
    distances = distances[np.isfinite(distances)]
    if not len(distances):
        return float(sensor.sigma(np.ones(1))[0])
    # Where strays lie noise may be too large to be any.
    distances = distances[distances <= _STRAY * np.median(distances)]
    return float(np.median(sensor.sigma(distances)))


def _distances(points: NDArray[np.floating], origin: Array) -> Array:
    """Distances of points (n, 3) from the origin, (3,) or (n, 3).

    Column by column: sums over an axis of three take NumPy six times as long.
    """
    x, y, z = (np.subtract(points[:, e], origin[..., e], dtype=np.float64) for e in range(3))
    with np.errstate(over="ignore"):  # of a point at 1e300
        return np.asarray(np.sqrt(x * x + y * y + z * z))


def _variances(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: Array | None,
    order: Order,
    starts: NDArray[np.int64],
    origin: Array,
) -> Array:
    """Mean variance of the points of each cube, at least that of rounding to the resolution."""
    least = sensor.resolution**2 / 12.0
    if sigma is None and is_constant(sensor.noise):
        return np.full(len(starts) - 1, max(float(sensor.sigma(np.zeros(1))[0]) ** 2, least))
    if sigma is None:
        sigma = _sigma_of_each(points, sensor, order, origin)
    squares = np.maximum(np.square(sigma), least)
    return np.asarray(np.add.reduceat(squares[order.rows], starts[:-1]) / np.diff(starts))


def _sigma_of_each(
    points: NDArray[np.floating], sensor: Sensor, order: Order, origin: Array
) -> Array:
    """Standard deviation of every point in the grid; of others, which may lie anywhere, 0."""
    out, there = np.zeros(len(points)), None
    if len(order.rows) < len(points):
        there = np.zeros(len(points), np.bool_)
        there[order.rows] = True
    for first in range(0, len(points), _PART):
        part = slice(first, first + _PART)
        mine = slice(None) if there is None else there[part]
        distances = _distances(points[part], origin if origin.ndim == 1 else origin[part])
        out[part][mine] = sensor.sigma(distances[mine])
    return out


def mean_origins(origin: Array, order: Order, starts: NDArray[np.int64]) -> Array:
    """Where the rays of the points of each cube begin, on average: shape (1 or n, 3)."""
    if origin.ndim == 1:
        return origin[None]
    sums = np.add.reduceat(origin[order.rows], starts[:-1], axis=0)
    return np.asarray(sums / np.diff(starts)[:, None])
