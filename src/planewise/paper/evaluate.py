"""Gains of readings on planes: the bridge from an observation to the compiled loops.

A search sees readings only through an `Evaluator`. Planes travel as parameter rows whose meaning
is the evaluator's own: theta (theta . x = 1) for readings on rays, where it makes the likelihood
linear in inverse depth; (normal, distance) about the centre of the points for free points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.readings import PART
from planewise.model import MAX_PLANES
from planewise.observation import Observation, RayObservation
from planewise.point_observation import PointObservation
from planewise.runtime import threads

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

FEWEST_PARTS = 2  # that are worth a thread
_FEWEST_SCORES = 1_000_000  # readings times planes that are worth a thread


@dataclass(frozen=True)
class Assignment:
    """Every reading given to its best plane.

    Attributes
    ----------
    labels : ndarray of uint16, shape (k,)
        0 for none, j for the plane of row j - 1.
    best, second : ndarray, shape (k,)
        Lowest and second-lowest gain, none (zero) included.
    cumulative : ndarray, shape (N + 1,)
        Sum of best gains if only the first 0 ... N planes were there.
    """

    labels: Labels
    best: Array
    second: Array
    cumulative: Array

    @classmethod
    def of(cls, labels: Labels, gains: Array, planes: int) -> Assignment:
        """Assignment with given labels, whose readings fall back to none."""
        sums = np.bincount(labels, weights=gains, minlength=planes + 1)[1:]
        cumulative = np.concatenate(([0.0], np.cumsum(sums)))
        return cls(labels, gains, np.zeros_like(gains), cumulative)

    @property
    def gain(self) -> float:
        """Sum of best gains in nats, negative."""
        return float(self.cumulative[-1])


class Evaluator(ABC):
    """Readings, whitened for the compiled loops.

    Attributes
    ----------
    tau : ndarray, shape (k,)
        What a reading saves on a plane it fits exactly.
    dimension : int
        Readings that determine a plane.
    width : int
        Numbers in a row of parameters.
    threads : int
        Used where work splits without changing a result.
    """

    tau: Array
    dimension: int
    width: int
    threads: int

    @property
    def count(self) -> int:
        """Number of readings."""
        return self.tau.size

    @abstractmethod
    def subset(self, chosen: NDArray[np.int64]) -> Self:
        """Evaluate only these readings."""

    @abstractmethod
    def through(self, chosen: NDArray[np.int64]) -> Array:
        """Planes through readings: chosen (T, n) -> parameters (T, p), NaN where degenerate."""

    @abstractmethod
    def scores(self, parameters: Array, floor: Array | None = None) -> Array:
        """What each plane would save, in single precision.

        Parameters
        ----------
        parameters : ndarray, shape (T, p)
            Candidate planes.
        floor : ndarray, shape (k,), optional
            Gain that every reading already has (at most zero); ``None`` means none has any.

        Returns
        -------
        ndarray, shape (T,)
            Sum over readings of min(0, gain - floor), nats.
        """

    def lowest(self, parameters: Array) -> tuple[int, float]:
        """Row of the plane that saves most (the first of equal ones), and its score."""
        scores = self.scores(parameters)
        pick = int(np.argmin(scores))
        return pick, float(scores[pick])

    @abstractmethod
    def assign(self, parameters: Array) -> Assignment:
        """Give every reading to the plane of lowest gain, in double precision."""

    @abstractmethod
    def refit(self, parameters: Array, labels: Labels, stretch: float = 1.0) -> Array:
        """One step of the likelihood's least squares for every plane, `stretch` times as long.

        Planes that their readings do not determine stay.
        """

    def offer(self, plane: Array, floor: Array | None = None) -> tuple[float, Array]:
        """What one plane saves above `floor`, and the plane refitted on the readings it takes.

        Parameters
        ----------
        plane : ndarray, shape (p,)
            Parameters.
        floor : ndarray, shape (k,), optional
            Gain that every reading already has (at most zero); ``None`` means none has any.

        Returns
        -------
        saved : float
            Sum over readings of min(0, gain - floor), nats.
        moved : ndarray, shape (p,)
            The plane itself where its readings do not determine one.
        """
        gains = self.assign(plane[None]).best
        floor = np.zeros_like(gains) if floor is None else floor
        taken = (gains < floor).astype(np.uint16)
        saved = float(np.minimum(gains - floor, 0.0).sum())
        return saved, self.refit(plane[None], taken)[0]

    @abstractmethod
    def coefficients(self, parameters: Array) -> Array:
        """Unit normal and distance of every plane: (N, p) -> (N, n + 1), distance >= 0."""

    @abstractmethod
    def covariances(self, parameters: Array, labels: Labels) -> Array:
        """Covariance of (normal, distance) of every plane: the Cramer-Rao bound, singular."""


def evaluator(observation: Observation, tau: Array, threads: int = 1) -> Evaluator:
    """Evaluator that fits the observation."""
    # These two import this module.
    from planewise.paper.point_evaluator import PointEvaluator
    from planewise.paper.ray_evaluator import RayEvaluator

    if isinstance(observation, RayObservation):
        return RayEvaluator.of(observation, tau, threads)
    if isinstance(observation, PointObservation):
        return PointEvaluator.of(observation, tau, threads)
    raise TypeError(f"no evaluator for {type(observation).__name__}")


def covariance_of_plane(theta: Array, covariance: Array) -> Array:
    """Covariance of theta carried over to (normal, distance) = (-theta, 1) / |theta|.

    theta (..., 3) and covariance (..., 3, 3) to (..., 4, 4).
    """
    size = np.linalg.norm(theta, axis=-1)[..., None, None]
    unit = theta[..., None, :] / size
    across = np.eye(3) - np.swapaxes(unit, -1, -2) * unit
    jacobian = np.concatenate((-across / size, -unit / size**2), axis=-2)
    return np.asarray(jacobian @ covariance @ np.swapaxes(jacobian, -1, -2))


def scored(
    planes: NDArray[np.float32],
    readings: int,
    workers: int,
    work: Callable[[int, int, Array], None],
) -> Array:
    """Scores of planes that ``work(first, last, total)`` writes, some planes a thread."""
    total = np.empty(len(planes))
    threads.over_chunks(
        lambda first, last: work(first, last, total),
        len(planes),
        workers,
        1 + _FEWEST_SCORES // (1 + readings),
    )
    return total


def assigned(
    count: int,
    planes: int,
    workers: int,
    work: Callable[[int, int, Array, Array, Labels, Array], None],
) -> Assignment:
    """Assignment that ``work(first, last, best, second, labels, sums)`` writes part by part."""
    if planes > MAX_PLANES:
        raise ValueError(f"at most {MAX_PLANES} planes fit a 16-bit label image, got {planes}")
    best, second, labels = np.empty(count), np.empty(count), np.empty(count, np.uint16)
    sums = np.empty((part_count(count), planes + 1))
    threads.over_chunks(
        lambda first, last: work(first, last, best, second, labels, sums),
        len(sums),
        workers,
        FEWEST_PARTS,
    )
    return Assignment(labels, best, second, sums.sum(axis=0))


def part_count(count: int) -> int:
    """Parts of so many readings; sums over parts make results the same for any thread count."""
    return -(-count // PART)


def inverse(matrix: Array) -> Array:
    """Inverse of a positive definite matrix, scaled to unit diagonal; NaN if it has none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / np.sqrt(np.diag(matrix))
        scaled = matrix * np.outer(scale, scale)
    if not np.isfinite(scaled).all() or np.linalg.cond(scaled) > 1e12:
        return np.full(matrix.shape, np.nan)
    return np.asarray(np.linalg.inv(scaled) * np.outer(scale, scale))
