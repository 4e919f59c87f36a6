"""The one call: from a depth image, a stream of them, or points to a ranked model of planes."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise import compilation, threads
from planewise.camera import Camera
from planewise.evaluate import MAX_PLANES, evaluator
from planewise.joint import joint_search
from planewise.model import Curve, PlaneModel
from planewise.objective import PAPER, SPATIAL, Objective, as_objective
from planewise.observation import (
    Observation,
    RayObservation,
    checked_points,
    observe,
    observe_points,
)
from planewise.partition import (
    Partition,
    Partitioner,
    PartitionOptions,
    as_partitioner,
    describe,
    regions_of,
)
from planewise.partition.partitioner import view_of
from planewise.partition.regions import Regions
from planewise.problem import Problem
from planewise.propose import propose
from planewise.rank import merge_into_better, rank
from planewise.reassign import NormalReassignment, as_reassignment, reassign_by_normals
from planewise.region_search import joint_with_regions, sequential_in_regions
from planewise.sensor import Sensor
from planewise.sequential import sequential_search, trial_count
from planewise.stages import stage
from planewise.workspace import Workspace

Search = Literal["joint", "sequential"]
Seed = int | np.random.Generator

_MAX_PLANES = {"joint": 64, "sequential": 8}


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to search.

    Parameters
    ----------
    search : {"joint", "sequential"}
        All planes together, or the paper's one after the other.
    objective : {"spatial", "paper"} or Objective, optional
        What is minimised: a spatial mask code with correlated error and a smooth null (depth
        images and points in space, joint search), or the paper's objective. ``None`` means the
        first where it can be had, else the second.
    instances : bool
        Keep coplanar surfaces that do not touch apart (spatial objective).
    significance : float
        Nats that a plane has to save beyond its parameters and its border (spatial objective): the
        larger, the fewer planes.
    confidence : float
        c of the paper: probability that a plane's sample is drawn from it alone (sequential).
    inlier_ratio : float
        r of the paper: share of the readings on the smallest plane sought (sequential).
    max_planes : int, optional
        Largest number of planes; ``None`` means 8 for the sequential search, as in the paper, and
        64 for the joint one, which stops by itself; there is no limit for the sequential search
        with a partition.
    reassign : {"normals"} or NormalReassignment, optional
        The paper's step after the search: readings that fit several planes go to the one whose
        normal and distance are most like those of the surface around them. For depth images under
        the paper's objective; the planes stay and Phi, exact for the new labels, may rise.
    partition : str, callable or array_like, optional
        Regions of a depth image, in which the sequential search looks for planes and the joint one
        for further candidates, which cannot raise Phi: "graph" or "auto", "blocks", "sam", a label
        image (H, W), masks (N, H, W), or a function (`planewise.partition`).
    partition_options : PartitionOptions
        How the paper's search goes through the regions.
    rng : int or numpy.random.Generator
        Seed. With an int every call gives the same answer for the same input.
    threads : int, optional
        Threads for the compiled loops; ``None`` means one per processor. No result depends on it.
    """

    search: Search = "joint"
    objective: Objective | str | None = None
    instances: bool = False
    significance: float = 0.0
    confidence: float = 0.99
    inlier_ratio: float = 0.1
    max_planes: int | None = None
    reassign: NormalReassignment | Literal["normals"] | None = None
    partition: Partition | None = None
    partition_options: PartitionOptions = field(default_factory=PartitionOptions)
    rng: Seed = 0
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.partition is not None:
            object.__setattr__(self, "partition", as_partitioner(self.partition))
        if self.search not in _MAX_PLANES:
            raise ValueError(f"search must be 'joint' or 'sequential', got {self.search!r}")
        if self.objective not in (None, SPATIAL):
            as_objective(self.objective)
            if self.instances:
                raise ValueError("instances needs objective='spatial', got another objective")
        elif self.search != "joint" and self.objective == SPATIAL:
            raise ValueError("objective='spatial' needs search='joint', got another search")
        elif self.search != "joint" and self.instances:
            raise ValueError("instances needs search='joint', got another search")
        if not 0 <= self.significance < math.inf:
            raise ValueError(
                f"significance must be a number of nats, not negative, got {self.significance}"
            )
        trial_count(self.confidence, self.inlier_ratio)
        as_reassignment(self.reassign)
        spatial = self.objective == SPATIAL or (self.objective is None and self.search == "joint")
        if self.reassign is not None and spatial:
            raise ValueError(
                "reassign needs objective='paper' or search='sequential', got objective='spatial', "
                "whose mask code sees to neighbours itself"
            )
        if self.max_planes is not None and not 1 <= self.max_planes <= MAX_PLANES:
            raise ValueError(f"max_planes must lie in 1 ... {MAX_PLANES}, got {self.max_planes}")
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"threads must be at least 1, got {self.threads}")

    def resolved(self, spatial: bool) -> Options:
        """These options with an objective; spatial: whether the observation may have that one."""
        if self.objective is not None:
            return self
        return replace(self, objective=SPATIAL if spatial and self.search == "joint" else "paper")

    def describe(self) -> dict[str, object]:
        """Say in plain types what was asked for, for result files."""
        out: dict[str, object] = {
            "search": self.search,
            "objective": "custom" if isinstance(self.objective, Objective) else self.objective,
            "max_planes": self.most_planes,
            "instances": self.instances,
            "significance": self.significance,
            "rng": self.rng if isinstance(self.rng, int) else "generator",
        }
        if self.search == "sequential":
            out |= {"confidence": self.confidence, "inlier_ratio": self.inlier_ratio}
        if reassign := as_reassignment(self.reassign):
            out["reassign"] = {"normals": asdict(reassign)}
        if self.partitioner is not None:
            out |= {
                "partition": describe(self.partitioner),
                "partition_options": asdict(self.partition_options),
            }
        return out

    @property
    def partitioner(self) -> Partitioner | None:
        """What makes the regions, if any."""
        return None if self.partition is None else as_partitioner(self.partition)

    @property
    def most_planes(self) -> int:
        """Largest number of planes."""
        regions = self.search == "sequential" and self.partition is not None
        return self.max_planes or (MAX_PLANES if regions else _MAX_PLANES[self.search])


def detect_planes(
    depth: ArrayLike,
    camera: Camera,
    sensor: Sensor,
    *,
    depth_scale: float | None = None,
    search: Search = "joint",
    objective: Objective | str | None = None,
    instances: bool = False,
    significance: float = 0.0,
    confidence: float = 0.99,
    inlier_ratio: float = 0.1,
    max_planes: int | None = None,
    reassign: NormalReassignment | Literal["normals"] | None = None,
    partition: Partition | None = None,
    partition_options: PartitionOptions = PartitionOptions(),  # noqa: B008 (frozen)
    rgb: ArrayLike | None = None,
    rng: Seed = 0,
    threads: int | None = None,
) -> PlaneModel:
    """Find every plane a depth image can justify, best first.

    Parameters
    ----------
    depth : array_like, shape (H, W)
        Metres if floating point, units of `depth_scale` if integer; for a `SphericalCamera`, range.
        0, NaN, infinity and readings outside the sensor's range are "no reading".
    camera : Camera
        `PinholeCamera`, or `SphericalCamera` for range images; `planewise.cameras` has presets.
    sensor : Sensor
        Range, resolution and noise; `planewise.sensors` has presets.
    depth_scale : float, optional
        Metres per unit of integer depth; ``None`` means the sensor's resolution.
    search, objective, instances, significance, confidence, inlier_ratio, max_planes
        See `Options`.
    reassign, rng, threads
        See `Options`.
    partition, partition_options
        See `Options`.
    rgb : array_like of uint8, shape (H, W, 3), optional
        Picture of the same view; only a partition looks at it.

    Returns
    -------
    PlaneModel
        Labels, planes, information. A frame with fewer than three readings gives a model without
        planes whose `note` says why.

    Raises
    ------
    ValueError
        If an argument is malformed; the message names it and says what was expected.

    Examples
    --------
    >>> import numpy as np, planewise as pw
    >>> wall = np.full((48, 64), 2.0) + np.random.default_rng(0).normal(0, 0.005, (48, 64))
    >>> camera = pw.PinholeCamera(fx=50, fy=50, cx=32, cy=24)
    >>> model = pw.detect_planes(wall, camera, pw.Sensor(max_depth=10, noise=0.005))
    >>> len(model.planes), round(model.planes[0].distance, 2)
    (1, 2.0)
    """
    options = Options(
        search=search,
        objective=objective,
        instances=instances,
        significance=significance,
        confidence=confidence,
        inlier_ratio=inlier_ratio,
        max_planes=max_planes,
        reassign=reassign,
        partition=partition,
        partition_options=partition_options,
        rng=rng,
        threads=threads,
    )
    with stage("observe"):
        frame = observe(depth, camera, sensor, depth_scale=depth_scale)
    return find(frame, options, rgb=rgb)


def detect_planes_in_points(
    points: ArrayLike,
    sensor: Sensor,
    *,
    sigma: ArrayLike | None = None,
    origin: ArrayLike | None = None,
    search: Search = "joint",
    objective: Objective | str | None = None,
    instances: bool = False,
    significance: float = 0.0,
    confidence: float = 0.99,
    inlier_ratio: float = 0.1,
    max_planes: int | None = None,
    rng: Seed = 0,
    threads: int | None = None,
) -> PlaneModel:
    """Find every plane that free points can justify, best first: in n dimensions, every hyperplane.

    Parameters
    ----------
    points : array_like, shape (k, n)
        Metres, n >= 2, any origin; rows that are not finite are no reading. In space (n = 3) a
        cloud of floating-point numbers in C order is searched where it lies, without a copy.
    sensor : Sensor
        `max_depth` is R, the extent a coordinate may take; noise is normal to the plane, evaluated
        at the distance from the origin of the coordinates. Depth limits do not apply.
    sigma : array_like, shape (k,), optional
        Standard deviation of every point in metres, in place of the sensor's noise (spatial
        objective).
    origin : array_like, shape (3,) or (k, 3), optional
        Where the scanner stood, for all points or each (spatial objective): noise is then along
        the rays from there, evaluated at the range. Normals face the origin of the coordinates all
        the same.
    search, objective, instances, significance, confidence, inlier_ratio, max_planes, rng, threads
        See `Options`. The spatial objective needs n = 3.

    Returns
    -------
    PlaneModel
        `labels` has shape (k,). Points that show no plane give a model without planes whose `note`
        says why.

    Raises
    ------
    ValueError
        If an argument is malformed; the message names it and says what was expected.

    Examples
    --------
    >>> import numpy as np, planewise as pw
    >>> rng = np.random.default_rng(0)
    >>> roof = rng.uniform(0, 10, (4000, 3)) + [592000.0, 6740000.0, 0]
    >>> roof[:, 2] = 60 + 0.5 * np.abs(roof[:, 0] - 592005) + rng.normal(0, 0.02, 4000)
    >>> model = pw.detect_planes_in_points(roof, pw.Sensor(max_depth=100, noise=0.02))
    >>> len(model), [round(plane.area) for plane in model.planes]
    (2, [56, 56])
    """
    options = Options(
        search=search,
        objective=objective,
        instances=instances,
        significance=significance,
        confidence=confidence,
        inlier_ratio=inlier_ratio,
        max_planes=max_planes,
        rng=rng,
        threads=threads,
    )
    array = checked_points(points, sensor)
    options = options.resolved(spatial=array.shape[1] == 3)
    if options.objective == SPATIAL:
        if array.shape[1] != 3:
            raise ValueError(
                f"objective='spatial' needs points of shape (k, 3), got {array.shape}; "
                "hyperplanes take 'paper'"
            )
        return _find_in_cloud(array, sensor, sigma, origin, options)
    for name, given in (("sigma", sigma), ("origin", origin)):
        if given is not None:
            raise ValueError(f"{name} needs objective='spatial', got another objective")
    return find(observe_points(array, sensor), options)


def _find_in_cloud(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: ArrayLike | None,
    origin: ArrayLike | None,
    options: Options,
) -> PlaneModel:
    errors = None if sigma is None else np.asarray(sigma, np.float64)
    if errors is not None:
        if errors.shape != points.shape[:1]:
            raise ValueError(
                f"sigma must hold one number a point: expected shape {points.shape[:1]}, "
                f"got {errors.shape}"
            )
        if not (np.isfinite(errors).all() and (errors > 0).all()):
            raise ValueError("sigma must be positive and finite (metres)")
    seen_from = None if origin is None else np.asarray(origin, np.float64)
    if seen_from is not None:
        if seen_from.shape not in ((3,), points.shape):
            raise ValueError(
                "origin must be one place or one a point: expected shape (3,) or "
                f"{points.shape}, got {seen_from.shape}"
            )
        if not np.isfinite(seen_from).all():
            raise ValueError("origin must be finite (metres)")
    compilation.announce()
    # Its compiled loops are loaded only where they are used.
    from planewise.cloud_model import cloud_model

    return cloud_model(
        np.ascontiguousarray(points),
        sensor,
        errors,
        seen_from,
        instances=options.instances,
        max_planes=options.max_planes or MAX_PLANES,
        significance=options.significance,
        settings=options.describe(),
        workers=options.threads or threads.available(),
        rng=np.random.default_rng(options.rng),
    )


class Detector:
    """`detect_planes` for a stream: camera, sensor and options are checked and prepared once.

    Memory is kept from frame to frame, so a detector serves one thread at a time.

    Parameters
    ----------
    camera, sensor
        As in `detect_planes`.
    **options
        Keyword options of `detect_planes`.

    Examples
    --------
    >>> import numpy as np, planewise as pw
    >>> detector = pw.Detector(pw.PinholeCamera(fx=50, fy=50, cx=32, cy=24), pw.Sensor(noise=0.01))
    >>> len(detector(np.full((48, 64), 2.0)))
    1
    """

    def __init__(
        self,
        camera: Camera,
        sensor: Sensor,
        *,
        depth_scale: float | None = None,
        **options: object,
    ) -> None:
        self.camera, self.sensor, self.depth_scale = camera, sensor, depth_scale
        self.options = Options(**options)  # type: ignore[arg-type]
        self._workspace = Workspace()

    def __call__(self, depth: ArrayLike, *, rgb: ArrayLike | None = None) -> PlaneModel:
        """Detect the planes of one frame; only a partition looks at its picture."""
        with self._workspace.frame():
            with stage("observe"):
                frame = observe(
                    depth,
                    self.camera,
                    self.sensor,
                    depth_scale=self.depth_scale,
                    workspace=self._workspace,
                )
            return find(frame, self.options, self._workspace, rgb=rgb)


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
    options = options.resolved(isinstance(observation, RayObservation))
    spatial = options.objective == SPATIAL
    if spatial and not isinstance(observation, RayObservation):
        raise ValueError(
            "objective='spatial' needs a depth image, or points (detect_planes_in_points)"
        )
    reassign = as_reassignment(options.reassign)
    if reassign is not None and not isinstance(observation, RayObservation):
        raise ValueError("reassign needs a depth image; free points have no neighbours")
    objective = PAPER if spatial else as_objective(options.objective or "paper")
    if observation.count < observation.dimension:
        return _no_planes(observation, options, objective.empty(observation))

    compilation.announce()
    regions = _regions(observation, options, rgb)
    if spatial and isinstance(observation, RayObservation):
        # Its compiled loops are loaded only where they are used.
        from planewise.spatial_model import spatial_model

        return spatial_model(
            observation,
            instances=options.instances,
            significance=options.significance,
            max_planes=options.max_planes or MAX_PLANES,
            settings=_settings(observation, options),
            workspace=workspace,
            regions=regions,
        )

    def structure(readings: int, most: int) -> NDArray[np.float64]:
        costs = [objective.structure(observation, n, readings) for n in range(most + 1)]
        return np.array(costs)

    empty = objective.empty(observation)
    rng = np.random.default_rng(options.rng)
    readings = evaluator(
        observation, objective.thresholds(observation), options.threads or threads.available()
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
        solution = merge_into_better(problem, solution)
    else:
        candidates = propose(observation, readings, rng)
        solution, curve = joint_search(problem, candidates, rng=rng)
        if within is not None:
            solution, curve = joint_with_regions(
                problem, solution, curve, within, how, structure, rng=rng
            )
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
        note="" if len(solution) else curve.reason,
        settings=_settings(observation, options),
    )


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
    if isinstance(observation, RayObservation) and observation.estimate is not None:
        out["noise"] = observation.estimate.describe()
    return out


def _prefix(phi: float, worth: list[float], structure: NDArray[np.float64]) -> tuple[float, ...]:
    """Phi with the best 0 ... N planes, the readings of the others on none."""
    n = len(worth)
    lost = np.concatenate((np.cumsum(worth[::-1])[::-1], [0.0]))
    return tuple((phi - lost - (structure[n] - structure[: n + 1])).tolist())


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
