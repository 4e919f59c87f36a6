"""Organised points: those of a depth image or a scan, in the order of its pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import checked_points, unmasked
from planewise.camera import Array, PinholeCamera
from planewise.spherical import SphericalCamera
from planewise.spherical_fit import fit_axes, fit_spherical

_FEWEST = 12  # points that tell a camera
_OFF = 0.5  # pixels from the ray of its pixel; of points rounded to 1 mm, at 1 m, about 0.3
_MOST_OFF = 0.01  # share of the points that may be farther off
_SLIGHTLY = 0.02  # pixels on the mean: not for a tilt
_CLEARLY = 0.5  # times as far off with axes of its own: a LiDAR is tilted
_OTHERS = (
    "; expected the frame of the camera that took them, x right, y down, z forward, without "
    "distortion, or one with a LiDAR in its origin. Other points are searched as such: "
    "detect_planes_in_points, 'planewise points'"
)


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class PointImage:
    """The depth image that organised points were made of.

    Attributes
    ----------
    depth : ndarray of float32 or float64, shape (H, W)
        z of the points, their distance with a `SphericalCamera`, metres; 0 where there is none.
    camera : PinholeCamera or SphericalCamera
        The points lie on its rays.
    """

    depth: NDArray[np.float32] | Array
    camera: PinholeCamera | SphericalCamera


def image_of_points(points: ArrayLike) -> PointImage:
    """Depth image and camera of organised points, as of depth cameras, LiDARs and laser scanners.

    A depth camera is that of least squares, x / z = (column - cx) / fx and y / z = (row - cy) / fy
    over all points. Of a LiDAR every row has an elevation, every column an azimuth, about z or, if
    it is tilted in the frame of the points, about an axis of its own (`SphericalCamera.turn`).
    Planes of the image are told better than those of the points, for it knows which are neighbours,
    and how far its error goes along the rays.

    Parameters
    ----------
    points : array_like, shape (H, W, 3)
        In the order of the pixels and the frame of the sensor that took them, its origin at the
        sensor: x right, y down, z forward of a camera; any of a LiDAR, of which each row is a beam,
        and rows are in step (destaggered). Metres: millimetres are not noticed, their depth lies
        beyond any sensor's range. NaN, infinity, 0, 0, 0 and what is masked is no point.

    Returns
    -------
    PointImage
        ``depth`` and ``camera``, as `detect_planes` takes them.

    Raises
    ------
    ValueError
        If the shape is another one, there are too few points or all in one row or column, or more
        than one in a hundred lies farther than half a pixel from the ray of its pixel: points of a
        lens with distortion, moved ones, or turned ones of a depth camera.

    Examples
    --------
    >>> import planewise as pw
    >>> room = pw.scenes.room(0, size=(120, 160))
    >>> points = room.camera.rays((120, 160)) * (0.001 * room.depth)[..., None]
    >>> image = pw.image_of_points(points)
    >>> round(image.camera.fx - room.camera.fx, 6), image.depth.shape
    (0.0, (120, 160))
    >>> len(pw.detect_planes(image.depth, image.camera, room.sensor)) > 5
    True
    """
    given = points if isinstance(points, np.ma.MaskedArray) else unmasked("points", points)
    if given.ndim != 3 or given.shape[2] != 3:
        raise ValueError(
            f"points must have shape (H, W, 3), a point for each pixel, got {given.shape}"
        )
    height, width, _ = given.shape
    array = checked_points(given.reshape(-1, 3), 3).reshape(given.shape)
    there = np.isfinite(array).all(axis=2) & array.any(axis=2)
    row, column = np.nonzero(there)
    if len(row) < _FEWEST or np.ptp(row) == 0 or np.ptp(column) == 0:
        raise ValueError(
            f"points: {len(row)} of {there.size:,} are finite and not 0, 0, 0; at least {_FEWEST} "
            "must be, in more than one row and column, to tell their camera"
        )
    fitted = _fit_pinhole(array[there].astype(np.float64), row, column)
    if isinstance(fitted, str):
        return _of_scan(array, there, fitted)
    fx, cx, fy, cy = fitted
    for axis, focal, to in (("x", fx, "right"), ("y", fy, "down")):
        if focal < 0:
            raise ValueError(f"points: their image is mirrored, {axis} is not {to}{_OTHERS}")
    camera = PinholeCamera(fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height)
    return PointImage(depth=np.where(there, array[..., 2], 0), camera=camera)


def _fit_pinhole(
    points: Array, row: NDArray[np.intp], column: NDArray[np.intp]
) -> tuple[float, float, float, float] | str:
    """fx, cx, fy and cy of points (k, 3); why they are of no pinhole camera where they are not."""
    x, y, z = points.T
    if behind := np.count_nonzero(z <= 0):
        return f"{behind:,} of {len(z):,} are behind the camera (z <= 0)"
    with np.errstate(all="ignore"):
        fx, cx, across = _fit(column, x / z)
        fy, cy, down = _fit(row, y / z)
        off = 1 - np.mean((across <= _OFF) & (down <= _OFF))  # NaN is off, too
    if off > _MOST_OFF:
        return (
            f"{100 * off:.3g} % of them are more than {_OFF} pixels off the rays of any pinhole "
            f"camera, at most {100 * _MOST_OFF:g} % may be"
        )
    return fx, cx, fy, cy


def _of_scan(points: NDArray[np.floating], there: NDArray[np.bool_], no_pinhole: str) -> PointImage:
    """Distances and camera of points on rows and columns of a LiDAR; why they are of no other."""
    camera, off = _fit_scan(points, there)
    if off > _SLIGHTLY:
        turned, less = _fit_scan(points, there, fit_axes(points, there))
        camera = turned if less < _CLEARLY * off else camera
    if isinstance(camera, str):
        raise ValueError(f"points: {no_pinhole}, and {camera}{_OTHERS}")
    ranges = np.linalg.norm(np.where(there[..., None], points, 0), axis=-1)
    return PointImage(depth=np.asarray(ranges.astype(points.dtype)), camera=camera)


def _fit_scan(
    points: NDArray[np.floating], there: NDArray[np.bool_], axes: Array | None = None
) -> tuple[SphericalCamera | str, float]:
    """LiDAR of points (H, W, 3), or why they are of none, and how far off they are on the mean."""
    try:
        camera, off = fit_spherical(points, there, axes)
    except ValueError as error:
        return f"of a LiDAR {str(error).removeprefix('camera: ')}", math.inf
    share = 1 - np.mean(off <= _OFF)
    if share > _MOST_OFF:
        return f"{100 * share:.3g} % are off the rows and columns of a LiDAR", math.inf
    return camera, float(off.mean())


def _fit(pixel: NDArray[np.intp], tangent: Array) -> tuple[float, float, Array]:
    """Focal length, principal point and how far points are from their rays, all in pixels."""
    middle = pixel.mean()
    away = pixel - middle
    focal = (away @ away) / (away @ tangent)
    centre = middle - focal * tangent.mean()
    return focal, centre, np.abs(focal * tangent + centre - pixel)
