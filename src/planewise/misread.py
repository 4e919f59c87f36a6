"""Whether readings are what they are taken for: depth, distances from the camera, or disparity.

In the image the inverse depth of a plane is affine; of distances, inverse distance is affine over
|(u, v, 1)|, and of disparity the reading itself. What is taken for the other is bent, on all planes
alike: that share of the curvature of flat squares which this explains is 0 of the one and 1 of the
other, whatever the planes.
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
_STEEPEST = 0.5  # of the flat squares tell disparity: it is no other on a wall that is faced
_FEWEST = 6  # squares that tell
_ERROR = 0.15  # of a median share, at most ...
_OFF = 0.3  # ... which is so near to what it is of another kind


def misread(observation: RayObservation) -> str:
    """What readings look like, where they are taken for something else; else empty."""
    camera = observation.camera
    if type(camera) is not PinholeCamera:
        return ""
    squares = _squares(camera, observation.shape)
    readings, whole = _readings(observation, squares)
    if len(readings) < _FEWEST:
        return ""
    if abs(disparity_share(readings, squares) - 1.0) < _OFF:
        return (
            "readings look like disparity or inverse depth, not depth, which is focal length x "
            "baseline / disparity"
        )
    shares = radial_shares(readings, squares.shrunk[whole], squares)
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


def radial_shares(readings: Array, shrunk: Array, squares: Squares) -> Array:
    """Shares of curvature, across and down, by which readings are distances; NaN if not known.

    readings (s, k): of squares, against their means; shrunk (s, k): as in `Squares`, of the same.
    """
    inverse = 1.0 / readings
    plane = _fit(inverse / shrunk, squares.affine)  # 1 / z, if these are distances
    bent, bend = (each - _fit(each, squares.affine) for each in (inverse, plane * shrunk))
    curvature, of_plane = bent @ squares.square, bend @ squares.square
    left = np.square(bent).sum(axis=1) - np.square(curvature).sum(axis=1)
    flat = left <= _FLAT * np.quantile(left, 0.25)
    return _median(curvature[flat] / of_plane[flat])


def disparity_share(readings: Array, squares: Squares) -> float:
    """Share of the curvature of 1 / reading by which readings are disparity; NaN if not known."""
    inverse, plane = 1.0 / readings, _fit(readings, squares.affine)
    bent, bend = (each - _fit(each, squares.affine) for each in (inverse, 1.0 / plane))
    left = np.minimum(np.square(bent).sum(axis=1), np.square(readings - plane).sum(axis=1))
    energy = np.square(bend).sum(axis=1)
    flat = left <= _FLAT * np.quantile(left, 0.25)
    tells = flat & (energy > np.quantile(energy[flat], 1.0 - _STEEPEST))
    share = np.einsum("sk,sk->s", bent[tells], bend[tells]) / energy[tells]
    return float(_median(share[:, None])[0])


class Squares(NamedTuple):
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
def _squares(camera: PinholeCamera, shape: tuple[int, int]) -> Squares:
    step = max(1, max(shape) // (_SQUARES * _PLACES))
    y, x = step * np.indices((_PLACES, _PLACES)).reshape(2, -1)
    side = step * _PLACES
    top, left = (side * np.indices([n // side for n in shape])).reshape(2, -1, 1)
    row, column = top + y, left + x
    u, v = (each[row, column] for each in camera.directions(shape))
    basis, _ = np.linalg.qr(np.stack((np.ones(x.size), x, y, x * x, y * y), axis=1))
    shrunk = 1.0 / np.sqrt(1.0 + u * u + v * v)
    return Squares(row, column, shrunk, basis[:, :3], basis[:, 3:])


def _readings(observation: RayObservation, squares: Squares) -> tuple[Array, NDArray[np.bool_]]:
    """Readings of whole squares against their means, (s, k), and which squares are whole."""
    image = observation.image
    values = image.values[squares.row, squares.column].astype(np.float64)
    whole = np.asarray(((values >= image.low) & (values <= image.high)).all(axis=1))
    values = values[whole]
    return np.asarray(values / values.mean(axis=1, keepdims=True)), whole


def _fit(values: Array, basis: Array) -> Array:
    """Nearest functions of a basis to values (s, k)."""
    return np.asarray((values @ basis) @ basis.T)


def _median(shares: Array) -> Array:
    """Medians over squares of shares (s, n), if all their errors are small; else NaN."""
    if len(shares) < _FEWEST:
        return np.full(shares.shape[1], np.nan)
    middle = np.median(shares, axis=0)
    # Of a median, by that of deviations: sqrt(pi / 2) 1.4826 MAD / sqrt(n) of normal ones.
    error = 1.858 * np.median(np.abs(shares - middle), axis=0) / math.sqrt(len(shares))
    return np.asarray(middle) if (error < _ERROR).all() else np.full_like(middle, np.nan)
