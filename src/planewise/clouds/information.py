"""Phi of a cloud under the spatial objective: a code length for any planes and labels.

    Phi = 2 k ln(R / eps) + mask + N * 3 ln(R / eps) + sum over groups of their data

Two coordinates of a point take ln(R / eps) each in any case, nothing where its ray is known; the
third is data: of a group, the
points of one label in one cube, normal about a plane, a random offset and tilt of the group
integrated out; about a smooth surface of its own; or anything at all. As `spatial.information`, but
for the white variance, which is the cloud's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import SHARED, CloudError
from planewise.clouds.cloud import Cloud, over_part
from planewise.information import coordinate_information, plane_information
from planewise.kernels import cloud_information as kernels
from planewise.kernels import cloud_labels as label_kernels
from planewise.kernels.cloud_keys import TURN
from planewise.kernels.cloud_rows import ROW
from planewise.kernels.masks import CODES

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

_SLOPE_PRIOR = 1.0  # inclination of a surface about which nothing is known
_LEAST_PART = 2_000  # groups that are worth a thread
_AT_ONCE = 50_000  # cubes whose labels are looked at together


@dataclass(frozen=True)
class CloudGroups:
    """Groups of a cloud under some labels.

    Attributes
    ----------
    rows : ndarray, shape (g, 18)
        Moments of the points of each (`kernels.cloud_rows`).
    label : ndarray of int, shape (g,)
        0 for none.
    places : ndarray of int, shape (n + 1,)
        Where those of each cube begin.
    """

    rows: Array
    label: NDArray[np.int64]
    places: NDArray[np.int64]


@dataclass(frozen=True)
class CloudLedger:
    """What a model costs.

    Attributes
    ----------
    order : ndarray of int, shape (N,)
        Planes, best first: by worth, unless told otherwise.
    worth, saved : ndarray, shape (N,)
        Nats by which the points of each row are shorter on its plane than on none, and than if each
        of them might be anything at all; negative.
    curve : ndarray, shape (N + 1,)
        Phi with the first 0 ... N planes in this order, the points of the others on none.
    """

    order: NDArray[np.intp]
    worth: Array
    saved: Array
    curve: Array


@dataclass(frozen=True)
class Mask:
    """Labels as a mask code sees them (`kernels.cloud_information.mask_edges`).

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


def groups_of(cloud: Cloud, labels: Labels, error: CloudError) -> CloudGroups:
    """Groups of the points with these labels, in sorted order."""
    counts = np.empty(len(cloud.cubes), np.int64)
    cloud.over_cubes(
        lambda first, last: label_kernels.count_groups(labels, cloud.starts, first, last, counts)
    )
    places = np.concatenate((np.zeros(1, np.int64), np.cumsum(counts)))
    rows = cloud.memory.empty((int(places[-1]), ROW))
    label = cloud.memory.empty(int(places[-1]), np.int64)
    variance = error.white * cloud.variance
    cloud.over_cubes(
        lambda first, last: label_kernels.sum_groups(
            cloud.local, labels, cloud.starts, cloud.cubes, cloud.side, cloud.grid.middle,
            TURN, variance, places, first, last, rows, label,
        )
    )  # fmt: skip
    return CloudGroups(rows, label, places)


def alone_of(cloud: Cloud, groups: CloudGroups, range: float, resolution: float) -> Array:
    """Nats of every group on none."""
    alone: Array = cloud.memory.empty(len(groups.label))
    prior = _prior(range, resolution)
    _over_groups(
        cloud, groups,
        lambda first, last: kernels.groups_alone(
            groups.rows, resolution, prior, first, last, alone
        ),
    )  # fmt: skip
    return alone


def data_of(
    cloud: Cloud,
    groups: CloudGroups,
    alone: Array,
    planes: Array,
    areas: Array,
    error: CloudError,
    range: float,
    resolution: float,
) -> Array:
    """Nats of every group as labelled; alone: on none; planes (N, 4), areas (N,)."""
    data: Array = cloud.memory.empty(len(groups.label))
    table = np.column_stack((planes, np.sqrt(areas)))
    anything = coordinate_information(range, resolution)
    _over_groups(
        cloud, groups,
        lambda first, last: kernels.group_data(
            groups.rows, groups.label, alone, table, (SHARED, error.drift), cloud.side, resolution,
            anything, first, last, data,
        ),
    )  # fmt: skip
    return data


def _over_groups(cloud: Cloud, groups: CloudGroups, work: Callable[[int, int], None]) -> None:
    for begin, end in cloud.runs():
        first, last = int(groups.places[begin]), int(groups.places[end])
        over_part(work, first, last, cloud.workers, _LEAST_PART)


def refitted(
    cloud: Cloud, groups: CloudGroups, alone: Array, data: Array, areas: Array, error: CloudError
) -> Array:
    """Rows (N, 18) of planes through the groups on them, as one step of expectation says."""
    rows = np.zeros((len(areas), ROW))
    drift = 0.113 * error.drift * np.sqrt(areas)
    for begin, end in cloud.runs():
        g = slice(groups.places[begin], groups.places[end])
        kernels.plane_rows(groups.rows[g], groups.label[g], alone[g], data[g], SHARED, drift, rows)
    return rows


def mask_of(cloud: Cloud, labels: Labels, planes: int) -> Mask:
    """Mask of the sorted points with these labels, 1 ... planes and 0."""
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
    return Mask(np.concatenate(all_edges), alike)


def ledger(
    cloud: Cloud,
    mask: Mask,
    groups: CloudGroups,
    alone: Array,
    data: Array,
    range: float,
    resolution: float,
    order: NDArray[np.intp] | None = None,
) -> CloudLedger:
    """Rank planes, by worth or in a given order, with Phi of them all and of the best of them."""
    planes, total = len(mask.alike) - 1, 0.0
    worth, saved, leaving = np.zeros((3, planes + 1))
    anything = coordinate_information(range, resolution)
    for begin, end in cloud.runs():
        g = slice(groups.places[begin], groups.places[end])
        total += kernels.sum_nats(
            groups.rows[g], groups.label[g], alone[g], data[g], anything, worth, saved
        )
    if order is None:
        order = np.argsort(worth[1:], kind="stable")
    place = np.zeros(planes + 1, np.int64)
    place[order + 1] = np.arange(1, planes + 1)
    left, prior = cloud.memory.empty(len(groups.label)), _prior(range, resolution)
    cloud.over_cubes(
        lambda first, last: kernels.groups_left(
            groups.rows, groups.label, groups.places, place, resolution, prior, alone, data,
            first, last, left,
        )
    )  # fmt: skip
    for begin, end in cloud.runs():
        g = slice(groups.places[begin], groups.places[end])
        leaving += np.bincount(groups.label[g], left[g], planes + 1)
    curve = np.full(planes + 1, total)
    # Planes are taken away from the last on.
    curve[:planes] += np.cumsum(leaving[1:][order][::-1])[::-1]
    curve += np.arange(planes + 1) * plane_information(3, range, resolution)
    if not cloud.on_rays:
        curve += 2.0 * len(cloud.local) * anything
    curve += mask.nats(place)
    return CloudLedger(order=order, worth=worth[1:], saved=saved[1:], curve=curve)


def _prior(range: float, resolution: float) -> tuple[float, float, float]:
    coordinate = coordinate_information(range, resolution)
    return _SLOPE_PRIOR**2, coordinate, coordinate
