"""The joint search: all planes together, every reading with its best plane, moves by exact Phi.

Choosing planes so that sum_i min_j gain_ij plus what N planes cost is lowest is facility location.
A lazy greedy choice among candidates on a sample of the readings gives a first model; then planes
are refitted, dropped, merged, added and exchanged as long as Phi falls. Moves are found on the
sample and taken by exact Phi of all readings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planewise.model import NOTHING_PAYS, Curve, Move, limited_to
from planewise.paper.evaluate import Evaluator
from planewise.paper.problem import Problem, Solution
from planewise.paper.sequential import distinct_tuples

Array = NDArray[np.float64]

_SAMPLE = 10_240  # readings on which candidates are judged
_PATIENCE = 17  # planes since Phi was lowest, until hope is bounded by what outliers can save
_BATCH = 32  # candidates looked at together by the lazy greedy choice
_EXTRA = 2  # planes beyond the best number that the curve shows
_ROUGH = 1e-5  # of Phi: progress that counts on the sample, whose own error is larger
_ROUNDS = 30  # moves on the sample at most
_DRAWS = 256  # planes drawn among the outliers before every move
_POOL = 256  # candidates that compete to be added or exchanged
_SKETCH = 3  # refits of a plane when the greedy choice takes it
_TRIAL = 2  # refits before a move is judged
_SETTLE = 8  # refits after it was taken
_FINAL = 8  # planes refitted on all readings, all steps together ...
_FEWEST = 2  # ... but no fewer steps
_DROPPABLE = 1.2  # a plane that saves less than this much of its cost may be dropped
_EXCHANGED = 2  # planes that save least are tried against others
_SHARED = 0.7  # of a plane's gain that another must offer for the pair to be worth a merge


def joint_search(
    problem: Problem, candidates: Array, *, rng: np.random.Generator
) -> tuple[Solution, Curve]:
    """Find all planes together.

    Parameters
    ----------
    problem : Problem
        Readings and objective.
    candidates : ndarray, shape (T, p)
        Planes to choose from.
    rng : numpy.random.Generator
        Draws the sample.

    Returns
    -------
    solution : Solution
        Planes and labels at a local minimum of Phi over all moves.
    curve : Curve
        Phi with the first 0 ... N planes in order of what they save, and with a few more.
    """
    moves: list[Move] = []

    def record(kind: str, solution: Solution) -> Solution:
        moves.append(Move(kind=kind, planes=len(solution), information=solution.phi))
        return solution

    sample = _sample(problem, rng)
    start, spare, pool = _greedy(sample, candidates)
    draft = sample.refine(sample.solve(start))
    exact = record("greedy", problem.solve(draft.parameters))
    for kind, better in _descend(sample, draft, pool, rng):
        # A move is found on the sample, and taken if it lowers Phi of all readings.
        trial = problem.solve(better.parameters)
        if not trial.phi < exact.phi:
            break
        exact = record(kind, trial)
    # Largest loss first: the running sums of the labelling are then the curve.
    order = np.argsort(-_losses(problem, exact), kind="stable")
    solution = record("refit", _finish(problem, problem.solve(exact.parameters[order])))
    for shorter in _cut(problem, solution):
        solution = record("cut", shorter)
    while (longer := _extended(problem, solution, spare)) is not None:
        spare = spare[len(longer) - len(solution) :]
        solution = record("add", longer)
        for shorter in _cut(problem, solution):
            solution = record("cut", shorter)
    return solution, _curve(problem, solution, spare, moves)


def descend(
    problem: Problem,
    solution: Solution,
    curve: Curve,
    of_regions: Solution,
    candidates: Array,
    *,
    rng: np.random.Generator,
) -> tuple[Solution, Curve]:
    """Go on from the better of two solutions, every move by exact Phi of all readings.

    Parameters
    ----------
    problem : Problem
        Readings and objective.
    solution, curve
        From `joint_search`.
    of_regions : Solution
        Of the planes of regions, at most as many as the problem allows.
    candidates : ndarray, shape (T, p)
        Planes to add or exchange.
    rng : numpy.random.Generator
        Draws planes among the outliers.

    Returns
    -------
    solution : Solution
        With Phi no higher than that of either; the same object as `solution` if nothing lowers it.
    curve : Curve
        The same if there was no move.
    """
    moves, start = list(curve.moves), solution
    if of_regions.phi < solution.phi:
        start = of_regions
        moves.append(Move(kind="regions", planes=len(start), information=start.phi))
    now = start
    for kind, now in _descend(problem, start, candidates, rng):
        moves.append(Move(kind=kind, planes=len(now), information=now.phi))
    order = np.argsort(-_losses(problem, now), kind="stable")
    now = problem.solve(now.parameters[order])
    for shorter in _cut(problem, now):
        now = shorter
        moves.append(Move(kind="cut", planes=len(now), information=now.phi))
    if not now.phi < solution.phi:
        return solution, curve
    return now, _curve(problem, now, candidates[:0], moves)


def _cut(problem: Problem, solution: Solution) -> Iterator[Solution]:
    """Yield what is left as long as the first planes alone are better than all of them."""
    while (best := int(np.argmin(problem.phis(solution.assignment)))) < len(solution):
        cut = problem.solve(solution.parameters[:best])
        solution = problem.refine(cut, _TRIAL, stretch=2.0)
        yield solution


def _finish(problem: Problem, solution: Solution) -> Solution:
    """Refit planes on all readings, with more steps where a step is cheap."""
    steps = max(_FEWEST, _FINAL // max(1, len(solution)))
    return problem.refine(solution, steps, stretch=2.0)


def _sample(problem: Problem, rng: np.random.Generator) -> Problem:
    """Readings drawn one from each of equal runs in raster order, each standing for its run."""
    count = problem.evaluator.count
    rough = replace(problem, tolerance=_ROUGH * problem.empty)
    if count <= _SAMPLE:
        return rough
    chosen = ((np.arange(_SAMPLE) + rng.random(_SAMPLE)) * (count / _SAMPLE)).astype(np.int64)
    return replace(rough, evaluator=problem.evaluator.subset(chosen), weight=count / _SAMPLE)


def _greedy(problem: Problem, candidates: Array) -> tuple[Array, Array, Array]:
    """Add the plane that saves most, up to where none pays for its parameters; cut at the best N.

    Returns the planes up to the lowest Phi, the next few for the curve, and the candidates that
    promise most beside them.
    """
    bounds = problem.evaluator.scores(candidates)
    promise = bounds.copy()
    floor, worth = np.zeros(problem.evaluator.count), np.maximum(problem.evaluator.tau, 0.0)
    chosen: list[Array] = []
    phi = [problem.phi(0, 0.0)]
    while len(chosen) < problem.max_planes and len(candidates):
        pick = _lazy_best(problem.evaluator, candidates, bounds, floor)
        plane, saved = problem.refine_one(candidates[pick], floor, _SKETCH)
        beyond = len(phi) - int(np.argmin(phi))  # planes since Phi was lowest, this one too
        if beyond <= _PATIENCE:
            promise = bounds.copy()
        # No later plane saves more than this one: can any number of them still pay? On a grid of
        # equal squares none does, nor do half of them.
        more = np.arange(1, problem.max_planes - len(chosen) + 1)
        savings = saved * more
        if beyond >= _PATIENCE:
            # Nor do all of them save more than if every reading came to fit exactly.
            savings = np.maximum(savings, -float((floor + worth).sum()))
        hope = phi[-1] + problem.weight * savings
        hope += problem.structure[len(chosen) + more] - problem.structure[len(chosen)]
        if not hope.min() < min(phi):
            break
        chosen.append(plane)
        floor = np.minimum(floor, problem.evaluator.assign(plane[None]).best)
        phi.append(problem.phi(len(chosen), float(floor.sum())))
    best = int(np.argmin(phi))
    planes = np.array(chosen).reshape(len(chosen), candidates.shape[1])
    pool = candidates[np.argsort(promise, kind="stable")[:_POOL]]
    return planes[:best], planes[best : best + _EXTRA], pool


def _lazy_best(evaluator: Evaluator, candidates: Array, bounds: Array, floor: Array) -> int:
    """Candidate that saves most above `floor`; `bounds` hold what each saved above a lower floor.

    Savings only shrink as the floor falls (submodularity), so candidates whose old bound is no
    better than a fresh one need no second look.
    """
    fresh = np.zeros(len(candidates), bool)
    while True:
        order = np.argpartition(bounds, min(_BATCH, len(bounds) - 1))[:_BATCH]
        stale = order[~fresh[order]]
        best = int(order[np.argmin(bounds[order])])
        if fresh[best] or not stale.size:
            return best
        bounds[stale] = evaluator.scores(candidates[stale], floor)
        fresh[stale] = True


def _descend(
    problem: Problem, solution: Solution, candidates: Array, rng: np.random.Generator
) -> Iterator[tuple[str, Solution]]:
    """Yield better and better solutions until no move lowers Phi."""
    for _ in range(_ROUNDS):
        fresh = _among_outliers(problem, solution, rng)
        for kind, trial in _moves(problem, solution, np.vstack((candidates, fresh))):
            if trial.phi < solution.phi - problem.tolerance:
                solution = problem.refine(trial, _SETTLE)
                yield kind, solution
                break
        else:
            return


def _moves(
    problem: Problem, solution: Solution, candidates: Array
) -> Iterator[tuple[str, Solution]]:
    """Changes worth a try, the most promising first; each is refitted and has its exact Phi."""
    n = len(solution)
    losses = _losses(problem, solution)
    step = problem.structure[n] - problem.structure[n - 1] if n else 0.0
    for j in np.argsort(losses, kind="stable"):
        if losses[j] > _DROPPABLE * step:
            break
        yield (
            "drop",
            problem.refine(problem.solve(np.delete(solution.parameters, j, axis=0)), _TRIAL),
        )
    for i, j in _mergeable(problem, solution):
        labels = solution.assignment.labels.copy()
        labels[labels == j + 1] = i + 1
        joined = problem.evaluator.refit(solution.parameters, labels)
        yield "merge", problem.refine(problem.solve(np.delete(joined, j, axis=0)), _TRIAL)
    if not len(candidates):
        return
    if n < problem.max_planes:
        added = _with_best(problem, solution.parameters, solution.assignment.best, candidates)
        yield "add", problem.refine(problem.solve(added), _TRIAL)
    for j in np.argsort(losses, kind="stable")[:_EXCHANGED]:
        others = np.delete(solution.parameters, j, axis=0)
        rest = problem.solve(others)
        swapped = _with_best(problem, others, rest.assignment.best, candidates)
        yield "exchange", problem.refine(problem.solve(swapped), _TRIAL)


def _among_outliers(problem: Problem, solution: Solution, rng: np.random.Generator) -> Array:
    """Planes through random readings that no plane explains yet: what the paper's search draws."""
    left = np.flatnonzero(solution.assignment.labels == 0)
    if left.size < problem.evaluator.dimension:
        return np.empty((0, problem.evaluator.width))
    drawn = distinct_tuples(rng, _DRAWS, left.size, problem.evaluator.dimension)
    planes = problem.evaluator.through(left[drawn])
    return planes[np.isfinite(planes).all(axis=1)]


def _losses(problem: Problem, solution: Solution) -> Array:
    """Nats by which the data term rises when each plane is dropped, from one pass.

    Every reading of a dropped plane falls back to its second-best gain.
    """
    chosen = solution.assignment
    rise = np.bincount(
        chosen.labels, weights=chosen.second - chosen.best, minlength=len(solution) + 1
    )
    return np.asarray(problem.weight * rise[1 : len(solution) + 1])


def _mergeable(problem: Problem, solution: Solution) -> list[tuple[int, int]]:
    """Pairs (i, j) such that plane i explains much of what plane j explains."""
    pairs = []
    labels, best = solution.assignment.labels, solution.assignment.best
    for j in range(len(solution)):
        mine = np.flatnonzero(labels == j + 1)
        if not mine.size:
            continue
        offered = problem.evaluator.subset(mine).scores(solution.parameters)
        own = best[mine].sum()
        pairs += [(offered[i] / own, i, j) for i in range(len(solution)) if i != j and own < 0]
    pairs.sort(reverse=True)
    return [(i, j) for share, i, j in pairs if share > _SHARED]


def _with_best(problem: Problem, planes: Array, floor: Array, candidates: Array) -> Array:
    """Return the planes and the candidate that saves most beside them."""
    pick = int(np.argmin(problem.evaluator.scores(candidates, floor)))
    plane, _ = problem.refine_one(candidates[pick], floor)
    return np.vstack((planes, plane[None]))


def _extended(problem: Problem, solution: Solution, spare: Array) -> Solution | None:
    """Add the next planes where Phi of all readings, unlike that of the sample, is lower."""
    beyond = _beyond(problem, solution, spare)
    if not beyond.size or not beyond.min() < solution.phi:
        return None
    added = spare[: int(np.argmin(beyond)) + 1]
    return problem.refine(problem.solve(np.vstack((solution.parameters, added))), _TRIAL)


def _beyond(problem: Problem, solution: Solution, spare: Array) -> Array:
    """Exact Phi with the next 1, 2 ... planes added as they are."""
    n, floor = len(solution), solution.assignment.best
    phis: list[float] = []
    for plane in spare[: problem.max_planes - n]:
        floor = np.minimum(floor, problem.evaluator.assign(plane[None]).best)
        phis.append(problem.phi(n + len(phis) + 1, float(floor.sum())))
    return np.array(phis)


def _curve(problem: Problem, solution: Solution, spare: Array, moves: list[Move]) -> Curve:
    """Phi with the first planes, and what a few more would have made it."""
    n = len(solution)
    if n == problem.max_planes:
        reason = limited_to(problem.max_planes)
    elif n == 0:
        reason = NOTHING_PAYS
    else:
        reason = "no move lowers the information"
    phi = np.append(problem.phis(solution.assignment), _beyond(problem, solution, spare))
    return Curve(information=phi, chosen=n, reason=reason, moves=tuple(moves))
