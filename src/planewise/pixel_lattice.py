"""Pixels in directions: those of the points of a depth image, seen from its camera, are a lattice.

A pinhole camera of focal lengths and principal point K that is turned by R sees what lies in the
direction d at

    (column, row, 1) ~ G d,   G = K R,

up to a factor. G is looked for in the directions alone, from the lattice about one of them
outwards, and then falls into K and R (Hartley and Zisserman, Multiple View Geometry, 4.1 and 6.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OFF = 0.25
"""Pixels between a direction and its own, at most: a quarter of any directions are no farther."""

MOST_OFF = 0.01
"""Share of the directions that may be farther off."""

_SEEDS = 8  # directions to start from; those at borders may not show the lattice ...
_MISSES = 4  # but hardly so many of them: one in ten does not, with a third of the points left out

_PATCH = 150  # directions about one of them
_FIRST = 32  # of which so many see it without perspective
_FINEST = 1e-7  # radians across a patch, at least
_SAME = 1e-3  # of the patch's radius: copies of a point
_UPRIGHT = 0.5  # sine of the angle between two sides of a pixel, at least
_FEWEST = 5  # pixels that tell their sides
_RADII = 1.6, 3.1  # pixels about the first; from each of these their sides are known better
_WITHIN = 0.9  # share of the directions of a part of the image that are on its pixels
_FITTED = 5_000  # of them that tell G
_GRAZING = 0.1  # cosine of the angle from the first direction: 84 degrees
_REDUCED = 8  # times, for pairs of steps that were taken at a slant of some pixels
_SKEW = 0.01  # of the focal length; of a camera 0, of tilted grids on planes anything
_ASPECT = 2.0  # times the other focal length, at most


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelLattice:
    """A camera without its position, up to the choice of its first pixel, row and column.

    Attributes
    ----------
    intrinsics : ndarray, shape (3, 3)
        K, upper triangular, in pixels.
    turn : ndarray, shape (3, 3)
        R: rows are the axes of the camera, along a row of pixels, along a column and forward. Its
        determinant is -1 where the first two are left-handed with the third.
    """

    intrinsics: Array
    turn: Array

    def turned_by(self, steps: Array) -> PixelLattice:
        """The same with other rows and columns, so many times these, shape (2, 2)."""
        change = np.eye(3)
        change[:2, :2] = steps
        return _fallen_apart(change @ self.intrinsics @ self.turn)


def may_be_seen(directions: Array) -> bool:
    """Whether one camera may see directions (k, 3), which of most scanners lie all around.

    What is not finite, or 0, is none.
    """
    some = _unit(directions)
    some = some[np.isfinite(some).all(axis=1)]
    if not len(some):
        return False
    (middle,) = _unit(some.mean(axis=0)[None])
    return bool(np.mean(some @ middle > _GRAZING) >= 1 - MOST_OFF)


def pixel_lattice(directions: Array) -> PixelLattice | None:
    """Find the lattice that directions (k, 3) from a camera lie on; None if they do not.

    They may have any length, and there may be holes between them.
    """
    if len(directions) < _PATCH:
        return None
    unit, missed, rng = _unit(directions), 0, np.random.default_rng(0)
    for seed in rng.choice(len(unit), _SEEDS, replace=False):
        frame = _frame_about(unit[seed])
        ahead = unit @ frame[2]
        near = np.argpartition(-ahead, _PATCH - 1)[:_PATCH]
        start = _start(_places(unit[near], frame))
        if start is None:
            missed += 1
            if missed == _MISSES:
                return None
            continue
        seen = ahead > _GRAZING
        grown = _grown(_places(unit[seen], frame), start) if np.mean(seen) > 1 - MOST_OFF else None
        if grown is None:
            continue
        found = _fallen_apart(grown @ frame)
        found = found.turned_by(_sides(found.intrinsics))
        k = found.intrinsics
        if abs(k[0, 1]) <= _SKEW * k[0, 0] and 1 / _ASPECT <= k[0, 0] / k[1, 1] <= _ASPECT:
            return found
    return None


def _unit(directions: Array) -> Array:
    """Directions of length one; none, or 0, where their squares are out of bounds."""
    with np.errstate(all="ignore"):
        length = np.sqrt(np.einsum("ij,ij->i", directions, directions))
        return np.asarray(directions / length[:, None])


def _frame_about(direction: Array) -> Array:
    """Axes (3, 3) of which the last is a direction of length one; of another one any axes."""
    if not abs(direction @ direction - 1.0) < _GRAZING:
        return np.eye(3)
    axes: Array = np.linalg.svd(direction[None])[2]
    return np.vstack((axes[1:], direction))


def _places(directions: Array, frame: Array) -> Array:
    """Where directions meet the plane at distance one across the last axis of a frame, (k, 2)."""
    ahead = directions @ frame.T
    places: Array = ahead[:, :2] / ahead[:, 2:]
    return places


def _start(patch: Array) -> Array | None:
    """Homography (3, 3) to the pixels of a patch of places about 0, 0; None without them."""
    length = np.hypot(*patch.T)
    order = np.argsort(length)
    patch, length = patch[order], length[order]
    apart = length > _SAME * length[-1]
    if not apart.any() or length[-1] < _FINEST:
        return None
    first = patch[apart][0]  # the sides of a pixel are the shortest two steps
    across = np.abs(first[0] * patch[:, 1] - first[1] * patch[:, 0])
    others = patch[apart & (across > _UPRIGHT * length * np.hypot(*first))]
    if not len(others):
        return None
    count: Array = np.linalg.inv(np.column_stack((first, others[0])))
    for radius in _RADII:
        pixels = patch @ count.T
        whole = np.rint(pixels)
        fits = (np.abs(pixels - whole) < OFF).all(axis=1) & (np.abs(whole) <= radius).all(axis=1)
        if np.count_nonzero(fits) < _FEWEST:
            return None
        count = np.linalg.lstsq(patch[fits], whole[fits], rcond=None)[0].T.astype(np.float64)
    start = np.eye(3)
    start[:2, :2] = count
    return _grown(patch, start)


def _grown(places: Array, homography: Array) -> Array | None:
    """Homography (3, 3) from places to pixels, from the middle outwards; None if they are off."""
    places = places[np.argsort((places**2).sum(axis=1))]
    near = _FIRST
    while True:
        pixels = _pixels(homography, places[:near])
        whole = np.rint(pixels)
        fits = np.flatnonzero((np.abs(pixels - whole) <= OFF).all(axis=1))
        if len(fits) < _WITHIN * len(pixels) or not np.ptp(whole[fits], axis=0).all():
            return None  # off the pixels, or all on one row or column
        some = fits[:: 1 + len(fits) // _FITTED]
        homography = _fitted(places[some], whole[some])
        if near >= len(places):
            return homography
        near *= 2


def _sides(intrinsics: Array) -> Array:
    """Change (2, 2) of rows and columns to those along the shortest steps in the image plane.

    Seen at a slant these need not be the shortest, and lattices have many pairs of steps (the
    reduction of Lagrange and Gauss).
    """
    one, other = np.linalg.inv(intrinsics[:2, :2]).T
    steps = np.eye(2)
    for _ in range(_REDUCED):
        if one @ one > other @ other:
            one, other, steps = other, one, steps[::-1]
        times = np.rint(one @ other / (one @ one))
        other, steps = other - times * one, np.vstack((steps[0], steps[1] - times * steps[0]))
    return np.linalg.inv(steps.T).astype(np.float64)


def _pixels(homography: Array, places: Array) -> Array:
    image = places @ homography[:, :2].T + homography[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels: Array = image[:, :2] / image[:, 2:]
    return np.nan_to_num(pixels, nan=np.inf)


def _fitted(places: Array, pixels: Array) -> Array:
    """Homography of least squares, both in units of their spread."""
    a, b = places.std(), pixels.std()
    (x, y), (column, row) = (places / a).T, (pixels / b).T
    one, none = np.ones_like(x), np.zeros_like(x)
    # column (h6 x + h7 y + 1) = h0 x + h1 y + h2, and so for row
    along = np.column_stack((x, y, one, none, none, none, -column * x, -column * y))
    down = np.column_stack((none, none, none, x, y, one, -row * x, -row * y))
    eight = np.linalg.lstsq(np.vstack((along, down)), np.append(column, row), rcond=None)[0]
    out: Array = np.diag((b, b, 1.0)) @ np.append(eight, 1.0).reshape(3, 3)
    return out @ np.diag((1 / a, 1 / a, 1.0))


def _fallen_apart(product: Array) -> PixelLattice:
    """K and R of a product G = K R."""
    # The QR decomposition of the rows in reverse order.
    q, r = np.linalg.qr(product[::-1].T)
    turn, intrinsics = q.T[::-1], r.T[::-1, ::-1]
    signs = np.where(np.diag(intrinsics) < 0, -1.0, 1.0)
    intrinsics, turn = intrinsics * signs, signs[:, None] * turn
    return PixelLattice(intrinsics=intrinsics / intrinsics[2, 2], turn=turn)
