"""Planes of rows (`kernels.cloud_rows`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.cloud_rows import COUNT, CX, CZ, NX, NZ, WEIGHT, XX, ZZ, write_normals

Array = NDArray[np.float64]

_IN_LINE = 1e-12  # of the scatter along points: as much across them is rounding


def planes_of(rows: Array) -> Array:
    """(normal, distance) of rows, shape (N, 4), relative to the centre of the cloud."""
    normals = rows[:, NX : NZ + 1]
    return np.column_stack((normals, -(normals * rows[:, CX : CZ + 1]).sum(axis=1)))


def determined(rows: Array, before: Array) -> Array:
    """Refitted rows with their normals; those before where no points say."""
    told = (rows[:, COUNT] >= 3) & (rows[:, WEIGHT] > 0)
    out = np.where(told[:, None], rows, before)
    write_normals(out)
    return out


def scatters(rows: Array) -> Array:
    """Weighted scatter of rows about their centroids, shape (N, 3, 3)."""
    xx, xy, xz, yy, yz, zz = rows[:, XX : ZZ + 1].T
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)


def covariances(rows: Array, centre: Array) -> Array:
    """Of (normal, distance) of rows, shape (N, 4, 4).

    From the information on offset and slopes in each plane's own frame; NaN where points in a line
    leave a slope open.
    """
    values, axes = np.linalg.eigh(scatters(rows))
    turn = -axes[:, :, 1:]  # of the normal by the slopes
    at = rows[:, CX : CZ + 1] + centre
    jacobian = np.zeros((len(rows), 4, 3))
    jacobian[:, :3, 1:] = turn
    jacobian[:, 3, 0] = -1.0
    jacobian[:, 3, 1:] = -np.einsum("ne,nes->ns", at, turn)
    open_ended = values[:, 1] <= _IN_LINE * values[:, 2]
    values[open_ended] = np.nan
    variances = np.column_stack((1.0 / rows[:, WEIGHT], 1.0 / values[:, 1:]))
    return np.asarray((jacobian * variances[:, None]) @ jacobian.transpose(0, 2, 1))
