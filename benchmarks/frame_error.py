"""What frames tell of their own error: prints a Markdown table.

python -m benchmarks.frame_error [--data FOLDER] [--every]

Medians over the frames of a set, or every frame. The sensor is taken without the parts of its
description, so that the frame alone says their size. white, near, bent: factors on the variances;
lateral in pixels^2; drift: how far inverse depth wanders over 100 pixels, in 0.001 / m; then the
same from three cells in a row that many pixels apart alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.frames import DATA, Frame, real, rooms
from benchmarks.simulated import DRIFT, kinect_room
from planewise.kernels.cells import SIDE
from planewise.kernels.walk import SATURATION
from planewise.spatial import cells, neighbouring
from planewise.spatial.frame import frame_of

LAGS = (1, 2, 4, 8)  # cells of 6 pixels


def frames(data: Path) -> Iterator[Frame]:
    """Synthetic ones of known error, and real ones where they are at hand."""
    yield from rooms(5)
    for part in (0.5, 1.0, 2.0):
        for seed in range(5):
            frame, _ = kinect_room(seed, drift=part * DRIFT)
            yield replace(frame, name=f"room, drift {part * DRIFT:g}/{seed}")
    yield from real(data)


def told(frame: Frame) -> list[float] | None:
    """White, lateral, drift, drift by lag, near and bent; None without cells."""
    sensor = replace(frame.sensor, parts=None)
    seen = pw.observe(frame.depth, frame.camera, sensor, depth_scale=frame.depth_scale)
    image = frame_of(seen)
    found = cells.cells_of(image, seen.pixel_size)
    if found is None:
        return None
    described = image.table.at(float(np.median(image.w[image.p > 0])))[2] / SATURATION
    by_lag = []
    for lag in LAGS:
        nearest = partial(neighbouring.drift_factor, lag=lag)
        with patch.object(cells, "drift_factor", nearest), patch.object(neighbouring, "_LAGS", ()):
            one = cells.cells_of(image, seen.pixel_size)
        assert one is not None
        by_lag.append(1e3 * float(np.sqrt(one.error.local * described)))
    error = found.error
    drift = 1e3 * float(np.sqrt(error.drift * described))
    return [error.white, error.lateral, drift, *by_lag, error.near, error.bent]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--every", action="store_true", help="a row a frame")
    given = parser.parse_args()
    lags = " | ".join(f"{SIDE * 2 * lag} px" for lag in LAGS)
    print(f"| frames | n | white | lateral | drift | {lags} | near | bent |")
    print(f"|{'---|' * (7 + len(LAGS))}")
    sets: dict[str, list[list[float]]] = {}
    for frame in frames(given.data):
        values = told(frame)
        if values is not None:
            kind, _, name = frame.name.rpartition("/")
            kind = "RealSense" if name.startswith(("rs_", "uoc_")) else kind
            sets.setdefault(frame.name if given.every else kind, []).append(values)
    for name, rows in sets.items():
        middle = " | ".join(f"{value:.2f}" for value in np.median(rows, axis=0))
        print(f"| {name} | {len(rows)} | {middle} |")


if __name__ == "__main__":
    main()
