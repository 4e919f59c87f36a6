"""Noise of a depth reading: the standard deviation sigma(z) in metres at depth z in metres.

Any callable that maps an array of depths to an array of sigmas of the same shape serves as a noise
model; the ones here also say what they are, so that a result file can record them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import is_finite, make_plain, real_numbers, shown

Array = NDArray[np.float64]
Noise = Callable[[Array], Array]
Auto = Literal["auto"]

AUTO: Auto = "auto"
"""In place of a noise model: estimate it from each frame (`planewise.calibration.estimate`)."""


@dataclass(frozen=True)
class Polynomial:
    """sigma(z) = constant + linear z + quadratic (z - offset)^2, in metres.

    Nearer than the offset the square is 0: noise does not grow towards the sensor.

    Parameters
    ----------
    constant : float
        Metres.
    linear : float
        Metres per metre.
    quadratic : float
        Metres per square metre.
    offset : float
        Depth up to which the quadratic term is 0, in metres.
    """

    constant: float = 0.0
    linear: float = 0.0
    quadratic: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        terms = (self.constant, self.linear, self.quadratic)
        for value in (*terms, self.offset):
            if not is_finite(value):
                raise ValueError(f"noise: sigma must be positive and a number, got {value!r}")
        if min(terms) < 0 or max(terms) == 0:
            raise ValueError(f"noise: sigma must be positive, got {self}")
        make_plain(self, float, "constant", "linear", "quadratic", "offset")

    def __call__(self, z: ArrayLike) -> Array:
        """Evaluate sigma at depths `z` (metres)."""
        z = np.asarray(z, dtype=np.float64)
        beyond = np.maximum(z - self.offset, 0.0)
        return self.constant + self.linear * z + self.quadratic * beyond**2

    def scaled(self, factor: float) -> Polynomial:
        """The same curve, `factor` times as high."""
        return Polynomial(
            self.constant * factor, self.linear * factor, self.quadratic * factor, self.offset
        )

    def __str__(self) -> str:
        """Write the formula, terms that are zero left out."""
        base = f"(z - {self.offset:g})^2" if self.offset else "z^2"
        parts = [(self.constant, ""), (self.linear, " z"), (self.quadratic, " " + base)]
        return (" + ".join(f"{size:g}{name}" for size, name in parts if size) or "0") + " m"


@dataclass(frozen=True)
class RootSum:
    """sigma(z) of independent errors together: the root of the sum of their squares, in metres.

    Parameters
    ----------
    parts : tuple of callable or float
        Standard deviations in metres at depth z, numbers at every depth; at least one.

    Examples
    --------
    >>> print(RootSum((constant(0.003), constant(0.004))))
    sqrt((0.003)^2 + (0.004)^2) m
    >>> RootSum((constant(0.003), constant(0.004)))([1.0, 2.0])
    array([0.005, 0.005])
    """

    parts: tuple[Noise | float, ...]

    def __post_init__(self) -> None:
        parts: Any = self.parts
        if not isinstance(parts, Iterable):
            raise ValueError(f"noise: a sum is of a tuple of parts, got {parts!r}")
        object.__setattr__(self, "parts", tuple(as_curve("parts", part) for part in parts))
        if not self.parts:
            raise ValueError("noise: a sum needs at least one part")

    def __call__(self, z: ArrayLike) -> Array:
        """Evaluate sigma at depths `z` (metres)."""
        z = np.asarray(z, dtype=np.float64)
        square = [np.square(evaluated("parts", part, z)) for part in self.parts]
        return np.asarray(np.sqrt(np.sum(square, axis=0)))

    def __str__(self) -> str:
        """Write the formula."""
        squares = (f"({in_words(part).removesuffix(' m')})^2" for part in self.parts)
        return f"sqrt({' + '.join(squares)}) m"


@dataclass(frozen=True)
class Nothing:
    """An error that is not there: sigma(z) = 0."""

    def __call__(self, z: ArrayLike) -> Array:
        """Return zeros of the shape of `z`."""
        return np.zeros(np.shape(z))

    def __str__(self) -> str:
        return "0 m"


NOTHING = Nothing()
"""Part of an error that is not there."""


@dataclass(frozen=True, kw_only=True)
class ErrorParts:
    """What a sensor's error consists of: neighbouring readings do not err independently.

    A number instead of a curve is a standard deviation in metres at every depth, 0 none.

    Attributes
    ----------
    white : callable
        Standard deviation in metres at depth z of what is new in every reading, quantisation apart.
    shared : callable
        Standard deviation in metres of what readings some ten pixels apart still share.
    drift : callable
        Standard deviation in metres by which the error wanders over 100 pixels, like a random walk.
    bounds : bool
        Whether shared and drift are the most that a frame may show; else only their course over
        depth is taken, and each frame tells their size.
    """

    white: Noise | float
    shared: Noise | float
    drift: Noise | float
    bounds: bool = True

    def __post_init__(self) -> None:
        for name in ("white", "shared", "drift"):
            object.__setattr__(self, name, as_curve(f"parts.{name}", getattr(self, name)))
        if not isinstance(self.bounds, bool):
            raise ValueError(f"parts.bounds must be True or False, got {self.bounds!r}")

    def __str__(self) -> str:
        white, shared, drift = map(in_words, (self.white, self.shared, self.drift))
        size = "" if self.bounds else ", of a size that each frame tells"
        return f"white {white}, shared {shared}, drift {drift} over 100 px{size}"


def constant(sigma: float) -> Polynomial:
    """Noise that does not depend on depth.

    Parameters
    ----------
    sigma : float
        Standard deviation in metres.

    Examples
    --------
    >>> print(constant(0.005))
    0.005 m
    """
    return Polynomial(constant=sigma)


def is_constant(noise: Noise | float | Auto) -> bool:
    """Whether noise is known to be the same at every depth, however far.

    Examples
    --------
    >>> is_constant(constant(0.005)), is_constant(proportional(0.01)), is_constant(AUTO)
    (True, False, False)
    """
    return isinstance(noise, Polynomial) and not noise.linear and not noise.quadratic


def as_curve(name: str, noise: Any) -> Noise:
    """Curve of one standard deviation in metres, or the one given.

    Raises
    ------
    ValueError
        If it is neither a number nor a function.
    """
    if not isinstance(noise, bool) and isinstance(noise, Real):
        return constant(noise) if noise else NOTHING  # type: ignore[arg-type]
    if not callable(noise):
        raise ValueError(f"{name} must be metres or a function of depth, got {noise!r}")
    made: Noise = noise
    return made


def in_words(noise: Noise | float | Auto) -> str:
    """Formula of a noise model; of a function without one its qualified name, as of a class's.

    Examples
    --------
    >>> in_words(constant(0.005)), in_words(np.sqrt), in_words(is_constant)
    ('0.005 m', "<ufunc 'sqrt'>", 'is_constant')
    """
    said = str(noise)
    if " at 0x" not in said:  # where it lies in memory, which is another place in every run
        return said
    return str(getattr(noise, "__qualname__", type(noise).__qualname__))


def evaluated(name: str, noise: Noise | float, z: Array) -> Array:
    """Standard deviations in metres at depths `z`, of their shape; their values are unchecked.

    Raises
    ------
    ValueError
        If the curve does not give a number for each.
    """
    given: Any = as_curve(name, noise)(z.copy())  # it may work in place
    try:
        sigma = real_numbers(name, given, "real")
    except ValueError:
        raise ValueError(f"{name} must return one sigma per depth, got {shown(given)}") from None
    if sigma.ndim and sigma.shape != z.shape:
        raise ValueError(
            f"{name} must return one sigma per depth: expected shape {z.shape}, got {sigma.shape}"
        )
    return sigma if sigma.shape == z.shape else np.full(z.shape, float(sigma))


def proportional(fraction: float) -> Polynomial:
    """Noise proportional to depth, as most data sheets state it: sigma = fraction z.

    Examples
    --------
    >>> proportional(0.01)([1.0, 3.0])
    array([0.01, 0.03])
    """
    return Polynomial(linear=fraction)


def quadratic(constant: float, quadratic: float, offset: float = 0.0) -> Polynomial:
    """Noise of a triangulating sensor: sigma = constant + quadratic (z - offset)^2.

    Nearer than the offset it is constant.

    Examples
    --------
    >>> print(quadratic(0.001, 0.002))
    0.001 + 0.002 z^2 m
    """
    return Polynomial(constant=constant, quadratic=quadratic, offset=offset)


def stereo(*, focal: float, baseline: float, subpixel: float = 0.08) -> Polynomial:
    """Noise of a stereo pair, from its geometry: sigma = subpixel z^2 / (focal baseline).

    Parameters
    ----------
    focal : float
        Focal length of the depth image in pixels.
    baseline : float
        Distance between the two imagers in metres.
    subpixel : float
        Standard deviation of the matched disparity in pixels; Intel's tuning guide for the D400
        family takes 0.08 as typical of a textured surface.
    """
    for name, value in (("focal", focal), ("baseline", baseline), ("subpixel", subpixel)):
        if not (is_finite(value) and value > 0):
            raise ValueError(f"{name} must be positive and finite, got {value!r}")
    product = float(focal) * float(baseline)
    if not 0 < product < math.inf:
        raise ValueError(f"focal and baseline are those of no camera: {focal!r} and {baseline!r}")
    return Polynomial(quadratic=subpixel / product)


KINECT = quadratic(0.0012, 0.0019, 0.4)
"""Axial noise of the first Kinect (Nguyen, Izadi, Lovell 2012), the paper's experimental model."""

KINECT_PARTS = ErrorParts(
    white=quadratic(0.0, 0.0015), shared=quadratic(0.0, 0.0010), drift=quadratic(0.0, 0.0035)
)
"""Parts of the first Kinect's error, measured on planes of real frames (docs/frame-error.md)."""
