"""Synthetic rooms whose depth was registered to a larger picture: prints a Markdown table.

python -m benchmarks.registered [--rooms N]

Every reading is moved to the pixel of a camera beside the sensor, turned by 0.7 degrees and with so
many times as many rows and columns, that sees it; the nearest stays, and nothing is filled in. VOI,
share of what is found that is a flat face, share of true planes of 0.25 % of the readings found,
and planes: as the image is, and in coarser pixels (`planewise.scattered`).
"""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.other_sensors import FIRST, READINGS, SMALLEST, Reading, camera_of, frame
from planewise.enlarged import own_pixels
from planewise.metrics import evaluate

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
    depth: NDArray[Any], marks: tuple[Grid, ...], reading: Reading, times: float
) -> tuple[NDArray[np.float64], list[Grid], pw.PinholeCamera]:
    """Depth in metres, marks of pixels, and the camera of the larger picture."""
    own = reading.size
    shape = int(times * own[0]), int(times * own[1])
    camera, there = camera_of(shape), depth > 0
    z = depth[there] * (reading.sensor.resolution if depth.dtype.kind == "u" else 1.0)
    points = (camera_of(own).rays(own)[there] * z[:, None]) @ _AXES.T + _MOVED
    column, row = np.rint(camera.project(points)).astype(int).T
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    order = np.argsort(-points[:, 2], kind="stable")
    order = order[inside[order]]
    where = row[order], column[order]
    image, moved = np.zeros(shape), [np.zeros(shape, int) for _ in marks]
    image[where] = points[order, 2]
    for out, each in zip(moved, marks, strict=True):
        out[where] = each[there][order]
    return image, moved, camera


def scored(reading: Reading, times: float, seed: int) -> list[float]:
    """VOI, P, R and planes of a room."""
    depth, *marks = frame(reading, seed)
    image, (labels, faces), camera = registered(depth, tuple(marks), reading, times)
    model = pw.detect_planes(image, camera, reading.sensor)
    fewest = int(SMALLEST * np.prod(reading.size))
    row = evaluate(model.labels, labels, minimum_pixels=fewest).row()
    precision = evaluate(model.labels, faces).row()["precision@0.5"]
    return [row["voi_labelled"], precision, row["recall@0.5"], len(model)]


def as_it_is(_: object, __: object) -> None:
    """In place of `own_pixels`: none are looked for."""


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
            for found in (as_it_is, own_pixels):
                with patch("planewise.detect.own_pixels", found):
                    seeds = range(FIRST, FIRST + given.rooms)
                    rows = [scored(reading, times, seed) for seed in seeds]
                voi, precision, recall, planes = np.nanmean(rows, axis=0)
                cells.append(f"{voi:.2f} {precision:.2f} {recall:.2f} {planes:.1f}")
            print(f"| {reading.name} | {times} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
