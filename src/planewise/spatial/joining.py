"""Planes that turn out to be one, once pixels have labels.

A segment of few cells is bent by those that lie across a border, so that the search takes a piece
of a floor for another plane. The groups of Phi tell: on the other's plane its readings do not take
so much more as standing apart costs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.groups import merge_groups
from planewise.kernels.planes import nearest_planes
from planewise.prices import FAR
from planewise.spatial.information import Groups
from planewise.spatial.search import Segmentation

Array = NDArray[np.float64]


def joined(
    groups: Groups, found: Segmentation, worth: Array, price: float
) -> tuple[Groups, Segmentation, NDArray[np.uint16] | None]:
    """Planes with those made one that do not save `price` nats by standing apart.

    Parameters
    ----------
    groups : Groups
        Of the labels; used up where planes are joined.
    found : Segmentation
        Planes and labels.
    worth : ndarray, shape (N,)
        Nats of its own groups on every plane less those on none (`Groups.data`).
    price : float
        Nats that the readings of a plane have to be shorter on it than on the nearest other.

    Returns
    -------
    Groups
    Segmentation
        The same objects where all planes stand apart. Labels are not changed.
    ndarray of uint16, shape (N K + 1,), optional
        What every label has become, ``None`` where all planes stand apart.
    """
    count, planes = groups.sectors.count, len(found.information)
    nearest, far = np.empty(planes, np.intp), np.empty(planes)
    first = np.ascontiguousarray(found.affine[::count])
    nearest_planes(first, found.information, nearest, far)
    near = (far < FAR * price).nonzero()[0]
    if not len(near):
        return groups, found, None
    theirs, by_plane = _groups_of(groups, near), found.affine.reshape(-1, count, 3)
    longer = theirs.data(by_plane[nearest[near]].reshape(-1, 3)).worth - worth[near]
    if longer.min() >= price:
        return groups, found, None
    part = _parts(planes, near, nearest[near], longer - price)
    stays = part == np.arange(planes)
    alive, part = stays.nonzero()[0], (stays.cumsum() - 1)[part]
    place = np.zeros(len(groups.readings), np.uint16)
    place[1:].reshape(-1, count)[:] = 1 + count * part[:, None] + np.arange(count)
    merge_groups(groups.moments, groups.label, groups.first, place)
    together = np.zeros((len(alive), 3, 3))
    np.add.at(together, part, found.information)
    told = found.residual_correlation  # of sparse frames, before; of others it is worked out later
    one = replace(
        found,
        affine=by_plane[alive].reshape(-1, 3),
        information=together,
        significance=np.asarray(np.bincount(part, found.significance), np.float64),
        residual_correlation=told[alive] if len(told) else told,
    )
    readings = np.bincount(place, groups.readings).astype(np.int64)
    return replace(groups, readings=readings), one, place


def _groups_of(groups: Groups, chosen: NDArray[np.intp]) -> Groups:
    """Groups of some planes only, which are 0, 1 ... there."""
    count = groups.sectors.count
    named = np.zeros(len(groups.readings), np.uint16)
    named[1:].reshape(-1, count)[chosen] = 1 + np.arange(len(chosen) * count).reshape(-1, count)
    label = named.take(groups.label[: groups.first[-1]])
    at = (label > 0).nonzero()[0]
    readings = groups.readings[1:].reshape(-1, count)[chosen]
    return replace(
        groups,
        moments=groups.moments.take(at, axis=1),
        label=label[at],
        first=np.array([len(at)], np.int32),
        readings=np.concatenate((np.zeros(1, np.int64), readings.ravel())),
        nats=np.empty((3, len(at))),
    )


def _parts(
    planes: int, small: NDArray[np.intp], large: NDArray[np.intp], more: Array
) -> NDArray[np.intp]:
    """Plane that each becomes part of, the small ones of the large ones that `more` nats favour.

    Those that save most come first, and none becomes part of what is part of another by then.
    """
    part = np.arange(planes)
    for k in np.argsort(more, kind="stable").tolist():
        if more[k] >= 0.0:
            break
        if part[large[k]] == large[k]:
            part[part == small[k]] = large[k]
    return part
