"""The paper's search: one plane after the other by repeated random sub-sampling."""

from __future__ import annotations

import math
from functools import reduce
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.readings import claim
from planewise.model import Curve, Move, limited_to
from planewise.paper.evaluate import Assignment, Evaluator
from planewise.paper.problem import Problem, Solution
from planewise.runtime.threads import halves
from planewise.wording import counted

Array = NDArray[np.float64]
Places = NDArray[np.int64]

_CHUNK = 16_384  # samples held at a time
_MOST_TRIALS = 1e7  # minutes for a thousand points


def trial_count(
    confidence: float, inlier_ratio: float, dimension: int = 3, name: str = "inlier_ratio"
) -> int:
    """Samples needed to draw one of inliers alone: ln(1 - c) / ln(1 - r^n) (paper, sec. III-C).

    name: of the option that gives r, for the error.

    Raises
    ------
    ValueError
        If r is so small for so many dimensions that it takes minutes a plane.

    Examples
    --------
    >>> trial_count(0.99, 0.1)
    4603
    """
    alone = inlier_ratio**dimension
    trials = math.log1p(-confidence) / math.log1p(-alone) if alone else math.inf
    if trials > _MOST_TRIALS:
        least = (-math.expm1(math.log1p(-confidence) / _MOST_TRIALS)) ** (1 / dimension)
        raise ValueError(
            f"{name} is too small, got {inlier_ratio!r}: a plane in {dimension} dimensions "
            f"would take {trials:.3g} samples, more than {_MOST_TRIALS:.0e}; give at least "
            f"{math.ceil(1000 * least) / 1000:g}, a smaller confidence, or search='joint'"
        )
    return max(1, math.ceil(trials))


def distinct_tuples(rng: np.random.Generator, trials: int, size: int, n: int) -> NDArray[np.int64]:
    """Draw `trials` rows of `n` different indices below `size`."""
    rows = rng.integers(size, size=(trials, n))
    while True:
        equal = (rows[:, i] == rows[:, j] for i, j in combinations(range(n), 2))
        again = reduce(np.logical_or, equal).nonzero()[0]
        if not again.size:
            return rows
        rows[again] = rng.integers(size, size=(again.size, n))


def _best_of_samples(rest: Evaluator, trials: int, rng: np.random.Generator) -> Array:
    """Of `trials` planes through random readings, the one that saves most on all readings."""
    best, lowest = np.full(rest.width, np.nan), np.inf
    for start in range(0, trials, _CHUNK):
        size = min(_CHUNK, trials - start)
        planes = rest.through(distinct_tuples(rng, size, rest.count, rest.dimension))
        pick, score = rest.lowest(planes)
        if score < lowest:
            best, lowest = planes[pick], score
    return best


def _claimed(
    assigned: Assignment, plane: int, free: Places, labels: NDArray[np.uint16], gains: Array
) -> tuple[Places, Places]:
    """Give a plane the readings that it explains, and list those that are left.

    Parameters
    ----------
    assigned : Assignment
        Of the free readings, to that plane alone.
    plane : int
        Its label.
    free : ndarray of int, shape (n,)
        Which readings these are.
    labels, gains : ndarray, shape (k,)
        Of all readings, in which those of the plane are written.

    Returns
    -------
    left : ndarray of int, shape (m,)
        Places of the others among those that were free.
    still : ndarray of int, shape (m,)
        Which readings these are.
    """
    explained, best = assigned.labels, assigned.best
    left, still = np.empty((2, free.size - np.count_nonzero(explained)), np.int64)

    def give(first: int, last: int) -> None:
        at = first - np.count_nonzero(explained[:first])
        claim(explained, best, plane, free, first, last, at, labels, gains, left, still)

    halves(give, free.size)
    return left, still


def sequential_search(
    problem: Problem, *, trials: int, rng: np.random.Generator
) -> tuple[Solution, Curve]:
    """Find planes one at a time; earlier assignments stay (paper, eq. 8 and 10).

    Parameters
    ----------
    problem : Problem
        Readings and objective.
    trials : int
        Random samples per plane.
    rng : numpy.random.Generator
        Source of the samples.

    Returns
    -------
    solution : Solution
        Planes and labels at the minimum of Phi over N.
    curve : Curve
        Phi after 0 ... max_planes planes.
    """
    everything, n = problem.evaluator, problem.evaluator.dimension
    found: list[Array] = []
    labels, gains = np.zeros(everything.count, np.uint16), np.zeros(everything.count)
    phi = [problem.phi(0, 0.0)]
    moves: list[Move] = []
    total, saved = 0.0, [0.0]
    reason = limited_to(problem.max_planes)
    free, rest = np.arange(everything.count), everything
    while len(found) < problem.max_planes:
        if free.size < n:
            reason = f"{counted(free.size, 'reading')} left without a plane, fewer than {n}"
            break
        best = _best_of_samples(rest, trials, rng)
        plane, gain = Problem(evaluator=rest, empty=0.0, structure=np.zeros(2)).refine_one(best)
        if not gain < 0:
            reason = "no candidate plane fits any of the remaining readings"
            break
        found.append(plane)
        total += gain
        assigned = rest.assign(plane[None])
        saved.append(assigned.gain)
        left, free = _claimed(assigned, len(found), free, labels, gains)
        rest = rest.subset(left)
        phi.append(problem.phi(len(found), total))
        moves.append(Move(kind="add", planes=len(found), information=phi[-1]))
    chosen = int(np.argmin(phi))
    if chosen < len(found):
        beyond = labels > chosen
        labels[beyond], gains[beyond] = 0, 0.0
    curve = Curve(information=np.array(phi), chosen=chosen, reason=reason, moves=tuple(moves))
    return Solution(
        np.array(found[:chosen]).reshape(chosen, everything.width),
        Assignment(labels, gains, np.zeros_like(gains), np.cumsum(saved[: chosen + 1])),
        phi[chosen],
    ), curve
