"""Missing returns: rays that met nothing are often kept as points where they begin, at 0, 0, 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.memory import Memory
from planewise.clouds.order import blocks_of
from planewise.noise import is_constant
from planewise.sensor import Sensor

Array = NDArray[np.float64]
Points = NDArray[np.floating]


def without_missing(
    points: Points,
    sensor: Sensor,
    sigma: Array | None,
    origin: Array | None,
    memory: Memory | None = None,
) -> Points:
    """Points, NaN those that lie on their own origin; the same array where there is none.

    Where their noise does not depend on any distance, such points may be true ones.

    Parameters
    ----------
    points : ndarray of float, shape (k, 3)
        May lie on a disk.
    sensor, sigma, origin
        As in `clouds.cloud.cloud_of`.
    memory : Memory, optional
        Where the points lie.
    """
    if origin is None and (sigma is not None or is_constant(sensor.noise)):
        return points
    memory = memory or Memory()
    places = np.broadcast_to(np.zeros(3) if origin is None else origin, points.shape)
    found, first = [np.empty(0, np.intp)], 0
    for block in blocks_of(points, memory):
        begins = places[first : first + len(block)]
        rows = np.flatnonzero(block[:, 0] == begins[:, 0])  # hardly any: the others need no look
        found.append(rows[(block[rows] == begins[rows]).all(axis=1)] + first)
        first += len(block)
    missing = np.concatenate(found)
    if not len(missing):
        return points
    others, first = memory.empty(points.shape, points.dtype), 0
    for block in blocks_of(points, memory):
        others[first : first + len(block)] = block
        first += len(block)
    others[missing] = np.nan
    return others
