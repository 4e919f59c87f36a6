"""Misassigned readings of the paper's T-junction, with and without reassignment by normals.

python -m benchmarks.reassignment
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import planewise as pw
from planewise import scenes

SIZES = ((3, 1.0), (5, 2.0), (7, 3.0), (15, 5.0))
SIGMA = 0.005


def misassigned(scene: scenes.Scene, model: pw.PlaneModel) -> int:
    """Readings given to another plane than theirs; those given to none do not count."""
    nearest = [np.abs(scene.planes - row).sum(axis=1).argmin() for row in model.coefficients]
    labels = np.array([0, *(j + 1 for j in nearest)])[model.labels]
    return int(np.count_nonzero((labels != scene.labels) & (labels > 0)))


def row(scene: scenes.Scene, reassign: pw.NormalReassignment | None) -> list[int]:
    """Of the sequential and of the joint search."""
    sensor = replace(scene.sensor, noise=pw.noise.constant(SIGMA))
    out = []
    for search in ("sequential", "joint"):
        options = pw.Options(search=search, objective="paper", reassign=reassign)
        observation = pw.observe(scene.depth, scene.camera, sensor)
        out.append(misassigned(scene, pw.find(observation, options)))
    return out


def main() -> None:
    ways = [None, *(pw.NormalReassignment(gradient=g, smoothing=s) for g, s in SIZES)]
    named = {
        "T-junction, no noise": scenes.t_junction(edge=0.0, sigma=0.0, quantise=False),
        "T-junction, 5 mm": scenes.t_junction(edge=0.0),
        "corner, 5 mm": scenes.corner(),
    }
    print("| scene | gradient, smoothing | sequential | joint |\n|---|---|---|---|")
    for name, scene in named.items():
        for how in ways:
            sizes = "no reassignment" if how is None else f"{how.gradient}, {how.smoothing}"
            print("|", " | ".join((name, sizes, *map(str, row(scene, how)))), "|")


if __name__ == "__main__":
    main()
