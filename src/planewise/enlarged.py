"""Depth that was enlarged by repeating pixels, as to the size of a picture: its own pixels.

A reading that is there k times has one error, not k, and cells of few pixels hold hardly one of
them. So such an image is searched at the size that it had.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Camera, PinholeCamera
from planewise.model import Plane, PlaneModel

Edges = NDArray[np.intp]
Image = NDArray[Any]

_LEAST, _MOST = 1.2, 16.0  # times as wide
_LOOKED_AT = 7  # rows, or columns, of which two are equal where that is more than `_LEAST`
_FEWEST = 16  # own rows and columns: fewer repeat by chance


@dataclass(frozen=True, kw_only=True, eq=False)
class OwnPixels:
    """Which rows and columns of an enlarged image are one of its own.

    Attributes
    ----------
    rows, columns : ndarray of int, shape (h + 1,), (w + 1,)
        First of those that are own row or column i, rising; the last is behind all of them. What is
        before and behind has no readings.
    shape : (H, W)
        Of the enlarged image.
    depth : ndarray, shape (h, w)
        The image of own pixels.
    camera : PinholeCamera
        That of own pixels.
    """

    rows: Edges
    columns: Edges
    shape: tuple[int, int]
    depth: Image
    camera: PinholeCamera

    @classmethod
    def of(cls, image: Image, camera: PinholeCamera, rows: Edges, columns: Edges) -> OwnPixels:
        """Own pixels of an enlarged image and its camera."""
        fx, cx = _own(columns, camera.fx, camera.cx)
        fy, cy = _own(rows, camera.fy, camera.cy)
        depth = image[np.ix_(rows[:-1], columns[:-1])]
        height, width = depth.shape
        own = replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, height=height, width=width)
        shape = image.shape[0], image.shape[1]
        return cls(rows=rows, columns=columns, shape=shape, depth=depth, camera=own)

    def enlarge(self, image: Image) -> Image:
        """An image of own pixels, enlarged; 0 where they have none."""
        out = np.zeros(self.shape, image.dtype)
        inside = np.repeat(image, np.diff(self.rows), axis=0)
        out[self.rows[0] : self.rows[-1], self.columns[0] : self.columns[-1]] = np.repeat(
            inside, np.diff(self.columns), axis=1
        )
        return out

    def enlarged(self, model: PlaneModel, readings: Edges) -> PlaneModel:
        """A model of own pixels as one of the enlarged image; readings: places of the own ones.

        Labels, counts and bounding boxes are those of the enlarged image; all else knows of every
        reading once, and settings say the own size.
        """
        labels, there = self.enlarge(model.labels), np.zeros(self.depth.shape, np.bool_)
        there.flat[readings] = True
        counts = np.bincount(labels.ravel(), minlength=len(model) + 1)[1:].tolist()
        return replace(
            model,
            labels=labels,
            planes=tuple(map(self._enlarged, model.planes, counts)),
            readings=int(np.count_nonzero(self.enlarge(there))),
            settings={**model.settings, "own_size": list(self.depth.shape)},
        )

    def _enlarged(self, plane: Plane, count: int) -> Plane:
        top, left, bottom, right = plane.bounding_box
        rows, columns = self.rows[[top, bottom]].tolist(), self.columns[[left, right]].tolist()
        return replace(plane, count=count, bounding_box=(rows[0], columns[0], rows[1], columns[1]))


def own_pixels(depth: object, camera: Camera) -> OwnPixels | None:
    """Own pixels of a depth image, where it was enlarged to the nearest ones; else None.

    Rows and columns must repeat evenly all over, each within 1.2 and 16 times: twice, or once and
    twice by turns. Only images of a `PinholeCamera` are looked at.
    """
    if type(camera) is not PinholeCamera or type(depth) is not np.ndarray or depth.ndim != 2:
        return None
    if depth.dtype.kind not in "fiu" or not (_may_repeat(depth) and _may_repeat(depth.T)):
        return None
    rows, columns = _edges(depth), _edges(depth.T)
    if rows is None or columns is None:
        return None
    return OwnPixels.of(depth, camera, rows, columns)


def _equal(image: Image) -> NDArray[np.bool_]:
    """Whether rows of an image equal those before, missing readings included, shape (H - 1,)."""
    one, next_one = image[:-1], image[1:]
    same = one == next_one
    if image.dtype.kind == "f":
        same |= np.isnan(one) & np.isnan(next_one)
    return np.asarray(same.all(axis=1))


def _may_repeat(image: Image) -> bool:
    """Whether some of the rows in the middle equal those before."""
    first = max(0, image.shape[0] // 2 - _LOOKED_AT // 2)
    return bool(_equal(image[first : first + _LOOKED_AT]).any())


def _edges(image: Image) -> Edges | None:
    """`OwnPixels.rows`; None where rows do not repeat evenly."""
    first = 1 + np.flatnonzero(~_equal(image))
    if len(first) < _FEWEST:
        return None
    times = (first[-1] - first[0]) / (len(first) - 1)
    most = int(np.ceil(times))
    gaps = np.diff(first)
    even = first[0] + times * np.arange(len(first))
    if not (
        _LEAST <= times <= _MOST
        and gaps.min() >= np.floor(times)
        and gaps.max() <= most
        and np.abs(first - even).max() < 1.0
    ):
        return None
    start, end = max(0, first[0] - most), min(len(image), first[-1] + most)
    for outside in (image[:start], image[end:]):  # has no rows of its own, and must need none
        if (np.isfinite(outside) & (outside != 0)).any():
            return None
    return np.concatenate(([start], first, [end]))


def _own(edges: Edges, focal: float, centre: float) -> tuple[float, float]:
    """Focal length and principal point, of rows or columns, in own pixels."""
    middle = (edges[1:] + edges[:-1] - 1) / 2
    middle = middle[1:-1]  # the first and the last may be cut
    times = (middle[-1] - middle[0]) / (len(middle) - 1)
    first = float(np.mean(middle - times * np.arange(1, len(middle) + 1)))
    return focal / float(times), (centre - first) / float(times)
