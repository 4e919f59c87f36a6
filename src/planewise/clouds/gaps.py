"""Segments of one plane of a cloud that do not touch: seen through gaps, or ring by ring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise import prices
from planewise.clouds.cells import PRIOR
from planewise.kernels import cloud_segments as kernels
from planewise.kernels.cloud_rows import COUNT, MISFIT
from planewise.runtime import threads

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

_GAP_OFFSET = 0.05  # of the range: where an unrelated plane seen through a gap may lie
_MOST_TOGETHER = 500  # segments, best first, that may pay together
_LEAST_PART = 5_000  # pairs that are worth a thread


def joined_through_gaps(
    rows: Array,
    worth: Array,
    accepted: NDArray[np.bool_],
    parameters: float,
    least: float,
    wander: tuple[float, float],
    range: float,
) -> tuple[Array, Numbers, Array]:
    """Join segments of one plane that do not touch.

    First accepted ones, then to each what is left over and lies on it. What is still left may pay
    together, if clearly: of ground that a LiDAR sees ring by ring no ring need tell a plane, but a
    few pieces of clutter lie on one by chance.

    Parameters
    ----------
    rows : ndarray, shape (n, 18)
        Of the segments (`kernels.cloud_rows`).
    worth : ndarray, shape (n,)
        Nats that each saves, its border paid, and of accepted ones `parameters`, too.
    accepted : ndarray of bool, shape (n,)
        Which pay for being a plane.
    parameters, least : float
        Nats that a plane has to save for its parameters, and beyond its costs.
    wander : (float, float)
        Of the error (`kernels.cloud_rows.compare`).
    range : float
        R in metres.

    Returns
    -------
    planes : ndarray, shape (N, 18)
        Rows of the planes: of what pays, those joined to it left aside.
    owner : ndarray of int, shape (n,)
        Plane of each segment, -1 for none.
    saved : ndarray, shape (N,)
        Nats that each plane saves, all costs paid.
    """
    owner = np.full(len(rows), -1)
    order = np.argsort(-worth, kind="stable")
    chosen, rest = order[accepted[order]], order[~accepted[order] & (worth[order] > 0)]
    if not len(rest) + len(chosen):
        return rows[:0], owner, worth[:0]
    gaps = _Gaps(wander, (0.0, PRIOR[1], (_GAP_OFFSET * range) ** 2), float(np.log(len(rows))))
    planes, owner[chosen] = gaps.merged(rows[chosen])
    owner[rest] = gaps.nearest(planes, rows[rest])
    rest = rest[owner[rest] < 0]
    few = rest[:_MOST_TOGETHER]
    more, of_few = gaps.merged(rows[few])
    # Those that are one plane pay its parameters once, and what they disagree.
    misfit = more[:, MISFIT] - np.bincount(of_few, rows[few, MISFIT], len(more))
    saved = np.bincount(of_few, worth[few], len(more)) - 0.5 * misfit - parameters
    several = np.bincount(of_few, minlength=len(more)) > 1
    fine = prices.fineness(int(rows[:, COUNT].sum()))
    pays = several & (saved > least + prices.price(prices.LEAST, parameters, fine))
    costs = np.zeros(len(planes))
    if pays.any():
        owner[few] = np.where(pays, len(planes) + np.cumsum(pays) - 1, -1)[of_few]
        rest = rest[owner[rest] < 0]
        found = gaps.nearest(more[pays], rows[rest])
        owner[rest] = np.where(found < 0, -1, found + len(planes))
        planes = np.vstack((planes, more[pays]))
        costs = np.append(costs, parameters + 0.5 * misfit[pays])
    kept = owner >= 0
    return planes, owner, np.bincount(owner[kept], worth[kept], len(planes)) - costs


class _Gaps:
    """What is one plane through gaps.

    Parameters
    ----------
    wander : (float, float)
        Of the error.
    prior : (float, float, float)
        As `kernels.cloud_segments.agglomerate` takes it.
    naming : float
        Nats to say which other segment it is.
    """

    def __init__(
        self, wander: tuple[float, float], prior: tuple[float, float, float], naming: float
    ) -> None:
        self.wander, self.prior, self.naming = wander, prior, naming

    def merged(self, rows: Array) -> tuple[Array, Numbers]:
        """Rows of those that are one plane, together, and which of these each is part of."""
        ends, _ = self._pairs(rows, len(rows))
        if not len(ends):
            return rows, np.arange(len(rows))
        planes, root = rows.copy(), np.empty(len(rows), np.int64)
        discords, evidence = pair_values(planes, ends, self.wander, self.prior, 1)
        saved, none = np.full(len(ends), -self.naming), np.zeros(len(rows), np.bool_)
        kernels.agglomerate(
            ends, discords, evidence, saved, planes, self.wander, self.prior, np.inf, none, root
        )
        alive, part = np.unique(root, return_inverse=True)
        return planes[alive], part

    def nearest(self, planes: Array, rows: Array) -> Numbers:
        """Plane that each row lies on best, -1 for none."""
        ends, gains = self._pairs(np.vstack((planes, rows)), len(planes))
        late = ends[:, 1] >= len(planes)
        ends, gains = ends[late], gains[late]
        order = np.argsort(gains, kind="stable")
        out = np.full(len(rows), -1)
        out[ends[order, 1] - len(planes)] = ends[order, 0]  # the best comes last
        return out

    def _pairs(self, rows: Array, planes: int) -> tuple[NDArray[np.int32], Array]:
        most = 4 * len(rows)
        while True:
            ends, gains = np.empty((most, 2), np.int32), np.empty(most)
            found = kernels.pairs_through_gaps(
                rows, self.wander, self.prior, self.naming, planes, ends, gains
            )
            if found <= most:
                return ends[:found], gains[:found]
            most = found


def pair_values(
    rows: Array,
    ends: NDArray[np.int32],
    wander: tuple[float, float],
    prior: tuple[float, float, float],
    workers: int,
) -> tuple[Array, Array]:
    """Discord and evidence of pairs of rows."""
    discords, evidence = np.empty((2, len(ends)))
    threads.over_chunks(
        lambda first, last: kernels.value_pairs(
            rows, ends, wander, prior, first, last, discords, evidence
        ),
        len(ends),
        workers,
        _LEAST_PART,
    )
    return discords, evidence
