"""Planes of simulated streets by LiDAR: found, wrong, and how near to the truth.

python -m benchmarks.lidar [--seams]

With --seams: one reading in how many has a wrong label, of those on planes that were found.
"""

from __future__ import annotations

import time

import numpy as np

import planewise as pw
from benchmarks.arguments import parser_of
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

_NEAR = 3  # columns


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


def seam_row(name: str) -> tuple[str, ...]:
    """One line of the table of seams: within three columns of one, and elsewhere."""
    camera = cameras.PRESETS[name]
    assert isinstance(camera, pw.SphericalCamera)
    sectors, width = camera.sectors(camera.shape), camera.shape[1]
    assert sectors.column is not None
    first = sectors.column[sectors.start]
    near = np.zeros(width, np.bool_)
    near[(first[:, None] + np.arange(-_NEAR, _NEAR)) % width] = True
    wrong, readings = np.zeros((2, 2))
    for seed in range(_STREETS):
        street = pw.scenes.street(seed, camera=camera)
        labels = pw.detect_planes(street.depth, camera, street.sensor).labels
        for j in np.flatnonzero(street.found(labels)) + 1:
            on = street.labels == j
            off = on & (labels != np.bincount(labels[on]).argmax())
            for where, columns in enumerate((near, ~near)):
                wrong[where] += np.count_nonzero(off[:, columns])
                readings[where] += np.count_nonzero(on[:, columns])
    return (name, *(f"{value:.0f}" for value in readings / np.maximum(wrong, 1)))


def main() -> None:
    """Print a table of the documentation."""
    parser = parser_of(__doc__)
    parser.add_argument("--seams", action="store_true")
    if parser.parse_args().seams:
        print("| LiDAR | near a seam, one in | elsewhere |")
        print("|---|---|---|")
        for name in _LIDAR:
            print("| " + " | ".join(seam_row(name)) + " |", flush=True)
        return
    print("| LiDAR | pixels | true | planes | P@.5 | R@.5 | VOI | deg | mm | time |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in _LIDAR:
        print("| " + " | ".join(row(name)) + " |", flush=True)


if __name__ == "__main__":
    main()
