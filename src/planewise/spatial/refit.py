"""Planes once more, from the groups that Phi is made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.refits import refit_sums
from planewise.spatial.information import GroupData, Groups
from planewise.spatial.segments import affine_planes

Array = NDArray[np.float64]

_LEAST = 1e-6  # of the determinant of information with unit diagonal: less tells no plane


def refitted(groups: Groups, affine: Array, before: GroupData) -> tuple[Array, GroupData]:
    """Planes that describe their groups in fewer nats, labels as they are, and their data.

    One step of expectation and maximisation: every group counts with the information on its plane
    that its random offset and tilt leave, times the probability that it is on it. A plane whose
    data would take more stays.

    Parameters
    ----------
    groups : Groups
        Of the labels.
    affine : ndarray, shape (N K, 3)
        (t0, t1, t2) of w = t0 + t1 x + t2 y, of every plane in every sector.
    before : GroupData
        On these planes, taken last.

    Returns
    -------
    affine : ndarray, shape (N K, 3)
    data : GroupData
        On the planes returned.
    """
    sums = np.empty((len(affine) + 1, 9))
    shared, step, drift, ranging = groups.table
    alone, white, nats = groups.nats[:3]
    refit_sums(
        groups.moments, groups.label[: groups.first[-1]], groups.planes(affine), shared, step,
        drift, ranging, groups.sizes, groups.prior[2], alone, white, nats, sums,
    )  # fmt: skip
    rows = groups.sectors.together(sums[1:])
    told = _told(rows)
    moved = affine.copy()
    moved[told] = affine_planes(rows[told])
    after = groups.data(moved)
    worse = groups.sectors.repeated(after.worth > before.worth)
    if not worse.any():
        return moved, after
    moved[worse] = affine[worse]
    return moved, groups.data(moved)


def _told(rows: Array) -> NDArray[np.bool_]:
    """Whether sums of information determine a plane."""
    a, b, c, d, e, f = rows[:, :6].T
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return np.asarray(determinant > _LEAST * a * d * f)
