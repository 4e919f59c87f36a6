"""The lowest of many scores, exactly, while few readings are looked at: branch and bound.

Readings are cut into runs of neighbours. A run saves nothing on a plane that stays clear of it, and
never more than the sum of its tau, so that the runs near a plane bound its score from below. Planes
whose bound is above a score that another plane is known to reach are out. The others are scored run
by run; every run replaces a bound by its exact gain, and a plane is out as soon as its bound has
risen too far. No plane of the lowest score is ever out, whatever the order: the result is that of
scoring every plane on every reading.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import runs as kernels
from planewise.kernels.readings import score_rays
from planewise.runtime import threads

Array = NDArray[np.float64]
Single = NDArray[np.float32]

_SAMPLE = 512  # readings on which planes compete to be scored first
_FIRST = 16  # planes scored first
_FEWEST_SCORED = 8  # planes that are worth a thread to score, ...
_FEWEST_BOUNDS = 200_000  # ... and runs times planes to bound


@dataclass(frozen=True)
class Runs:
    """Readings on rays in runs of neighbours.

    Attributes
    ----------
    sample : ndarray of float32, shape (5, 256 to 512, or all if fewer)
        a, s and tau of readings from all runs alike.
    data : ndarray of float32, shape (R, 5, RUN)
        a, s and tau of the readings of every run (see `planewise.kernels.readings`).
    box : ndarray of float32, shape (8, R)
        What bounds q = theta . a of a run, and the q at which it gains.
    worth : ndarray of int32, shape (R,)
        Sum of tau of every run in nats, rounded up.
    workers : int
        Threads.
    """

    sample: Single
    data: Single
    box: Single
    worth: NDArray[np.int32]
    workers: int

    @classmethod
    def of(cls, a: Array, s: Array, tau: Array, workers: int) -> Runs:
        """Put readings in runs: a (3, k), s (k,), tau (k,)."""
        order, flat = np.empty(s.size, np.int32), _flattened(a)
        count, of_strip = -(-s.size // kernels.RUN), kernels.STRIP // kernels.RUN
        data = np.empty((count, 5, kernels.RUN), np.float32)
        box, worth = np.empty((8, count), np.float32), np.empty(count, np.int32)

        def put_in_runs(first: int, last: int) -> None:
            kernels.order_rays(flat, s, first, last, order)
            runs = first * of_strip, min(last * of_strip, count)
            kernels.pack_rays(a, s, tau, order, *runs, data, box, worth)

        threads.over_chunks(put_in_runs, -(-s.size // kernels.STRIP), workers)
        every, of_run = -(-count // _SAMPLE), -(-kernels.RUN * count // _SAMPLE)
        some = data[::every, :, ::of_run]  # a few of each run, or one of some
        sample = np.ascontiguousarray(some.swapaxes(0, 1).reshape(5, -1))
        return cls(sample, data, box, worth, workers)

    def lowest(self, parameters: Array) -> tuple[int, float]:
        """Row of the plane of the lowest score (the first of equal ones), and that score.

        Planes of low scores on the sample are scored first; the result does not depend on these.

        Parameters
        ----------
        parameters : ndarray, shape (T, 3)
            theta of each plane; NaN scores zero.
        """
        theta = parameters.astype(np.float32)
        rest, total = np.empty(len(theta), np.int64), np.zeros(len(theta))
        likely = np.empty(len(theta))

        def bound(first: int, last: int) -> None:
            kernels.bound_rays(theta, self.box, self.worth, first, last, rest)
            score_rays(theta, self.sample[:3], *self.sample[3:], first, last, likely)

        threads.over_chunks(
            bound, len(theta), self.workers, max(1, _FEWEST_BOUNDS // len(self.worth))
        )

        def score(chosen: NDArray[np.int64], best: float) -> None:
            threads.over_chunks(
                lambda first, last: kernels.score_runs(
                    theta, self.data, self.box, self.worth, chosen, best, first, last, rest, total
                ),
                chosen.size,
                self.workers,
                _FEWEST_SCORED,
            )

        score(np.argpartition(likely, min(_FIRST, len(likely) - 1))[:_FIRST], np.inf)
        best = float(total.min())
        score(np.flatnonzero((rest > 0) & (total - rest <= best)), best)
        # A plane that is out has a total above best, as its rest is not negative.
        pick = int(np.argmin(total))
        return pick, float(total[pick])


def _flattened(a: Array) -> Array:
    """Rays as (u, v, 1) by which readings are near to each other, whitened as they are.

    Those of a panorama point in all directions: then u and v are azimuth and elevation.
    """
    if a[2].min() > 0:
        return a
    length = np.linalg.norm(a, axis=0)
    around, up = np.arctan2(a[1], a[0]), np.arcsin(np.clip(a[2] / length, -1, 1))
    return np.stack((around * length, up * length, length))
