"""Organised points: those of a depth image, in the order of its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import checked_points, unmasked
from planewise.camera import Array, PinholeCamera

_FEWEST = 12  # points that tell a camera
_OFF = 0.5  # pixels from the ray of its pixel; of points rounded to 1 mm, at 1 m, about 0.3
_MOST_OFF = 0.01  # share of the points that may be farther off
_OTHERS = (
    "; expected the frame of the camera that took them, x right, y down, z forward, without "
    "distortion. Other points are searched as such: detect_planes_in_points, 'planewise points'"
)


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class PointImage:
    """The depth image that organised points were made of.

    Attributes
    ----------
    depth : ndarray of float32 or float64, shape (H, W)
        z of the points, metres; 0 where there is none.
    camera : PinholeCamera
        The points lie on its rays.
    """

    depth: NDArray[np.float32] | Array
    camera: PinholeCamera


def image_of_points(points: ArrayLike) -> PointImage:
    """Depth image and camera of organised points, such as Kinect and RealSense tools save.

    The camera is that of least squares, x / z = (column - cx) / fx and y / z = (row - cy) / fy over
    all points. Planes of the image are told better than those of the points, for it knows which
    are neighbours, and how far its error goes along the rays.

    Parameters
    ----------
    points : array_like, shape (H, W, 3)
        In the order of the pixels and the frame of the camera that took them, x right, y down,
        z forward. Metres: millimetres are not noticed, their depth lies beyond any sensor's range.
        NaN, infinity, 0, 0, 0 and what is masked is no point.

    Returns
    -------
    PointImage
        ``depth`` and ``camera``, as `detect_planes` takes them.

    Raises
    ------
    ValueError
        If the shape is another one, there are too few points or all in one row or column, some
        lie behind the camera, or more than one in a hundred lies farther than half a pixel from
        the ray of its pixel: points of a LiDAR, of a lens with distortion, or moved or turned ones.

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
    x, y, z = array[there].astype(np.float64).T
    if behind := np.count_nonzero(z <= 0):
        raise ValueError(
            f"points: {behind:,} of {len(z):,} are behind the camera (z <= 0){_OTHERS}"
        )
    with np.errstate(all="ignore"):
        fx, cx, across = _fit(column, x / z)
        fy, cy, down = _fit(row, y / z)
        off = 1 - np.mean((across <= _OFF) & (down <= _OFF))  # NaN is off, too
    if off > _MOST_OFF:
        raise ValueError(
            f"points: {100 * off:.3g} % of them are more than {_OFF} pixels off the rays of any "
            f"pinhole camera, at most {100 * _MOST_OFF:g} % may be{_OTHERS}"
        )
    for axis, focal, to in (("x", fx, "right"), ("y", fy, "down")):
        if focal < 0:
            raise ValueError(f"points: their image is mirrored, {axis} is not {to}{_OTHERS}")
    camera = PinholeCamera(fx=fx, fy=fy, cx=cx, cy=cy, width=width, height=height)
    return PointImage(depth=np.where(there, array[..., 2], 0), camera=camera)


def _fit(pixel: NDArray[np.intp], tangent: Array) -> tuple[float, float, Array]:
    """Focal length, principal point and how far points are from their rays, all in pixels."""
    middle = pixel.mean()
    away = pixel - middle
    focal = (away @ away) / (away @ tangent)
    centre = middle - focal * tangent.mean()
    return focal, centre, np.abs(focal * tangent + centre - pixel)
