"""Text: XYZ, TXT, CSV, ASC and PTS, with or without a line of names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import IO

from planewise.errors import PlanewiseError
from planewise.files.cloud_columns import LOOK, cloud_file, positions
from planewise.files.cloud_records import is_number, point_lines, read_words
from planewise.point_cloud import Array, CloudFile
from planewise.wording import counted

_XYZ = ["x", "y", "z"]
_FEWEST_NUMBERED = 10  # points whose numbers are no coordinate by chance


@dataclass(frozen=True, kw_only=True)
class _Layout:
    """Delimiter, names of the columns, lines before the points, and their number if stated."""

    delimiter: str | None
    names: list[str]
    skip: int
    count: int | None


def open_xyz(path: Path) -> CloudFile:
    """Open a text file of points, one a line.

    A first line of names says what the columns are (``//`` or ``#`` may stand before them);
    otherwise x, y, z come first, then an intensity, or whole numbers up to 255 as colours, or both;
    before them, of four columns or more, may stand numbers that count the points.
    A line of one whole number, as in PTS, is the number of points that follow.
    """
    layout = _layout(path)
    positions(layout.names)

    def tables(size: int) -> Iterator[dict[str, Array]]:
        for table in _tables(path, layout, size):
            yield {name: table[:, k] for k, name in enumerate(layout.names)}

    return cloud_file(path, None, tables)


def _open(path: Path) -> IO[str]:
    return path.open(encoding="utf-8-sig", errors="replace")


def _tables(path: Path, layout: _Layout, size: int) -> Iterator[Array]:
    with _open(path) as stream:
        for _ in islice(stream, layout.skip):
            pass
        count, more = layout.count, True
        while more:
            yield from read_words(stream, len(layout.names), size, layout.delimiter, count)
            more = False
            if count is not None and (line := next(point_lines(stream), None)) is not None:
                # Of several scans each has a line of its number of points before it.
                if not line.isdecimal():
                    raise PlanewiseError(f"holds more than the {counted(count, 'point')} it claims")
                count, more = int(line), True


def _layout(path: Path) -> _Layout:
    with _open(path) as stream:
        head = list(islice(iter(lambda: stream.readline(1 << 16), ""), LOOK))
    if not any(line.strip() for line in head):
        raise PlanewiseError("is empty")
    if any("\0" in line for line in head):
        raise PlanewiseError("is no text file")
    names, count, remarked = None, None, False
    for before, line in enumerate(head):  # noqa: B007 - used after it
        text = line.strip()
        bare = text.lstrip("#/").strip()
        if not text:
            continue
        delimiter = _delimiter(bare)
        words = [word.strip().strip('"') for word in bare.split(delimiter)]
        if len(words) > 1 and not words[-1]:
            words.pop()  # some tools end every line with a delimiter
        if text.startswith(("#", "//")):
            # A comment; names of columns where x, y and z are among them.
            if set(_XYZ) <= {word.lower() for word in words}:
                names, remarked = words, True
        elif all(map(is_number, words)):
            if len(words) == 1 and words[0].isdecimal() and count is None:
                count = int(words[0])
                continue
            break
        elif _has_decimal_commas(bare):
            raise PlanewiseError(
                f"has numbers with a decimal comma, which are not read: '{text[:60]}'; write them "
                "with a decimal point"
            )
        elif names is None or remarked:
            names, remarked = words, False
        else:
            raise PlanewiseError(f"has a second line that is no point: '{text[:60]}'")
    else:
        raise PlanewiseError("holds no line of numbers")
    if names is None or (remarked and len(names) != len(words)):  # prose, of x, y and z
        rows = list(islice(point_lines(StringIO("".join(head[before:]))), 1000))
        names = _usual_names([row.split(delimiter) for row in rows], len(words))
    elif len(names) != len(words):
        raise PlanewiseError(
            f"names {counted(len(names), 'column')} ({', '.join(names)}), but its points have "
            f"{len(words)}"
        )
    positions(names)
    return _Layout(delimiter=delimiter, names=names, skip=before, count=count)


def _has_decimal_commas(line: str) -> bool:
    """Whether it is one of numbers once their commas are points."""
    words = line.replace('"', "").replace(";", " ").split()
    pointed = [word.replace(",", ".", 1) for word in words]
    return len(words) > 1 and pointed != words and all(map(is_number, pointed))


def _delimiter(line: str) -> str | None:
    if all(map(is_number, line.split())):
        return None  # spaces, tabs, or both, as from several tools
    return next((each for each in (";", ",", "\t") if each in line), None)


def _usual_names(rows: list[list[str]], columns: int) -> list[str]:
    """Names for columns without: [number] x y z [i] [r g b], what is beyond them unknown."""
    if columns < 3:
        raise PlanewiseError(f"has {counted(columns, 'number')} a line; a point has at least three")
    if columns > 3 and _are_numbered(rows):
        return ["number", *_usual_names([row[1:] for row in rows], columns - 1)]
    rest = [f"column {k + 1}" for k in range(3, columns)]
    colours = {6: 3, 7: 4}.get(columns)  # where r, g, b would begin
    if colours is not None and _are_colours(rows, colours):
        rest[-3:] = ["r", "g", "b"]
    if columns in (4, 7):
        rest[0] = "intensity"
    return [*_XYZ, *rest]


def _are_numbered(rows: list[list[str]]) -> bool:
    """Whether the first column counts the points, as surveyors write them."""
    numbers = [row[0].strip() for row in rows]
    if len(numbers) < _FEWEST_NUMBERED or not all(map(str.isdecimal, numbers)):
        return False
    return [int(each) - int(numbers[0]) for each in numbers] == list(range(len(numbers)))


def _are_colours(rows: list[list[str]], first: int) -> bool:
    words = [word.strip() for row in rows for word in row[first : first + 3]]
    return all(word.isdecimal() and int(word) <= 255 for word in words)
