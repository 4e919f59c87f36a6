"""Whether readings are what the camera says: depth along z, or distances from it (`radial`).

In the image the inverse depth of a plane is affine, its inverse distance affine over |(u, v, 1)|:
what is read as the other is bent, on every plane alike. That share of the curvature of flat squares
which this explains, along rows and along columns, is 0 of depth and 1 of distances, whatever the
planes.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planewise.camera import RIG, PinholeCamera
from planewise.observation import RayObservation

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_SQUARES = 10  # along the longer side of an image
_PLACES = 12  # rows, and columns, of a square that are looked at
_FLAT = 2.0  # times the residuals of the flattest quarter
_FEWEST = 6  # flat squares
_ERROR = 0.15  # of either median share, at most ...
_OFF = 0.3  # ... which are so near to what they are of the other kind


def misread(observation: RayObservation) -> str:
    """What readings look like, where the camera says otherwise; else empty."""
    camera = observation.camera
    if type(camera) is not PinholeCamera:
        return ""
    shares = radial_shares(observation, camera)
    if camera.radial and np.all(np.abs(shares) < _OFF):
        return (
            "readings look like depth along z, not distances from the camera; where they are, it "
            "must not be radial"
        )
    if not camera.radial and np.all(np.abs(shares - 1.0) < _OFF):
        return (
            "readings look like distances from the camera, not depth along z; where they are, it "
            "must be radial (PinholeCamera(..., radial=True), --camera CAMERA:radial)"
        )
    return ""


def radial_shares(observation: RayObservation, camera: PinholeCamera) -> Array:
    """Shares of the curvature of flat squares, across and down, by which readings are distances.

    Medians, if their errors are small; else NaN, as where noise hides them or squares are few.
    """
    squares, image = _squares(camera, observation.shape), observation.image
    values = image.values[squares.row, squares.column].astype(np.float64)
    whole = ((values >= image.low) & (values <= image.high)).all(axis=1)
    if np.count_nonzero(whole) < _FEWEST:
        return np.full(2, np.nan)
    inverse, shrunk = 1.0 / values[whole], squares.shrunk[whole]
    inverse /= inverse.mean(axis=1, keepdims=True)
    plane = _fit(inverse / shrunk, squares.affine)  # 1 / z, if these are distances
    bent, bend = (each - _fit(each, squares.affine) for each in (inverse, plane * shrunk))
    curvature, of_plane = bent @ squares.square, bend @ squares.square
    left = np.square(bent).sum(axis=1) - np.square(curvature).sum(axis=1)
    flat = left <= _FLAT * np.quantile(left, 0.25)
    shares = curvature[flat] / of_plane[flat]
    middle = np.median(shares, axis=0)
    # Of a median, by that of deviations: sqrt(pi / 2) 1.4826 MAD / sqrt(n) of normal ones.
    error = 1.858 * np.median(np.abs(shares - middle), axis=0) / math.sqrt(len(shares))
    sure = len(shares) >= _FEWEST and bool((error < _ERROR).all())
    return np.asarray(middle) if sure else np.full(2, np.nan)


class _Squares(NamedTuple):
    """Squares of pixels (s,), and places (k,) in each.

    row, column (s, k); shrunk (s, k): z / distance, 1 / |(u, v, 1)|; affine (k, 3), square (k, 2):
    orthonormal, of the affine functions and of squares of x and y, less these.
    """

    row: Index
    column: Index
    shrunk: Array
    affine: Array
    square: Array


@lru_cache(maxsize=RIG)
def _squares(camera: PinholeCamera, shape: tuple[int, int]) -> _Squares:
    step = max(1, max(shape) // (_SQUARES * _PLACES))
    y, x = step * np.indices((_PLACES, _PLACES)).reshape(2, -1)
    side = step * _PLACES
    top, left = (side * np.indices([n // side for n in shape])).reshape(2, -1, 1)
    row, column = top + y, left + x
    u, v = (each[row, column] for each in camera.directions(shape))
    basis, _ = np.linalg.qr(np.stack((np.ones(x.size), x, y, x * x, y * y), axis=1))
    shrunk = 1.0 / np.sqrt(1.0 + u * u + v * v)
    return _Squares(row, column, shrunk, basis[:, :3], basis[:, 3:])


def _fit(values: Array, basis: Array) -> Array:
    """Nearest functions of a basis to values (s, k)."""
    return np.asarray((values @ basis) @ basis.T)
