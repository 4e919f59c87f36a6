"""Whether readings are what they are taken for: depth, distances, or disparity, through a lens.

In the image the inverse depth of a plane is affine; of distances, inverse distance is affine over
|(u, v, 1)|, and of disparity the reading itself. What is taken for the other is bent, on all planes
alike: that share of the curvature of flat squares which this explains is 0 of the one and 1 of the
other, whatever the planes. A lens whose distortion the camera does not know bends them, too, the
more the farther out and the more they lean: by the k1 that the camera lacks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planewise.camera import RIG, PinholeCamera
from planewise.observation import RayObservation

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_SQUARES = 10  # along the longer side of an image
_PLACES = 12  # rows, and columns, of a square that are looked at
_FLAT = 2.0  # times the residuals of the flattest quarter
_STEEPEST = 0.5  # of the flat squares tell disparity and lenses, which walls that are faced do not
_ROUNDING = 1e-6  # of inverse depth: a smaller bend is none
_FEWEST = 6  # squares that tell
_ERROR = 0.15  # of a median share, at most ...
_OFF = 0.3  # ... which is so near to what it is of another kind
_CERTAIN = 6.0  # errors of k1
_LENS = 0.03, 0.45  # k1 that bends planes, and that of what is curved itself


def misread(observation: RayObservation) -> str:
    """What readings look like, where they are taken for something else; else empty."""
    camera = observation.camera
    if type(camera) is not PinholeCamera:
        return ""
    readings, squares = _readings(observation, _squares(camera, observation.shape))
    if len(readings) < _FEWEST:
        return ""
    inverse = 1.0 / readings
    bent = inverse - squares.fit(inverse)
    if abs(disparity_share(readings, bent, squares) - 1.0) < _OFF:
        return (
            "readings look like disparity or inverse depth, not depth, which is focal length x "
            "baseline / disparity"
        )
    shares = radial_shares(inverse, bent, squares)
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
    k1, error = lens_left(inverse / squares.shrunk if camera.radial else inverse, squares)
    least, most = _LENS
    if max(least, _CERTAIN * error) < abs(k1) < most:
        return (
            f"planes look bent by a lens, by a distortion of about k1 = {k1:.2g} that the camera "
            "lacks; give it, or rectify images"
        )
    return ""


def radial_shares(inverse: Array, bent: Array, squares: Squares) -> Array:
    """Shares of curvature, across and down, by which readings are distances; NaN if not known.

    inverse (s, k): 1 / reading; bent (s, k): what it is beyond affine.
    """
    plane = squares.fit(inverse / squares.shrunk)  # 1 / z, if these are distances
    bend = plane * squares.shrunk
    curvature = squares.curvature(bent)
    flat = _flat(squares.rough(bent))
    return _median(curvature[flat] / squares.curvature(bend - squares.fit(bend))[flat])


def disparity_share(readings: Array, bent: Array, squares: Squares) -> float:
    """Share of `bent`, as of `radial_shares`, by which readings are disparity; NaN if not known."""
    plane = squares.fit(readings)
    bend = 1.0 / plane
    left = np.minimum(np.square(bent).sum(axis=1), np.square(readings - plane).sum(axis=1))
    return float(_median(_shares(bent, bend - squares.fit(bend), left)[:, None])[0])


def lens_left(inverse: Array, squares: Squares) -> tuple[float, float]:
    """Distortion k1 that a camera lacks, and its error; NaN if squares are too few.

    What is seen at (u, v) lies at (u, v) (1 - k1 r^2), r^2 = u^2 + v^2: a plane of inverse depth
    a + b u + c v is bent by -k1 r^2 (b u + c v).
    """
    u, v = squares.u, squares.v
    plane, last = squares.fit(inverse), [_PLACES - 1, (_PLACES - 1) * _PLACES]
    # Two corners against the first: b and c, for such planes are affine.
    across = np.stack([each[:, last] - each[:, :1] for each in (u, v)], axis=2)
    b, c = np.linalg.solve(across, (plane[:, last] - plane[:, :1])[..., None])[..., 0].T
    bend = -(b[:, None] * u + c[:, None] * v) * (u * u + v * v)
    bent = inverse - plane
    k1 = _shares(bent, bend - squares.fit(bend), squares.rough(bent))
    if len(k1) < _FEWEST:
        return math.nan, math.nan
    middle, error = _median_and_error(k1)
    return float(middle), float(error)


def _flat(left: Array) -> NDArray[np.bool_]:
    """Which squares (s,) are flat, by what is left of their curvature."""
    return np.asarray(left <= _FLAT * _ranked(left, 0.25))


def _telling(left: Array, energy: Array) -> NDArray[np.bool_]:
    """Which of the flat squares (s,) would be bent by much."""
    flat = _flat(left)
    least = max(_ranked(energy[flat], 1.0 - _STEEPEST), _PLACES**2 * _ROUNDING**2)
    return np.asarray(flat & (energy > least))


def _shares(bent: Array, bend: Array, left: Array) -> Array:
    """How much of a bend (s, k) is in what is bent, of the squares that tell; left (s,)."""
    energy = np.square(bend).sum(axis=1)
    tells = _telling(left, energy)
    return np.asarray(np.einsum("sk,sk->s", bent[tells], bend[tells]) / energy[tells])


def _ranked(values: Array, share: float) -> float:
    """A quantile of values, one of them."""
    place = int(share * len(values))
    return float(np.partition(values, place)[place])


@dataclass(frozen=True, eq=False)
class Squares:
    """Squares of pixels (s,), and places (k,) in each.

    row, column (s, k); u, v (s, k): where they lie at z = 1; shrunk (s, k): z / distance there,
    1 / |(u, v, 1)|; affine (s, k, 3), square (s, k, 2): orthonormal, of the affine functions of
    u and v and of their squares, less these.
    """

    row: Index
    column: Index
    u: Array
    v: Array
    shrunk: Array
    affine: Array
    square: Array

    def some(self, which: NDArray[np.bool_]) -> Squares:
        """Those of a mask (s,)."""
        pixels = self.row[which], self.column[which]
        rays = self.u[which], self.v[which], self.shrunk[which]
        return Squares(*pixels, *rays, self.affine[which], self.square[which])

    def fit(self, values: Array) -> Array:
        """Nearest affine functions to values (s, k)."""
        return np.asarray((self.affine @ self._on(self.affine, values))[..., 0])

    def curvature(self, values: Array) -> Array:
        """How much of squares of u and v is in values (s, k): shape (s, 2)."""
        return self._on(self.square, values)[..., 0]

    def rough(self, bent: Array) -> Array:
        """What squares of u and v leave of values that are beyond affine: shape (s,)."""
        curvature = self.curvature(bent)
        return np.asarray(np.square(bent).sum(axis=1) - np.square(curvature).sum(axis=1))

    @staticmethod
    def _on(basis: Array, values: Array) -> Array:
        """Products of functions of a basis (s, k, c) and values (s, k): shape (s, c, 1)."""
        return np.asarray(np.swapaxes(basis, 1, 2) @ values[..., None])


@lru_cache(maxsize=RIG)
def _squares(camera: PinholeCamera, shape: tuple[int, int]) -> Squares:
    step = max(1, max(shape) // (_SQUARES * _PLACES))
    y, x = step * np.indices((_PLACES, _PLACES)).reshape(2, -1)
    side = step * _PLACES
    top, left = (side * np.indices([n // side for n in shape])).reshape(2, -1, 1)
    row, column = top + y, left + x
    u, v = (each[row, column] for each in camera.directions(shape))
    seen = np.isfinite(u).all(axis=1)  # by the lens
    row, column, u, v = row[seen], column[seen], u[seen], v[seen]
    basis, _ = np.linalg.qr(np.stack((np.ones_like(u), u, v, u * u, v * v), axis=2))
    shrunk = 1.0 / np.sqrt(1.0 + u * u + v * v)
    return Squares(row, column, u, v, shrunk, basis[..., :3].copy(), basis[..., 3:].copy())


def _readings(observation: RayObservation, squares: Squares) -> tuple[Array, Squares]:
    """Readings of whole squares against their means, (s, k), and these squares."""
    image = observation.image
    values = image.values[squares.row, squares.column].astype(np.float64)
    whole = np.all((values >= image.low) & (values <= image.high), axis=1)
    values = values[whole]
    return values / values.mean(axis=1, keepdims=True), squares.some(whole)


def _median(shares: Array) -> Array:
    """Medians over squares of shares (s, n), if all their errors are small; else NaN."""
    if len(shares) < _FEWEST:
        return np.full(shares.shape[1], np.nan)
    middle, error = _median_and_error(shares)
    return middle if (error < _ERROR).all() else np.full_like(middle, np.nan)


def _median_and_error(values: Array) -> tuple[Array, Array]:
    """Medians over squares (s, ...), and their errors by the median deviation.

    sqrt(pi / 2) 1.4826 / sqrt(s) of it, if values are normal.
    """
    middle = np.median(values, axis=0)
    deviation = np.median(np.abs(values - middle), axis=0)
    return np.asarray(middle), np.asarray(1.858 * deviation / math.sqrt(len(values)))
