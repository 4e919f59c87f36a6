"""Waves: errors that come again along range, depth or disparity, the same on every surface.

Time of flight is told by phases, and harmonics of the modulation leave an error that is periodic in
range, called wiggling; matching prefers whole pixels, and leaves one that is periodic in disparity,
called pixel locking.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import is_finite, make_plain

Array = NDArray[np.float64]
Along = Literal["range", "depth", "disparity"]

ALONG: tuple[Along, ...] = get_args(Along)
_STEPS = 5  # of Newton's, from what is read to what is true
_KNOTS = 8192  # of a table
_MOST = 0.2  # of a coordinate is taken off, at most: waves of another unit leave depth what it is
_NARROW = 1e-6  # share of a coordinate that a table spans at least


@dataclass(frozen=True)
class Wave:
    """The error amplitude sin(2 pi u / period + phase) of a coordinate u.

    Parameters
    ----------
    period, amplitude : float
        In the unit of u.
    phase : float
        Radians.
    """

    period: float
    amplitude: float
    phase: float

    def __post_init__(self) -> None:
        for name in ("period", "amplitude", "phase"):
            value = getattr(self, name)
            if not is_finite(value) or (value <= 0 and name == "period"):
                positive = "positive and " if name == "period" else ""
                raise ValueError(f"waves: {name} must be {positive}finite, got {value!r}")
        make_plain(self, float, "period", "amplitude", "phase")


@dataclass(frozen=True)
class Waves:
    """Systematic error of a depth sensor: a sum of waves along one coordinate.

    Where u is true, u + error(u) is read.

    Parameters
    ----------
    along : {"range", "depth", "disparity"}
        The coordinate: distance from the camera, or depth, in metres; or inverse depth in 1 / m, of
        which disparity is a multiple: a stereo pair of focal length f pixels and baseline b metres
        has a period of 1 / (f b) for every pixel of disparity.
    parts : sequence of Wave
        At least one.

    Examples
    --------
    >>> wiggling = Waves("range", [Wave(period=0.75, amplitude=0.003, phase=0.0)])
    >>> print(wiggling)
    3 mm every 0.75 m of range
    >>> wiggling.error(np.array([1.5, 1.6875])).round(4)
    array([-0.   ,  0.003])
    """

    along: Along
    parts: tuple[Wave, ...]

    def __post_init__(self) -> None:
        if self.along not in ALONG:
            raise ValueError(f"waves: along must be one of {', '.join(ALONG)}, got {self.along!r}")
        parts: Any = self.parts
        if not isinstance(parts, Iterable):
            raise ValueError(f"waves: parts must be a sequence of Wave, got {parts!r}")
        object.__setattr__(self, "parts", tuple(parts))
        if not self.parts or not all(isinstance(part, Wave) for part in self.parts):
            raise ValueError(f"waves: parts must be one Wave or more, got {self.parts!r}")
        if sum(2 * math.pi * abs(part.amplitude) / part.period for part in self.parts) >= 1:
            raise ValueError(
                f"waves: {self} are too large for their periods: different true depths would be "
                "read alike"
            )

    def error(self, u: Array) -> Array:
        """Error where `u` is true, in its unit."""
        return sum((a * s for a, s, _, _ in self._terms(u)), np.zeros_like(u))

    def true(self, u: Array, about: Array | None = None, steps: int = _STEPS) -> Array:
        """What is true where `u` is read: u = true + error(true); about: what nearly is."""
        out = u if about is None else about
        for _ in range(steps):
            off, slope = out - u, np.ones_like(u)
            for amplitude, sine, cosine, frequency in self._terms(out):
                off += amplitude * sine
                slope += amplitude * frequency * cosine
            out = out - off / slope
        return out

    def table(self, first: float, last: float) -> tuple[Array, Array]:
        """What is read from `first` > 0 to `last`, at regular steps, and its error."""
        read = np.linspace(first, max(last, first * (1 + _NARROW)), _KNOTS)
        most = _MOST * read
        return read, np.clip(read - self.true(read), -most, most)

    def taken_off(self, z: Array, rays: Array) -> Array:
        """Depths z (k,) without them; rays (3, k): directions of the readings, 1 deep."""
        if not z.size:
            return z
        if self.along == "disparity":
            return np.asarray(1.0 / self._without(1.0 / z))
        if self.along == "depth":
            return self._without(z)
        length = np.sqrt(np.einsum("ij,ij->j", rays, rays))
        return np.asarray(self._without(z * length) / length)

    def _without(self, u: Array) -> Array:
        """Coordinates without their error."""
        return np.asarray(u - np.interp(u, *self.table(float(u.min()), float(u.max()))))

    def _terms(self, u: Array) -> Iterable[tuple[float, Array, Array, float]]:
        """Amplitude, sine, cosine and frequency in radians of every wave."""
        for part in self.parts:
            frequency = 2 * math.pi / part.period
            angle = frequency * u + part.phase
            yield part.amplitude, np.sin(angle), np.cos(angle), frequency

    @classmethod
    def of(cls, described: Mapping[str, Any]) -> Waves:
        """Waves of their description."""
        return cls(described["along"], tuple(Wave(**part) for part in described["parts"]))

    def describe(self) -> dict[str, Any]:
        """Give them in plain types, as files have them."""
        return {"along": self.along, "parts": [dict(vars(part)) for part in self.parts]}

    def __str__(self) -> str:
        """Say how large they are, and how often they come again."""
        inverse = self.along == "disparity"
        unit, small, scale = ("1 / m", "1 / m", 1.0) if inverse else ("m", "mm", 1000.0)
        each = (
            f"{scale * abs(part.amplitude):.2g} {small} every {part.period:.3g} {unit}"
            for part in self.parts
        )
        return f"{', '.join(each)} of {'inverse depth' if inverse else self.along}"
