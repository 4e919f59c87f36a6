"""From an observation to a ranked model: which search, under which objective."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise import compilation, threads
from planewise.allocator import keep_freed
from planewise.model import NOTHING_PAYS, Curve, PlaneModel
from planewise.noise import AUTO
from planewise.objective import PAPER, SPATIAL, Objective, as_objective
from planewise.observation import Observation, RayObservation, checked_observation
from planewise.options import Options
from planewise.paper.evaluate import evaluator
from planewise.paper.joint import joint_search
from planewise.paper.problem import Problem
from planewise.paper.propose import propose
from planewise.paper.rank import merge_found, rank
from planewise.paper.reassign import as_reassignment, reassign_by_normals
from planewise.paper.regions import joint_with_regions, sequential_in_regions
from planewise.paper.sequential import sequential_search, trial_count
from planewise.partition import regions_of
from planewise.partition.partitioner import view_of
from planewise.partition.regions import Regions
from planewise.point_observation import PointObservation, checked_origin, checked_sigma
from planewise.sensor import Sensor
from planewise.stages import stage
from planewise.workspace import Workspace


def find(
    observation: Observation,
    options: Options,
    workspace: Workspace | None = None,
    *,
    rgb: ArrayLike | None = None,
) -> PlaneModel:
    """Find the planes of an observation: propose, select, label, refine, rank.

    Parameters
    ----------
    observation : Observation
        From `observe` or `observe_points`.
    options : Options
        How to search.
    workspace : Workspace, optional
        Memory to work in.
    rgb : array_like of uint8, shape (H, W, 3), optional
        Picture of the same view, for a partition.

    Returns
    -------
    PlaneModel
        Planes, best first.
    """
    checked_observation(observation)
    if not isinstance(options, Options):
        raise ValueError(f"options must be planewise.Options(), got a {type(options).__name__}")
    options = options.resolved(isinstance(observation, RayObservation))
    spatial = options.objective == SPATIAL
    if spatial and not isinstance(observation, RayObservation):
        raise ValueError(
            "objective='spatial' needs a depth image, or points (detect_planes_in_points)"
        )
    if options.reassign is not None and not isinstance(observation, RayObservation):
        raise ValueError("reassign needs a depth image; free points have no neighbours")
    objective = PAPER if spatial else as_objective(options.objective or "paper")
    if observation.count < observation.dimension:
        return _no_planes(observation, options, objective.empty(observation))

    image = isinstance(observation, RayObservation)
    compilation.announce("spatial" if spatial else "paper" if image else "points")
    keep_freed()
    regions = _regions(observation, options, rgb)
    if spatial and isinstance(observation, RayObservation):
        # Its compiled loops are loaded only where they are used.
        from planewise.spatial.model import spatial_model

        with threads.allowed(threads.chosen(options.threads)):
            return spatial_model(
                observation,
                instances=options.instances,
                significance=options.significance,
                max_planes=options.most_planes,
                settings=_settings(observation, options),
                workspace=workspace,
                regions=regions,
            )
    return _separable_model(observation, options, objective, regions)


def _separable_model(
    observation: Observation, options: Options, objective: Objective, regions: Regions | None
) -> PlaneModel:
    """Find planes under an objective whose parts are separable: the paper's, or another."""

    def structure(readings: int, most: int) -> NDArray[np.float64]:
        costs = [objective.structure(observation, n, readings) for n in range(most + 1)]
        return np.array(costs)

    empty = objective.empty(observation)
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
        solution, curve = merge_found(problem, solution, curve)
    else:
        candidates = propose(observation, readings, rng)
        solution, curve = joint_search(problem, candidates, rng=rng)
        if within is not None:
            solution, curve = joint_with_regions(
                problem, solution, curve, within, how, structure, rng=rng
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
        objective=options.describe()["objective"],  # type: ignore[arg-type]
        note="" if len(solution) else _why_none(curve),
        settings=_settings(observation, options),
    )


def find_in_cloud(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: ArrayLike | None,
    origin: ArrayLike | None,
    options: Options,
) -> PlaneModel:
    """Find the planes of points in space under the spatial objective.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        As `arguments.checked_points` gives them.
    sensor, sigma, origin
        As in `detect_planes_in_points`.
    options : Options
        How to search.
    """
    errors = checked_sigma(sigma, len(points))
    seen_from = checked_origin(origin, points.shape)
    compilation.announce("cloud")
    keep_freed()
    # Its compiled loops are loaded only where they are used.
    from planewise.clouds.model import cloud_model
    from planewise.clouds.noise import cloud_noise
    from planewise.copies import places_of

    points, settings = np.ascontiguousarray(points), options.describe()
    workers = threads.chosen(options.threads)
    with stage("observe"):
        places = places_of(points)
    if places is not None:
        points = points[places.rows]
        errors = None if errors is None else errors[places.rows]
        if seen_from is not None and seen_from.ndim == 2:
            seen_from = seen_from[places.rows]
    if sensor.noise == AUTO and errors is None:
        with stage("noise"):
            estimate = cloud_noise(points, sensor, seen_from, workers)
        sensor, settings["noise"] = estimate.sensor(sensor), estimate.describe()
    model = cloud_model(
        points,
        sensor,
        errors,
        seen_from,
        instances=options.instances,
        max_planes=options.most_planes,
        significance=options.significance,
        settings=settings,
        workers=workers,
        rng=np.random.default_rng(options.rng),
    )
    return model if places is None else places.of_all(model)


def _regions(observation: Observation, options: Options, rgb: ArrayLike | None) -> Regions | None:
    """Regions of the partition that is asked for, if any."""
    if options.partitioner is None:
        return None
    if not isinstance(observation, RayObservation):
        raise ValueError("partition needs a depth image; free points have no regions")
    with stage("partition"):
        return regions_of(options.partitioner, view_of(observation, rgb))


def _settings(observation: Observation, options: Options) -> dict[str, object]:
    """What the model was made with; a noise that was estimated included."""
    out = options.describe()
    if (
        isinstance(observation, RayObservation | PointObservation)
        and observation.estimate is not None
    ):
        out["noise"] = observation.estimate.describe()
    return out


def _prefix(phi: float, worth: list[float], structure: NDArray[np.float64]) -> tuple[float, ...]:
    """Phi with the best 0 ... N planes, the readings of the others on none."""
    n = len(worth)
    lost = np.concatenate((np.cumsum(worth[::-1])[::-1], [0.0]))
    return tuple((phi - lost - (structure[n] - structure[: n + 1])).tolist())


def _why_none(curve: Curve) -> str:
    """Why there is no plane, by the curve of a search that found none, or none that pays."""
    return curve.reason if len(curve) == 1 else NOTHING_PAYS


def _no_planes(observation: Observation, options: Options, empty: float) -> PlaneModel:
    return PlaneModel(
        labels=np.zeros(observation.shape, np.uint16),
        planes=(),
        information=empty,
        curve=Curve(information=np.array([empty]), chosen=0, reason=observation.note),
        readings=observation.count,
        prefix=(empty,),
        search=options.search,
        objective=options.describe()["objective"],  # type: ignore[arg-type]
        note=observation.note,
        settings=_settings(observation, options),
    )
