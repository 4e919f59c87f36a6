"""Noise of a cloud, estimated from its points: ``noise="auto"``.

Cubes of an octree, of every size, say how far their points lie from a plane. Those that are smaller
than the noise tell none, and the larger a cube, the more often an edge goes through it: the size
counts whose flat cubes hold most points. Edges, clutter and bent surfaces only make cubes rougher,
so the estimate comes from below, as that of depth images (`calibration.estimate`).

Points of a depth image lie on slices, the steps of its depth (`clouds.depth_steps`): then no cube
counts as flatter than these steps, and sigma is a function of the range, that along the rays.

Where most points lie in rougher cubes, or the rougher cubes agree on a noise of their own, what is
quiet is not the noise of the rest: near a scanner, along its lines, or on ground that it grazes.
Then sigma is doubled while Phi falls (`clouds.noise_factor`). So is what is assumed where a few
points have too few cubes, if planes hold most of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import checked_count, checked_points
from planewise.calibration.fit import fit_polynomial
from planewise.clouds.cloud import STEEPEST, WIDE, mean_origins, middle_of, side_for
from planewise.clouds.depth_steps import Rounding
from planewise.clouds.memory import Memory
from planewise.clouds.missing import without_missing
from planewise.clouds.order import Grid, Order, blocks_of, extent_in_blocks, order_of
from planewise.kernels import cloud_cells, cloud_keys
from planewise.kernels import cloud_noise as kernels
from planewise.kernels.cloud_noise import FREEDOM, RANGE, VARIANCE
from planewise.kernels.cloud_rows import COUNT, ROW
from planewise.noise import AUTO, Polynomial, constant
from planewise.point_observation import checked_origin
from planewise.runtime.threads import chosen
from planewise.sensor import Sensor, checked_sensor

Array = NDArray[np.float64]
Points = NDArray[np.floating]

_FEWEST = 8.0  # points of a cube
_GRAZING = 0.1  # least cos^2 between ray and normal
_THICK = 12.0  # standard deviations that the side of a cube has at least: it must not cut the sheet
_FULL = 0.12  # of the side: at most 1 / sqrt 12, at which points fill a cube
_CUBES = 50  # that can tell
_HELD = 7.0  # points in an occupied cube of the middle level, on average
_FINER, _LEVELS = 3, 9  # levels below that one, and all of them
_START = 0.4  # quantile of the variances, from which to go on
_ROUGH = 3.0  # standard deviations of chi^2: a cube that is rougher is on an edge
_ENOUGH = 30.0  # degrees of freedom of a cube that count: a large one is many points in one place
_STEPS, _TOLERANCE = 40, 1e-3
_GRIDS, _MANY = 8, 100_000  # grids that a cloud of few points is laid into; points that need one
_MOST = 300_000  # points that stand for a cloud
_BLOCK = 5_000  # points of a part of space that is looked at as a whole
_SAMPLE = 200_000  # points that say how large such a part is
_BIN = 1.3  # ranges of a bin lie within this factor
_CURVE_ERROR = 0.05  # relative error that a curve of the range may have on top
_FEWEST_BINS = 4  # that tell how noise depends on the range
_SURE = 0.6  # share of the points in cubes that lies in flat ones, above which noise is that of all
_ASSUMED = 1e-3  # of the extent: noise of points that do not tell


@dataclass(frozen=True, kw_only=True)
class CloudNoise:
    """Noise of a cloud as its points show it.

    Attributes
    ----------
    noise : Polynomial
        Standard deviation of a point in metres: across its surface, the same everywhere; where the
        place of the scanner is known, along the ray, a function of the range.
    cubes : int
        Flat cubes that say it.
    side : float
        Of these cubes, metres; 0 where the points do not tell.
    note : str
        What was assumed instead, where the points do not tell; else empty.
    """

    noise: Polynomial
    cubes: int
    side: float
    note: str = ""

    def sensor(self, base: Sensor) -> Sensor:
        """Sensor of the same range and resolution with this noise."""
        return replace(base, noise=self.noise)

    def describe(self) -> dict[str, str | int | float]:
        """Say in plain types what was found, for result files."""
        return {
            "source": "assumed" if self.note else "estimated",
            "note": self.note,
            "cubes": self.cubes,
            "side_m": self.side,
            "noise": str(self.noise),
        }


def estimate_cloud_noise(
    points: ArrayLike,
    sensor: Sensor,
    *,
    origin: ArrayLike | None = None,
    threads: int | None = None,
) -> CloudNoise:
    """Estimate the noise of points in space from the points themselves.

    Parameters
    ----------
    points : array_like, shape (k, 3)
        As in `planewise.detect_planes_in_points`.
    sensor : Sensor
        Range and resolution; its noise is not used.
    origin : array_like, shape (3,) or (k, 3), optional
        Where the scanner stood: then the noise along the rays is told.
    threads : int, optional
        ``None`` means one per processor. The result does not depend on it.

    Returns
    -------
    CloudNoise

    Raises
    ------
    ValueError
        If an argument is malformed.

    Examples
    --------
    >>> import numpy as np, planewise as pw
    >>> rng = np.random.default_rng(0)
    >>> wall = np.column_stack((rng.uniform(0, 3, (20_000, 2)), rng.normal(0, 0.004, 20_000)))
    >>> noise = pw.estimate_cloud_noise(wall, pw.Sensor(max_depth=5.0, noise="auto")).noise
    >>> round(noise.constant, 4)
    0.004
    """
    array = checked_points(points, 3)
    checked_sensor(sensor)
    workers = chosen(threads if threads is None else checked_count("threads", threads))
    place = checked_origin(origin, array.shape)
    readings = without_missing(array, replace(sensor, noise=AUTO), None, place)
    return cloud_noise(np.ascontiguousarray(readings), sensor, place, workers)


def cloud_noise(
    points: Points,
    sensor: Sensor,
    origin: Array | None,
    workers: int,
    memory: Memory | None = None,
) -> CloudNoise:
    """`estimate_cloud_noise` of checked arguments; memory: where the points lie."""
    memory = memory or Memory()
    low, high, count = extent_in_blocks(points, workers, memory)
    if count < _FEWEST:
        return _assumed(sensor, 0.0)
    centre, reach = middle_of(points, low, high, sensor.range)
    some, seen_from, wide = _standing_for(points, origin, centre, reach, count, workers, memory)
    rounding, rays = Rounding.of(some, sensor.resolution, seen_from), seen_from
    if rays is None and rounding.has_steps:
        rays = np.zeros(3)  # where the camera is
    sizes, floor = _sizes(some, centre, reach, rays, workers), rounding.between(0.0, math.inf)
    if rays is None:
        told = _best([each for each in sizes if each[0] < 0.5 * wide], floor, _FULL)
        if told is None:
            if count > _MOST:
                some = np.ascontiguousarray(points[:: 1 + count // _MOST])
                memory.release()
                sizes = _sizes(some, centre, reach, None, workers)
            from planewise.clouds.few import MOST  # with it come the loops of searches

            thick = _of_thick(sizes, floor, sensor, reach)
            few = thick.note and count <= MOST
            return _by_planes(thick, some, sensor, workers) if few else thick
    else:
        told = _best(sizes, floor)
    if told is None:
        return _assumed(sensor, reach)
    noise = constant(told.sigma)
    if rays is not None:
        noise = _of_range(sizes, rounding) or _of_steps(sizes, rounding) or noise
    if not rounding.has_steps and _differs(told, dict(sizes)[told.side], floor):
        # Its compiled loops are loaded only where they are used.
        from planewise.clouds.noise_factor import noise_factor

        def noise_of(points: Points) -> float:
            sizes = _sizes(points, centre, reach, None, workers)
            told = _best([each for each in sizes if each[0] < 0.5 * wide], floor, _FULL)
            return told.sigma if told is not None and told.share >= _SURE else 0.0

        noise = noise.scaled(noise_factor(some, sensor, noise, seen_from, noise_of, workers))
    return CloudNoise(noise=noise, cubes=told.cubes, side=told.side)


def _sizes(
    points: Points, centre: Array, reach: float, rays: Array | None, workers: int
) -> list[tuple[float, Array]]:
    """Side and flat cubes (`kernels.flat_cubes`) of every size."""
    levels: list[list[Array]] = [[] for _ in range(_LEVELS)]
    side = 0.0
    for order, finest in _grids(points, centre, reach, workers):
        side = finest
        for level, cubes in enumerate(_flat(points, order, rays)):
            levels[level].append(cubes)
    return [(side * 2.0**k, np.concatenate(each)) for k, each in enumerate(levels) if each]


def _of_thick(
    sizes: list[tuple[float, Array]], floor: float, sensor: Sensor, reach: float
) -> CloudNoise:
    """Noise of dense and thick sheets, from the cubes of every n-th point.

    Parts of space that hold some thousands of points are thinner than such sheets. Of cubes that
    are hardly wider than them, the median of the size that is flattest is not far from the truth,
    unless these are full, too: points that fill space tell nothing.
    """
    told = _best(sizes, floor, _FULL)
    if told is not None:
        return CloudNoise(noise=constant(told.sigma), cubes=told.cubes, side=told.side)
    assumed = _assumed(sensor, reach)
    usual = [
        (float(np.median(cubes[:, VARIANCE])) ** 0.5 / side, side, len(cubes))
        for side, cubes in sizes
        if len(cubes) >= _CUBES
    ]
    flattest, side, cubes = min(usual, default=(math.inf, 0.0, 0))
    if flattest > _FULL or flattest * side < assumed.noise.constant:
        return assumed
    note = f"all cubes that tell are hardly wider than the noise; assumed {flattest * side:g} m"
    return CloudNoise(noise=constant(flattest * side), cubes=cubes, side=side, note=note)


def _by_planes(assumed: CloudNoise, points: Points, sensor: Sensor, workers: int) -> CloudNoise:
    """Assumed noise of few points, or more where most of them lie on planes that err by more."""
    from planewise.clouds.noise_factor import noise_factor  # with its loops, where they are used

    factor = noise_factor(points, sensor, assumed.noise, None, lambda _: 0.0, workers, least=_SURE)
    if factor == 1.0:
        return assumed
    noise = assumed.noise.scaled(factor)
    note = f"too few points tell it; assumed {noise.constant:g} m, by the planes they lie on"
    return replace(assumed, noise=noise, note=note)


def _assumed(sensor: Sensor, reach: float) -> CloudNoise:
    sigma = max(sensor.resolution, 2.0 * _ASSUMED * reach)
    note = f"too few points lie on something flat; assumed {sigma:g} m"
    return CloudNoise(noise=constant(sigma), cubes=0, side=0.0, note=note)


def _standing_for(
    points: Points,
    origin: Array | None,
    centre: Array,
    reach: float,
    count: int,
    workers: int,
    memory: Memory,
) -> tuple[Points, Array | None, float]:
    """Points that stand for all, each place once, where their rays begin, and how wide parts are.

    Of many points those in parts of space that a hash draws, all that lie there.
    """
    rows, wide = None, math.inf
    if count > _MOST:
        rows, wide = _drawn(points, centre, reach, count, workers, memory)
    some = points if rows is None else points[rows]
    order = order_of(some, Grid.reaching(centre, reach, 0.0), workers)
    # Points that were copied err alike.
    chosen = order.rows[_begins(order.keys)]
    some = np.ascontiguousarray(some[chosen])
    if origin is None or origin.ndim == 1:
        return some, origin, wide
    return some, origin[chosen] if rows is None else origin[rows[chosen]], wide


def _drawn(
    points: Points, centre: Array, reach: float, count: int, workers: int, memory: Memory
) -> tuple[NDArray[np.int64], float]:
    """Rows of the points in some cubes of `_BLOCK` points, and the side of these."""
    sample = np.ascontiguousarray(points[:: 1 + len(points) // _SAMPLE])
    memory.release()
    held = max(_BLOCK * len(sample) / len(points), 1.0)
    side = side_for(sample, centre, reach, 2.0 * reach / len(sample), held, workers)
    grid, share = Grid.reaching(centre, reach, side), np.uint64(1 + count // _MOST)
    rows: list[NDArray[np.int64]] = []
    first = 0
    for block in blocks_of(points, memory):
        keys = grid.keys(block, workers)
        part = (keys * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(32)
        drawn = (part % share == 0) & (keys < np.uint64(1 << 3 * grid.levels))
        rows.append(np.flatnonzero(drawn) + first)
        first += len(block)
    return np.concatenate(rows), side


def _grids(
    points: Points, centre: Array, reach: float, workers: int
) -> Iterator[tuple[Order, float]]:
    """Points in the order of a grid, and its finest side; of few points in several grids."""
    if not len(points):
        return
    least = 2.0 * reach / len(points)
    side = side_for(points, centre, reach, least, _HELD, workers) / (1 << _FINER)
    rng = np.random.default_rng(0)
    for grid in range(max(1, min(_GRIDS, _MANY // len(points)))):
        widest = side * (1 << (_LEVELS - 1)) if grid else 0.0
        middle = centre + rng.uniform(-widest, widest, 3)
        order = order_of(points, Grid.reaching(middle, reach + 2.0 * widest, side), workers)
        yield order, order.grid.side


def _flat(points: Points, order: Order, origin: Array | None) -> Iterator[Array]:
    """Flat cubes of every level (`kernels.flat_cubes`)."""
    starts = order.starts(0)
    keys, seen_from, grid = order.keys[starts[:-1]], np.empty((0, 3)), order.grid
    local, nodes = np.empty((len(order.keys), 3), np.float32), np.empty((len(keys), ROW))
    cloud_cells.local_points(
        points, order.rows, starts, keys, grid.side, grid.middle, cloud_keys.TURN, grid.centre,
        0, len(keys), local, nodes,
    )  # fmt: skip
    if origin is not None:
        seen_from = mean_origins(origin, order, starts) - grid.centre
    limits = _FEWEST, WIDE, STEEPEST, _GRAZING
    for _ in range(_LEVELS):
        out = np.empty((len(nodes), 3))
        yield out[: kernels.flat_cubes(nodes, seen_from, limits, out)]
        parents, above = np.empty_like(nodes), np.empty_like(keys)
        found = cloud_cells.parents_of(nodes, keys, parents, above)
        if len(seen_from) > 1:
            begins = np.flatnonzero(_begins(keys >> np.uint64(3)))
            sums = np.add.reduceat(seen_from * nodes[:, COUNT, None], begins, axis=0)
            seen_from = sums / parents[:found, COUNT, None]
        nodes, keys = parents[:found].copy(), above[:found].copy()


def _begins(keys: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """Whether each of sorted keys is another one than that before it."""
    return np.append(True, keys[1:] != keys[:-1])[: len(keys)]


@dataclass(frozen=True)
class _Told:
    """What cubes of one size say: sigma in metres; flat ones, their share of points, freedom."""

    sigma: float
    cubes: int
    share: float
    freedom: float
    side: float


def _best(sizes: list[tuple[float, Array]], floor: float, full: float = math.inf) -> _Told | None:
    """What cubes of the size say whose flat ones hold most points.

    full: of their side; cubes that are half of them rougher are full of points, and in these some
    are flat by chance, or because they reach into the edge of a sheet.
    """
    told = [
        _told(side, cubes, floor)
        for side, cubes in sizes
        if len(cubes) >= _CUBES and np.median(cubes[:, VARIANCE]) <= (full * side) ** 2
    ]
    told = [each for each in told if each.side >= _THICK * each.sigma]
    return max(told, key=lambda each: each.freedom, default=None)


def _told(side: float, cubes: Array, floor: float) -> _Told:
    """From below: the mean of the cubes that are not much rougher, again and again."""
    variance, freedom = cubes[:, VARIANCE], cubes[:, FREEDOM]
    rough = _roughest(cubes)
    square = max(float(np.quantile(variance, _START)), floor)
    for _ in range(_STEPS):
        flat = variance <= rough * square
        last, total = square, float(freedom[flat].sum())
        if total:
            square = max(float(variance[flat] @ freedom[flat]) / total, floor)
        if abs(square / last - 1.0) < _TOLERANCE:
            break
    flat = variance <= rough * square
    weight = float(np.minimum(freedom[flat], _ENOUGH).sum())
    share = float(freedom[flat].sum() / freedom.sum())
    return _Told(math.sqrt(square), int(flat.sum()), share, weight, side)


def _roughest(cubes: Array) -> Array:
    """Variance of cubes that are still flat, against that of the noise."""
    return np.asarray(1.0 + _ROUGH * np.sqrt(2.0 / cubes[:, FREEDOM]))


def _differs(told: _Told, cubes: Array, floor: float) -> bool:
    """Whether noise is not that of all: most err by more, or those that err by twice as much agree.

    cubes: of the size that told it.
    """
    if told.share < _SURE:
        return True
    rougher = cubes[cubes[:, VARIANCE] > _roughest(cubes) * (2.0 * told.sigma) ** 2]
    other = _best([(told.side, rougher)], floor)
    return other is not None and other.share >= _SURE


def _of_range(sizes: list[tuple[float, Array]], rounding: Rounding) -> Polynomial | None:
    """Curve of sigma over the range, None where too few ranges tell."""
    points = []
    for low, high in _bins(np.concatenate([cubes[:, RANGE] for _, cubes in sizes])):
        inside = [(side, c[(c[:, RANGE] >= low) & (c[:, RANGE] < high)]) for side, c in sizes]
        told = _best(inside, rounding.between(low, high))
        if told is not None:
            error = math.hypot(math.sqrt(0.5 / told.freedom), _CURVE_ERROR)
            points.append((math.sqrt(low * high), told.sigma, error))
    if len(points) < _FEWEST_BINS:
        return None
    return fit_polynomial(*np.array(points).T)


def _of_steps(sizes: list[tuple[float, Array]], rounding: Rounding) -> Polynomial | None:
    """Curve of sigma where the steps of depth give its course, and cubes of all ranges its size.

    Both are those of disparity, as a rule. None where there are no steps.
    """
    if not rounding.has_steps:
        return None
    points = []
    for low, high in _bins(rounding.ranges):
        middle = math.sqrt(low * high)
        points.append((middle, math.sqrt(rounding.between(low, high)), _CURVE_ERROR))
    course = fit_polynomial(*np.array(points).T)
    units = []
    for side, cubes in sizes:
        step, in_steps = course(cubes[:, RANGE]), cubes.copy()
        in_steps[:, VARIANCE] /= step**2
        units.append((side / float(np.median(step)) if len(step) else side, in_steps))
    told = _best(units, 1.0)
    return None if told is None else course.scaled(told.sigma)


def _bins(ranges: Array) -> list[tuple[float, float]]:
    """Bins that hold ranges, but for those of 0."""
    ranges = ranges[ranges > 0]
    if not len(ranges):
        return []
    nearest = float(ranges.min())
    held = np.unique((np.log(ranges / nearest) / math.log(_BIN)).astype(np.int64))
    return [(nearest * _BIN**k, nearest * _BIN ** (k + 1)) for k in held.tolist()]
