"""Clouds of boards before a wall, and of the two sides of a thin one: Markdown tables.

python -m benchmarks.cloud_steps [--clouds 8]

By how far they are apart: planes found, and VOI in bits, first without dividing segments at steps
(`clouds.steps`), then with it; means over clouds that are turned at random.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import planewise as pw
from benchmarks.arguments import parser_of
from planewise.clouds import segments
from planewise.metrics import evaluate

Array = NDArray[np.float64]
Labelled = tuple[Array, NDArray[np.int64]]

_OFF = (1.0, 2.0, 3.0, 4.0, 6.0, 10.0)  # boards, standard deviations
_GAPS = (0.08, 0.1, 0.12, 0.15)  # two sides, metres
_BOARDS = ((1, 0.6), (5, 0.6), (20, 0.4), (20, 0.2))  # how many, and their sides in metres


def boards(count: int, side: float, off: float, sigma: float, seed: int) -> Labelled:
    """400,000 points of a wall of 6 x 3 m with boards of one plane before it."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform((0, 0), (6, 3), (400_000, 2))
    columns = int(np.ceil(np.sqrt(2 * count)))
    rows = -(-count // columns)
    row, column = np.divmod(np.arange(count), columns)
    middles = np.column_stack(((column + 0.5) * 6 / columns, (row + 0.5) * 3 / rows))
    on = np.any([(np.abs(xy - middle) < side / 2).all(axis=1) for middle in middles], axis=0)
    return _turned(xy, off * on, sigma, rng), 1 + on


def two_sides(count: int, gap: float, sigma: float, seed: int) -> Labelled:
    """So many points on either side of a wall of 3 x 3 m."""
    rng = np.random.default_rng(seed)
    side = np.repeat((0, 1), count)
    return _turned(rng.uniform(0, 3, (2 * count, 2)), gap * side, sigma, rng), 1 + side


def _turned(xy: Array, height: Array, sigma: float, rng: np.random.Generator) -> Array:
    points = np.column_stack((xy, height + rng.normal(0, sigma, len(xy))))
    return np.asarray(Rotation.random(random_state=rng).apply(points))


@contextmanager
def undivided() -> Iterator[None]:
    """Inside the block segments stay as they are."""
    with patch.object(segments, "at_steps", lambda cells, rows, of_cell, *_: (rows, of_cell)):
        yield


def _cell(make: partial[Labelled], sigma: float, clouds: int) -> str:
    sensor = pw.Sensor(max_depth=100.0, resolution=0.001, noise=sigma)
    rows = []
    for seed in range(clouds):
        points, truth = make(seed)
        with undivided():
            whole = pw.detect_planes_in_points(points, sensor)
        for model in (whole, pw.detect_planes_in_points(points, sensor)):
            scores = evaluate(model.labels[None], truth[None])
            rows.append((len(model), scores.row()["voi_labelled"]))
    planes, voi = np.array(rows).reshape(clouds, 2, 2).mean(axis=0).T
    return ", ".join(f"{n:.1f} {bits:.2f}" for n, bits in zip(planes, voi, strict=True))


def _print(
    name: str,
    columns: list[str],
    rows: dict[str, list[tuple[partial[Labelled], float]]],
    clouds: int,
) -> None:
    print(f"\n| {name} | {' | '.join(columns)} |")
    print("|---|" + "---|" * len(columns))
    for row, makers in rows.items():
        cells = [_cell(make, sigma, clouds) for make, sigma in makers]
        print(f"| {row} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--clouds", type=int, default=8)
    clouds = parser.parse_args().clouds
    before = {
        f"{count} of {side:g} m, {1e3 * sigma:g} mm": [
            (partial(boards, count, side, off * sigma, sigma), sigma) for off in _OFF
        ]
        for sigma in (0.002, 0.01)
        for count, side in _BOARDS
    }
    _print("boards, off by standard deviations", [f"{off:g}" for off in _OFF], before, clouds)
    sides = {
        f"2 x {count:,}, 10 mm": [(partial(two_sides, count, gap, 0.01), 0.01) for gap in _GAPS]
        for count in (5_000, 20_000)
    }
    _print("two sides, apart", [f"{100 * gap:g} cm" for gap in _GAPS], sides, clouds)


if __name__ == "__main__":
    main()
