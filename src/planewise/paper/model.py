"""From an observation to a ranked model: the paper's searches, under objectives like its own."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planewise.model import NOTHING_PAYS, Curve, PlaneModel
from planewise.objective import Objective
from planewise.observation import Observation, RayObservation
from planewise.paper.evaluate import evaluator
from planewise.paper.joint import joint_search
from planewise.paper.problem import Problem
from planewise.paper.propose import propose
from planewise.paper.rank import merge_found, rank
from planewise.paper.reassign import as_reassignment, reassign_by_normals
from planewise.paper.regions import joint_with_regions, sequential_in_regions
from planewise.paper.sequential import sequential_search, trial_count
from planewise.partition.regions import Regions
from planewise.runtime import threads

if TYPE_CHECKING:
    from planewise.options import Options


def separable_model(
    observation: Observation,
    options: Options,
    objective: Objective,
    settings: dict[str, object],
    regions: Regions | None = None,
) -> PlaneModel:
    """Find planes under an objective whose parts are separable: propose, select, rank.

    Parameters
    ----------
    observation : Observation
        Readings.
    options : Options
        How to search.
    objective : Objective
        The paper's, or another.
    settings : dict
        What the model was made with.
    regions : Regions, optional
        Of a partition, searched one by one.
    """

    def structure(readings: int, most: int) -> NDArray[np.float64]:
        costs = [objective.structure(observation, n, readings) for n in range(most + 1)]
        return np.array(costs)

    empty = objective.all_outliers(observation)
    rng = np.random.default_rng(options.rng)
    readings = evaluator(
        observation, objective.thresholds(observation), threads.chosen(options.threads)
    )
    most = options.most_planes if regions is None or options.search == "joint" else 0
    problem = Problem(evaluator=readings, empty=empty, structure=structure(observation.count, most))
    within = None if regions is None else regions.take(observation.index)
    how = options.partition_options
    if within is not None and options.search == "sequential":
        solution, curve = sequential_in_regions(
            problem, within, how, structure, max_planes=options.most_planes, rng=rng
        )
        costs = structure(observation.count, len(solution))
        problem = replace(problem, structure=costs)
    elif options.search == "sequential":
        trials = trial_count(options.confidence, options.inlier_ratio, observation.dimension)
        solution, curve = sequential_search(problem, trials=trials, rng=rng)
        solution, curve = merge_found(problem, solution, curve, in_turn=True)
    else:
        candidates = propose(observation, readings, rng)
        solution, curve = joint_search(problem, candidates, rng=rng)
        if within is not None:
            # A seed draws as for the sequential search: Phi is then never above that one's.
            again = np.random.default_rng(options.rng)
            solution, curve = joint_with_regions(
                problem, solution, curve, within, how, structure, rng=again
            )
    reassign = as_reassignment(options.reassign)
    if reassign is not None and isinstance(observation, RayObservation) and len(solution):
        solution = reassign_by_normals(observation, problem, solution, reassign)
        curve = curve.then("reassign", len(solution), solution.phi)
    planes, labels = rank(observation, readings, solution)
    return PlaneModel(
        labels=observation.unflatten(labels),
        planes=planes,
        information=solution.phi,
        curve=curve,
        readings=observation.count,
        prefix=_prefix(solution.phi, [each.information for each in planes], problem.structure),
        search=options.search,
        objective=settings["objective"],  # type: ignore[arg-type]
        note="" if len(solution) else _why_none(curve),
        settings=settings,
    )


def _prefix(phi: float, worth: list[float], structure: NDArray[np.float64]) -> tuple[float, ...]:
    """Phi with the best 0 ... N planes, the readings of the others on none."""
    n = len(worth)
    lost = np.concatenate((np.cumsum(worth[::-1])[::-1], [0.0]))
    return tuple((phi - lost - (structure[n] - structure[: n + 1])).tolist())


def _why_none(curve: Curve) -> str:
    """Why there is no plane, by the curve of a search that found none, or none that pays."""
    return curve.reason if len(curve) == 1 else NOTHING_PAYS
