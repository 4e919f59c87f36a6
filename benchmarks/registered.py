"""Synthetic rooms whose depth was registered to a larger picture: prints a Markdown table.

python -m benchmarks.registered [--rooms N] [--blocks]

Every reading is moved to the pixel of a camera beside the sensor, turned by 0.7 degrees and with so
many times as many rows and columns, that sees it, and nothing is filled in; or with `--blocks` to
all pixels that its own covers. The nearest stays. VOI, share of what is found that is a flat face,
share of true planes of 0.25 % of the readings found, and planes: as the image is, and in coarser
pixels (`planewise.enlarged.scattered`, `planewise.enlarged.filled`).
"""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.enlarged import as_it_is
from benchmarks.other_sensors import FIRST, READINGS, SMALLEST, Reading, camera_of, frame_in_metres
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
    "stereo, smooth over 20 px",
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
    blocks: bool = False,
) -> tuple[Array, list[Grid]]:
    """Depth in metres and marks of pixels, moved to those of a larger picture of this shape.

    blocks: to all pixels that a pixel covers, from the one where its first corner is seen to that
    of its last.
    """
    row, column = (z > 0).nonzero()
    depth, half = z[row, column], 0.5 if blocks else 0.0

    def seen(off: float) -> tuple[Array, Grid]:
        rays = camera.unproject(np.stack((column + off, row + off), axis=-1))
        points = (rays * depth[:, None]) @ _AXES.T + _MOVED
        return points[:, 2], np.floor(larger.project(points) + 0.5).astype(int)

    moved, (_, first), (_, last) = seen(0.0)[0], seen(-half), seen(half)
    whole = ((first >= 0) & (last < shape[::-1])).all(axis=1)
    sides = (1 + last - first)[whole].max(axis=0).tolist()
    which, places = [], []
    for off in map(np.array, np.ndindex(*sides)):
        which.append(np.flatnonzero(whole & (first + off <= last).all(axis=1)))
        places.append(first[which[-1]] + off)
    readings, (x, y) = np.concatenate(which), np.concatenate(places).T
    order = np.argsort(-moved[readings], kind="stable")  # what is nearest stays
    readings, at = readings[order], (y[order], x[order])
    images = np.zeros((1 + len(marks), *shape))
    for image, values in zip(images, (moved, *(m[row, column] for m in marks)), strict=True):
        image[at] = values[readings]
    return images[0], list(images[1:].astype(int))


def scored(reading: Reading, times: float, seed: int, blocks: bool) -> list[float]:
    """VOI, P, R and planes of a room."""
    z, *marks = frame_in_metres(reading, seed)
    shape = int(times * reading.size[0]), int(times * reading.size[1])
    larger = camera_of(shape)
    own = camera_of(reading.size)
    image, (labels, faces) = registered(z, own, larger, shape, *marks, blocks=blocks)
    model = pw.detect_planes(image, larger, reading.sensor)
    fewest = int(SMALLEST * np.prod(shape if blocks else reading.size))
    row = evaluate(model.labels, labels, minimum_pixels=fewest).row()
    precision = evaluate(model.labels, faces).row()["precision@0.5"]
    return [row["voi_labelled"], precision, row["recall@0.5"], len(model)]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=6)
    parser.add_argument("--blocks", action="store_true")
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
                    rows = [scored(reading, times, seed, given.blocks) for seed in seeds]
                voi, precision, recall, planes = np.nanmean(rows, axis=0)
                cells.append(f"{voi:.2f} {precision:.2f} {recall:.2f} {planes:.1f}")
            print(f"| {reading.name} | {times} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
