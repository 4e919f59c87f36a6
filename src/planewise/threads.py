"""Threads for the compiled loops, which release the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise


def available() -> int:
    """Processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS, Windows
        return os.cpu_count() or 1


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="planewise")


def over_chunks(work: Callable[[int, int], None], size: int, threads: int, least: int = 1) -> None:
    """Call ``work(first, last)`` on consecutive parts of ``range(size)``, one part a thread.

    What `work` writes for one element must not depend on the part it is in: then results are the
    same for any number of threads. Fewer than `least` elements are not worth a thread.
    """
    threads = min(threads, size // least)
    if threads <= 1:
        work(0, size)
        return
    bounds = [size * part // threads for part in range(threads + 1)]
    mine, *others = pairwise(bounds)
    waiting = [_pool(threads - 1).submit(work, *part) for part in others]
    work(*mine)
    for done in waiting:
        done.result()
