"""Lists of things with times, and what belongs together in two of them."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from pathlib import Path

from planewise.datasets.paths import text_of
from planewise.errors import PlanewiseError

APART = 0.02
"""Seconds by which two readings of one frame may differ, as in the tools of TUM RGB-D."""


def timed_list(root: Path, name: str) -> list[tuple[float, list[str]]]:
    """Lines of a list of TUM RGB-D: a time in seconds, then words.

    Returns
    -------
    list of (float, list of str)
        In order of time.

    Raises
    ------
    PlanewiseError
        If the file cannot be read, or a line is none of these.
    """
    lines = []
    for number, line in enumerate(text_of(root, name).splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            time = float(words[0])
        except ValueError:
            time = math.nan
        if not math.isfinite(time) or len(words) < 2:
            raise PlanewiseError(f"{name}, line {number}: expected a time and a name")
        lines.append((time, words[1:]))
    return sorted(lines, key=lambda line: line[0])


def nearest(times: Sequence[float], time: float, apart: float = APART) -> int | None:
    """Number of the nearest of some times in ascending order; ``None`` where none is near.

    Parameters
    ----------
    times : sequence of float
        Seconds, ascending.
    time : float
        Seconds.
    apart : float
        Seconds that they may differ by.
    """
    after = bisect_left(times, time)
    near = [at for at in (after - 1, after) if 0 <= at < len(times)]
    best = min(near, key=lambda at: abs(times[at] - time), default=None)
    return best if best is not None and abs(times[best] - time) <= apart else None
