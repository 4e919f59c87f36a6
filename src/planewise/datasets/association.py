"""Lists of things with times, and what belongs together in two of them."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from pathlib import Path

from planewise.datasets.paths import text_of
from planewise.datasets.picture_folder import FrameFiles
from planewise.errors import PlanewiseError

ASSOCIATIONS = "associations.txt"
"""Name of the list of depth images with their pictures."""

_FIRST_TIME = 1e8  # seconds since 1970; no sequence has as many frames

APART = 0.02
"""Seconds by which two readings of one frame may differ, as in the tools of TUM RGB-D."""


def numbered_words(root: Path, name: str) -> Iterator[tuple[int, list[str]]]:
    """Words of the lines of a list that are no comments, with the number of each line.

    Raises
    ------
    PlanewiseError
        If the file cannot be read.
    """
    for number, line in enumerate(text_of(root, name).splitlines(), start=1):
        words = line.replace(",", " ").split()
        if words and not words[0].startswith("#"):
            yield number, words


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
    for number, words in numbered_words(root, name):
        time = _number(words[0])
        if not math.isfinite(time) or len(words) < 2:
            raise PlanewiseError(f"{name}, line {number}: expected a time and a name")
        lines.append((time, words[1:]))
    return sorted(lines, key=lambda line: line[0])


def associations(root: Path) -> list[FrameFiles]:
    """Frames of `ASSOCIATIONS`, as the tools of TUM RGB-D write it, in order of their times.

    Lines are "time depth time picture", or pictures come first. A time may be a number. Ids are the
    names of the depth images.

    Raises
    ------
    PlanewiseError
        If the file cannot be read, or a line is none of these.
    """
    pairs = []
    for time, words in timed_list(root, ASSOCIATIONS):
        if len(words) < 3:
            raise PlanewiseError(f"{ASSOCIATIONS}: expected lines 'time depth time picture'")
        first, beside, second = words[:3]
        if "depth" in second and "depth" not in first:
            time, first, second = _number(beside), second, first
        if not math.isfinite(time):
            raise PlanewiseError(f"{ASSOCIATIONS}: expected a time before {first}, got {beside}")
        pairs.append((time, first, second))
    return [
        FrameFiles(id=Path(depth).stem, depth=depth, rgb=picture, timestamp=time)
        for time, depth, picture in sorted(pairs, key=lambda pair: pair[0])
    ]


def are_timed(frames: Sequence[FrameFiles]) -> bool:
    """Whether `associations` are by times of a clock, not by numbers of frames."""
    return bool(frames) and (frames[0].timestamp or 0.0) >= _FIRST_TIME


def states_times(root: Path, *, named: bool = False) -> bool:
    """Whether there is a list of `associations` that are timed.

    With `named`, files have to be named by times, too, as those of TUM RGB-D are.
    """
    try:
        frames = associations(root)
    except PlanewiseError:
        return False
    return are_timed(frames) and (not named or _number(frames[0].id) > _FIRST_TIME)


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


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan
