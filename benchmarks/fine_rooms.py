"""Synthetic rooms in finer images, every flat face counted: prints a Markdown table.

python -m benchmarks.fine_rooms [--rooms N]

Means over rooms as a Kinect reads them: planes found, precision and recall at an IoU of 0.5, F1 at
0.8, and VOI; faces of fewer pixels than 400 of 640 x 480 are neither hit nor miss. First without
looking at segments that bend (`planewise.spatial.splitting`), then with it.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.flat_edges import unsplit
from planewise.metrics import evaluate
from planewise.metrics.scores import MINIMUM_PIXELS

_SIZES = (640, 480), (1280, 720), (1920, 1080)
_FIRST = 200  # seed of the first room
_SCORES = "planes_predicted", "precision@0.5", "recall@0.5", "f1@0.8", "voi_labelled"


def scored(size: tuple[int, int], seed: int) -> NDArray[np.float64]:
    """Scores of a room, shape (2, 5): without and with."""
    width, height = size
    scene = pw.scenes.room(seed, size=(height, width), every_face=True)
    least = MINIMUM_PIXELS * width * height // (640 * 480)
    rows = []
    for way in (unsplit(), nullcontext()):
        with way:
            model = pw.detect_planes(scene.depth, scene.camera, scene.sensor, threads=1)
        row = evaluate(model.labels, scene.labels, minimum_pixels=least).row()
        rows.append([row[name] for name in _SCORES])
    return np.array(rows)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=16)
    rooms = parser.parse_args().rooms
    print("| size | planes | P@.5 | R@.5 | F1@.8 | VOI |\n|---|---|---|---|---|---|")
    with ProcessPoolExecutor() as workers:
        for size in _SIZES:
            seeds = range(_FIRST, _FIRST + rooms)
            means = np.mean(list(workers.map(scored, [size] * rooms, seeds)), axis=0)
            cells = " | ".join(f"{without:.3f}, {parted:.3f}" for without, parted in means.T)
            print(f"| {size[0]} x {size[1]} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
