"""Trials in several processes; what comes back does not depend on how many there are."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.sharedctypes import Synchronized
from typing import TypeVar

import numpy as np

from planewise.camera import PinholeCamera
from planewise.detect import detect_planes
from planewise.errors import PlanewiseError
from planewise.sensor import Sensor

Given = TypeVar("Given")
Got = TypeVar("Got")


def each_in_order(
    work: Sequence[tuple[Callable[[Given], Got], Given]], processes: int
) -> Iterator[Got]:
    """Call every function with its argument in other processes.

    Parameters
    ----------
    work : sequence of (function, argument)
        Functions of modules, and what can be sent to another process.
    processes : int
        How many, at least 1.

    Yields
    ------
    object
        Results in the order of `work`.

    Raises
    ------
    PlanewiseError
        If a process dies.
    """
    if not work:
        return
    compile_once()
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(processes, len(work)), context, _start, (context.Value("i", 0),))
    try:
        for future in [pool.submit(function, argument) for function, argument in work]:
            yield future.result()
    except BrokenProcessPool:
        raise PlanewiseError(
            "processes: one of them ended before its time, perhaps for want of memory; "
            "give a smaller number"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def compile_once() -> None:
    """Have the loops that all frames need compiled, and in this process, before it begins."""
    camera, wall = PinholeCamera(fx=50, fy=50, cx=32, cy=24), np.full((48, 64), 2.0)
    detect_planes(wall, camera, Sensor())
    detect_planes(wall, camera, Sensor(), search="sequential", threads=1)


def _start(started: Synchronized[int]) -> None:
    """Prepare a process: Ctrl-C is the parent's to handle, and every library has one thread.

    Open3D's RANSAC ends early, and with several threads chance would decide on which sample.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["OMP_NUM_THREADS"] = "1"
    if hasattr(os, "sched_setaffinity"):
        with started.get_lock():
            processors = sorted(os.sched_getaffinity(0))
            os.sched_setaffinity(0, {processors[started.value % len(processors)]})
            started.value += 1
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    compile_once()


def _end_with_the_parent() -> None:
    """Do not stay behind where the parent was killed: a pool's processes would wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
