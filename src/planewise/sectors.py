"""Sectors of an image: parts in which inverse depth is affine on every plane.

A pinhole image is one sector. Unit directions around a full turn have no coordinates in which all
planes are affine, so a panorama is cut into upright sectors. Within one, about its middle azimuth,

    z = range c,   w = 1 / z = t0 + t1 x + t2 y,   c = cos(elevation) cos(azimuth - middle),

with (x, y) the gnomonic projection, which is what a pinhole camera looking there would see. Sectors
lie side by side with gaps without readings between them, wide enough for no loop over neighbours to
see from one into the next; margins in the gaps show what lies beyond a seam in the coordinates of
the sector beside them, where pixels get their labels. What is known of a plane, P and P t of a row
(`kernels.cells`), is carried from one sector to another exactly: theta = turn t, and P is a sum
over d d', d the unit direction of a reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planewise import prices
from planewise.flatness import LEAN
from planewise.kernels.cells import SIDE, UNIT
from planewise.kernels.turns import turn_rows
from planewise.ranks import ranks

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Scalar = TypeVar("Scalar", bound=np.generic)

SQUARE = 2 * SIDE  # pixels of a square of cells
BLOCK = 3 * SQUARE  # columns in which squares and groups begin together
GAP = 4 * SQUARE  # columns between sectors: the farthest that cells in a row lie apart
_MARGIN = 9  # columns beyond a seam that are shown in a gap ...
_FAR = np.radians(10.0)  # ... and how wide they are at most
_POLE = np.radians(89.999)  # of elevation: straight up and down there are no coordinates
_WIDEST = np.radians(61.0)  # of azimuth: at its edges coordinates are stretched by a third


def _no_columns() -> NDArray[np.intp]:
    return np.empty(0, np.intp)


@dataclass(frozen=True)
class Sectors:
    """Coordinates of the pixels of an image, sector by sector.

    Attributes
    ----------
    x, y : ndarray of float32, shape (H, W')
        Undistorted pixel coordinates about the middle of each sector, divided by 100.
    straight : bool
        Whether `x` is the same in every row and `y` in every column.
    focal : (float, float)
        Pixels of usual width and height to a metre at z = 1.
    turn : ndarray, shape (K, 3, 3)
        theta = turn t for the plane w = t0 + t1 x + t2 y of each sector.
    column : ndarray of int, shape (W',), optional
        Column of the image, -1 in a gap; ``None`` where both are one and the same.
    start, stop : ndarray of int, shape (K,)
        First column of each sector, and the one behind its last.
    ratio : ndarray of float32, shape (H, W'), optional
        c = z / range, 1 in gaps; ``None`` where depth is z.
    wraps : bool
        Whether the last sector is beside the first one.
    margin, beyond : ndarray of int
        Columns of margins, and the columns that they show.
    """

    x: Image
    y: Image
    straight: bool
    focal: tuple[float, float]
    turn: Array
    column: NDArray[np.intp] | None
    start: NDArray[np.intp]
    stop: NDArray[np.intp]
    ratio: Image | None = None
    wraps: bool = False
    margin: NDArray[np.intp] = field(default_factory=_no_columns)
    beyond: NDArray[np.intp] = field(default_factory=_no_columns)

    @cached_property
    def count(self) -> int:
        """Number of sectors, K."""
        return len(self.turn)

    @cached_property
    def axes(self) -> Array:
        """Axes of every sector, (K, 3, 3): the columns point along x, along y, and outwards."""
        along = self.turn[..., [1, 2, 0]]
        return np.asarray(along / np.linalg.norm(along, axis=1, keepdims=True))

    @cached_property
    def home(self) -> NDArray[np.int32]:
        """Sector of every column of the image, shape (W,)."""
        if self.column is None:
            return np.zeros(self.x.shape[1], np.int32)
        return self.of_columns(np.flatnonzero(self.column >= 0))

    @cached_property
    def coordinates(self) -> tuple[Image, Image]:
        """x and y for loops that look at few pixels.

        Where the image is straight, x has one row and y one column: these stay in the cache.
        """
        if not self.straight:
            return self.x, self.y
        return self.x[:1].copy(), self.y[:, :1].copy()

    @cached_property
    def mean_focal(self) -> float:
        """Geometric mean of `focal`."""
        return math.sqrt(self.focal[0] * self.focal[1])

    @property
    def lean(self) -> float:
        """Change of w over 100 pixels, against w, of a piece of a surface that leans by `LEAN`."""
        return LEAN * UNIT / self.mean_focal

    @property
    def slants(self) -> tuple[float, float]:
        """a and b of (range / z)^2 = 1 / c^2 = 1 + a x^2 + b y^2."""
        return (UNIT / self.focal[0]) ** 2, (UNIT / self.focal[1]) ** 2

    @cached_property
    def oblique(self) -> tuple[float, float]:
        """`slants`; 0 where depth is z."""
        return (0.0, 0.0) if self.ratio is None else self.slants

    @cached_property
    def mean_ratio(self) -> float:
        """Root mean square of c: depth z against range of a usual reading."""
        if self.ratio is None:
            return 1.0
        return float(np.sqrt(np.mean(np.square(self.image(self.ratio), dtype=np.float64))))

    @cached_property
    def width(self) -> int:
        """Columns of the image, W."""
        return self.x.shape[1] if self.column is None else int(np.count_nonzero(self.column >= 0))

    @cached_property
    def fineness(self) -> float:
        """`prices.fineness` of the image."""
        return prices.fineness(len(self.x) * self.width)

    def price(self, factor: float, parameters: float) -> float:
        """Nats that a plane has to save: `factor` times its parameters in a fine image."""
        return prices.price(factor, parameters, self.fineness)

    @cached_property
    def _slices(self) -> list[slice]:
        """Columns of each sector, whose pixels are those of the image in order."""
        return list(map(slice, self.start.tolist(), self.stop.tolist()))

    def spread(self, w: Image, p: Image) -> tuple[Image, Image]:
        """Inverse depth and its precision in sectors, from inverse range and precision (H, W).

        Where the image is one sector they are written there. Margins have inverse depth, but
        precision 0: their readings count where they are.
        """
        if self.ratio is None:
            return w, p
        if self.column is None:
            w /= self.ratio
            p *= self.ratio
            p *= self.ratio
            return w, p
        out_w, out_p = np.zeros((2, *self.ratio.shape), np.float32)
        end = 0
        for here in self._slices:
            c, begin, end = self.ratio[:, here], end, end + here.stop - here.start
            np.divide(w[:, begin:end], c, out=out_w[:, here])
            np.multiply(p[:, begin:end], c * c, out=out_p[:, here])
        inverse_range = out_w[:, self.beyond] * self.ratio[:, self.beyond]
        out_w[:, self.margin] = inverse_range / self.ratio[:, self.margin]
        return out_w, out_p

    def image(self, sectors: NDArray[Scalar]) -> NDArray[Scalar]:
        """Put what is known by pixel of the sectors, (H, W'), back in its place in the image."""
        if self.column is None:
            return sectors
        return np.concatenate([sectors[:, here] for here in self._slices], axis=1)

    def labels(self, image: NDArray[np.integer]) -> NDArray[np.integer]:
        """Labels n K + k + 1 in sectors, (H, W'), of the labels n + 1 of an image; 0 for none."""
        if self.column is None:
            return image
        out = np.where(self.column >= 0, np.take(image, self.column, axis=1), 0)
        sector = self.of_columns(np.arange(self.column.size))
        return np.where(out > 0, (out - 1) * self.count + sector + 1, 0)

    def of_columns(self, columns: NDArray[np.intp]) -> NDArray[np.int32]:
        """Sector of some columns, those of margins included."""
        before = np.searchsorted(self.start - _MARGIN, columns, side="right")
        return np.asarray(before - 1, np.int32)

    def turned(self, rows: Array, home: NDArray[np.integer], turns: Array) -> Array:
        """Rows (n, E) of segments in other coordinates.

        Parameters
        ----------
        rows : ndarray, shape (n, at least 9)
            P and P t first (`kernels.cells`); what follows does not depend on coordinates.
        home : ndarray of int, shape (n,)
            Sector in whose coordinates each is.
        turns : ndarray, shape (K, 3, 3)
            B, of every sector, with P' = B P B' and P' t' = B P t.
        """
        out = np.empty_like(rows)
        turn_rows(rows, home.astype(np.int32, copy=False), np.ascontiguousarray(turns), out)
        return out

    @cached_property
    def turns(self) -> Array:
        """B, from one sector to another: shape (K, K, 3, 3)."""
        return _back(self.turn[:, None], self.turn[None])

    @cached_property
    def seams(self) -> Array:
        """Turn about the seam behind each sector, half-way to the next one's: shape (K, 3, 3)."""
        scale = turn_to_theta((1.0 / self.focal[0], 1.0 / self.focal[1]))
        axes = (self.turn + np.roll(self.turn, -1, axis=0)) @ np.linalg.inv(scale)
        return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True) @ scale)

    @cached_property
    def seam_turns(self) -> Array:
        """B, from one sector to the coordinates about the seam behind another: (K, K, 3, 3)."""
        return _back(self.turn[:, None], self.seams[None])

    def everywhere(self, rows: Array, home: NDArray[np.integer]) -> Array:
        """Rows (n, E) in the coordinates of every sector: (K, n, E). home (n,): sector of each."""
        if self.count == 1:
            return rows[None]
        return np.stack([self.turned(rows, home, self.turns[:, k]) for k in range(self.count)])

    def together(self, rows: Array) -> Array:
        """Sums over all sectors in the coordinates of each: rows (N K, E), of plane n and sector k.

        `rows[n K + k]` is what sector k says of plane n, in its own coordinates.
        """
        if self.count == 1:
            return rows
        planes = len(rows) // self.count
        first = self.turned(rows, np.tile(np.arange(self.count), planes), self.turns[:, 0])
        total = first.reshape(planes, self.count, rows.shape[1]).sum(axis=1)
        every = self.everywhere(total, np.zeros(planes, np.intp))
        return np.ascontiguousarray(every.swapaxes(0, 1)).reshape(rows.shape)

    def summed(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """Sums (N, ...) over the sectors of what is known by plane and sector, (N K, ...)."""
        if self.count == 1:
            return values
        return np.asarray(values.reshape(-1, self.count, *values.shape[1:]).sum(axis=1))

    def repeated(self, values: NDArray[Scalar]) -> NDArray[Scalar]:
        """What is known by plane (N, ...) for every plane and sector, (N K, ...)."""
        return values if self.count == 1 else np.repeat(values, self.count, axis=0)

    def places(self, order: NDArray[np.intp], planes: int) -> NDArray[np.uint16]:
        """Rank 1 ... of every label (N K + 1,) by the order of planes; 0 for those left out."""
        place = ranks(order, planes)
        if self.count == 1:
            return place
        return np.concatenate((place[:1], self.repeated(place[1:])))

    def affine(self, theta: Array) -> Array:
        """(t0, t1, t2) in every sector, (N K, 3), of planes theta (N, 3)."""
        inverse = np.linalg.inv(self.turn)
        return np.asarray(np.einsum("kij,nj->nki", inverse, theta).reshape(-1, 3))

    def metres(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Coordinates on the plane z = 1, in metres."""
        return x * (UNIT / self.focal[0]), y * (UNIT / self.focal[1])

    def stretch(self, x: NDArray[np.floating], y: NDArray[np.floating]) -> Array:
        """Range / z in directions given by coordinates, whether depth is z or range."""
        (a, b), x, y = self.slants, x.astype(np.float64), y.astype(np.float64)
        return np.asarray(np.sqrt(1.0 + a * x * x + b * y * y))

    def squared_stretch(
        self, x: NDArray[np.floating], y: NDArray[np.floating]
    ) -> NDArray[np.floating]:
        """(range / z)^2 = 1 / c^2 in directions given by coordinates; 1 where depth is z."""
        a, b = self.oblique
        return 1.0 + a * x * x + b * y * y


def _back(source: Array, turn: Array) -> Array:
    """B with P' = B P B' and P' t' = B P t: B = M^-T for t' = M t."""
    both = np.broadcast_arrays(source, turn)  # NumPy 1 takes a matrix beside a stack for vectors
    return np.ascontiguousarray(np.swapaxes(np.linalg.solve(*both), -1, -2))


def turn_to_theta(pixel_size: tuple[float, float]) -> Array:
    """Matrix that makes theta, theta . x = 1 for the points of a plane, of (t0, t1, t2)."""
    du, dv = pixel_size
    return np.array([[0, 1 / (UNIT * du), 0], [0, 0, 1 / (UNIT * dv)], [1, 0, 0]])


def one_sector(
    u: Array, v: Array, focal: tuple[float, float], straight: bool, *, radial: bool = False
) -> Sectors:
    """Sectors of a pinhole image through (u, v, 1), with these focal lengths in pixels.

    radial: its readings are distances, range rather than z.
    """
    return Sectors(
        x=(u * (focal[0] / UNIT)).astype(np.float32),
        y=(v * (focal[1] / UNIT)).astype(np.float32),
        straight=straight,
        focal=focal,
        turn=turn_to_theta((1.0 / focal[0], 1.0 / focal[1]))[None],
        column=None,
        start=np.zeros(1, np.intp),
        stop=np.array([u.shape[1]]),
        ratio=(1.0 / np.sqrt(1.0 + u * u + v * v)).astype(np.float32) if radial else None,
    )


def of_panorama(
    azimuth: Array, elevation: Array, pixel_size: tuple[float, float], wraps: bool
) -> Sectors:
    """Sectors of directions around an upright axis.

    Parameters
    ----------
    azimuth, elevation : ndarray, shape (H, W)
        Radians; azimuth is continuous along a row.
    pixel_size : (float, float)
        Radians between columns and between rows.
    wraps : bool
        Whether the last column is beside the first one.

    Returns
    -------
    Sectors
    """
    along, width = azimuth.mean(axis=0), azimuth.shape[1]
    edges = _edges(width, abs(along[-1] - along[0]) * width / (width - 1))
    count = len(edges) - 1
    wraps &= count > 1
    pitch = -(-(int(np.diff(edges).max()) + GAP) // BLOCK) * BLOCK
    start = pitch * np.arange(count) + (BLOCK if wraps else 0)
    stop = start + np.diff(edges)
    margin, beyond = _margins(start, stop, min(_MARGIN, int(_FAR / pixel_size[0])), wraps)
    column = np.full(max(int(stop[-1]), margin.max(initial=-1) + 1), -1)
    for k in range(count):
        column[start[k] : stop[k]] = np.arange(edges[k], edges[k + 1])
    shown = column.copy()
    shown[margin] = column[beyond]

    x, y = np.zeros((2, len(azimuth), column.size), np.float32)
    ratio = np.ones(x.shape, np.float32)
    turn = np.empty((count, 3, 3))
    sense = np.sign(along[-1] - along[0])  # x grows along a row ...
    fall = np.sign(elevation[-1, 0] - elevation[0, 0])  # ... and y down a column
    for k in range(count):
        middle = 0.5 * (along[edges[k]] + along[edges[k + 1] - 1])
        turn[k] = looking(middle, sense, fall) @ turn_to_theta(pixel_size)
        at = np.arange(max(start[k] - _MARGIN, 0), min(stop[k] + _MARGIN, column.size))
        at = at[shown[at] >= 0]
        apart, level = azimuth[:, shown[at]] - middle, elevation[:, shown[at]].clip(-_POLE, _POLE)
        x[:, at] = sense * np.tan(apart) / (UNIT * pixel_size[0])
        y[:, at] = fall * np.tan(level) / np.cos(apart) / (UNIT * pixel_size[1])
        ratio[:, at] = np.cos(level) * np.cos(apart)
    return Sectors(
        x=x,
        y=y,
        straight=False,
        focal=(1.0 / pixel_size[0], 1.0 / pixel_size[1]),
        turn=turn,
        column=column,
        start=start,
        stop=stop,
        ratio=ratio,
        wraps=wraps,
        margin=margin,
        beyond=beyond,
    )


def _edges(width: int, span: float) -> NDArray[np.intp]:
    """First column of every sector of an image that spans so many radians, and its width.

    Sectors are whole squares, but for columns so far apart that few make a sector.
    """
    count = max(1, int(np.ceil(span / _WIDEST)))
    whole = SQUARE if 2 * SQUARE * span < _WIDEST * width else 1
    edges = whole * np.rint(np.linspace(0, width / whole, count + 1)).astype(np.intp)
    edges[-1] = width
    return np.unique(np.minimum(edges, width))


def _margins(
    start: NDArray[np.intp], stop: NDArray[np.intp], size: int, wraps: bool
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Columns beside both ends of every seam, and those that they show."""
    left = np.arange(len(start) if wraps else len(start) - 1)
    right, place = (left + 1) % len(start), np.arange(size)
    before, behind = stop[left, None] - 1 - place, start[right, None] + place
    margin = stop[left, None] + place, start[right, None] - 1 - place
    return np.concatenate(margin, axis=None), np.concatenate((behind, before), axis=None)


def looking(azimuth: float, sense: float, fall: float) -> Array:
    """Matrix whose columns are the axes of a sector, in a frame with x forward, y left, z up.

    Along a row (`sense` of the azimuth), down a column (`fall` of the elevation), and outwards.
    """
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.array([[-s * sense, 0.0, c], [c * sense, 0.0, s], [0.0, fall, 0.0]])
