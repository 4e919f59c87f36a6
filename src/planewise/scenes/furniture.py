"""Solids that rooms are made of, and how they are arranged.

World frame: x right, y into the room, z up, floor at z = 0, metres. The first solid of an
arrangement is the room itself, seen from inside.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Solid(ABC):
    """Something a ray can meet.

    Attributes
    ----------
    centre : ndarray, shape (3,)
        Metres.
    half : ndarray, shape (3,)
        Half its extent along its own axes.
    colour : tuple of float
        Red, green and blue in 0 ... 1.
    clutter : bool
        Whether its faces are no planes worth finding.
    """

    centre: Array
    half: Array
    colour: tuple[float, float, float]
    clutter: bool = False

    @abstractmethod
    def hit(self, origin: Array, ray: Array) -> tuple[Array, Faces]:
        """Multiples of the rays at which they enter, infinite for a miss, and the faces met."""

    @abstractmethod
    def normal(self, points: Array, face: Faces) -> Array:
        """Outward unit normals at points of the surface."""

    def corners(self) -> Array:
        """Corners of a box around it, shape (8, 3)."""
        return np.array([self.centre + self.half * signs for signs in _SIGNS])

    def paint(self, points: Array, face: Faces) -> Array:
        """Colour at points of the surface."""
        return np.broadcast_to(np.array(self.colour), points.shape)


def turned(points: Array, axes: Array) -> Array:
    """Coordinates of points (k, 3) along the columns of axes, shape (3, k).

    Written out: `matmul` wakes threads for every such product, and waits for them.
    """
    x, y, z = np.ascontiguousarray(points.T)
    return np.stack([a * x + b * y + c * z for a, b, c in axes.T])


_SIGNS = np.array(list(product((-1, 1), repeat=3)))


@dataclass(frozen=True, kw_only=True)
class Block(Solid):
    """Box; the columns of `axes` are its axes. Face 2 i + s is the one at axis i, side s."""

    axes: Array = field(default_factory=lambda: np.eye(3))

    def hit(self, origin: Array, ray: Array) -> tuple[Array, Faces]:
        """Enter through the farthest of the three nearer faces."""
        first, last, along = self._slabs(origin, ray)
        near = first.max(axis=0)
        met = (near < last.min(axis=0)) & (near > 0)
        axis = _which(first, near)
        return np.where(met, near, np.inf), 2 * axis + (_of_axis(along, axis) < 0)

    def _slabs(self, origin: Array, ray: Array) -> tuple[Array, Array, Array]:
        """Where rays enter and leave the three slabs, and their course along the axes, (3, k)."""
        start = turned(origin - self.centre, self.axes)
        along = turned(ray, self.axes)
        inverse = 1 / np.where(along == 0, 1e-300, along)
        half = self.half[:, None]
        low, high = (-half - start) * inverse, (half - start) * inverse
        return np.minimum(low, high), np.maximum(low, high), along

    def normal(self, points: Array, face: Faces) -> Array:
        """Axis of the face, outward."""
        return np.asarray(self.axes.T[face // 2] * np.where(face % 2, 1, -1)[:, None])

    def face_point(self, face: int) -> Array:
        """Return the middle of a face."""
        axis, sign = face // 2, 1 if face % 2 else -1
        return np.asarray(self.centre + sign * self.half[axis] * self.axes[:, axis])

    def corners(self) -> Array:
        """Corners, shape (8, 3)."""
        return np.asarray(self.centre + (_SIGNS * self.half) @ self.axes.T)


@dataclass(frozen=True, kw_only=True)
class Room(Block):
    """Box seen from inside, with floor boards."""

    def hit(self, origin: Array, ray: Array) -> tuple[Array, Faces]:
        """Leave through the nearest of the three farther faces."""
        _, last, along = self._slabs(origin, ray)
        far = last.min(axis=0)
        axis = _which(last, far)
        return far, 2 * axis + (_of_axis(along, axis) > 0)

    def normal(self, points: Array, face: Faces) -> Array:
        """Axis of the face, into the room."""
        return -super().normal(points, face)

    def paint(self, points: Array, face: Faces) -> Array:
        """Boards on the floor, white ceiling, walls in the room's colour."""
        colour = np.tile(self.colour, (len(points), 1))
        colour[face == 5] = (0.92, 0.92, 0.9)
        floor = face == 4
        board = np.floor(points[floor, 0] / 0.14)
        shade = 0.85 + 0.15 * np.sin(board * 12.9898) * np.sin(board * 4.1 + 1)
        shade = np.where(np.abs(points[floor, 0] / 0.14 - board - 0.5) > 0.47, 0.6, shade)
        colour[floor] = np.array((0.62, 0.46, 0.32)) * shade[:, None]
        return colour


@dataclass(frozen=True, kw_only=True)
class Ball(Solid):
    """Sphere of radius ``half[0]``."""

    def hit(self, origin: Array, ray: Array) -> tuple[Array, Faces]:
        """Solve the quadratic for its smaller root."""
        t = _nearer_root(origin - self.centre, ray, self.half[0])
        return t, np.zeros(len(t), np.intp)

    def normal(self, points: Array, face: Faces) -> Array:
        """Away from the centre."""
        return np.asarray((points - self.centre) / self.half[0])


@dataclass(frozen=True, kw_only=True)
class Can(Solid):
    """Upright cylinder of radius ``half[0]``; face 0 is its side, `TOP` its top."""

    TOP: ClassVar[int] = 1

    def hit(self, origin: Array, ray: Array) -> tuple[Array, Faces]:
        """Meet the side between its ends, or the top within its rim."""
        start = origin - self.centre
        side = _nearer_root(start[:, :2], ray[:, :2], self.half[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            height = start[:, 2] + np.where(np.isfinite(side), side, 0) * ray[:, 2]
            side = np.where(np.abs(height) <= self.half[2], side, np.inf)
            top = (self.half[2] - start[:, 2]) / ray[:, 2]
            across = start[:, :2] + top[:, None] * ray[:, :2]
            inside = (top > 0) & (np.einsum("ij,ij->i", across, across) <= self.half[0] ** 2)
        top = np.where(inside, top, np.inf)
        return np.minimum(side, top), (top < side).astype(np.intp)

    def normal(self, points: Array, face: Faces) -> Array:
        """Away from the axis, or up."""
        out = (points - self.centre) / self.half[0]
        out[:, 2] = 0
        out[face == self.TOP] = (0, 0, 1)
        return np.asarray(out)

    def face_point(self, face: int) -> Array:
        """Return the middle of its top."""
        assert face == self.TOP
        return np.asarray(self.centre + np.array((0, 0, self.half[2])))


def _which(rows: Array, row: Array) -> Faces:
    """Which of three rows (3, k) a row (k,) was taken from, the first of equal ones."""
    return np.where(rows[0] == row, 0, np.where(rows[1] == row, 1, 2))


def _of_axis(rows: Array, axis: Faces) -> Array:
    """Entry of three rows (3, k) at an axis for each, shape (k,)."""
    return np.asarray(np.where(axis == 0, rows[0], np.where(axis == 1, rows[1], rows[2])))


def _nearer_root(start: Array, ray: Array, radius: float) -> Array:
    """Smaller positive t of |start + t ray| = radius, infinite where there is none."""
    a = np.einsum("ij,ij->i", ray, ray)
    b = np.einsum("ij,ij->i", start, ray)
    c = np.einsum("ij,ij->i", start, start) - radius**2
    inside = b * b - a * c
    t = (-b - np.sqrt(np.maximum(inside, 0))) / np.maximum(a, 1e-300)
    return np.where((inside > 0) & (t > 0), t, np.inf)


_WALLS = ((0.80, 0.78, 0.72), (0.70, 0.76, 0.80), (0.78, 0.72, 0.70), (0.74, 0.79, 0.70))
_WOODS = ((0.55, 0.38, 0.24), (0.72, 0.56, 0.38), (0.40, 0.28, 0.20), (0.85, 0.83, 0.80))
_PAINTS = (
    (0.75, 0.25, 0.20),
    (0.20, 0.40, 0.65),
    (0.85, 0.65, 0.20),
    (0.25, 0.55, 0.35),
    (0.70, 0.55, 0.42),
    (0.50, 0.30, 0.55),
)


def furnish(rng: np.random.Generator) -> list[Solid]:
    """Arrange a room at random; nothing overlaps on the floor.

    Returns
    -------
    list of Solid
        The room first.
    """
    width, length, height = rng.uniform(3.2, 5.5), rng.uniform(4.0, 6.5), rng.uniform(2.4, 2.9)
    walls = _pick(_WALLS, rng)
    room = Room(
        centre=np.array((0, length / 2, height / 2)),
        half=np.array((width, length, height)) / 2,
        colour=walls,
    )
    floor = _Floor(width, length, rng)
    solids: list[Solid] = [room]
    if rng.random() < 0.6:
        solids.append(_recess(room, floor, walls, rng))
    for _ in range(rng.integers(1, 3)):
        solids += _cabinet(room, floor, rng)
    solids += _table(floor, rng)
    for _ in range(rng.integers(1, 4)):
        solids += _boxes(floor, rng)
    if rng.random() < 0.5:
        solids += _board(room, floor, rng)
    for _ in range(rng.integers(1, 4)):
        radius = rng.uniform(0.1, 0.28)
        if place := floor.free(radius):
            centre = np.array((*place, radius))
            solids.append(_ball(centre, radius, rng))
    if rng.random() < 0.7 and (place := floor.free(0.18)):
        solids.append(
            _can(np.array((*place, 0.0)), rng.uniform(0.1, 0.18), rng.uniform(0.25, 0.6), rng)
        )
    return solids


class _Floor:
    """Free places on the floor; what stands there is kept apart as circles."""

    def __init__(self, width: float, length: float, rng: np.random.Generator) -> None:
        self.width, self.length, self.rng = width, length, rng
        self.taken: list[tuple[float, float, float]] = []

    def free(self, radius: float, front: float = 1.6) -> tuple[float, float] | None:
        """Find room for a circle, at least `front` metres into the room; remember it."""
        for _ in range(30):
            x = self.rng.uniform(radius - self.width / 2, self.width / 2 - radius)
            y = self.rng.uniform(front + radius, max(front + radius + 0.1, self.length - radius))
            if self.take(x, y, radius):
                return x, y
        return None

    def take(self, x: float, y: float, radius: float) -> bool:
        """Claim a circle if it is free."""
        if any(math.hypot(x - a, y - b) < radius + r for a, b, r in self.taken):
            return False
        self.taken.append((x, y, radius))
        return True


def _pick(
    colours: tuple[tuple[float, float, float], ...], rng: np.random.Generator
) -> tuple[float, float, float]:
    return colours[rng.integers(len(colours))]


def _turn(yaw: float, tilt: float = 0.0) -> Array:
    """Axes turned by `yaw` about z after a tilt about x, in radians."""
    c, s = math.cos(yaw), math.sin(yaw)
    ct, st = math.cos(tilt), math.sin(tilt)
    return np.array(((c, -s * ct, s * st), (s, c * ct, -c * st), (0, st, ct)))


def _recess(
    room: Room, floor: _Floor, colour: tuple[float, float, float], rng: np.random.Generator
) -> Solid:
    """Chimney or corner of an L-shaped room: a block from floor to ceiling at the far wall."""
    half = np.array((rng.uniform(0.3, 0.8), rng.uniform(0.2, 0.7), room.half[2]))
    side = rng.choice((-1, 0, 1))
    x = side * (room.half[0] - half[0]) + (rng.uniform(-0.4, 0.4) if side == 0 else 0)
    y = 2 * room.half[1] - half[1]
    floor.take(x, y, float(max(half[:2])))
    return Block(centre=np.array((x, y, half[2])), half=half, colour=colour)


def _cabinet(room: Room, floor: _Floor, rng: np.random.Generator) -> list[Solid]:
    """Cupboard with its back to the far or a side wall."""
    half = np.array((rng.uniform(0.3, 0.7), rng.uniform(0.18, 0.3), rng.uniform(0.35, 0.95)))
    wall = rng.choice(("far", "left", "right"))
    gap = 0.02
    for _ in range(10):
        if wall == "far":
            x = rng.uniform(-1, 1) * (room.half[0] - half[0] - gap)
            y, yaw = 2 * room.half[1] - half[1] - gap, 0.0
        else:
            x = (1 if wall == "right" else -1) * (room.half[0] - half[1] - gap)
            y = rng.uniform(2.0 + half[0], 2 * room.half[1] - half[0] - gap)
            yaw = math.pi / 2
        if floor.take(x, y, float(half[0])):
            block = Block(
                centre=np.array((x, y, half[2])),
                half=half,
                colour=_pick(_WOODS, rng),
                axes=_turn(yaw),
            )
            return [block]
    return []


def _table(floor: _Floor, rng: np.random.Generator) -> list[Solid]:
    """Table on four legs with things on it."""
    half = np.array((rng.uniform(0.45, 0.8), rng.uniform(0.3, 0.45), 0.02))
    place = floor.free(float(half[0]) * 0.9, 1.7)
    if place is None:
        return []
    height, yaw, colour = rng.uniform(0.66, 0.78), rng.uniform(-0.8, 0.8), _pick(_WOODS, rng)
    axes = _turn(yaw)
    middle = np.array((*place, 0.0))
    up = np.array((0, 0, 1.0))
    solids: list[Solid] = [
        Block(centre=middle + (height - 0.02) * up, half=half, colour=colour, axes=axes)
    ]
    leg = np.array((0.025, 0.025, (height - 0.04) / 2))
    for sx, sy in product((-1, 1), repeat=2):
        offset = axes @ np.array((sx * (half[0] - 0.06), sy * (half[1] - 0.06), leg[2]))
        solids.append(
            Block(centre=middle + offset, half=leg, colour=colour, axes=axes, clutter=True)
        )
    top = _Floor(2 * float(half[0]), 2 * float(half[1]), rng)
    for _ in range(rng.integers(1, 4)):
        size = rng.uniform(0.07, 0.17)
        spot = top.free(size * 1.1, 0.0)
        if spot is None:
            continue
        at = middle + axes @ np.array((spot[0], spot[1] - half[1], 0)) + height * up
        kind = rng.random()
        if kind < 0.6:
            box = np.array((size, size * rng.uniform(0.5, 0.9), size * rng.uniform(0.5, 1.2)))
            solids.append(
                Block(
                    centre=at + box[2] * up,
                    half=box,
                    colour=_pick(_PAINTS, rng),
                    axes=_turn(rng.uniform(0, math.pi)),
                )
            )
        elif kind < 0.8:
            solids.append(_ball(at + size * up, size, rng))
        else:
            solids.append(_can(at, size * 0.6, size * 2, rng))
    return solids


def _boxes(floor: _Floor, rng: np.random.Generator) -> list[Solid]:
    """Box on the floor, now and then with a smaller one on top."""
    half = rng.uniform((0.18, 0.15, 0.12), (0.4, 0.35, 0.35))
    place = floor.free(float(math.hypot(half[0], half[1])))
    if place is None:
        return []
    base = 0.0
    solids: list[Solid] = []
    yaw = rng.uniform(0, math.pi)
    for _ in range(1 + (rng.random() < 0.35)):
        solids.append(
            Block(
                centre=np.array((*place, base + half[2])),
                half=half,
                colour=_pick(_PAINTS, rng),
                axes=_turn(yaw),
            )
        )
        base += 2 * float(half[2])
        half, yaw = half * rng.uniform(0.5, 0.8), yaw + rng.uniform(-0.5, 0.5)
    return solids


def _board(room: Room, floor: _Floor, rng: np.random.Generator) -> list[Solid]:
    """Board that leans against the far wall: a plane that is neither level nor upright."""
    half = np.array((rng.uniform(0.3, 0.6), 0.012, rng.uniform(0.45, 0.8)))
    tilt = rng.uniform(0.25, 0.5)
    reach = float(half[2]) * math.sin(tilt)
    x = rng.uniform(-1, 1) * (room.half[0] - half[0] - 0.05)
    y = 2 * room.half[1] - reach - 0.03
    if not floor.take(x, y, float(half[0])):
        return []
    centre = np.array((x, y, half[2] * math.cos(tilt) + 0.01))
    return [Block(centre=centre, half=half, colour=_pick(_WOODS, rng), axes=_turn(0.0, -tilt))]


def _ball(centre: Array, radius: float, rng: np.random.Generator) -> Solid:
    return Ball(centre=centre, half=np.full(3, radius), colour=_pick(_PAINTS, rng), clutter=True)


def _can(base: Array, radius: float, height: float, rng: np.random.Generator) -> Solid:
    return Can(
        centre=base + np.array((0, 0, height / 2)),
        half=np.array((radius, radius, height / 2)),
        colour=_pick(_PAINTS, rng),
        clutter=True,
    )
