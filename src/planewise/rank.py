"""From a solution to a ranked model: merge, order by information, describe each plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise import kernels
from planewise.evaluate import Assignment, Evaluator
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
    alone = [problem.evaluator.assign(plane[None]).best for plane in solution.parameters]
    alive = list(np.argsort(np.bincount(labels, gains, len(alone) + 1)[1:], kind="stable"))
    merged = False
    for worse in alive[::-1]:
        mine = labels == worse + 1
        better = alive[: alive.index(worse)]
        if not better:
            break
        offers = [float(alone[i][mine].sum()) for i in better]
        pick = int(np.argmin(offers))
        saved = problem.structure[len(alive)] - problem.structure[len(alive) - 1]
        if problem.weight * (offers[pick] - gains[mine].sum()) < saved:
            gains[mine] = alone[better[pick]][mine]
            labels[mine] = np.where(gains[mine] < 0, better[pick] + 1, 0)
            alive.remove(worse)
            merged = True
    if not merged:
        return solution
    keep = np.sort(alive)
    lookup = np.zeros(len(alone) + 1, np.uint16)
    lookup[keep + 1] = np.arange(1, len(keep) + 1)
    assignment = Assignment.of(lookup[labels], gains, len(keep))
    phi = problem.phi(len(keep), assignment.gain)
    return Solution(solution.parameters[keep], assignment, phi)


def ranked(solution: Solution) -> Solution:
    """Order the planes by the information they save, best first."""
    chosen = solution.assignment
    worth = np.bincount(chosen.labels, chosen.best, len(solution) + 1)[1:]
    order = np.argsort(worth, kind="stable")
    lookup = np.zeros(len(solution) + 1, np.uint16)
    lookup[order + 1] = np.arange(1, len(solution) + 1)
    assignment = Assignment.of(lookup[chosen.labels], chosen.best, len(solution))
    return Solution(solution.parameters[order], assignment, solution.phi)


def describe(
    observation: Observation, evaluator: Evaluator, solution: Solution
) -> tuple[Plane, ...]:
    """Planes of a ranked solution with their statistics.

    Parameters
    ----------
    observation : Observation
        Positions, areas and sigmas of the readings.
    evaluator : Evaluator
        The same readings, whitened.
    solution : Solution
        Ranked.

    Returns
    -------
    tuple of Plane
        In the order of the solution.
    """
    count, n = len(solution), observation.dimension
    chosen = solution.assignment
    # g = delta^2 / (2 sigma^2) - tau, solved for delta^2.
    square = 2.0 * (chosen.best + evaluator.tau) * observation.sigma**2
    rows = evaluator.coefficients(solution.parameters)
    image = isinstance(observation, RayObservation) and len(observation.shape) == 2
    if isinstance(observation, RayObservation):
        position = observation.rays * observation.depth
        # |dx/du x dx/dv| = z^3 / d for the point z r of a plane at distance d.
        area = observation.depth**3 * observation.solid
    else:
        position, area = observation.positions().T, np.zeros(observation.count)
    sums = np.empty((count, 4 + n))
    box = np.empty((count, 4), np.int64)
    width = observation.shape[-1] if image else max(1, observation.count)
    kernels.summarise(
        chosen.labels, chosen.best, square, position, area, observation.index, width, sums, box
    )
    covariances = evaluator.covariances(solution.parameters, chosen.labels)
    planes = []
    for j in range(count):
        k = max(sums[j, 0], 1.0)
        planes.append(
            Plane(
                normal=rows[j, :-1],
                distance=float(rows[j, -1]),
                information=float(sums[j, 1]),
                count=int(sums[j, 0]),
                rms=float(np.sqrt(max(sums[j, 2], 0.0) / k)),
                centroid=sums[j, 4:] / k,
                covariance=covariances[j],
                area=float(sums[j, 3] / rows[j, -1]) if image else float("nan"),
                bounding_box=tuple(int(b) for b in box[j]) if image else (),
            )
        )
    return tuple(planes)
