"""The information of a model in nats: the paper's equations, one pure function each.

Symbols: k readings, N planes, R range, eps resolution, n dimension of space, f freedom of a reading
(n for free points, 1 on a known ray), delta residual, sigma standard deviation of a reading.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import plane_rows, unmasked
from planewise.model import Plane
from planewise.observation import Observation, RayObservation, checked_observation

Array = NDArray[np.float64]

_UNIT = 1e-3  # by which the length of a normal may be off, for planes that were rounded


def coordinate_information(range: float, resolution: float) -> float:
    """ln(R / eps): one coordinate that may take any of R / eps values."""
    return math.log(range / resolution)


def outlier_information(freedom: int, range: float, resolution: float) -> float:
    """C_out = f ln(R / eps): a reading that no plane explains (paper, eq. 1 and 10)."""
    return freedom * coordinate_information(range, resolution)


def plane_information(dimension: int, range: float, resolution: float) -> float:
    """n ln(R / eps): the parameters of one hyperplane (paper, below eq. 1)."""
    return dimension * coordinate_information(range, resolution)


def mask_information(readings: int, planes: int) -> float:
    """k ln(N + 1): the assignment of every reading to a plane or to none (paper, eq. 6)."""
    return readings * math.log(planes + 1)


def residual_information(residual: ArrayLike, sigma: ArrayLike, resolution: float) -> Array:
    """delta^2 / (2 sigma^2) + 1/2 ln(2 pi sigma^2 / eps^2): the last term of eq. 4."""
    residual, sigma = np.asarray(residual, float), np.asarray(sigma, float)
    return np.asarray(0.5 * (residual / sigma) ** 2 + exact_fit_information(sigma, resolution))


def exact_fit_information(sigma: ArrayLike, resolution: float) -> Array:
    """1/2 ln(2 pi sigma^2 / eps^2): residual information where the residual is zero."""
    return np.asarray(np.log(np.asarray(sigma, float) * (math.sqrt(2 * math.pi) / resolution)))


def inlier_information(
    residual: ArrayLike, sigma: ArrayLike, freedom: int, range: float, resolution: float
) -> Array:
    """I(x | plane) = (f - 1) ln(R / eps) + residual information (paper, eq. 4)."""
    within = outlier_information(freedom - 1, range, resolution)
    return within + residual_information(residual, sigma, resolution)


def threshold(sigma: ArrayLike, range: float) -> Array:
    """tau = ln(R / (sigma sqrt(2 pi))): what a reading saves on a plane it fits exactly.

    A reading is an inlier where delta^2 / (2 sigma^2) < tau; eps has cancelled.
    """
    return np.asarray(np.log(range / (np.asarray(sigma, float) * math.sqrt(2 * math.pi))))


def gain(residual: ArrayLike, sigma: ArrayLike, range: float) -> Array:
    """g = delta^2 / (2 sigma^2) - tau: inlier minus outlier information, negative when it pays."""
    residual, sigma = np.asarray(residual, float), np.asarray(sigma, float)
    return np.asarray(0.5 * (residual / sigma) ** 2 - threshold(sigma, range))


def outlier_model(readings: int, freedom: int, range: float, resolution: float) -> float:
    """Phi_0 = k f ln(R / eps), model O (paper, eq. 1)."""
    return readings * outlier_information(freedom, range, resolution)


def planes_model(
    inliers: Sequence[tuple[ArrayLike, ArrayLike]],
    outliers: int,
    *,
    dimension: int,
    freedom: int,
    range: float,
    resolution: float,
) -> float:
    """Phi_N, model NP+O (paper, eq. 6).

    Parameters
    ----------
    inliers : sequence of (residual, sigma)
        One pair of arrays of shape (k_i,) per plane, in metres.
    outliers : int
        k_0.
    dimension, freedom : int
        n and f.
    range, resolution : float
        R and eps in metres.

    Examples
    --------
    >>> phi = planes_model([([0.0], [0.01])], 1, dimension=3, freedom=1, range=10, resolution=0.001)
    >>> round(phi, 6)  # 2 ln 2 + (1 + 3) ln 10^4 + 1/2 ln(2 pi 100)
    41.449179
    """
    readings = outliers + sum(np.size(residual) for residual, _ in inliers)
    phi = mask_information(readings, len(inliers))
    phi += outliers * outlier_information(freedom, range, resolution)
    for residual, sigma in inliers:
        phi += plane_information(dimension, range, resolution)
        phi += float(inlier_information(residual, sigma, freedom, range, resolution).sum())
    return phi


def information(
    observation: Observation,
    planes: Sequence[Plane | ArrayLike] | Array,
    labels: ArrayLike,
    *,
    objective: str = "paper",
) -> float:
    """Phi of any planes and any labelling on an observation: the judge of models, edited ones too.

    Under the spatial objective it judges planes that their readings lie near: readings on none are
    one smooth surface in every block of 9 x 9 pixels, so that at the edges of clutter any label,
    be its plane metres away, makes it lower.

    Parameters
    ----------
    observation : Observation
        From `planewise.observe` or `planewise.observe_points`.
    planes : array_like, shape (N, n + 1), or sequence of Plane
        Unit normal and distance of each.
    labels : array_like of int
        Of the shape of the input, or one per reading: 0 for none, as what is masked, j for the
        j-th plane.
    objective : {"paper", "spatial"}
        The paper's (eq. 6, and eq. 10 for readings on rays), or that of the default search, for
        depth images (`planewise.spatial.information`), whichever one the planes were found with.
        Where an observation has fewer than three readings, the latter takes them for outliers.

    Returns
    -------
    float
        Nats.

    Raises
    ------
    ValueError
        If shapes do not agree, a normal has not length one, a label names no plane, or a plane
        passes through the sensor such that its readings say nothing of it.

    Examples
    --------
    >>> import numpy as np, planewise as pw
    >>> wall = np.full((48, 64), 2.0) + np.random.default_rng(0).normal(0, 0.005, (48, 64))
    >>> camera, sensor = pw.PinholeCamera(fx=50, fy=50, cx=32, cy=24), pw.Sensor(noise=0.005)
    >>> model = pw.detect_planes(wall, camera, sensor)
    >>> edited = model.labels.copy()
    >>> edited[:9, :9] = 0
    >>> seen = pw.observe(wall, camera, sensor)
    >>> phi = pw.information(seen, model.planes, edited, objective="spatial")
    >>> bool(phi > model.information)
    True
    """
    if objective not in ("paper", "spatial"):
        raise ValueError(f"objective must be 'paper' or 'spatial', got {objective!r}")
    checked_observation(observation)
    n = observation.dimension
    rows = plane_rows("planes", planes, n + 1)
    lengths = np.linalg.norm(rows[:, :-1], axis=1)
    wrong = ~(np.isfinite(rows).all(axis=1) & (np.abs(lengths - 1) < _UNIT))
    if wrong.any():
        raise ValueError(
            f"planes: expected unit normals and finite distances, got {rows[wrong][0].tolist()}"
        )
    given = marks = unmasked("labels", labels)
    if marks.dtype.kind not in "iu":
        raise ValueError(f"labels must be integers, got dtype {marks.dtype}")
    if marks.shape == observation.shape:
        marks = marks.reshape(-1)[observation.index]
    if marks.shape != (observation.count,):
        shapes = " or ".join(map(str, dict.fromkeys((observation.shape, (observation.count,)))))
        raise ValueError(f"labels: expected shape {shapes}, got {given.shape}")
    if marks.size and not 0 <= marks.min() <= marks.max() <= len(rows):
        raise ValueError(
            f"labels must lie between 0 and {len(rows)}, the number of planes, "
            f"got {marks.min()} to {marks.max()}"
        )
    if objective == "spatial":
        # Its compiled loops are loaded only where they are used.
        from planewise.spatial.information import information_of_rows

        if not isinstance(observation, RayObservation):
            raise ValueError("objective='spatial' needs the observation of a depth image")
        if observation.count < n:  # too few for a search, which says the same of no planes
            limits = observation.range, observation.resolution
            every = outlier_model(observation.count, observation.freedom, *limits)
            return every + len(rows) * plane_information(n, *limits)
        return information_of_rows(observation, rows, marks)
    inliers = []
    for j, row in enumerate(rows, start=1):
        mine = marks == j
        residuals = observation.residuals(row)[mine]
        if np.isnan(residuals).any():
            raise ValueError(
                f"planes: {row.tolist()} passes through the sensor, and rays of its readings lie "
                "in it"
            )
        inliers.append((residuals, observation.sigma[mine]))
    return planes_model(
        inliers,
        int(np.count_nonzero(marks == 0)),
        dimension=n,
        freedom=observation.freedom,
        range=observation.range,
        resolution=observation.resolution,
    )
