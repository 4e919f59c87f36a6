"""What a frame says about its own error: white noise, steep surfaces, drift, what neighbours share.

A sensor's description gives the error's shape over depth; the frame gives its size. Each number is
the one at which most cells, or neighbours, or cells in a row, lie as far from planes as chi^2 says
they should: quantiles, for edges and clutter only make them lie farther.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import frame_error as kernels
from planewise.kernels import medians
from planewise.kernels.cells import COUNT, SIDE, UNIT
from planewise.sectors import Sectors
from planewise.spatial.frame import ErrorTable
from planewise.workspace import Workspace

Array = NDArray[np.float64]
Grid = NDArray[np.int32]
Image = NDArray[np.float32]

_WIDEST, _WITHIN = 9.0, 0.9973  # three standard deviations, and the share of a normal within them
_DISTORTED = 0.22  # steradians, where error drifts over 100 pixels as much as it is white
_TURN = 0.15  # radians from one cell to the next, on smooth surfaces that are no planes
_FARTHEST = 0.03  # of their depth: over 100 pixels no camera's error drifts by more
_FARTHEST_CELLS = 0.05  # the same of cells in a row, whose error may be smooth over a few pixels
_FEWEST = 100  # cells, or pairs of them, that can tell
_FEWEST_TRIPLES = 20  # of near cells in a row: in small images they say more than a description
_ROUGH = 0.8, 0.8416  # share of the cells, and of a normal below so many standard deviations
_ROUGHER = 2.0  # times the white variance of half of them: more is no noise, but edges
_USUAL = 25.0  # five times the described standard deviation: a frame may always err by that
_AS_MUCH = 1.3  # times what cells show of an error, blocks of four may show of it if it is white
_ROUGHEST = 0.1  # of its depth: no sensor's reading errs by more
_STEEPNESS = (0.25, 0.75, 1.25, 1.75, 2.25)  # bins of slope per pixel in standard deviations
_SAMPLE = 2000  # cells of a bin that medians are taken of, at most
_LATERAL_LIMIT = 1.5  # pixels^2
_TELLING = 0.1  # of the triples: an error that leaves fewer within three deviations is larger
_LAG = 2  # cells from the middle of three in a row to the others
_MANY = 2000  # cells of which some can stand for all
_LAGS = (4, 8, 12)  # the same: they tell a walk from an error that soon levels off
_CELL = 2 * SIDE / UNIT
_ABOUT = 1 / 3  # of the drift of the shortest distance: as far as that of longer ones may be off
_CURVED = 0.2  # depth against its radius: no camera bends a plane so much
_SMOOTH = 8.0  # times what a reading errs by itself: a cell's readings share more of a smooth error
_SOON = 0.4  # of V(24 px), V(12 px): 0.5 of an error over 14 px, 0.3 of one over 20 px
_AVERAGED = 0.2  # `FrameError.priced` at most, where error is smooth over a few pixels
_LESS = 0.5  # of the drift of three cells in a row: four show no less of a walk
_MORE = 1.5  # times the drift of the shortest distance: more is no walk
_RELIEF = 2.0  # times it: more is none of an error that is smooth over 20 pixels, either
_UNTOLD = 2.25  # times its described variance: more from one cell to the next but one is no error
_UNSEEN = 0.3  # of the drift of the shortest distance, where no other tells: between all and none
_AT_LEAST = 0.25  # of the drift: few distances may show none by chance
_BY_CHANCE = 0.01, 100  # `FrameError.drifting` that white noise may show; the same times squares
_BISECTIONS = 12
_BISECTED = (1e-3, 400.0)
_BEYOND = 0.99  # of the largest factor: none was found


@dataclass(frozen=True, kw_only=True)
class FrameError:
    """Sizes of the parts of a frame's error against its sensor's description, as variances.

    Attributes
    ----------
    white : float
        Of the white part; below 1 only where the description is no more than a data sheet's.
    seen : float
        The same as cells show it, be it below 1.
    lateral : float
        Error across the image in pixels^2: a surface of slope s per pixel errs by lateral s^2 more,
        in all parts alike.
    drift : float
        Of the drift between segments.
    local : float
        Of the drift as the shortest distance shows it: of readings about their plane.
    near, bent : float
        Of the shared part: as offsets and as slopes of cells.
    drifting : float
        Drift between segments over 100 pixels against what is random, at most 1: the white part,
        and what it dithers of steps.
    priced : float
        The same for what a plane has to save: little, where error is smooth over a few pixels.
    distorted : float
        Readings of a plane of whose misfit half is distortion; infinite where there is none.
    turning : float
        Discord against white error of cells side by side on a smooth surface that turns by `_TURN`.
    walk : float
        Of the drift of near cells, as far as it does not level off: it moves planes as a whole. 0
        where chance may explain it.
    """

    white: float = 1.0
    seen: float = 1.0
    lateral: float = 0.0
    drift: float = 1.0
    local: float = 1.0
    near: float = 1.0
    bent: float = 1.0
    drifting: float = 1.0
    priced: float = 1.0
    distorted: float = math.inf
    turning: float = 0.0
    walk: float = 0.0

    @property
    def smooth(self) -> bool:
        """Whether it is the same over a few pixels: planes are not `priced` as it drifts."""
        return self.priced != self.drifting

    def describe(self) -> dict[str, float | None]:
        """All of it in plain types, for result files; infinity is None."""
        return {name: float(x) if math.isfinite(x) else None for name, x in vars(self).items()}


def drift_and_distortion(
    white: float, drift: float, w: float, table: ErrorTable, sectors: Sectors
) -> tuple[float, float, float]:
    """What depends on a usual 1 / z, w: `FrameError.drifting`, `distorted` and `turning`.

    A camera whose error drifts is distorted on the scale of the image, too; a range image is not,
    nor are readings that stray farther than those of cameras do, as of leaves.
    """
    described, _, wandering, step = table.at(w)
    total, white, drift = white * (described + step), white * described, drift * wandering
    random = max(total - step, white)
    if step:  # what noise dithers of steps is random, too (`kernels.frame_error.unit_errors`)
        random -= step * math.expm1(-(math.pi**2) * random / (3 * step))
    drifting = min(1.0, drift / random) if random else 1.0
    distorted, turning = math.inf, 0.0
    if sectors.count == 1 and white:
        # The slope dw/dx of n x n pixels has 12 / (n^2 (n^2 - 1)) of the variance of a reading.
        n, slope = 2 * SIDE, w * _TURN / sectors.mean_focal
        turning = slope**2 * n**2 * (n**2 - 1) / (2 * 12 * white)
    if sectors.count == 1 and drifting and drift <= (_FARTHEST * w) ** 2:
        distorted = _DISTORTED * sectors.mean_focal**2 / drifting
    return drifting, distorted, turning


def white_seen(misfits: Array, freedom: Array | int, w: Image, p: Image) -> float:
    """White variance against the description: the median whole cell about its own plane says it.

    A frame whose cells are farther from planes than a sensor can err has no such noise, but no
    planes: then the description stands. w, p (H, W): inverse depth, and its described precision.
    """
    if not misfits.size:
        return 1.0
    factor = _against_chi2(misfits, freedom)
    if factor > _USUAL:
        there = p > 0
        most = _ROUGHEST**2 * float(np.median(np.square(w[there]) * p[there]))
        return factor if factor <= most else 1.0
    return factor


def white_of_rough(seen: float, misfits: Array, freedom: Array | int) -> float:
    """White variance against the description where cells err more differently than chi^2 does.

    A plane must not fall apart where its error is larger than that of most, so it is what four
    cells of five have: as much as `seen` of half of them where all err alike.
    """
    rough = _against_chi2(misfits, freedom, _ROUGH) if misfits.size else seen
    if rough > _USUAL:
        return seen
    return min(max(rough, seen), _ROUGHER * seen)


def white_of_quiet(
    moments: Array, misfits: Array, of_cells: Array, table: ErrorTable, resolution: float
) -> float:
    """White variance against a description of more than the frame shows.

    Data sheets state limits, and then the frame is right; but readings that were smoothed show less
    than they err, and then it is not. Smooth error shows more in larger cells, white error as much:
    each block is held against its own cells, for by how much a description is too large may differ
    with depth. moments (rows, 11, columns), misfits (rows, columns): of blocks of 2 x 2 cells;
    of_cells: misfits of the cells. At least rounding is there.
    """
    moments, misfits = moments[::2, :, ::2], misfits[::2, ::2]  # a quarter stands for all
    row, column = np.nonzero(moments[:, COUNT] == 4 * SIDE * SIDE)
    if len(row) < _FEWEST:
        return 1.0
    together = misfits[row, column]
    apart = np.zeros(len(row))
    for down, right in np.ndindex(2, 2):
        apart += of_cells[4 * row + down, 4 * column + right]
    freedom = 4 * SIDE * SIDE - 3
    more = together * (4 * (SIDE * SIDE - 3)) > _AS_MUCH * freedom * apart
    if 2 * np.count_nonzero(more) > len(row):
        return 1.0
    w = float(np.median(moments[row, 6, column] / moments[row, 0, column]))
    least = rounding(table, w, resolution)
    return min(max(_against_chi2(together, freedom), least), 1.0)


def rounding(table: ErrorTable, w: float, resolution: float) -> float:
    """White variance of readings that do nothing but round, at w, against the description."""
    white, _, _, step = table.at(w)
    return max(step, w**4 * resolution**2 / 12) / (white + step)


def _against_chi2(
    misfits: Array, freedom: Array | int, quantile: tuple[float, float] = (0.5, 0.0)
) -> float:
    """Quantile of misfits against that of chi^2 (Wilson and Hilferty).

    quantile: share of the misfits below it, and where it lies in a standard normal distribution.
    """
    share, normal = quantile
    variance = 2 / (9 * freedom)
    ratios = misfits / (freedom * (1 - variance + normal * np.sqrt(variance)) ** 3)
    return float(medians.smallest(ratios, int(share * ratios.size), np.empty(ratios.size)))


def lateral_variance(
    planes: Array, count: Array, whole: NDArray[np.bool_], workspace: Workspace
) -> tuple[float, Array]:
    """Error across the image in pixels^2, and how steep every unit is.

    Cells on steep surfaces lie farther from their planes: chi^2 = a + b q with q = (slope per pixel
    / sigma)^2 is a line through medians, and lateral = b / a. planes (10, .), count (n,), whole
    (n,): of units (`kernels.cells.merge_quarters`).
    """
    bins = len(_STEEPNESS) - 1
    steep, sizes = workspace.empty(len(count)), np.empty(bins, np.int64)
    samples = workspace.empty((bins, 2, _SAMPLE))
    kernels.steepness(planes, count, whole, np.square(_STEEPNESS), steep, sizes, samples)
    told = [(sample, n) for sample, n in zip(samples, sizes.tolist(), strict=True) if n >= _FEWEST]
    lateral = 0.0
    if len(told) > 1:
        slope, base = _line([_medians(*each) for each in told], [math.sqrt(n) for _, n in told])
        lateral = min(max(slope / max(base, 0.1), 0.0), _LATERAL_LIMIT)
    return lateral, steep


def _medians(sample: Array, size: int) -> tuple[float, float]:
    """Medians of the two rows of a sample of so many."""
    taken = -(-size // -(-size // sample.shape[1]))
    work = np.empty(taken)
    x, y = (float(medians.smallest(row[:taken], taken // 2, work)) for row in sample)
    return x, y


def _line(points: list[tuple[float, float]], weights: list[float]) -> tuple[float, float]:
    """Slope and height at 0 of the line through points."""
    weighted = [(*point, weight) for point, weight in zip(points, weights, strict=True)]
    total = sum(weights)
    cx = sum(weight * x for x, _, weight in weighted) / total
    cy = sum(weight * y for _, y, weight in weighted) / total
    slope = sum(weight * (x - cx) * (y - cy) for x, y, weight in weighted)
    slope /= sum(weight * (x - cx) ** 2 for x, _, weight in weighted)
    return slope, cy - slope * cx


def drift_factor(
    grid: Grid,
    planes: Array,
    inflation: Array,
    drift: Array,
    focal: float,
    workspace: Workspace,
    lag: int = _LAG,
    every: int = 1,
) -> float | None:
    """Drift against its description, as a variance: from three and four cells in a row.

    None if it is open, infinite if none explains them.

    w_middle - t w_left - (1 - t) w_right has the variance of the cells' own errors and what the
    drift adds. Its median among those within three standard deviations is that of chi^2: what lies
    across an edge is left out, not taken for drift. A curved surface shows in it as well, but not
    in how much it changes from one cell to the next, as drift does: where that tells of much less
    drift, and surfaces bend more than distortion does, it is right. grid holds whole cells only, -1
    elsewhere; one of `every` rows and columns counts; focal: pixels.
    """
    some = grid if every == 1 else np.ascontiguousarray(grid[::every, ::every])
    of_cells = some, planes, inflation, drift, lag // every
    fewest = _FEWEST_TRIPLES if lag == _LAG else _FEWEST
    with workspace.stage():
        rows = workspace.empty((3, 2 * some.size), np.float32)

        def told_by(four: bool) -> float | None:
            n = kernels.cells_in_a_row(*of_cells, four, *rows)
            square, own, slow = rows[:, :n]
            if n < fewest or not slow.max():
                return None
            return _bisect(square, own, slow, 0.5 / _WITHIN, _WIDEST)

        factor = told_by(False)
        if not factor or factor == math.inf:
            return factor
        r = lag * _CELL
        bend = 2 * math.sqrt(factor * float(drift.mean()) * _of_three(r)) / (r * UNIT / focal) ** 2
        if bend > _CURVED * planes[2, : len(drift)].mean():
            of_four = told_by(True)
            if of_four is not None and of_four < _LESS * factor:
                return of_four
    return factor


class Walk(NamedTuple):
    """A random walk, as variances against that of the described drift (`walk_of`).

    Attributes
    ----------
    drift, least : float
        As it is told, and how little of it there may be.
    shown, of_drift : float
        V(r) of the distance that tells what cells have of their own besides, and f(r).
    soon : bool
        Whether cells a few pixels apart err nearly as differently as those farther apart do.
    """

    drift: float
    least: float
    shown: float = 0.0
    of_drift: float = 0.0
    soon: bool = False

    @property
    def shared(self) -> float:
        """What every cell has of its own."""
        return max(self.shown - self.drift * self.of_drift, 0.0) / 1.5

    def less(self, share: float) -> Walk:
        """The same if so much of it were a walk."""
        return self._replace(drift=share * self.drift, least=share * self.least)


def walk_of(
    grid: Grid,
    planes: Array,
    inflation: Array,
    drift: Array,
    nearest: float,
    reading: float,
    focal: float,
    workspace: Workspace,
) -> Walk:
    """Drift, and what a cell's readings share, which several distances tell apart.

    Three cells in a row, r from the middle to the others, have an error of the variance

        V(r) = 3/2 s + D f(r)    (f: `kernels.frame_error.cells_in_a_row`)

    s what every cell has of its own, such as an error that is the same over a few pixels and then
    another one, D the random walk. Where an error levels off, D lies between the least slope of V
    and the walk without s that explains as much: their mean is taken. Where that is about
    `nearest`, D of the shortest distance, it is a walk, and the shortest distance is the most
    certain. No camera's walk is more than 3 % of the depth over 100 pixels: the rest is s. Both
    against the described variance of the drift; reading: that of one reading.
    """
    told: list[float] = []
    of_three: list[float] = []
    cluttered = False
    usual, w = float(drift.mean()), float(planes[2, : len(drift)].mean())
    farthest = (_FARTHEST * w) ** 2
    nearby = _of_three(_LAG * _CELL)
    relief = max(farthest, _UNTOLD * reading / nearby)
    if nearest * usual * nearby > (_FARTHEST_CELLS * w) ** 2:
        return Walk(0.0, 0.0)  # no camera errs by so much
    every = 2 if grid.size > _MANY else 1  # far ones overlap: every other row and column will do
    for lag in _LAGS:
        factor = drift_factor(grid, planes, inflation, drift, focal, workspace, lag, every)
        if factor is None:
            break
        cluttered = factor * usual > max(farthest, _MORE * nearest * usual)
        if cluttered:
            if not told and nearest * usual > relief and factor > _RELIEF * nearest:
                return Walk(0.0, 0.0)  # nor so
            break
        of_three.append(_of_three(lag * _CELL))
        told.append(factor * of_three[-1])
    walk = least = nearest
    soon = nearest * nearby > _SOON * told[0] if told else not cluttered
    if len(told) > 1:
        most = np.divide(told, of_three)[1:]
        least = max(float(min(most[0], (np.diff(told) / np.diff(of_three)).min())), 0.0)
        walk = 0.5 * (least + float(most.min()))
    elif cluttered:  # what is farther apart lies on different surfaces
        walk = least = _UNSEEN * nearest
    alike = abs(walk - nearest) < _ABOUT * nearest
    if alike:
        walk = least = nearest
    if alike or len(told) < 2:
        of_three, told = [nearby], [nearest * nearby]
    walk, least = min(walk, farthest / usual), min(max(least, _AT_LEAST * walk), farthest / usual)
    return Walk(walk, least, told[0], of_three[0], soon)


def _of_three(r: float) -> float:
    """f(r) of `walk_of`."""
    near, far = (d + _CELL * _CELL / (12 * d) for d in (r, 2 * r))
    return near - 0.25 * far - 0.75 * kernels.MEAN_DISTANCE * _CELL


def drifting_by_chance(squares: int, measured: float | None, *, known: bool) -> float:
    """`FrameError.drifting` that a frame of so many whole squares of cells may show without a walk.

    measured: as of `drift_factor`; known: a drift that the sensor states is there, unless the frame
    says otherwise.
    """
    if not known and (measured is None or measured == math.inf):
        return 1.0
    chance = max(_BY_CHANCE[0], _BY_CHANCE[1] / max(squares, 1))
    return min(chance, 0.5) if known else chance


def priced(drifting: float, shared: float, own: float) -> float:
    """`FrameError.priced`, of what a cell's readings share and what each errs by itself, variances.

    An error that is smooth over a few pixels, as of stereo, is another in the next cell but one:
    planes average it as they do white noise, and clutter does not look like planes by it.
    """
    return min(drifting, _AVERAGED) if shared > _SMOOTH * own else drifting


def shared_factors(
    grid: Grid,
    planes: Array,
    inflation: Array,
    drift: Array,
    shared: Array,
    tilt: Array,
    workspace: Workspace,
) -> tuple[float, float]:
    """How far neighbours disagree beyond white noise and drift, where they meet and in slope.

    Factors on the variances `shared` of a cell's offset and `tilt` of its slopes, per unit.
    """
    # In single precision, for quantiles of so many.
    slopes = workspace.empty((3, 4 * grid.size), np.float32)
    offsets = workspace.empty((4, 2 * grid.size), np.float32)
    n = kernels.neighbours(grid, planes, inflation, drift, shared, tilt, slopes, offsets)
    square, own, tilted = slopes[:, : 2 * n]
    if 2 * n < _FEWEST or not tilted.max():
        return 1.0, 1.0
    # Where what is described is next to nothing, the description stands.
    bent = _bisect(square, own, tilted, 0.5)
    bent = bent if bent < math.inf else 1.0
    square, own, common, turned = offsets[:, :n]
    near = _bisect(square, own + bent * turned, common, 0.5)
    return near if near < math.inf else 1.0, bent


def _bisect(square: Array, own: Array, added: Array, share: float, widest: float = np.inf) -> float:
    """The factor at which a quantile of square / (own + factor added) is the median of chi^2, or 0.

    Of those up to `widest`, which have to be a tenth of all: where the error is much larger than
    `own`, hardly any are at small factors, and these by chance. Infinite where none explains the
    rest.
    """
    limits = (medians.OF_CHI2, widest, _TELLING, *_BISECTED, _BISECTIONS)
    factor = float(kernels.bisect(square, own, added, share, *limits))
    return factor if factor < _BEYOND * _BISECTED[1] else math.inf
