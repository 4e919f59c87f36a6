"""Text: XYZ, TXT, CSV, ASC and PTS, with or without a line of names."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from io import StringIO
from itertools import islice, pairwise
from pathlib import Path
from typing import IO

from planewise.errors import PlanewiseError
from planewise.files.cloud_columns import LOOK, cloud_file, positions, unknown
from planewise.files.cloud_records import is_number, point_lines, read_words, split_words, too_many
from planewise.point_cloud import Array, CloudFile
from planewise.wording import counted

_XYZ = ["x", "y", "z"]
_MAP_NAMES = {
    "x": {"e", "east", "easting"},
    "y": {"n", "north", "northing"},
    "z": {"h", "height", "elev", "elevation"},
}
# Behind a name; it is looked for once in a row of spaces, not behind each of them.
_METRES = re.compile(r"(?<!\s)\s*[\[(]\s*(m|met(re|er)s?)\s*[\])]", re.IGNORECASE)
_FEW = 1000  # rows that tell what most columns are
_FEWEST_NUMBERED = 10  # points whose numbers are no coordinate by chance
_MEETINGS = 5  # of coordinates in one place, where chance has none once in a hundred files


@dataclass(frozen=True, kw_only=True)
class _Layout:
    """Delimiter, names of the columns, lines before the points, and their number if stated."""

    delimiter: str | None
    names: list[str]
    skip: int
    count: int | None


def open_xyz(path: Path) -> CloudFile:
    """Open a text file of points, one a line.

    A first line of names says what the columns are (``//`` or ``#`` may stand before them, lines
    of a title, too); easting, northing and elevation are x, y and z, and what other columns hold
    does not matter. Without names x, y, z come first, then an intensity, or whole numbers up to 255
    as colours, or both; before them, of four columns or more, may stand numbers of the points, and
    columns of text anywhere.
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
            yield from read_words(
                stream, len(layout.names), size, layout.delimiter, count, unknown(layout.names)
            )
            more = False
            if count is not None and (line := next(point_lines(stream), None)) is not None:
                # Of several scans each has a line of its number of points before it.
                if not line.isdecimal():
                    raise too_many(count)
                count, more = int(line), True


def _layout(path: Path) -> _Layout:
    with _open(path) as stream:
        head = list(islice(iter(lambda: stream.readline(1 << 16), ""), LOOK))
    if not any(line.strip() for line in head):
        raise PlanewiseError("is empty")
    if any("\0" in line for line in head):
        raise PlanewiseError("is no text file")
    names: list[str] = []
    count, remarked = None, False
    for before, line in enumerate(head):  # noqa: B007 - used after it
        text = line.strip()
        if not text:
            continue
        bare = text.lstrip("#/").strip()
        delimiter = _delimiter(bare)
        words = split_words(bare, delimiter)
        if len(words) > 1 and not words[-1] and len(words) != len(names):
            words.pop()  # some tools end every line with a delimiter
        if text.startswith(("#", "//")):
            # A comment; names of columns where x, y and z are among them.
            if _have_positions(remark := _names(bare)):
                names, remarked = remark, True
        elif not any(map(_is_text, words)):
            if len(words) == 1 and words[0].isdecimal() and not count:
                count = int(words[0])
                continue
            break
        elif _has_decimal_commas(bare, words):
            raise PlanewiseError(
                f"has numbers with a decimal comma, which are not read: '{text[:60]}'; write them "
                "with a decimal point"
            )
        elif _have_positions(names) and _is_point(words, names):
            break
        elif _have_positions(names) and not remarked:
            raise PlanewiseError(f"has a second line that is no point: '{text[:60]}'")
        elif sum(map(is_number, words)) >= len(_XYZ):
            break
        else:  # names, or a title before them
            names, remarked = _names(bare), False
    else:
        raise PlanewiseError("holds no line of numbers")
    if not names or (remarked and len(names) != len(words)):  # prose, of x, y and z
        names = _usual_names(head[before:], delimiter, len(words))
    elif len(names) != len(words):
        raise PlanewiseError(
            f"names {counted(len(names), 'column')} ({', '.join(names)}), but its points have "
            f"{len(words)}"
        )
    positions(names)
    return _Layout(delimiter=delimiter, names=names, skip=before, count=count)


def _names(line: str) -> list[str]:
    """Names of columns in a line; those of a map's axes as x, y and z."""
    line = _METRES.sub("", line)
    names = split_words(line, _delimiter(line))
    if names[-1:] == [""]:
        names.pop()
    lower = [name.lower() for name in names]
    for axis, others in _MAP_NAMES.items():
        found = [k for k, name in enumerate(lower) if name in others]
        if axis not in lower and len(found) == 1:
            names[found[0]] = axis
    return names


def _have_positions(names: list[str]) -> bool:
    return set(_XYZ) <= {name.lower() for name in names}


def _is_point(words: list[str], names: list[str]) -> bool:
    """Whether words stand for a point, whatever there is in columns of unknown meaning."""
    return len(words) == len(names) and not any(_is_text(words[k]) for k in positions(names))


def _is_text(word: str) -> bool:
    return bool(word) and not is_number(word)


def _has_decimal_commas(line: str, words: list[str]) -> bool:
    """Whether it, or one of its words, is of numbers once their commas are points."""
    if any(_is_text(word) and is_number(word.replace(",", ".", 1)) for word in words):
        return True
    words = line.replace('"', "").replace(";", " ").split()
    pointed = [word.replace(",", ".", 1) for word in words]
    return len(words) > 1 and pointed != words and all(map(is_number, pointed))


def _delimiter(line: str) -> str | None:
    if all(map(is_number, line.split())):
        return None  # spaces, tabs, or both, as from several tools
    return next((each for each in (";", ",", "\t") if each in line), None)


def _usual_names(lines: list[str], delimiter: str | None, columns: int) -> list[str]:
    """Names for columns without any: of text, and as usual of numbers."""

    def rows_of(some: list[str]) -> list[list[str]]:
        points = point_lines(StringIO("".join(some)))
        rows = (split_words(line, delimiter, columns) for line in points)
        return [row for row in rows if len(row) == columns]

    rows = rows_of(lines[:_FEW])
    if any(all(row[k].isdecimal() for row in rows) for k in range(columns - len(_XYZ))):
        rows = rows_of(lines)  # whole numbers before three columns, which may be x or not
    texts = {k for k, word in enumerate(rows[0]) if _is_text(word)}
    texts = {k for k in texts if not any(is_number(row[k]) for row in rows)}
    numbers = [[word for k, word in enumerate(row) if k not in texts] for row in rows]
    usual = iter(_names_of_numbers(numbers))
    return ["text" if k in texts else next(usual) for k in range(columns)]


def _names_of_numbers(rows: list[list[str]]) -> list[str]:
    """[number] x y z [i] [r g b], what is beyond them unknown."""
    columns = len(rows[0])
    if columns < 3:
        raise PlanewiseError(f"has {counted(columns, 'number')} a line; a point has at least three")
    if columns > 3 and _are_numbered(rows):
        return ["number", *_names_of_numbers([row[1:] for row in rows])]
    rest = [f"column {k + 1}" for k in range(3, columns)]
    colours = {6: 3, 7: 4}.get(columns)  # where r, g, b would begin
    if colours is not None and _are_colours(rows, colours):
        rest[-3:] = ["r", "g", "b"]
    if columns in (4, 7):
        rest[0] = "intensity"
    return [*_XYZ, *rest]


def _are_numbered(rows: list[list[str]]) -> bool:
    """Whether the first of four columns or more numbers the points, as surveyors write them.

    Numbers are whole and none is there twice; x, y and z have decimals then, or the numbers count
    from 0 or 1. A raster's x counts, too, but again in each of its rows, in which y stands still.
    What may be either is refused: the wrong one would be nonsense that looks like points.
    """
    words = [row[0] for row in rows]
    if len(words) < _FEWEST_NUMBERED or not all(map(str.isdecimal, words)):
        return False
    numbers = list(map(int, words))
    measured = all(any("." in row[k] for row in rows) for k in (1, 2, 3))
    if len(set(numbers)) == len(numbers):
        counts = numbers[0] <= 1 and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        if (measured or counts) and len({row[1] for row in rows}) > 1:
            return True
        # As many whole coordinates within their extent would have met by chance.
        extent = max(numbers) - min(numbers) + 1
        unsure = len(numbers) * (len(numbers) - 1) / 2 > _MEETINGS * extent
    else:  # numbers of several scans, one after the other?
        steps = zip(pairwise(numbers), pairwise(rows), strict=True)
        counted = sum(b - a == 1 and row[1] != after[1] for (a, b), (row, after) in steps)
        unsure = measured and counted > len(numbers) / 2
    if unsure:
        raise PlanewiseError(
            "has a first column that may be x or numbers of the points; write a line of names "
            "before them, such as 'x y z intensity' or 'number x y z'"
        )
    return False


def _are_colours(rows: list[list[str]], first: int) -> bool:
    words = [word.strip() for row in rows for word in row[first : first + 3]]
    return all(word.isdecimal() and int(word) <= 255 for word in words)
