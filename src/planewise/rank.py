"""From a solution to a ranked model: merge, order by information, describe each plane."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planewise import threads
from planewise.evaluate import FEWEST_PARTS, Assignment, Evaluator, part_count
from planewise.frame import Frame
from planewise.kernels import readings as kernels
from planewise.kernels.cells import UNIT
from planewise.kernels.plane_sums import plane_sums
from planewise.model import Plane
from planewise.observation import Observation, RayObservation
from planewise.problem import Problem, Solution

Array = NDArray[np.float64]


def merge_into_better(problem: Problem, solution: Solution) -> Solution:
    """Give a plane's readings to a better plane wherever that lowers Phi (paper, sec. III-C).

    Readings that the better plane does not explain become outliers.

    Parameters
    ----------
    problem : Problem
        Readings and objective.
    solution : Solution
        Any labelling, optimal for its planes or not.

    Returns
    -------
    Solution
        With Phi no higher; the same object if nothing was merged.
    """
    labels, gains = solution.assignment.labels.copy(), solution.assignment.best.copy()
    planes = solution.parameters
    alive = list(np.argsort(np.bincount(labels, gains, len(planes) + 1)[1:], kind="stable"))
    merged = False
    for worse in alive[:0:-1]:
        mine = np.flatnonzero(labels == worse + 1)
        readings = problem.evaluator.subset(mine)
        better = alive[: alive.index(worse)]
        pick = int(np.argmin(readings.scores(planes[better])))
        offer = readings.assign(planes[better[pick]][None])
        saved = problem.structure[len(alive)] - problem.structure[len(alive) - 1]
        if problem.weight * (offer.gain - gains[mine].sum()) < saved:
            gains[mine] = offer.best
            labels[mine] = np.where(gains[mine] < 0, better[pick] + 1, 0)
            alive.remove(worse)
            merged = True
    if not merged:
        return solution
    keep = np.sort(alive)
    lookup = np.zeros(len(planes) + 1, np.uint16)
    lookup[keep + 1] = np.arange(1, len(keep) + 1)
    assignment = Assignment.of(lookup[labels], gains, len(keep))
    phi = problem.phi(len(keep), assignment.gain)
    return Solution(planes[keep], assignment, phi)


def rank(
    observation: Observation, evaluator: Evaluator, solution: Solution
) -> tuple[tuple[Plane, ...], NDArray[np.uint16]]:
    """Describe the planes and order them by the information they save, best first.

    Parameters
    ----------
    observation : Observation
        Positions, areas and sigmas of the readings.
    evaluator : Evaluator
        The same readings, whitened.
    solution : Solution
        Planes and labels in any order.

    Returns
    -------
    planes : tuple of Plane
        Best first.
    labels : ndarray of uint16, shape (k,)
        0 for none, j for ``planes[j - 1]``.
    """
    labels, gains = solution.assignment.labels, solution.assignment.best
    # g = delta^2 / (2 sigma^2) - tau, solved for delta^2.
    square = gains + evaluator.tau
    square *= 2.0 * observation.sigma**2
    rows = evaluator.coefficients(solution.parameters)
    covariances = evaluator.covariances(solution.parameters, labels)
    planes = describe(observation, rows, covariances, labels, gains, square, evaluator.threads)
    order = np.argsort([plane.information for plane in planes], kind="stable")
    place = np.zeros(len(solution) + 1, np.uint16)
    place[order + 1] = np.arange(1, len(solution) + 1)
    return tuple(planes[j] for j in order), place[labels]


def describe(
    observation: Observation,
    rows: Array,
    covariances: Array,
    labels: NDArray[np.integer],
    gains: Array,
    square: Array,
    workers: int = 1,
    **told: list[float],
) -> list[Plane]:
    """Planes with the statistics of their readings, in the order of their labels.

    Parameters
    ----------
    observation : Observation
        Positions and areas of the readings.
    rows : ndarray, shape (N, n + 1)
        Unit normal and distance.
    covariances : ndarray, shape (N, n + 1, n + 1)
        Of the rows.
    labels : ndarray of int, shape (k,)
        0 for none, j for row j - 1.
    gains, square : ndarray, shape (k,)
        What each reading saves, in nats, and its squared residual, in square metres.
    workers : int
        Threads.
    **told
        What else is known of each plane, by the names of `Plane`.
    """
    parts = part_count(observation.count)
    sums = np.empty((parts, len(rows), 4 + observation.dimension))
    boxes = np.empty((parts, len(rows), 4), np.int64)
    if isinstance(observation, RayObservation):
        direction, depth, solid = observation.rays, observation.depth, observation.solid
        if observation.ranges:
            square = _across(rows, labels, direction, depth)
    else:
        direction = observation.positions().T.copy()
        depth, solid = np.ones(observation.count), np.zeros(observation.count)
    where = observation.index, observation.shape[-1]
    threads.over_chunks(
        lambda first, last: kernels.summarise(
            labels, gains, square, direction, depth, solid, *where, first, last, sums, boxes
        ),
        parts,
        workers,
        FEWEST_PARTS,
    )
    total = sums.sum(axis=0)
    box = np.hstack((boxes[..., :2].min(axis=0), boxes[..., 2:].max(axis=0)))
    image = isinstance(observation, RayObservation)
    if isinstance(observation, RayObservation) and observation.camera.wraps:
        box = _around(box, labels, *where, len(rows))
    return [
        _plane(
            row,
            covariances[j],
            total[j],
            box[j] if image else None,
            {name: told[name][j] for name in told},
        )
        for j, row in enumerate(rows)
    ]


def _across(rows: Array, labels: NDArray[np.integer], direction: Array, ranges: Array) -> Array:
    """Squared distances of readings to their planes, normal . x + distance.

    Many rays of a LiDAR graze the ground: distances along them say little.
    """
    mine = np.vstack((np.zeros((1, 4)), rows))[labels]
    facing = np.einsum("ik,ki->k", direction, mine[:, :3])
    return np.asarray((ranges * facing + mine[:, 3]) ** 2)


def _around(
    box: NDArray[np.int64],
    labels: NDArray[np.integer],
    index: NDArray[np.int64],
    width: int,
    planes: int,
) -> NDArray[np.int64]:
    """Boxes of planes in a panorama: columns between their widest gap, beyond the last if need be.

    The columns of a plane that lies across the end of the image are left ... right - 1, of which
    those from `width` on are the first ones of the image.
    """
    there = np.zeros((planes + 1, width), bool)
    there[labels, index % width] = True
    out = box.copy()
    for j in range(planes):
        columns = np.flatnonzero(there[j + 1])
        gaps = np.diff(columns, append=columns[:1] + width)
        if columns.size and gaps[:-1].max(initial=0) > gaps[-1]:
            widest = int(gaps[:-1].argmax())
            out[j, 1], out[j, 3] = columns[widest + 1], columns[widest] + width + 1
    return out


def describe_labels(
    observation: RayObservation,
    rows: Array,
    covariances: Array,
    labels: NDArray[np.uint16],
    **told: list[float],
) -> list[Plane]:
    """`describe` for a label image of ranges.

    Parameters
    ----------
    observation : RayObservation
        The readings.
    rows : ndarray, shape (N, 4)
        Unit normal and distance.
    covariances : ndarray, shape (N, 4, 4)
        Of the rows.
    labels : ndarray of uint16, shape (H, W)
        0 for none, j for row j - 1.
    **told
        What else is known of each plane, by the names of `Plane`.
    """
    mine = labels.reshape(-1)[observation.index]
    nothing = np.zeros(mine.size)
    return describe(observation, rows, covariances, mine, nothing, nothing, 1, **told)


def describe_image(
    frame: Frame,
    area: Array,
    affine: Array,
    rows: Array,
    covariances: Array,
    labels: NDArray[np.uint16],
    place: NDArray[np.uint16],
    **told: list[float],
) -> tuple[list[Plane], NDArray[np.uint16]]:
    """`describe` for a depth image in inverse depth, without its readings one by one.

    Inverse depth and coordinates are in single precision there: lengths agree to 1e-6 of the depth.

    Parameters
    ----------
    frame : Frame
        The readings.
    area : ndarray, shape (H, W)
        That each pixel covers on the plane z = 1, in square metres.
    affine : ndarray, shape (N, 3)
        (t0, t1, t2) of w = t0 + t1 x + t2 y, the planes that residuals are taken to.
    rows : ndarray, shape (N, 4)
        Unit normal and distance.
    covariances : ndarray, shape (N, 4, 4)
        Of the rows.
    labels : ndarray of uint16, shape (H, W)
        In any order, 0 for none and where there is no reading.
    place : ndarray of uint16
        What becomes of each label: j for row j - 1, 0 for none.
    **told
        What else is known of each plane, by the names of `Plane`.

    Returns
    -------
    planes : list of Plane
        Their information is 0 if it is not told.
    labels : ndarray of uint16, shape (H, W)
        A new image of the labels' places.
    """
    ranked = np.empty_like(labels)
    sums = np.empty((len(rows), 7))
    boxes = np.empty((len(rows), 4), np.int64)
    solid = area[:1, :1] if frame.straight else area  # the same of all pixels
    plane_sums(
        labels, place, frame.w, frame.x, frame.y, frame.straight, affine, solid, ranked, sums, boxes
    )
    sums[:, 4:6] *= UNIT / frame.sectors.focal[0], UNIT / frame.sectors.focal[1]
    planes = [
        _plane(row, covariances[j], sums[j], boxes[j], {name: told[name][j] for name in told})
        for j, row in enumerate(rows)
    ]
    return planes, ranked


def _plane(
    row: Array,
    covariance: Array,
    sums: Array,
    box: NDArray[np.int64] | None,
    told: Mapping[str, float] | None = None,
) -> Plane:
    readings, gain, square, area, *position = sums.tolist()
    count = max(readings, 1.0)
    return Plane(
        **{"information": gain} | dict(told or {}),
        normal=row[:-1],
        distance=float(row[-1]),
        count=int(readings),
        rms=math.sqrt(max(square, 0.0) / count),
        centroid=np.array(position) / count,
        covariance=covariance,
        # |dx/du x dx/dv| = z^3 / d for the point z r of a plane at distance d.
        area=float("nan") if box is None else area / float(row[-1]),
        bounding_box=() if box is None else tuple(box.tolist()),
    )
