"""Gains of readings on known rays; parameters are theta = -normal / distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import readings as kernels
from planewise.kernels.samples import planes_through_rays
from planewise.observation import RayObservation
from planewise.paper.evaluate import (
    FEWEST_PARTS,
    Array,
    Assignment,
    Evaluator,
    Labels,
    assigned,
    covariance_of_plane,
    inverse,
    part_count,
    scored,
)
from planewise.paper.runs import Runs
from planewise.runtime.threads import over_chunks

_FEWEST_SAMPLES = 2048  # whose planes are worth a thread
_FEWEST_OFFERED = 4  # parts whose sums for one plane take longer than a thread to begin


class RayEvaluator(Evaluator):
    """Evaluator of readings on rays; parameters are theta = -normal / distance."""

    dimension = 3
    width = 3

    def __init__(self, a: Array, s: Array, tau: Array, threads: int = 1) -> None:
        self.a, self.s, self.tau, self.threads = a, s, tau, threads
        self._single: tuple[NDArray[np.float32], ...] | None = None
        self._runs: Runs | None = None

    @classmethod
    def of(cls, observation: RayObservation, tau: Array, threads: int = 1) -> RayEvaluator:
        """Whiten an observation."""
        rays, depth, sigma = observation.rays, observation.depth, observation.sigma
        a, s = np.empty(rays.shape), np.empty(depth.shape)

        def whiten(first: int, last: int) -> None:
            scale = np.sqrt(2.0) * sigma[first:last]
            np.multiply(rays[:, first:last], scale, out=a[:, first:last])
            np.divide(depth[first:last], scale, out=s[first:last])

        over_chunks(whiten, depth.size, threads, FEWEST_PARTS * kernels.PART)
        return cls(a, s, tau, threads)

    def subset(self, chosen: NDArray[np.int64]) -> RayEvaluator:
        """Evaluate only these readings."""
        out = np.empty((5, chosen.size))
        over_chunks(
            lambda first, last: kernels.gather_rays(
                self.a, self.s, self.tau, chosen, first, last, out
            ),
            chosen.size,
            self.threads,
            FEWEST_PARTS * kernels.PART,
        )
        return RayEvaluator(out[:3], out[3], out[4], self.threads)

    def through(self, chosen: NDArray[np.int64]) -> Array:
        """Solve theta . x = 1 for three points x."""
        theta = np.empty((len(chosen), 3))
        over_chunks(
            lambda first, last: planes_through_rays(self.a, self.s, chosen, first, last, theta),
            len(chosen),
            self.threads,
            _FEWEST_SAMPLES,
        )
        return theta

    def lowest(self, parameters: Array) -> tuple[int, float]:
        """Row of the plane that saves most and its score, by branch and bound: see `Runs`."""
        if self._runs is None:
            self._runs = Runs.of(self.a, self.s, self.tau, self.threads)
        return self._runs.lowest(parameters)

    def scores(self, parameters: Array, floor: Array | None = None) -> Array:
        """Sum over readings of min(0, gain - floor) for every plane."""
        if self._single is None:
            self._single = self.a.astype(np.float32), self.s.astype(np.float32)
        a, s = self._single
        ceiling = self._ceiling(floor).astype(np.float32)
        theta = parameters.astype(np.float32)
        return scored(
            theta,
            self.count,
            self.threads,
            lambda *rest: kernels.score_rays(theta, a, s, ceiling, *rest),
        )

    def assign(self, parameters: Array) -> Assignment:
        """Give every reading to the plane of lowest gain."""
        return assigned(
            self.count,
            len(parameters),
            self.threads,
            lambda *rest: kernels.assign_rays(parameters, self.a, self.s, self.tau, *rest),
        )

    def refit(self, parameters: Array, labels: Labels, stretch: float = 1.0) -> Array:
        """One Gauss-Newton step of sum delta^2 / (2 sigma^2) for every plane."""
        _, moved = self._gauss_newton(parameters, labels)
        moved = parameters + stretch * (moved - parameters)
        return np.where(np.isfinite(moved).all(axis=1, keepdims=True), moved, parameters)

    def offer(self, plane: Array, floor: Array | None = None) -> tuple[float, Array]:
        """Sum of min(0, gain - floor), and one Gauss-Newton step on the readings below."""
        theta, ceiling = plane[None], self._ceiling(floor)
        parts = part_count(self.count)
        sums, saved = np.empty((parts, 1, 9)), np.empty(parts)
        over_chunks(
            lambda first, last: kernels.offer_sums(
                theta, self.a, self.s, ceiling, first, last, sums, saved
            ),
            parts,
            self.threads,
            _FEWEST_OFFERED,
        )
        moved = np.empty((1, 3))
        kernels.gauss_newton(theta, sums, np.empty((1, 3, 3)), moved)
        return float(saved.sum()), moved[0] if np.isfinite(moved).all() else plane

    def coefficients(self, parameters: Array) -> Array:
        """normal = -theta / |theta|, distance = 1 / |theta|: the normal faces the sensor."""
        size = np.linalg.norm(parameters, axis=1, keepdims=True)
        return np.hstack((-parameters / size, 1.0 / size))

    def covariances(self, parameters: Array, labels: Labels) -> Array:
        """Inverse Fisher information of theta, carried over to (normal, distance)."""
        fisher = 2.0 * self._gauss_newton(parameters, labels)[0]
        out = np.full((len(parameters), 4, 4), np.nan)
        for j, theta in enumerate(parameters):
            out[j] = covariance_of_plane(theta, inverse(fisher[j]))
        return out

    def _ceiling(self, floor: Array | None) -> Array:
        return self.tau if floor is None else self.tau + floor

    def _gauss_newton(self, parameters: Array, labels: Labels) -> tuple[Array, Array]:
        sums = np.empty((part_count(self.count), len(parameters), 9))
        over_chunks(
            lambda first, last: kernels.normal_sums(
                parameters, self.a, self.s, labels, first, last, sums
            ),
            len(sums),
            self.threads,
            FEWEST_PARTS,
        )
        matrix, moved = np.empty((len(parameters), 3, 3)), np.empty((len(parameters), 3))
        kernels.gauss_newton(parameters, sums, matrix, moved)
        return matrix, moved
