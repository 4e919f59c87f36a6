"""Taking times on a machine that others use, too: ratios are of calls that are close in time."""

from __future__ import annotations

import contextlib
import gc
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Work = Callable[[], object]
Clock = Callable[[], float]


def elapsed(work: Work, clock: Clock = time.perf_counter) -> float:
    """Milliseconds of one call."""
    start = clock()
    work()
    return 1e3 * (clock() - start)


def times_of(work: Work, runs: int, warm: int = 1) -> Array:
    """Milliseconds of each of `runs` calls, after `warm` that do not count."""
    for _ in range(warm):
        work()
    gc.collect()
    return np.array([elapsed(work) for _ in range(runs)])


def interleaved(
    ours: Work,
    theirs: Work,
    rounds: int,
    repeats: int = 1,
    warm: int = 1,
    clock: Clock = time.perf_counter,
) -> tuple[Array, Array]:
    """Milliseconds of two calls by turns, so that whatever else runs slows both.

    Parameters
    ----------
    ours, theirs : callable
        What is timed.
    rounds : int
        Turns.
    repeats : int
        Calls of `ours` in a turn, of which the median counts.
    warm : int
        Calls of `theirs` that do not count; of `ours`, at least one does not.
    clock : callable
        Gives seconds; `time.process_time` leaves out the time that other processes take.

    Returns
    -------
    tuple of ndarray, shape (rounds,)
        Of `ours` and of `theirs`.
    """
    for work, count in ((ours, max(1, warm)), (theirs, warm)):
        for _ in range(count):
            work()
    gc.collect()
    first, second = np.empty(rounds), np.empty(rounds)
    for turn in range(rounds):
        first[turn] = np.median([elapsed(ours, clock) for _ in range(repeats)])
        second[turn] = elapsed(theirs, clock)
    return first, second


@contextmanager
def one_core() -> Iterator[None]:
    """Stay on one processor, with one thread in the libraries that have pools of their own."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError):
            stack.enter_context(import_module("threadpoolctl").threadpool_limits(1))
        if hasattr(os, "sched_setaffinity"):
            before = os.sched_getaffinity(0)
            os.sched_setaffinity(0, {max(before)})
            stack.callback(os.sched_setaffinity, 0, before)
        yield
