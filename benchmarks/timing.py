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


def processors() -> set[int]:
    """Processors this thread may run on; empty where the system does not say."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()


_ALL = processors()


@contextmanager
def one_core() -> Iterator[None]:
    """Stay on one processor, with one thread in NumPy's linear algebra.

    Libraries with threads of their own have to be imported inside: they look then how many
    processors there are, and some of their threads do not follow later.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError):
            stack.enter_context(import_module("threadpoolctl").threadpool_limits(1))
        stack.enter_context(_on({max(_ALL)} if _ALL else set()))
        yield


@contextmanager
def all_cores() -> Iterator[None]:
    """Use every processor, inside `one_core`."""
    with _on(_ALL):
        yield


@contextmanager
def _on(chosen: set[int]) -> Iterator[None]:
    before = processors()
    if before:
        os.sched_setaffinity(0, chosen)
    try:
        yield
    finally:
        if before:
            os.sched_setaffinity(0, before)
