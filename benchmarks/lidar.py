"""Planes of simulated streets by LiDAR: found, wrong, and how near to the truth.

python -m benchmarks.lidar
"""

from __future__ import annotations

import time

import numpy as np

import planewise as pw
from planewise import cameras
from planewise.metrics import evaluate

_STREETS = 10
_LIDAR = (
    "ouster-os0-128",
    "ouster-os1-128",
    "velodyne-vls128",
    "ouster-os1-64",
    "velodyne-hdl64e",
    "ouster-os1-32",
    "velodyne-hdl32e",
    "velodyne-vlp16",
)


def row(name: str) -> tuple[str, ...]:
    """One line of the table: means over streets, times against that of a 640 x 480 room."""
    camera = cameras.PRESETS[name]
    assert isinstance(camera, pw.SphericalCamera)
    numbers, ratios = [], []
    room = pw.scenes.room(0)
    sensor = pw.scenes.street(0, camera=camera).sensor
    detectors = pw.Detector(room.camera, room.sensor), pw.Detector(camera, sensor)
    for seed in range(_STREETS):
        street = pw.scenes.street(seed, camera=camera)
        model = pw.detect_planes(street.depth, camera, street.sensor)
        truth = evaluate(
            model.labels,
            street.labels,
            predicted_planes=model.coefficients,
            truth_planes=street.planes,
            minimum_pixels=0,
        )
        found, errors = truth.detections[0], truth.errors
        assert errors is not None
        numbers.append(
            (
                len(street.planes),
                len(model),
                found.precision,
                found.recall,
                truth.frame.variation_of_information,
                errors.mean_normal,
                1000 * errors.mean_distance,
            )
        )
        took = []
        for detector, depth in zip(detectors, (room.depth, street.depth), strict=True):
            times = []
            for _ in range(5):
                start = time.perf_counter()
                detector(depth)
                times.append(time.perf_counter() - start)
            took.append(min(times))
        ratios.append(took[1] / took[0])
    height, width = camera.shape
    true, planes, precision, recall, voi, normal, distance = np.mean(numbers, axis=0)
    return (
        name,
        f"{height} x {width}",
        *(f"{value:.1f}" for value in (true, planes)),
        *(f"{value:.2f}" for value in (precision, recall, voi, normal)),
        f"{distance:.0f}",
        f"{np.median(ratios):.1f}",
    )


def main() -> None:
    """Print the table of the documentation."""
    print("| LiDAR | pixels | true | planes | P@.5 | R@.5 | VOI | deg | mm | time |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in _LIDAR:
        print("| " + " | ".join(row(name)) + " |", flush=True)


if __name__ == "__main__":
    main()
