"""The searches under a separable objective, region by region (paper, sec. III-C and IV-B).

The sequential search goes through the regions alone, and then its planes are ranked, merged and
dropped for the frame as a whole. The joint search has found its planes already: it goes on from
these or those, whichever have the lower Phi, with all planes of the regions as candidates.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planewise.model import MAX_PLANES, Curve, Move, limited_to
from planewise.paper.evaluate import Assignment
from planewise.paper.joint import descend
from planewise.paper.problem import Problem, Solution
from planewise.paper.rank import merge_into_better
from planewise.paper.sequential import sequential_search, trial_count
from planewise.partition.options import PartitionOptions
from planewise.ranks import ranks

Array = NDArray[np.float64]
Structure = Callable[[int, int], Array]
"""Nats of the mask and parameters of 0 ... most planes, from (readings, most)."""


def search_regions(
    problem: Problem,
    regions: NDArray[np.integer],
    options: PartitionOptions,
    structure: Structure,
    *,
    rng: np.random.Generator,
) -> Solution:
    """Search every region by itself, and the remainder.

    Parameters
    ----------
    problem : Problem
        All readings.
    regions : ndarray of int, shape (k,)
        Region of every reading, 0 for the remainder, to which regions with too few readings for a
        plane are added.
    options : PartitionOptions
        N, c and r of a region and of the remainder.
    structure : callable
        What planes cost among so many readings.
    rng : numpy.random.Generator
        Source of the samples.

    Returns
    -------
    Solution
        Planes of all regions, labels of all readings, and their Phi in `problem`, whose structure
        is `structure` of all readings and at least as many planes.
    """
    everything, dimension = problem.evaluator, problem.evaluator.dimension
    inside = np.where(np.bincount(regions)[regions] < dimension, 0, regions)
    order = np.argsort(inside, kind="stable")
    numbers, first = np.unique(inside[order], return_index=True)
    planes: list[Array] = [np.empty((0, everything.width))]
    labels, gains = np.zeros(everything.count, np.int64), np.zeros(everything.count)
    found = 0
    for number, mine in zip(numbers, np.split(order, first[1:]), strict=True):
        most, ratio = options.region_planes, options.region_inlier_ratio
        if number == 0:
            most, ratio = options.remainder_planes, options.remainder_inlier_ratio
        local = Problem(
            evaluator=everything.subset(mine), empty=0.0, structure=structure(mine.size, most)
        )
        trials = trial_count(options.confidence, ratio, dimension)
        solution, _ = sequential_search(local, trials=trials, rng=rng)
        given = solution.assignment.labels
        labels[mine] = np.where(given > 0, given + np.int64(found), 0)
        gains[mine] = solution.assignment.best
        planes.append(solution.parameters)
        found += len(solution)
    return _best(problem, np.vstack(planes), labels, gains, MAX_PLANES, structure)


def sequential_in_regions(
    problem: Problem,
    regions: NDArray[np.integer],
    options: PartitionOptions,
    structure: Structure,
    *,
    max_planes: int,
    rng: np.random.Generator,
) -> tuple[Solution, Curve]:
    """Search every region by itself; rank, merge and drop planes for the whole frame.

    Parameters
    ----------
    problem, regions, options, structure, rng
        As of `search_regions`; of the structure of `problem` only that of no plane is used.
    max_planes : int
        The best are kept.

    Returns
    -------
    solution : Solution
        The best planes first. No plane merges into a better one or can be left out, with labels as
        they are, such that Phi falls.
    curve : Curve
        Phi of the best 0 ... N planes.
    """
    found = search_regions(problem, regions, options, structure, rng=rng)
    return _for_the_frame(problem, found, structure, max_planes)


def _for_the_frame(
    problem: Problem, solution: Solution, structure: Structure, max_planes: int
) -> tuple[Solution, Curve]:
    """Merge and drop planes of regions as long as Phi of the frame falls."""
    moves = [Move(kind="regions", planes=len(solution), information=solution.phi)]
    while True:
        costs = structure(problem.evaluator.count, len(solution))
        problem = Problem(evaluator=problem.evaluator, empty=problem.empty, structure=costs)
        merged = merge_into_better(problem, solution)
        if merged is not solution:
            moves.append(Move(kind="merge", planes=len(merged), information=merged.phi))
        given = merged.assignment
        kept = _best(
            problem, merged.parameters, given.labels, given.best, max_planes, structure, cut=True
        )
        if len(kept) < len(merged):
            moves.append(Move(kind="cut", planes=len(kept), information=kept.phi))
        if len(kept) == len(solution):
            break
        solution = kept
    if not len(kept):
        reason = "no plane of any region saves more than it costs"
    elif len(kept) == max_planes:
        reason = limited_to(max_planes)
    else:
        reason = "no plane merges into a better one or can be left out such that Phi falls"
    phi = problem.phis(kept.assignment)
    return kept, Curve(information=phi, chosen=len(kept), reason=reason, moves=tuple(moves))


def _best(
    problem: Problem,
    planes: Array,
    labels: NDArray[np.integer],
    gains: Array,
    most: int,
    structure: Structure,
    *,
    cut: bool = False,
) -> Solution:
    """The best planes first, `most` of them; with `cut` no more than make Phi lowest."""
    worth = np.bincount(labels, gains, len(planes) + 1)[1:]
    order = np.argsort(worth, kind="stable")[:most]
    costs = structure(problem.evaluator.count, len(order))
    if cut:
        phi = costs + np.concatenate(([0.0], np.cumsum(worth[order])))
        order = order[: int(np.argmin(phi))]
    place = ranks(order, len(planes))
    kept = place[labels]
    assignment = Assignment.of(kept, np.where(kept > 0, gains, 0.0), len(order))
    phi_of_all = problem.empty + float(costs[len(order)]) + assignment.gain
    return Solution(planes[order], assignment, phi_of_all)


def joint_with_regions(
    problem: Problem,
    solution: Solution,
    curve: Curve,
    regions: NDArray[np.integer],
    options: PartitionOptions,
    structure: Structure,
    *,
    rng: np.random.Generator,
) -> tuple[Solution, Curve]:
    """Go on from what the joint search or the regions found, with the regions' planes to add.

    Parameters
    ----------
    problem, regions, options, structure, rng
        As of `search_regions`.
    solution, curve
        From `joint_search`.

    Returns
    -------
    solution : Solution
        With Phi no higher than that of `solution` or of `sequential_in_regions`; the same object
        if nothing lowers it.
    curve : Curve
        The same, with what was done.
    """
    found = search_regions(problem, regions, options, structure, rng=rng)
    alone, _ = _for_the_frame(problem, found, structure, problem.max_planes)
    # Each reading may take the best of them all now, not of its region alone.
    alone = problem.solve(alone.parameters)
    return descend(problem, solution, curve, alone, found.parameters, rng=rng)
