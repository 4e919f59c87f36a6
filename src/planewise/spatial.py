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

from planewise.cells import SIDE, Cells, Frame
from planewise.information import plane_information
from planewise.kernels import labels as label_loops
from planewise.kernels import segments as loops
from planewise.kernels.cells import COUNT, FREE, MISFIT, UNIT
from planewise.observation import RayObservation

Array = NDArray[np.float64]
Labels = NDArray[np.int32]

# Nats per pixel of border where the surface breaks and where it goes on, and the discord half-way.
_MERGE_BORDER = (0.7, 2.0, 8.0)  # that a merge saves
_PLANE_BORDER = (0.01, 1.5, 20.0)  # that a plane has to pay for
_PLANE_COST = 3.0  # times 3 ln(R / eps): what a plane has to save besides its border
_FITTED_AWAY = 1.5  # half the mean of chi^2 with three degrees of freedom: what a free plane fits
_SHARE_POWER = 0.25  # cells of few pixels are worth less: the surface about them is one
_WHOLE = 64.0  # pixels of a cell whose error is its own
_GAP_OFFSET = 0.3  # of its depth: where an unrelated plane seen through a gap may lie
_DIFFERING = 1.0  # nats per neighbouring pixel with another label
_PIXEL_DRIFT = 1.5  # of the drift over 100 pixels: how far a reading may lie from its plane
_SWEEPS = 6
_CREASE_REACH = 5  # pixels beside a border where the two planes are compared
_CREASE_BAND = 4  # pixels about a border that are looked at
_CREASE_SIGMA = 0.05  # pixels by which a border may leave the line of intersection
_CREASE_HIDDEN = 4.0  # standard deviations within which two planes cannot be told apart
_CREASE_FAR = 8.0  # pixels from the line of intersection
_FEWEST_PURE = 4  # cells wholly inside a label that are needed to refit its plane


@dataclass(frozen=True)
class Segmentation:
    """Planes and labels found by the spatial search.

    Attributes
    ----------
    theta : ndarray, shape (N, 3)
        theta . x = 1 for the points of each plane.
    covariance : ndarray, shape (N, 3, 3)
        Of theta, the error that near readings share included.
    labels : ndarray of int32, shape (H, W)
        0 for none, j for row j - 1.
    significance : ndarray, shape (N,)
        Nats that each plane saves against a smooth surface, all its costs paid.
    affine : ndarray, shape (N, 3)
        The same planes as w = t0 + t1 x + t2 y (`cells.Frame`).
    left_out : int
        Planes that pay but are more than was asked for.
    """

    theta: Array
    covariance: Array
    labels: Labels
    significance: Array
    affine: Array
    left_out: int = 0


def segment(
    observation: RayObservation,
    frame: Frame,
    cells: Cells | None,
    *,
    instances: bool = False,
    max_planes: int | None = None,
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

    Returns
    -------
    Segmentation
    """
    if cells is None:
        return _nothing(observation.shape)
    cost = plane_information(3, observation.range, observation.resolution)
    discords = _border_discords(cells)
    rows, root = _agglomerate(cells, discords, cost)
    accepted, worth = _accept(cells, discords, rows, root, cost)
    planes, owner = _join_through_gaps(cells, rows, accepted, instances)
    left_out = 0 if max_planes is None else max(0, len(planes) - max_planes)
    if max_planes is not None and left_out:
        planes, owner = _most_significant(planes, owner, worth, max_planes)
    if not len(planes):
        return _nothing(observation.shape)
    rows, labels = _label(frame, cells, root, accepted, planes, owner, observation)
    kept = owner >= 0
    total = np.bincount(owner[kept], worth[kept], len(planes))
    return replace(
        _compact(rows, labels, np.asarray(total), observation.pixel_size), left_out=left_out
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
    cells: Cells, discords: Array, rows: Array, root: NDArray[np.int32], cost: float
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
    accepted = alone > 0
    while True:
        paid = np.bincount(a, price * accepted[b], len(rows))
        paid += np.bincount(b, price * accepted[a], len(rows))
        more = (alone + paid > 0) & ~accepted
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
    slope = cells.slope_prior[accepted] / cells.offset_prior[accepted]
    naming = np.log(len(planes))  # nats to say which other segment it is

    def saved(i: int, j: int) -> float:
        small = i if planes[i, COUNT] < planes[j, COUNT] else j
        offset = (_GAP_OFFSET * planes[small, 6] / planes[small, 0]) ** 2
        local = cells.offset_prior[accepted[small]] * slope[small]
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


def _affine(rows: Array) -> Array:
    """(t0, t1, t2) of w = t0 + t1 x + t2 y: the plane of every segment row."""
    matrix = rows[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    scale = 1.0 / np.sqrt(np.einsum("nii->ni", matrix))
    scaled = matrix * scale[:, :, None] * scale[:, None, :]
    return np.asarray(scale * np.linalg.solve(scaled, (rows[:, 6:9] * scale)[..., None])[..., 0])


def _label(
    frame: Frame,
    cells: Cells,
    root: NDArray[np.int32],
    accepted: NDArray[np.int64],
    planes: Array,
    owner: NDArray[np.int64],
    observation: RayObservation,
) -> tuple[Array, Labels]:
    """Give every pixel near a border its label, refit the planes, put creases in their place.

    Returns the rows of the refitted planes and the labels.
    """
    height, width = frame.w.shape
    number = np.zeros(len(cells.rows) + 1, np.int32)
    number[accepted] = owner + 1
    coarse = np.where(cells.grid >= 0, number[root[cells.grid]], 0).astype(np.int32)
    labels = np.repeat(np.repeat(coarse, SIDE, 0), SIDE, 1)[:height, :width].copy()
    labels[frame.p == 0] = 0
    affine = np.vstack((np.zeros((1, 3)), _affine(planes)))
    error = cells.error
    slow = error.near * (frame.shared + frame.step) + _PIXEL_DRIFT * error.drift * frame.drift
    null = float(np.log(observation.range / observation.resolution))
    arguments = (frame.p / error.white, frame.x, frame.y, slow)
    label_loops.label_pixels(
        labels,
        _settled(coarse),
        SIDE,
        frame.w,
        *arguments,
        affine,
        _lateral(cells, affine),
        null,
        _DIFFERING,
        _SWEEPS,
    )
    planes = _refit(cells, labels, planes)
    affine = np.vstack((np.zeros((1, 3)), _affine(planes)))
    kinds = np.zeros((len(affine), len(affine)), np.int8)
    label_loops.crease_kinds(labels, affine, frame.x, frame.y, _CREASE_REACH, kinds)
    if kinds.any():
        offset = np.empty((len(affine), len(affine)))
        label_loops.crease_offsets(
            labels,
            affine,
            kinds,
            frame.w,
            *arguments,
            _lateral(cells, affine),
            UNIT,
            _CREASE_BAND,
            _CREASE_SIGMA,
            offset,
        )
        band = np.empty(labels.shape, np.bool_)
        label_loops.crease_band(labels, kinds, _CREASE_BAND, band)
        label_loops.snap_creases(
            labels,
            band,
            affine,
            kinds,
            offset,
            *arguments,
            UNIT,
            _CREASE_HIDDEN,
            _CREASE_FAR,
            2 * _CREASE_BAND,
        )
    return planes, labels


def _settled(coarse: Labels) -> NDArray[np.bool_]:
    """Cells on a plane whose neighbours are on it too: their pixels need no look."""
    padded = np.pad(coarse, 1, mode="edge")
    rows, columns = coarse.shape
    same = coarse > 0
    for i in range(3):
        for j in range(3):
            same &= padded[i : i + rows, j : j + columns] == coarse
    return same


def _lateral(cells: Cells, affine: Array) -> Array:
    """Variance of w by an error of half a pixel across the image, for every plane."""
    slope = affine[:, 1] ** 2 + affine[:, 2] ** 2
    return np.asarray(cells.error.lateral / UNIT**2 * slope)


def _refit(cells: Cells, labels: Labels, planes: Array) -> Array:
    """Rows of the planes once more, from the units that lie wholly inside their label."""
    height, width = labels.shape
    rows, columns = height // SIDE, width // SIDE
    blocks = labels[: rows * SIDE, : columns * SIDE].reshape(rows, SIDE, columns, SIDE)
    low, high = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))
    pure = np.zeros(cells.grid.shape, np.int32)
    pure[:rows, :columns] = np.where(low == high, low, 0)
    there = cells.grid >= 0
    unit, label = cells.grid[there], pure[there]
    least = np.full(len(cells.rows), np.iinfo(np.int32).max, np.int32)
    most = np.zeros(len(cells.rows), np.int32)
    np.minimum.at(least, unit, label)
    np.maximum.at(most, unit, label)
    of_unit = np.where(least == most, most, 0)
    sums = np.zeros((len(planes) + 1, cells.rows.shape[1]))
    np.add.at(sums, of_unit, cells.rows)
    enough = np.bincount(of_unit, minlength=len(planes) + 1)[1:] >= _FEWEST_PURE
    return np.where(enough[:, None], sums[1:], planes)


def _compact(
    planes: Array, labels: Labels, worth: Array, pixel_size: tuple[float, float]
) -> Segmentation:
    """Leave out planes that lost all their pixels, and turn w = t . (1, x, y) into theta . r."""
    count = np.bincount(labels.reshape(-1), minlength=len(planes) + 1)[1:]
    keep = np.flatnonzero(count)
    place = np.zeros(len(planes) + 1, np.int32)
    place[keep + 1] = np.arange(1, len(keep) + 1)
    affine = _affine(planes[keep])
    du, dv = pixel_size
    turn = np.array([[0, 1 / (UNIT * du), 0], [0, 0, 1 / (UNIT * dv)], [1, 0, 0]])
    matrix = planes[keep][:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return Segmentation(
        theta=affine @ turn.T,
        covariance=turn @ np.linalg.inv(matrix) @ turn.T,
        labels=place[labels],
        significance=worth[keep],
        affine=affine,
    )


def _nothing(shape: tuple[int, ...]) -> Segmentation:
    return Segmentation(
        theta=np.empty((0, 3)),
        covariance=np.empty((0, 3, 3)),
        labels=np.zeros(shape, np.int32),
        significance=np.empty(0),
        affine=np.empty((0, 3)),
    )
