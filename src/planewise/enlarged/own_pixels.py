"""Depth that was enlarged, as to the size of a picture: pixels repeat, lie between, or are missing.

A reading that is there k times has one error, not k, and cells of few pixels hold hardly one of
them; nor do they where only every third row and column has readings. So such an image is searched
at the size that it had.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Camera, PinholeCamera
from planewise.density import Mask, has_reading
from planewise.enlarged.filled import filled
from planewise.enlarged.interpolated import as_loops_take, interpolated
from planewise.enlarged.lines import Index, Lines
from planewise.enlarged.scattered import Scattered, scattered
from planewise.model import Plane, PlaneModel

if TYPE_CHECKING:
    from planewise.observation import RayObservation

Image = NDArray[Any]

_LEAST, _MOST = 1.2, 16.0  # times as wide
_LOOKED_AT = 7  # rows, or columns, of which two are equal where that is more than `_LEAST`
_FEWEST = 16  # own rows and columns: fewer repeat by chance
_ALIKE = 0.05  # of the own rows may be like the one before
_ABOUT = 0.02  # of how many times as wide it is, as most rows show
_SPARSE = 3.0  # pixels for one with a reading; of half as many cells make enough


@dataclass(frozen=True, kw_only=True, eq=False)
class OwnPixels:
    """Which pixels of an enlarged image are one of its own.

    Attributes
    ----------
    rows, columns : Lines
        Of sparse images what is not among them has no readings.
    there : ndarray of bool, shape (H, W)
        Which pixels of the enlarged image have a reading.
    depth : ndarray, shape (h, w)
        The image of own pixels.
    camera : PinholeCamera
        That of own pixels.
    """

    rows: Lines
    columns: Lines
    there: Mask
    depth: Image
    camera: PinholeCamera

    @classmethod
    def of(
        cls, image: Image, camera: PinholeCamera, rows: Lines, columns: Lines, depth: Image
    ) -> OwnPixels:
        """Own pixels of an enlarged image and its camera; depth: that of own pixels."""
        fx, cx = columns.own(camera.fx, camera.cx)
        fy, cy = rows.own(camera.fy, camera.cy)
        height, width = depth.shape
        own = replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, height=height, width=width)
        there = has_reading(image)
        return cls(rows=rows, columns=columns, there=there, depth=depth, camera=own)

    def enlarge(self, image: Image) -> Image:
        """An image of own pixels, enlarged; 0 where they have none."""
        out = np.zeros(self.there.shape, image.dtype)
        (rows, own_rows), (columns, own_columns) = self.rows.every(), self.columns.every()
        out[np.ix_(rows, columns)] = image[np.ix_(own_rows, own_columns)]
        return out

    def tells(self, _: RayObservation) -> bool:
        """Whether planes are those of the image: its pixels are where they were."""
        return True

    def around(self, box: tuple[int, ...]) -> tuple[int, ...]:
        """First row and column, and those behind the last, of what own ones (`box`) cover."""
        top, left, bottom, right = box
        (top, bottom), (left, right) = self.rows.edges(top, bottom), self.columns.edges(left, right)
        return top, left, bottom, right


def as_enlarged(own: OwnPixels | Scattered, model: PlaneModel, readings: Index) -> PlaneModel:
    """A model of own pixels as one of the enlarged image; readings: places of the own ones.

    Labels, counts and bounding boxes are those of the enlarged image; all else knows of every
    reading once, and settings say the own size.
    """
    labels, seen = own.enlarge(model.labels), np.zeros(own.depth.shape, np.bool_)
    labels[~own.there], seen.flat[readings] = 0, True
    return replace(
        model,
        labels=labels,
        planes=tuple(
            _enlarged(own, plane, number, labels) for number, plane in enumerate(model.planes, 1)
        ),
        readings=int(np.count_nonzero(own.enlarge(seen) & own.there)),
        settings={**model.settings, "own_size": list(own.depth.shape)},
    )


def _enlarged(own: OwnPixels | Scattered, plane: Plane, number: int, labels: Image) -> Plane:
    top, left, bottom, right = own.around(plane.bounding_box)
    its = labels[top:bottom, left:right] == number
    rows, columns = (np.flatnonzero(its.any(axis=axis)) for axis in (1, 0))
    box = top, left, bottom, right
    if rows.size:
        box = top + rows[0], left + columns[0], top + rows[-1] + 1, left + columns[-1] + 1
    return replace(plane, count=int(np.count_nonzero(its)), bounding_box=tuple(map(int, box)))


def own_pixels(depth: object, camera: Camera) -> OwnPixels | Scattered | None:
    """Own pixels of a depth image, where it was enlarged; else None.

    Rows and columns must repeat evenly, each within 1.2 and 16 times: twice, or once and twice by
    turns; but for a few that are like the ones before, and any without readings. Or only every n-th
    row, or column, or both, have readings, a third of the pixels at most. Or they were interpolated
    linearly, within 1.2 and 16 times. Or readings, of depth along z, lie on scattered pixels, as
    evenly as those of a coarser image, or are blocks of pixels, twice to 8 times as wide. Only
    images of a `PinholeCamera` are looked at.

    Raises
    ------
    ValueError
        If it is enlarged, and cannot have been taken by the camera.
    """
    if type(camera) is not PinholeCamera or type(depth) is not np.ndarray or depth.ndim != 2:
        return None
    if depth.dtype.kind not in "fiu":
        return None
    from planewise import compilation  # loads Numba

    compilation.announce("depth image")
    pixels = as_loops_take(depth)
    (rows_alike, row_empty), (columns_alike, column_empty) = (
        _lines_tell(pixels, down=down) for down in (False, True)
    )
    lines = None
    if rows_alike and columns_alike:
        lines = _repeated(depth)
    if lines is None and (row_empty or column_empty):
        lines = _sparse(depth)
    if lines is not None:
        own = depth[np.ix_(lines[0].first, lines[1].first)]
    elif not camera.radial and (blocks := filled(depth, camera)) is not None:
        return blocks
    elif (found := interpolated(depth)) is not None:
        lines, own = found
    else:
        return None if camera.radial else scattered(depth, camera)
    camera.check((depth.shape[0], depth.shape[1]))
    return OwnPixels.of(depth, camera, *lines, own)


def _lines_tell(image: Image, *, down: bool) -> tuple[bool, bool]:
    """Whether two of the middle rows, or columns, are equal, and whether one has no readings.

    image: as loops take it.
    """
    from planewise.kernels.knots import lines_tell  # loads Numba

    height, width = image.shape
    lines, of_each = (width, (height, 1, width)) if down else (height, (width, width, 1))
    first = max(0, lines // 2 - _LOOKED_AT // 2)
    count = min(_LOOKED_AT, lines - first)
    alike, empty = lines_tell(image.reshape(-1), first, count, *of_each)
    return bool(alike), bool(empty)


def _repeated(image: Image) -> tuple[Lines, Lines] | None:
    """Own rows and columns of an image that repeats them."""
    rows, columns = _own_rows(image), _own_rows(image.T)
    return None if rows is None or columns is None else (rows, columns)


def _sparse(image: Image) -> tuple[Lines, Lines] | None:
    """Own rows and columns of an image of which others have no readings."""
    rows, columns = _rows_with_readings(image), _rows_with_readings(image.T)
    if rows is None or columns is None:
        return None
    return (rows, columns) if rows.times * columns.times >= _SPARSE else None


def _equal(image: Image) -> Mask:
    """Whether rows of an image equal those before, missing readings included, shape (H - 1,)."""
    one, next_one = image[:-1], image[1:]
    same = one == next_one
    if image.dtype.kind == "f":
        same |= np.isnan(one) & np.isnan(next_one)
    return np.asarray(same.all(axis=1))


def _has_readings(image: Image) -> Mask:
    """Whether rows have any readings."""
    return np.asarray(has_reading(image).any(axis=1))


def _own_rows(image: Image) -> Lines | None:
    """Own rows of an image that repeats them; None where it does not, or not evenly."""
    first, there = 1 + np.flatnonzero(~_equal(image)), _has_readings(image)
    if len(first) < _FEWEST:
        return None
    gaps = np.diff(first)
    usual = gaps <= max(gaps.min() + 1, 2 * gaps.min() - 1)
    if np.count_nonzero(~usual & there[first[:-1]]) > _ALIKE * len(gaps):
        return None
    # Of rows that are alike, or have no readings, it does not show how many are one.
    off, place = min(
        (
            _off_even(first, np.where(usual, 1.0, np.maximum(1.0, np.rint(gaps / times))))
            for times in gaps[usual].mean() * np.linspace(1 - _ABOUT, 1 + _ABOUT, 41)
        ),
        key=lambda each: each[0],
    )
    times = (first[-1] - first[0]) / place[-1]
    if off >= 1.0 or not _LEAST <= times <= _MOST:
        return None
    most, even = int(np.ceil(times)), np.rint(first[0] + times * np.arange(place[-1] + 1))
    even[place] = first
    start, end = max(0, first[0] - most), min(len(image), first[-1] + most)
    if there[:start].any() or there[end:].any():
        return None
    before = first[0] - times * np.arange(np.ceil((first[0] - most) / times), 0, -1)
    behind = first[-1] + times * np.arange(1, 1 + np.ceil((len(image) - most - first[-1]) / times))
    edges = np.concatenate(([0], np.rint(before), even, np.rint(behind), [len(image)]))
    edges = np.unique(edges.astype(np.intp))
    return Lines(first=edges[:-1], count=np.diff(edges))


def _rows_with_readings(image: Image) -> Lines | None:
    """Every n-th row of an image in which no others have readings; None where they are few."""
    there = np.flatnonzero(_has_readings(image))
    if len(there) < _FEWEST:
        return None
    step = int(np.gcd.reduce(np.diff(there)))
    first = np.arange(there[0] % step, len(image), step)
    return Lines(first=first, count=np.ones_like(first)) if len(first) >= _FEWEST else None


def _off_even(first: Index, steps: NDArray[np.float64]) -> tuple[float, Index]:
    """How far rows so many steps apart are from even ones, at most, and which of these they are."""
    place = np.concatenate(([0.0], np.cumsum(steps)))
    even = first[0] + (first[-1] - first[0]) / place[-1] * place
    return float(np.abs(first - even).max()), place.astype(np.intp)
