"""Labelled frames, enlarged: prints a Markdown table.

python -m benchmarks.enlarged

Pixels are repeated, or interpolated linearly as by OpenCV (missing readings are zeros), in metres
or rounded to integers. Means over frames of VOI, F1 at an IoU of 0.5 and of 0.8, and planes found:
searched as they are, and at the own size that `planewise.enlarged` finds. Scored on own pixels;
those beside a jump of depth, which are mixed with what lies behind it, are not.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from itertools import islice
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.frames import DATA
from benchmarks.labelled import LabelledFrame, frames_of
from benchmarks.other_sensors import enlarged
from benchmarks.rival_points import metres
from planewise.metrics import evaluate

Image = NDArray[Any]
Array = NDArray[np.float64]

_SETS = "nyu_dpd", "mosd_boxes", "abw_segcomp", "rooms"
_FRAMES = 12
_JUMP = 0.03  # of the depth, between pixels side by side
_SCORES = "voi_labelled", "f1@0.5", "f1@0.8", "planes_predicted"


def repeated(depth: Array, shape: tuple[int, int]) -> Image:
    """Every pixel of the enlarged image is the nearest own one."""
    rows, columns = (np.arange(n) * k // n for k, n in zip(depth.shape, shape, strict=True))
    return depth[np.ix_(rows, columns)]


def rounded(depth: Array, shape: tuple[int, int]) -> Image:
    """Interpolated, in integer millimetres."""
    return np.rint(1000 * enlarged(depth, shape)).astype(np.uint16)


WAYS: dict[str, tuple[Callable[[Array, tuple[int, int]], Image], float]] = {
    "as it was": (lambda depth, _: depth, 1.0),
    "repeated twice": (repeated, 2.0),
    "interpolated, 1.2 times": (enlarged, 1.2),
    "1.5 times": (enlarged, 1.5),
    "twice": (enlarged, 2.0),
    "twice, rounded": (rounded, 2.0),
    "three times": (enlarged, 3.0),
}


def scored(labelled: LabelledFrame, way: str) -> list[float]:
    """Scores of a frame that was enlarged in one way."""
    read, times = WAYS[way]
    frame, camera = labelled.frame, labelled.frame.camera
    assert isinstance(camera, pw.PinholeCamera)
    own = np.nan_to_num(metres(frame))
    height, width = own.shape
    shape = round(times * height), round(times * width)
    y, x = shape[0] / height, shape[1] / width
    large = pw.PinholeCamera(
        fx=x * camera.fx,
        fy=y * camera.fy,
        cx=x * (camera.cx + 0.5) - 0.5,
        cy=y * (camera.cy + 0.5) - 0.5,
    )
    depth = read(own, shape)
    scale = 0.001 if depth.dtype.kind == "u" else None
    model = pw.detect_planes(
        depth, large, frame.sensor, depth_scale=scale, instances=labelled.per_surface
    )
    rows, columns = (
        np.rint((np.arange(k) + 0.5) * n / k - 0.5).astype(int)
        for k, n in zip(own.shape, shape, strict=True)
    )
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(own, 1, mode="edge"), (3, 3))
    jump = np.ptp(windows, axis=(2, 3)) > _JUMP * own
    truth = np.where(jump, 0, labelled.truth)
    scores = evaluate(model.labels[np.ix_(rows, columns)], truth).row()
    return [float(scores[name]) for name in _SCORES]


def as_it_is() -> AbstractContextManager[object]:
    """Inside the block no image is searched at its own size."""
    return patch("planewise.detect.own_pixels", lambda *_: None)


def cell(frames: list[LabelledFrame], way: str) -> str:
    """Means over frames, as a cell of the table."""
    voi, half, most, planes = np.nanmean([scored(each, way) for each in frames], axis=0)
    return f"{voi:.3f} {half:.3f} {most:.3f} {planes:.1f}"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--data", default=DATA)
    given = parser.parse_args()
    print("| frames | enlarged | searched as they are | at their own size |\n|---|---|---|---|")
    for name in _SETS:
        frames = list(islice(frames_of(name, given.data, quick=False), _FRAMES))
        for way in WAYS:
            with as_it_is():
                before = cell(frames, way)
            print(f"| {name} | {way} | {before} | {cell(frames, way)} |", flush=True)


if __name__ == "__main__":
    main()
