"""What a frame says about its own error: white noise, steep surfaces, and what follows from drift.

A sensor's description gives the error's shape over depth; the frame gives its size. Each number is
the one at which most cells lie as far from planes as chi^2 says they should: quantiles, for edges
and clutter only make them lie farther.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import frame_error as kernels
from planewise.kernels import medians
from planewise.kernels.cells import COUNT, SIDE
from planewise.runtime.workspace import Workspace
from planewise.sectors import Sectors
from planewise.spatial.frame import ErrorTable

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FARTHEST = 0.03
"""Of their depth: over 100 pixels no camera's error drifts by more."""

FEWEST = 100
"""Cells, or pairs of them, that can tell."""

_DISTORTED = 0.22  # steradians, where error drifts over 100 pixels as much as it is white
_TURN = 0.15  # radians from one cell to the next, on smooth surfaces that are no planes
_ROUGH = 0.8, 0.8416  # share of the cells, and of a normal below so many standard deviations
_ROUGHER = 2.0  # times the white variance of half of them: more is no noise, but edges
_USUAL = 25.0  # five times the described standard deviation: a frame may always err by that
_AS_MUCH = 1.3  # times what cells show of an error, blocks of four may show of it if it is white
_ROUGHEST = 0.1  # of its depth: no sensor's reading errs by more
_STEEPNESS = (0.25, 0.75, 1.25, 1.75, 2.25)  # bins of slope per pixel in standard deviations
_SAMPLE = 2000  # cells of a bin that medians are taken of, at most
_LATERAL_LIMIT = 1.5  # pixels^2
_SMOOTH = 8.0  # times what a reading errs by itself: a cell's readings share more of a smooth error
_AVERAGED = 0.2  # `FrameError.priced` at most, where error is smooth over a few pixels
_BY_CHANCE = 0.01, 100  # `FrameError.drifting` that white noise may show; the same times squares


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
    if sectors.count == 1 and drifting and drift <= (FARTHEST * w) ** 2:
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
    if len(row) < FEWEST:
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
    told = [(sample, n) for sample, n in zip(samples, sizes.tolist(), strict=True) if n >= FEWEST]
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
