"""Rooms whose walls are not flat, as building tolerances allow: prints Markdown tables.

python -m benchmarks.bulging [--rooms N]

Walls, floor and ceiling bulge by a wave of 6 m in two directions: so much between the highest and
the lowest point. VOI on the true planes, how many of these are found at an IoU of 0.5, and planes
found; first where surfaces are to be as flat as readings say (`planewise.flatness`), then as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.curved_frames import CAMERA, SHAPE, rays
from planewise import sectors
from planewise.clouds import cells, curvature, labels
from planewise.metrics import evaluate
from planewise.metrics.scores import FrameScores
from planewise.scenes.furniture import Block

Array = NDArray[np.float64]
Labelled = tuple[Array, NDArray[np.int64]]

_WAVE = 6.0  # metres
_POINTS, _SIZE = 60_000, np.array([6.0, 4.0, 2.8])
_BULGES, _SIGMAS = (0.0, 0.005, 0.01, 0.02, 0.04), (0.0005, 0.001, 0.003, 0.008)
_STEPS = 6  # of the fixed point of a ray and a bulging wall
_C, _S = np.cos(0.6), np.sin(0.6)
_BOX = Block(
    centre=np.array([0.2, 0.95, 1.7]),
    half=np.array([0.25, 0.25, 0.2]),
    colour=(0.5, 0.5, 0.5),
    axes=np.array([[_C, 0, _S], [0, 1, 0], [-_S, 0, _C]]),
)


def wave(points: Array, axes: Array, bulge: float, phase: Array) -> Array:
    """Height of points (., 3) over a wall along two axes (2, 3)."""
    return np.asarray(0.25 * bulge * np.sin(2 * np.pi * points @ axes.T / _WAVE + phase).sum(-1))


def corner(bulge: float, rng: np.random.Generator) -> Labelled:
    """Depth of two walls and a floor, which bulge, and of a box, which does not."""
    every, turn = rays(), rng.uniform(-0.3, 0.3)
    c, s = np.cos(turn), np.sin(turn)
    depths = []
    for normal, distance in (((s, 0, c), 2.6), ((-c, 0, s), 1.1), ((0, 1, 0), 1.2)):
        along = every @ np.array(normal, float)
        ahead = np.where(along > 1e-3, along, np.nan)
        axes = np.linalg.svd(np.array([normal], float))[2][1:]
        phase, z = rng.uniform(0, 2 * np.pi, 2), distance / ahead
        for _ in range(_STEPS):
            z = (distance + wave(z[..., None] * every, axes, bulge, phase)) / ahead
        depths.append(np.where(z > 0, z, np.inf))
    box, face = _BOX.hit(np.zeros((1, 3)), every.reshape(-1, 3))
    depth = np.stack((*depths, box.reshape(SHAPE)))
    nearest = depth.argmin(axis=0)
    return depth.min(axis=0), np.where(nearest < 3, nearest + 1, 4 + face.reshape(SHAPE) // 2)


def room(bulge: float, rng: np.random.Generator) -> Labelled:
    """Points of the six faces of a room."""
    areas = np.array([_SIZE.prod() / _SIZE[axis] for axis in range(3)])
    points, labels = [], []
    for face in range(6):
        axis, axes = face // 2, np.delete(np.eye(3), face // 2, axis=0)
        count = int(_POINTS * areas[axis] / (2 * areas.sum()))
        on = rng.uniform(0, 1, (count, 3)) * _SIZE
        on[:, axis] = face % 2 * _SIZE[axis] + wave(on, axes, bulge, rng.uniform(0, 2 * np.pi, 2))
        points.append(on)
        labels.append(np.full(count, face + 1))
    order = rng.permutation(sum(map(len, points)))
    return np.concatenate(points)[order], np.concatenate(labels)[order]


def _of_image(depth: Array, sigma: float, rng: np.random.Generator) -> pw.PlaneModel:
    sensor = pw.Sensor(max_depth=10.0, resolution=1e-4, noise=sigma)
    return pw.detect_planes(depth + sigma * rng.standard_normal(depth.shape), CAMERA, sensor)


def _of_cloud(points: Array, sigma: float, rng: np.random.Generator) -> pw.PlaneModel:
    sensor = pw.Sensor(max_depth=20.0, resolution=1e-4, noise=sigma)
    return pw.detect_planes_in_points(points + rng.normal(0, sigma, points.shape), sensor)


@contextmanager
def flat() -> Iterator[None]:
    """Inside the block a surface is as flat as its readings say, or several."""
    with ExitStack() as patches:
        for module, name in (
            (sectors, "LEAN"),
            (cells, "LEAN"),
            (curvature, "WARP"),
            (labels, "WARP"),
        ):
            patches.enter_context(patch.object(module, name, 0.0))
        yield


SCENES: dict[str, tuple[Callable[..., Labelled], Callable[..., pw.PlaneModel]]] = {
    "depth images": (corner, _of_image),
    "clouds": (room, _of_cloud),
}


def scored(name: str, bulge: float, sigma: float, seed: int) -> FrameScores:
    """What is found in one room."""
    scene, detect = SCENES[name]
    rng = np.random.default_rng(seed)
    seen, truth = scene(bulge, rng)
    model = detect(seen, sigma, rng)
    return evaluate(np.atleast_2d(model.labels), np.atleast_2d(truth))


def means(name: str, bulge: float, sigma: float, rooms: int) -> str:
    """VOI, share of the true planes that are found, and planes found: means of some rooms."""
    rows = []
    for seed in range(rooms):
        found = scored(name, bulge, sigma, seed)
        voi = found.labelled.variation_of_information
        rows.append((voi, found.detections[0].recall, found.predicted_planes))
    return "{:.2f} {:.2f} {:.1f}".format(*np.mean(rows, axis=0))


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=6)
    rooms = parser.parse_args().rooms
    for name in SCENES:
        print(f"\n| {name}: bulge, mm | {' | '.join(f'{1e3 * s:g} mm' for s in _SIGMAS)} |")
        print("|---|" + "---|" * len(_SIGMAS))
        for bulge in _BULGES:
            columns = []
            for sigma in _SIGMAS:
                with flat():
                    before = means(name, bulge, sigma, rooms)
                columns.append(f"{before}, {means(name, bulge, sigma, rooms)}")
            print(f"| {1e3 * bulge:g} | {' | '.join(columns)} |", flush=True)


if __name__ == "__main__":
    main()
