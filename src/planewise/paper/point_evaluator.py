"""Gains of free points in n dimensions; parameters are (normal, distance) about their centre."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import readings as kernels
from planewise.paper.evaluate import (
    Array,
    Assignment,
    Evaluator,
    Labels,
    assigned,
    inverse,
    scored,
)
from planewise.point_observation import UNTOLD, PointObservation


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
        scale = np.sqrt(2.0) * observation.sigma
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
            with np.errstate(over="ignore"):  # of strays, which gain nothing
                self._single = self.x.astype(np.float32)
        x = self._single
        ceiling = (self.tau if floor is None else self.tau + floor).astype(np.float32)
        planes = parameters.astype(np.float32)
        return scored(
            planes,
            self.count,
            self.threads,
            lambda *rest: kernels.score_points(planes, x, ceiling, *rest),
        )

    def assign(self, parameters: Array) -> Assignment:
        """Give every point to the plane of lowest gain."""
        return assigned(
            self.count,
            len(parameters),
            self.threads,
            lambda *rest: kernels.assign_points(parameters, self.x, self.tau, *rest),
        )

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
        """Inverse Fisher information on the n free directions of (normal, distance).

        Scatter S along the plane has noise in it, too: slopes have that of principal axes
        (Anderson 1963), (S - noise)^-1 S (S - noise)^-1. NaN where they are not told.
        """
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
            known = tangent.T @ fisher[j] @ tangent
            noise = plane @ fisher[j] @ plane
            slopes = inverse(known)[:-1, :-1]
            known[:-1, :-1] += noise * (noise * slopes - 2.0 * np.eye(self.dimension - 1))
            found = inverse(known)
            if found[:-1, :-1].trace() < UNTOLD:
                out[j] = basis @ found @ basis.T
        return out

    def _scatter(self, planes: int, labels: Labels) -> Array:
        matrix = np.empty((planes, self.dimension + 1, self.dimension + 1))
        kernels.scatter(self.x, labels, matrix)
        return matrix
