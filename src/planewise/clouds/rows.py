"""Planes of rows (`kernels.cloud_rows`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.cloud_rows import CX, CZ, NX, NZ, WEIGHT, XX, ZZ

Array = NDArray[np.float64]


def planes_of(rows: Array) -> Array:
    """(normal, distance) of rows, shape (N, 4), relative to the centre of the cloud."""
    normals = rows[:, NX : NZ + 1]
    return np.column_stack((normals, -(normals * rows[:, CX : CZ + 1]).sum(axis=1)))


def quadratic(scatter: Array, normal: Array) -> Array:
    """n' S n of rows of (xx, xy, xz, yy, yz, zz)."""
    x, y, z = normal.T
    xx, xy, xz, yy, yz, zz = scatter.T
    return np.asarray(
        xx * x * x + yy * y * y + zz * z * z + 2 * (xy * x * y + xz * x * z + yz * y * z)
    )


def covariance(row: Array, centre: Array) -> Array:
    """Of (normal, distance), from the information on offset and slopes in the plane's own frame."""
    xx, xy, xz, yy, yz, zz = row[XX : ZZ + 1]
    scatter = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    values, axes = np.linalg.eigh(scatter)
    inside = axes[:, 1:]
    slopes = np.diag(1.0 / np.maximum(values[1:], 1e-300))
    turn = -inside  # of the normal by the slopes
    at = row[CX : CZ + 1] + centre
    jacobian = np.zeros((4, 3))
    jacobian[:3, 1:] = turn
    jacobian[3, 0] = -1.0
    jacobian[3, 1:] = -at @ turn
    spread = np.zeros((3, 3))
    spread[0, 0], spread[1:, 1:] = 1.0 / row[WEIGHT], slopes
    return np.asarray(jacobian @ spread @ jacobian.T)
