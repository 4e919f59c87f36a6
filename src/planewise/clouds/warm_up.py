"""Compile the loops of a cloud's later stages in a process of their own, while the first ones are.

``python -m planewise.clouds.warm_up`` is to clouds what `warm_up` is to depth images.
"""

from __future__ import annotations

import gc

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import PRIOR, CloudCells, CloudError, residual_correlation
from planewise.clouds.cloud import Cloud
from planewise.clouds.curvature import borders_of, curved_segments, nearly_flat
from planewise.clouds.labels import label_points, lost_most
from planewise.clouds.model import ranked_model
from planewise.clouds.order import Grid
from planewise.clouds.rows import planes_of
from planewise.clouds.segments import PAIRS_AT_ONCE, segments_of
from planewise.clouds.weighing import CloudPlanes
from planewise.compilation import confirm
from planewise.information import coordinate_information, plane_information
from planewise.kernels.cloud_keys import TURN
from planewise.kernels.cloud_rows import (
    AREA,
    CELLS,
    COUNT,
    CX,
    CZ,
    FREE,
    NX,
    NZ,
    ROW,
    WEIGHT,
    XX,
    ZZ,
)
from planewise.kernels.cloud_segments import agglomerate, join_parts
from planewise.sensor import Sensor

_WIDE, _HIGH = 4, 6  # cubes to a side of each of two squares, and from one to the other
_POINTS = 8  # in a cube
_SIGMA = 0.01  # metres; cubes have a metre


def later_stages() -> None:
    """Rank the planes of two squares, one over the other, label their points, merge their cells.

    The arrays have the types and layouts of a real cloud's. What comes last comes first, and of
    merging the largest loop: so little is compiled twice once the call has got that far.
    """
    cloud, cells = _made_up()
    sensor = Sensor(max_depth=10.0, resolution=0.001, noise=_SIGMA)
    limits, count = (sensor.range, sensor.resolution), len(cells.rows)
    of_cell = np.arange(count) * 2 // count
    labels, rows = np.repeat(of_cell + 1, _POINTS).astype(np.uint16), cells.rows[[0, -1]]
    told = CloudPlanes(cloud, labels, rows, cells.error, np.ones(2), np.zeros(2))
    ranked_model(len(labels), told, sensor, 9, {})

    planes = planes_of(rows)
    coordinate, cost = coordinate_information(*limits), plane_information(3, *limits)
    label_points(cloud, cells, of_cell, planes, rows[:, AREA], coordinate, limits[1])
    lost_most(cloud, cells, of_cell, labels, len(planes))
    residual_correlation(cells, of_cell, planes)

    each = np.arange(count)
    beside = borders_of(cells, cells.rows, each, PAIRS_AT_ONCE, cloud.memory)
    curved_segments(cells.rows, beside)
    nearly_flat(cells.rows, beside)
    join_parts(cells.rows.copy(), each)
    nats = np.ones((3, len(cells.ends)))
    agglomerate(
        cells.ends.copy(), *nats, cells.rows.copy(), cells.error.wander, (*PRIOR, 0.0), cost,
        np.zeros(count, np.bool_), np.empty(count, np.int64),
    )  # fmt: skip
    segments_of(cells, cost, sensor.range, significance=0.0, workers=1)


def _made_up() -> tuple[Cloud, CloudCells]:
    """Every cube a cell."""
    places = [(x, y, z) for z in (0, _HIGH) for y in range(_WIDE) for x in range(_WIDE)]
    places.sort(key=_key)
    number = {place: k for k, place in enumerate(places)}
    n, steps = len(places), (-1, 0, 1)
    about = np.array(
        [
            [number.get((x + i, y + j, z + k), -1) for i in steps for j in steps for k in steps]
            for x, y, z in places
        ],
        np.int32,
    )
    grid, rng = Grid(np.zeros(3), 1.0, 3, 4.0), np.random.default_rng(0)
    cubes = np.array([_key(place) for place in places], np.uint64)
    inside = rng.uniform(-0.5, 0.5, (n * _POINTS, 3)) * (1.0, 1.0, 0.0)
    local = (inside @ TURN).astype(np.float32)
    cloud = Cloud(
        grid, np.arange(len(local), dtype=np.uint32), local, np.arange(n + 1) * _POINTS, cubes,
        about, np.zeros((n, ROW)), np.full(n, _SIGMA**2), workers=1,
    )  # fmt: skip
    cells = CloudCells(
        rows=_rows((np.array(places) + 0.5 - grid.middle) @ TURN),
        keys=cubes,
        owner=np.arange(n),
        ends=np.array([(k, e) for k in range(n) for e in about[k, 14:] if e >= 0], np.int32),
        sides=np.ones(int((about[:, 14:] >= 0).sum()), np.float32),
        error=CloudError(1.0, 1e-6),
    )
    return cloud, cells


def _key(place: tuple[int, int, int]) -> int:
    """Morton key of a cube."""
    return sum(((e >> bit) & 1) << (3 * bit + k) for k, e in enumerate(place) for bit in range(3))


def _rows(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of squares of a metre along the first two axes of the grid."""
    rows = np.zeros((len(centres), ROW))
    weight = _POINTS / _SIGMA**2
    rows[:, CX : CZ + 1], rows[:, NX : NZ + 1] = centres, TURN[2]
    rows[:, XX : ZZ + 1] = weight / 12.0 * (TURN[:2].T @ TURN[:2])[np.triu_indices(3)]
    rows[:, [WEIGHT, COUNT, AREA, FREE, CELLS]] = weight, _POINTS, 1.0, 9.0, 1.0
    return rows


if __name__ == "__main__":
    gc.disable()  # a short life
    later_stages()
    confirm(cloud=True)
    gc.freeze()  # nor at its end
