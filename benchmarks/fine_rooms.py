"""Synthetic rooms in finer images, every flat face counted: prints a Markdown table.

python -m benchmarks.fine_rooms [--rooms N]

Means over rooms as a Kinect reads them: planes found, precision and recall at an IoU of 0.5, F1 at
0.8, and VOI; faces of fewer pixels than 400 of 640 x 480 are neither hit nor miss. First without
looking at segments that bend (`planewise.spatial.splitting`) nor at planes that are two faces
(`planewise.spatial.faces`), then with the first, then with both.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.flat_edges import unsplit
from planewise.metrics import evaluate
from planewise.metrics.scores import MINIMUM_PIXELS
from planewise.spatial import labels
from planewise.spatial.frame import Frame

Array = NDArray[np.float64]

_SIZES = (640, 480), (1280, 720), (1920, 1080)
_FIRST = 200  # seed of the first room
_SCORES = "planes_predicted", "precision@0.5", "recall@0.5", "f1@0.8", "voi_labelled"


@contextmanager
def unparted() -> Iterator[None]:
    """Inside the block planes that are two faces stay one."""

    def unchanged(_frame: Frame, _white: float, rows: Array, *_: object) -> tuple[Array, ...]:
        return rows, np.empty(0), np.empty(0, np.int32)

    with patch.object(labels, "parted", unchanged):
        yield


def scored(size: tuple[int, int], seed: int) -> Array:
    """Scores of a room, shape (3, 5): without, with the one and with both."""
    width, height = size
    scene = pw.scenes.room(seed, size=(height, width), every_face=True)
    least = MINIMUM_PIXELS * width * height // (640 * 480)
    rows = []
    for without in ((unsplit, unparted), (unparted,), ()):
        with ExitStack() as ways:
            for each in without:
                ways.enter_context(each())
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
            cells = " | ".join(", ".join(f"{each:.3f}" for each in ways) for ways in means.T)
            print(f"| {size[0]} x {size[1]} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
