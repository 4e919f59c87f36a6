"""Picture of a point cloud and its planes: seen obliquely from above, without perspective."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.drawing.overlay import Picture, annotate
from planewise.drawing.palette import distinct_colours
from planewise.model import PlaneModel
from planewise.outlines.occupancy import share_in_surfaces
from planewise.outlines.outlines import Surface

Array = NDArray[np.float64]
Labels = NDArray[np.integer]

_WIDTH, _LEAST_HEIGHT, _MOST_HEIGHT = 1200, 500, 900
_MARGIN = 0.06
_ELEVATION, _TURN = np.radians(38), np.radians(25)
_MOST_POINTS = 3_000_000
_ENOUGH = 20_000  # points that tell which side to look from
_BLOCKS = (1, 2, 3, 4, 5, 7, 9, 12, 16, 24)  # pixels between which points may leave gaps
_LARGEST_DOT, _LONE_DOT = 6.0, 4.0  # radius in pixels; where they leave larger ones
_HIDES = 0.25  # share of the other points from which a plane that hides them is cut away
_MOST_CUTS = 2
_LONGEST_LINE = 5000  # pixels
_LOOSE = 0.3  # what a point on no plane counts when a side is chosen; one seen face on counts 1
_BEHIND = 20  # pixels from which a point is behind another, not beside it
_OUTSIDE = 1e9  # pixels from the middle of any picture
_LAMP = np.array((0.45, 0.5, -0.75)) / np.linalg.norm((0.45, 0.5, -0.75))  # right, up, ahead
_BACKGROUND, _NONE, _INK = (250, 250, 248), (150, 152, 156), (28, 30, 34)


@dataclass(frozen=True, kw_only=True)
class _Eye:
    """From where a cloud is seen: to the right, up and ahead, and the middle of the picture."""

    axes: Array  # rows
    middle: Array
    centre: Array  # of the picture, along the first two axes from the middle, metres
    metres: float  # of a pixel
    shape: tuple[int, int]

    def place(self, xyz: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Pixel rows and columns of points, and how far away they are."""
        x, y, depth = ((xyz - self.middle) @ axis for axis in self.axes)
        column = self.shape[1] / 2 + (x - self.centre[0]) / self.metres
        row = self.shape[0] / 2 - (y - self.centre[1]) / self.metres
        whole = [
            np.floor(each.clip(-_OUTSIDE, _OUTSIDE)).astype(np.int64) for each in (row, column)
        ]
        return whole[0], whole[1], depth


@dataclass(frozen=True, kw_only=True)
class _View:
    """Where the points of a cloud appear."""

    eye: _Eye
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    depth: Array

    @property
    def shape(self) -> tuple[int, int]:
        return self.eye.shape

    @property
    def metres(self) -> float:
        return self.eye.metres


@np.errstate(over="ignore", invalid="ignore")  # of damaged points, which may be of any size
def draw_cloud(
    points: NDArray[np.floating], model: PlaneModel, *, surfaces: Sequence[Surface] = ()
) -> Picture:
    """Draw a cloud, its planes in colours with their ranks, and a legend beside it.

    z is up. Planes that hide much of the rest, such as a ceiling, are cut away, and a line at the
    bottom says so.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        Metres. Of more than 3 million every n-th is drawn.
    model : PlaneModel
        Of these points.
    surfaces : sequence of Surface
        Outlines to draw over them.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3)
    """
    step = max(1, -(-len(points) // _MOST_POINTS))
    labels = model.labels[::step]
    xyz = points[::step].astype(np.float64)
    keep = np.isfinite(xyz).all(axis=1)
    xyz, labels = xyz[keep], labels[keep]
    if not len(xyz):
        blank = np.full((_LEAST_HEIGHT, _WIDTH, 3), _BACKGROUND, np.uint8)
        return annotate(blank, np.zeros(blank.shape[:2], np.uint16), model)
    some = slice(None, None, max(1, len(xyz) // _ENOUGH))
    side = max(range(4), key=lambda side: _openness(xyz[some], labels[some], side, model))
    view = _look(xyz, labels, side)
    shown = np.ones(len(xyz), bool)
    cut: list[int] = []
    nearest = _nearest(view, shown)
    radius = _dot(nearest)
    while len(cut) < _MOST_CUTS:
        plane = _curtain(view, labels, _splat(view, nearest, radius), len(model))
        if plane is None:
            break
        cut.append(plane)
        shown &= labels != plane
        nearest = _nearest(view, shown)
    nearest = _splat(view, nearest, _dot(nearest))
    seen = np.where(nearest >= 0, labels[nearest], 0).astype(np.uint16)
    picture = _shade(view, nearest, seen, model)
    depth = np.where(nearest >= 0, view.depth[nearest], np.inf)
    for surface in surfaces:
        if surface.plane not in cut:
            for ring in (ring for rings in surface.rings for ring in rings):
                _line(picture, view.eye, depth, ring)
    words = f"cut away: {', '.join(map(str, sorted(cut)))}" if cut else ""
    return annotate(picture, seen, model, note=words)


def _openness(xyz: Array, labels: Labels, side: int, model: PlaneModel) -> float:
    """How many points are not hidden from a side, less for planes that are seen at their edge."""
    view = _look(xyz, labels, side)
    nearest = _nearest(view, np.ones(len(xyz), bool))
    hidden = _hidden(view, labels, _splat(view, nearest, _dot(nearest)))[0]
    facing = [abs(float(plane.normal @ view.eye.axes[2])) for plane in model.planes]
    return float(np.array([_LOOSE, *facing])[labels[~hidden]].sum())


def _look(xyz: Array, labels: Labels, side: int) -> _View:
    """Turn the longest way of the cloud to the right, then a little, and look down on it.

    `side` is the number of quarter turns after that.
    """
    main = xyz[labels > 0] if np.count_nonzero(labels) > 100 else xyz
    middle = np.median(main, axis=0)
    flat = (main - middle)[:, :2]
    spread = np.clip(flat, *np.percentile(flat, (1, 99), axis=0))
    angle = np.linalg.eigh(np.cov(spread.T) if len(spread) > 2 else np.eye(2))[1][:, 1]
    turn = np.arctan2(angle[1], angle[0]) % np.pi - _TURN + side * np.pi / 2
    right = np.array((np.cos(turn), np.sin(turn), 0.0))
    ahead = np.array((-np.sin(turn), np.cos(turn), 0.0))
    into = np.cos(_ELEVATION) * ahead - np.sin(_ELEVATION) * np.array((0, 0, 1))
    up = np.cross(right, into)
    axes = np.stack((right, up, into))
    low, high = np.percentile((xyz - middle) @ axes[:2].T, (0.2, 99.8), axis=0)
    wide, tall = np.maximum(high - low, 1e-9)
    height = int(np.clip(_WIDTH * tall / wide, _LEAST_HEIGHT, _MOST_HEIGHT))
    eye = _Eye(
        axes=axes,
        middle=middle,
        centre=(low + high) / 2,
        metres=float(max(wide / _WIDTH, tall / height)) * (1 + 2 * _MARGIN),
        shape=(height, _WIDTH),
    )
    row, column, depth = eye.place(xyz)
    return _View(eye=eye, row=row, column=column, depth=depth)


def _nearest(view: _View, shown: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Which point is seen at each pixel, -1 for none, shape (H, W)."""
    height, width = view.shape
    inside = (view.row >= 0) & (view.row < height) & (view.column >= 0) & (view.column < width)
    index = np.flatnonzero(inside & shown)
    index = index[np.argsort(-view.depth[index], kind="stable")]  # the last one written stays
    out = np.full(view.shape, -1)
    out[view.row[index], view.column[index]] = index
    return out


def _hidden(
    view: _View, labels: Labels, nearest: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which points lie well behind another plane, and the point in front of each."""
    height, width = view.shape
    front = nearest[view.row.clip(0, height - 1), view.column.clip(0, width - 1)]
    deeper = view.depth - view.depth[front] > _BEHIND * view.metres
    return (front >= 0) & deeper & (labels[front] != labels), front


def _curtain(view: _View, labels: Labels, nearest: NDArray[np.int64], planes: int) -> int | None:
    """Plane behind which the most other points are hidden, if those are many."""
    hidden, front = _hidden(view, labels, nearest)
    hides = np.bincount(labels[front[hidden]], minlength=planes + 1)
    hides[0] = 0
    plane = int(hides.argmax())
    others = np.count_nonzero(labels != plane)
    return plane if plane and hides[plane] > _HIDES * others else None


def _dot(nearest: NDArray[np.int64]) -> float:
    """Radius in pixels of dots between which surfaces look closed."""
    row, column = np.nonzero(nearest >= 0)
    for side in _BLOCKS:
        held = np.zeros(np.array(nearest.shape) // side + 1, bool)
        held[row // side, column // side] = True
        if share_in_surfaces(held)[1]:
            return min(0.7 * side, _LARGEST_DOT)
    return _LONE_DOT


def _splat(view: _View, nearest: NDArray[np.int64], radius: float) -> NDArray[np.int64]:
    """Make dots of single pixels; the one that is nearer covers the other."""
    row, column = np.nonzero(nearest >= 0)
    index = nearest[row, column]
    order = np.argsort(-view.depth[index], kind="stable")  # the last one written stays
    reach = np.arange(-int(radius), int(radius) + 1)
    dy, dx = (each.ravel() for each in np.meshgrid(reach, reach, indexing="ij"))
    dot = np.hypot(dy, dx) <= radius
    height, width = nearest.shape
    edge = int(radius)  # around the picture, for the dots at its border
    stride = width + 2 * edge
    out = np.full((height + 2 * edge, stride), -1)
    middle = (row + edge) * stride + column + edge
    out.reshape(-1)[middle[order, None] + dy[dot] * stride + dx[dot]] = index[order, None]
    return out[edge : edge + height, edge : edge + width]


def _moved(image: NDArray, dy: int, dx: int, empty: float) -> NDArray:  # type: ignore[type-arg]
    """Shift an image; what comes in is empty."""
    out = np.full_like(image, empty)
    height, width = image.shape
    out[max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)] = image[
        max(-dy, 0) : height + min(-dy, 0), max(-dx, 0) : width + min(-dx, 0)
    ]
    return out


def _shade(view: _View, nearest: NDArray[np.int64], seen: Labels, model: PlaneModel) -> Picture:
    """Colour of each plane in the light that falls on it; what lies behind an edge is darker."""
    colours = np.vstack((_NONE, distinct_colours(len(model)))).astype(np.float32)
    lamp = _LAMP @ view.eye.axes
    for label, plane in enumerate(model.planes, start=1):
        colours[label] *= 0.72 + 0.36 * abs(float(plane.normal @ lamp))
    picture = colours[seen]
    picture *= _edges(view, nearest)[..., None]
    picture[nearest < 0] = _BACKGROUND
    return np.asarray(np.round(picture.clip(0, 255, out=picture)), np.uint8)


def _line(picture: Picture, eye: _Eye, depth: Array, ring: Array) -> None:
    """Draw a closed line where no point hides it."""
    for start, end in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        pixels = int(np.linalg.norm(eye.axes[:2] @ (end - start)) / eye.metres * 1.5) + 2
        way = start + np.linspace(0, 1, min(pixels, _LONGEST_LINE))[:, None] * (end - start)
        row, column, away = eye.place(way)
        inside = (row > 0) & (row < eye.shape[0]) & (column > 0) & (column < eye.shape[1])
        row, column, away = row[inside], column[inside], away[inside]
        free = away < depth[row, column] + _BEHIND * eye.metres
        for shift in ((0, 0), (1, 0), (0, 1), (1, 1)):
            picture[row[free] - shift[0], column[free] - shift[1]] = _INK


def _edges(view: _View, nearest: NDArray[np.int64]) -> NDArray[np.float32]:
    """Darkening by neighbours that are nearer to the eye (eye-dome lighting, Boucheny 2009)."""
    pixels = np.where(nearest >= 0, view.depth[nearest] / view.metres, np.inf)
    depth = pixels.astype(np.float32)
    total = np.zeros(view.shape, np.float32)
    for dy, dx in ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)):
        with np.errstate(invalid="ignore"):
            step = depth - _moved(depth, 2 * dy, 2 * dx, np.inf)
        step[~np.isfinite(step)] = 0
        total += step.clip(0, 40, out=step)
    return np.asarray(0.45 + 0.55 * np.exp(-total / 120), np.float32)
