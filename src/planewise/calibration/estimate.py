"""Noise of a sensor, estimated from what it saw: ``noise="auto"``.

Cells of every depth say how far readings lie from planes (`calibration.cells`), a smooth curve goes
through what they say (`calibration.fit`), and cells in a row tell what neighbours share
(`calibration.correlated`). Edges, clutter and curved surfaces only make cells rougher, so the
estimate comes from below: start at a low quantile, take the mean of the cells that are not much
rougher, repeat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.calibration.cells import NoiseCells, blurred, noise_cells
from planewise.calibration.correlated import shared_ratio
from planewise.calibration.fit import fit_polynomial, refit
from planewise.camera import Camera
from planewise.noise import AUTO, NOTHING, ErrorParts, Noise, RootSum, proportional
from planewise.observation import RayObservation, observe
from planewise.sensor import Sensor, checked_sensor

Array = NDArray[np.float64]
Seed = int | np.random.Generator

_BIN = 1.19  # depths of a bin lie within this factor
_FEWEST = 12  # flat cells of a bin, and of a frame that can tell
_START = 0.4  # quantile of the variances, from which to go up
_ROUGH = 2.0  # times its expected variance: such a cell is on an edge
_ROUGH_SIGMAS = 3.0  # the same in standard deviations of chi^2, for cells of few pixels
_UNLUCKY = 3.0  # times the rounding error that the fit may follow, at its worst phase
_STEPS = 20
_TOLERANCE = 1e-3
_RESOLVED = 0.05  # of a step: noise below it cannot be seen
_CURVE_ERROR = 0.02  # relative error that a smooth curve may have on top
_CORRELATED = 0.64  # shared part against what noise leaves of a cell's mean: less is chance
_LEAST_SHARED = 1.0  # else at least this, for what bends slowly hides from three cells in a row
_DRIFT = 3.5  # drift over 100 pixels against the shared part: the Kinect's proportion
RESAMPLES = 200
"""Of the bootstrap that a confidence band comes from."""
_FEW_FRAMES = 10  # of which blocks are drawn instead
_CONFIDENCE = (2.5, 97.5)  # percent
_ASSUMED = proportional(0.01)  # where a frame cannot tell and the sensor says nothing


@dataclass(frozen=True, kw_only=True)
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
        95 % confidence band of the curve of `sigma` at these depths, metres.
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


@dataclass(frozen=True, kw_only=True)
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
        Error that neighbouring cells were seen to have of their own, against the noise.
    frames : int
        Frames it comes from.
    note : str
        What was assumed instead, where the frames cannot tell; else empty.
    """

    white: Noise
    quantisation: Noise
    shared: Noise
    drift: Noise
    bins: NoiseBins
    shared_ratio: float = 0.0
    frames: int = 1
    note: str = ""

    @property
    def noise(self) -> Noise:
        """Standard deviation of a reading about its surroundings in metres: white and rounding."""
        if self.quantisation == NOTHING:
            return self.white
        return RootSum((self.white, self.quantisation))

    @property
    def parts(self) -> ErrorParts:
        """The parts for the spatial objective, which treats rounding by itself."""
        return ErrorParts(white=self.white, shared=self.shared, drift=self.drift)

    def sensor(self, base: Sensor) -> Sensor:
        """Sensor of the same range and resolution with this noise."""
        return replace(base, noise=self.noise, parts=self.parts)

    def describe(self) -> dict[str, str | int]:
        """Say in plain types what was found, for result files."""
        return {
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
        `noise` and `parts` are what ``noise="auto"`` takes for this image.

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
    cells = cells_of_frame(depth, camera, sensor, depth_scale)
    return pooled_noise([cells], sensor, resamples=RESAMPLES, rng=rng)


def cells_of_frame(
    depth: ArrayLike, camera: Camera, sensor: Sensor, depth_scale: float | None
) -> NoiseCells:
    """What one frame says about the noise of its sensor."""
    known = replace(checked_sensor(sensor), noise=1.0)
    return noise_cells(observe(depth, camera, known, depth_scale=depth_scale))


def resolved(observation: RayObservation, sensor: Sensor) -> tuple[NoiseEstimate, Sensor]:
    """Noise that an observation shows, without confidence band, and the sensor that has it."""
    assert sensor.noise == AUTO
    found = pooled_noise([noise_cells(observation)], sensor)
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
    pool = _Pool.of(frames)
    bins = [_Bin.of(pool, members, sensor.resolution) for members in _by_depth(pool.depth)]
    bins = [each for each in bins if each.members.size >= _FEWEST]
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
    if ratio * frames[0].side >= _CORRELATED:
        shared = fit_polynomial(depth, max(ratio, _LEAST_SHARED) * sigma, error)
        drift = shared.scaled(_DRIFT)
    low, high = np.full((2, len(bins)), np.nan)
    if resamples:
        whites = _bootstrap(pool, bins, resamples, np.random.default_rng(rng))
        sets = np.maximum(refit(curve, depth, white, error, whites), 0.0)
        totals = np.hypot(sets, rounding(depth))
        low, high = np.percentile(totals, _CONFIDENCE, axis=0)
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


@dataclass(frozen=True)
class _Pool:
    """Usable cells of all frames: see `NoiseCells`; `unit` is what the bootstrap draws."""

    depth: Array
    variance: Array
    freedom: Array
    step: Array
    followed: Array
    unit: NDArray[np.intp]

    @classmethod
    def of(cls, frames: Sequence[NoiseCells]) -> _Pool:
        units = [np.full(each.depth.size, k) for k, each in enumerate(frames)]
        if len(frames) < _FEW_FRAMES:
            most = max(each.depth.size for each in frames)
            units = [each.block + most * k for k, each in enumerate(frames)]
        columns = [
            [a[each.usable] for a in (each.depth, each.variance, each.freedom, each.step,
                                      each.followed, unit)]
            for each, unit in zip(frames, units, strict=True)
        ]  # fmt: skip
        return cls(*(np.concatenate(parts) for parts in zip(*columns, strict=True)))


def _by_depth(depth: Array) -> list[NDArray[np.intp]]:
    """Members of bins of similar depth; those of too few cells join the next one."""
    order = np.argsort(depth, kind="stable")
    number = np.floor(np.log(depth[order]) / np.log(_BIN))
    bins: list[NDArray[np.intp]] = []
    waiting = order[:0]
    for group in np.split(order, np.flatnonzero(np.diff(number)) + 1):
        waiting = np.concatenate((waiting, group))
        if waiting.size >= _FEWEST:
            bins.append(waiting)
            waiting = order[:0]
    return bins


@dataclass(frozen=True)
class _Bin:
    """Cells of similar depth: their white noise, and which of them are flat.

    Attributes
    ----------
    members : ndarray of int
        Flat cells.
    square : ndarray
        What each says of the white variance, square metres.
    least : float
        White variance below which nothing can be told, square metres.
    depth, white, step : float
        Metres.
    error : float
        Relative standard deviation of `white`.
    """

    members: NDArray[np.intp]
    square: Array
    least: float
    depth: float
    white: float
    step: float
    error: float

    @classmethod
    def of(cls, pool: _Pool, members: NDArray[np.intp], resolution: float) -> _Bin:
        variance, freedom = pool.variance[members], pool.freedom[members]
        steps, followed = pool.step[members], pool.followed[members]
        step = float(np.median(steps))
        rounding = steps**2 / 12
        least = max((_RESOLVED * step) ** 2, (resolution**2 - step**2) / 12)
        rough = max(_ROUGH, 1 + _ROUGH_SIGMAS * float(np.sqrt(2 / np.median(freedom))))
        square = max(float(np.quantile(variance, _START)) - step**2 / 12, least)
        flat, off = np.ones(members.size, bool), variance - rounding
        for _ in range(_STEPS):
            coherent = np.zeros(members.size)
            if step:
                coherent = steps**2 * (followed @ blurred(np.sqrt(square) / step))
            off = variance - rounding + coherent
            expected = square + rounding - coherent
            flat = variance <= rough * expected + _UNLUCKY * coherent
            before, weight = square, freedom * flat
            square = max(float(weight @ off) / max(float(weight.sum()), 1.0), least)
            if abs(square - before) < _TOLERANCE * before:
                break
        scatter = float(np.std(off[flat])) / np.sqrt(max(flat.sum(), 1)) if flat.any() else square
        return cls(
            members=members[flat],
            square=off[flat],
            least=least,
            depth=float(pool.depth[members[flat] if flat.any() else members].mean()),
            white=float(np.sqrt(square)),
            step=step,
            error=0.5 * scatter / square,
        )


def _bootstrap(
    pool: _Pool, bins: Sequence[_Bin], resamples: int, rng: np.random.Generator
) -> Array:
    """White noise of every bin when units are drawn with replacement, shape (S, B)."""
    _, unit = np.unique(pool.unit, return_inverse=True)
    units = int(unit.max()) + 1
    draws = rng.multinomial(units, np.full(units, 1 / units), size=resamples)
    out = np.empty((resamples, len(bins)))
    for k, each in enumerate(bins):
        weight = pool.freedom[each.members]
        top = draws @ np.bincount(unit[each.members], weight * each.square, units)
        bottom = draws @ np.bincount(unit[each.members], weight, units)
        square = np.divide(top, bottom, out=np.full(resamples, each.white**2), where=bottom > 0)
        out[:, k] = np.sqrt(np.maximum(square, each.least))
    return out


def _assumed(sensor: Sensor, cells: int, frames: int) -> NoiseEstimate:
    """What is taken where there are too few flat cells: what the sensor says, else 1 % of depth."""
    parts = sensor.parts
    if parts is None:
        parts = ErrorParts(white=_ASSUMED, shared=NOTHING, drift=NOTHING)
    nothing = np.empty(0)
    return NoiseEstimate(
        white=parts.white,
        quantisation=NOTHING,
        shared=parts.shared,
        drift=parts.drift,
        bins=NoiseBins(
            depth=nothing, sigma=nothing, white=nothing, step=nothing, low=nothing, high=nothing,
            cells=np.empty(0, np.int64),
        ),
        frames=frames,
        note=(
            f"{cells} flat cells, too few to tell the noise ({_FEWEST} are needed): "
            f"sigma = {parts.white} was assumed"
        ),
    )  # fmt: skip
