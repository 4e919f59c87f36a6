"""Cells of a frame: what the spatial search works on instead of pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planewise.density import LEAST_READINGS, usual_size
from planewise.kernels import cells as kernels
from planewise.kernels import frame_error, medians
from planewise.kernels.cells import COUNT, SIDE, STRIP
from planewise.kernels.walk import SATURATION
from planewise.runtime import threads
from planewise.runtime.workspace import Workspace
from planewise.sectors import Sectors
from planewise.spatial.frame import Frame
from planewise.spatial.frame_error import (
    FrameError,
    drift_and_distortion,
    drifting_by_chance,
    lateral_variance,
    priced,
    rounding,
    white_of_quiet,
    white_of_rough,
    white_seen,
)
from planewise.spatial.neighbouring import Walk, drift_factor, shared_factors, walk_of

Array = NDArray[np.float64]

_SPLIT = 40.0  # F of nine further parameters above which a cell is divided
_HOPELESS = 25.0, 60.0  # chi^2 per degree of freedom of a cell without a plane (`_hopeless`)
_FILLED = 0.5  # least readings of a cell against what is usual in the frame
_FEWEST = 100  # whole cells that can tell white noise
_OFFSET_PRIOR = 0.05  # a local plane lies within this share of its depth
_FEWER = 3  # times as many cells as units, as a rule
_LEAST_DRIFT = 0.1  # of the white variance
_STEADIER = 0.1  # of the drift of an error that is smooth over a few pixels: what else it may be
_COARSE = 0.05  # of the units, at least, err more by steps that readings do not show than by else


@dataclass(frozen=True)
class Cells:
    """Cells of a frame that have a plane of their own.

    Attributes
    ----------
    grid : ndarray of int32, shape (rows, columns)
        Unit of every cell of `SIDE` pixels, -1 where there is no plane.
    count : ndarray of uint8, shape (rows, columns)
        Readings of every cell.
    tiles : ndarray, shape (rows / 3, 12, columns / 3)
        Moments of every 3 x 3 cells (`Moments`).
    rows : ndarray, shape (units, 13)
        Segment row of every unit (`kernels.cells`).
    whole : ndarray of bool, shape (units,)
        Which are of 2 x 2 cells.
    squares : ndarray of int32
        Unit of every 2 x 2 cells, -1 where they are not one.
    drift, told_drift : ndarray, shape (units,)
        Variance of w by which the error drifts over 100 pixels: as much as a plane is allowed to,
        and as much as the readings tell.
    offset_prior, slope_prior : ndarray, shape (units,)
        Variances of a local plane about which nothing is known.
    error : FrameError
        Size of the frame's error against the sensor's description.
    thinned : bool
        Whether readings are missing all over.
    other : Cells, optional
        The same by another error, where either may be: with hardly any drift, where it is smooth
        over a few pixels; or with steps in common, where many cells are on one of quantisation.
    """

    grid: NDArray[np.int32]
    count: NDArray[np.uint8]
    tiles: Array
    rows: Array
    whole: NDArray[np.bool_]
    squares: NDArray[np.int32]
    drift: Array
    told_drift: Array
    offset_prior: Array
    slope_prior: Array
    error: FrameError
    thinned: bool = False
    other: Cells | None = None

    @property
    def by_error(self) -> tuple[Cells, ...]:
        """These, and `other` if its error is another, of which ledgers know no more."""
        other = self.other
        return (self,) if other is None or other.error == self.error else (self, other)

    @property
    def bends_more_than_told(self) -> bool:
        """Whether planes are allowed to bend more than the readings tell."""
        return bool((self.told_drift < self.drift).any())

    def cropped(
        self, top: int, left: int, bottom: int, right: int
    ) -> tuple[Cells, NDArray[np.intp], tuple[int, int, int, int]]:
        """Cells of these rows and columns, the last ones included, and of what is beside them.

        Returns
        -------
        Cells
        ndarray of int, shape (units,)
            Which units these are.
        (int, int, int, int)
            First row and column, and the ones behind the last.
        """
        # Units of 2 x 2 cells begin at even rows and columns.
        top, left = max(0, top - 1) // 2 * 2, max(0, left - 1) // 2 * 2
        bottom, right = (bottom + 3) // 2 * 2, (right + 3) // 2 * 2
        grid = self.grid[top:bottom, left:right]
        units = np.unique(grid[grid >= 0]).astype(np.intp)
        place = np.full(len(self.rows) + 1, -1, np.int32)
        place[units] = np.arange(len(units))
        part = replace(
            self,
            grid=place[grid],
            rows=self.rows[units],
            whole=self.whole[units],
            squares=place[self.squares[top // 2 : bottom // 2, left // 2 : right // 2]],
            drift=self.drift[units],
            told_drift=self.told_drift[units],
            offset_prior=self.offset_prior[units],
            slope_prior=self.slope_prior[units],
            other=None,
        )
        return part, units, (top, left, bottom, right)


class _Integrated(NamedTuple):
    """What `Cells` has of units once what neighbours share is integrated out."""

    rows: Array
    drift: Array
    told_drift: Array
    error: FrameError


class Moments(NamedTuple):
    """Of the readings of a frame (`kernels.cells`), with the precision that the sensor says.

    Attributes
    ----------
    readings, misfits : ndarray of uint8 and of float64, shape (rows, columns)
        How many there are in every cell, and chi^2 of its plane.
    blocks, together : ndarray, shapes (rows / 2, 11, columns / 2) and (rows / 2, columns / 2)
        Moments of 2 x 2 cells and chi^2 of their plane.
    tiles : ndarray, shape (rows / 3, 12, columns / 3)
        Moments of 3 x 3 cells. All shapes are rounded up.
    """

    readings: NDArray[np.uint8]
    misfits: Array
    blocks: Array
    together: Array
    tiles: Array


def moments_of(frame: Frame, workspace: Workspace) -> Moments:
    """Moments of the readings of a frame."""
    rows, columns = (-(-n // SIDE) for n in frame.w.shape)
    halved, third = (-(-rows // 2), -(-columns // 2)), (-(-rows // 3), -(-columns // 3))
    out = Moments(
        readings=workspace.kept((rows, columns), np.uint8),
        misfits=workspace.empty((rows, columns)),
        blocks=workspace.empty((halved[0], kernels.MOMENTS, halved[1])),
        together=workspace.empty(halved),
        tiles=workspace.kept((third[0], kernels.MOMENTS + 1, third[1])),
    )
    images, strips = (frame.w, frame.p, frame.x, frame.y), -(-rows // STRIP)
    # Of a straight image, those whose cells have all rows.
    whole = (strips if frame.w.shape[0] % SIDE == 0 else strips - 1) if frame.straight else 0

    def add_up(first: int, last: int) -> None:
        middle = min(max(first, whole), last)
        if first < middle:
            kernels.straight_moments(*images, first, middle, *out)
        if middle < last:
            kernels.cell_moments(*images, frame.straight, middle, last, *out)

    threads.halves(add_up, strips)
    return out


def cells_of(
    frame: Frame, pixel_size: tuple[float, float], workspace: Workspace | None = None
) -> Cells | None:
    """Cells that have a plane, their random effects integrated out; ``None`` if no cell has one."""
    workspace = workspace or Workspace()
    moments = moments_of(frame, workspace)
    count, misfits, blocks, together, tiles = moments
    shape = misfits.shape
    # A quarter of the cells stands for the frame.
    sample = workspace.empty(blocks.shape[0] * blocks.shape[2])
    sizes = np.empty(4 * SIDE * SIDE + 1, np.int64)
    full = kernels.whole_misfits(count, misfits, blocks, sample, sizes)
    usual = usual_size(sizes)
    lone: Array = sample[:full]
    freedom: Array | int = SIDE * SIDE - 3
    if full < _FEWEST:  # as where readings are missing here and there: then blocks do
        some = blocks[:, COUNT] >= max(usual, LEAST_READINGS)
        if np.count_nonzero(some) > full:
            lone, freedom = together[some], blocks[:, COUNT][some] - 3
    seen = white_seen(lone, freedom, frame.w, frame.p)
    # In range images, whose cells are wide far off, one of five may well lie across an edge.
    rough = white_of_rough(seen, lone, freedom) if frame.sectors.count == 1 else seen
    white = max(rough, 1.0)  # no frame is trusted to err less than a sensor that was measured
    if rough < 1.0 and not frame.measured:
        white = white_of_quiet(blocks, together, misfits, frame.table, frame.resolution)

    filled = max(_FILLED * usual, LEAST_READINGS) / (4 * SIDE * SIDE)
    most = shape[0] * shape[1]
    grid, squares = workspace.kept(shape, np.int32), workspace.kept(together.shape, np.int32)

    def units_of(
        white: float, described: float
    ) -> tuple[NDArray[np.bool_], Array, list[_Integrated]]:
        """Which units are whole, their inverse depth, and their error integrated out.

        white: size of the white part; described: that of how all others are described.
        """
        found, room = -1, most // _FEWER + 4
        while found < 0:
            # Most cells are one of four: seldom is there need for more room.
            planes = workspace.empty((kernels.PLANE, room))
            readings, size = workspace.empty((2, room))
            found = kernels.merge_quarters(
                frame.w,
                frame.p,
                *frame.sectors.coordinates,
                *moments[:4],
                white,
                _SPLIT,
                _hopeless(frame.sectors),
                filled,
                grid,
                squares,
                planes,
                readings,
                size,
            )
            room += most
        readings, size = readings[:found], size[:found]
        whole, sizes = size == 2, (white, seen, described)
        if not found:
            return whole, size, []
        units = _without_shared_error(
            frame, squares, planes, readings, size, whole, sizes, workspace
        )
        return whole, planes[2, :found], units

    quiet = min(white, 1.0)  # then all parts are described as too large
    whole, w, units = units_of(white, quiet)
    if len(units) > 1 and not frame.measured:
        # What a data sheet states is shared by near readings: what cells show is new in each.
        least = rounding(frame.table, float(np.median(w)), frame.resolution)
        whole, w, units = units_of(min(white, max(rough, least)), quiet)
    if not units:
        return None
    priors = workspace.kept((2, len(w)))
    slope = kernels.UNIT * math.sqrt(pixel_size[0] * pixel_size[1])  # and is inclined by about 1
    np.square(_OFFSET_PRIOR * w, out=priors[0])
    np.square(w * slope, out=priors[1])
    cells = Cells(
        grid=grid,
        count=count,
        tiles=tiles,
        whole=whole,
        squares=squares,
        offset_prior=priors[0],
        slope_prior=priors[1],
        thinned=usual < 4 * SIDE * SIDE,
        **units[0]._asdict(),
    )
    if len(units) == 1:
        return cells
    return replace(cells, other=replace(cells, **units[1]._asdict()))


def _hopeless(sectors: Sectors) -> float:
    """chi^2 per degree of freedom above which a cell has no plane, for it lies across an edge.

    So do more of them in coarse images and in range images, whose cells are wide far off.
    """
    low, high = _HOPELESS
    return low + (sectors.fineness if sectors.count == 1 else 0.0) * (high - low)


def _without_shared_error(
    frame: Frame,
    squares: NDArray[np.int32],
    planes: Array,
    count: Array,
    size: Array,
    whole: NDArray[np.bool_],
    sizes: tuple[float, float, float],
    workspace: Workspace,
) -> list[_Integrated]:
    """Units with what neighbours share integrated out: as the frame shows; and as it may be, too.

    sizes: `FrameError.white` and `seen`, and that of how all other parts are described. These are
    those at the mean depth of each unit. There is a second where the error is smooth over a few
    pixels, for that looks like a walk: if little drifts. Or where readings of many units are all
    on one step of quantisation, and most surfaces so steep that neighbours show nothing of it: if
    what readings do not show of it they share.
    """
    (white, seen, quiet), table = sizes, frame.table
    depths = planes[2, : len(count)]
    with workspace.stage():
        errors = workspace.empty((6, len(count)))
        lateral, steep = lateral_variance(planes, count, whole, workspace)
        lateral *= max(seen, 1.0) / max(white, 1.0)  # of the error of most cells
        frame_error.unit_errors(
            planes,
            count,
            size,
            table.white,
            table.shared,
            table.drift,
            table.step,
            table.ranging,
            white,
            lateral,
            steep,
            errors,
        )
        if quiet < 1.0:
            errors[:3] *= quiet
        _, _, described, _, inflation, alike = errors
        # Cells of 2 x 2 stand for the frame, but for those that may lie across an edge.
        rough = inflation > _HOPELESS[0]
        calm = np.where(rough.take(squares), np.int32(-1), squares)
        w = float(medians.smallest(depths, len(count) // 2, workspace.empty(len(count))))
        focal = frame.sectors.mean_focal
        measured = drift_factor(calm, planes, inflation, described, focal, workspace)
        local = 1.0 if measured is None or measured == math.inf else measured
        of_one, _, _, step = table.at(w)
        reading = of_one + step
        if math.isnan(local):  # what bends is no drift
            local = measured = 0.0
            walk = Walk(0.0, 0.0)
        elif frame.known:
            local = min(local, 1.0)
            walk = Walk(local, local)
        else:
            walk = walk_of(calm, planes, inflation, described, local, reading, focal, workspace)
        chance = drifting_by_chance(int(np.count_nonzero(whole)), measured, known=frame.known)

        def integrated(walk: Walk, steps: Array | None = None) -> _Integrated:
            """Integrate out a walk, what cells have of their own, and a variance by steps."""
            factor, own, least = walk.drift, walk.shared, walk.least
            between = quiet * SATURATION * factor
            drifting, distorted, turning = drift_and_distortion(
                white, between, w, table, frame.sectors
            )
            drift, told = workspace.kept((2, len(count)))
            frame_error.wandering(planes, errors, factor, frame.resolution, table.ranging, drift)
            if drifting > chance:
                np.multiply(drift, SATURATION, out=told)
            else:
                least = 0.0
                frame_error.wandering(planes, errors, 0.0, frame.resolution, table.ranging, told)
                told *= SATURATION
            # No plane is free of mixed pixels at its edges.
            np.maximum(drift, _LEAST_DRIFT * count / planes[6, : len(count)], out=drift)
            offset, tilt = errors[:2]
            common = own * float(described.mean())
            if own:
                own *= described.sum() / offset.sum()
            near, bent = shared_factors(calm, planes, inflation, drift, offset, tilt, workspace)
            near = max(near, own)
            rows = workspace.kept((len(count), kernels.SEGMENT))
            with workspace.stage():
                larger = workspace.empty((2, len(count)))
                np.multiply(offset, near, out=larger[0])
                np.multiply(tilt, bent, out=larger[1])
                if steps is not None:
                    larger[0] += steps
                    larger[1] += steps / np.square(0.5 * SIDE / kernels.UNIT * size)
                kernels.marginalise(planes, count, inflation, *larger, rows)
            drift *= SATURATION
            return _Integrated(
                rows,
                drift,
                told,
                FrameError(
                    white=white,
                    seen=seen,
                    lateral=lateral,
                    drift=between,
                    local=quiet * SATURATION * max(local, factor),
                    near=quiet * near,
                    bent=quiet * bent,
                    drifting=drifting,
                    priced=priced(drifting, common, seen * reading),
                    distorted=distorted,
                    turning=turning,
                    walk=quiet * least,
                ),
            )

        found = [integrated(walk)]
        error = found[0].error
        if error.smooth and walk.soon and frame.sectors.count == 1:
            other = integrated(walk.less(_STEADIER))
            # Planes cost as much by either, and residuals of near cells are alike by both.
            same = replace(other.error, priced=error.priced)
            found.append(other._replace(told_drift=other.drift, error=same))
        elif not error.walk and error.near < 1.0:
            steps = (1.0 - error.near) * alike
            if np.count_nonzero(steps * planes[6, : len(count)] > 1.0) > _COARSE * len(count):
                found.append(integrated(walk, steps))
    return found
