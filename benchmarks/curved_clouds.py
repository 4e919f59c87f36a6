"""Clouds of curved surfaces, alone and beside planes, and of planes that meet at small angles.

Every point is on a surface that is known: labels are 0 where it is curved, 1, 2 ... on planes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Labelled = tuple[Array, NDArray[np.int64]]
_FULL = 2.0 * np.pi


def sphere(n: int, radius: float, rng: np.random.Generator, lowest: float = -1.0) -> Array:
    """Sphere, or its part above so many radii."""
    z, turn = rng.uniform(lowest, 1, n), rng.uniform(0, _FULL, n)
    wide = np.sqrt(1 - z * z)
    return radius * np.column_stack((wide * np.cos(turn), wide * np.sin(turn), z))


def cylinder(
    n: int, radius: float, height: float, rng: np.random.Generator, arc: float = _FULL
) -> Array:
    """Side of an upright cylinder, or an arc of it."""
    turn = rng.uniform(0, arc, n)
    return np.column_stack(
        (radius * np.cos(turn), radius * np.sin(turn), rng.uniform(0, height, n))
    )


def capsule(n: int, radius: float, height: float, rng: np.random.Generator) -> Array:
    """Cylinder between two half spheres."""
    sides = round(n * height / (height + 2 * radius))
    ends = sphere(n - sides, radius, rng)
    ends[:, 2] += np.where(ends[:, 2] > 0, height, 0.0)
    return np.vstack((cylinder(sides, radius, height, rng), ends))


def torus(n: int, radius: float, thickness: float, rng: np.random.Generator) -> Array:
    """Torus about the vertical, evenly covered."""
    around, across = rng.uniform(0, _FULL, (2, 4 * n))
    far = radius + thickness * np.cos(across)
    even = np.flatnonzero(rng.uniform(0, radius + thickness, 4 * n) < far)[:n]
    around, across, far = around[even], across[even], far[even]
    return np.column_stack((far * np.cos(around), far * np.sin(around), thickness * np.sin(across)))


def saddle(n: int, width: float, radius: float, rng: np.random.Generator) -> Array:
    """Hyperbolic paraboloid."""
    x, y = rng.uniform(-width / 2, width / 2, (2, n))
    return np.column_stack((x, y, (x * x - y * y) / (2 * radius)))


def cone(n: int, radius: float, height: float, rng: np.random.Generator) -> Array:
    """Side of a cone."""
    out, turn = np.sqrt(rng.uniform(0, 1, n)), rng.uniform(0, _FULL, n)
    r = radius * out
    return np.column_stack((r * np.cos(turn), r * np.sin(turn), height * (1 - out)))


def ellipsoid(n: int, axes: tuple[float, float, float], rng: np.random.Generator) -> Array:
    """Ellipsoid, evenly covered."""
    at = rng.normal(0, 1, (8 * n, 3))
    at /= np.linalg.norm(at, axis=1)[:, None]
    density = np.linalg.norm(at / np.array(axes), axis=1)
    even = rng.uniform(0, density.max(), len(at)) < density
    return np.asarray(at[even][:n] * axes)


def terrain(n: int, width: float, rng: np.random.Generator) -> Array:
    """Rolling ground: six waves, each some 3 % as high as it is long."""
    at, z = rng.uniform(0, width, (n, 2)), np.zeros(n)
    for _ in range(6):
        length, turn = rng.uniform(0.3, 0.8) * width, rng.uniform(0, _FULL)
        along = at @ (np.cos(turn), np.sin(turn))
        height = 0.04 * length * rng.uniform(0.5, 1)
        z += height * np.sin(_FULL * (along / length + rng.uniform()))
    return np.column_stack((at, z))


def column(n: int, sides: int, radius: float, height: float, rng: np.random.Generator) -> Labelled:
    """Upright prism of so many faces."""
    face, along = rng.integers(0, sides, n), rng.uniform(0, 1, (n, 1))
    turn = _FULL * np.arange(sides + 1) / sides
    corner = radius * np.column_stack((np.cos(turn), np.sin(turn)))
    flat = corner[face] + along * (corner[face + 1] - corner[face])
    return np.column_stack((flat, rng.uniform(0, height, n))), face + 1


def walls(n: int, degrees: float, rng: np.random.Generator) -> Labelled:
    """Two walls of 3 x 2.5 m that meet at an angle."""
    along, half = rng.uniform(-3, 3, n), np.radians(180 - degrees) / 2
    x, y = along * np.cos(half), -np.abs(along) * np.sin(half)
    return np.column_stack((x, y, rng.uniform(0, 2.5, n))), 1 + (along > 0)


def room(
    n: int, size: tuple[float, float, float], rng: np.random.Generator, ceiling: bool = True
) -> tuple[Array, NDArray[np.int64], float]:
    """Floor, ceiling and walls of a room; the points on a square metre, too."""
    x, y, z = np.diag(size)
    low = np.zeros(3)
    faces = [(low, x, y), (low, x, z), (low, y, z), (y, x, z), (x, y, z)]
    faces += [(z, x, y)] if ceiling else []
    areas = np.array([np.linalg.norm(np.cross(u, v)) for _, u, v in faces])
    counts = (n * areas / areas.sum()).astype(int)
    points = []
    for (corner, u, v), count in zip(faces, counts, strict=True):
        s, t = rng.uniform(0, 1, (2, count, 1))
        points.append(corner + s * u + t * v)
    return np.vstack(points), np.repeat(np.arange(len(faces)) + 1, counts), n / float(areas.sum())


ALONE: dict[str, Callable[[int, np.random.Generator], Array]] = {
    "sphere": lambda n, rng: sphere(n, 1.0, rng),
    "cylinder": lambda n, rng: cylinder(n, 0.5, 3.0, rng),
    "half a cylinder": lambda n, rng: cylinder(n, 3.0, 8.0, rng, np.pi),
    "capsule": lambda n, rng: capsule(n, 0.25, 1.3, rng),
    "pipe": lambda n, rng: cylinder(n, 0.1, 5.0, rng),
    "cone": lambda n, rng: cone(n, 0.6, 1.5, rng),
    "ellipsoid": lambda n, rng: ellipsoid(n, (2.0, 1.0, 0.6), rng),
    "saddle": lambda n, rng: saddle(n, 4.0, 3.0, rng),
    "torus": lambda n, rng: torus(n, 1.0, 0.35, rng),
    "terrain": lambda n, rng: terrain(n, 40.0, rng),
    "dome of 30 m": lambda n, rng: sphere(n, 30.0, rng, 0.5),
}


def beside_planes(n: int, rng: np.random.Generator) -> Iterator[tuple[str, Labelled]]:
    """Rooms and houses of some n points with something curved."""

    def with_it(flat: Array, labels: NDArray[np.int64], curved: Array) -> Labelled:
        return np.vstack((flat, curved)), np.append(labels, np.zeros(len(curved), np.int64))

    flat, labels, dense = room(n, (5.0, 4.0, 2.8), rng)
    ball = sphere(round(dense * 2 * _FULL * 0.6**2), 0.6, rng) + np.array((2.5, 2.0, 0.6))
    yield "sphere on a floor", with_it(flat, labels, ball)
    pipe = cylinder(round(dense * _FULL * 0.5), 0.1, 5.0, rng)[:, [2, 0, 1]]
    yield "pipe along a wall", with_it(flat, labels, pipe + np.array((0.0, 0.15, 2.0)))
    post = cylinder(round(dense * _FULL * 0.4 * 2.8), 0.4, 2.8, rng) + np.array((2.5, 2.0, 0.0))
    yield "round column in a room", with_it(flat, labels, post)
    flat, labels, dense = room(n, (6.0, 6.0, 3.0), rng, ceiling=False)
    dome = sphere(round(dense * _FULL * 9), 3.0, rng, 0.0) + np.array((3.0, 3.0, 3.0))
    yield "dome over four walls", with_it(flat, labels, dome)
    vault = cylinder(round(dense * np.pi * 18), 3.0, 6.0, rng, np.pi)[:, [0, 2, 1]]
    yield "barrel vault on walls", with_it(flat, labels, vault + np.array((3.0, 0.0, 3.0)))
    flat, labels, _ = room(n // 2, (4.0, 4.0, 4.0), rng)
    up = labels > 1
    house = flat[up] + np.array((8.0, 8.0, 0.0))
    yield "house on rolling ground", with_it(house, labels[up] - 1, terrain(n // 2, 20.0, rng))


def only_planes(n: int, rng: np.random.Generator) -> Iterator[tuple[str, Labelled]]:
    """Columns of many faces and walls that meet at small angles."""
    for sides in (6, 8, 12, 16, 24):
        yield f"column of {sides} faces", column(n, sides, 1.0, 3.0, rng)
    for degrees in (170, 175, 177):
        yield f"walls at {degrees} degrees", walls(n, degrees, rng)


def curved_clouds(n: int, sigma: float, seed: int = 0) -> Iterator[tuple[str, Labelled]]:
    """All of them, with noise in every coordinate."""
    rng = np.random.default_rng(seed)
    clouds: list[tuple[str, Labelled]] = []
    for name, points_of in ALONE.items():
        points = points_of(n, rng)
        clouds.append((name, (points, np.zeros(len(points), np.int64))))
    for name, (points, labels) in [*clouds, *beside_planes(n, rng), *only_planes(n, rng)]:
        yield name, (points + rng.normal(0, sigma, points.shape), labels)
