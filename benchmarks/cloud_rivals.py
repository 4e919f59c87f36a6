"""Detectors of planes in point clouds, at three settings each.

What is timed is detection alone, the normals included; the points are already in the form that a
method takes. Settings are in units of the noise and of the spacing of the points.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.rival_points import Points, labels_of_patches
from planewise.reproduce.open3d_ransac import why_missing

Labels = NDArray[np.int64]


@dataclass(frozen=True)
class Scan:
    """Points, their truth (0 for no plane), standard deviation and spacing in metres."""

    name: str
    points: Points
    truth: Labels
    sigma: float
    range: float
    resolution: float = 0.001

    @property
    def spacing(self) -> float:
        """Median distance to the nearest neighbour but one, of a sample."""
        step = 1 + len(self.points) // 500
        sample = self.points[::step]
        far = [np.partition(((self.points - p) ** 2).sum(axis=1), 2)[2] for p in sample[:500]]
        return float(np.sqrt(np.median(far)))


@dataclass(frozen=True)
class CloudMethod:
    """A method at one setting: run(scan) gives seconds and labels; module: what it imports."""

    name: str
    setting: str
    run: Callable[[Scan], tuple[float, Labels]]
    module: str = "planewise"


def ours(threads: int | None = None, **options: Any) -> Callable[[Scan], tuple[float, Labels]]:
    """Our detector, surfaces of one plane told apart as the truth does."""

    def run(scan: Scan) -> tuple[float, Labels]:
        sensor = pw.Sensor(max_depth=scan.range, resolution=scan.resolution, noise=scan.sigma)
        start = time.perf_counter()
        model = pw.detect_planes_in_points(
            scan.points, sensor, instances=True, threads=threads, **options
        )
        return time.perf_counter() - start, model.labels.astype(np.int64)

    return run


def _open3d(neighbours: int, variance: float) -> Callable[[Scan], tuple[float, Labels]]:
    def run(scan: Scan) -> tuple[float, Labels]:
        o3d = import_module("open3d")
        points = o3d.utility.Vector3dVector(scan.points)
        start = time.perf_counter()
        made = o3d.geometry.PointCloud(points)
        made.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(knn=neighbours))
        boxes = made.detect_planar_patches(
            normal_variance_threshold_deg=variance,
            search_param=o3d.geometry.KDTreeSearchParamKNN(knn=neighbours),
        )
        seconds = time.perf_counter() - start
        return seconds, labels_of_patches(boxes, scan.points, points)

    return run


def _cgal(
    neighbours: int, smallest: int, cosine: float, gap: float
) -> Callable[[Scan], tuple[float, Labels]]:
    """Threshold 3 sigma, clusters so many spacings apart, probability 1 %."""

    def run(scan: Scan) -> tuple[float, Labels]:
        sets, processing, detection = (
            import_module(f"CGAL.CGAL_{name}")
            for name in ("Point_set_3", "Point_set_processing_3", "Shape_detection")
        )
        apart = max(gap * scan.spacing, 6 * scan.sigma)
        made = sets.Point_set_3()
        made.insert_range(scan.points.ravel().tolist())
        made.add_normal_map()
        planes = made.add_int_map("plane")
        start = time.perf_counter()
        processing.pca_estimate_normals(made, min(neighbours, len(scan.points) // 4))
        detection.efficient_RANSAC(made, planes, smallest, 3 * scan.sigma, apart, cosine, 0.01)
        seconds = time.perf_counter() - start
        # The detection moves points about: indices say which is which.
        labels = np.array([planes.get(i) + 1 for i in range(len(scan.points))], np.int64)
        return seconds, labels

    return run


def methods() -> Iterator[CloudMethod]:
    """Ours first."""
    yield CloudMethod("planewise", "default", ours())
    for neighbours, variance in ((30, 60.0), (15, 60.0), (60, 45.0)):
        yield CloudMethod(
            "Open3D patches",
            f"{neighbours} neighbours, {variance:g} deg",
            _open3d(neighbours, variance),
            "open3d",
        )
    for neighbours, smallest, cosine, gap in (
        (30, 50, 0.8, 5.0),
        (15, 20, 0.8, 10.0),
        (60, 50, 0.9, 20.0),
    ):
        yield CloudMethod(
            "CGAL Efficient RANSAC",
            f"{neighbours} neighbours, {smallest} points, cosine {cosine}, {gap:g} spacings",
            _cgal(neighbours, smallest, cosine, gap),
            "CGAL.CGAL_Point_set_3",
        )


def usable() -> list[CloudMethod]:
    """Methods that can be run here; why others cannot is said."""
    skipped = {each.name: why for each in methods() if (why := why_missing(each.module))}
    for name, why in skipped.items():
        print(f"{name} was skipped: {why} (pip install -e '.[bench]')", file=sys.stderr)
    return [each for each in methods() if each.name not in skipped]
