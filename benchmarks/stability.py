"""How stable planes are from frame to frame: prints a Markdown table.

python -m benchmarks.stability [--rooms N] [--frames N] [--step METRES]

A stream is a synthetic room, read anew in every frame by a camera that stands still or moves
sideways. Every frame is detected on its own. A plane is there again if one of the next frame
overlaps with it by more than half: the share of those that are, by size in pixels; then the median
angle in degrees between the normals of both, and the standard deviation of the number of planes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.arguments import parser_of
from benchmarks.frames import Frame
from benchmarks.other_sensors import Exact, Reading, camera_of, named
from benchmarks.rivals import DEFAULT, OPENCV, PAPER, Method
from planewise.metrics.contingency import contingency_table
from planewise.scenes.rooms import _arrange, cast

Array = NDArray[np.float64]
Labels = NDArray[np.integer]

FIRST = 300  # seed of the first room
SENSORS = (
    "Kinect",
    "Kinect, error that wanders",
    "stereo, smooth over 8 px",
    "time of flight",
    "2 mm",
)
SIZES = (400, 1_000, 3_000, 10_000)  # pixels from which a plane belongs to the next class


def stream(reading: Reading, seed: int, count: int, step: float) -> Iterator[tuple[Frame, Array]]:
    """Frames of a camera that moves so many metres to its right each time, and exact depth."""
    camera = camera_of(reading.size)
    solids, view = _arrange(np.random.default_rng(seed))
    nothing = np.zeros(reading.size, np.uint16)  # no reading depends on labels
    for k in range(count):
        moved = replace(view, position=view.position + k * step * view.rotation[:, 0])
        hit = cast(solids, moved, camera, reading.size)
        rng = np.random.default_rng([seed, k, *reading.name.encode()])
        z = reading.read(Exact(hit.depth, nothing, nothing, rng))
        z[z > reading.sensor.max_depth] = 0
        depth = np.round(z / reading.sensor.resolution).astype(np.uint16)
        yield Frame(f"room/{seed}/{k}", depth, camera, reading.sensor), hit.depth


def normals(labels: Labels, z: Array, frame: Frame) -> Array:
    """Unit normals of least squares through the exact points of every label, shape (N, 3).

    So planes of any method are compared, whether it fits them or not: by where their pixels are.
    """
    points = frame.camera.rays(frame.depth.shape) * z[..., None]
    out = np.empty((labels.max(initial=0), 3))
    for n in range(len(out)):
        mine = points[labels == n + 1]
        out[n] = np.linalg.svd(mine[::7] - mine.mean(axis=0), full_matrices=False)[2][2]
    return out


def again(
    first: tuple[Labels, Array], second: tuple[Labels, Array]
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Sizes of the planes of a frame, which the next one has, and angles between these."""
    table = contingency_table(second[0], first[0])
    overlap = table.overlaps()
    kept = overlap.max(axis=1, initial=0.0) > 0.5
    partner = overlap[kept].argmax(axis=1)
    ours, theirs = (
        each[1][which[1:][chosen] - 1]
        for each, which, chosen in (
            (first, table.truth_labels, kept),
            (second, table.predicted_labels, partner),
        )
    )
    cosine = np.abs((ours * theirs).sum(axis=1)).clip(max=1)
    return table.truth_sizes[1:].astype(float), kept, np.degrees(np.arccos(cosine))


def measured(method: Method, reading: Reading, rooms: int, count: int, step: float) -> list[str]:
    """Cells of a row."""
    sizes: list[Array] = []
    kept: list[NDArray[np.bool_]] = []
    angles: list[Array] = []
    spread = []
    for seed in range(FIRST, FIRST + rooms):
        before: tuple[Labels, Array] | None = None
        numbers = []
        for frame, z in stream(reading, seed, count, step):
            ready = method.prepare(frame, False)
            labels = ready.labels(ready.detect())
            now = labels, normals(labels, z, frame)
            numbers.append(len(now[1]))
            if before is not None:
                size, there, angle = again(before, now)
                sizes.append(size)
                kept.append(there)
                angles.append(angle)
            before = now
        spread.append(np.std(numbers))
    pixels, found, turned = np.concatenate(sizes), np.concatenate(kept), np.concatenate(angles)
    cells = []
    for low, high in zip(SIZES, (*SIZES[1:], np.inf), strict=True):
        some = (pixels >= low) & (pixels < high)
        cells.append(f"{found[some].mean():.2f} ({some.sum()})" if some.any() else "")
    return [*cells, f"{np.median(turned):.2f}" if turned.size else "", f"{np.mean(spread):.1f}"]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=6)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--step", type=float, default=0.0, help="metres that the camera moves")
    given = parser.parse_args()
    classes = [f"{low:,} px" for low in SIZES]
    print(f"| readings | method | {' | '.join(classes)} | angle | planes +- |")
    print(f"|---|---|{'---:|' * (len(SIZES) + 2)}")
    for name in SENSORS:
        for method in (DEFAULT, PAPER, OPENCV):
            if method.missing():
                continue
            cells = measured(method, named(name), given.rooms, given.frames, given.step)
            print(f"| {' | '.join((name, method.name, *cells))} |", flush=True)


if __name__ == "__main__":
    main()
