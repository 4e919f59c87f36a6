"""What a LiDAR, a laser scanner or a panoramic camera reads of solids all around it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planewise.scenes.furniture import Solid
from planewise.scenes.rooms import Hits, View, cast, truth
from planewise.scenes.scene import Scene
from planewise.sensor import Sensor
from planewise.spherical import SphericalCamera


def checked_scan(sigma: float, lost: float) -> None:
    """Refuse noise in metres and a share of lost readings that no scan has.

    Raises
    ------
    ValueError
        Which names what is wrong.
    """
    if not (math.isfinite(sigma) and sigma > 0):
        raise ValueError(f"sigma must be a positive number of metres, got {sigma}")
    if not 0 <= lost < 1:
        raise ValueError(f"lost must be a share of the readings below 1, got {lost}")


def upright(position: tuple[float, float, float], heading: float) -> View:
    """Upright sensor that stands there and looks in a direction about the vertical, in radians."""
    c, s = math.cos(heading), math.sin(heading)
    return View(
        position=np.array(position),
        rotation=np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))),
    )


def scan(
    solids: list[Solid],
    view: View,
    camera: SphericalCamera,
    sensor: Sensor,
    sigma: float,
    lost: float,
    rng: np.random.Generator,
    *,
    every_face: bool = False,
) -> Scene:
    """Scene of whole steps of range with white noise sigma, readings lost at random."""
    hit = cast(solids, view, camera, camera.shape)
    seen = (hit.depth <= sensor.max_depth) & (rng.random(camera.shape) >= lost)
    labels, planes = truth(solids, view, hit, seen, every_face)
    ranges = hit.depth + sigma * rng.standard_normal(camera.shape)
    seen &= (ranges >= sensor.min_depth) & (ranges <= sensor.max_depth)
    return Scene(
        depth=np.where(seen, np.round(ranges / sensor.resolution), 0).astype(np.uint16),
        camera=camera,
        sensor=sensor,
        labels=np.where(seen, labels, 0).astype(np.uint16),
        planes=planes,
        rgb=_lit(hit, seen),
    )


def _lit(hit: Hits, seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Picture by the light of the sensor."""
    light = 255 * (0.35 + 0.65 * np.clip(hit.cosine, 0, 1))
    return np.repeat(np.where(seen, light, 0)[..., None], 3, axis=2).astype(np.uint8)
