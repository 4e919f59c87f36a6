"""Noise of a sensor, estimated from what it saw: ``noise="auto"``.

Cells of every depth say how far readings lie from planes (`calibration.cells`, `calibration.bins`),
a smooth curve goes through what they say (`calibration.fit`), and cells in a row tell what
neighbours share (`calibration.correlated`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import checked_seed, unmasked
from planewise.calibration.bins import Bin, Pool, bootstrap, by_depth
from planewise.calibration.cells import FEWEST, NoiseCells
from planewise.calibration.correlated import by_chance, shared_ratio
from planewise.calibration.fit import fit_polynomial, refit
from planewise.calibration.frame_noise import noise_of_frame
from planewise.camera import Camera
from planewise.depth_image import within_range
from planewise.enlarged.own_pixels import own_pixels
from planewise.noise import AUTO, NOTHING, ErrorParts, Noise, RootSum, as_curve, proportional
from planewise.observation import RayObservation, observe
from planewise.sensor import Sensor, checked_sensor
from planewise.waves import Waves
from planewise.wording import counted

Array = NDArray[np.float64]
Seed = int | np.random.Generator

_CURVE_ERROR = 0.02  # relative error that a smooth curve may have on top
_LEAST_SHARED = 1.0  # else at least this, for what bends slowly hides from three cells in a row
_DRIFT = 3.5  # drift over 100 pixels against the shared part: the Kinect's proportion
_WIDE = 1.5  # farthest bin against the nearest: less hardly tells a constant from a slope
RESAMPLES = 200
"""Of the bootstrap that a confidence band comes from."""
_CONFIDENCE = (2.5, 97.5)  # percent
_SYSTEMATIC = 0.015  # of sigma, by which creases, and bins where it grows with z^2, may be off
_ASSUMED = proportional(0.01)  # where a frame cannot tell and the sensor says nothing


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseBins:
    """What cells of similar depth say; arrays of shape (B,), by depth.

    Attributes
    ----------
    depth : ndarray
        Metres.
    sigma : ndarray
        Standard deviation of a reading, quantisation included, metres.
    white : ndarray
        Its white part alone, metres.
    step : ndarray
        Quantisation step in metres, 0 where there is none.
    low, high : ndarray
        95 % confidence band of the curve of `sigma` at these depths, metres: of which cells were
        drawn, and 1.5 % for creases and for the width of the bins; not of clutter, nor of how far
        the family of curves may be off.
    cells : ndarray of int
        Cells that were flat enough to count.
    """

    depth: Array
    sigma: Array
    white: Array
    step: Array
    low: Array
    high: Array
    cells: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class NoiseEstimate:
    """Noise of a sensor as frames show it.

    Attributes
    ----------
    white, quantisation, shared, drift : callable
        sigma(z) in metres: of what is new in every reading, of rounding to steps (step / sqrt 12),
        of what readings some ten pixels apart share, of what wanders over 100 pixels.
    bins : NoiseBins
        The points that the curve of the white part goes through.
    shared_ratio : float
        Error that neighbouring cells were seen to have of their own, against the noise; NaN where
        too few flat cells lie in a row to tell.
    bounds : bool
        Whether no frame is to show more of `shared` and `drift`: where many frames tell a walk.
    frames : int
        Frames it comes from.
    note : str
        What was assumed instead, where the frames cannot tell; else empty.
    waves : Waves, optional
        Systematic error that frames share, and without which their noise is.
    """

    white: Noise
    quantisation: Noise
    shared: Noise
    drift: Noise
    bins: NoiseBins
    shared_ratio: float = np.nan
    bounds: bool = False
    frames: int = 1
    note: str = ""
    waves: Waves | None = None

    @property
    def noise(self) -> Noise:
        """Standard deviation of a reading about its surroundings in metres: white and rounding."""
        if self.quantisation == NOTHING:
            return self.white
        return RootSum((self.white, self.quantisation))

    @property
    def parts(self) -> ErrorParts:
        """The parts for the spatial objective, which treats rounding by itself."""
        return ErrorParts(
            white=self.white, shared=self.shared, drift=self.drift, bounds=self.bounds
        )

    @property
    def caution(self) -> str:
        """What the frames leave open, though they tell the noise; else empty."""
        if self.note:
            return ""
        said = []
        if self.bins.depth[-1] < _WIDE * self.bins.depth[0]:
            near, far = (f"{depth:.3g}" for depth in self.bins.depth[[0, -1]])
            where = f"at {near} m" if near == far else f"from {near} to {far} m"
            said.append(
                f"all flat cells lie {where}, so that noise at other depths is a guess: add frames "
                "that are nearer and farther"
            )
        if np.isnan(self.shared_ratio):
            said.append(
                "too few flat cells lie in a row to tell what neighbouring readings share of their "
                "error: each frame that is searched has to tell"
            )
        return "; ".join(said)

    def sensor(self, base: Sensor) -> Sensor:
        """Sensor of the same range and resolution with this noise."""
        return replace(base, noise=self.noise, parts=self.parts, waves=self.waves)

    def describe(self) -> dict[str, str | int]:
        """Say in plain types what was found, for result files."""
        waves = {} if self.waves is None else {"waves": str(self.waves)}
        return waves | {
            "source": "assumed" if self.note else "estimated",
            "note": self.note,
            "frames": self.frames,
            "cells": int(self.bins.cells.sum()),
            "noise": str(self.noise),
            "white": str(self.white),
            "quantisation": str(self.quantisation),
            "shared": str(self.shared),
            "drift": str(self.drift),
        }


def estimate_noise(
    depth: ArrayLike,
    camera: Camera,
    sensor: Sensor,
    *,
    depth_scale: float | None = None,
    rng: Seed = 0,
) -> NoiseEstimate:
    """Estimate the noise of a depth image from the image itself.

    Parameters
    ----------
    depth : array_like, shape (H, W)
        As in `planewise.detect_planes`.
    camera : Camera
        Intrinsics.
    sensor : Sensor
        Range and resolution; its noise is not used, its parts only where the image cannot tell.
    depth_scale : float, optional
        Metres per unit of integer depth; ``None`` means the sensor's resolution.
    rng : int or numpy.random.Generator
        Seed of the bootstrap over blocks of the image that the confidence band comes from.

    Returns
    -------
    NoiseEstimate
        `noise` and `parts` are what ``noise="auto"`` takes for this image. Of one that was enlarged
        that is so under the spatial objective without a partition, which searches its own pixels;
        others see the enlarged ones.

    Raises
    ------
    ValueError
        If an argument is malformed.

    Examples
    --------
    >>> import numpy as np, planewise as pw
    >>> scene = pw.scenes.corner(sigma=0.004)
    >>> found = pw.estimate_noise(scene.depth, scene.camera, pw.Sensor(noise="auto"))
    >>> found.noise([1.2]).round(4), found.shared([1.2])
    (array([0.004]), array([0.]))
    """
    checked_seed("rng", rng)
    frame = noise_of_frame(own_readings(depth, camera, sensor, depth_scale))
    found = pooled_noise([frame.cells], sensor, resamples=RESAMPLES, rng=rng)
    return replace(found, waves=frame.waves)


def own_readings(
    depth: ArrayLike, camera: Camera, sensor: Sensor, depth_scale: float | None
) -> RayObservation:
    """Readings of a frame in the pixels in which it is searched, whatever their noise."""
    known = replace(checked_sensor(sensor), noise=1.0)
    depth = unmasked("depth", depth)
    own = own_pixels(within_range(depth, known, depth_scale), camera)
    if own is not None:
        seen = observe(own.depth, own.camera, known, depth_scale=depth_scale)
        _, told = resolved(seen, replace(known, noise=AUTO))
        if own.tells(replace(seen, sensor=told)):
            return seen
    return observe(depth, camera, known, depth_scale=depth_scale)


def resolved(observation: RayObservation, sensor: Sensor) -> tuple[NoiseEstimate, Sensor]:
    """Noise that an observation shows, without confidence band, and the sensor that has it."""
    assert sensor.noise == AUTO
    frame = noise_of_frame(observation)
    found = replace(pooled_noise([frame.cells], sensor), waves=frame.waves)
    return found, found.sensor(sensor)


def pooled_noise(
    frames: Sequence[NoiseCells], sensor: Sensor, *, resamples: int = 0, rng: Seed = 0
) -> NoiseEstimate:
    """Estimate the noise of a sensor from the cells of one frame or many.

    Parameters
    ----------
    frames : sequence of NoiseCells
        Of images of one size.
    sensor : Sensor
        Its resolution is the least step of its readings.
    resamples : int
        Of the bootstrap over frames, or over blocks of few frames; 0 leaves the band out (NaN).
    rng : int or numpy.random.Generator
        Seed of the bootstrap.
    """
    pool = Pool.of(frames)
    bins = [Bin.of(pool, members, sensor.resolution) for members in by_depth(pool.depth)]
    bins = [each for each in bins if each.members.size >= FEWEST]
    if not bins:
        return _assumed(sensor, pool.depth.size, len(frames))
    depth, white, step = np.array([(b.depth, b.white, b.step) for b in bins]).T
    sigma = np.hypot(white, step / np.sqrt(12))
    cells = np.array([b.members.size for b in bins])
    # Depths at which little lies are more often edges and clutter.
    error = np.hypot([b.error for b in bins], _CURVE_ERROR * np.sqrt(cells.max() / cells))
    curve = fit_polynomial(depth, white, error)
    rounding: Noise = NOTHING
    if step.any():
        known = step > 0
        rounding = fit_polynomial(
            depth[known], step[known] / np.sqrt(12), np.full(known.sum(), _CURVE_ERROR)
        )
    ratio = shared_ratio(frames, curve)
    shared: Noise = NOTHING
    drift: Noise = NOTHING
    if ratio >= by_chance(frames):
        shared = fit_polynomial(depth, max(ratio, _LEAST_SHARED) * sigma, error)
        drift = shared.scaled(_DRIFT)
    low, high = np.full((2, len(bins)), np.nan)
    if resamples:
        whites = bootstrap(pool, bins, resamples, np.random.default_rng(rng))
        sets = np.maximum(refit(curve, depth, white, error, whites), 0.0)
        totals = np.hypot(sets, rounding(depth))
        middle = np.hypot(curve(depth), rounding(depth))
        sampled = np.percentile(totals, _CONFIDENCE, axis=0) - middle
        below, above = np.hypot(sampled, _SYSTEMATIC * middle)
        low, high = middle - below, middle + above
    return NoiseEstimate(
        white=curve,
        quantisation=rounding,
        shared=shared,
        drift=drift,
        shared_ratio=ratio,
        bins=NoiseBins(
            depth=depth,
            sigma=sigma,
            white=white,
            step=step,
            low=low,
            high=high,
            cells=cells,
        ),
        frames=len(frames),
    )


def too_few(cells: int) -> str:
    """Say why so many flat cells cannot tell the noise."""
    return f"{counted(cells, 'flat cell')}, too few to tell the noise ({FEWEST} are needed)"


def _assumed(sensor: Sensor, cells: int, frames: int) -> NoiseEstimate:
    """What is taken where there are too few flat cells: what the sensor says, else 1 % of depth."""
    parts = sensor.parts
    if parts is None:
        parts = ErrorParts(white=_ASSUMED, shared=NOTHING, drift=NOTHING)
    white, shared, drift = (
        as_curve("parts", each) for each in (parts.white, parts.shared, parts.drift)
    )
    nothing = np.empty(0)
    return NoiseEstimate(
        white=white,
        quantisation=NOTHING,
        shared=shared,
        drift=drift,
        bins=NoiseBins(
            depth=nothing, sigma=nothing, white=nothing, step=nothing, low=nothing, high=nothing,
            cells=np.empty(0, np.int64),
        ),
        frames=frames,
        note=f"{too_few(cells)}: sigma = {white} was assumed",
    )  # fmt: skip
