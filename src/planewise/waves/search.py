"""Waves that frames show: lines of the spectrum of bends.

A wave is some millimetres on every surface alike, and a plane that slants through some periods of
it is ribbed. But it is a function of one number, so a frame has thousands of readings of it: of
three blocks a, b, c of pixels in a row on a plane,

    2 w_b - w_a - w_c = 2 r_b g(u_b) - r_a g(u_a) - r_c g(u_c) + noise,    r = dw/du,

w = 1 / z and g the error of the coordinate u. How much of these bends a wave of any period explains
is a spectrum (Lomb 1976, of unevenly spaced readings); a line that stands out is a wave. Curved and
cluttered surfaces explain bends as well, but at no single period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import waves as kernels
from planewise.waves.bends import Bends
from planewise.waves.waves import ALONG, Along, Wave, Waves

Array = NDArray[np.float64]

_FEWEST = 500  # bends that can tell
# Along range and depth in metres; light modulated with 19 MHz tells ranges of 8 m, a quarter of
# which is its wave. Along disparity in 1 / m: a pixel of a stereo camera of 10 px m.
_LONGEST: dict[Along, float] = {"range": 2.0, "depth": 2.0, "disparity": 0.1}
_SHORTEST: dict[Along, float] = {"range": 0.1, "depth": 0.1, "disparity": 0.0015}
_HIGHEST: dict[Along, float] = {"range": 0.03, "depth": 0.03, "disparity": np.inf}  # amplitude
_STEEPEST: dict[Along, float] = {"range": 0.03, "depth": 0.03, "disparity": 0.07}  # over period
_STEPS = 5.0  # between readings in a period, at least: steps come again, too, of Kinects by fours
_PERIODS: dict[Along, float] = {"range": 2.0, "depth": 2.0, "disparity": 5.0}  # fewest in a frame
_SHARE = 0.06  # of the squares of bends that a wave explains, at least
_LEAST = 100.0  # and of their sum against their variance
_ALONE = 0.4  # of what it explains that may be explained by other periods, multiples apart ...
_WIDE = 1.5  # ... which differ by less over a whole frame than so many periods
_ACROSS, _LEAST_ACROSS = 0.05, 25.0  # of what it saves, on surfaces that lean across the others
_MOST = 3  # waves
_ROUNDS, _FIXED = 5, 2  # of a fit, and the first ones, at the period of the spectrum
_FITTED = 1.4  # times the largest amplitude: a fit may tell more than a spectrum
_REACH = 0.2  # periods over a whole frame by which a round may change one
_KNOTS, _FINE = 2048, 16.0  # of a spectrum, and of its shortest period, at most
_SINGULAR, _TINY = 1e-6, 1e-30


@dataclass(frozen=True)
class _Line:
    """The period at which a wave explains most of what is left of bends, and how much of it."""

    along: Along
    period: float
    explained: float


def waves_of(bends: Bends) -> Waves | None:
    """Waves that bends show; ``None`` where they show none."""
    if bends.bend.size < _FEWEST:
        return None
    left, weights = bends.bend, bends.weights(bends.bend)
    lines = [line for along in ALONG if (line := _line(bends, along, left, weights)) is not None]
    best = max(lines, key=lambda line: line.explained, default=None)
    found: Waves | None = None
    while best is not None:
        told = _fitted(bends, best, () if found is None else found.parts)
        if told is None:
            break
        all_of_it, across = bends.saved(left, told[1])
        if across < max(_ACROSS * all_of_it, _LEAST_ACROSS):
            break
        (found, left), best = told, None
        if len(found.parts) < _MOST:
            best = _line(bends, found.along, left, bends.weights(left), found.parts)
    return found


def _line(
    bends: Bends, along: Along, left: Array, weights: Array, known: Sequence[Wave] = ()
) -> _Line | None:
    """The line of the spectrum of what is left of bends; ``None`` where none stands out.

    known: waves that were found.
    """
    u, rate = bends.coordinate(along)
    seen = u[bends.w > 0]
    first, span = float(seen.min()), float(seen.max() - seen.min())
    if not span:
        return None
    knots = _KNOTS
    while knots > _FINE * span / _SHORTEST[along]:
        knots //= 2
    if knots < _FINE:
        return None
    place = np.maximum(np.rint((u - first) * ((knots - 1) / span)), 0).astype(np.int32)
    together, (sums, apart, own) = np.empty(2 * knots), np.empty((3, knots))
    kernels.spectrum_sums(bends.index, place, rate, left, weights, sums, apart, together, own)

    # With q = sum_k b_k exp(-i f k) and so on, of each frequency the normal equations of a sine and
    # a cosine: (ss, sc; sc, cc) (sine, cosine) = (s, c).
    size = 4 * knots
    period = np.full(size // 2 + 1, np.inf)
    period[1:] = size * span / (knots - 1) / np.arange(1, size // 2 + 1)
    longest = min(_LONGEST[along], span / _PERIODS[along])
    rounding = bends.step / float(np.median(np.abs(rate[bends.w > 0])))
    shortest = max(_SHORTEST[along], 4 * span / knots, _STEPS * rounding)
    some = slice(*np.searchsorted(-period, (-longest, -shortest)).tolist())
    period = period[some]
    if not period.size:
        return None
    b, minus, plus, noise = (np.fft.rfft(each, size)[some] for each in (sums, apart, together, own))
    # Noise moves a block along the coordinate, too: where blocks lie at regular steps of it, as
    # on a wall upright in the image, bends look like a wave of that period by this much.
    noise *= 2 * np.pi / period
    s, c = -b.imag - noise.real, b.real - noise.imag
    ss, cc, sc = (minus - plus).real / 2, (minus + plus).real / 2, -plus.imag / 2
    determinant = ss * cc - sc * sc
    determinant[determinant <= _SINGULAR * ss * cc] = np.inf
    sine, cosine = (cc * s - sc * c) / determinant, (ss * c - sc * s) / determinant
    explained = np.maximum(sine * s + cosine * c, 0.0)
    # No sensor errs by more: what such a wave explains of a surface that is curved.
    part = np.minimum(_most(along, period) / np.maximum(np.hypot(sine, cosine), _TINY), 1.0)
    explained *= part * (2.0 - part)

    k = int(explained.argmax())
    least = max(_SHARE * float((weights * left * left).sum()), _LEAST)
    if explained[k] < least or part[k] < 1.0:
        return None
    its = [*(times / period[k] for times in (0.5, 1.0, 2.0, 3.0)), *(1 / w.period for w in known)]
    alike = (np.abs(1 / period - np.array(its)[:, None]) < _WIDE / span).any(axis=0)
    if explained[~alike].max(initial=0.0) > _ALONE * explained[k]:
        return None
    return _Line(along, float(period[k]), float(explained[k]))


def _fitted(bends: Bends, line: _Line, known: Sequence[Wave]) -> tuple[Waves, Array] | None:
    """Known waves and that of a line by least squares (Gauss-Newton), and what they leave.

    ``None`` where no sensor errs so much.
    """
    u, rate = bends.coordinate(line.along)
    seen = u[bends.w > 0]
    usual, reach = float(np.median(seen)), _REACH / float(seen.max() - seen.min())
    u = u - usual  # so that a change of the period moves no wave as a whole
    frequency = np.array([*(1 / wave.period for wave in known), 1 / line.period])
    height = np.array([*(wave.amplitude for wave in known), 0.0])
    phase = 2 * np.pi * usual * frequency + [*(wave.phase for wave in known), 0.0]
    sine, cosine = height * np.cos(phase), height * np.sin(phase)
    true = u
    for n in range(_ROUNDS + 1):
        try:
            waves = _waves(line.along, frequency, sine, cosine)
        except ValueError:  # two true depths would be read alike
            return None
        true = waves.true(u, true, 1 if n else 3)
        left = bends.bend - bends.of_blocks(rate * waves.error(true))
        if n == _ROUNDS:
            break
        columns = []
        for f, s, c in zip(2 * np.pi * frequency, sine, cosine, strict=True):
            of_sine, of_cosine = np.sin(f * true), np.cos(f * true)
            columns += [of_sine, of_cosine]
            if n >= _FIXED:  # of the frequency
                columns.append(2 * np.pi * true * (s * of_cosine - c * of_sine))
        rows = np.stack([bends.of_blocks(rate * column) for column in columns])
        weighted = rows * bends.weights(left)
        change = np.linalg.lstsq(weighted @ rows.T, weighted @ left, rcond=None)[0]
        steps = change.reshape(frequency.size, -1)
        sine, cosine = sine + steps[:, 0], cosine + steps[:, 1]
        if n >= _FIXED:
            frequency = np.maximum(frequency + np.clip(steps[:, 2], -reach, reach), reach)
    if (np.hypot(sine, cosine) > _FITTED * _most(line.along, 1 / frequency)).any():
        return None
    return _waves(line.along, frequency, sine, cosine, usual), left


def _waves(along: Along, frequency: Array, sine: Array, cosine: Array, usual: float = 0.0) -> Waves:
    """Waves of a coordinate from which `usual` was taken."""
    phase = np.arctan2(cosine, sine) - 2 * np.pi * frequency * usual
    phase = (phase + np.pi) % (2 * np.pi) - np.pi
    rows = np.stack((1 / frequency, np.hypot(sine, cosine), phase), axis=1)
    return Waves(along, tuple(Wave(*row) for row in rows.tolist()))


def _most(along: Along, period: Array) -> Array:
    """Largest amplitude of a wave."""
    return np.minimum(_HIGHEST[along], _STEEPEST[along] * period)
