"""An image of inverse depth and its cells: what the spatial search works on instead of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.frame_error import (
    CellPlanes,
    FrameError,
    drift_factor,
    lateral_variance,
    shared_factors,
    white_factor,
)
from planewise.kernels import cells as kernels
from planewise.observation import RayObservation

Array = NDArray[np.float64]

SIDE = 3  # pixels of the finest cell; 2 x 2 of them are one where one plane explains them
_SPLIT = 40.0  # F of nine further parameters above which a cell is divided
_HOPELESS = 25.0  # chi^2 per degree of freedom above which a cell has no plane
_FILLED = 0.5  # least share of a cell's pixels that are readings
TILT = 10.0  # slope per offset of the shared error: its correlation length is 10 pixels
_OFFSET_PRIOR = 0.05  # a local plane lies within this share of its depth ...
_SLOPE_PRIOR = 1.0  # ... and is inclined by about this much
_GRID = 0.1  # of the sensor's resolution; distinct readings are told apart on this grid
_WINDOW = 9  # gaps between readings over which the step is a median
_LEAST_DRIFT = 0.1  # of the white variance
_SATURATION = 0.33  # of the drift of near cells: its share between segments, for it levels off
_UNKNOWN_SHARED, _UNKNOWN_DRIFT = 2 / 3, 7 / 3  # of the noise, as the Kinect's, where not known


@dataclass(frozen=True)
class Frame:
    """Images (H, W) of an observation; where there is no reading `p` is zero.

    Attributes
    ----------
    w, p : ndarray
        Inverse depth in 1 / m, and one over the variance of what is new in every reading.
    x, y : ndarray
        Undistorted pixel coordinates about the principal point, divided by 100.
    shared, drift, step : ndarray
        Variances of w: of what near readings share, of how far that drifts over 100 pixels, and of
        the quantisation.
    known : bool
        Whether shared and drift are what the sensor shows at most; else only their course over
        depth is taken from them, and their size from the frame.
    resolution : float
        Step between two readings in metres.
    """

    w: Array
    p: Array
    x: Array
    y: Array
    shared: Array
    drift: Array
    step: Array
    known: bool
    resolution: float


@dataclass(frozen=True)
class Cells:
    """Cells of a frame that have a plane of their own.

    Attributes
    ----------
    grid : ndarray of int32, shape (rows, columns)
        Unit of every cell of `SIDE` pixels, -1 where there is no plane.
    rows : ndarray, shape (units, 13)
        Segment row of every unit (`kernels.cells`).
    drift : ndarray, shape (units,)
        Variance of w by which the error drifts over 100 pixels.
    offset_prior, slope_prior : ndarray, shape (units,)
        Variances of a local plane about which nothing is known.
    error : FrameError
        Size of the frame's error against the sensor's description.
    """

    grid: NDArray[np.int32]
    rows: Array
    drift: Array
    offset_prior: Array
    slope_prior: Array
    error: FrameError


def reading_steps(z: Array, resolution: float = 0.001) -> Array:
    """Quantisation step at every reading: gaps between the distinct readings of the frame.

    Parameters
    ----------
    z : ndarray, shape (k,)
        Metres.
    resolution : float
        eps of the sensor in metres; no step is smaller than a tenth of it.

    Returns
    -------
    ndarray, shape (k,)
        Running median of the gaps, so that a level that no pixel hit does not count. Metres.

    Examples
    --------
    >>> reading_steps(np.repeat(1.0 + 0.003 * np.arange(20), 2))[[0, -1]]
    array([0.003, 0.003])
    """
    grid = _GRID * resolution
    place = np.rint(z / grid).astype(np.int64)
    levels = np.flatnonzero(np.bincount(place))
    if levels.size < _WINDOW:
        return np.zeros(z.shape)
    gaps = np.pad(np.diff(levels) * grid, _WINDOW // 2, mode="edge")
    steps = np.median(np.lib.stride_tricks.sliding_window_view(gaps, _WINDOW), axis=1)
    table = np.zeros(int(levels[-1]) + 1)
    table[levels] = np.append(steps, steps[-1])
    return table[place]


def frame_of(observation: RayObservation) -> Frame:
    """Spread readings over images, in inverse depth."""
    z, parts = observation.depth, observation.parts
    quarter = 1.0 / (z * z) ** 2
    step = reading_steps(z, observation.resolution) ** 2 / 12 * quarter
    if parts is None:
        white = observation.sigma
        shared, drift = _UNKNOWN_SHARED * white, _UNKNOWN_DRIFT * white
    else:
        white, shared, drift = (np.asarray(f(z)) for f in (parts.white, parts.shared, parts.drift))
    du, dv = observation.pixel_size

    values = np.empty((7, observation.count))
    np.divide(1.0, z, out=values[0])
    np.divide(1.0, white**2 * quarter + step, out=values[1])
    np.multiply(observation.rays[0], 1.0 / (du * kernels.UNIT), out=values[2])
    np.multiply(observation.rays[1], 1.0 / (dv * kernels.UNIT), out=values[3])
    np.multiply(shared**2, quarter, out=values[4])
    np.multiply(drift**2, quarter, out=values[5])
    values[6] = step
    images = np.empty((len(values), *observation.shape))
    kernels.spread(observation.index, values, images.reshape(len(values), -1))
    w, p, x, y, shared, drift, step = images
    return Frame(w, p, x, y, shared, drift, step, parts is not None, observation.resolution)


def cells_of(frame: Frame, pixel_size: tuple[float, float]) -> Cells | None:
    """Cells that have a plane, their random effects integrated out; ``None`` if no cell has one."""
    height, width = frame.w.shape
    rows, columns = -(-height // SIDE), -(-width // SIDE)
    moments = np.empty((rows * columns, kernels.MOMENTS))
    kernels.cell_moments(frame.w, frame.p, frame.x, frame.y, SIDE, moments)
    full = moments[:, kernels.COUNT] == SIDE * SIDE
    misfits = np.empty(len(moments))
    kernels.own_misfits(moments, misfits)
    white = white_factor(misfits[full], SIDE * SIDE - 3)
    moments[:, :10] /= white

    unit = np.empty(rows * columns, np.int32)
    units = np.empty((rows * columns, kernels.MOMENTS))
    size = np.empty(rows * columns)
    found = kernels.merge_quarters(
        moments, rows, columns, SIDE, 1.0, _SPLIT, _HOPELESS, _FILLED, unit, units, size
    )
    if not found:
        return None
    units, size = units[:found], size[:found]
    segments, drift, error = _without_shared_error(frame, unit, (rows, columns), units, size, white)
    w = units[:, 6] / units[:, 0]
    slope = kernels.UNIT * np.sqrt(pixel_size[0] * pixel_size[1]) * _SLOPE_PRIOR
    return Cells(
        grid=unit.reshape(rows, columns),
        rows=segments,
        drift=drift,
        offset_prior=(_OFFSET_PRIOR * w) ** 2,
        slope_prior=(w * slope) ** 2,
        error=error,
    )


def _without_shared_error(
    frame: Frame,
    unit: NDArray[np.int32],
    shape: tuple[int, int],
    units: Array,
    size: Array,
    white: float,
) -> tuple[Array, Array, FrameError]:
    """Rows of the units with what neighbours share integrated out, their drift, and the error."""
    shared, drift, step = (
        _at_units(values, unit, *shape, len(units))
        for values in (frame.shared, frame.drift, _shared_step(frame, white))
    )
    half = size * SIDE / 2 / kernels.UNIT
    lateral, steep = lateral_variance(units, size == 2)
    offset, tilt = steep * (shared + step), steep * (TILT**2 * shared + step / half**2)
    segments = np.zeros((len(units), kernels.SEGMENT))
    kernels.marginalise(units, 0.0 * offset, 0.0 * tilt, segments)
    planes = CellPlanes.of(segments)

    # Cells of 2 x 2 stand for the frame.
    grid = unit.reshape(shape)[: shape[0] // 2 * 2 : 2, : shape[1] // 2 * 2 : 2]
    whole = (grid >= 0) & (size[grid] == 2)
    wandering = steep * drift
    factor = drift_factor(grid, whole, planes, wandering)
    if frame.known:
        factor = min(factor, 1.0)
    # No plane is known better than readings are resolved, nor free of mixed pixels at its edges.
    inverse = units[:, 6] / units[:, 0]
    wandering = factor * wandering + step + inverse**4 * frame.resolution**2 / 12
    wandering = np.maximum(wandering, _LEAST_DRIFT * units[:, kernels.COUNT] / units[:, 0])
    near, bent = shared_factors(grid, whole, planes, wandering, offset, tilt)
    kernels.marginalise(units, near * offset, bent * tilt, segments)
    factor *= _SATURATION
    error = FrameError(white=white, lateral=lateral, drift=factor, near=near, bent=bent)
    return segments, _SATURATION * wandering, error


def _shared_step(frame: Frame, white: float) -> Array:
    """Variance by quantisation that near readings share: noise of its size makes it independent.

    White noise of standard deviation s dithers steps of q: the mean error keeps exp(-2 pi^2 s^2 /
    q^2) of its amplitude.
    """
    dither = np.zeros(frame.step.shape)
    coarse = frame.step > 0
    variance = white / frame.p[coarse] - frame.step[coarse]
    dither[coarse] = np.exp(-4 * np.pi**2 * variance / (12 * frame.step[coarse]))
    return np.asarray(frame.step * dither)


def _at_units(values: Array, unit: NDArray[np.int32], rows: int, columns: int, count: int) -> Array:
    """Value of an image in the middle of every unit."""
    height, width = values.shape
    i = np.minimum(np.arange(rows) * SIDE + SIDE // 2, height - 1)
    j = np.minimum(np.arange(columns) * SIDE + SIDE // 2, width - 1)
    centre = values[i[:, None], j[None]].reshape(-1)
    there = (unit >= 0) & (centre > 0)
    members = np.bincount(unit[there], minlength=count)
    return np.bincount(unit[there], centre[there], count) / np.maximum(members, 1)
