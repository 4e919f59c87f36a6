"""Freed memory, kept for the next call."""

from __future__ import annotations

import ctypes
import os
import sys
from functools import cache

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # names of mallopt(3)
_BLOCK = 32 << 20  # bytes: the most that glibc sets the second to by itself, half of the first
_TOLD = ("GLIBC_TUNABLES", "MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_")


@cache
def keep_freed() -> None:
    """Let glibc keep up to 64 MiB that arrays leave behind, unless the environment tells it what.

    Else it may give them back to the system with every call, and fetch them again page by page: up
    to a quarter of the time of the paper's searches at 640 x 480. These are the thresholds that it
    comes to by itself in a process that frees blocks of 32 MiB. Other C libraries do as they do.
    """
    if sys.platform != "linux" or not os.environ.keys().isdisjoint(_TOLD):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _BLOCK)
        mallopt(_TRIM_THRESHOLD, 2 * _BLOCK)
