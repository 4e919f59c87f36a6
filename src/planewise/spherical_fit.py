"""The spherical camera of organised points: what angles its rows and columns have."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Array
from planewise.spherical import SphericalCamera

_ROUNDS = 3  # of columns given what rows are off them, and rows given columns
_TELLS = 0.2  # cosine of elevation above which a point tells the azimuth of its column
_STAGGERED = 0.05  # columns: what rows are off them by less is none
_ENOUGH = 2_000_000  # pixels that tell how a sensor is tilted


def fit_axes(points: NDArray[np.floating], there: NDArray[np.bool_]) -> Array:
    """Axes of the sensor that rows of organised points are cones about, shape (3, 3).

    Directions d of a row have the same n . d for the third axis n, that of least scatter within
    rows. The first one is as near to x as may be.

    Parameters
    ----------
    points, there
        As in `fit_spherical`, in any frame with the sensor in its origin.

    Returns
    -------
    ndarray, shape (3, 3)
        Forward, left and up, as rows; up is not below the frame's horizon.
    """
    some = slice(None, None, 1 + there.size // _ENOUGH)
    there = there[:, some]
    directions = np.where(there[..., None], points[:, some], 1.0).astype(np.float64)
    directions /= np.abs(directions).max(axis=2, keepdims=True)  # squares do not overflow
    directions *= there[..., None] / np.linalg.norm(directions, axis=2, keepdims=True)
    count, total = np.maximum(there.sum(axis=1), 1), directions.sum(axis=1)
    flat = directions.reshape(-1, 3)
    scatter = flat.T @ flat - (total / count[:, None]).T @ total
    up = np.linalg.eigh(scatter)[1][:, 0]
    up *= np.copysign(1.0, up[2])
    nearest = np.eye(3)[1 if np.abs(up).argmax() == 0 else 0]
    forward = nearest - (nearest @ up) * up
    forward /= np.linalg.norm(forward)
    return np.stack((forward, np.cross(up, forward), up))


def fit_spherical(
    points: NDArray[np.floating], there: NDArray[np.bool_], axes: Array | None = None
) -> tuple[SphericalCamera, Array]:
    """Camera on whose rays organised points lie, and how far off those of their pixels they are.

    Elevations of rows, azimuths of columns, and what rows are off these, are medians of their
    points; those without points lie evenly between, or beyond, the others.

    Parameters
    ----------
    points : ndarray, shape (H, W, 3)
        Metres, about the sensor: x forward, y left, z up.
    there : ndarray of bool, shape (H, W)
        Which of them are points.
    axes : ndarray, shape (3, 3), optional
        Those of the sensor in the frame of the points (`SphericalCamera.turn`).

    Returns
    -------
    camera : SphericalCamera
    off : ndarray, shape (k,)
        Pixels, along rows or columns, whichever is more, of every point.

    Raises
    ------
    ValueError
        If no such camera has rows or columns of these angles.
    """
    turned = np.where(there[..., None], points, 0.0)
    if axes is not None:
        turned = turned @ axes.T
    x, y, z = np.moveaxis(turned, -1, 0)
    level = np.degrees(np.arctan2(z, np.hypot(x, y)))
    around = np.degrees(np.arctan2(y, x))
    elevation = _filled(_medians(level, there))
    tells = there & (np.cos(np.radians(level)) > _TELLS)
    offset = np.zeros(len(points))
    for _ in range(_ROUNDS):
        azimuth = _directions((around - offset[:, None]).T, tells.T)
        azimuth = _filled(_unwrapped(azimuth))
        off = _wrapped(around - azimuth)
        offset = np.nan_to_num(_medians(off, tells))
        offset -= np.median(offset)
    azimuth -= 360.0 * np.round(azimuth.mean() / 360.0)
    step = np.abs(np.diff(azimuth)).mean()
    staggered = np.abs(offset).max() > _STAGGERED * step
    camera = SphericalCamera(
        elevation=_within(elevation).tolist(),
        azimuth=azimuth.tolist(),
        azimuth_offset=offset.tolist() if staggered else (),
        turn=() if axes is None else axes.tolist(),
    )
    across, down = np.degrees(camera.pixel_size)
    beside = _wrapped(around - azimuth - offset[:, None]) * np.cos(np.radians(level)) / across
    above = (level - elevation[:, None]) / down
    return camera, np.maximum(np.abs(beside), np.abs(above))[there]


def _medians(values: Array, there: NDArray[np.bool_]) -> Array:
    """Median of every row of values that are there, NaN of a row without any."""
    out = np.full(len(values), np.nan)
    some = there.any(axis=1)
    out[some] = np.nanmedian(np.where(there[some], values[some], np.nan), axis=1)
    return out


def _directions(angles: Array, there: NDArray[np.bool_]) -> Array:
    """The same of directions, in degrees: medians about their mean."""
    radians = np.radians(angles)
    up, ahead = (np.sum(each * there, axis=1) for each in (np.sin(radians), np.cos(radians)))
    mean = np.degrees(np.arctan2(up, ahead))
    return np.asarray(mean + _medians(_wrapped(angles - mean[:, None]), there))


def _unwrapped(azimuth: Array) -> Array:
    """Azimuths without jumps of 360, however many columns lie between those that are there."""
    at = np.flatnonzero(np.isfinite(azimuth))
    out = azimuth.copy()
    if len(at) > 1:
        turns = _wrapped(np.diff(azimuth[at]))
        usual = np.median(turns / np.diff(at)) * np.diff(at)
        steps = usual + _wrapped(turns - usual)
        out[at[1:]] = azimuth[at[0]] + np.cumsum(steps)
    return out


def _wrapped(angles: Array) -> Array:
    """The same between -180 and 180."""
    return np.asarray((angles + 180.0) % 360.0 - 180.0)


def _filled(angles: Array) -> Array:
    """Angles of all rows, even between those that are known and, by their usual step, beyond."""
    at = np.flatnonzero(np.isfinite(angles))
    if len(at) < 2:
        raise ValueError("points lie in one row or column")
    known = angles[at]
    step = np.median(np.diff(known) / np.diff(at))
    place = np.arange(len(angles))
    out = np.interp(place, at, known)
    out += step * (np.minimum(place - at[0], 0) + np.maximum(place - at[-1], 0))
    return np.asarray(out)


def _within(elevation: Array) -> Array:
    """Elevations, of which rows without points at the ends may lie beyond the poles, in between."""
    beyond = np.abs(elevation) > 90.0
    if not beyond.any():
        return elevation
    inside = np.flatnonzero(~beyond)
    first, last = inside[0], inside[-1]
    out = elevation.copy()
    for known, rows in ((first, np.arange(first)[::-1]), (last, np.arange(last + 1, len(out)))):
        share = np.arange(1, len(rows) + 1) / (len(rows) + 1)
        out[rows] = out[known] + share * (np.sign(out[known]) * 90.0 - out[known])
    return out
