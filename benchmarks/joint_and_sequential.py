"""Phi of the joint search against the paper's, frame by frame: prints a Markdown table.

python -m benchmarks.joint_and_sequential [--data FOLDER] [--rooms 20]
        [--seeds 1] [--proportional 0.01]
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import chain
from pathlib import Path

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.frames import DATA, Frame, real, rooms

_ROUNDING = 1e-9  # of Phi: where both end at the same planes, the last digits may differ


def table(frames: Iterable[Frame], seeds: int) -> None:
    """Print one row a frame and a summary."""
    print("| frame | Phi joint | planes | Phi sequential | planes | joint lower by |")
    print("|---|---|---|---|---|---|")
    count = worse = 0
    for frame in frames:
        joint = frame.detect(search="joint", objective="paper")
        sequential = min(
            (frame.detect(search="sequential", rng=seed) for seed in range(seeds)),
            key=lambda model: model.information,
        )
        saved = sequential.information - joint.information
        if abs(saved) < _ROUNDING * sequential.information:
            saved = 0.0
        count += 1
        worse += saved < 0
        print(
            f"| {frame.name} | {joint.information:.0f} | {len(joint)} | "
            f"{sequential.information:.0f} | {len(sequential)} | "
            f"{100 * saved / sequential.information:.2f} % |",
            flush=True,
        )
    print(f"\n{count} frames, joint above sequential on {worse}.")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--rooms", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--proportional", type=float, help="sigma = this z on every frame")
    options = parser.parse_args()
    frames: Iterable[Frame] = chain(rooms(options.rooms), real(options.data))
    if options.proportional:
        noise = pw.noise.proportional(options.proportional)
        frames = (replace(f, sensor=replace(f.sensor, noise=noise)) for f in frames)
    table(frames, options.seeds)


if __name__ == "__main__":
    main()
