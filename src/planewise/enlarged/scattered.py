"""Depth that was registered to a larger picture, whose readings lie on scattered pixels.

A driver that moves every reading to the pixel of a colour camera where it is seen, and fills
nothing in, leaves gaps between them: about one pixel in so many has a reading, in rows that are not
quite straight. Pixels of a coarser image then have one each, on a ray of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.camera import PinholeCamera
from planewise.density import Mask, cell_counts, has_reading, middle_rows, usual_count
from planewise.noise import evaluated

if TYPE_CHECKING:
    from planewise.observation import RayObservation
    from planewise.sectors import Sectors

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Image = NDArray[Any]

_ALONE = 0.2  # of the readings of some rows have none to their right, at least
_MIDDLE = 9  # rows that are looked at
_CELL = 12  # pixels of a cell, in whose median it shows how many have a reading
_FEWEST, _MOST = 0.04, 0.45  # of the pixels have a reading
_WIDER = 1.0, 1.1, 1.2, 1.3  # times what would have one reading each
_SQUARE = 4  # coarse pixels of a square; those less than half full are at a border
_ROUNDED = 0.3  # of the noise is what moving readings to their pixels does, at most
_LEANS = math.tan(math.radians(70))  # of a floor some metres away
_FILLED = 0.9  # of the others have a reading: of random pixels it is 0.88 at most


@dataclass(frozen=True, kw_only=True, eq=False)
class ScatteredCamera:
    """Camera of a coarser image, each of whose pixels has the ray of its reading.

    Attributes
    ----------
    parent : PinholeCamera
        That of the image.
    times : float
        How many of its pixels are one, along either side.
    u, v : ndarray, shape (h, w)
        Rays (u, v, 1).
    """

    parent: PinholeCamera
    times: float
    u: Array
    v: Array

    @classmethod
    def of(cls, parent: PinholeCamera, times: float, x: Array, y: Array) -> ScatteredCamera | None:
        """Camera whose pixels lie at these places of the image; None where a lens folds it."""
        u, v, _ = np.moveaxis(parent.unproject(np.stack((x, y), axis=-1)), -1, 0)
        if not np.isfinite(u).all():
            return None
        u, v = np.ascontiguousarray(u), np.ascontiguousarray(v)
        return cls(parent=parent, times=times, u=u, v=v)

    @property
    def frame(self) -> str:
        """The camera's axes in words."""
        return self.parent.frame

    @property
    def wraps(self) -> bool:
        """A pinhole image does not."""
        return False

    @property
    def bends(self) -> bool:
        """Every pixel has a ray."""
        return False

    @property
    def pixel_size(self) -> tuple[float, float]:
        """Width and height of a usual pixel at one metre, in metres."""
        width, height = self.parent.pixel_size
        return self.times * width, self.times * height

    def check(self, shape: tuple[int, int]) -> None:
        """Raise ValueError for an image of another size."""
        if tuple(shape) != self.u.shape:
            raise ValueError(f"shape must be {self.u.shape}, got {shape}")

    def rays(self, shape: tuple[int, int]) -> Array:
        """Rays of all pixels, shape (h, w, 3)."""
        return np.ascontiguousarray(np.moveaxis(self.ray_rows(shape).reshape(3, *shape), 0, -1))

    def ray_rows(self, shape: tuple[int, int]) -> Array:
        """Return the same rays as rows over the flattened image, shape (3, h * w)."""
        self.check(shape)
        return np.stack((self.u.reshape(-1), self.v.reshape(-1), np.ones(self.u.size)))

    def pixel_area(self, shape: tuple[int, int]) -> Array:
        """Area that pixels cover where readings are 1, square metres, shape (h, w)."""
        width, height = self.pixel_size
        return np.broadcast_to(width * height, shape)

    def unproject(self, pixels: ArrayLike) -> Array:
        """Rays (..., 3) of places (x, y) in the coarser image, as if each were at its middle."""
        at = np.asarray(pixels, np.float64)
        return self.parent.unproject((at + 0.5) * self.times - 0.5)

    def sectors(self, shape: tuple[int, int]) -> Sectors:
        """One, whose coordinates are those of the rays."""
        from planewise.sectors import one_sector  # loads Numba

        self.check(shape)
        width, height = self.pixel_size
        return one_sector(self.u, self.v, (1.0 / width, 1.0 / height), straight=False)

    def describe(self) -> dict[str, Any]:
        """Say in plain types what the camera is."""
        return {"model": "scattered", "times": self.times, "parent": self.parent.describe()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Scattered:
    """A coarser image of scattered readings.

    Attributes
    ----------
    there : ndarray of bool, shape (H, W)
        Which pixels of the image have a reading.
    of_reading : ndarray of int, shape (k,)
        Pixel of the coarser one, flattened, in which each of these readings lies.
    depth : ndarray, shape (h, w)
        The reading of each coarse pixel that lies nearest to its middle; 0 where there is none.
    camera : ScatteredCamera
        Its rays.
    """

    there: Mask
    of_reading: Index
    depth: Image
    camera: ScatteredCamera

    def enlarge(self, image: Image) -> Image:
        """An image of coarse pixels on the readings of each; 0 elsewhere."""
        out = np.zeros(self.there.shape, image.dtype)
        out[self.there] = image.reshape(-1)[self.of_reading]
        return out

    def tells(self, seen: RayObservation) -> bool:
        """Whether planes are those of the image, by the noise of what is seen in coarse pixels.

        A reading was moved to the middle of its pixel, which on a surface that leans is an error,
        alike for many side by side where one pixel in a whole number has a reading. Where it is
        large against the noise, such a surface falls into strips.
        """
        if not seen.count:
            return True
        depth = float(np.median(seen.depth))
        off = _LEANS * math.sqrt(math.prod(self.camera.parent.pixel_size)) * depth / math.sqrt(12)
        sensor, at = seen.sensor, np.array([depth])
        parts = sensor.parts
        shared = 0.0 if parts is None else float(evaluated("parts.shared", parts.shared, at)[0])
        return off < _ROUNDED * math.hypot(float(sensor.sigma(at)[0]), shared)

    def around(self, box: tuple[int, ...]) -> tuple[int, ...]:
        """First row and column, and those behind the last, of what coarse ones (`box`) cover."""
        times = self.camera.times
        top, left = (int(times * first) for first in box[:2])
        bottom, right = (int(np.ceil(times * end)) for end in box[2:])
        return top, left, bottom, right


def scattered(image: Image, camera: PinholeCamera) -> Scattered | None:
    """A coarser image of one whose readings are scattered evenly; None for any other.

    Raises
    ------
    ValueError
        If they are, and the image cannot have been taken by the camera.
    """
    some = has_reading(middle_rows(image, _MIDDLE))
    alone = np.count_nonzero(some[:, :-1] & ~some[:, 1:])
    if not alone > _ALONE * np.count_nonzero(some):
        return None
    there = has_reading(image)
    share = usual_count(cell_counts(there, _CELL)) / _CELL**2
    if not _FEWEST <= share <= _MOST:
        return None
    row, column = there.nonzero()
    for wider in _WIDER:
        times = wider / np.sqrt(share)
        shape = int(np.ceil(image.shape[0] / times)), int(np.ceil(image.shape[1] / times))
        i, j = (
            np.minimum((at / times).astype(np.intp), n - 1)
            for at, n in zip((row, column), shape, strict=True)
        )
        if _is_filled(i, j, shape):
            break
    else:
        return None
    camera.check((image.shape[0], image.shape[1]))
    middle = [(np.arange(n) + 0.5) * times - 0.5 for n in shape]
    off = np.square(row - middle[0][i]) + np.square(column - middle[1][j])
    last = np.argsort(-off, kind="stable")  # what is written last stays
    where = i[last], j[last]
    depth = np.zeros(shape, image.dtype)
    depth[where] = image[there][last]
    y, x = (np.ascontiguousarray(each) for each in np.meshgrid(*middle, indexing="ij"))
    y[where], x[where] = row[last], column[last]
    own = ScatteredCamera.of(camera, times, x, y)
    if own is None:
        return None
    return Scattered(there=there, of_reading=i * shape[1] + j, depth=depth, camera=own)


def _is_filled(i: Index, j: Index, shape: tuple[int, int]) -> bool:
    """Whether nearly all coarse pixels away from borders have one of the readings in them."""
    full = np.zeros(shape, np.bool_)
    full[i, j] = True
    counts = cell_counts(full, _SQUARE)
    counts = counts[2 * counts >= _SQUARE**2]
    return bool(counts.size) and bool(counts.mean() >= _FILLED * _SQUARE**2)
