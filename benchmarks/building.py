"""A generated building as a scanner would see it: rooms on floors, openings, furniture, clutter.

Every flat surface has a label of its own (1, 2 ...); spheres, cylinders and stray points are 0.
Points are denser near the scanner that stands in each room.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ROOM = (5.0, 4.0, 2.8)  # metres
_WALL = 0.2
_TOLERANCE = 0.04  # metres by which a room leaves its place and its size
_STRAY = 0.01  # share of the points that lie anywhere in the building
_NEAR = 1.5  # metres from the scanner beyond which density falls


@dataclass(frozen=True)
class Building:
    """Points, shape (k, 3), metres, and their labels, shape (k,), 0 for no plane."""

    points: Array
    labels: NDArray[np.int32]


@dataclass
class _Surfaces:
    """Rectangles corner + s u + t v, s and t in [0, 1], some with a hole; and round things."""

    corner: list[Array] = field(default_factory=list)
    u: list[Array] = field(default_factory=list)
    v: list[Array] = field(default_factory=list)
    hole: list[tuple[float, float, float, float]] = field(default_factory=list)
    scanner: list[Array] = field(default_factory=list)
    balls: list[tuple[Array, float, Array]] = field(default_factory=list)
    columns: list[tuple[Array, float, float, Array]] = field(default_factory=list)

    def add(
        self,
        corner: Array,
        u: Array,
        v: Array,
        scanner: Array,
        hole: tuple[float, float, float, float] = (0, 0, 0, 0),
    ) -> None:
        self.corner.append(corner)
        self.u.append(u)
        self.v.append(v)
        self.scanner.append(scanner)
        self.hole.append(hole)

    def box(self, low: Array, size: Array, turn: float, scanner: Array) -> None:
        """Sides and top of a box that is turned about the vertical."""
        c, s = np.cos(turn), np.sin(turn)
        x, y, z = size[0] * np.array([c, s, 0]), size[1] * np.array([-s, c, 0]), size[2]
        up = np.array([0, 0, z])
        self.add(low, x, up, scanner)
        self.add(low, y, up, scanner)
        self.add(low + x, y, up, scanner)
        self.add(low + y, x, up, scanner)
        self.add(low + up, x, y, scanner)


def building(
    count: int,
    *,
    sigma: float = 0.01,
    floors: int = 2,
    rooms: tuple[int, int] = (3, 2),
    seed: int = 0,
) -> Building:
    """Make a building.

    Parameters
    ----------
    count : int
        Points, about.
    sigma : float
        Standard deviation of the noise in every coordinate, metres.
    floors : int
        Storeys.
    rooms : (int, int)
        Rooms of a storey along x and y.
    seed : int
        Of everything random.

    Returns
    -------
    Building
        Points in random order.
    """
    rng = np.random.default_rng(seed)
    surfaces = _Surfaces()
    size = np.array(_ROOM)
    for floor in range(floors):
        for i in range(rooms[0]):
            for j in range(rooms[1]):
                low = np.array([i, j, floor]) * (size + np.array((_WALL, _WALL, 0.3)))
                # No two rooms are built alike.
                shift = rng.uniform(-_TOLERANCE, _TOLERANCE, (2, 3))
                _room(surfaces, low + shift[0], size + shift[1], rng)
    points, labels = _sample(surfaces, count, rng)
    extent = points.max(axis=0) - points.min(axis=0)
    stray = rng.uniform(0, 1, (int(_STRAY * count), 3)) * extent + points.min(axis=0)
    points = np.vstack((points, stray))
    labels = np.concatenate((labels, np.zeros(len(stray), np.int32)))
    points += rng.normal(0, sigma, points.shape)
    order = rng.permutation(len(points))
    return Building(points[order], labels[order])


def _room(surfaces: _Surfaces, low: Array, size: Array, rng: np.random.Generator) -> None:
    x, y, z = np.diag(size)
    scanner = low + size * [rng.uniform(0.3, 0.7), rng.uniform(0.3, 0.7), 0.5]
    surfaces.add(low, x, y, scanner)
    surfaces.add(low + z, x, y, scanner)
    for k, (corner, along) in enumerate(((low, x), (low, y), (low + y, x), (low + x, y))):
        at = rng.uniform(0.1, 0.6)
        door, window = (at, 0.0, at + 0.2, 0.75), (at, 0.3, at + 0.3, 0.8)
        hole = (door, window, (0.0,) * 4, (0.0,) * 4)[(k + int(rng.integers(4))) % 4]
        surfaces.add(corner, along, z, scanner, hole)
    for _ in range(3):
        place = low + np.array((*(rng.uniform(0.15, 0.7, 2) * size[:2]), 0.0))
        turn = rng.uniform(0, np.pi)
        if rng.random() < 0.5:  # a table: top and four legs
            top = rng.uniform(0.8, 1.4), rng.uniform(0.6, 0.9)
            c, s = np.cos(turn), np.sin(turn)
            along, across = top[0] * np.array([c, s, 0]), top[1] * np.array([-s, c, 0])
            surfaces.add(place + np.array((0, 0, 0.72)), along, across, scanner)
            for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
                foot = a * (top[0] - 0.05), b * (top[1] - 0.05)
                at_foot = place + np.array(
                    (foot[0] * c - foot[1] * s, foot[0] * s + foot[1] * c, 0)
                )
                surfaces.columns.append((at_foot, 0.03, 0.7, scanner))
        else:  # a cabinet
            cabinet = np.array([rng.uniform(0.4, 1.2), rng.uniform(0.3, 0.6), rng.uniform(0.4, 2)])
            surfaces.box(place, cabinet, turn, scanner)
    for _ in range(2):
        radius = rng.uniform(0.1, 0.35)
        place = low + np.array((*(rng.uniform(0.15, 0.85, 2) * size[:2]), radius))
        surfaces.balls.append((place, radius, scanner))
    place = low + np.array((*(rng.uniform(0.15, 0.85, 2) * size[:2]), 0.0))
    surfaces.columns.append((place, rng.uniform(0.08, 0.25), rng.uniform(0.5, 2.5), scanner))


def _sample(
    surfaces: _Surfaces, count: int, rng: np.random.Generator
) -> tuple[Array, NDArray[np.int32]]:
    corner, u, v = np.array(surfaces.corner), np.array(surfaces.u), np.array(surfaces.v)
    hole, scanner = np.array(surfaces.hole), np.array(surfaces.scanner)
    flat = np.linalg.norm(np.cross(u, v), axis=1)
    balls = np.array([4 * np.pi * r**2 for _, r, _ in surfaces.balls])
    columns = np.array([2 * np.pi * r * h for _, r, h, _ in surfaces.columns])
    area = np.concatenate((flat, balls, columns))
    # Some are thrown away below.
    chosen = rng.choice(len(area), size=int(2.6 * count), p=area / area.sum())
    s, t = rng.uniform(0, 1, (2, len(chosen)))
    points = np.empty((len(chosen), 3))
    views = np.empty((len(chosen), 3))
    labels = np.zeros(len(chosen), np.int32)
    keep = np.ones(len(chosen), np.bool_)
    rect = chosen < len(flat)
    k = chosen[rect]
    points[rect] = corner[k] + s[rect, None] * u[k] + t[rect, None] * v[k]
    views[rect], labels[rect] = scanner[k], k + 1
    a, b, c, d = hole[k].T
    keep[rect] = ~((s[rect] > a) & (s[rect] < c) & (t[rect] > b) & (t[rect] < d))
    for i, (centre, radius, view) in enumerate(surfaces.balls):
        mine = chosen == len(flat) + i
        z, turn = 2 * s[mine] - 1, 2 * np.pi * t[mine]
        ring = np.sqrt(1 - z**2)
        points[mine] = centre + radius * np.stack([ring * np.cos(turn), ring * np.sin(turn), z], 1)
        views[mine] = view
    for i, (foot, radius, height, view) in enumerate(surfaces.columns):
        mine = chosen == len(flat) + len(balls) + i
        turn = 2 * np.pi * t[mine]
        points[mine] = foot + np.stack(
            [radius * np.cos(turn), radius * np.sin(turn), height * s[mine]], 1
        )
        views[mine] = view
    square = ((points - views) ** 2).sum(axis=1)
    keep &= rng.uniform(0, 1, len(chosen)) < 1 / (1 + square / _NEAR**2) ** 0.5
    index = np.flatnonzero(keep)[:count]
    return points[index], labels[index]
