"""What a partition does to the searches, on labelled frames with colour: prints Markdown tables.

python -m benchmarks.partition [--data FOLDER] [--frames 35]

Regions are made once for each frame and handed over as labels, so that times are those of the
searches. "whole" is the frame as one region: what going on with the search does by itself. Scale
and weights of the graph were chosen on one half of the frames (`benchmarks.labelled`): the halves
are told apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.frames import DATA, Frame, frame_of
from benchmarks.labelled import CHOOSE
from planewise.metrics import evaluate
from planewise.observation import RayObservation
from planewise.partition import Blocks, Graph, Partitioner, regions_of
from planewise.partition.partitioner import view_of

Regions = NDArray[np.integer]
Rows = dict[tuple[str, str], list[tuple[float, ...]]]

_COLUMNS = ("voi_labelled", "sc_labelled", "voi_k_best", "sc_k_best", "f1@0.5", "planes_predicted")
_SEARCHES: dict[str, dict[str, object]] = {
    "sequential": {"search": "sequential"},
    "joint, paper": {"objective": "paper"},
    "joint, spatial": {"objective": "spatial"},
}
_MADE: dict[str, Callable[[], Partitioner]] = {"blocks": Blocks, "graph": Graph}


def frames(folder: Path, most: int) -> Iterator[tuple[Frame, NDArray[Any], NDArray[Any]]]:
    """Labelled frames, their pictures and truth."""
    for path in sorted((folder / "nyu_dpd").glob("*.npz"))[:most]:
        with np.load(path) as arrays:
            yield frame_of(path, arrays), arrays["rgb"], arrays["gt"]


def measure(folder: Path, most: int) -> tuple[dict[str, Rows], dict[str, list[float]]]:
    """By half, search and partition: scores, percent by which Phi falls, and time, by frame."""
    halves: dict[str, Rows] = {"choose": {}, "report": {}}
    seconds: dict[str, list[float]] = {}
    for frame, rgb, truth in frames(folder, most):
        number = int(frame.name.rsplit("_", 1)[-1])
        rows = halves["choose" if number in CHOOSE["nyu_dpd"] else "report"]
        seen = pw.observe(frame.depth, frame.camera, frame.sensor, depth_scale=frame.depth_scale)
        assert isinstance(seen, RayObservation)
        regions: dict[str, Regions | None] = {
            "none": None,
            "whole": np.zeros(seen.shape, np.int32),
        }
        for kind, make in _MADE.items():
            started = time.perf_counter()
            regions[kind] = regions_of(make(), view_of(seen, rgb))
            seconds.setdefault(kind, []).append(time.perf_counter() - started)
        for search, options in _SEARCHES.items():
            base = None
            for kind, partition in regions.items():
                if search == "sequential" and kind == "whole":
                    continue
                started = time.perf_counter()
                model = frame.detect(partition=partition, **options)
                took = time.perf_counter() - started
                scores = evaluate(model.labels, truth).row()
                base = base or (model.information, took)
                fall = 100 * (base[0] - model.information) / base[0]
                values = (*(scores[column] for column in _COLUMNS), fall, took / base[1])
                rows.setdefault((search, kind), []).append(values)
        print(f"{frame.name} done", flush=True)
    return halves, seconds


def table(rows: Rows) -> None:
    """Print one row for each search and partition."""
    names = ("VOI", "SC", "VOI k best", "SC k best", "F1@.5", "planes")
    print(f"| search | partition | {' | '.join(names)} | Phi lower on | by (mean) | time ratio |")
    print("|---" * (len(names) + 5) + "|")
    for (search, kind), values in rows.items():
        data = np.array(values)
        means = " | ".join(f"{x:.3f}" for x in np.nanmean(data[:, :5], axis=0))
        fall, ratio = data[:, 6], np.median(data[:, 7])
        lower = f"{np.count_nonzero(fall > 0)} of {len(fall)}"
        if (fall < 0).any():
            lower += f", higher on {np.count_nonzero(fall < 0)}"
        print(
            f"| {search} | {kind} | {means} | {data[:, 5].mean():.1f} | {lower} | "
            f"{fall.mean():.2f} % | {ratio:.1f} |"
        )


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--frames", type=int, default=35)
    options = parser.parse_args()
    # The first calls compile.
    scene = pw.scenes.corner(size=(120, 160))
    for search in _SEARCHES.values():
        pw.detect_planes(
            scene.depth, scene.camera, scene.sensor, partition="blocks",
            **search,  # type: ignore[arg-type]
        )  # fmt: skip
    halves, seconds = measure(options.data, options.frames)
    if not seconds:
        raise SystemExit(f"there are no files {options.data / 'nyu_dpd'}/*.npz")
    for half, rows in halves.items():
        if rows:
            print(f"\n{half}, {len(next(iter(rows.values())))} frames:\n")
            table(rows)
    for kind, each in seconds.items():
        print(f"\n{kind}: regions take {1000 * np.median(each):.0f} ms a frame")


if __name__ == "__main__":
    main()
