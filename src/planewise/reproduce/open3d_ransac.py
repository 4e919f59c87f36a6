"""Open3D's RANSAC for one plane, called again and again on what the planes before it left."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Fit = Callable[[Array], tuple[Array, NDArray[np.intp]]]
"""From points, shape (k, 3), to a plane (a, b, c, d) and the indices of its inliers."""


def why_missing(module: str = "open3d") -> str:
    """Why a module cannot be imported here; empty where it can."""
    try:
        import_module(module)
    except Exception as reason:  # a broken installation may raise anything
        return f"{type(reason).__name__}: {reason}".splitlines()[0]
    return ""


def segment_plane(
    threshold: float, trials: int, probability: float | None = None, *, seed: int = 0
) -> Fit:
    """Open3D's `segment_plane` with its settings.

    Parameters
    ----------
    threshold : float
        Largest distance of an inlier from the plane, metres.
    trials : int
        Samples at most.
    probability : float, optional
        That one of the samples was pure: with the inliers of the best one so far it may end the
        search early. ``None`` means Open3D's own.
    seed : int
        Of Open3D's samples, from now on. On more than one thread its results still vary a little.
    """
    o3d = import_module("open3d")
    o3d.utility.random.seed(seed)
    more = () if probability is None else (probability,)

    def fit(points: Array) -> tuple[Array, NDArray[np.intp]]:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        plane, inliers = cloud.segment_plane(threshold, 3, trials, *more)
        return np.asarray(plane, np.float64), np.asarray(inliers, np.intp)

    return fit


def one_after_the_other(
    fit: Fit, points: Array, most: int, smallest: float = 0.0
) -> tuple[NDArray[np.int64], Array]:
    """Take the largest plane out of the points again and again.

    Parameters
    ----------
    fit : callable
        Finds one plane.
    points : ndarray, shape (k, 3)
        Metres.
    most : int
        Planes at most.
    smallest : float
        Share of the points below which a plane is none, and the search ends.

    Returns
    -------
    labels : ndarray of int64, shape (k,)
        0 for no plane, j for the j-th.
    planes : ndarray, shape (N, 4)
        Their equations, as `fit` gave them.
    """
    labels, rest = np.zeros(len(points), np.int64), np.arange(len(points))
    planes: list[Array] = []
    while len(planes) < most and len(rest) >= 3:
        plane, inliers = fit(points[rest])
        if len(inliers) < max(3.0, smallest * len(points)):
            break
        planes.append(plane)
        labels[rest[inliers]] = len(planes)
        rest = np.delete(rest, inliers)
    return labels, np.array(planes).reshape(-1, 4)
