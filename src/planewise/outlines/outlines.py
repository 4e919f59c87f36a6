"""Bounded planes: where on its plane a surface lies, as polygons with holes.

Plane coordinates (a, b) are metres along two orthonormal axes u and v of the plane, u x v = normal,
from an origin on it: the point is origin + a u + b v. u is the axis x, y or z that is most nearly
parallel to the plane (the first of them if several are), turned into it; so a wall that faces a
camera has u to the right. The origin is the place of the plane nearest to the centroid of its
readings.

Shells of polygons run counter-clockwise in these coordinates, holes clockwise: seen from the side
that the normal points to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import needs
from planewise.model import Plane

Array = NDArray[np.float64]


def dot(points: Array, axis: Array) -> Array:
    """Products with an axis (3,), shape (...), of points (..., 3): the same of equal ones.

    Matrix products round them by their places, and rings then do not close.
    """
    x, y, z = np.moveaxis(points, -1, 0)
    return np.asarray(x * axis[0] + y * axis[1] + z * axis[2])


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneFrame:
    """Coordinates on a plane.

    Attributes
    ----------
    origin : ndarray, shape (3,)
        Point of the plane, metres.
    u, v, normal : ndarray, shape (3,)
        Orthonormal, u x v = normal.
    """

    origin: Array
    u: Array
    v: Array
    normal: Array

    @classmethod
    def of(cls, plane: Plane) -> PlaneFrame:
        """Frame of a plane, by the convention of this module."""
        normal = np.asarray(plane.normal, np.float64)
        axis = np.zeros(3)
        axis[np.argmin(np.abs(normal))] = 1.0
        u = axis - (axis @ normal) * normal
        u /= np.linalg.norm(u)
        off = normal @ plane.centroid + plane.distance
        return cls(origin=plane.centroid - off * normal, u=u, v=np.cross(normal, u), normal=normal)

    def to_plane(self, points: Array) -> Array:
        """Coordinates (a, b), shape (..., 2), of the feet of points, shape (..., 3)."""
        away = points - self.origin
        return np.stack((dot(away, self.u), dot(away, self.v)), axis=-1)

    def to_space(self, coordinates: Array) -> Array:
        """Points, shape (..., 3), at coordinates (a, b), shape (..., 2)."""
        return np.asarray(self.origin + coordinates @ np.stack((self.u, self.v)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Polygon:
    """A shell and its holes in plane coordinates; rings are not closed by a repeated point.

    Attributes
    ----------
    shell : ndarray, shape (n, 2)
        Counter-clockwise, metres.
    holes : tuple of ndarray, shape (m, 2)
        Clockwise, inside the shell.
    """

    shell: Array
    holes: tuple[Array, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Extent:
    """Smallest rectangle, however turned, around a surface.

    Attributes
    ----------
    centre : ndarray, shape (2,)
        In plane coordinates, metres.
    length, width : float
        Longer and shorter side, metres.
    angle : float
        From u to the longer side in radians, 0 <= angle < pi.
    """

    centre: Array
    length: float
    width: float
    angle: float


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class Surface:
    """The bounded part of a plane, or one connected piece of it.

    Attributes
    ----------
    plane : int
        Label of its plane: ``model.planes[plane - 1]``.
    surface : int
        Number of the piece on its plane, the largest first; 0 for all pieces of a plane together.
    frame : PlaneFrame
        Plane coordinates.
    polygons : tuple of Polygon
        Largest first; they do not overlap. Empty where the readings span no area.
    area : float
        Without the holes, square metres.
    extent : Extent, optional
        Smallest rectangle around it; ``None`` where there is no polygon.
    """

    plane: int
    surface: int
    frame: PlaneFrame
    polygons: tuple[Polygon, ...]
    area: float
    extent: Extent | None

    @cached_property
    def rings(self) -> list[list[Array]]:
        """Shell and holes of each polygon in space, rings of shape (n, 3), metres."""
        to_space = self.frame.to_space
        return [[to_space(ring) for ring in (each.shell, *each.holes)] for each in self.polygons]

    @property
    def corners(self) -> Array:
        """Corners of the extent in space, shape (4, 3), or (0, 3) without one."""
        if self.extent is None:
            return np.empty((0, 3))
        e = self.extent
        long = e.length / 2 * np.array((np.cos(e.angle), np.sin(e.angle)))
        wide = e.width / 2 * np.array((-np.sin(e.angle), np.cos(e.angle)))
        return self.frame.to_space(
            e.centre + np.array((-long - wide, long - wide, long + wide, wide - long))
        )


def load_shapely() -> Any:
    """Import shapely, or say which extra has it."""
    with needs("shapely", "outlines of planes", "cloud"):
        import shapely  # type: ignore[import-untyped, import-not-found, unused-ignore]
    return shapely


def surfaces_of(
    plane: int, frame: PlaneFrame, pieces: Sequence[Any], *, instances: bool
) -> list[Surface]:
    """Make surfaces of polygons of shapely in plane coordinates.

    Parameters
    ----------
    plane : int
        Label of their plane.
    frame : PlaneFrame
        Its coordinates.
    pieces : sequence of shapely.Polygon
        Connected pieces.
    instances : bool
        One surface a piece; otherwise one for all, without any if there is no piece.
    """
    shapely = load_shapely()
    ordered = sorted(pieces, key=lambda piece: -piece.area)
    groups = [[piece] for piece in ordered] if instances else [ordered]
    return [
        Surface(
            plane=plane,
            surface=number if instances else 0,
            frame=frame,
            polygons=tuple(_polygon(shapely, piece) for piece in group),
            area=float(sum(piece.area for piece in group)),
            extent=_extent(shapely, group) if group else None,
        )
        for number, group in enumerate(groups, start=1)
    ]


def _polygon(shapely: Any, piece: Any) -> Polygon:
    turned = shapely.orient_polygons(piece)
    return Polygon(shell=_ring(turned.exterior), holes=tuple(map(_ring, turned.interiors)))


def _ring(ring: Any) -> Array:
    return np.array(ring.coords, np.float64)[:-1, :2]


def _extent(shapely: Any, pieces: Sequence[Any]) -> Extent:
    box = np.array(shapely.MultiPolygon(pieces).minimum_rotated_rectangle.exterior.coords)
    sides = np.diff(box[:3], axis=0)
    lengths = np.hypot(*sides.T)
    long = sides[np.argmax(lengths)]
    return Extent(
        centre=box[:4].mean(axis=0),
        length=float(lengths.max()),
        width=float(lengths.min()),
        angle=float(np.arctan2(long[1], long[0]) % np.pi % np.pi),  # of -1e-17 once is pi
    )


def as_shapely(surface: Surface) -> Any:
    """A surface as a MultiPolygon of shapely in plane coordinates."""
    shapely = load_shapely()
    return shapely.MultiPolygon([(each.shell, each.holes) for each in surface.polygons])
