"""Synthetic Kinect images searched as clouds of points: prints a Markdown table of means.

python -m benchmarks.depth_clouds [--rooms 8]

Points in the frame of the camera, of every pixel, or of every second or fourth row and column.
Their noise is told (white noise and rounding), or estimated; below, the same rooms as images.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
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


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=8)
    made = [scenes.room(seed) for seed in range(parser.parse_args().rooms)]
    print("| | points | planes, VOI, F1@.5: told | auto |\n|---|---|---|---|")
    for every in (1, 2, 4):
        clouds = [cloud_of(scene, every) for scene in made]
        cells = [f"every {every}", f"{np.mean([len(points) for points, _ in clouds]):,.0f}"]
        for sensor in (TOLD, SENSOR):
            rows = [
                scored(pw.detect_planes_in_points(points, sensor), labels)
                for points, labels in clouds
            ]
            cells.append(_means(rows))
        print(f"| {' | '.join(cells)} |", flush=True)
    rows = [
        scored(pw.detect_planes(each.depth, each.camera, each.sensor), each.labels) for each in made
    ]
    readings = np.mean([np.count_nonzero(each.depth) for each in made])
    print(f"| as images | {readings:,.0f} | {_means(rows)} | |")


if __name__ == "__main__":
    main()
