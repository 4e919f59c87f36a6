"""Depth images searched as clouds of points: prints Markdown tables of means.

python -m benchmarks.depth_clouds [--rooms 8]

Points of synthetic Kinect images in the frame of the camera, of every pixel, or of every second or
fourth row and column, all of them or two thirds. Their noise is given (white and rounding), or
estimated; or they are searched as the image that they tell (`planewise.image_of_cloud`), its noise
estimated. Below, the scans of depth cameras among the real ones, without labels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.clouds import unlabelled
from planewise import scenes
from planewise.metrics import evaluate
from planewise.noise import RootSum
from planewise.scenes import Scene

STEP = 0.00287  # metres at one metre, growing with the square of depth: of the scenes' disparity
SENSOR = pw.Sensor(max_depth=10.0, noise="auto")
TOLD = pw.Sensor(
    max_depth=10.0,
    noise=RootSum((pw.noise.KINECT, pw.noise.Polynomial(quadratic=STEP / np.sqrt(12)))),
)


def cloud_of(scene: Scene, every: int) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Points of some of the pixels, and their labels."""
    depth = scene.depth * scene.sensor.resolution
    points = (scene.camera.rays(scene.depth.shape) * depth[..., None])[::every, ::every]
    there = points[..., 2] > 0
    return points[there], scene.labels[::every, ::every][there]


def scored(model: pw.PlaneModel, labels: NDArray[np.integer]) -> tuple[float, float, float]:
    """Planes, VOI and F1 at an IoU of 0.5."""
    row = evaluate(np.atleast_2d(model.labels), np.atleast_2d(labels)).row()
    return float(len(model)), float(row["voi_labelled"]), float(row["f1@0.5"])


def _means(rows: list[tuple[float, float, float]]) -> str:
    planes, voi, f1 = np.mean(rows, axis=0)
    return f"{planes:.0f}, {voi:.2f}, {f1:.2f}"


def _rooms(count: int) -> None:
    made = [scenes.room(seed) for seed in range(count)]
    rng = np.random.default_rng(0)
    print("| | points | planes, VOI, F1@.5: given | estimated | as images |\n|---|---|---|---|---|")
    for every, share, name in (
        (1, 1.0, "every pixel"),
        (1, 0.67, "two thirds of them"),
        (2, 1.0, "every second row and column"),
        (2, 0.67, "two thirds of them"),
        (4, 1.0, "every fourth"),
    ):
        clouds = []
        for scene in made:
            points, labels = cloud_of(scene, every)
            kept = rng.random(len(points)) < share
            clouds.append((points[kept].astype(np.float32), labels[kept]))
        cells = [name, f"{np.mean([len(points) for points, _ in clouds]):,.0f}"]
        for sensor, as_image in ((TOLD, False), (SENSOR, False), (SENSOR, True)):
            rows = [
                scored(pw.detect_planes_in_points(points, sensor, as_image=as_image), labels)
                for points, labels in clouds
            ]
            cells.append(_means(rows))
        print(f"| {' | '.join(cells)} |", flush=True)


def _scans() -> None:
    head = "| | points | planes and share on them: given | estimated | as images |"
    print(f"\n{head}\n|---|---|---|---|---|")
    for name, points, given in unlabelled():
        found = pw.detect_planes_in_points(points, SENSOR)
        if "image" not in found.settings:
            continue
        models = (
            pw.detect_planes_in_points(points, given),
            pw.detect_planes_in_points(points, SENSOR, as_image=False),
            found,
        )
        cells = [f"{len(each)}, {np.mean(each.labels > 0):.2f}" for each in models]
        print(f"| {name} | {len(points):,} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=8)
    _rooms(parser.parse_args().rooms)
    _scans()


if __name__ == "__main__":
    main()
