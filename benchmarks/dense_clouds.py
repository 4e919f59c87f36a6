"""Dense clouds with thick noise: walls of 3 x 2 m and cubes of 1 m, turned at random.

python -m benchmarks.dense_clouds [--turns 4]

Prints a Markdown table by number of points and sigma: how many planes are found in walls, which are
one, and in cubes, which have six; in brackets how many of the six, at IoU 0.5. x: times.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from planewise.metrics.scores import evaluate

Points = NDArray[np.float64]
COUNTS, SIGMAS = (10_000, 100_000, 300_000, 1_000_000), (0.001, 0.003, 0.005, 0.01, 0.02, 0.03)


def _turned(points: Points, rng: np.random.Generator) -> Points:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.asarray(points @ (q * np.sign(np.diag(r))).T)


def _found(points: Points, sigma: float) -> pw.PlaneModel:
    reach = float(np.linalg.norm(np.ptp(points, axis=0)))
    return pw.detect_planes_in_points(points, pw.Sensor(max_depth=reach, noise=sigma))


def walls(count: int, sigma: float, turns: int) -> str:
    """Planes of walls, and how many walls have so many."""
    found = []
    for seed in range(turns):
        rng = np.random.default_rng(seed)
        flat = np.column_stack((rng.uniform(0, 3, count), rng.uniform(0, 2, count)))
        points = np.column_stack((flat, rng.normal(0, sigma, count)))
        found.append(len(_found(_turned(points, rng), sigma)))
    return ", ".join(f"{planes} x {times}" for planes, times in sorted(Counter(found).items()))


def cubes(count: int, sigma: float, turns: int) -> str:
    """Planes of every cube, and true ones."""
    found = []
    for seed in range(turns):
        rng = np.random.default_rng(100 + seed)
        face, points = rng.integers(0, 6, count), rng.uniform(-0.5, 0.5, (count, 3))
        side = np.where(face % 2, 0.5, -0.5) + rng.normal(0, sigma, count)
        points[np.arange(count), face // 2] = side
        model = _found(_turned(points, rng), sigma)
        labels = model.labels.astype(np.int64)
        hits = evaluate(labels[None], face[None] + 1, minimum_pixels=50).detections[0].hits
        found.append(f"{len(model)} ({hits})")
    return ", ".join(f"{each} x {times}" for each, times in sorted(Counter(found).items()))


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--turns", type=int, default=4)
    turns = parser.parse_args().turns
    print("| points | sigma, mm | walls: planes | cubes: planes (true) |\n|---|---|---|---|")
    for count in COUNTS:
        for sigma in SIGMAS:
            row = walls(count, sigma, turns), cubes(count, sigma, turns)
            print(f"| {count:,} | {1000 * sigma:.0f} | {row[0]} | {row[1]} |", flush=True)


if __name__ == "__main__":
    main()
