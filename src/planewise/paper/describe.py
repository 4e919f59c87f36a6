"""What is told of every plane: its readings, how far they lie off, its area and where it is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import readings as kernels
from planewise.model import Plane
from planewise.observation import Observation, RayObservation
from planewise.paper.evaluate import FEWEST_PARTS, part_count
from planewise.runtime import threads

Array = NDArray[np.float64]


def describe(
    observation: Observation,
    rows: Array,
    covariances: Array,
    labels: NDArray[np.integer],
    gains: Array,
    square: Array,
    workers: int = 1,
) -> list[Plane]:
    """Planes with the statistics of their readings, in the order of their labels.

    Parameters
    ----------
    observation : Observation
        Positions and areas of the readings.
    rows : ndarray, shape (N, n + 1)
        Unit normal and distance.
    covariances : ndarray, shape (N, n + 1, n + 1)
        Of the rows.
    labels : ndarray of int, shape (k,)
        0 for none, j for row j - 1.
    gains, square : ndarray, shape (k,)
        What each reading saves, in nats, and its squared residual, in square metres.
    workers : int
        Threads.
    """
    parts = part_count(observation.count)
    sums = np.empty((parts, len(rows), 4 + observation.dimension))
    boxes = np.empty((parts, len(rows), 4), np.int64)
    if isinstance(observation, RayObservation):
        direction, depth, solid = observation.rays, observation.depth, observation.solid
        if observation.ranges:
            square = _across(rows, labels, direction, depth)
    else:
        direction = observation.positions().T.copy()
        depth, solid = np.ones(observation.count), np.zeros(observation.count)
    where = observation.index, observation.shape[-1]
    threads.over_chunks(
        lambda first, last: kernels.summarise(
            labels, gains, square, direction, depth, solid, *where, first, last, sums, boxes
        ),
        parts,
        workers,
        FEWEST_PARTS,
    )
    total = sums.sum(axis=0)
    if not isinstance(observation, RayObservation):
        return planes_of(rows, covariances, total, None, {})
    box = np.hstack((boxes[..., :2].min(axis=0), boxes[..., 2:].max(axis=0)))
    if observation.camera.wraps:
        index, width = where
        there = np.zeros((len(rows) + 1, width), np.bool_)
        there.reshape(-1)[labels.astype(np.intp) * width + index % width] = True
        box = boxes_around(box, there[1:])
    return planes_of(rows, covariances, total, box, {})


def _across(rows: Array, labels: NDArray[np.integer], direction: Array, ranges: Array) -> Array:
    """Squared distances of readings to their planes, normal . x + distance.

    Many rays of a LiDAR graze the ground: distances along them say little.
    """
    x, y, z, distance = np.vstack((np.zeros((1, 4)), rows)).T.copy()
    facing = x[labels] * direction[0] + y[labels] * direction[1] + z[labels] * direction[2]
    return np.asarray(np.square(ranges * facing + distance[labels]))


def boxes_around(box: NDArray[np.int64], there: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Boxes of planes in a panorama: columns between their widest gap, beyond the last if need be.

    there (N, W): columns in which each has readings. Those of a plane that lies across the end of
    the image are left ... right - 1, of which those from W on are the first ones of the image.
    """
    out, width = box.copy(), there.shape[1]
    for j in range(len(box)):
        columns = np.flatnonzero(there[j])
        gaps = np.diff(columns, append=columns[:1] + width)
        if columns.size and gaps[:-1].max(initial=0) > gaps[-1]:
            widest = int(gaps[:-1].argmax())
            out[j, 1], out[j, 3] = columns[widest + 1], columns[widest] + width + 1
    return out


def planes_of(
    rows: Array,
    covariances: Array,
    sums: Array,
    boxes: NDArray[np.int64] | None,
    told: Mapping[str, list[float]],
) -> list[Plane]:
    """Planes from sums over their readings: count, gain, delta^2, z^3 solid, position."""
    counts, distances = np.maximum(sums[:, 0], 1.0), rows[:, -1]
    columns: dict[str, Iterable[Any]] = {
        "normal": rows[:, :-1],
        "distance": distances.tolist(),
        "information": sums[:, 1].tolist(),
        "count": sums[:, 0].astype(int).tolist(),
        "rms": np.sqrt(np.maximum(sums[:, 2], 0.0) / counts).tolist(),
        "centroid": sums[:, 4:] / counts[:, None],
        "covariance": covariances,
    }
    if boxes is not None:
        # |dx/du x dx/dv| = z^3 / d for the point z r of a plane at distance d.
        columns["area"] = (sums[:, 3] / distances).tolist()
        columns["bounding_box"] = map(tuple, (boxes * (sums[:, :1] > 0)).tolist())
    columns |= told
    planes = [object.__new__(Plane) for _ in rows]
    for plane, each in zip(planes, zip(*columns.values(), strict=True), strict=True):
        # All at once: as it is frozen, `__init__` takes three times as long.
        plane.__dict__.update(zip(columns, each, strict=True))
    return planes
