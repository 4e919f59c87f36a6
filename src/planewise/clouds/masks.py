"""Masks of a cloud: nats of its labels with any of its planes.

Where sheets are thin beside the cubes, labels of points are coded one after the other, as in
images. Where they are thick, points near a crease are a mix of labels, so that a name for every
point would cost more than planes save, and the more so the more points there are. There the code is
which planes are in which cube; points of planes that meet in it are told apart by their place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import CloudError
from planewise.clouds.cloud import Cloud
from planewise.clouds.groups import CloudGroups
from planewise.kernels import cloud_masks as kernels
from planewise.kernels.masks import CODES

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

_AT_ONCE = 50_000  # cubes whose labels are looked at together


@dataclass(frozen=True)
class PointMask:
    """Labels as a mask code sees them (`kernels.cloud_masks.mask_edges`).

    Attributes
    ----------
    edges : ndarray of int32, shape (m, 6)
        Labels of neighbours already coded and of the point, where they differ, and how often.
    alike : ndarray of int, shape (N + 1,)
        Points of every label that have the one of all their neighbours.
    """

    edges: NDArray[np.int32]
    alike: NDArray[np.int64]

    def nats(self, place: NDArray[np.int64]) -> Array:
        """Of the first 0 ... N planes, shape (N + 1,), that place (N + 1,) puts in order."""
        lengths, changes = np.empty(len(place)), np.zeros((len(place), CODES), np.int64)
        kernels.mask_lengths(self.edges, self.alike, place, changes, lengths)
        return lengths


@dataclass(frozen=True)
class SheetMask:
    """Labels where sheets are thick: in which cubes planes are, and names where place says none.

    Attributes
    ----------
    cloud, groups
        Of these labels.
    """

    cloud: Cloud
    groups: CloudGroups

    def nats(self, place: NDArray[np.int64]) -> Array:
        """As of `PointMask`."""
        cloud, groups, count = self.cloud, self.groups, len(place)
        changes, lengths = np.zeros((count, kernels.CODES), np.int64), np.empty(count)
        names, left = cloud.memory.empty(len(cloud.cubes)), cloud.memory.empty(len(groups.label))
        cloud.over_cubes(
            lambda first, last: kernels.name_points(
                groups.rows, groups.label, groups.places, place, first, last, names, left
            )
        )
        total, leaving = 0.0, np.zeros(count)  # by place
        for begin, end in cloud.runs():
            g = slice(groups.places[begin], groups.places[end])
            kernels.count_sets(groups.label, groups.places, cloud.about, begin, end, place, changes)
            total += float(names[begin:end].sum())
            leaving += np.bincount(place[groups.label[g]], left[g], count)
        kernels.set_lengths(changes, lengths)
        # Planes are taken away from the last on.
        lengths += total
        lengths[:-1] += np.cumsum(leaving[:0:-1])[::-1]
        return lengths


Mask = PointMask | SheetMask


def mask_of(
    cloud: Cloud,
    labels: Labels,
    groups: CloudGroups,
    planes: int,
    error: CloudError,
) -> Mask:
    """Mask of the sorted points with these labels, 1 ... planes and 0, and their groups."""
    return (
        SheetMask(cloud, groups)
        if cloud.cuts_sheets(error.white)
        else _point_mask(cloud, labels, planes)
    )


def _point_mask(cloud: Cloud, labels: Labels, planes: int) -> PointMask:
    alike, previous = np.zeros(planes + 1, np.int64), 0
    all_edges = [np.empty((0, 6), np.int32)]
    for begin, end in cloud.runs():
        for first in range(begin, end, _AT_ONCE):
            last = min(first + _AT_ONCE, end)
            edges = np.empty((cloud.starts[last] - cloud.starts[first], 6), np.int32)
            found, previous = kernels.mask_edges(
                labels, cloud.starts, cloud.about, first, last, previous, alike, edges
            )
            all_edges.append(edges[:found].copy())
    return PointMask(np.concatenate(all_edges), alike)
