"""Noise of a camera from many of its frames, and waves of its error (`planewise.waves`)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planewise.arguments import checked_seed
from planewise.calibration.correlated import is_walk
from planewise.calibration.estimate import (
    RESAMPLES,
    NoiseEstimate,
    Seed,
    own_readings,
    pooled_noise,
)
from planewise.calibration.frame_noise import FrameNoise, noise_of_frame
from planewise.camera import Camera
from planewise.errors import PlanewiseError
from planewise.sensor import Sensor
from planewise.waves.bends import Bends
from planewise.waves.search import waves_of


def calibrate(
    depths: Iterable[ArrayLike],
    camera: Camera,
    sensor: Sensor,
    *,
    depth_scale: float | None = None,
    rng: Seed = 0,
) -> NoiseEstimate:
    """Estimate the noise of a camera from frames of it, all cells together.

    Frames that were enlarged are looked at in the pixels that the spatial objective searches
    (`planewise.estimate_noise`).

    Parameters
    ----------
    depths : iterable of array_like, shape (H, W)
        As in `planewise.detect_planes`; one is held at a time.
    camera : Camera
        Intrinsics.
    sensor : Sensor
        Range and resolution; its noise is not used.
    depth_scale : float, optional
        Metres per unit of integer depth; ``None`` means the sensor's resolution.
    rng : int or numpy.random.Generator
        Seed of the bootstrap, over frames, or over blocks of them where there are few.

    Returns
    -------
    NoiseEstimate
        Its `sensor` makes the sensor to detect with, waves of its error included, and
        `planewise.sensors.save` keeps it; its `caution` says what the frames leave open: how noise
        grows with depth, where they are of about one, and what neighbours share of it, where too
        few flat cells lie in a row.

    Raises
    ------
    ValueError
        If a frame is malformed, or too few of their cells are flat.

    Examples
    --------
    >>> import planewise as pw
    >>> scenes = [pw.scenes.corner(sigma=0.004, size=(120, 160), rng=k) for k in range(3)]
    >>> found = pw.calibrate((s.depth for s in scenes), scenes[0].camera, pw.Sensor())
    >>> found.frames, bool(abs(found.noise([1.2])[0] - 0.004) < 0.0002)
    (3, True)
    """
    checked_seed("rng", rng)
    readings = (own_readings(depth, camera, sensor, depth_scale) for depth in depths)
    return pooled([noise_of_frame(seen).thinned() for seen in readings], sensor, rng)


def pooled(frames: list[FrameNoise], sensor: Sensor, rng: Seed = 0) -> NoiseEstimate:
    """Noise that the cells of all frames show, with its confidence band, and waves they share.

    Raises
    ------
    PlanewiseError
        If they cannot tell.
    """
    if not frames:
        raise PlanewiseError("calibrate: no frame was given")
    bends = [frame.bends for frame in frames if frame.bends is not None]
    waves = waves_of(Bends.together(bends)) if bends else sensor.waves
    cells = [
        frame.cells.without(waves) if waves is not None and frame.waves is None else frame.cells
        for frame in frames
    ]
    found = pooled_noise(cells, sensor, resamples=RESAMPLES, rng=rng)
    if found.note:
        raise PlanewiseError(
            f"calibrate: {found.note.split(':')[0]}; take frames of walls, floors or tables, "
            "and check the intrinsics and the unit of the depth"
        )
    bounds = is_walk(cells, found.white, found.shared_ratio)
    return replace(found, bounds=bounds, waves=waves)


def describe_calibration(found: NoiseEstimate) -> dict[str, Any]:
    """Say in plain types what a noise was measured from: the evidence kept with a sensor."""
    bins = found.bins
    return found.describe() | {
        "caution": found.caution,
        "shared_ratio": None if np.isnan(found.shared_ratio) else found.shared_ratio,
        "bounds": found.bounds,
        "confidence": 0.95,
        "depth_m": bins.depth.tolist(),
        "sigma_m": bins.sigma.tolist(),
        "curve_m": np.asarray(found.noise(bins.depth)).tolist(),
        "curve_low_m": bins.low.tolist(),
        "curve_high_m": bins.high.tolist(),
        "flat_cells": bins.cells.tolist(),
    }
