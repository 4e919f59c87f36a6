"""Reassignment by surface normals: the paper's optional step after its search.

Readings near the line in which two planes meet fit both, and the one that saves more nats may be
the wrong one. Each reading is compared by angle and by distance with all planes, and goes to the
most similar of those that it still saves nats on (paper, sec. IV-C).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import is_finite, is_whole, make_plain
from planewise.observation import RayObservation
from planewise.paper.evaluate import Assignment
from planewise.paper.problem import Problem, Solution
from planewise.ranks import ranks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NORMALS = "normals"
_REACH = 3.0  # of the Gaussian, in standard deviations


@dataclass(frozen=True, kw_only=True)
class NormalReassignment:
    """How surface normals are made. Larger filters bear more noise and blur what is small.

    Parameters
    ----------
    gradient : int
        Pixels of the kernel along x and along y that the tangents are taken over; odd, at least 3.
    smoothing : float
        Standard deviation of the Gaussian over the normals, in pixels; 0 for none.
    """

    gradient: int = 7
    smoothing: float = 3.0

    def __post_init__(self) -> None:
        if not is_whole(self.gradient):
            raise ValueError(f"gradient must be a whole number of pixels, got {self.gradient!r}")
        if self.gradient < 3 or self.gradient % 2 == 0:
            raise ValueError(
                f"gradient must be an odd number of pixels, at least 3, got {self.gradient}"
            )
        if not (is_finite(self.smoothing) and self.smoothing >= 0):
            raise ValueError(
                f"smoothing must be a number of pixels, not negative, got {self.smoothing!r}"
            )
        make_plain(self, int, "gradient")
        make_plain(self, float, "smoothing")

    @property
    def gaussian(self) -> Array:
        """Weights of the Gaussian along one axis; they sum to one."""
        if not self.smoothing:
            return np.ones(1)
        reach = math.ceil(_REACH * self.smoothing)
        weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / self.smoothing) ** 2)
        return np.asarray(weights / weights.sum())

    @property
    def slope_noise(self) -> float:
        """Standard deviation of a smoothed slope per pixel, for readings of standard deviation 1.

        That of the readings' weights: derivative and Gaussian along one axis, Gaussian along the
        other.
        """
        offset = np.arange(self.gradient) - self.gradient // 2
        along = np.convolve(offset / (offset**2).sum(), self.gaussian)
        return float(np.linalg.norm(along) * np.linalg.norm(self.gaussian))


def as_reassignment(reassign: NormalReassignment | str | None) -> NormalReassignment | None:
    """The reassignment of that name, or the one given.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if reassign is None or isinstance(reassign, NormalReassignment):
        return reassign
    if reassign != NORMALS:
        raise ValueError(
            f"reassign must be {NORMALS!r}, a NormalReassignment or None, got {reassign!r}"
        )
    return NormalReassignment()


def surface_normals(points: Array, seen: Mask, how: NormalReassignment) -> Array:
    """Unit normal of the surface at every pixel, smoothed.

    Parameters
    ----------
    points : ndarray, shape (H, W, 3)
        Positions in the camera frame, metres.
    seen : ndarray of bool, shape (H, W)
        Where there is a reading; no other point counts.
    how : NormalReassignment
        Kernels.

    Returns
    -------
    ndarray, shape (H, W, 3)
        Facing the sensor; NaN where there is no reading, or too few around it.
    """
    points = np.where(seen[..., None], points, 0.0)
    tangents = [_tangent(points, seen, how.gradient, axis) for axis in (0, 1)]
    # y before x: the cross product then faces the sensor.
    normals = np.nan_to_num(_unit(_cross(*tangents)))
    away = np.einsum("...c,...c->...", normals, points) > 0
    normals[away] *= -1.0
    normals[~seen] = 0.0
    # What is not seen has weight 0; the sum of the weights is lost in the length.
    for axis in (0, 1):
        normals = _convolve(normals, how.gaussian, axis)
    return np.where(seen[..., None], _unit(normals), np.nan)


def reassign_by_normals(
    observation: RayObservation, problem: Problem, solution: Solution, how: NormalReassignment
) -> Solution:
    """Give every reading to the most similar plane that it saves nats on; planes stay as they are.

    The dissimilarity of a reading and a plane is delta^2 / (2 sigma^2) + alpha^2 / (2 sigma_n^2),
    alpha the angle between their normals and sigma_n what noise makes of a smoothed normal on a
    surface that is seen face on.

    Parameters
    ----------
    observation : RayObservation
        A depth image.
    problem : Problem
        The same readings, and the objective.
    solution : Solution
        Planes and labels.
    how : NormalReassignment
        Kernels.

    Returns
    -------
    Solution
        Its Phi may be higher. Planes that keep no reading are dropped; readings without a normal
        keep their label.
    """
    rows = problem.evaluator.coefficients(solution.parameters)
    normals = _normals_of(observation, how)
    blind = np.isnan(normals[:, 0])
    labels = np.where(blind, solution.assignment.labels, 0).astype(np.uint16)
    gains = np.where(blind, solution.assignment.best, 0.0)
    # A slope of one metre per metre is fx or fy pixels long: sigma_n, squared.
    angular = (how.slope_noise * observation.sigma / observation.depth) ** 2 / observation.solid
    lowest = np.full(observation.count, np.inf)
    for j, row in enumerate(rows, start=1):
        error = 0.5 * (observation.residuals(row) / observation.sigma) ** 2
        angle = np.arccos(np.clip(normals @ row[:3], -1.0, 1.0))
        unlike = error + 0.5 * angle**2 / angular
        closer = (error < problem.evaluator.tau) & (unlike < lowest)  # never where it is NaN
        labels[closer], lowest[closer] = j, unlike[closer]
        gains[closer] = (error - problem.evaluator.tau)[closer]
    kept = np.flatnonzero(np.bincount(labels, minlength=len(rows) + 1)[1:])
    place = ranks(kept, len(rows))
    assignment = Assignment.of(place[labels], gains, kept.size)
    return Solution(solution.parameters[kept], assignment, problem.phi(kept.size, assignment.gain))


def _normals_of(observation: RayObservation, how: NormalReassignment) -> Array:
    """Surface normal of every reading, shape (k, 3)."""
    points, seen = np.zeros((*observation.shape, 3)), np.zeros(observation.shape, bool)
    points.reshape(-1, 3)[observation.index] = observation.positions()
    seen.reshape(-1)[observation.index] = True
    return surface_normals(points, seen, how).reshape(-1, 3)[observation.index]


def _tangent(points: Array, seen: Mask, size: int, axis: int) -> Array:
    """Along the slope of the points on an axis: least squares over those seen in the kernel.

    Its weights sum to zero whatever is missing, so on a plane it lies in the plane. How long it is
    says nothing; zero where fewer than two are seen.
    """
    there = seen[..., None].astype(np.float64)
    step = np.arange(size, dtype=np.float64) - size // 2
    (count, total), (first, moment) = (
        [_convolve(image, weights, axis) for image in (there, points)]
        for weights in (np.ones(size), step)
    )
    return np.asarray(count * moment - first * total)


def _convolve(image: Array, weights: Array, axis: int) -> Array:
    """Sum of weights[i] * (pixel i - len // 2 further along an axis); nothing beyond the image."""
    out = np.zeros_like(image)
    size = image.shape[axis]
    source, target = np.moveaxis(image, axis, 0), np.moveaxis(out, axis, 0)
    for i, weight in enumerate(weights):
        shift = i - len(weights) // 2
        low, high = max(0, -shift), min(size, size - shift)
        if low < high:
            target[low:high] += weight * source[low + shift : high + shift]
    return out


def _cross(a: Array, b: Array) -> Array:
    return np.stack(
        [a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1))], -1
    )


def _unit(vectors: Array) -> Array:
    """Vectors of length 1; NaN where they have no direction."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
