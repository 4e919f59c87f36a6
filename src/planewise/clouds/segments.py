"""Segments of a cloud: cells merged by information, and which of them are planes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import PRIOR, CloudCells
from planewise.clouds.curvature import borders_of, curved_segments, nearly_flat
from planewise.clouds.gaps import joined_through_gaps, pair_values
from planewise.clouds.memory import Memory
from planewise.clouds.steps import at_steps
from planewise.kernels import borders, pairs
from planewise.kernels import cloud_segments as kernels
from planewise.kernels.cloud_rows import FREE, MISFIT
from planewise.model import MAX_PLANES
from planewise.ranks import ranks
from planewise.runtime import threads

Array = NDArray[np.float64]

# Nats per point of border where the surface breaks and where it goes on, and the discord half-way.
_MERGE_BORDER = (0.7, 2.0, 8.0)  # that a merge saves
_PLANE_BORDER = (0.01, 1.25, 20.0)  # that a plane has to pay for
_PLANE_COST = 0.6  # times 3 ln(R / eps): what a plane has to save besides its border
_SAME = 7.81  # discord up to which cells of a cube are joined at once: chi^2 of three, 95 %
_LEAST_PART = 5_000  # pairs or cells that are worth a thread
PAIRS_AT_ONCE = 12_000_000  # of cells that merge together; some 1.3 GB
OUTSIDE = -1  # of runs: a pair of cells of two


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
    curved : int
        Segments that are none, for they are pieces of curved surfaces.
    """

    rows: Array
    of_cell: NDArray[np.int64]
    significance: Array
    curved: int = 0

    def without(self, gone: NDArray[np.intp]) -> CloudSegments:
        """All but some planes, whose cells are then on none."""
        keep = np.delete(np.arange(len(self.rows)), gone)
        place = ranks(keep, len(self.rows)).astype(np.int64) - 1
        of_cell = np.append(place[1:], -1)[self.of_cell]
        return CloudSegments(self.rows[keep], of_cell, self.significance[keep], self.curved)


def segments_of(
    cells: CloudCells,
    cost: float,
    range: float,
    *,
    significance: float,
    workers: int,
    memory: Memory | None = None,
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
    significance : float
        Nats that a plane has to save beyond its costs.
    workers : int
        Threads.
    memory : Memory, optional
        Where large arrays lie.
    """
    memory = memory or Memory()
    rows, of_cell, price = merged_cells(cells, cost, workers, memory)
    beside = borders_of(cells, rows, of_cell, PAIRS_AT_ONCE, memory)
    part = nearly_flat(rows, beside)
    if (part < np.arange(len(part))).any():
        kernels.join_parts(rows, part)
        rows, part_of = _roots(rows, part)
        of_cell = part_of[of_cell]
        beside = borders_of(cells, rows, of_cell, PAIRS_AT_ONCE, memory)
    curved = curved_segments(rows, beside)
    rows, of_cell = at_steps(cells, rows, of_cell, curved, cost, workers, PAIRS_AT_ONCE, memory)
    if len(rows) > len(curved):
        beside = borders_of(cells, rows, of_cell, PAIRS_AT_ONCE, memory)
        curved = curved_segments(rows, beside)
    worth, accepted = _accepted(cells, rows, of_cell, price, curved, cost, significance)
    apart = cells.error.of_readings
    planes, owner, total = joined_through_gaps(
        rows, worth, accepted, _PLANE_COST * cost, significance, apart.wander, range
    )
    found = CloudSegments(planes, owner[of_cell], total, int(curved.sum()))
    return found.without(np.argsort(-total, kind="stable")[MAX_PLANES:])


def merged_cells(
    cells: CloudCells, cost: float, workers: int, memory: Memory, at_once: int = PAIRS_AT_ONCE
) -> tuple[Array, NDArray[np.int64], Array]:
    """Rows of segments, the segment of every cell, and what each pair of cells costs as a border.

    Cells of a cube twice as wide that are clearly one plane are joined, then neighbours, what
    saves most first. Where there are more pairs of them than `at_once`, runs merge on their own
    first, all but what is near the rim of its run; what they have become merges with the rest.
    """
    wander = cells.error.wander
    saved, price = memory.empty((2, len(cells.ends)))
    for first in range(0, len(cells.ends), at_once):
        e = slice(first, first + at_once)
        _price_borders(cells, e, workers, saved[e], price[e])
        memory.release()
    rows, of_cell = _joined_siblings(cells, workers)
    between = _between(cells.ends, saved, of_cell, len(rows), at_once)
    memory.release()
    if len(between[0]) > at_once:
        rows, part_of = _merged_in_runs(rows, *between, wander, cost, workers, at_once)
        between = _between(*between, part_of, len(rows), at_once)
        of_cell = part_of[of_cell]
    rows, part_of = _agglomerated(rows, *between, wander, cost, workers)
    return rows, part_of[of_cell], price


def _price_borders(
    cells: CloudCells, part: slice, workers: int, saved: Array, price: Array
) -> None:
    ends, sides = cells.ends[part], cells.sides[part]
    threads.over_chunks(
        lambda first, last: kernels.border_prices(
            cells.rows, ends, sides, cells.error.wander, _MERGE_BORDER, _PLANE_BORDER,
            first, last, saved, price,
        ),
        len(ends), workers, _LEAST_PART,
    )  # fmt: skip


def _joined_siblings(cells: CloudCells, workers: int) -> tuple[Array, NDArray[np.int64]]:
    """Join cells of a cube that are clearly one plane; rows, and which of them each cell is in."""
    rows, root = cells.rows.copy(), np.empty(len(cells.rows), np.int64)
    threads.over_chunks(
        lambda first, last: kernels.join_siblings(
            cells.keys, rows, cells.error.wander, _SAME, first, last, root
        ),
        len(rows), workers, _LEAST_PART,
    )  # fmt: skip
    return _roots(rows, root)


def _roots(rows: Array, root: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Rows that are roots, and which of them each row is part of."""
    alive = root == np.arange(len(root))
    return rows[alive], (np.cumsum(alive) - 1)[root]


def _agglomerated(
    rows: Array,
    ends: NDArray[np.int32],
    saved: Array,
    wander: tuple[float, float],
    cost: float,
    workers: int,
    waits: NDArray[np.bool_] | None = None,
) -> tuple[Array, NDArray[np.int64]]:
    """Merge rows, which are changed, as are ends, saved and waits; as `_roots`."""
    prior = (*PRIOR, 0.0)
    values = pair_values(rows, ends, wander, prior, workers)
    root = np.empty(len(rows), np.int64)
    waits = np.zeros(len(rows), np.bool_) if waits is None else waits
    kernels.agglomerate(ends, *values, saved, rows, wander, prior, cost, waits, root)
    return _roots(rows, root)


def _merged_in_runs(
    rows: Array,
    ends: NDArray[np.int32],
    saved: Array,
    wander: tuple[float, float],
    cost: float,
    workers: int,
    at_once: int,
) -> tuple[Array, NDArray[np.int64]]:
    """Merge one run of rows after the other; those near the rim of theirs stay as they are."""
    runs = max(2, -(-2 * len(ends) // at_once))
    bounds = [len(rows) * run // runs for run in range(runs + 1)]
    part_of, merged, found = np.empty(len(rows), np.int64), [], 0
    inside = _runs_of_pairs(ends, bounds, at_once)
    rim = np.zeros(len(rows), np.bool_)
    rim[ends[np.flatnonzero(inside == OUTSIDE)].ravel()] = True
    for run, (first, last) in enumerate(pairwise(bounds)):
        mine = np.flatnonzero(inside == run)
        e = (ends[mine] - first).astype(np.int32)
        out, of_row = _agglomerated(
            rows[first:last].copy(), e, saved[mine], wander, cost, workers, rim[first:last].copy()
        )
        part_of[first:last] = of_row + found
        merged.append(out)
        found += len(out)
    return np.concatenate(merged), part_of


def _runs_of_pairs(ends: NDArray[np.int32], bounds: list[int], at_once: int) -> NDArray[np.int16]:
    """Run that both cells of a pair are in, OUTSIDE for none."""
    out = np.empty(len(ends), np.int16)
    for first in range(0, len(ends), at_once):
        u, v = (np.searchsorted(bounds, e, "right") for e in ends[first : first + at_once].T)
        out[first : first + at_once] = np.where(u == v, u - 1, OUTSIDE)
    return out


def _between(
    ends: NDArray[np.int32],
    saved: Array,
    part_of: NDArray[np.int64],
    parts: int,
    at_once: int,
) -> tuple[NDArray[np.int32], Array]:
    """Pairs of what rows have become parts of, each once, and the nats of their borders."""
    all_ends, all_nats = [np.empty((0, 2), np.int32)], [np.empty(0)]
    for first in range(0, len(ends), at_once):
        some = slice(first, first + at_once)
        out, nats = np.empty((len(ends[some]), 2), np.int32), np.empty(len(ends[some]))
        found = pairs.pairs_between(ends[some], saved[some], part_of, out, nats)
        all_ends.append(out[:found].copy())
        all_nats.append(nats[:found].copy())
    new_ends, new_nats = np.concatenate(all_ends), np.concatenate(all_nats)
    found = pairs.pairs_once(new_ends, new_nats, parts)
    return new_ends[:found], new_nats[:found]


def _accepted(
    cells: CloudCells,
    rows: Array,
    of_cell: NDArray[np.int64],
    price: Array,
    curved: NDArray[np.bool_],
    cost: float,
    least: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """What each segment saves in nats, and which pay for being a plane; what is curved does not.

    What does not pay is worth what it saves as part of a plane that is paid for.
    """
    border, all_ends, all_nats = np.zeros(len(rows)), [], []
    for first in range(0, len(price), PAIRS_AT_ONCE):
        part = slice(first, first + PAIRS_AT_ONCE)
        ends, nats = np.empty((len(price[part]), 2), np.int32), np.empty(len(price[part]))
        found = kernels.segment_borders(of_cell, cells.ends[part], price[part], border, ends, nats)
        all_ends.append(ends[:found])
        all_nats.append(nats[:found].copy())
    ends = np.concatenate([np.empty((0, 2), np.int32), *all_ends])
    nats = np.concatenate([np.empty(0), *all_nats])
    worth = rows[:, FREE] - 0.5 * rows[:, MISFIT] - _PLANE_COST * cost - border
    worth[curved] = -np.inf
    accepted = np.empty(len(rows), np.bool_)
    borders.accept(worth, ends, nats, least, accepted)
    worth[~accepted] += _PLANE_COST * cost
    return worth, accepted
