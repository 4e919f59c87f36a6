"""Labelled frames as small images: prints a Markdown table.

python -m benchmarks.small_images

Of every frame every second, third or fourth row and column. Means over frames of VOI, F1 at an IoU
of 0.5 and of 0.8, and planes found: with cells and borders worth what they are in fine images, and
what they are in images of few pixels (`planewise.spatial.merging`).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from unittest.mock import patch

import numpy as np

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.frames import DATA
from benchmarks.labelled import LabelledFrame, frames_of
from planewise.metrics import evaluate
from planewise.metrics.scores import MINIMUM_PIXELS
from planewise.spatial import merging

_SETS = "nyu_dpd", "mosd_boxes", "abw_segcomp", "rooms"
_EVERY = 2, 3, 4
_SCORES = "voi_labelled", "f1@0.5", "f1@0.8", "planes_predicted"


@contextmanager
def as_fine() -> Iterator[None]:
    """Inside the block cells and borders are worth what they are in fine images."""
    with patch.object(merging, "_fineness", lambda _: 1.0):
        yield


def small(labelled: LabelledFrame, every: int) -> LabelledFrame:
    """Some rows and columns of a frame."""
    frame, some = labelled.frame, (slice(None, None, every),) * 2
    camera = frame.camera
    assert isinstance(camera, pw.PinholeCamera)
    own = pw.PinholeCamera(
        fx=camera.fx / every, fy=camera.fy / every, cx=camera.cx / every, cy=camera.cy / every
    )
    depth = np.ascontiguousarray(frame.depth[some])
    return replace(
        labelled, frame=replace(frame, depth=depth, camera=own), truth=labelled.truth[some]
    )


def row(frames: list[LabelledFrame], every: int) -> str:
    """Means over frames, as a cell of the table."""
    rows = []
    for each in frames:
        model = each.frame.detect(instances=each.per_surface)
        scores = evaluate(model.labels, each.truth, minimum_pixels=MINIMUM_PIXELS // every**2).row()
        rows.append([float(scores[name]) for name in _SCORES])
    voi, half, most, planes = np.nanmean(rows, axis=0)
    return f"{voi:.3f} {half:.3f} {most:.3f} {planes:.1f}"


def main() -> None:
    parser_of(__doc__).parse_args()
    print("| frames | every | VOI, F1@.5, F1@.8, planes: as in fine images | as they are |")
    print("|---|---|---|---|")
    for name in _SETS:
        frames = list(frames_of(name, DATA))
        for every in _EVERY:
            some = [small(each, every) for each in frames]
            with as_fine():
                before = row(some, every)
            print(f"| {name} | {every} | {before} | {row(some, every)} |", flush=True)


if __name__ == "__main__":
    main()
