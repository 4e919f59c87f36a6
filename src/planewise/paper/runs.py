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
from planewise.runtime import threads

Array = NDArray[np.float64]
Single = NDArray[np.float32]

_SAMPLE = 1024  # readings on which planes compete to be scored first
_FIRST = 8  # planes scored first
_FEWEST_RUNS = 128  # that are worth a thread to put them together ...
_FEWEST_BOUNDS = 200_000  # ... and times planes, to bound them


@dataclass(frozen=True)
class Runs:
    """Readings on rays in runs of neighbours.

    Attributes
    ----------
    sample : ndarray of int, shape (about 1024,)
        Readings from all runs alike.
    data : ndarray of float32, shape (R, 5, RUN)
        a, s and tau of the readings of every run (see `planewise.kernels.readings`).
    box : ndarray of float32, shape (8, R)
        What bounds q = theta . a of a run, and the q at which it gains.
    worth : ndarray of int32, shape (R,)
        Sum of tau of every run in nats, rounded up.
    workers : int
        Threads.
    """

    sample: NDArray[np.int64]
    data: Single
    box: Single
    worth: NDArray[np.int32]
    workers: int

    @classmethod
    def of(cls, a: Array, s: Array, tau: Array, workers: int) -> Runs:
        """Put readings in runs: a (3, k), s (k,), tau (k,)."""
        order = np.empty(s.size, np.int32)
        flat = _flattened(a)
        threads.over_chunks(
            lambda first, last: kernels.order_rays(flat, s, first, last, order),
            -(-s.size // kernels.STRIP),
            workers,
        )
        count = -(-s.size // kernels.RUN)
        data = np.empty((count, 5, kernels.RUN), np.float32)
        box, worth = np.empty((8, count), np.float32), np.empty(count, np.int32)
        threads.over_chunks(
            lambda first, last: kernels.pack_rays(a, s, tau, order, first, last, data, box, worth),
            count,
            workers,
            _FEWEST_RUNS,
        )
        sample = order[:: max(1, s.size // _SAMPLE)].astype(np.int64)
        return cls(sample, data, box, worth, workers)

    def lowest(self, parameters: Array, guess: Array) -> tuple[int, float]:
        """Row of the plane of the lowest score (the first of equal ones), and that score.

        Parameters
        ----------
        parameters : ndarray, shape (T, 3)
            theta of each plane; NaN scores zero.
        guess : ndarray, shape (T,)
            Whose lowest values tell the planes to score first; the result does not depend on it.
        """
        theta = parameters.astype(np.float32)
        rest, total = np.empty(len(theta), np.int64), np.zeros(len(theta))
        threads.over_chunks(
            lambda first, last: kernels.bound_rays(theta, self.box, self.worth, first, last, rest),
            len(theta),
            self.workers,
            max(1, _FEWEST_BOUNDS // len(self.worth)),
        )

        def score(chosen: NDArray[np.int64], best: float) -> None:
            threads.over_chunks(
                lambda first, last: kernels.score_runs(
                    theta, self.data, self.box, self.worth, chosen, best, first, last, rest, total
                ),
                chosen.size,
                self.workers,
                _FIRST,
            )

        score(np.argpartition(guess, min(_FIRST, len(guess) - 1))[:_FIRST], np.inf)
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
