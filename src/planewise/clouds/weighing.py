"""What planes of a cloud are worth: refitted to their points, ranked by exact Phi."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise import prices
from planewise.clouds.cells import CloudError
from planewise.clouds.cloud import Cloud
from planewise.clouds.groups import CloudGroups, groups_of
from planewise.clouds.information import CloudLedger, alone_of, data_of, ledger, refitted
from planewise.clouds.masks import Mask, mask_of
from planewise.clouds.rows import determined, planes_of
from planewise.information import plane_information
from planewise.kernels.cloud_rows import AREA
from planewise.sensor import Sensor

Array = NDArray[np.float64]

_ROUNDING = 1e-9  # of Phi


@dataclass(frozen=True)
class CloudPlanes:
    """Planes and labels of the sorted points, before they are ranked.

    Attributes
    ----------
    cloud : Cloud
        The points, in the cubes whose groups Phi is made of.
    labels : ndarray of uint16, shape (k,)
        0 for none, j for row j - 1.
    rows : ndarray, shape (N, 18)
        Of the planes.
    error : CloudError
        Its size.
    significance, correlation : ndarray, shape (N,)
        Nats that each saves, all its costs paid; of the residuals of cells side by side.
    curved : int
        Pieces of curved surfaces, which are none.
    """

    cloud: Cloud
    labels: NDArray[np.uint16]
    rows: Array
    error: CloudError
    significance: Array
    correlation: Array
    curved: int = 0


@dataclass(frozen=True)
class Weighed:
    """Planes refitted to their points, and what Phi says of them.

    Attributes
    ----------
    rows : ndarray, shape (N, 18)
        Of the planes, refitted.
    groups : CloudGroups
        Of the labels.
    book : CloudLedger
        Of all planes, those that do not pay last.
    curve : ndarray
        Phi with the first planes of the book, as far as they pay.
    """

    rows: Array
    groups: CloudGroups
    book: CloudLedger
    curve: Array


def weighed(found: CloudPlanes, sensor: Sensor) -> Weighed:
    """Refit planes to their points, and rank them by exact Phi."""
    cloud, error, limits = found.cloud, found.error, (sensor.range, sensor.resolution)
    areas = found.rows[:, AREA]
    groups = groups_of(cloud, found.labels, error)
    alone = alone_of(cloud, groups, *limits)
    data = data_of(cloud, groups, alone, planes_of(found.rows), areas, error, *limits)
    rows = determined(refitted(cloud, groups, alone, data, areas, error), found.rows)
    now = data_of(cloud, groups, alone, planes_of(rows), areas, error, *limits)
    mask = mask_of(cloud, found.labels, groups, len(rows), error)
    book, curve = _ranked(cloud, mask, groups, alone, now, len(rows), limits)
    return Weighed(rows, groups, book, curve)


def _ranked(
    cloud: Cloud,
    mask: Mask,
    groups: CloudGroups,
    alone: Array,
    data: Array,
    planes: int,
    limits: tuple[float, float],
) -> tuple[CloudLedger, Array]:
    """All planes as the paper ranks them, those that do not pay last; the curve of those that do.

    Those pay whose points are clearly shorter on them, and with which Phi falls when they come
    after all that are worth more.
    """
    by_worth = ledger(cloud, mask, groups, planes, alone, data, *limits)
    fine = prices.fineness(len(cloud.local))
    least = prices.price(prices.LEAST, plane_information(3, *limits), fine)
    clear = int(np.count_nonzero(by_worth.worth < -least))
    phi, first = by_worth.curve[: clear + 1], by_worth.order[:clear]

    def keeping(pays: NDArray[np.intp]) -> tuple[CloudLedger, Array]:
        rest = np.ones(planes, np.bool_)
        rest[pays] = False
        order = np.lexsort((by_worth.saved, rest))
        book = ledger(cloud, mask, groups, planes, alone, data, *limits, order)
        return book, book.curve[: len(pays) + 1]

    best = int(np.argmin(phi))
    book, curve = keeping(first[np.diff(phi) < 0])
    if phi[best] < curve.min() - _ROUNDING * abs(curve[0]):
        # Some pay only together with others that are cut.
        book, curve = keeping(first[:best])
    return book, curve
