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
from planewise.spatial.information import GroupData, Groups
from planewise.spatial.search import Segmentation

Array = NDArray[np.float64]

_FAR = 40.0  # times its parameters, by the information on it: no plane is another that is so far


def joined(
    groups: Groups, found: Segmentation, data: GroupData, price: float
) -> tuple[Groups, Segmentation, GroupData, NDArray[np.uint16] | None]:
    """Planes with those made one that do not save `price` nats by standing apart.

    Parameters
    ----------
    groups : Groups
        Of the labels; used up where planes are joined.
    found : Segmentation
        Planes and labels.
    data : GroupData
        Of the groups on these planes.
    price : float
        Nats that the readings of a plane have to be shorter on it than on the nearest other.

    Returns
    -------
    Groups
    Segmentation
    GroupData
        The same objects where all planes stand apart. Labels are not changed.
    ndarray of uint16, shape (N K + 1,), optional
        What every label has become, ``None`` where all planes stand apart.
    """
    count, planes = groups.sectors.count, len(found.information)
    nearest, far = np.empty(planes, np.intp), np.empty(planes)
    first = np.ascontiguousarray(found.affine[::count])
    nearest_planes(first, found.information, nearest, far)
    near = (far < _FAR * price).nonzero()[0]
    if not len(near):
        return groups, found, data, None
    more = np.full((planes, planes), np.inf)
    elsewhere = _worth_on(groups, found.affine, near, nearest[near])
    more[near, nearest[near]] = elsewhere - data.worth[near] - price
    if more.min() >= 0.0:
        return groups, found, data, None
    alive, part = np.unique(_parts(more), return_inverse=True)
    named = 1 + count * part[:, None] + np.arange(count)
    place = np.concatenate((np.zeros(1, np.uint16), named.reshape(-1).astype(np.uint16)))
    merge_groups(groups.moments, groups.label, groups.first, place)
    readings = np.zeros(len(alive) * count + 1, np.int64)
    np.add.at(readings, place, groups.readings)
    together = np.zeros((len(alive), 3, 3))
    np.add.at(together, part, found.information)
    one = replace(
        found,
        affine=found.affine.reshape(-1, count, 3)[alive].reshape(-1, 3),
        information=together,
        significance=np.asarray(np.bincount(part, found.significance), np.float64),
    )
    groups = replace(groups, readings=readings)
    return groups, one, groups.data(one.affine), place


def _worth_on(
    groups: Groups, affine: Array, first: NDArray[np.intp], second: NDArray[np.intp]
) -> Array:
    """`GroupData.worth` of the readings of each first plane on the second."""
    count, pairs = groups.sectors.count, len(first)
    named = np.zeros(len(groups.readings), np.uint16)
    of_plane = named[1:].reshape(-1, count)
    of_plane[first] = 1 + np.arange(pairs * count).reshape(pairs, count)
    label = named[groups.label[: groups.first[-1]]]
    at = np.flatnonzero(label)
    readings = groups.readings[1:].reshape(-1, count)[first]
    moved = replace(
        groups,
        moments=np.ascontiguousarray(groups.moments[:, at]),
        label=label[at],
        first=np.array([len(at)], np.int32),
        readings=np.concatenate((np.zeros(1, np.int64), readings.ravel())),
        nats=np.empty((3, len(at))),
    )
    planes = affine.reshape(-1, count, 3)[second]
    return moved.data(planes.reshape(-1, 3)).worth


def _parts(more: Array) -> NDArray[np.intp]:
    """Plane that each becomes part of, itself unless `more` nats are fewer than none."""
    part = np.arange(len(more))
    while more.size and more.min() < 0.0:
        small, large = np.unravel_index(more.argmin(), more.shape)
        part[part == small] = large
        more[small] = more[:, small] = np.inf
    return part
