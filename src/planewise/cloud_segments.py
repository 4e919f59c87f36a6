"""Segments of a cloud: cells merged by information, and which of them are planes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise import threads
from planewise.cloud_cells import PRIOR, CloudCells
from planewise.kernels import borders
from planewise.kernels import cloud_segments as kernels
from planewise.kernels.cloud_rows import FREE, MISFIT

Array = NDArray[np.float64]

# Nats per point of border where the surface breaks and where it goes on, and the discord half-way.
_MERGE_BORDER = (0.7, 2.0, 8.0)  # that a merge saves
_PLANE_BORDER = (0.01, 1.25, 20.0)  # that a plane has to pay for
_PLANE_COST = 1.0  # times 3 ln(R / eps): what a plane has to save besides its border
_GAP_OFFSET = 0.05  # of the range: where an unrelated plane seen through a gap may lie
_LEAST_PART = 5_000  # pairs that are worth a thread


@dataclass(frozen=True)
class CloudSegments:
    """Planes of a cloud, before its points are labelled.

    Attributes
    ----------
    rows : ndarray, shape (N, 18)
        Of the planes (`kernels.cloud_rows`).
    of_cell : ndarray of int, shape (m,)
        Plane of every cell, -1 for none.
    significance : ndarray, shape (N,)
        Nats that each saves, all its costs paid.
    left_out : int
        Planes that pay but are more than was asked for.
    """

    rows: Array
    of_cell: NDArray[np.int64]
    significance: Array
    left_out: int = 0


def segments_of(
    cells: CloudCells,
    cost: float,
    range: float,
    *,
    instances: bool,
    significance: float,
    max_planes: int,
    workers: int,
) -> CloudSegments:
    """Merge cells into segments and find those that pay for being a plane.

    Parameters
    ----------
    cells : CloudCells
        Of the cloud.
    cost : float
        Nats of the parameters of a plane.
    range : float
        R in metres.
    instances : bool
        Keep coplanar segments that do not touch apart.
    significance : float
        Nats that a plane has to save beyond its costs.
    max_planes : int
        Keep the most significant ones only.
    workers : int
        Threads.
    """
    drift, prior = cells.error.drift, (*PRIOR, 0.0)
    rows, root = cells.rows.copy(), np.empty(len(cells.rows), np.int64)
    discords, evidence = _values(rows, cells.ends, drift, prior, workers)
    saved, price = np.empty((2, len(discords)))
    kernels.border_prices(discords, cells.sides, _MERGE_BORDER, saved)
    kernels.border_prices(discords, cells.sides, _PLANE_BORDER, price)
    kernels.agglomerate(cells.ends, discords, evidence, saved, rows, drift, prior, cost, root)

    alive, of_cell = np.unique(root, return_inverse=True)
    rows = rows[alive]
    worth, accepted = _accepted(cells, rows, of_cell, price, cost, significance)
    owner = np.full(len(rows), -1)
    order = np.argsort(-worth, kind="stable")
    chosen = order[accepted[order]]
    owner[chosen] = np.arange(len(chosen))
    planes = rows[chosen]
    if len(chosen) and not instances:
        rest = order[~accepted[order] & (worth[order] + _PLANE_COST * cost > 0)]
        planes = _joined_through_gaps(planes, rows, chosen, rest, drift, range, owner)
    kept = owner >= 0
    total = np.asarray(np.bincount(owner[kept], worth[kept], len(planes)), np.float64)
    left_out = max(0, len(planes) - max_planes)
    if left_out:
        keep = np.sort(np.argsort(-total, kind="stable")[:max_planes])
        place = np.full(len(planes) + 1, -1)
        place[keep] = np.arange(len(keep))
        planes, owner, total = planes[keep], place[owner], total[keep]
    return CloudSegments(planes, owner[of_cell], total, left_out)


def _values(
    rows: Array,
    ends: NDArray[np.int32],
    drift: float,
    prior: tuple[float, float, float],
    workers: int,
) -> tuple[Array, Array]:
    """Discord and evidence of pairs of rows."""
    discords, evidence = np.empty((2, len(ends)))
    threads.over_chunks(
        lambda first, last: kernels.value_pairs(
            rows, ends, drift, prior, first, last, discords, evidence
        ),
        len(ends),
        workers,
        _LEAST_PART,
    )
    return discords, evidence


def _accepted(
    cells: CloudCells,
    rows: Array,
    of_cell: NDArray[np.int64],
    price: Array,
    cost: float,
    least: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """What each segment saves in nats, and which pay for being a plane."""
    border, nats = np.empty(len(rows)), np.empty(len(price))
    pairs = np.empty((len(price), 2), np.int32)
    found = kernels.segment_borders(of_cell, cells.ends, price, border, pairs, nats)
    worth = rows[:, FREE] - 0.5 * rows[:, MISFIT] - _PLANE_COST * cost - border
    accepted = np.empty(len(rows), np.bool_)
    borders.accept(worth, pairs[:found], nats[:found], least, accepted)
    return worth, accepted


def _joined_through_gaps(
    planes: Array,
    rows: Array,
    chosen: NDArray[np.int64],
    rest: NDArray[np.int64],
    drift: float,
    range: float,
    owner: NDArray[np.int64],
) -> Array:
    """Join planes that do not touch, then to each what is left over and lies on it.

    Writes the plane of each segment to owner, and returns their rows.
    """
    prior = (0.0, PRIOR[1], (_GAP_OFFSET * range) ** 2)
    naming = float(np.log(len(rows)))  # nats to say which other segment it is
    planes = planes.copy()
    ends, _ = _gaps(planes, len(planes), drift, prior, naming)
    root = np.arange(len(planes))
    if len(ends):
        discords, evidence = _values(planes, ends, drift, prior, 1)
        saved = np.full(len(ends), -naming)
        kernels.agglomerate(ends, discords, evidence, saved, planes, drift, prior, np.inf, root)
    alive, plane_of = np.unique(root, return_inverse=True)
    planes = planes[alive]
    owner[chosen] = plane_of
    ends, gains = _gaps(np.vstack((planes, rows[rest])), len(planes), drift, prior, naming)
    late = ends[:, 1] >= len(planes)
    ends, gains = ends[late], gains[late]
    order = np.argsort(gains, kind="stable")
    owner[rest[ends[order, 1] - len(planes)]] = ends[order, 0]  # the best comes last
    return planes


def _gaps(
    rows: Array, planes: int, drift: float, prior: tuple[float, float, float], least: float
) -> tuple[NDArray[np.int32], Array]:
    most = 4 * len(rows)
    while True:
        ends, gains = np.empty((most, 2), np.int32), np.empty(most)
        found = kernels.pairs_through_gaps(rows, drift, prior, least, planes, ends, gains)
        if found <= most:
            return ends[:found], gains[:found]
        most = found
