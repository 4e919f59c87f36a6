"""Outlines of the planes of a point cloud: the cells of a grid on the plane that hold points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import checked_points, is_finite
from planewise.copies import places_of
from planewise.model import PlaneModel, checked_model
from planewise.outlines.label_borders import regions
from planewise.outlines.occupancy import FEWEST, MOST_CELLS, counts, derive_cells, neighbours
from planewise.outlines.outlines import PlaneFrame, Surface, load_shapely, surfaces_of

Array = NDArray[np.float64]

_MITRE = 2.0
_STRAIGHT = 1.5  # cells; a straight border at any angle becomes one line
_NARROW = 0.25  # of a narrow strip's cells across: they are not straightened by more
_ENOUGH = 50_000  # points that tell the direction of the grid


def outline_points(
    model: PlaneModel,
    points: ArrayLike,
    *,
    spacing: float | None = None,
    instances: bool = False,
) -> tuple[Surface, ...]:
    """Outline the planes of a point cloud.

    Points are dropped on their plane and into the cells of a grid that lies along their smallest
    rectangle. Cells with points, and cells that those enclose, make the surface; its border is
    simplified by up to 1.5 cells and drawn in by what cells reach beyond random points on the mean.
    A hole or gap has to be about two cells wide to be seen.

    Parameters
    ----------
    model : PlaneModel
        Of these points.
    points : array_like, shape (k, 3)
        As it was found in.
    spacing : float, optional
        Side of a cell in metres; at least two lie across a surface. ``None`` derives it for each
        plane: the smallest cells that make a surface, most of them with five neighbours or more and
        with few gaps between them; for random points some three to six in a cell.
    instances : bool
        One surface for each connected piece, numbered from the largest; otherwise one a plane.

    Returns
    -------
    tuple of Surface
        By plane. One without polygons where the points span no area, except with `instances`.

    Raises
    ------
    ValueError
        If points and labels do not belong together, or the spacing is not positive.
    MissingExtraError
        Without shapely (extra 'cloud').
    """
    points = checked_points(points, 3)
    if checked_model(model).labels.shape != points.shape[:1]:
        raise ValueError(
            f"points must have shape (k, 3), a row for each of the model's labels "
            f"{model.labels.shape}, got {points.shape}"
        )
    if spacing is not None and not (is_finite(spacing) and spacing > 0):
        raise ValueError(f"spacing must be a positive number of metres, got {spacing!r}")
    load_shapely()
    there = np.isfinite(points).all(axis=1)
    labels = model.labels if there.all() else np.where(there, model.labels, 0)
    places = places_of(np.ascontiguousarray(points))
    if places is not None:  # copies say nothing of how densely points lie
        points, labels = points[places.rows], labels[places.rows]
    order = np.argsort(labels, kind="stable")
    ends = np.searchsorted(labels[order], np.arange(len(model) + 2))
    out: list[Surface] = []
    for label, plane in enumerate(model.planes, start=1):
        frame = PlaneFrame.of(plane)
        rows = order[ends[label] : ends[label + 1]]
        flat = frame.to_plane(points[rows].astype(np.float64))
        out.extend(surfaces_of(label, frame, _pieces(flat, spacing), instances=instances))
    return tuple(out)


def _pieces(flat: Array, spacing: float | None) -> list[Any]:
    """Connected pieces of points (k, 2) as polygons of shapely."""
    shapely = load_shapely()
    turn = _along(flat)
    if turn is None:
        return []
    local = flat @ turn.T
    low = local.min(axis=0)
    local -= low
    extent = local.max(axis=0)
    sides = derive_cells(local) if spacing is None else np.minimum(spacing, extent / 2)
    sides *= max(1.0, float(extent[0]) / (MOST_CELLS * float(sides[0])))
    overhang = _overhang(counts(local, sides))
    # Cells that reach beyond the outermost points by what they do on the mean.
    number = np.maximum(np.round(extent / sides + 2 * overhang), 1)
    sides = extent / (number - 2 * overhang)
    cells = counts(local + overhang * sides, sides) > 0
    for _ in range(2):
        cells |= neighbours(cells) >= 6
    start = low - (1 + overhang) * sides  # of the grid, whose margin is one empty cell

    def back(cell: Array) -> Array:
        return np.asarray(((cell + 0.5) * sides + start) @ turn)

    out = []
    straight = min(_STRAIGHT, _NARROW * float(number.min()))
    for piece in regions(cells.T.astype(np.uint8), straight).get(1, []):
        drawn_in = piece.buffer(-overhang, join_style="mitre", mitre_limit=_MITRE)
        out += [
            shapely.transform(each, back) for each in shapely.get_parts(drawn_in) if each.area > 0.5
        ]
    return out


def _overhang(counts: NDArray[np.int64]) -> float:
    """How far cells reach beyond a border of random points on the mean, in cells.

    A cell of which the part f is inside holds none of its points with probability exp(-n f), n the
    points of a whole one. It adds 1 - f where it does, else takes f away: the mean over f is
    1/2 - (1 - exp(-n)) / n, if there are enough of them that it is positive.
    """
    held = counts > 0
    inner = held & (neighbours(held) == 8)
    n = float(counts[inner if inner.any() else held].mean())
    return max(0.5 - (1 - math.exp(-n)) / n, 0.0)


def _along(flat: Array) -> Array | None:
    """Rotation of points into the frame of their smallest rectangle; None where they are a line."""
    shapely = load_shapely()
    if len(flat) < FEWEST:
        return None
    hull = shapely.MultiPoint(_outermost(flat)).convex_hull
    if hull.geom_type != "Polygon":
        return None
    box = np.array(hull.minimum_rotated_rectangle.exterior.coords)
    sides = np.diff(box[:3], axis=0)
    lengths = np.hypot(*sides.T)
    if lengths.min() < 1e-6 * lengths.max():
        return None
    axis = sides[np.argmax(lengths)] / lengths.max()
    return np.array(((axis[0], axis[1]), (-axis[1], axis[0])))


def _outermost(flat: Array) -> Array:
    """Points furthest out in some of 360 directions; their hull is close to that of all."""
    flat = flat[:: max(1, len(flat) // _ENOUGH)]
    if len(flat) < 1000:
        return flat
    angles = np.radians(np.arange(180.0))
    found: set[int] = set()
    for direction in np.stack((np.cos(angles), np.sin(angles)), axis=1):
        along = flat @ direction
        found |= {int(along.argmin()), int(along.argmax())}
    return np.asarray(flat[sorted(found)])
