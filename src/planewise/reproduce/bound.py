"""The Cramer-Rao bound: how well any unbiased method could know a plane from its readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.paper.evaluate import covariance_of_plane
from planewise.scenes.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Bound:
    """Smallest standard errors of every plane of a scene.

    Attributes
    ----------
    normals : ndarray, shape (N,)
        Root mean square angle between the estimated normal and the true one, degrees.
    distances : ndarray, shape (N,)
        Of the distance, metres.
    """

    normals: Array
    distances: Array


def cramer_rao(scene: Scene, sigma: float) -> Bound:
    """Bound of a scene for one who knows which reading belongs to which plane.

    A reading on the ray r = (u, v, 1) of the plane theta . x = 1 is z = 1 / (theta . r) with
    independent errors of variance sigma^2. Hence dz/dtheta = -z^2 r, and the Fisher information of
    theta is the sum of z^4 r r' / sigma^2 over the readings of the plane.

    Parameters
    ----------
    scene : Scene
        Its true planes, labels and camera.
    sigma : float
        Standard deviation of a reading, rounding included, metres.

    Returns
    -------
    Bound
        From the inverse information, carried over to normal and distance.
    """
    rays = scene.camera.rays((scene.labels.shape[0], scene.labels.shape[1]))
    covariances = []
    for label, plane in enumerate(scene.planes, start=1):
        r = rays[scene.labels == label]
        theta = -plane[:3] / plane[3]
        z = 1 / (r @ theta)
        slope = z[:, None] ** 2 * r
        information = slope.T @ slope / sigma**2
        covariances.append(covariance_of_plane(theta, np.linalg.inv(information)))
    return Bound(
        normals=np.degrees([np.sqrt(np.trace(each[:3, :3])) for each in covariances]),
        distances=np.sqrt([each[3, 3] for each in covariances]),
    )


def with_rounding(sigma: float, step: float) -> float:
    """Standard deviation of a reading of which only its step is known, taken at the middle.

    White noise of some steps makes the place within the step uniform, variance step^2 / 12.
    """
    return float(np.hypot(sigma, step / np.sqrt(12)))
