"""Planes of a cloud that turn out to be one, once points have labels.

Along a scanner's rings and lines cells lie so far apart that pieces of one sheet do not merge, and
what cells say of a narrow piece is too little to tell it from the sheet. The groups of Phi tell: on
the other plane its points do not take so much more as standing apart costs. The same as
`spatial.joining` for depth images.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import CloudError
from planewise.clouds.cloud import Cloud
from planewise.clouds.groups import CloudGroups, groups_of
from planewise.clouds.information import alone_of, data_of, refitted
from planewise.clouds.masks import PointMask, mask_of
from planewise.clouds.rows import determined, planes_of
from planewise.information import plane_information
from planewise.kernels import cloud_planes as kernels
from planewise.kernels.cloud_rows import AREA
from planewise.prices import FAR
from planewise.runtime import threads

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

_NAME = 4.0  # nats of a point's name, at most, where two planes mix
_LEAST_PART = 100  # planes that are worth a thread


def joined(
    cloud: Cloud, labels: Labels, rows: Array, error: CloudError, limits: tuple[float, float]
) -> tuple[Array, NDArray[np.intp]]:
    """Planes with those made one that do not save their parameters by standing apart.

    Parameters
    ----------
    cloud : Cloud
        The points.
    labels : ndarray of uint16, shape (k,)
        0 for none, j for row j - 1. Changed to what the planes become: 0 for what is far off that.
    rows : ndarray, shape (N, 18)
        Of the planes.
    error : CloudError
        Its size.
    limits : (float, float)
        Range and resolution in metres.

    Returns
    -------
    ndarray, shape (M, 18)
        Rows of the planes that are left.
    ndarray of int, shape (N,)
        Which of these each has become part of.
    """
    part, fresh = np.arange(len(rows)), np.ones(len(rows), np.bool_)
    error = error.of_readings  # pieces that do not touch do not bend into each other
    while True:
        into = _larger(cloud, labels, rows, fresh, error, limits)
        left, place = np.unique(into, return_inverse=True)
        if len(left) == len(rows):
            return rows, part
        together = np.zeros((len(left), rows.shape[1]))
        kernels.add_rows(rows, place, together)
        rows, part, fresh = together, place[part], np.bincount(place) > 1
        cloud.rename(labels, np.append(0, place + 1).astype(np.uint16))


def _larger(
    cloud: Cloud,
    labels: Labels,
    rows: Array,
    fresh: NDArray[np.bool_],
    error: CloudError,
    limits: tuple[float, float],
) -> NDArray[np.intp]:
    """The plane that each is part of: itself, or the nearest larger one if that makes Phi smaller.

    What one becomes part of becomes part of none itself, until its plane is known. Of what becomes
    part of it, points far off it are left out of labels. fresh (N,): only these, and those that are
    near them, are looked at.
    """
    price, n = plane_information(3, *limits), len(rows)
    into, nearest, far = np.arange(n), np.empty(n, np.intp), np.empty(n)
    threads.over_chunks(
        lambda first, last: kernels.nearest_larger(rows, first, last, nearest, far),
        n, cloud.workers, _LEAST_PART,
    )  # fmt: skip
    near = np.flatnonzero((far < FAR * price) & (fresh | fresh[nearest]))
    if not len(near):
        return into
    groups = groups_of(cloud, labels, error)
    more, off = _more(cloud, groups, rows, near, nearest[near], error, limits)
    more -= price
    names, settled = _Names(cloud, labels, groups, nearest, error), np.zeros(n, np.bool_)
    for k in np.argsort(more, kind="stable"):
        small, large = near[k], nearest[near[k]]
        if settled[small] or into[large] != large:
            continue
        if more[k] < 0.0 or names.save(more[k], into, small):
            into[small], settled[large] = large, True
    gone = np.append(False, into != np.arange(n))
    if not gone.any():
        return into
    cloud.over_cubes(
        lambda first, last: kernels.leave_out(
            groups.label, groups.places, off, gone, cloud.starts, first, last, labels
        )
    )
    return into


def _more(
    cloud: Cloud,
    groups: CloudGroups,
    rows: Array,
    small: NDArray[np.intp],
    large: NDArray[np.intp],
    error: CloudError,
    limits: tuple[float, float],
) -> tuple[Array, NDArray[np.bool_]]:
    """Nats that the points of each small plane take more on the large one, both refitted.

    Infinite where they are shorter on none: what hardly pays takes hardly more anywhere. And which
    groups of the small planes are shorter on none than on the large ones.
    """
    looked_at, mine = np.zeros((2, len(rows) + 1), np.bool_)
    mine[small + 1] = looked_at[small + 1] = looked_at[large + 1] = True
    some = _some(cloud, groups, looked_at)
    alone, areas = alone_of(cloud, some, *limits), rows[:, AREA].copy()

    def data(planes: Array) -> Array:
        return data_of(cloud, some, alone, planes, areas, error, *limits)

    fitted = refitted(cloud, some, alone, data(planes_of(rows)), areas, error)
    planes = planes_of(determined(fitted, rows))
    apart = data(planes)
    planes[small], areas[small] = planes[large], areas[small] + areas[large]
    there = data(planes)
    off: NDArray[np.bool_] = cloud.memory.empty(len(groups.label), np.bool_)
    more, worth = np.zeros((2, len(rows) + 1))
    for begin, end in cloud.runs():
        g = slice(some.places[begin], some.places[end])
        more += np.bincount(some.label[g], there[g] - apart[g], len(more))
        worth += np.bincount(some.label[g], there[g] - alone[g], len(more))
        here = slice(groups.places[begin], groups.places[end])
        off[here] = mine[groups.label[here]]
        off[here][looked_at[groups.label[here]]] &= there[g] >= alone[g]
    return np.where(worth[1:][small] < 0.0, more[1:][small], np.inf), off


def _some(cloud: Cloud, groups: CloudGroups, looked_at: NDArray[np.bool_]) -> CloudGroups:
    """Groups of some labels, looked_at (N + 1,)."""
    places = np.zeros_like(groups.places)
    for begin, end in cloud.runs():
        first, last = groups.places[[begin, end]]
        so_far = np.append(0, np.cumsum(looked_at[groups.label[first:last]]))
        places[begin + 1 : end + 1] = (
            places[begin] + so_far[groups.places[begin + 1 : end + 1] - first]
        )
    rows: Array = cloud.memory.empty((int(places[-1]), groups.rows.shape[1]))
    label: NDArray[np.int64] = cloud.memory.empty(len(rows), np.int64)
    for begin, end in cloud.runs():
        here = slice(groups.places[begin], groups.places[end])
        g, mine = slice(places[begin], places[end]), looked_at[groups.label[here]]
        rows[g], label[g] = groups.rows[here][mine], groups.label[here][mine]
    return CloudGroups(rows, label, places)


class _Names:
    """What it costs to say which points are on which of two planes.

    Two planes where one sheet is share its points, each those that are nearer: so these are shorter
    than all on one, but have to be named.
    """

    def __init__(
        self,
        cloud: Cloud,
        labels: Labels,
        groups: CloudGroups,
        nearest: NDArray[np.intp],
        error: CloudError,
    ) -> None:
        self._mask = mask_of(cloud, labels, groups, len(nearest), error)
        self._nearest, self._mixed = nearest, np.zeros(len(nearest))
        self._into, self._length = np.empty(0, np.intp), 0.0
        if isinstance(self._mask, PointMask):
            kernels.mixed_points(self._mask.edges, nearest, self._mixed)
        else:
            of_cubes = groups.rows, groups.label, groups.places
            kernels.points_together(*of_cubes, nearest, self._mixed)

    def save(self, nats: float, into: NDArray[np.intp], small: int) -> bool:
        """Whether the mask is shorter by more if a plane becomes part of its nearest one, too."""
        if nats > _NAME * self._mixed[small]:
            return False
        if not np.array_equal(into, self._into):
            self._into, self._length = into.copy(), self._length_of(into)
        one = into.copy()
        one[small] = self._nearest[small]
        return self._length - self._length_of(one) > nats

    def _length_of(self, into: NDArray[np.intp]) -> float:
        rank = np.unique(into, return_inverse=True)[1] + 1
        return float(self._mask.nats(np.append(0, rank))[rank.max()])
