"""Synthetic streets as a spinning LiDAR sees them, by ray casting, with true planes.

World frame: x along the street, y to the left, z up, ground at z = 0, metres.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from planewise import cameras, sensors
from planewise.arguments import checked_seed
from planewise.noise import constant
from planewise.scenes.furniture import Ball, Block, Can, Room, Solid
from planewise.scenes.scans import checked_scan, scan, upright
from planewise.scenes.scene import Array, Scene, Seed
from planewise.spherical import SphericalCamera

_FAR = 500.0  # metres: the sky, beyond what any sensor sees
_GREY = (0.6, 0.6, 0.6)


def street(
    seed: Seed = 0,
    *,
    camera: SphericalCamera | None = None,
    sigma: float = 0.02,
    lost: float = 0.02,
) -> Scene:
    """Street between buildings, with cars and clutter, seen by a LiDAR on a car.

    Parameters
    ----------
    seed : int or numpy.random.Generator
        Every seed is another street.
    camera : SphericalCamera, optional
        ``None`` means `planewise.cameras.OUSTER_OS1_64`.
    sigma : float
        Standard deviation of the white noise of a range, in metres.
    lost : float
        Share of the readings that are missing at random.

    Returns
    -------
    Scene
        Ranges in millimetres; planes in the frame of the LiDAR: x forward, y left, z up. Faces that
        cover less than 0.25 % of the image, trees and poles are clutter: label 0.
    """
    checked_scan(sigma, lost)
    rng = np.random.default_rng(checked_seed("seed", seed))
    solids = _arrange(rng)
    heading = rng.uniform(-math.pi, math.pi)
    view = upright((0.0, rng.uniform(-1, 1), rng.uniform(1.7, 1.9)), heading)
    sensor = replace(
        sensors.OUSTER_OS1, noise=constant(sigma), resolution=0.001, max_depth=65.0, parts=None
    )
    return scan(solids, view, camera or cameras.OUSTER_OS1_64, sensor, sigma, lost, rng)


def _arrange(rng: np.random.Generator) -> list[Solid]:
    """Ground, buildings on both sides, parked cars, trees and poles; the sky last."""
    solids: list[Solid] = [_box((0.0, 0.0, -0.5), (_FAR / 2, _FAR / 2, 0.5))]
    for side in (-1, 1):
        line, x = rng.uniform(8, 11), -60.0 + rng.uniform(0, 10)
        while x < 60.0:
            length, height = rng.uniform(10, 22), rng.uniform(5, 14)
            front = line + rng.uniform(0, 3)
            turn = rng.normal(0, 0.02)
            centre = (x + length / 2, side * (front + 5.0), height / 2)
            solids.append(_box(centre, (length / 2, 5.0, height / 2), turn))
            x += length + rng.choice((0.0, rng.uniform(2, 6)))
        for _ in range(rng.integers(3, 6)):
            centre = (rng.uniform(-25, 25), side * rng.uniform(5, 6), 0.75)
            if abs(centre[0]) > 3.0:
                solids.append(_box(centre, (2.1, 0.9, 0.75), rng.normal(0, 0.05)))
        for _ in range(rng.integers(2, 5)):
            at = np.array((rng.uniform(-30, 30), side * rng.uniform(6.8, 7.5), 0.0))
            crown, size = at + np.array((0.0, 0.0, 3.8)), np.full(3, rng.uniform(0.8, 1.5))
            solids.append(Ball(centre=crown, half=size, colour=_GREY, clutter=True))
            solids.append(_can(at, 0.15, 3.0))
            solids.append(_can(at + np.array((rng.uniform(2, 4), 0.0, 0.0)), 0.08, 6.0))
    solids.append(Room(centre=np.zeros(3), half=np.full(3, _FAR), colour=_GREY, clutter=True))
    return solids


def _box(
    centre: tuple[float, float, float], half: tuple[float, float, float], turn: float = 0.0
) -> Block:
    c, s = math.cos(turn), math.sin(turn)
    return Block(
        centre=np.array(centre),
        half=np.array(half),
        colour=_GREY,
        axes=np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))),
    )


def _can(foot: Array, radius: float, height: float) -> Can:
    half = np.array((radius, radius, height / 2))
    centre = foot + np.array((0.0, 0.0, height / 2))
    return Can(centre=centre, half=half, colour=_GREY, clutter=True)
