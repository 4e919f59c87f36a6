"""The doors: from a depth image, a stream of them, or points to a ranked model of planes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import replace
from typing import Any, Literal, Unpack

from numpy.typing import ArrayLike

from planewise.arguments import checked_points, checked_scale, unmasked
from planewise.camera import Camera
from planewise.depth_image import within_range
from planewise.enlarged.own_pixels import as_enlarged, own_pixels
from planewise.misread import misread
from planewise.model import PlaneModel
from planewise.objective import SPATIAL, Objective
from planewise.observation import RayObservation, observe
from planewise.options import GivenOptions, Options, Search, Seed
from planewise.own_camera import checked_camera
from planewise.paper.reassign import NormalReassignment
from planewise.partition import Partition, PartitionOptions
from planewise.point_observation import observe_points
from planewise.runtime.stages import stage
from planewise.runtime.threads import chosen, in_order
from planewise.runtime.workspace import Workspace
from planewise.search import find, find_in_cloud
from planewise.sensor import Sensor, checked_sensor


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
        Metres if floating point, units of `depth_scale` if integer: z, or for a `SphericalCamera`
        and a `PinholeCamera` that is `radial`, range.
        0, NaN, infinity of either sign, what is masked in a masked array and readings outside the
        sensor's range are "no reading". What was enlarged, by repeating pixels, interpolating
        linearly, rows and columns without readings, or moving readings to pixels of a larger
        picture, or to blocks of them, is searched at its own size (spatial objective, without a
        partition; ``settings["own_size"]`` says it).
    camera : Camera
        `PinholeCamera`, or `SphericalCamera` for range images; `planewise.cameras` has presets.
    sensor : Sensor
        Range, resolution and noise; `planewise.sensors` has presets.
    depth_scale : float, optional
        Metres per unit of integer depth; ``None`` means the sensor's resolution. Presets of
        LiDARs have steps of their own, such as 12 mm: 0.001 says that ranges are in millimetres.
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
    return observe_and_find(depth, camera, sensor, options, depth_scale=depth_scale, rgb=rgb)[1]


def observe_and_find(
    depth: ArrayLike,
    camera: Camera,
    sensor: Sensor,
    options: Options,
    *,
    depth_scale: float | None = None,
    rgb: ArrayLike | None = None,
    workspace: Workspace | None = None,
    doubt: bool = True,
) -> tuple[RayObservation, PlaneModel]:
    """Give what is seen in a depth image, too; of an enlarged one, in its own pixels.

    Parameters
    ----------
    depth, camera, sensor, depth_scale, rgb
        As in `detect_planes`.
    options : Options
        How to search.
    workspace : Workspace, optional
        Memory to work in.
    doubt : bool
        Whether the model's note says what readings look like, where that is not what they should.
    """
    options, own = options.resolved(spatial=True), None

    def observed(depth: ArrayLike, camera: Camera) -> RayObservation:
        # Its memory is its own, so that it needs no copy of the image.
        memory = workspace or Workspace()
        return observe(depth, camera, sensor, depth_scale=depth_scale, workspace=memory)

    with stage("observe"):
        if options.objective == SPATIAL and options.partition is None:
            depth = unmasked("depth", depth)
            own = own_pixels(within_range(depth, checked_sensor(sensor), depth_scale), camera)
        if own is not None:
            seen = observed(own.depth, own.camera)
            own = own if own.tells(seen) else None
        if own is None:
            seen = observed(depth, camera)
    model = find(seen, options, workspace, rgb=rgb)
    if doubt:
        model = model.with_note(misread(seen))
    return seen, model if own is None else as_enlarged(own, model, seen.index)


def detect_planes_in_points(
    points: ArrayLike,
    sensor: Sensor,
    *,
    sigma: ArrayLike | None = None,
    origin: ArrayLike | None = None,
    as_image: bool | None = None,
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
        Metres, n >= 2, any origin; rows that are not finite are no reading, nor are points on their
        own origin (of the coordinates, unless `origin` says another), as scanners write missing
        returns, but where noise is a constant or `sigma`, and `origin` not given. In space (n = 3)
        a cloud of floating-point numbers in C order is searched where it lies, without a copy
        unless returns are missing.
    sensor : Sensor
        `max_depth` is R, the extent a coordinate may take; noise is normal to the plane, evaluated
        at the distance from the origin of the coordinates, or "auto": estimated from the points, in
        space (`planewise.estimate_cloud_noise`). `min_depth` does not apply; in space points that
        are farther from the median than R and two million sigma are on no plane.
    sigma : array_like, shape (k,), optional
        Standard deviation of every point in metres, in place of the sensor's noise (spatial
        objective).
    origin : array_like, shape (3,) or (k, 3), optional
        Where the scanner stood, for all points or each (spatial objective): noise is then along
        the rays from there, evaluated at the range. Normals face the origin of the coordinates all
        the same.
    as_image : bool, optional
        Whether points that are those of one depth image (`image_of_cloud`, seen from `origin`) are
        searched as that image, which tells their planes better; noise is then along its axis. By
        default where the noise is "auto". ``settings["image"]`` says that they were.
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
        If an argument is malformed, or `as_image` is true of points that are no depth image's; the
        message says what was expected.

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
    array = checked_points(points)
    options = options.resolved(spatial=array.shape[1] == 3)
    if options.objective == SPATIAL:
        if array.shape[1] != 3:
            raise ValueError(
                f"objective='spatial' needs points of shape (k, 3), got {array.shape}; "
                "hyperplanes take 'paper'"
            )
        return find_in_cloud(
            array, checked_sensor(sensor), sigma, origin, options, as_image=as_image
        )
    for name, given in (("sigma", sigma), ("origin", origin), ("as_image", as_image or None)):
        if given is not None:
            raise ValueError(f"{name} needs objective='spatial', got another objective")
    return find(observe_points(array, sensor), options)


class Detector:
    """`detect_planes` for a stream: camera, sensor and options are checked and prepared once.

    Memory is kept from frame to frame, so a detector serves one thread at a time; a second one that
    calls it meanwhile gets a RuntimeError. Models are the caller's: no later frame changes them.
    What is copied or pickled is the detector without its memory.

    With ``noise="auto"`` every frame has a noise of its own. Planes are steadier with the one that
    the first frames show: ``planewise.calibrate(frames, camera, sensor).sensor(sensor)``.
    Whether readings look like something else than depth is looked at in the first frame alone.

    Parameters
    ----------
    camera, sensor, depth_scale
        As in `detect_planes`.
    **options
        Fields of `Options`; a picture comes with its frame.

    Raises
    ------
    ValueError
        If an argument is malformed; the message names it and says what was expected.

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
        **options: Unpack[GivenOptions],
    ) -> None:
        self.camera, self.sensor = checked_camera(camera), checked_sensor(sensor)
        self.depth_scale = checked_scale(depth_scale)
        self.options = Options(**options).resolved(spatial=True)
        self.options.check_samples(3)
        self._workspace, self._seen = Workspace(), False

    def __call__(self, depth: ArrayLike, *, rgb: ArrayLike | None = None) -> PlaneModel:
        """Detect the planes of one frame; only a partition looks at its picture."""
        return self.observe_and_find(depth, rgb=rgb)[1]

    def observe_and_find(
        self, depth: ArrayLike, *, rgb: ArrayLike | None = None
    ) -> tuple[RayObservation, PlaneModel]:
        """Do the same and give what was seen, too, which lasts until the next frame."""
        with self._workspace.frame():
            found = observe_and_find(
                depth,
                self.camera,
                self.sensor,
                self.options,
                depth_scale=self.depth_scale,
                rgb=rgb,
                workspace=self._workspace,
                doubt=not self._seen,
            )
        self._seen = True
        return found

    def stream(self, frames: Iterable[ArrayLike]) -> Iterator[PlaneModel]:
        """Detect the planes of one frame after another, several of them side by side.

        A frame takes as long as with one thread, but `threads` of them are under way at once: more
        frames a second than by calling the detector, whose threads share the work on one frame.
        For recordings, and for cameras that are faster than one frame is done.

        Parameters
        ----------
        frames : iterable of array_like, shape (H, W)
            As in `detect_planes`. Up to ``threads + 1`` are taken ahead of the model that is waited
            for, and none may change before its model is there: copy what a camera writes over.

        Yields
        ------
        PlaneModel
            Of every frame in turn, the same as by calling the detector.

        Raises
        ------
        ValueError
            In the place of a malformed frame, and at once where the detector has a partition, which
            is asked about one frame and its picture at a time.

        Examples
        --------
        >>> import numpy as np, planewise as pw
        >>> camera = pw.PinholeCamera(fx=50, fy=50, cx=32, cy=24)
        >>> detector = pw.Detector(camera, pw.Sensor(noise=0.01), threads=2)
        >>> recording = [np.full((48, 64), depth) for depth in (2.0, 2.5, 3.0)]
        >>> [round(model.planes[0].distance, 2) for model in detector.stream(recording)]
        [2.0, 2.5, 3.0]
        """
        if self.options.partition is not None:
            raise ValueError("a stream is for detectors without a partition; call this one instead")
        count = chosen(self.options.threads)
        if count == 1 or not isinstance(self.options.rng, int):  # frames draw one after another
            return in_order([self], frames)
        workers = [self._with_one_thread(seen=self._seen or k > 0) for k in range(count)]
        return in_order(workers, frames)

    def _with_one_thread(self, seen: bool) -> Detector:
        """Return a detector with the same options but memory of its own; seen: a frame before."""
        worker = copy(self)
        worker.options, worker._seen = replace(self.options, threads=1), seen
        return worker

    def __getstate__(self) -> dict[str, Any]:
        return {name: each for name, each in self.__dict__.items() if name != "_workspace"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._workspace = Workspace()
