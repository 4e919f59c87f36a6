"""noise="auto" against the truth on synthetic frames: curves, Phi and planes.

python -m benchmarks.noise [--seeds N]

Deviation: largest relative difference of the curve of sigma, over the depths that a frame has, from
the root of (true noise^2 + step^2 / 12); white: the same of its white part where the noise is at
least 0.4 steps. Phi: of the run with noise="auto" against that of the run told the truth.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import planewise as pw
from benchmarks.arguments import parser_of
from planewise import noise, scenes

SIGMAS = (0.0005, 0.001, 0.002, 0.005, 0.01)
KINECT_STEP = 1 / (8 * 580 * 0.075)  # 1 / m: what rooms are rounded to
MILLIMETRE = 0.001


def cases(seeds: int) -> Iterator[tuple[str, scenes.Scene, noise.Noise, noise.Polynomial]]:
    """Name, scene, true white noise, and the steps of its readings."""
    for seed in range(seeds):
        for sigma in (None, *SIGMAS):
            room = scenes.room(seed, sigma=sigma)
            white = noise.KINECT if sigma is None else noise.constant(sigma)
            name = f"room, {'Kinect' if sigma is None else f'{1e3 * sigma:g} mm'}"
            yield name, room, white, noise.quadratic(0.0, KINECT_STEP)
        for sigma in SIGMAS:
            for make in (scenes.staircase, scenes.corner):
                scene = make(sigma=sigma, rng=seed)
                name = f"{make.__name__}, {1e3 * sigma:g} mm"
                yield name, scene, noise.constant(sigma), noise.constant(MILLIMETRE)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    given = parser.parse_args()
    rows: dict[str, list[tuple[float, ...]]] = {}
    for name, scene, white, step in cases(given.seeds):
        auto = replace(scene.sensor, noise="auto")
        pw.observe(scene.depth, scene.camera, auto)  # compiles
        times = []
        for sensor in (replace(auto, noise=0.005), auto):
            start = time.perf_counter()
            pw.observe(scene.depth, scene.camera, sensor)
            times.append(1e3 * (time.perf_counter() - start))
        found = pw.estimate_noise(scene.depth, scene.camera, auto)
        z = np.linspace(found.bins.depth[0], found.bins.depth[-1], 50)
        true, steps = np.asarray(white(z)), step(z)
        total = np.sqrt(true**2 + steps**2 / 12)
        seen = true >= 0.4 * steps
        off = np.abs(found.noise(z) / total - 1).max()
        white_off = np.abs(found.white(z) / true - 1)[seen].max() if seen.any() else np.nan
        told = replace(
            scene.sensor,
            noise=noise.RootSum((white, step.scaled(1 / np.sqrt(12)))),
            parts=noise.ErrorParts(white=white, shared=noise.NOTHING, drift=noise.NOTHING),
        )
        row = [float(off), float(white_off), found.shared_ratio, times[1] - times[0]]
        for objective in ("paper", "spatial"):
            one, other = (
                pw.detect_planes(scene.depth, scene.camera, sensor, objective=objective)
                for sensor in (auto, told)
            )
            row += [abs(one.information / other.information - 1), abs(len(one) - len(other))]
        rows.setdefault(name, []).append(tuple(row))
    print("| frames | sigma off | white off | shared | Phi, paper | Phi, spatial | planes | ms |")
    print("|---|---|---|---|---|---|---|---|")
    for name, values in rows.items():
        off, white_off, shared, _, paper, more, spatial, others = np.max(values, axis=0)
        extra = float(np.median([row[3] for row in values]))
        print(
            f"| {name} | {off:.1%} | {'' if np.isnan(white_off) else f'{white_off:.1%}'} | "
            f"{shared:.2f} | {paper:.2%} | {spatial:.2%} | {max(more, others):g} | {extra:.0f} |"
        )


if __name__ == "__main__":
    main()
