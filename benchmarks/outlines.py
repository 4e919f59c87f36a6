"""How well outlines of clouds bound a known surface, and what outlines cost.

python -m benchmarks.outlines

The surface is a rectangle of 4 x 2 m with a hole of 1 x 0.8 m, random points on it, its sides
turned against the axes of the plane. Times are of the processor, by turns with the default
detection of a room.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from planewise.model import Curve, Plane, PlaneModel

ANGLES = (0, 10, 33)
TRUE_AREA, TRUE_HOLE = 7.2, 0.8
ROUNDS = 40


def surface(count: int, degrees: float, seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    flat = rng.uniform((-2, -1), (2, 1), (round(count * 8 / TRUE_AREA), 2))
    flat = flat[(abs(flat[:, 0] - 0.5) > 0.5) | (abs(flat[:, 1]) > 0.4)]
    a = np.radians(degrees)
    turned = flat @ np.array(((np.cos(a), np.sin(a)), (-np.sin(a), np.cos(a))))
    return np.column_stack((turned, np.full(len(turned), -2.0)))


def model_of(points: NDArray[np.float64]) -> PlaneModel:
    """The model that has all points on their plane."""
    plane = Plane(
        normal=np.array((0.0, 0.0, 1.0)),
        distance=2.0,
        information=-1.0,
        count=len(points),
        rms=0.0,
        centroid=points.mean(axis=0),
        covariance=np.eye(4),
    )
    return PlaneModel(
        labels=np.ones(len(points), np.uint16),
        planes=(plane,),
        information=0.0,
        curve=Curve(information=np.zeros(1), chosen=0, reason=""),
        readings=len(points),
        prefix=(0.0,),
        search="joint",
        objective="paper",
    )


def enclosed(ring: NDArray[np.float64]) -> float:
    """Area within a ring."""
    (x, y), (next_x, next_y) = ring.T, np.roll(ring, -1, axis=0).T
    return float(abs(x @ next_y - y @ next_x) / 2)


def seconds(work: Callable[[], object]) -> float:
    started = time.process_time()
    work()
    return time.process_time() - started


def main() -> None:
    for count in (900, 9_000, 180_000):
        areas, holes, found = [], [], 0
        for seed in range(10):
            for angle in ANGLES:
                points = surface(count, angle, seed)
                (outline,) = pw.outline_points(model_of(points), points)
                areas.append(outline.area / TRUE_AREA)
                inside = [hole for each in outline.polygons for hole in each.holes]
                found += len(inside) == 1
                holes += [enclosed(hole) / TRUE_HOLE for hole in inside]
        print(
            f"{count:,} points: {np.mean(areas):.3f} +- {np.std(areas):.3f} of the true area; "
            f"one hole in {found} of {len(areas)}: {np.mean(holes):.2f} +- {np.std(holes):.2f}"
        )
    room = pw.scenes.room(0)
    detector = pw.Detector(room.camera, room.sensor)
    found_in_room = detector(room.depth)
    cloud = surface(1_000_000, 10, 0)
    clouds = [cloud[:10_000], cloud[:100_000], cloud]
    models = [model_of(points) for points in clouds]
    times = np.array(
        [
            (
                seconds(lambda: detector(room.depth)),
                seconds(lambda: pw.outline_image(found_in_room, room.camera)),
                *(
                    seconds(lambda k=k: pw.outline_points(models[k], clouds[k]))  # type: ignore[misc]
                    for k in range(3)
                ),
            )
            for _ in range(ROUNDS)
        ]
    )
    ratios = np.median(times / times[:, :1], axis=0)
    print(f"room of {len(found_in_room)} planes: {ratios[1]:.1f} times its detection")
    for points, ratio, spent in zip(clouds, ratios[2:], np.median(times, axis=0)[2:], strict=True):
        print(
            f"{len(points):,} points: {ratio:.1f} times, {1e6 * spent / len(points):.2f} us a point"
        )


if __name__ == "__main__":
    main()
