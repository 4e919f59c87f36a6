"""The spatial search: cells, agglomeration by information, labels near borders.

A mask of connected surfaces is cheap to write down and neighbouring readings share their error, so
neighbours are merged first: two segments become one where the evidence that they are one plane and
the border that disappears outweigh their discord. A plane is accepted where it saves more against a
smooth surface, of which every cell has its own plane, than its parameters and its border cost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planewise.cells import SIDE, Cells
from planewise.frame import Frame
from planewise.information import plane_information
from planewise.kernels import segments as loops
from planewise.kernels.cells import COUNT, FREE, MISFIT, UNIT
from planewise.observation import RayObservation
from planewise.spatial_labels import (
    affine_planes,
    label_planes,
    planes_seen,
    residual_correlation,
)

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

# Nats per pixel of border where the surface breaks and where it goes on, and the discord half-way.
_MERGE_BORDER = (0.7, 2.0, 8.0)  # that a merge saves
_PLANE_BORDER = (0.01, 1.5, 20.0)  # that a plane has to pay for
_PLANE_COST = 3.0  # times 3 ln(R / eps): what a plane has to save besides its border
_FITTED_AWAY = 1.5  # half the mean of chi^2 with three degrees of freedom: what a free plane fits
_SHARE_POWER = 0.25  # cells of few pixels are worth less: the surface about them is one
_WHOLE = 64.0  # pixels of a cell whose error is its own
_GAP_OFFSET = 0.3  # of its depth: where an unrelated plane seen through a gap may lie


@dataclass(frozen=True)
class Segmentation:
    """Planes and labels found by the spatial search.

    Attributes
    ----------
    theta : ndarray, shape (N, 3)
        theta . x = 1 for the points of each plane.
    covariance : ndarray, shape (N, 3, 3)
        Of theta, the error that near readings share included.
    labels : ndarray of uint16, shape (H, W)
        0 for none, j for row j - 1.
    significance : ndarray, shape (N,)
        Nats that each plane saves against a smooth surface, all its costs paid.
    affine : ndarray, shape (N, 3)
        The same planes as w = t0 + t1 x + t2 y (`cells.Frame`).
    residual_correlation : ndarray, shape (N,)
        Of cells side by side on each plane (`spatial_labels`).
    left_out : int
        Planes that pay but are more than was asked for.
    """

    theta: Array
    covariance: Array
    labels: Labels
    significance: Array
    affine: Array
    residual_correlation: Array
    left_out: int = 0


def segment(
    observation: RayObservation,
    frame: Frame,
    cells: Cells | None,
    *,
    instances: bool = False,
    max_planes: int | None = None,
    significance: float = 0.0,
) -> Segmentation:
    """Find planes and labels under the spatial objective.

    Parameters
    ----------
    observation : RayObservation
        Of a depth image.
    frame, cells
        The same readings as images, and their cells.
    instances : bool
        Do not join coplanar segments seen through gaps: each is a surface of its own.
    max_planes : int, optional
        Keep the most significant ones only.
    significance : float
        Nats that a segment has to save beyond its costs.

    Returns
    -------
    Segmentation
    """
    if cells is None:
        return _nothing(observation.shape)
    cost = plane_information(3, observation.range, observation.resolution)
    discords = _border_discords(cells)
    rows, root = _agglomerate(cells, discords, cost)
    accepted, worth = _accept(cells, discords, rows, root, cost, significance)
    planes, owner = _join_through_gaps(cells, rows, accepted, instances)
    left_out = 0 if max_planes is None else max(0, len(planes) - max_planes)
    if max_planes is not None and left_out:
        planes, owner = _most_significant(planes, owner, worth, max_planes)
    if not len(planes):
        return _nothing(observation.shape)
    rows, labels = label_planes(frame, cells, root, accepted, planes, owner, observation)
    kept = owner >= 0
    total = np.bincount(owner[kept], worth[kept], len(planes))
    return replace(
        _compact(cells, rows, labels, np.asarray(total), observation.pixel_size), left_out=left_out
    )


def _agglomerate(cells: Cells, discords: Array, cost: float) -> tuple[Array, NDArray[np.int32]]:
    """Merge neighbouring cells into segments; returns their rows and the root of every unit."""
    rows = cells.rows.copy()
    free = np.empty(len(rows))
    loops.free_prices(rows, cells.drift, cells.offset_prior, cells.slope_prior, free)
    rows[:, FREE] = (free + _FITTED_AWAY) * (rows[:, COUNT] / _WHOLE) ** _SHARE_POWER
    root: NDArray[np.int32] = loops.agglomerate(
        cells.grid.reshape(-1),
        cells.grid.shape[0],
        cells.grid.shape[1],
        _border_prices(discords, _MERGE_BORDER),
        rows,
        cells.drift.copy(),
        cells.offset_prior,
        cells.slope_prior,
        cost,
    )
    return rows, root


def _border_discords(cells: Cells) -> Array:
    """Discord across every side that two units share, -1 elsewhere: to the right, and below."""
    rows, columns = cells.grid.shape
    discords = np.empty((2, rows, columns))
    loops.border_discords(cells.grid.reshape(-1), rows, columns, cells.rows, cells.drift, discords)
    return discords


def _border_prices(discords: Array, bounds: tuple[float, float, float]) -> Array:
    """Nats of every side of a cell as a border: dear where the surface goes on, else cheap."""
    low, high, knee = bounds
    price = low + (high - low) / (1.0 + (discords / knee) ** 2)
    return np.asarray(SIDE * np.where(discords < 0, low, price))


def _accept(
    cells: Cells,
    discords: Array,
    rows: Array,
    root: NDArray[np.int32],
    cost: float,
    least: float,
) -> tuple[NDArray[np.int64], Array]:
    """Roots of the segments that pay for being a plane, best first, and what each saves in nats.

    A border between two planes is paid for once. Every plane makes its neighbours cheaper, so
    adding the ones that pay, until no more do, ends at the same planes in any order.
    """
    owner = np.where(cells.grid >= 0, root[cells.grid], -1)
    prices = _border_prices(discords, _PLANE_BORDER)
    border = np.zeros(len(rows))
    between = []
    for a, b, price in (
        (owner[:, 1:], owner[:, :-1], prices[0, :, :-1]),
        (owner[1:], owner[:-1], prices[1, :-1]),
    ):
        apart = a != b
        a, b, price = a[apart], b[apart], price[apart]
        for side in (a, b):
            segment = side >= 0
            border += np.bincount(side[segment], price[segment], len(rows))
        both = (a >= 0) & (b >= 0)
        between.append((a[both], b[both], price[both]))
    a, b, price = (np.concatenate(part) for part in zip(*between, strict=True))
    ids = np.unique(root)
    alone = np.full(len(rows), -np.inf)
    alone[ids] = rows[ids, FREE] - 0.5 * rows[ids, MISFIT] - _PLANE_COST * cost - border[ids]
    accepted = alone > least
    while True:
        paid = np.bincount(a, price * accepted[b], len(rows))
        paid += np.bincount(b, price * accepted[a], len(rows))
        more = (alone + paid > least) & ~accepted
        if not more.any():
            break
        accepted |= more
    taken = np.flatnonzero(accepted).astype(np.int64)
    worth = np.asarray((alone + paid)[taken], np.float64)
    order = np.argsort(-worth, kind="stable")
    return taken[order], worth[order]


def _join_through_gaps(
    cells: Cells, rows: Array, accepted: NDArray[np.int64], instances: bool
) -> tuple[Array, NDArray[np.int64]]:
    """Join accepted segments of one plane that do not touch; returns planes and owners."""
    planes = rows[accepted].copy()
    owner = np.arange(len(planes))
    if instances or len(planes) < 2:
        return planes, owner
    drift = cells.drift[accepted]
    naming = np.log(len(planes))  # nats to say which other segment it is

    def saved(i: int, j: int) -> float:
        small = i if planes[i, COUNT] < planes[j, COUNT] else j
        offset = (_GAP_OFFSET * planes[small, 6] / planes[small, 0]) ** 2
        local = cells.slope_prior[accepted[small]]
        slow = float(np.sqrt(drift[i] * drift[j]))
        discord, evidence = loops.compare(planes[i], planes[j], slow, offset, local)
        return float(evidence - 0.5 * discord - naming)

    alive = list(range(len(planes)))
    gains = {(i, j): saved(i, j) for i in alive for j in alive if i < j}
    while gains:
        (i, j), best = max(gains.items(), key=lambda pair: pair[1])
        if best <= 0:
            break
        slow = float(np.sqrt(drift[i] * drift[j]))
        planes[i, MISFIT] += loops.compare(planes[i], planes[j], slow, 0.0, 0.0)[0]
        planes[i] += planes[j]
        owner[owner == j] = i
        alive.remove(j)
        gains = {pair: gain for pair, gain in gains.items() if i not in pair and j not in pair}
        gains |= {(min(i, k), max(i, k)): saved(i, k) for k in alive if k != i}
    place = np.full(len(planes), -1)
    place[alive] = np.arange(len(alive))
    return planes[alive], place[owner]


def _most_significant(
    planes: Array, owner: NDArray[np.int64], worth: Array, most: int
) -> tuple[Array, NDArray[np.int64]]:
    """The planes that save most, and owners with -1 for the others' segments."""
    total = np.bincount(owner, worth, len(planes))
    keep = np.sort(np.argsort(-total, kind="stable")[:most])
    place = np.full(len(planes), -1)
    place[keep] = np.arange(len(keep))
    return planes[keep], place[owner]


def _compact(
    cells: Cells, planes: Array, labels: Labels, worth: Array, pixel_size: tuple[float, float]
) -> Segmentation:
    """Leave out planes that lost all their pixels, and turn w = t . (1, x, y) into theta . r."""
    keep = planes_seen(cells, labels, len(planes))
    if len(keep) < len(planes):
        place = np.zeros(len(planes) + 1, np.uint16)
        place[keep + 1] = np.arange(1, len(keep) + 1)
        labels = place[labels]
    affine = affine_planes(planes[keep])
    du, dv = pixel_size
    turn = np.array([[0, 1 / (UNIT * du), 0], [0, 0, 1 / (UNIT * dv)], [1, 0, 0]])
    matrix = planes[keep][:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return Segmentation(
        theta=affine @ turn.T,
        covariance=turn @ np.linalg.inv(matrix) @ turn.T,
        labels=labels,
        significance=worth[keep],
        affine=affine,
        residual_correlation=residual_correlation(cells, labels, affine),
    )


def _nothing(shape: tuple[int, ...]) -> Segmentation:
    return Segmentation(
        theta=np.empty((0, 3)),
        covariance=np.empty((0, 3, 3)),
        labels=np.zeros(shape, np.uint16),
        significance=np.empty(0),
        affine=np.empty((0, 3)),
        residual_correlation=np.empty(0),
    )
