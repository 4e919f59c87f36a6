"""Synthetic frames whose error is correlated, as real sensors' is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.frames import Frame
from planewise import scenes

Array = NDArray[np.float64]

WHITE = 0.0015  # 1 / m: what is new in every reading of a Kinect
DRIFT = 0.0035  # 1 / m: how far its error wanders over 100 pixels
STEP = 1 / (8 * 580 * 0.075)  # 1 / m: of its disparity, an eighth of a pixel
_DOMAIN = 4  # sides of the field that the image is cut from: the field is periodic


def random_walk(shape: tuple[int, int], drift: float, rng: int | np.random.Generator = 0) -> Array:
    """Field whose differences over r pixels have the variance drift^2 r / 100.

    Parameters
    ----------
    shape : (height, width)
        Pixels.
    drift : float
        Standard deviation of a difference over 100 pixels.
    rng : int or numpy.random.Generator
        Seed.

    Returns
    -------
    ndarray, shape (height, width)
        By spectral synthesis: in the plane a variogram D r has the density D / (4 pi k^3), k in
        radians per pixel.
    """
    side = _DOMAIN * max(shape)
    frequency = 2 * np.pi * np.fft.fftfreq(side)
    k = np.hypot(frequency[:, None], frequency[None, : side // 2 + 1])
    k[0, 0] = np.inf
    density = drift**2 / 100 / (4 * np.pi * k**3)
    noise = np.fft.rfft2(np.random.default_rng(rng).standard_normal((side, side)))
    # White noise has the density 1 / (2 pi)^2.
    field = np.fft.irfft2(noise * np.sqrt(density) * 2 * np.pi, s=(side, side))
    return np.asarray(field[: shape[0], : shape[1]])


def kinect_room(seed: int = 0, *, drift: float = DRIFT, rng: int = 0) -> tuple[Frame, scenes.Scene]:
    """Synthetic room read once more: with white noise, a random walk, and a Kinect's steps.

    Faces are exact before that; clutter keeps the white noise and the steps that it has.
    """
    scene = scenes.room(seed)
    shape = (scene.depth.shape[0], scene.depth.shape[1])
    z = scene.sensor.resolution * np.asarray(scene.depth, np.float64)
    there = z > 0
    w = np.zeros(shape)
    w[there] = 1 / z[there]
    rays = scene.camera.rays(shape)
    for label, plane in enumerate(scene.planes, start=1):
        on = there & (scene.labels == label)
        w[on] = -(rays[on] @ plane[:3]) / plane[3]
    random = np.random.default_rng(rng)
    w += WHITE * random.standard_normal(shape) + random_walk(shape, drift, random)
    z = 1 / (np.round(np.maximum(w, 0.1) / STEP) * STEP)
    depth = np.where(there, np.round(z / scene.sensor.resolution), 0).astype(np.uint16)
    frame = Frame(f"room/{seed} with drift", depth, scene.camera, pw.sensors.KINECT_V1)
    return frame, scene
