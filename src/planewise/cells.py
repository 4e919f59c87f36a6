"""Cells of a frame: what the spatial search works on instead of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.frame import Frame
from planewise.frame_error import (
    FrameError,
    drift_factor,
    lateral_variance,
    shared_factors,
    white_factor,
)
from planewise.kernels import cells as kernels
from planewise.kernels.cells import SIDE
from planewise.workspace import Workspace

Array = NDArray[np.float64]

_SPLIT = 40.0  # F of nine further parameters above which a cell is divided
_HOPELESS = 25.0  # chi^2 per degree of freedom above which a cell has no plane
_FILLED = 0.5  # least share of a cell's pixels that are readings
TILT = 10.0  # slope per offset of the shared error: its correlation length is 10 pixels
_OFFSET_PRIOR = 0.05  # a local plane lies within this share of its depth ...
_SLOPE_PRIOR = 1.0  # ... and is inclined by about this much
_FEWER = 3  # times as many cells as units, as a rule
_LEAST_DRIFT = 0.1  # of the white variance
_SATURATION = 0.33  # of the drift of near cells: its share between segments, for it levels off


@dataclass(frozen=True)
class Cells:
    """Cells of a frame that have a plane of their own.

    Attributes
    ----------
    grid : ndarray of int32, shape (rows, columns)
        Unit of every cell of `SIDE` pixels, -1 where there is no plane.
    moments : ndarray, shape (rows, 12, columns)
        Of the readings of every cell (`kernels.cells`), with the precision that the sensor says.
    rows : ndarray, shape (units, 13)
        Segment row of every unit (`kernels.cells`).
    whole : ndarray of bool, shape (units,)
        Which are of 2 x 2 cells.
    squares : ndarray of int32
        Unit of every 2 x 2 cells, -1 where they are not one.
    drift : ndarray, shape (units,)
        Variance of w by which the error drifts over 100 pixels.
    offset_prior, slope_prior : ndarray, shape (units,)
        Variances of a local plane about which nothing is known.
    error : FrameError
        Size of the frame's error against the sensor's description.
    """

    grid: NDArray[np.int32]
    moments: Array
    rows: Array
    whole: NDArray[np.bool_]
    squares: NDArray[np.int32]
    drift: Array
    offset_prior: Array
    slope_prior: Array
    error: FrameError


def moments_of(frame: Frame, workspace: Workspace) -> tuple[Array, Array, Array, Array]:
    """Moments of cells and chi^2 of their planes, and the same of blocks of 2 x 2 cells.

    Shapes (rows, 12, columns), (rows, columns), (rows / 2, 11, columns / 2) and (rows / 2, columns
    / 2), rounded up.
    """
    rows, columns = (-(-n // SIDE) for n in frame.w.shape)
    halved = -(-rows // 2), -(-columns // 2)
    moments = workspace.empty("moments of cells", (rows, kernels.MOMENTS + 1, columns))
    misfits = workspace.empty("misfits of cells", (rows, columns))
    blocks = workspace.empty("moments of blocks", (halved[0], kernels.MOMENTS, halved[1]))
    together = workspace.empty("misfits of blocks", halved)
    out = moments, misfits, blocks, together
    kernels.cell_moments(frame.w, frame.p, frame.x, frame.y, *out)
    return out


def cells_of(
    frame: Frame, pixel_size: tuple[float, float], workspace: Workspace | None = None
) -> Cells | None:
    """Cells that have a plane, their random effects integrated out; ``None`` if no cell has one."""
    workspace = workspace or Workspace()
    moments, misfits, blocks, together = moments_of(frame, workspace)
    shape = misfits.shape
    # A quarter of the cells stands for the frame.
    full = moments[::2, kernels.COUNT, ::2] == SIDE * SIDE
    white = white_factor(misfits[::2, ::2][full], SIDE * SIDE - 3)

    most = shape[0] * shape[1]
    grid = workspace.empty("units of cells", shape, np.int32)
    found, room = -1, most // _FEWER + 4
    while found < 0:
        # Most cells are one of four: seldom is there need for more room.
        units = workspace.empty("units", (room, kernels.MOMENTS))
        size = workspace.empty("sizes of units", room)
        found = kernels.merge_quarters(
            moments,
            misfits,
            blocks,
            together,
            white,
            _SPLIT,
            _HOPELESS,
            _FILLED,
            grid,
            units,
            size,
        )
        room += most
    if not found:
        return None
    units, size = units[:found], size[:found]
    planes = workspace.empty("planes of units", (kernels.PLANE, found))
    kernels.unit_planes(units, planes)
    segments = workspace.empty("rows of units", (found, kernels.SEGMENT))
    drift, squares, error = _without_shared_error(
        frame, grid, units, size, planes, white, segments, workspace
    )
    w = planes[2]
    slope = kernels.UNIT * np.sqrt(pixel_size[0] * pixel_size[1]) * _SLOPE_PRIOR
    return Cells(
        grid=grid,
        moments=moments,
        rows=segments,
        whole=size == 2,
        squares=squares,
        drift=drift,
        offset_prior=(_OFFSET_PRIOR * w) ** 2,
        slope_prior=(w * slope) ** 2,
        error=error,
    )


def _without_shared_error(
    frame: Frame,
    grid: NDArray[np.int32],
    units: Array,
    size: Array,
    planes: Array,
    white: float,
    segments: Array,
    workspace: Workspace,
) -> tuple[Array, NDArray[np.int32], FrameError]:
    """Write the units' rows with what neighbours share integrated out.

    Returns their drift, which of them are whole squares and where, and the size of the error.
    Parts of the error are those at the mean depth of each unit.
    """
    w, count = planes[2], units[:, kernels.COUNT]
    new, shared, drift, step = frame.table.at(w)
    coarse = _shared_step(step, white * (new + step) - step)
    half = size * SIDE / 2 / kernels.UNIT
    lateral, steep = lateral_variance(units, planes, size == 2)
    offset, tilt = steep * (shared + coarse), steep * (TILT**2 * shared + coarse / half**2)
    inflation = np.maximum(1.0, planes[5] / (count - 3.0))

    # Cells of 2 x 2 stand for the frame.
    squares = _squares(grid, size == 2, workspace)
    wandering = steep * drift
    factor = drift_factor(squares, planes, inflation, wandering)
    if frame.known:
        factor = min(factor, 1.0)
    # No plane is known better than readings are resolved, nor free of mixed pixels at its edges.
    wandering = factor * wandering + coarse + w**4 * frame.resolution**2 / 12
    wandering = np.maximum(wandering, _LEAST_DRIFT * count / units[:, 0])
    near, bent = shared_factors(squares, planes, inflation, wandering, offset, tilt)
    kernels.marginalise(planes, count, inflation, near * offset, bent * tilt, segments)
    factor *= _SATURATION
    error = FrameError(white=white, lateral=lateral, drift=factor, near=near, bent=bent)
    return _SATURATION * wandering, squares, error


def _squares(
    grid: NDArray[np.int32], whole: NDArray[np.bool_], workspace: Workspace
) -> NDArray[np.int32]:
    shape = -(-grid.shape[0] // 2), -(-grid.shape[1] // 2)
    squares: NDArray[np.int32] = workspace.empty("squares", shape, np.int32)
    kernels.squares_of(grid, whole, squares)
    return squares


def _shared_step(step: Array, variance: Array) -> Array:
    """Variance by quantisation that near readings share: noise of its size makes it independent.

    White noise of standard deviation s dithers steps of q: the mean error keeps exp(-2 pi^2 s^2 /
    q^2) of its amplitude. step: q^2 / 12.
    """
    with np.errstate(divide="ignore"):
        dither = np.exp(-4 * np.pi**2 * variance / (12 * step))
    return np.asarray(step * np.where(step > 0, dither, 0.0))
