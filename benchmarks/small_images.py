"""Labelled frames as small images: prints a Markdown table.

python -m benchmarks.small_images

Of every frame every second, third or fourth row and column. Means over frames of VOI, F1 at an IoU
of 0.5 and of 0.8, and planes found: with cells, borders and planes worth what they are in fine
images; with cells and borders worth what they are in images of few pixels
(`planewise.spatial.merging`); and with planes, too, that end at breaks
(`planewise.spatial.search`). Last, in how many frames Phi is lower and in how many higher for that.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.frames import DATA
from benchmarks.labelled import LabelledFrame, frames_of
from planewise.metrics import evaluate
from planewise.metrics.scores import MINIMUM_PIXELS
from planewise.spatial import curvature, merging

Array = NDArray[np.float64]

_SETS = "nyu_dpd", "mosd_boxes", "abw_segcomp", "rooms", "room_faces"
_EVERY = 2, 3, 4
_SCORES = "voi_labelled", "f1@0.5", "f1@0.8", "planes_predicted"


@contextmanager
def nothing_ends() -> Iterator[None]:
    """Inside the block planes cost what they do in fine images: nothing ends at breaks."""
    with patch.object(curvature, "_NEAR", -1.0):
        yield


@contextmanager
def as_fine() -> Iterator[None]:
    """Inside the block so do cells and borders."""
    with nothing_ends(), patch.object(merging, "_fineness", lambda _: 1.0):
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


def scored(frames: list[LabelledFrame], every: int) -> tuple[str, Array]:
    """Means over frames, as a cell of the table, and Phi of each."""
    rows, phi = [], []
    for each in frames:
        model = each.frame.detect(instances=each.per_surface)
        scores = evaluate(model.labels, each.truth, minimum_pixels=MINIMUM_PIXELS // every**2).row()
        rows.append([float(scores[name]) for name in _SCORES])
        phi.append(model.information)
    voi, half, most, planes = np.nanmean(rows, axis=0)
    return f"{voi:.3f} {half:.3f} {most:.3f} {planes:.1f}", np.array(phi)


def main() -> None:
    parser_of(__doc__).parse_args()
    print(
        "| frames | every | VOI, F1@.5, F1@.8, planes: as in fine images | cells and borders "
        "| planes, too | Phi lower, higher |"
    )
    print("|---|---|---|---|---|---|")
    for name in _SETS:
        frames = list(frames_of(name, DATA))
        for every in _EVERY:
            some = [small(each, every) for each in frames]
            with as_fine():
                fine, _ = scored(some, every)
            with nothing_ends():
                without, before = scored(some, every)
            as_they_are, phi = scored(some, every)
            changes = f"{np.count_nonzero(phi < before)}, {np.count_nonzero(phi > before)}"
            cells = " | ".join((name, str(every), fine, without, as_they_are, changes))
            print(f"| {cells} |", flush=True)


if __name__ == "__main__":
    main()
