"""From a solution to a ranked model: merge, and order by information."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planewise.model import Curve, Plane
from planewise.observation import Observation
from planewise.paper.describe import describe
from planewise.paper.evaluate import Assignment, Evaluator
from planewise.paper.problem import Problem, Solution
from planewise.ranks import ranks
from planewise.runtime.threads import halves


def merge_into_better(problem: Problem, solution: Solution, *, in_turn: bool = False) -> Solution:
    """Give a plane's readings to a better plane wherever that lowers Phi (paper, sec. III-C).

    Readings that the better plane does not explain become outliers.

    Parameters
    ----------
    problem : Problem
        Readings and objective.
    solution : Solution
        Any labelling, optimal for its planes or not.
    in_turn : bool
        Whether the planes took readings one after the other, each all that it explains: then an
        earlier plane explains none of a later one's, and is not asked.

    Returns
    -------
    Solution
        With Phi no higher; the same object if nothing was merged.
    """
    labels, gains = solution.assignment.labels, solution.assignment.best
    planes = solution.parameters
    # Planes before `since` explain none of a plane's readings.
    if in_turn:
        since, worth = np.arange(len(planes)), np.diff(solution.assignment.cumulative)
    else:
        since = np.zeros(len(planes), np.intp)
        worth = np.asarray(np.bincount(labels, gains, len(planes) + 1)[1:], np.float64)
    alive = list(np.argsort(worth, kind="stable"))
    merged = False
    for worse in alive[:0:-1]:
        saved = problem.structure[len(alive)] - problem.structure[len(alive) - 1]
        better = [j for j in alive[: alive.index(worse)] if j >= since[worse]]
        if not better and problem.weight * -worth[worse] >= saved:
            continue
        mine = np.flatnonzero(labels == worse + 1)
        on_better, gain, heir = np.zeros(mine.size), 0.0, worse
        if better:
            readings = problem.evaluator.subset(mine)
            heir = better[int(np.argmin(readings.scores(planes[better])))]
            offer = readings.assign(planes[heir][None])
            on_better, gain = offer.best, offer.gain
        if problem.weight * (gain - worth[worse]) < saved:
            if not merged:
                labels, gains = labels.copy(), gains.copy()
            gains[mine] = on_better
            labels[mine] = np.where(on_better < 0, heir + 1, 0)
            worth[heir] += gain
            since[heir] = min(since[heir], since[worse])
            alive.remove(worse)
            merged = True
    if not merged:
        return solution
    keep = np.sort(alive)
    lookup = ranks(keep, len(planes))
    assignment = Assignment.of(lookup[labels], gains, len(keep))
    phi = problem.phi(len(keep), assignment.gain)
    return Solution(planes[keep], assignment, phi)


def merge_found(
    problem: Problem, solution: Solution, curve: Curve, *, in_turn: bool = False
) -> tuple[Solution, Curve]:
    """Merge planes found one after the other, and leave out the last ones that do not pay then.

    Parameters
    ----------
    problem : Problem
        Readings and objective.
    solution, curve
        From `sequential_search`.
    in_turn : bool
        As of `merge_into_better`.

    Returns
    -------
    solution : Solution
        With Phi no higher; the same object if nothing was merged.
    curve : Curve
        The same if nothing was merged; else that of the planes that were left, and what was done.
    """
    merged = merge_into_better(problem, solution, in_turn=in_turn)
    if merged is solution:
        return solution, curve
    curve = curve.then("merge", len(merged), merged.phi)
    phi = problem.phis(merged.assignment)
    chosen = int(np.argmin(phi))
    if chosen < len(merged):
        labels, gains = merged.assignment.labels, merged.assignment.best
        beyond = labels > chosen
        labels[beyond], gains[beyond] = 0, 0.0
        assignment = Assignment.of(labels, gains, chosen)
        merged = Solution(merged.parameters[:chosen], assignment, float(phi[chosen]))
        curve = curve.then("cut", chosen, merged.phi)
    return merged, replace(curve, information=phi, chosen=chosen)


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
    square, tau, sigma = np.empty(gains.size), evaluator.tau, observation.sigma

    def solve(first: int, last: int) -> None:
        """Take delta^2 from g = delta^2 / (2 sigma^2) - tau."""
        part = square[first:last]
        np.add(gains[first:last], tau[first:last], out=part)
        part *= 2.0 * sigma[first:last] ** 2

    halves(solve, gains.size)
    rows = evaluator.coefficients(solution.parameters)
    covariances = evaluator.covariances(solution.parameters, labels)
    planes = describe(observation, rows, covariances, labels, gains, square, evaluator.threads)
    order = np.argsort([plane.information for plane in planes], kind="stable")
    place = ranks(order, len(solution))
    return tuple(planes[j] for j in order), place.take(labels)
