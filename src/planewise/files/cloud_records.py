"""Points as rows of a file: of bytes, or of words; what PLY, PCD and XYZ have in common."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.wording import counted

Table = NDArray[Any]

LONGEST_HEADER = 1 << 20
"""Bytes after which a header that has not ended is none."""

_LONGEST_LINE = 1 << 16


def check_length(path: Path, start: int, count: int, width: int) -> None:
    """Refuse a file that is too short for what its header claims; nothing is allocated for it.

    Parameters
    ----------
    path : Path
        The file.
    start : int
        Where its points begin.
    count, width : int
        How many points there should be, and the bytes of one, at least.
    """
    there = path.stat().st_size - start
    if count * width > there:
        raise PlanewiseError(
            f"is cut short or its header is wrong: it claims {counted(count, 'point')}, "
            f"there is room for {max(there, 0) // width:,}"
        )


def read_rows(path: Path, start: int, count: int, row: np.dtype[Any], size: int) -> Iterator[Table]:
    """Read rows of bytes in blocks, in the machine's byte order.

    Parameters
    ----------
    path, start, count
        As in `check_length`.
    row : dtype
        Structure of a row.
    size : int
        Rows of a block.
    """
    with path.open("rb") as stream:
        stream.seek(start)
        for first in range(0, count, size):
            wanted = min(size, count - first)
            rows = np.frombuffer(stream.read(wanted * row.itemsize), row)
            if len(rows) < wanted:
                raise PlanewiseError(f"is cut short: {first + len(rows):,} of {count:,} points")
            yield rows.astype(row.newbyteorder("="))


def read_words(
    stream: IO[str], columns: int, size: int, delimiter: str | None = None, count: int | None = None
) -> Iterator[NDArray[np.float64]]:
    """Read lines of numbers in blocks; empty ones and comments are skipped.

    A delimiter may end lines, too.

    Parameters
    ----------
    stream : text file
        Where the first line of points begins.
    columns : int
        Numbers of a line.
    size : int
        Lines of a block.
    delimiter : str, optional
        Between numbers; ``None`` means spaces.
    count : int, optional
        Lines that there must be; ``None`` means up to the end.

    Yields
    ------
    ndarray, shape (n, columns)
        Numbers as float64.
    """
    done = 0
    lines = point_lines(stream)
    while count is None or done < count:
        block = list(islice(lines, size if count is None else min(size, count - done)))
        if not block:
            break
        if delimiter is not None and block[0].endswith(delimiter):
            block = [line.removesuffix(delimiter) for line in block]
        yield _numbers(block, columns, delimiter, done)
        done += len(block)
    if count is not None and done < count:
        raise PlanewiseError(f"is cut short: {done:,} of {count:,} points are there")


def point_lines(stream: IO[str]) -> Iterator[str]:
    """Lines that hold something else than a comment; a line without end is no text."""
    while line := stream.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            raise PlanewiseError("holds a line of more than 65,536 characters: it is no text file")
        text = line.strip()
        if text and not text.startswith(("#", "//")):
            yield text


def _numbers(
    lines: list[str], columns: int, delimiter: str | None, done: int
) -> NDArray[np.float64]:
    rows = np.empty((0, 0))
    if any(map(str.strip, lines)):  # else there is a warning
        with suppress(ValueError):
            rows = np.loadtxt(lines, delimiter=delimiter, ndmin=2, comments=None)
    if rows.shape == (len(lines), columns):
        return rows
    for number, line in enumerate(lines, start=done + 1):  # which one is it?
        words = line.split(delimiter)
        if len(words) != columns or not all(map(is_number, words)):
            shown = line if len(line) <= 60 else line[:57] + "..."
            wanted = counted(columns, "number")
            raise PlanewiseError(
                f"has a bad line of points, number {number:,}: expected {wanted}, got '{shown}'"
            )
    raise PlanewiseError(f"must hold {counted(columns, 'number')} a line")


def is_number(word: str) -> bool:
    """Whether a word is a number, NaN and infinity included."""
    try:
        float(word)
    except ValueError:
        return False
    return True
