"""Work that does not change, to measure a machine by.

The time of a detection over its time hardly depends on how fast the machine is or what else runs.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CELL = 8  # pixels
_SOLVES = 40  # small systems, one by one
_PLANES = 80  # which readings are held against where vectors count
_FAR = 9.0  # squared distance in variances beyond which a reading tells no more


def reference(depth: NDArray[np.uint16], *, vectors: bool = False) -> float:
    """Do a fixed amount of the four kinds of work that a detection consists of.

    Parameters
    ----------
    depth : ndarray of uint16, shape (H, W)
        Millimetres.
    vectors : bool
        Do as much again of what takes half the time where a processor's vectors are twice as wide,
        as holding all readings against many planes does.

    Returns
    -------
    float
        Of no meaning; keeps the work from being left out.
    """
    z = 0.001 * depth  # passes over memory
    there = z > 0
    w = np.divide(1.0, z, out=np.zeros_like(z), where=there)
    total = float(np.bincount(depth[there] >> 4, weights=w[there]).max() + np.cumsum(z)[-1])
    sums = _moments(w)  # compiled arithmetic
    total += _walk(np.argsort(sums[:, 5], kind="stable"))  # reads that have to wait for each other
    for k in range(_SOLVES):  # the interpreter
        matrix = sums[k, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3) + np.eye(3)
        total += float(np.linalg.solve(matrix, sums[k, 6:9])[0])
    return total + (_misfits(w, _PLANES) if vectors else 0.0)


@numba.njit(cache=True, error_model="numpy")
def _moments(w: Array) -> Array:
    """Sums over each cell, shape (cells, 9)."""
    rows, columns = w.shape[0] // _CELL, w.shape[1] // _CELL
    out = np.zeros((rows * columns, 9))
    for cell in range(rows * columns):
        top, left = _CELL * (cell // columns), _CELL * (cell % columns)
        for y in range(_CELL):
            for x in range(_CELL):
                value = w[top + y, left + x]
                weight = 1.0 / (1.0 + value * value)
                u, v = weight * x, weight * y
                out[cell, 0] += u * x
                out[cell, 1] += u * y
                out[cell, 2] += u
                out[cell, 3] += v * y
                out[cell, 4] += v
                out[cell, 5] += weight
                out[cell, 6] += u * value
                out[cell, 7] += v * value
                out[cell, 8] += weight * value
    return out


@numba.njit(cache=True)
def _walk(after: NDArray[np.int64]) -> int:
    at = 0
    total = 0
    for step in range(20 * len(after)):
        at = after[(at + step) % len(after)]
        total += at
    return total


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _misfits(w: Array, planes: int) -> float:
    """Squared distances from some planes that cross the image."""
    total, x = 0.0, np.arange(w.shape[1]) / w.shape[1]
    for i in range(w.shape[0]):
        row = w[i]
        for k in range(planes):
            height, slope = 0.01 * k + i / w.shape[0], 0.1 * k
            for j in range(row.size):
                off = row[j] - height - slope * x[j]
                total += min(1e3 * off * off, _FAR)
    return total
