"""What a search minimises: a mask code, an error model and a null model, each replaceable.

The data term of every objective here is a truncated sum of squares,

    sum over inliers of [delta^2 / (2 sigma^2) - tau],

where tau, what a reading saves on a plane it fits exactly, follows from the error and the null.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import is_finite
from planewise.information import (
    exact_fit_information,
    mask_information,
    outlier_information,
    plane_information,
)
from planewise.observation import Observation

Array = NDArray[np.float64]


class MaskCode(Protocol):
    """Length of the code that says which reading belongs to which plane."""

    def information(self, readings: int, planes: int) -> float:
        """Nats for `readings` labels out of `planes` + 1."""
        ...


class ErrorModel(Protocol):
    """Information of a reading's residual to its plane."""

    def exact_fit(self, observation: Observation) -> Array:
        """Nats of every reading, shape (k,), were its residual zero."""
        ...


class NullModel(Protocol):
    """Information of a reading that belongs to no plane."""

    def information(self, observation: Observation) -> Array:
        """Nats of every reading, shape (k,)."""
        ...


@dataclass(frozen=True)
class UniformMask:
    """Every label is equally likely everywhere: k ln(N + 1) (paper, eq. 6)."""

    def information(self, readings: int, planes: int) -> float:
        """Nats for `readings` labels out of `planes` + 1."""
        return mask_information(readings, planes)


@dataclass(frozen=True)
class IndependentError:
    """Every reading errs on its own, normally with its sigma (paper, eq. 4)."""

    def exact_fit(self, observation: Observation) -> Array:
        """(f - 1) ln(R / eps) + 1/2 ln(2 pi sigma^2 / eps^2)."""
        within = outlier_information(
            observation.freedom - 1, observation.range, observation.resolution
        )
        resolution = observation.resolution
        return observation.of_sigma(lambda sigma: within + exact_fit_information(sigma, resolution))


@dataclass(frozen=True)
class UniformNull:
    """An outlier may have any value: f ln(R / eps) (paper, eq. 1)."""

    def information(self, observation: Observation) -> Array:
        """C_out for every reading."""
        cost = outlier_information(observation.freedom, observation.range, observation.resolution)
        return np.full(observation.count, cost)


@dataclass(frozen=True, kw_only=True)
class Objective:
    """A code length for planes and labels; the default is the paper's.

    Parameters
    ----------
    mask : MaskCode
        Code of the labels.
    error : ErrorModel
        Information of inliers.
    null : NullModel
        Information of outliers.
    """

    mask: MaskCode = field(default_factory=UniformMask)
    error: ErrorModel = field(default_factory=IndependentError)
    null: NullModel = field(default_factory=UniformNull)

    def __post_init__(self) -> None:
        for name, method in (
            ("mask", "information"),
            ("error", "exact_fit"),
            ("null", "information"),
        ):
            part = getattr(self, name)
            if not callable(getattr(part, method, None)):
                raise ValueError(f"objective: {name} must have a method {method}, got {part!r}")

    def thresholds(self, observation: Observation) -> Array:
        """tau of every reading, shape (k,): null minus error information at an exact fit."""
        return self._outliers(observation) - _checked(
            "error.exact_fit", self.error.exact_fit(observation), observation
        )

    def empty(self, observation: Observation) -> float:
        """Phi_0: no plane."""
        return self.all_outliers(observation) + self._mask(observation.count, 0)

    def all_outliers(self, observation: Observation) -> float:
        """Nats of the readings with no plane, the mask not among them."""
        return float(self._outliers(observation).sum())

    def structure(
        self, observation: Observation, planes: int, readings: int | None = None
    ) -> float:
        """Nats that planes cost before they explain anything: their parameters and the mask.

        `readings` is how many the mask is of, if not all.
        """
        cost = plane_information(observation.dimension, observation.range, observation.resolution)
        count = observation.count if readings is None else readings
        return planes * cost + self._mask(count, planes)

    def _mask(self, count: int, planes: int) -> float:
        nats = self.mask.information(count, planes)
        if not is_finite(nats):
            raise ValueError(f"objective: mask.information must return finite nats, got {nats!r}")
        return float(nats)

    def _outliers(self, observation: Observation) -> Array:
        return _checked("null.information", self.null.information(observation), observation)


def _checked(name: str, nats: Array, observation: Observation) -> Array:
    """Refuse what is not one finite number for each reading."""
    given = np.asarray(nats)
    if given.shape != (observation.count,) or given.dtype.kind not in "fiu":
        found = f"shape {given.shape}" if given.dtype.kind in "fiu" else f"dtype {given.dtype}"
        raise ValueError(
            f"objective: {name} must return nats for each of {observation.count} readings, "
            f"shape ({observation.count},), got {found}"
        )
    if not np.isfinite(given).all():
        raise ValueError(
            f"objective: {name} must return finite nats, got {given[~np.isfinite(given)][0]}"
        )
    return np.asarray(given, np.float64)


PAPER = Objective()
"""Uniform mask code, independent error, uniform null."""

SPATIAL = "spatial"
"""Name of the spatial objective, whose parts are not separable: see `spatial.information`."""


def as_objective(objective: Objective | str) -> Objective:
    """Objective of that name, or the one given.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if isinstance(objective, Objective):
        return objective
    if not isinstance(objective, str) or objective != "paper":
        raise ValueError(f"objective must be 'paper', 'spatial' or an Objective, got {objective!r}")
    return PAPER
