"""The methods that are compared, each told the same about a frame."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise import noise
from planewise.camera import Camera
from planewise.detect import Detector
from planewise.paper.sequential import trial_count
from planewise.reproduce.open3d_ransac import one_after_the_other, segment_plane, why_missing
from planewise.scenes.scene import Scene
from planewise.sensor import Sensor

Array = NDArray[np.float64]

OPEN3D, PAPER, OURS = "Open3D", "paper's search", "planewise"
REASSIGNED = "paper's search, reassigned"

WORDS = {OPEN3D: "open3d", PAPER: "paper", REASSIGNED: "reassigned", OURS: "planewise"}
"""What methods are called in the names of files."""

CONFIDENCE = 0.99
"""c of the paper: probability that a plane's sample is pure."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A depth image and what a method is told about it.

    Attributes
    ----------
    depth : ndarray, shape (H, W)
        As `planewise.detect_planes` takes it.
    camera, sensor
        Of the frame; the sensor's noise is the assumed one.
    sigma : float
        Assumed standard deviation in metres; the distance threshold of Open3D.
    inlier_ratio : float
        r of the paper: share of the readings on the smallest plane.
    max_planes : int
        N of the paper.
    seed : int
        Of a method that draws samples.
    threads : int, optional
        As in `planewise.Detector`.
    """

    depth: NDArray[Any]
    camera: Camera
    sensor: Sensor
    sigma: float
    inlier_ratio: float
    max_planes: int = 8
    seed: int = 0
    threads: int | None = 1

    @classmethod
    def of(
        cls,
        scene: Scene,
        sigma: float,
        *,
        inlier_ratio: float,
        max_planes: int,
        seed: int,
        depth: NDArray[Any] | None = None,
    ) -> Frame:
        """Frame of a scene, or of its depth in metres, whose noise is taken to be `sigma`."""
        return cls(
            depth=scene.depth if depth is None else depth,
            camera=scene.camera,
            sensor=replace(scene.sensor, noise=noise.constant(sigma)),
            sigma=sigma,
            inlier_ratio=inlier_ratio,
            max_planes=max_planes,
            seed=seed,
        )


@dataclass(frozen=True, kw_only=True)
class Found:
    """What a method found: label j is row j - 1 of the planes (normal, distance >= 0)."""

    labels: NDArray[np.integer]
    planes: Array
    seconds: float


def available() -> tuple[str, ...]:
    """Methods that can be run here, in the order of the tables."""
    return (*(() if why_missing() else (OPEN3D,)), PAPER, OURS)


def detect(method: str, frame: Frame) -> Found:
    """Run a method; what is timed is the detection alone, for Open3D from points on."""
    call = prepared(method, frame)
    if method != OPEN3D:  # which has nothing to warm up
        call()  # the first of a process loads compiled loops, and no other frame needs them all
    start = time.perf_counter()
    labels, planes = call()
    seconds = time.perf_counter() - start
    return Found(labels=labels, planes=_facing_the_camera(planes), seconds=seconds)


def prepared(method: str, frame: Frame) -> Callable[[], tuple[NDArray[np.integer], Array]]:
    """Set a method up on a frame: calling what is returned detects, and gives labels and planes."""
    if method == OPEN3D:
        return _open3d(frame)
    options: dict[str, Any] = {}
    if method != OURS:
        options = {
            "search": "sequential",
            "confidence": CONFIDENCE,
            "inlier_ratio": frame.inlier_ratio,
            "max_planes": frame.max_planes,
        }
    if method == REASSIGNED:
        options["reassign"] = "normals"
    detector = Detector(
        frame.camera, frame.sensor, rng=frame.seed, threads=frame.threads, **options
    )

    def call() -> tuple[NDArray[np.integer], Array]:
        model = detector(frame.depth)
        return model.labels, model.coefficients

    return call


def _open3d(frame: Frame) -> Callable[[], tuple[NDArray[np.integer], Array]]:
    """Threshold sigma, samples by c and r, always N planes: as the paper compares."""
    z = np.asarray(frame.depth, np.float64)
    if frame.depth.dtype.kind != "f":
        z = z * frame.sensor.resolution
    there = z > 0
    points = (frame.camera.rays((z.shape[0], z.shape[1])) * z[..., None])[there]
    trials = trial_count(CONFIDENCE, frame.inlier_ratio)

    def call() -> tuple[NDArray[np.integer], Array]:
        fit = segment_plane(frame.sigma, trials, CONFIDENCE, seed=frame.seed)
        found, planes = one_after_the_other(fit, points, frame.max_planes)
        labels = np.zeros(z.shape, np.int64)
        labels[there] = found
        return labels, planes

    return call


def _facing_the_camera(planes: Array) -> Array:
    """Rows (normal, distance) of unit normals with distance >= 0."""
    planes = planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    return np.asarray(planes * np.where(planes[:, 3:] < 0, -1.0, 1.0))
