"""White noise of cells of similar depth, and how sure of it they are.

Edges, clutter and curved surfaces only make cells rougher, so the estimate comes from below: start
at a low quantile, take the mean of the cells that are not much rougher, repeat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.calibration.cells import FEWEST, NoiseCells, blurred

Array = NDArray[np.float64]

_BIN = 1.19  # depths of a bin lie within this factor
_START = 0.4  # quantile of the variances, from which to go up
_ROUGH = 2.0  # times its expected variance: such a cell is on an edge
_ROUGH_SIGMAS = 3.0  # the same in standard deviations of chi^2, for cells of few pixels
_UNLUCKY = 3.0  # times the rounding error that the fit may follow, at its worst phase
_STEPS = 20
_TOLERANCE = 1e-3
_RESOLVED = 0.05  # of a step: noise below it cannot be seen
_FEW_FRAMES = 10  # of which blocks are drawn instead


@dataclass(frozen=True)
class Pool:
    """Usable cells of all frames: see `NoiseCells`; `unit` is what the bootstrap draws."""

    depth: Array
    variance: Array
    freedom: Array
    step: Array
    followed: Array
    unit: NDArray[np.intp]

    @classmethod
    def of(cls, frames: Sequence[NoiseCells]) -> Pool:
        """Put the usable cells of frames one behind the other."""
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


def by_depth(depth: Array) -> list[NDArray[np.intp]]:
    """Members of bins of similar depth; those of too few cells join the next one."""
    order = np.argsort(depth, kind="stable")
    number = np.floor(np.log(depth[order]) / np.log(_BIN))
    bins: list[NDArray[np.intp]] = []
    waiting = order[:0]
    for group in np.split(order, np.flatnonzero(np.diff(number)) + 1):
        waiting = np.concatenate((waiting, group))
        if waiting.size >= FEWEST:
            bins.append(waiting)
            waiting = order[:0]
    return bins


@dataclass(frozen=True)
class Bin:
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
    def of(cls, pool: Pool, members: NDArray[np.intp], resolution: float) -> Bin:
        """From below: only flat cells remain members."""
        variance, freedom = pool.variance[members], pool.freedom[members]
        steps, followed = pool.step[members], pool.followed[members]
        step = float(np.median(steps))
        rounding = steps**2 / 12
        least = max((_RESOLVED * step) ** 2, (resolution**2 - step**2) / 12)
        usual = float(np.median(freedom))
        rough = max(_ROUGH, 1 + _ROUGH_SIGMAS * math.sqrt(2 / usual))
        square = max(float(np.quantile(variance, _START)) - step**2 / 12, least)
        flat, off = np.ones(members.size, bool), variance
        for _ in range(_STEPS):
            coherent = np.zeros(members.size)
            if step:
                coherent = steps**2 * (followed @ blurred(np.sqrt(square) / step))
            expected = square + rounding - coherent
            limit = rough * expected + _UNLUCKY * coherent
            flat = variance <= limit
            # The limit is for edges, but cuts off the roughest of the flat cells, too.
            kept = _mean_below(float((limit / expected).mean()), usual)
            off = variance / kept - rounding + coherent
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


def _mean_below(limit: float, freedom: float) -> float:
    """Mean of chi^2 / freedom where that is below a limit; their share by Wilson and Hilferty."""
    half = freedom / 2
    x = half * limit
    normal = (limit ** (1 / 3) - 1 + 1 / (9 * half)) * math.sqrt(9 * half)
    share = 0.5 * math.erfc(-normal / math.sqrt(2))
    return 1 - math.exp(half * math.log(x) - x - math.lgamma(half + 1)) / share


def bootstrap(pool: Pool, bins: Sequence[Bin], resamples: int, rng: np.random.Generator) -> Array:
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
