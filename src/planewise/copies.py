"""Points that were copied: exact copies are one reading, however often it is told.

Clouds that were merged hold points twice. A copy has the very error of its original: taken for a
reading of its own it would make cubes too small, and their points too sure of a plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planewise.model import PlaneModel

_COPIED = 1.05  # points a place: where there are more, copies are dropped; fewer make no plane
_DRAWN = 3_000  # points that tell whether there are so many
_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


@dataclass(frozen=True)
class Places:
    """Different points of a cloud.

    Attributes
    ----------
    rows : ndarray of int, shape (n,)
        The first row of the cloud that is at each place.
    of_point : ndarray of int, shape (k,)
        Place of every point.
    """

    rows: NDArray[np.int64]
    of_point: NDArray[np.int64]

    def of_all(self, model: PlaneModel) -> PlaneModel:
        """Return a model of the places, as one of the points."""
        labels = model.labels[self.of_point]
        count = np.bincount(labels, minlength=len(model) + 1)[1:]
        planes = zip(model.planes, count.tolist(), strict=True)
        note, reason = (
            said.replace("finite point", "distinct point")
            for said in (model.note, model.curve.reason)
        )
        return replace(
            model,
            note=note,
            curve=replace(model.curve, reason=reason),
            labels=labels,
            planes=tuple(replace(plane, count=n) for plane, n in planes),
            readings=model.readings + len(self.of_point) - len(self.rows),
        )


def places_of(points: NDArray[np.floating]) -> Places | None:
    """Places of points, contiguous (k, 3); ``None`` where copies are few.

    What is not finite is no copy.
    """
    some = points[_drawn(points)]
    if len(some) <= _COPIED * np.count_nonzero(_sorted(some)[1]):
        return None
    order, new = _sorted(points)
    of_point = np.empty(len(points), np.int64)
    of_point[order] = np.cumsum(new) - 1
    return Places(order[new], of_point)


def _drawn(points: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Some points, by a hash of where they are: all copies of a point or none."""
    share = np.uint64(1 + len(points) // _DRAWN)
    words = points.view(f"u{points.itemsize}").astype(np.uint64, copy=False)
    x, y, z = words.T  # column by column, which is three times as fast as words @ _MIX
    mixed = (x * _MIX[0] + y * _MIX[1] + z * _MIX[2]) * _MIX[0]
    return np.asarray((mixed >> np.uint64(32)) % share == 0)


def _sorted(points: NDArray[np.floating]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Order in which copies of a point follow each other, and which are not one of that before."""
    order = np.lexsort(points.T)
    with np.errstate(invalid="ignore", over="ignore"):
        apart = (np.diff(points[order], axis=0) != 0).any(axis=1)
    return order, np.append(np.ones(min(len(points), 1), np.bool_), apart)
