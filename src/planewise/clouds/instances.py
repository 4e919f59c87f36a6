"""Surfaces of one plane that do not touch, told apart: ``instances=True``.

Cells of two walls in one plane may lie side by side though the walls end a hand's breadth from each
other. Points tell it better: of each plane they are dropped into a grid with some two
points in a cell, and what does not hang together there becomes a plane of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cloud import FINER, Cloud
from planewise.clouds.rows import planes_of
from planewise.kernels import cloud_instances as kernels
from planewise.kernels.cloud_keys import TURN
from planewise.kernels.cloud_rows import AREA
from planewise.model import MAX_PLANES

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

_HELD = 1.5  # places in a cell, if they lay evenly on the area of their plane
_MOST_CELLS = 4_000_000  # of a plane


def apart(cloud: Cloud, labels: Labels, rows: Array) -> tuple[Labels, NDArray[np.int64]]:
    """Labels of the sorted points by connected piece, and the row in `rows` of each.

    Parameters
    ----------
    cloud : Cloud
        The points.
    labels : ndarray of uint16, shape (k,)
        0 for none, j for row j - 1.
    rows : ndarray, shape (N, 18)
        Of the planes.
    """
    planes = planes_of(rows)
    axes = np.zeros((len(rows) + 1, 2, 3))
    axes[1:] = _inside(planes[:, :3])
    where = cloud.local, labels, cloud.starts, cloud.cubes, cloud.side, cloud.grid.middle, TURN
    low, high = np.full((len(axes), 2), np.inf), np.full((len(axes), 2), -np.inf)
    places = np.zeros(len(axes), np.int64)
    for first, last in cloud.runs():
        kernels.extents(*where, axes, cloud.side / (1 << FINER), first, last, low, high, places)
    side, shape = _grids(places, low, high, np.append(0.0, rows[:, AREA]))
    begins = np.append(0, np.cumsum(shape.prod(axis=1)))
    grid = cloud.memory.empty(int(begins[-1]), np.int32)
    grid[:] = 0
    cells = axes, low, 1.0 / side, shape[:, 0], begins
    cloud.over_cubes(lambda first, last: kernels.occupy(*where, *cells, first, last, grid))
    number = np.ones(len(axes), np.int64)
    for j in np.flatnonzero(shape[:, 0]):
        number[j] = kernels.pieces(grid[begins[j] : begins[j + 1]], shape[j, 1], shape[j, 0])
    number[0] = 1
    if number.sum() == len(number) or number.sum() > MAX_PLANES:
        return labels, np.arange(len(rows))
    new = np.append(0, np.cumsum(number)[:-1])
    out: Labels = cloud.memory.empty(len(labels), np.uint16)
    cloud.over_cubes(
        lambda first, last: kernels.relabel(*where, *cells, grid, new, first, last, out)
    )
    return out, np.repeat(np.arange(len(rows)), number[1:])


def _inside(normals: Array) -> Array:
    """Two axes in the plane of every normal, shape (N, 2, 3)."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack((first, np.cross(normals, first)), axis=1)


def _grids(
    places: NDArray[np.int64], low: Array, high: Array, area: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Side of the cells of every plane, and the shape of its grid along both axes, 0 for none."""
    side, shape = np.ones(len(places)), np.zeros((len(places), 2), np.int64)
    there = np.flatnonzero((places > 0) & (area > 0))
    there = there[there > 0]
    extent = high[there] - low[there]
    smallest = np.sqrt(extent.prod(axis=1) / _MOST_CELLS)
    smallest = np.maximum(smallest, extent.max(axis=1) / _MOST_CELLS)
    side[there] = np.maximum(np.sqrt(_HELD * area[there] / places[there]), smallest)
    shape[there] = (extent / side[there, None]).astype(np.int64) + 1
    return side, shape
