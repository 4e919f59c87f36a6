"""Methods to compare: planewise and, where they are installed, detectors from the package registry.

Each adapter sets a method up on a frame. What is timed afterwards is the detection alone, normals
included where a method needs them; for planewise it starts at the depth image, for the others at
points that are already in the form they take, which favours them. Distances are in metres, sigma is
the sensor's standard deviation at the median depth, and thresholds are 3 sigma unless stated.

Open3D's wheel for Linux also needs the system's libusb-1.0.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.frames import Frame
from benchmarks.rival_points import Cloud, Labels, Points, labels_of_patches, metres, sigma_of
from planewise.paper.sequential import trial_count
from planewise.reproduce.open3d_ransac import one_after_the_other, segment_plane, why_missing

_SMALLEST = 0.01  # share of the readings at which extracting plane after plane ends
_MOST = 32  # planes, there
_NEIGHBOURS = 100  # of a normal: with fewer, planes come in pieces


@dataclass(frozen=True)
class Ready:
    """A method set up on a frame: `detect` is timed, `labels` reads what it returned."""

    detect: Callable[[], Any]
    labels: Callable[[Any], Labels]


@dataclass(frozen=True, kw_only=True)
class Method:
    """One method with its settings.

    Attributes
    ----------
    name, settings : str
        For tables and pictures.
    prepare : callable
        From a frame, and whether its truth tells surfaces of one plane apart, to a method set up.
    module, package : str
        What it is imported as, and the distribution whose version counts.
    slow : bool
        Takes seconds a frame.
    """

    name: str
    settings: str
    prepare: Callable[[Frame, bool], Ready]
    module: str = "planewise"
    package: str = "planewise"
    slow: bool = False

    def missing(self) -> str:
        """Why the method cannot be run here; empty where it can."""
        return why_missing(self.module)


def _planewise(**options: Any) -> Callable[[Frame, bool], Ready]:
    def prepare(frame: Frame, surfaces: bool) -> Ready:
        more: dict[str, Any] = {"instances": True} if surfaces and not options else {}
        detector = pw.Detector(
            frame.camera, frame.sensor, depth_scale=frame.depth_scale, threads=1, **options, **more
        )
        return Ready(lambda: detector(frame.depth), lambda model: model.labels)

    return prepare


def _opencv(**options: Any) -> Callable[[Frame, bool], Ready]:
    def prepare(frame: Frame, _: bool) -> Ready:
        cv2 = import_module("cv2")
        cv2.setNumThreads(1)
        z, camera = metres(frame), frame.camera
        assert isinstance(camera, pw.PinholeCamera)  # what this rival takes
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        points = cv2.depthTo3d(z.astype(np.float32), matrix)
        # With three channels instead of four it returns a mask of the wrong size.
        assert points.shape == (*z.shape, 4)
        settings = options | ({"threshold": 3 * sigma_of(frame, z)} if options else {})
        return Ready(
            lambda: cv2.findPlanes(points, None, **settings)[0],
            lambda mask: np.where(mask == 255, 0, mask.astype(np.int64) + 1),
        )

    return prepare


def _open3d_paper(frame: Frame, _: bool) -> Ready:
    """Threshold sigma, c = 0.99, r = 0.1, N = 8: as the paper compares."""
    cloud = Cloud.of(frame)
    fit = segment_plane(cloud.sigma, trial_count(0.99, 0.1), 0.99)
    return Ready(lambda: one_after_the_other(fit, cloud.points, 8)[0], cloud.image)


def _open3d_tuned(frame: Frame, _: bool) -> Ready:
    """Threshold 3 sigma, 1000 trials a plane, until one has less than 1 % of the readings."""
    cloud = Cloud.of(frame)
    fit = segment_plane(3 * cloud.sigma, 1000)
    return Ready(lambda: one_after_the_other(fit, cloud.points, _MOST, _SMALLEST)[0], cloud.image)


def _open3d_patches(frame: Frame, _: bool) -> Ready:
    """Normals of 100 neighbours."""
    o3d, cloud = import_module("open3d"), Cloud.of(frame)
    points = o3d.utility.Vector3dVector(cloud.points)

    def detect() -> Any:
        made = o3d.geometry.PointCloud(points)
        made.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(knn=_NEIGHBOURS))
        return made.detect_planar_patches()

    def labels(boxes: Any) -> Labels:
        return cloud.image(labels_of_patches(boxes, cloud.points, points))

    return Ready(detect, labels)


def _cgal(smallest: int, frame: Frame, _: bool) -> Ready:
    """Normals of 100 neighbours; clusters 0.1 m apart, cosine 0.8, probability 1 %."""
    sets, processing, detection = (
        import_module(f"CGAL.CGAL_{name}")
        for name in ("Point_set_3", "Point_set_processing_3", "Shape_detection")
    )
    cloud = Cloud.of(frame)
    flat = cloud.points.ravel().tolist()

    def fresh() -> Any:
        points = sets.Point_set_3()
        points.insert_range(flat)
        points.add_normal_map()
        return points, points.add_int_map("plane")

    made = [fresh()]  # the detection reorders its points

    def detect() -> Any:
        points, planes = made.pop() if made else fresh()
        processing.pca_estimate_normals(points, _NEIGHBOURS)
        detection.efficient_RANSAC(points, planes, smallest, 3 * cloud.sigma, 0.1, 0.8, 0.01)
        return points, planes  # the map is part of the set: it must not die before

    def labels(found: Any) -> Labels:
        return cloud.image(np.array([found[1].get(i) + 1 for i in range(len(cloud.points))]))

    return Ready(detect, labels)


def _pyransac3d(frame: Frame, _: bool) -> Ready:
    """293 trials a plane (c = 0.99, r = 0.25), until one has less than 1 % of the readings."""
    pyransac3d, cloud = import_module("pyransac3d"), Cloud.of(frame)
    trials = trial_count(0.99, 0.25)

    def fit(points: Points) -> tuple[Points, NDArray[np.intp]]:
        plane, inliers = pyransac3d.Plane().fit(points, 3 * cloud.sigma, trials)
        return np.asarray(plane, np.float64), np.asarray(inliers, np.intp)

    random.seed(0)
    return Ready(lambda: one_after_the_other(fit, cloud.points, _MOST, _SMALLEST)[0], cloud.image)


DEFAULT = Method(name="planewise", settings="default", prepare=_planewise())
SEQUENTIAL = Method(
    name="planewise sequential",
    settings="search='sequential', c = 0.99, r = 0.1, N = 8",
    prepare=_planewise(search="sequential"),
)
PAPER = Method(
    name="planewise paper",
    settings="objective='paper', joint search",
    prepare=_planewise(objective="paper"),
)
_OPENCV: dict[str, Any] = {"module": "cv2", "package": "opencv-python-headless"}
_OPEN3D: dict[str, Any] = {"module": "open3d", "package": "open3d", "slow": True}
OPENCV = Method(
    name="OpenCV block 20",
    settings="findPlanes, block_size=20, threshold 3 sigma",
    prepare=_opencv(block_size=20),
    **_OPENCV,
)
OPEN3D_PAPER = Method(
    name="Open3D, paper",
    settings="segment_plane, threshold sigma, c = 0.99, r = 0.1, N = 8",
    prepare=_open3d_paper,
    **_OPEN3D,
)
METHODS = (
    DEFAULT,
    PAPER,
    SEQUENTIAL,
    Method(name="OpenCV", settings="findPlanes, defaults", prepare=_opencv(), **_OPENCV),
    OPENCV,
    Method(
        name="Open3D patches",
        settings="detect_planar_patches, normals of 100 neighbours",
        prepare=_open3d_patches,
        **_OPEN3D,
    ),
    Method(
        name="Open3D RANSAC",
        settings="segment_plane, threshold 3 sigma, 1000 trials, planes of 1 % or more",
        prepare=_open3d_tuned,
        **_OPEN3D,
    ),
    OPEN3D_PAPER,
    *(
        Method(
            name=name,
            settings=f"efficient_RANSAC, {smallest} points, 3 sigma, 0.1 m, cosine 0.8",
            prepare=partial(_cgal, smallest),
            module="CGAL.CGAL_Shape_detection",
            package="cgal",
            slow=True,
        )
        for name, smallest in (("CGAL", 3000), ("CGAL, small planes", 800))
    ),
    Method(
        name="pyransac3d",
        settings="Plane.fit, threshold 3 sigma, 293 trials, planes of 1 % or more",
        prepare=_pyransac3d,
        module="pyransac3d",
        package="pyransac3d",
        slow=True,
    ),
)
"""Every method, ours first."""
