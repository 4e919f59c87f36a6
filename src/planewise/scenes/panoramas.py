"""Synthetic rooms as a laser scanner in them sees all around, by ray casting, with true planes."""

from __future__ import annotations

import math

import numpy as np

from planewise.arguments import checked_seed
from planewise.noise import constant
from planewise.scenes.furniture import furnish
from planewise.scenes.rooms import cast
from planewise.scenes.scans import checked_scan, scan, upright
from planewise.scenes.scene import Scene, Seed
from planewise.sensor import Sensor
from planewise.spherical import SphericalCamera

_PREVIEW = 32  # rows
_CLEAR = 0.3  # metres about the scanner
_ATTEMPTS = 200


def panorama(
    seed: Seed = 0,
    *,
    camera: SphericalCamera | None = None,
    sigma: float = 0.002,
    lost: float = 0.0,
    every_face: bool = False,
) -> Scene:
    """Furnished room about a laser scanner, or a panoramic camera, that stands in it.

    Parameters
    ----------
    seed : int or numpy.random.Generator
        Every seed is another room.
    camera : SphericalCamera, optional
        ``None`` means `SphericalCamera.panorama` of 512 rows.
    sigma : float
        Standard deviation of the white noise of a range, in metres.
    lost : float
        Share of the readings that are missing at random.
    every_face : bool
        Label every flat face in view, however small; table legs and tops of cylinders, too.

    Returns
    -------
    Scene
        Ranges in millimetres; planes in the frame of the scanner: x forward, y left, z up. Faces
        that cover less than 0.25 % of the image, table legs, spheres and cylinders are clutter:
        label 0. With `every_face` only what is curved is.
    """
    checked_scan(sigma, lost)
    rng = np.random.default_rng(checked_seed("seed", seed))
    preview = SphericalCamera.panorama(_PREVIEW)
    for _ in range(_ATTEMPTS):
        solids = furnish(rng)
        half, heading = solids[0].half, rng.uniform(-math.pi, math.pi)
        place = rng.uniform(-0.4, 0.4) * half[0], rng.uniform(0.6, 1.4) * half[1]
        view = upright((*place, rng.uniform(1.3, 1.7)), heading)
        if cast(solids, view, preview, preview.shape).depth.min() > _CLEAR:
            break
    else:
        raise AssertionError("no room with a free place")  # pragma: no cover
    sensor = Sensor(max_depth=20.0, resolution=0.001, noise=constant(sigma))
    camera = camera or SphericalCamera.panorama(512)
    return scan(solids, view, camera, sensor, sigma, lost, rng, every_face=every_face)
