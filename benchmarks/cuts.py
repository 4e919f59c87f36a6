"""How much lower Phi was before planes were cut: prints a Markdown table.

python -m benchmarks.cuts [--data FOLDER] [--rooms N]

Planes are cut by what their own readings save on them (docs/method.md, step 9). Phi takes readings
on none for one smooth surface in every block of 9 x 9 pixels: where there are two, as at an edge of
clutter, it falls if either has a label, whatever plane that names, and a cut raises it. Frames that
have it raised by more than 100 nats, the most nats, and the most as a share of all that is saved.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.arguments import parser_of
from benchmarks.frames import DATA, Frame, real, rooms

_MUCH = 100.0  # nats


def raised(frame: Frame) -> tuple[float, float]:
    """Nats by which Phi is above the lowest that the search had, and what its planes save."""
    model = frame.detect()
    lowest = min((move.information for move in model.curve.moves), default=model.information)
    return max(model.information - lowest, 0.0), model.curve[0] - model.information


def main() -> None:
    """Measure and print."""
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--rooms", type=int, default=20)
    given = parser.parse_args()

    def frames() -> Iterator[Frame]:
        yield from rooms(given.rooms)
        yield from real(given.data)

    rows: dict[str, list[tuple[float, float]]] = {}
    for frame in frames():
        rows.setdefault(frame.name.partition("/")[0], []).append(raised(frame))
    print("| frames | n | raised | most, nats | most, share |\n|---|---:|---:|---:|---:|")
    for name, each in rows.items():
        nats, saved = np.transpose(each)
        share = (nats / np.maximum(saved, 1.0)).max()
        much = np.count_nonzero(nats > _MUCH)
        print(f"| `{name}` | {len(each)} | {much} | {nats.max():,.0f} | {share:.0%} |")


if __name__ == "__main__":
    main()
