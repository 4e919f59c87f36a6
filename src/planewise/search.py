"""From an observation to a ranked model: which search, under which objective."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise import compilation
from planewise.cloud_image import CloudImage, image_of_cloud
from planewise.model import Curve, PlaneModel, assumed_noise
from planewise.noise import AUTO
from planewise.objective import PAPER, SPATIAL, as_objective
from planewise.observation import Observation, RayObservation, checked_observation, observe
from planewise.options import Options
from planewise.partition import regions_of
from planewise.partition.partitioner import view_of
from planewise.partition.regions import Regions
from planewise.point_observation import PointObservation, checked_origin, checked_sigma
from planewise.runtime import threads
from planewise.runtime.allocator import keep_freed
from planewise.runtime.stages import stage
from planewise.runtime.workspace import Workspace
from planewise.sensor import Sensor


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

    Raises
    ------
    ValueError
        If an argument is malformed, or the options do not go with such an observation: the spatial
        objective and `reassign` need a depth image, samples in many dimensions a larger share.
    MissingExtraError
        If a partition needs what is not installed.
    """
    checked_observation(observation)
    if not isinstance(options, Options):
        raise ValueError(f"options must be planewise.Options(), got a {type(options).__name__}")
    options = options.resolved(isinstance(observation, RayObservation))
    options.check_samples(observation.dimension)
    spatial = options.objective == SPATIAL
    if spatial and not isinstance(observation, RayObservation):
        raise ValueError(
            "objective='spatial' needs a depth image, or points (detect_planes_in_points)"
        )
    if options.reassign is not None and not isinstance(observation, RayObservation):
        raise ValueError("reassign needs a depth image; free points have no neighbours")
    objective = PAPER if spatial else as_objective(options.objective or "paper")
    settings = _settings(observation, options)
    if observation.count < observation.dimension:
        empty = objective.empty(observation)
        return noted(_no_planes(observation, options, settings, empty))

    image = isinstance(observation, RayObservation)
    compilation.announce("spatial" if spatial else "paper" if image else "points")
    keep_freed()
    regions = _regions(observation, options, rgb)
    # Compiled loops are loaded only where they are used.
    with threads.allowed(threads.chosen(options.threads)):
        if spatial and isinstance(observation, RayObservation):
            from planewise.spatial.model import spatial_model

            model = spatial_model(
                observation,
                instances=options.instances,
                significance=options.significance,
                max_planes=options.most_planes,
                settings=settings,
                workspace=workspace,
                regions=regions,
            )
            return noted(model)
        from planewise.paper.model import separable_model

        return noted(separable_model(observation, options, objective, settings, regions))


def find_in_cloud(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: ArrayLike | None,
    origin: ArrayLike | None,
    options: Options,
    *,
    as_image: bool | None = False,
) -> PlaneModel:
    """Find the planes of points in space under the spatial objective.

    Parameters
    ----------
    points : ndarray, shape (k, 3)
        As `arguments.checked_points` gives them.
    sensor, sigma, origin, as_image
        As in `detect_planes_in_points`.
    options : Options
        How to search.
    """
    errors = checked_sigma(sigma, len(points))
    seen_from = checked_origin(origin, points.shape)
    if as_image and errors is not None:
        raise ValueError("as_image needs the noise of a sensor, not sigma= of every point")
    if as_image or (as_image is None and errors is None and sensor.noise == AUTO):
        try:
            image = image_of_cloud(points, seen_from)
        except ValueError:
            if as_image:
                raise
        else:
            return find_in_image(image, sensor, options)
    compilation.announce("cloud")
    keep_freed()
    # Its compiled loops are loaded only where they are used.
    from planewise.clouds.missing import without_missing
    from planewise.clouds.model import cloud_model
    from planewise.clouds.noise import cloud_noise
    from planewise.copies import places_of

    points, settings = np.ascontiguousarray(points), options.describe()
    workers = threads.chosen(options.threads)
    with stage("observe"):
        points = without_missing(points, sensor, errors, seen_from)
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
    return noted(model if places is None else places.of_all(model))


def find_in_image(image: CloudImage, sensor: Sensor, options: Options) -> PlaneModel:
    """Find the planes of points in the depth image that they were made of.

    All of them are within the sensor's range, as those of any other cloud are.
    """
    deepest = max(sensor.max_depth, float(image.depth.max()))
    ranging = replace(sensor, min_depth=0.0, max_depth=deepest)
    with stage("observe"):
        seen = observe(image.depth, image.camera, ranging, workspace=Workspace())
    return image.in_cloud(find(seen, options))


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


def noted(model: PlaneModel) -> PlaneModel:
    """Say in the model's note, too, where noise could not be estimated and was assumed."""
    assumed = assumed_noise(model.settings)
    if not assumed:
        return model
    return model.with_note(f"noise: {assumed}; where that is wrong, so are planes")


def _no_planes(
    observation: Observation, options: Options, settings: dict[str, object], empty: float
) -> PlaneModel:
    return PlaneModel(
        labels=np.zeros(observation.shape, np.uint16),
        planes=(),
        information=empty,
        curve=Curve(information=np.array([empty]), chosen=0, reason=observation.note),
        readings=observation.count,
        prefix=(empty,),
        search=options.search,
        objective=settings["objective"],  # type: ignore[arg-type]
        note=observation.note,
        settings=settings,
    )
