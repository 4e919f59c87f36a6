"""Planes of rows (`kernels.cloud_rows`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.cloud_rows import COUNT, CX, CZ, NX, NZ, WEIGHT, XX, ZZ, write_normals
from planewise.point_observation import UNTOLD

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

    From the information on offset and slopes in each plane's own frame. Scatter along the plane has
    noise in it, too: the variance of a slope is l / (l - noise)^2, that of a principal axis
    (Anderson 1963). NaN where points hardly scatter more along the plane than across it.
    """
    values, axes = np.linalg.eigh(scatters(rows))
    turn = -axes[:, :, 1:]  # of the normal by the slopes
    at = rows[:, CX : CZ + 1] + centre
    jacobian = np.zeros((len(rows), 4, 3))
    jacobian[:, :3, 1:] = turn
    jacobian[:, 3, 0] = -1.0
    jacobian[:, 3, 1:] = -np.einsum("ne,nes->ns", at, turn)
    noise, along = values[:, :1], values[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = along / (along - noise) ** 2
    # Of points in one line rounding is all there is across it.
    told = (slopes[:, 0] < UNTOLD) & (along[:, 0] > _IN_LINE * along[:, 1])
    slopes[~told] = np.nan
    variances = np.column_stack((1.0 / rows[:, WEIGHT], slopes))
    return np.asarray((jacobian * variances[:, None]) @ jacobian.transpose(0, 2, 1))
