"""An image of inverse depth and its cells: what the spatial search works on instead of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import cells as kernels
from planewise.kernels import segments as loops
from planewise.noise import Noise
from planewise.observation import RayObservation

Array = NDArray[np.float64]

SIDE = 3  # pixels of the finest cell; 2 x 2 of them are one where one plane explains them
_SPLIT = 40.0  # F of nine further parameters above which a cell is divided
_HOPELESS = 25.0  # chi^2 per degree of freedom above which a cell has no plane
_FILLED = 0.5  # least share of a cell's pixels that are readings
_TILT = 10.0  # slope per offset of the shared error: its correlation length is 10 pixels
LATERAL = 0.5  # pixels; error across the image, which shows where a surface is steep
_OFFSET_PRIOR = 0.05  # a local plane lies within this share of its depth ...
_SLOPE_PRIOR = 1.0  # ... and is inclined by about this much
_GRID = 1e-4  # metres; distinct readings are told apart on this grid
_WINDOW = 9  # gaps between readings over which the step is a median
_MEDIAN_CHI2_3 = 2.366  # of three degrees of freedom: neighbouring cells of one plane


@dataclass(frozen=True)
class Frame:
    """Images (H, W) of an observation; where there is no reading `p` is zero.

    Attributes
    ----------
    w, p : ndarray
        Inverse depth in 1 / m, and one over the variance of its white part.
    x, y : ndarray
        Undistorted pixel coordinates about the principal point, divided by 100.
    slow : ndarray
        Variance of w by what readings share: short part, drift over 100 pixels and quantisation.
    step : ndarray
        Quantisation step in metres.
    """

    w: Array
    p: Array
    x: Array
    y: Array
    slow: Array
    step: Array
    shared: Noise
    drift: Noise


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
    scale : float
        Short-range error of this frame, as a variance, against the sensor's description.
    """

    grid: NDArray[np.int32]
    rows: Array
    drift: Array
    offset_prior: Array
    slope_prior: Array
    scale: float


def reading_steps(z: Array) -> Array:
    """Quantisation step at every reading: gaps between the distinct readings of the frame.

    Parameters
    ----------
    z : ndarray, shape (k,)
        Metres.

    Returns
    -------
    ndarray, shape (k,)
        Running median of the gaps, so that a level that no pixel hit does not count. Metres.

    Examples
    --------
    >>> reading_steps(np.repeat(1.0 + 0.003 * np.arange(20), 2))[[0, -1]]
    array([0.003, 0.003])
    """
    place = np.rint(z / _GRID).astype(np.int64)
    levels = np.flatnonzero(np.bincount(place))
    if levels.size < _WINDOW:
        return np.zeros(z.shape)
    gaps = np.pad(np.diff(levels) * _GRID, _WINDOW // 2, mode="edge")
    steps = np.median(np.lib.stride_tricks.sliding_window_view(gaps, _WINDOW), axis=1)
    table = np.zeros(int(levels[-1]) + 1)
    table[levels] = np.append(steps, steps[-1])
    return table[place]


def frame_of(observation: RayObservation) -> Frame:
    """Spread readings over images, in inverse depth."""
    z, parts = observation.depth, observation.parts
    nothing = lambda depth: np.zeros(np.shape(depth))  # noqa: E731
    shared, drift = (nothing, nothing) if parts is None else (parts.shared, parts.drift)
    step = reading_steps(z)
    white = observation.sigma if parts is None else np.asarray(parts.white(z))
    w, quarter = 1.0 / z, 1.0 / z**4
    variance = (white**2 + step**2 / 12) * quarter
    slow = (np.asarray(shared(z)) ** 2 + np.asarray(drift(z)) ** 2 + step**2 / 12) * quarter
    du, dv = observation.pixel_size
    u, v = observation.rays[0] / (du * kernels.UNIT), observation.rays[1] / (dv * kernels.UNIT)

    def image(values: Array) -> Array:
        out = np.zeros(observation.shape)
        out.reshape(-1)[observation.index] = values
        return out

    return Frame(
        w=image(w),
        p=image(1.0 / variance),
        x=image(u),
        y=image(v),
        slow=image(slow),
        step=image(step),
        shared=shared,
        drift=drift,
    )


def cells_of(frame: Frame, pixel_size: tuple[float, float]) -> Cells | None:
    """Cells that have a plane, their random effects integrated out; ``None`` if no cell has one."""
    height, width = frame.w.shape
    rows, columns = -(-height // SIDE), -(-width // SIDE)
    moments = np.empty((rows * columns, kernels.MOMENTS))
    kernels.cell_moments(frame.w, frame.p, frame.x, frame.y, SIDE, moments)

    misfits = np.empty(len(moments))
    kernels.own_misfits(moments, misfits)
    full = moments[:, kernels.COUNT] == SIDE * SIDE
    white = np.median(misfits[full]) / (SIDE * SIDE - 3) / 0.95 if full.any() else 1.0

    unit = np.empty(rows * columns, np.int32)
    units = np.empty((rows * columns, kernels.MOMENTS))
    size = np.empty(rows * columns)
    found = kernels.merge_quarters(
        moments, rows, columns, SIDE, max(white, 1.0), _SPLIT, _HOPELESS, _FILLED, unit, units, size
    )
    if not found:
        return None
    units, size = units[:found], size[:found]
    w = units[:, 6] / units[:, 0]
    z = 1.0 / w
    shared = np.asarray(frame.shared(z)) ** 2 * w**4
    drift = np.asarray(frame.drift(z)) ** 2 * w**4
    step = _cell_steps(frame, z) ** 2 / 12 * w**4
    segments = np.zeros((found, kernels.SEGMENT))
    half = size * SIDE / 2 / kernels.UNIT
    kernels.marginalise(units, shared, step, _TILT, half, LATERAL / kernels.UNIT, segments)

    scale = _short_scale(unit, (rows, columns), segments, size, drift)
    segments[:, :10] /= scale
    slope = kernels.UNIT * np.sqrt(pixel_size[0] * pixel_size[1]) * _SLOPE_PRIOR
    return Cells(
        grid=unit.reshape(rows, columns),
        rows=segments,
        drift=drift,
        offset_prior=(_OFFSET_PRIOR * w) ** 2,
        slope_prior=(w * slope) ** 2,
        scale=scale,
    )


def _cell_steps(frame: Frame, z: Array) -> Array:
    """Step at the depth of each cell: that of the nearest reading."""
    there = frame.p > 0
    depth, step = 1.0 / frame.w[there], frame.step[there]
    place = np.rint(depth / 0.01).astype(np.int64)
    count = np.bincount(place)
    table = np.bincount(place, step) / np.maximum(count, 1)
    known = np.flatnonzero(count)
    return np.interp(z, known * 0.01, table[known])


def _short_scale(
    unit: NDArray[np.int32],
    shape: tuple[int, int],
    segments: Array,
    size: Array,
    drift: Array,
) -> float:
    """Factor on the short-range variance at which neighbouring cells disagree as they should.

    The discord of two cells of one plane is chi^2 of three degrees of freedom; most neighbours in
    most frames are on one plane, so their median tells. Found by bisection, the drift kept.
    """
    discords = np.empty(2 * unit.size)
    low, high = 0.05, 8.0
    scale = 1.0
    for _ in range(6):
        scale = float(np.sqrt(low * high))
        found = loops.neighbour_discords(unit, *shape, segments, size, drift, scale, discords)
        if not found:
            return 1.0
        if np.median(discords[:found]) > _MEDIAN_CHI2_3:
            low = scale
        else:
            high = scale
    return scale
