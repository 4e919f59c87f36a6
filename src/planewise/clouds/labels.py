"""Labels of the points of a cloud: each is on the plane that its residual and surroundings say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import SHARED, CloudCells
from planewise.clouds.cloud import SLICED, Cloud
from planewise.flatness import WARP
from planewise.kernels import cloud_labels as kernels
from planewise.kernels.cloud_cells import cell_residuals
from planewise.kernels.cloud_keys import TURN
from planewise.kernels.cloud_rows import COUNT, WEIGHT
from planewise.kernels.medians import OF_CHI2

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

_MOST = 0.75  # of the points of a plane's cells
_BOWED = 2.0  # times its deviation the median of what is bowed may say


def label_points(
    cloud: Cloud,
    cells: CloudCells,
    plane_of_cell: NDArray[np.int64],
    planes: Array,
    areas: Array,
    null: float,
    resolution: float,
) -> Labels:
    """Labels of the sorted points, 0 for none, j for row j - 1.

    Parameters
    ----------
    cloud, cells
        The points and their cells.
    plane_of_cell : ndarray of int, shape (m,)
        Row in `planes`, -1 for none.
    planes : ndarray, shape (N, 4)
        (normal, distance) relative to the centre of the cloud.
    areas : ndarray, shape (N,)
        Of the planes, square metres.
    null : float
        Nats of a point on none, across the plane.
    resolution : float
        eps in metres.
    """
    label_of = np.append(plane_of_cell + 1, 0)[cells.owner]
    extra = np.zeros(len(planes) + 1)
    # Points lie about the plane of a square as far as the error wanders on it.
    extra[1:] = cells.error.about_planes(areas)
    # Points of a square have a variance of a twelfth of its area along either side.
    most = (_BOWED * WARP) ** 2 * areas / 12.0
    follow = np.append(0.0, _bulging(cells, plane_of_cell, planes, most))
    larger = cells.error.white * (1.0 + SHARED)
    variance = larger * cloud.variance
    # By what was described: where that is far too little, nothing says what a sheet is.
    thick = larger * (cloud.louder * cloud.side / SLICED) ** 2
    labels: Labels = cloud.memory.empty(len(cloud.local), np.uint16)
    cloud.over_cubes(
        lambda first, last: kernels.label_points(
            cloud.local, cloud.starts, cloud.cubes, cloud.side, cloud.grid.middle, TURN,
            cloud.about, label_of, cells.rows, cells.owner, follow, variance, extra, planes,
            null, resolution, thick, first, last, labels,
        )
    )  # fmt: skip
    return labels


def _bulging(
    cells: CloudCells, plane_of_cell: NDArray[np.int64], planes: Array, most: Array
) -> Array:
    """Share of the deviation of cells from their planes that is no noise, shape (N,).

    Of the median cell: those that are none of the plane's, such as those about a crease, are less
    than half of them. 0 of what deviates by a variance of more than `most`, which is no plane.
    """
    off = np.empty(len(plane_of_cell))
    cell_residuals(cells.rows, plane_of_cell, planes, off)
    on = np.flatnonzero(plane_of_cell >= 0)
    plane, weight, count = plane_of_cell[on], cells.rows[on, WEIGHT], cells.rows[on, COUNT]
    square = off[on] * off[on] / weight
    order = np.lexsort((square, plane))
    points = np.bincount(plane, count, len(planes))
    reached = np.cumsum(points) - 0.5 * points
    median = np.append(square[order], 0.0)[np.searchsorted(np.cumsum(count[order]), reached)]
    # Of a point, with what the points of a cell share.
    noise = np.bincount(plane, count * count / weight, len(planes)) / np.maximum(points, 1.0)
    variance = np.where(points > 0.0, median / OF_CHI2, 0.0)
    bulges = np.maximum(variance - noise, 0.0)
    share = bulges / np.maximum(variance, np.finfo(float).tiny)
    return np.where(bulges <= most, share, 0.0)


def lost_most(
    cloud: Cloud,
    cells: CloudCells,
    plane_of_cell: NDArray[np.int64],
    labels: Labels,
    planes: int,
) -> NDArray[np.bool_]:
    """Which planes have lost most points of their cells to other planes, shape (N,).

    Cubes that cut a corner off each of two sheets look like cells of a plane across both. Along the
    line in which sides of the grid cut the sheets there are many of them, all on one plane; but the
    sheets themselves are nearer to some nine of ten of their points. Small faces in thick noise may
    lose half.
    """
    label_of = np.append(plane_of_cell + 1, 0)[cells.owner]
    points = np.zeros((planes + 1, 2), np.int64)
    for first, last in cloud.runs():
        kernels.count_lost(labels, cloud.starts, label_of, first, last, points)
    of_cells, lost = points[1:].T
    return np.asarray(lost > _MOST * of_cells)
