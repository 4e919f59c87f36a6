"""Phi of a cloud under the spatial objective: a code length for any planes and labels.

    Phi = 2 k ln(R / eps) + mask + N * 3 ln(R / eps) + sum over groups of their data

Two coordinates of a point take ln(R / eps) each in any case, nothing where its ray is known; the
third is data: of a group, the points of one label in one cube, normal about a plane, a random
offset and tilt of the group integrated out; about a smooth surface of its own; or anything at all.
As `spatial.information`, but for the white variance, which is the cloud's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import SHARED, CloudError
from planewise.clouds.cloud import Cloud, over_part
from planewise.clouds.groups import CloudGroups
from planewise.clouds.masks import Mask
from planewise.information import coordinate_information, plane_information
from planewise.kernels import cloud_information as kernels
from planewise.kernels.cloud_rows import ROW, WEIGHT, XX, ZZ
from planewise.ranks import ranks

Array = NDArray[np.float64]

_LEAST_PART = 2_000  # groups that are worth a thread


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
    table = np.column_stack((planes, error.about_planes(areas)))
    anything = coordinate_information(range, resolution)
    _over_groups(
        cloud, groups,
        lambda first, last: kernels.group_data(
            groups.rows, groups.label, alone, table, (SHARED, *error.wander), cloud.side,
            resolution, anything, first, last, data,
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
    """Rows (N, 18) of planes through the groups on them, as one step of expectation says.

    Where cubes cut thick sheets, planes go through all the pieces alike, but their information is
    still that of points that share some of their error: what is cut at creases tilts them.
    """
    rows, weights = np.zeros((len(areas), ROW)), np.zeros((len(areas), 2))
    pieces = cloud.cuts_sheets(error.white)
    drift = error.of_readings.about_planes(areas)
    for begin, end in cloud.runs():
        g = slice(groups.places[begin], groups.places[end])
        kernels.plane_rows(
            groups.rows[g], groups.label[g], alone[g], data[g], SHARED, drift, pieces, rows, weights
        )
    if pieces:
        left = np.divide(weights[:, 1], weights[:, 0], np.ones(len(rows)), where=weights[:, 0] > 0)
        rows[:, WEIGHT] *= left
        rows[:, XX : ZZ + 1] *= left[:, None]
    return rows


def ledger(
    cloud: Cloud,
    mask: Mask,
    groups: CloudGroups,
    planes: int,
    alone: Array,
    data: Array,
    range: float,
    resolution: float,
    order: NDArray[np.intp] | None = None,
) -> CloudLedger:
    """Rank planes, by worth or in a given order, with Phi of them all and of the best of them."""
    worth, saved, leaving = np.zeros((3, planes + 1))
    total = 0.0
    anything = coordinate_information(range, resolution)
    for begin, end in cloud.runs():
        g = slice(groups.places[begin], groups.places[end])
        total += kernels.sum_nats(
            groups.rows[g], groups.label[g], alone[g], data[g], anything, worth, saved
        )
    if order is None:
        order = np.argsort(worth[1:], kind="stable")
    place = ranks(order, planes).astype(np.int64)
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
    """What `groups_alone` takes: a surface about which nothing is known is inclined by about 1."""
    coordinate = coordinate_information(range, resolution)
    return 1.0, coordinate, coordinate
