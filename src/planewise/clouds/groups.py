"""Groups of a cloud: the points of one label in one cube, which its Phi is a sum over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import CloudError
from planewise.clouds.cloud import Cloud
from planewise.kernels import cloud_labels as kernels
from planewise.kernels.cloud_keys import TURN
from planewise.kernels.cloud_rows import ROW

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]


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


def groups_of(cloud: Cloud, labels: Labels, error: CloudError) -> CloudGroups:
    """Groups of the points with these labels, in sorted order."""
    counts = np.empty(len(cloud.cubes), np.int64)
    cloud.over_cubes(
        lambda first, last: kernels.count_groups(labels, cloud.starts, first, last, counts)
    )
    places = np.concatenate((np.zeros(1, np.int64), np.cumsum(counts)))
    rows = cloud.memory.empty((int(places[-1]), ROW))
    label = cloud.memory.empty(int(places[-1]), np.int64)
    variance = error.white * cloud.variance
    cloud.over_cubes(
        lambda first, last: kernels.sum_groups(
            cloud.local, labels, cloud.starts, cloud.cubes, cloud.side, cloud.grid.middle,
            TURN, variance, places, first, last, rows, label,
        )
    )  # fmt: skip
    return CloudGroups(rows, label, places)
