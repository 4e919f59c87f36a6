"""What the objective has to know of a depth sensor: its range, its resolution and its noise."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planewise.arguments import FINEST, LEAST_LENGTH, MOST_LENGTH, is_finite, make_plain
from planewise.noise import (
    AUTO,
    Array,
    Auto,
    ErrorParts,
    Noise,
    Nothing,
    constant,
    evaluated,
    in_words,
    proportional,
)
from planewise.waves import Waves


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A digital depth sensor.

    Parameters
    ----------
    max_depth : float
        Largest depth it reports, in metres; readings beyond are "no reading". So are those at it
        where one in a hundred is, but not all: a renderer clips what lies beyond.
    resolution : float
        eps of the paper: the step between two readings, in metres. An integer depth image is taken
        to be in units of it.
    noise : callable, float or "auto"
        sigma(z) in metres for an array of depths in metres (see `planewise.noise`), one number
        in metres for every depth, or "auto": estimated, with the parts, from each depth image
        (`planewise.estimate_noise`), or from each cloud (`planewise.estimate_cloud_noise`).
    min_depth : float
        Smallest depth it reports, in metres; readings below are "no reading".
    parts : ErrorParts, optional
        How much of the error neighbouring readings share, for ``objective="spatial"``; ``None``
        means unknown: each frame tells. They are used in place of `noise`, so a sensor given
        another noise wants ``parts=None``, too.
    waves : Waves, optional
        Systematic error that comes again along range or disparity (`planewise.waves`), which
        ``objective="spatial"`` takes off; ``None`` means unknown: each frame tells, unless `parts`
        are known, with which there are none.
    depth_range : float, optional
        R of the paper, in metres: a reading that no plane explains is one of R / eps values.
        ``None`` means `max_depth`.

    Raises
    ------
    ValueError
        If a length is not positive or above 1e9 m, the resolution is below 1e-12 m or not smaller
        than the range, `min_depth` does not lie in [0, max_depth), a noise that is a number is not
        positive and finite, or is a word other than "auto", or `parts` or `waves` are none. What a
        function of depth gives is checked where it is evaluated.

    Examples
    --------
    >>> sensor = Sensor(max_depth=10.0, resolution=0.001, noise=0.005)
    >>> sensor.range, sensor.sigma([1.0, 2.0])
    (10.0, array([0.005, 0.005]))
    """

    max_depth: float = 10.0
    resolution: float = 0.001
    noise: Noise | float | Auto = field(default_factory=lambda: proportional(0.01))
    min_depth: float = 0.0
    parts: ErrorParts | None = None
    waves: Waves | None = None
    depth_range: float | None = None

    def __post_init__(self) -> None:
        for name in ("max_depth", "resolution", "depth_range"):
            value = getattr(self, name)
            if value is None and name == "depth_range":
                continue
            if not (is_finite(value) and value > 0):
                raise ValueError(f"{name} must be a positive number of metres, got {value!r}")
            if value > MOST_LENGTH and name != "resolution":  # which is less than the range
                raise ValueError(
                    f"{name} must be at most {MOST_LENGTH:g} metres, got {value!r}; give the "
                    "largest depth that the sensor reports"
                )
        if self.resolution < LEAST_LENGTH:
            raise ValueError(
                f"resolution must be at least {LEAST_LENGTH:g} metres, got {self.resolution!r}; "
                "give the step between two readings"
            )
        if not (is_finite(self.min_depth) and 0 <= self.min_depth < self.max_depth):
            raise ValueError(
                f"min_depth must lie in [0, max_depth = {self.max_depth}) metres, "
                f"got {self.min_depth!r}"
            )
        if not self.resolution < self.range:
            raise ValueError(
                f"resolution must be smaller than the range: got {self.resolution} m against "
                f"{self.range} m; both are in metres"
            )
        make_plain(self, float, "max_depth", "resolution", "min_depth", "depth_range")
        parts: Any = self.parts
        if not (parts is None or isinstance(parts, ErrorParts)):
            raise ValueError(f"parts must be planewise.noise.ErrorParts or None, got {parts!r}")
        if parts is not None and isinstance(parts.white, Nothing):
            raise ValueError("parts.white must be more than nothing: no two readings err alike")
        waves: Any = self.waves
        if not (waves is None or isinstance(waves, Waves)):
            raise ValueError(f"waves must be planewise.waves.Waves or None, got {waves!r}")
        noise: Any = self.noise
        if not isinstance(noise, bool) and isinstance(noise, Real):
            object.__setattr__(self, "noise", constant(noise))  # type: ignore[arg-type]
        elif isinstance(noise, Nothing):
            raise ValueError("noise must be more than nothing: there is no sensor without")
        elif not (callable(noise) or (isinstance(noise, str) and noise == AUTO)):
            raise ValueError(f"noise must be a function of depth, metres or 'auto', got {noise!r}")

    @property
    def range(self) -> float:
        """R of the paper in metres."""
        return self.max_depth if self.depth_range is None else self.depth_range

    def sigma(self, z: ArrayLike) -> Array:
        """Standard deviation of readings at depths `z`, checked.

        Parameters
        ----------
        z : array_like
            Depths in metres.

        Returns
        -------
        ndarray
            sigma in metres, of the shape of `z`.

        Raises
        ------
        ValueError
            If the noise model returns another shape, or a sigma that is not positive, above 1e9 m
            or below 1e-12 of the depth; if the noise is "auto".
        """
        if self.noise == AUTO:
            raise ValueError(
                "noise='auto' is estimated from a depth image or a cloud and not known without; "
                "see planewise.estimate_noise, or give the noise as metres or a function of depth"
            )
        z = np.asarray(z, dtype=np.float64)
        assert callable(self.noise)
        sigma = evaluated("noise", self.noise, z)
        # Nearly always all of them are large enough for any depth.
        if sigma.size and sigma.min() >= FINEST * self.max_depth and sigma.max() <= MOST_LENGTH:
            return sigma
        bad = ~((sigma > 0) & (sigma <= MOST_LENGTH))  # as NaN is
        bad |= sigma < FINEST * np.minimum(z, self.max_depth)  # strays of a cloud are far beyond
        if bad.any():
            raise ValueError(
                f"noise must be positive and finite (metres, at most {MOST_LENGTH:g}, at least "
                f"{FINEST:g} of the depth), got "
                f"sigma = {sigma[bad].flat[0]} at z = {z[bad].flat[0]} m"
            )
        return sigma

    def describe(self) -> dict[str, float | str]:
        """Say in plain types what the sensor is, for result files."""
        said: dict[str, float | str] = {
            "max_depth_m": self.max_depth,
            "min_depth_m": self.min_depth,
            "range_m": self.range,
            "resolution_m": self.resolution,
            "noise": in_words(self.noise),
            "parts": self._describe_parts(),
        }
        return said if self.waves is None else said | {"waves": str(self.waves)}

    def _describe_parts(self) -> str:
        if self.noise == AUTO:
            return "estimated with the noise"
        return "told by each frame" if self.parts is None else str(self.parts)


def checked_sensor(sensor: object) -> Sensor:
    """Refuse what is no sensor, such as the name of one.

    Raises
    ------
    ValueError
        If it is not a `Sensor`.
    """
    if not isinstance(sensor, Sensor):
        raise ValueError(
            "sensor must be a planewise.Sensor, such as planewise.sensors.KINECT_V1, "
            f"got {type(sensor).__name__}"
        )
    return sensor
