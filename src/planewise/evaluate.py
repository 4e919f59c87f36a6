"""Gains of readings on planes: the bridge from an observation to the compiled loops.

A search sees readings only through an `Evaluator`. Planes travel as parameter rows whose meaning
is the evaluator's own: theta (theta . x = 1) for readings on rays, where it makes the likelihood
linear in inverse depth; (normal, distance) about the centre of the points for free points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from planewise import threads
from planewise.kernels import readings as kernels
from planewise.observation import Observation, PointObservation, RayObservation

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

MAX_PLANES = np.iinfo(np.uint16).max
_SQRT2 = np.sqrt(2.0)


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

    @abstractmethod
    def assign(self, parameters: Array) -> Assignment:
        """Give every reading to the plane of lowest gain, in double precision."""

    @abstractmethod
    def refit(self, parameters: Array, labels: Labels, stretch: float = 1.0) -> Array:
        """One step of the likelihood's least squares for every plane, `stretch` times as long.

        Planes that their readings do not determine stay.
        """

    @abstractmethod
    def coefficients(self, parameters: Array) -> Array:
        """Unit normal and distance of every plane: (N, p) -> (N, n + 1), distance >= 0."""

    @abstractmethod
    def covariances(self, parameters: Array, labels: Labels) -> Array:
        """Covariance of (normal, distance) of every plane: the Cramer-Rao bound, singular."""


class RayEvaluator(Evaluator):
    """Evaluator of readings on rays; parameters are theta = -normal / distance."""

    dimension = 3
    width = 3

    def __init__(self, a: Array, s: Array, tau: Array, threads: int = 1) -> None:
        self.a, self.s, self.tau, self.threads = a, s, tau, threads
        self._single: tuple[NDArray[np.float32], ...] | None = None

    @classmethod
    def of(cls, observation: RayObservation, tau: Array, threads: int = 1) -> RayEvaluator:
        """Whiten an observation."""
        scale = _SQRT2 * observation.sigma
        return cls(observation.rays * scale, observation.depth / scale, tau, threads)

    def subset(self, chosen: NDArray[np.int64]) -> RayEvaluator:
        """Evaluate only these readings."""
        return RayEvaluator(
            np.ascontiguousarray(self.a[:, chosen]), self.s[chosen], self.tau[chosen], self.threads
        )

    def through(self, chosen: NDArray[np.int64]) -> Array:
        """Solve theta . x = 1 for three points x: theta = sum of cross products / determinant."""
        x, y, z = ((self.a[:, i] * self.s[i]).T for i in chosen.T)
        normal = np.cross(y - x, z - x)
        determinant = np.einsum("ti,ti->t", normal, x)
        span = np.linalg.norm(y - x, axis=1) * np.linalg.norm(z - x, axis=1)
        flat = np.linalg.norm(normal, axis=1) <= 1e-9 * span
        with np.errstate(divide="ignore", invalid="ignore"):
            theta = normal / determinant[:, None]
        theta[flat | ~np.isfinite(theta).all(axis=1)] = np.nan
        return np.asarray(theta)

    def scores(self, parameters: Array, floor: Array | None = None) -> Array:
        """Sum over readings of min(0, gain - floor) for every plane."""
        if self._single is None:
            self._single = self.a.astype(np.float32), self.s.astype(np.float32)
        a, s = self._single
        ceiling = (self.tau if floor is None else self.tau + floor).astype(np.float32)
        theta = parameters.astype(np.float32)
        total = np.empty(len(theta))
        threads.over_chunks(
            lambda first, last: kernels.score_rays(theta, a, s, ceiling, first, last, total),
            len(theta),
            self.threads,
        )
        return total

    def assign(self, parameters: Array) -> Assignment:
        """Give every reading to the plane of lowest gain."""
        out = _assignment(self.count, len(parameters))
        kernels.assign_rays(
            parameters, self.a, self.s, self.tau, out.best, out.second, out.labels, out.cumulative
        )
        return out

    def refit(self, parameters: Array, labels: Labels, stretch: float = 1.0) -> Array:
        """One Gauss-Newton step of sum delta^2 / (2 sigma^2) for every plane."""
        _, moved = self._gauss_newton(parameters, labels)
        moved = parameters + stretch * (moved - parameters)
        return np.where(np.isfinite(moved).all(axis=1, keepdims=True), moved, parameters)

    def coefficients(self, parameters: Array) -> Array:
        """normal = -theta / |theta|, distance = 1 / |theta|: the normal faces the sensor."""
        size = np.linalg.norm(parameters, axis=1, keepdims=True)
        return np.hstack((-parameters / size, 1.0 / size))

    def covariances(self, parameters: Array, labels: Labels) -> Array:
        """Inverse Fisher information of theta, carried over to (normal, distance)."""
        fisher = 2.0 * self._gauss_newton(parameters, labels)[0]
        out = np.full((len(parameters), 4, 4), np.nan)
        for j, theta in enumerate(parameters):
            out[j] = covariance_of_plane(theta, _inverse(fisher[j]))
        return out

    def _gauss_newton(self, parameters: Array, labels: Labels) -> tuple[Array, Array]:
        matrix = np.empty((len(parameters), 3, 3))
        moved = np.empty((len(parameters), 3))
        kernels.gauss_newton(parameters, self.a, self.s, labels, matrix, moved)
        return matrix, moved


class PointEvaluator(Evaluator):
    """Evaluator of free points; parameters are (normal, distance) about the points' centre."""

    def __init__(self, x: Array, tau: Array, origin: Array, threads: int = 1) -> None:
        self.x, self.tau, self.origin, self.threads = x, tau, origin, threads
        self.dimension, self.width = x.shape[0] - 1, x.shape[0]
        self._single: NDArray[np.float32] | None = None

    @classmethod
    def of(cls, observation: PointObservation, tau: Array, threads: int = 1) -> PointEvaluator:
        """Whiten an observation."""
        ones = np.ones((1, observation.count))
        scale = _SQRT2 * observation.sigma
        x = np.vstack((observation.points, ones)) / scale
        return cls(np.ascontiguousarray(x), tau, observation.origin, threads)

    def subset(self, chosen: NDArray[np.int64]) -> PointEvaluator:
        """Evaluate only these readings."""
        x = np.ascontiguousarray(self.x[:, chosen])
        return PointEvaluator(x, self.tau[chosen], self.origin, self.threads)

    def through(self, chosen: NDArray[np.int64]) -> Array:
        """Normal = null space of the differences of n points."""
        points = (self.x[:-1, chosen] / self.x[-1, chosen]).transpose(1, 2, 0)
        differences = points[:, 1:] - points[:, :1]
        _, size, basis = np.linalg.svd(differences)
        normal = basis[:, -1]
        distance = -np.einsum("ti,ti->t", normal, points[:, 0])
        plane = np.hstack((normal, distance[:, None]))
        plane[size[:, -1] <= 1e-9 * size[:, 0]] = np.nan
        return np.asarray(plane)

    def scores(self, parameters: Array, floor: Array | None = None) -> Array:
        """Sum over points of min(0, gain - floor) for every plane."""
        if self._single is None:
            self._single = self.x.astype(np.float32)
        x = self._single
        ceiling = (self.tau if floor is None else self.tau + floor).astype(np.float32)
        planes = parameters.astype(np.float32)
        total = np.empty(len(planes))
        threads.over_chunks(
            lambda first, last: kernels.score_points(planes, x, ceiling, first, last, total),
            len(planes),
            self.threads,
        )
        return total

    def assign(self, parameters: Array) -> Assignment:
        """Give every point to the plane of lowest gain."""
        out = _assignment(self.count, len(parameters))
        kernels.assign_points(
            parameters, self.x, self.tau, out.best, out.second, out.labels, out.cumulative
        )
        return out

    def refit(self, parameters: Array, labels: Labels, stretch: float = 1.0) -> Array:
        """Weighted total least squares, which is the likelihood's optimum: no iteration needed."""
        matrix = self._scatter(len(parameters), labels)
        moved = parameters.copy()
        for j, m in enumerate(matrix):
            if np.count_nonzero(labels == j + 1) < self.dimension:
                continue
            centre = m[:-1, -1] / m[-1, -1]
            spread = m[:-1, :-1] - np.outer(centre, m[:-1, -1])
            normal = np.linalg.eigh(spread)[1][:, 0]
            if normal @ parameters[j, :-1] < 0:
                normal = -normal
            moved[j] = (*normal, -normal @ centre)
        moved = parameters + stretch * (moved - parameters)
        return np.asarray(moved / np.linalg.norm(moved[:, :-1], axis=1, keepdims=True))

    def coefficients(self, parameters: Array) -> Array:
        """Move the distance back to the caller's origin; distance >= 0."""
        normal, distance = parameters[:, :-1], parameters[:, -1]
        distance = distance - normal @ self.origin
        sign = np.where(distance < 0, -1.0, 1.0)
        for j in np.flatnonzero(distance == 0):
            sign[j] = np.sign(normal[j][np.flatnonzero(normal[j])[0]])
        return np.hstack((normal, distance[:, None])) * sign[:, None]

    def covariances(self, parameters: Array, labels: Labels) -> Array:
        """Inverse Fisher information on the n free directions of (normal, distance)."""
        size = self.dimension + 1
        fisher = 2.0 * self._scatter(len(parameters), labels)
        out = np.full((len(parameters), size, size), np.nan)
        for j, plane in enumerate(parameters):
            # The normal moves in its tangent space; the distance moves freely.
            tangent = np.zeros((size, self.dimension))
            tangent[:-1, :-1] = np.linalg.svd(plane[None, :-1])[2][1:].T
            tangent[-1, -1] = 1.0
            shift = np.eye(size)
            shift[-1, :-1] = -self.origin
            basis = shift @ tangent
            out[j] = basis @ _inverse(tangent.T @ fisher[j] @ tangent) @ basis.T
        return out

    def _scatter(self, planes: int, labels: Labels) -> Array:
        matrix = np.empty((planes, self.dimension + 1, self.dimension + 1))
        kernels.scatter(self.x, labels, matrix)
        return matrix


def evaluator(observation: Observation, tau: Array, threads: int = 1) -> Evaluator:
    """Evaluator that fits the observation."""
    if isinstance(observation, RayObservation):
        return RayEvaluator.of(observation, tau, threads)
    if isinstance(observation, PointObservation):
        return PointEvaluator.of(observation, tau, threads)
    raise TypeError(f"no evaluator for {type(observation).__name__}")


def covariance_of_plane(theta: Array, covariance: Array) -> Array:
    """Covariance of theta carried over to (normal, distance) = (-theta, 1) / |theta|."""
    size = np.linalg.norm(theta)
    unit = theta / size
    jacobian = np.vstack((-(np.eye(3) - np.outer(unit, unit)) / size, -unit[None] / size**2))
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _assignment(count: int, planes: int) -> Assignment:
    if planes > MAX_PLANES:
        raise ValueError(f"at most {MAX_PLANES} planes fit a 16-bit label image, got {planes}")
    return Assignment(
        labels=np.empty(count, np.uint16),
        best=np.empty(count),
        second=np.empty(count),
        cumulative=np.empty(planes + 1),
    )


def _inverse(matrix: Array) -> Array:
    """Inverse of a positive definite matrix, scaled to unit diagonal; NaN if it has none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / np.sqrt(np.diag(matrix))
        scaled = matrix * np.outer(scale, scale)
    if not np.isfinite(scaled).all() or np.linalg.cond(scaled) > 1e12:
        return np.full(matrix.shape, np.nan)
    return np.asarray(np.linalg.inv(scaled) * np.outer(scale, scale))
