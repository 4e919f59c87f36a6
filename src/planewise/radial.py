"""Whether readings are what the camera says: depth along z, or distances from it (`radial`).

In the image the inverse depth of a plane is affine, its inverse distance affine over |(u, v, 1)|:
what is read as the other is bent, on every plane alike. That share of the curvature of flat squares
which this explains is 0 of depth and 1 of distances, whatever the planes.
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
_ERROR = 0.12  # of the median share, at most ...
_OFF = 0.25  # ... which is so near to what it is of the other kind


def misread(observation: RayObservation) -> str:
    """What readings look like, where the camera says otherwise; else empty."""
    camera = observation.camera
    if type(camera) is not PinholeCamera:
        return ""
    share = radial_share(observation, camera)
    if camera.radial and abs(share) < _OFF:
        return (
            "readings look like depth along z, not distances from the camera; where they are, it "
            "must not be radial"
        )
    if not camera.radial and abs(share - 1.0) < _OFF:
        return (
            "readings look like distances from the camera, not depth along z; where they are, it "
            "must be radial (PinholeCamera(..., radial=True), --camera CAMERA:radial)"
        )
    return ""


def radial_share(observation: RayObservation, camera: PinholeCamera) -> float:
    """Share of the curvature of flat squares by which readings are distances.

    The median, if its error is small; else NaN, as where noise hides it or squares are few.
    """
    squares, image = _squares(camera, observation.shape), observation.image
    values = image.values[squares.row, squares.column].astype(np.float64)
    whole = ((values >= image.low) & (values <= image.high)).all(axis=1)
    if np.count_nonzero(whole) < _FEWEST:
        return math.nan
    inverse, shrunk = 1.0 / values[whole], squares.shrunk[whole]
    inverse /= inverse.mean(axis=1, keepdims=True)
    plane = _affine(inverse / shrunk, squares.basis)  # 1 / z, if these are distances
    curvature, bend = (each - _affine(each, squares.basis) for each in (inverse, plane * shrunk))
    shares = np.einsum("sk,sk->s", curvature, bend) / np.einsum("sk,sk->s", bend, bend)
    left = np.square(curvature - shares[:, None] * bend).sum(axis=1)
    shares = shares[left <= _FLAT * np.quantile(left, 0.25)]
    middle = np.median(shares)
    # Of a median, by that of deviations: sqrt(pi / 2) 1.4826 MAD / sqrt(n) of normal ones.
    error = 1.858 * np.median(np.abs(shares - middle)) / math.sqrt(len(shares))
    return float(middle) if len(shares) >= _FEWEST and error < _ERROR else math.nan


class _Squares(NamedTuple):
    """Squares of pixels (s,), and places (k,) in each.

    row, column (s, k); shrunk (s, k): z / distance, 1 / |(u, v, 1)|; basis (k, 3): orthonormal, of
    the affine functions.
    """

    row: Index
    column: Index
    shrunk: Array
    basis: Array


@lru_cache(maxsize=RIG)
def _squares(camera: PinholeCamera, shape: tuple[int, int]) -> _Squares:
    step = max(1, max(shape) // (_SQUARES * _PLACES))
    y, x = step * np.indices((_PLACES, _PLACES)).reshape(2, -1)
    side = step * _PLACES
    top, left = (side * np.indices([n // side for n in shape])).reshape(2, -1, 1)
    row, column = top + y, left + x
    u, v = (each[row, column] for each in camera.directions(shape))
    basis, _ = np.linalg.qr(np.stack((np.ones(x.size), x, y), axis=1))
    return _Squares(row, column, 1.0 / np.sqrt(1.0 + u * u + v * v), basis)


def _affine(values: Array, basis: Array) -> Array:
    """Nearest affine functions of values (s, k)."""
    return np.asarray((values @ basis) @ basis.T)
