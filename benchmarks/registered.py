"""Synthetic rooms whose depth was registered to a larger picture: prints a Markdown table.

python -m benchmarks.registered [--rooms N]

Every reading is moved to the pixel of a camera beside the sensor, turned by 0.7 degrees and with so
many times as many rows and columns, that sees it; the nearest stays, and nothing is filled in. VOI,
share of what is found that is a flat face, share of true planes of 0.25 % of the readings found,
and planes: as the image is, and in coarser pixels (`planewise.scattered`).
"""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.enlarged import as_it_is
from benchmarks.other_sensors import FIRST, READINGS, SMALLEST, Reading, camera_of, frame
from planewise.metrics import evaluate

Array = NDArray[np.float64]
Grid = NDArray[np.integer]

_TURN = np.radians(0.7)
_AXES = np.array([[np.cos(_TURN), -np.sin(_TURN), 0], [np.sin(_TURN), np.cos(_TURN), 0], [0, 0, 1]])
_MOVED = np.array([0.05, 0.002, 0.001])
_NAMES = (
    "Kinect",
    "Kinect, 320 x 240",
    "stereo, smooth over 8 px",
    "time of flight",
    "phone, 256 x 192",
)
_TIMES = 1.5, 1.83, 2.0, 2.5, 4.0


def registered(
    z: Array,
    camera: pw.PinholeCamera,
    larger: pw.PinholeCamera,
    shape: tuple[int, int],
    *marks: Grid,
) -> tuple[Array, list[Grid]]:
    """Depth in metres and marks of pixels, moved to those of a larger picture of this shape."""
    there = z > 0
    rays = camera.rays((z.shape[0], z.shape[1]))
    points = (rays[there] * z[there][:, None]) @ _AXES.T + _MOVED
    column, row = np.rint(larger.project(points)).astype(int).T
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    order = np.argsort(-points[:, 2], kind="stable")  # what is nearest stays
    order = order[inside[order]]
    where = row[order], column[order]
    image, moved = np.zeros(shape), [np.zeros(shape, int) for _ in marks]
    image[where] = points[order, 2]
    for out, each in zip(moved, marks, strict=True):
        out[where] = each[there][order]
    return image, moved


def scored(reading: Reading, times: float, seed: int) -> list[float]:
    """VOI, P, R and planes of a room."""
    depth, *marks = frame(reading, seed)
    z = depth * (reading.sensor.resolution if depth.dtype.kind == "u" else 1.0)
    shape = int(times * reading.size[0]), int(times * reading.size[1])
    larger = camera_of(shape)
    image, (labels, faces) = registered(z, camera_of(reading.size), larger, shape, *marks)
    model = pw.detect_planes(image, larger, reading.sensor)
    fewest = int(SMALLEST * np.prod(reading.size))
    row = evaluate(model.labels, labels, minimum_pixels=fewest).row()
    precision = evaluate(model.labels, faces).row()["precision@0.5"]
    return [row["voi_labelled"], precision, row["recall@0.5"], len(model)]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=6)
    given = parser.parse_args()
    print(
        "| readings | times | as it is: VOI, P, R, planes | in coarser pixels |\n|---|---|---|---|"
    )
    for reading in (each for each in READINGS if each.name in _NAMES):
        for times in _TIMES:
            cells = []
            for how in (as_it_is, nullcontext):
                with how():
                    seeds = range(FIRST, FIRST + given.rooms)
                    rows = [scored(reading, times, seed) for seed in seeds]
                voi, precision, recall, planes = np.nanmean(rows, axis=0)
                cells.append(f"{voi:.2f} {precision:.2f} {recall:.2f} {planes:.1f}")
            print(f"| {reading.name} | {times} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
