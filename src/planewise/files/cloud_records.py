"""Points as rows of a file: of bytes, or of words; what PLY, PCD and XYZ have in common."""

from __future__ import annotations

import csv
from collections.abc import Collection, Iterator
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
_PAGE = 1 << 16  # of memory, at most


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


def too_many(count: int, found: str = "") -> PlanewiseError:
    """Error of a file that claims `count` points and has more, of which `found` tells."""
    mend = "; mend its header" if found else ""
    return PlanewiseError(f"holds more than the {counted(count, 'point')} it claims{found}{mend}")


def check_end(path: Path, end: int, count: int, width: int) -> None:
    """Refuse a file in which whole points are left behind all that its header claims.

    Zeros are none: the Point Cloud Library long stretched its files by a page of memory.

    Parameters
    ----------
    path : Path
        The file.
    end : int
        Where all that it claims ends.
    count, width : int
        How many points it claims, and the bytes of one.
    """
    rest = path.stat().st_size - end
    if rest < width:
        return
    with path.open("rb") as stream:
        stream.seek(end)
        if any(stream.read(_PAGE)):
            raise too_many(count, f": behind them and all else there is room for {rest // width:,}")


def check_last(stream: IO[str], count: int, columns: int, others: int = 0) -> None:
    """Refuse text in which lines of points are left behind `others`, all else that it claims."""
    while line := stream.readline(_LONGEST_LINE):
        text = line.strip()
        if not text or text.startswith(("#", "//")):
            continue
        others -= len(line) < _LONGEST_LINE  # lists may be longer, and come in pieces
        if others < 0 and len(text.split()) >= columns:
            raise too_many(count, ": behind them and all else there are lines of numbers")


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
    stream: IO[str],
    columns: int,
    size: int,
    delimiter: str | None = None,
    count: int | None = None,
    free: Collection[int] = (),
) -> Iterator[NDArray[np.float64]]:
    """Read lines of numbers in blocks; empty ones and comments are skipped.

    A delimiter may end lines, too. Numbers may be in quotes; an empty cell is NaN.

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
    free : collection of int
        Columns that nobody looks at, and which may hold anything; where they do, they are NaN.

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
        # One more than between cells: else the last one is empty.
        if delimiter and block[0].endswith(delimiter) and block[0].count(delimiter) == columns:
            block = [line.removesuffix(delimiter) for line in block]
        yield _numbers(block, columns, delimiter, free, done)
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


def split_words(line: str, delimiter: str | None, columns: int | None = None) -> list[str]:
    """Words of a line, without the quotes around them; beyond `columns` of them no empty one."""
    if '"' not in line:
        words = line.split(delimiter)
    elif delimiter is None:
        words = [word.strip('"') for word in line.split()]
    else:  # quotes may hold a delimiter
        words = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    if len(words) - 1 == columns and not words[-1].strip():
        words.pop()
    return [word.strip() for word in words]


def _numbers(
    lines: list[str], columns: int, delimiter: str | None, free: Collection[int], done: int
) -> NDArray[np.float64]:
    rows = _loaded(lines, delimiter)
    if rows.shape == (len(lines), columns):
        return rows
    table = [split_words(line, delimiter, columns) for line in lines]
    for words in table:  # in quotes, empty or of no matter
        words[:] = ["nan" if not word or k in free else word for k, word in enumerate(words)]
    rows = _loaded([",".join(words) for words in table], ",")
    if rows.shape == (len(lines), columns):
        return rows
    for number, (line, words) in enumerate(zip(lines, table, strict=True), start=done + 1):
        if len(words) != columns or not all(map(is_number, words)):
            shown = line if len(line) <= 60 else line[:57] + "..."
            wanted = counted(columns, "number")
            raise PlanewiseError(
                f"has a bad line of points, number {number:,}: expected {wanted}, got '{shown}'"
            )
    raise PlanewiseError(f"must hold {counted(columns, 'number')} a line")


def _loaded(lines: list[str], delimiter: str | None) -> NDArray[np.float64]:
    """Numbers of lines, and none at all where one holds anything else."""
    if any(map(str.strip, lines)):  # else there is a warning
        with suppress(ValueError):
            return np.loadtxt(lines, delimiter=delimiter, ndmin=2, comments=None)
    return np.empty((0, 0))


def as_stated(numbers: NDArray[np.float64], kind: str, name: str) -> Table:
    """Numbers of text, of the type that the header states; one that it cannot hold is refused."""
    limits = np.finfo(kind) if "f" in kind else np.iinfo(kind)
    held = (numbers >= limits.min) & (numbers <= limits.max)
    wrong = ~held if isinstance(limits, np.iinfo) else ~held & np.isfinite(numbers)
    if wrong.any():
        raise PlanewiseError(
            f"has {name} {numbers[wrong][0]:g}, where its header states {np.dtype(kind).name}"
        )
    return numbers.astype(kind)


def is_number(word: str) -> bool:
    """Whether a word is a number, NaN and infinity included; Python's own 1_000 is none."""
    try:
        float(word)
    except ValueError:
        return False
    return "_" not in word
