"""What neighbouring cells tell of a frame's error: how far it drifts, and what they share of it.

Each number is the one at which most cells in a row, or side by side, lie as far from a line, or
from each other, as chi^2 says they should: quantiles, for edges and clutter only make them lie
farther.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import frame_error as kernels
from planewise.kernels import medians
from planewise.kernels.cells import SIDE, UNIT
from planewise.runtime.workspace import Workspace
from planewise.spatial.frame_error import FARTHEST, FEWEST

Array = NDArray[np.float64]
Grid = NDArray[np.int32]

_WIDEST, _WITHIN = 9.0, 0.9973  # three standard deviations, and the share of a normal within them
_FARTHEST_CELLS = 0.05  # of their depth: no camera's cells in a row err by more
_FEWEST_TRIPLES = 20  # of near cells in a row: in small images they say more than a description
_TELLING = 0.1  # of the triples: an error that leaves fewer within three deviations is larger
_LAG = 2  # cells from the middle of three in a row to the others
_LAGS = (4, 8, 12)  # the same: they tell a walk from an error that soon levels off
_NEAR = 4  # the same, at most: farther apart too few are in a part that may bend alike
_MANY = 2000  # cells of which some can stand for all
_CELL = 2 * SIDE / UNIT
_ABOUT = 1 / 3  # of the drift of the shortest distance: as far as that of longer ones may be off
_CURVED = 0.2  # depth against its radius: no camera bends a plane so much
_SOON = 0.4  # of V(24 px), V(12 px): 0.5 of an error over 14 px, 0.3 of one over 20 px
_ALIKE = 0.5  # of what cells in a row are off a line: of a walk next to nothing bends alike
_MORE = 1.5  # times the drift of the shortest distance: more is no walk
_RELIEF = 2.0  # times it: more is none of an error that is smooth over 20 pixels, either
_UNTOLD = 2.25  # times its described variance: more from one cell to the next but one is no error
_UNSEEN = 0.3  # of the drift of the shortest distance, where no other tells: between all and none
_AT_LEAST = 0.25  # of the drift: few distances may show none by chance
_BISECTIONS = 12
_BISECTED = (1e-3, 400.0)
_BEYOND = 0.99  # of the largest factor: none was found


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
    """Drift against its description, as a variance: from three cells in a row.

    None if it is open, infinite if none explains them, NaN if a curved surface does.

    w_middle - t w_left - (1 - t) w_right has the variance of the cells' own errors and what the
    drift adds. Its median among those within three standard deviations is that of chi^2: what lies
    across an edge is left out, not taken for drift. A curved surface shows in it as well, but bends
    alike all over a part of the image, as a random walk does not: where most of it is alike, and
    bends more than distortion does, it tells of no drift. grid holds whole cells only, -1
    elsewhere; one of `every` rows and columns counts; focal: pixels.
    """
    some = grid if every == 1 else np.ascontiguousarray(grid[::every, ::every])
    fewest = _FEWEST_TRIPLES if lag == _LAG else FEWEST
    with workspace.stage():
        rows = workspace.empty((3, 2 * some.size), np.float32)
        squares = workspace.empty(kernels.most_squares(some.shape), np.int64)
        of_cells = some, planes, inflation, drift, lag // every
        n, found = kernels.cells_in_a_row(*of_cells, *rows, squares)
        off, own, slow = rows[:, :n]
        if n < fewest or not slow.max():
            return None
        factor = _bisect(off * off, own, slow, 0.5 / _WITHIN, _WIDEST)
        if not factor or factor == math.inf:
            return factor
        r = lag * _CELL
        bend = 2 * math.sqrt(factor * float(drift.mean()) * _of_three(r)) / (r * UNIT / focal) ** 2
        if lag <= _NEAR and bend > _CURVED * planes[2, : len(drift)].mean():
            alike, excess = kernels.bent_alike(off, own, slow, squares[:found], factor, _WIDEST)
            if 0.0 < _ALIKE * excess < alike:
                return math.nan
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
    farthest = (FARTHEST * w) ** 2
    nearby = _of_three(_LAG * _CELL)
    relief = max(farthest, _UNTOLD * reading / nearby)
    if nearest * usual * nearby > (_FARTHEST_CELLS * w) ** 2:
        return Walk(0.0, 0.0)  # no camera errs by so much
    every = 2 if grid.size > _MANY else 1  # far ones overlap: every other row and column will do
    for lag in _LAGS:
        factor = drift_factor(grid, planes, inflation, drift, focal, workspace, lag, every)
        if factor is None:
            break
        if math.isnan(factor):
            return Walk(0.0, 0.0)  # what bends is no drift
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
    if 2 * n < FEWEST or not tilted.max():
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
