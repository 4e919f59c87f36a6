"""PTX, text of laser scanners: each scan a grid of points in its own frame, behind its pose."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.files.cloud_columns import cloud_of
from planewise.files.cloud_records import check_length, is_number, read_words
from planewise.files.depth import check_size
from planewise.files.scans import Grid, chosen_scan
from planewise.point_cloud import Array, CloudFile, PointCloud, offset_near
from planewise.wording import counted

Kind = TypeVar("Kind", bound=np.generic)

_HEADER = 1, 1, 3, 3, 3, 3, 4, 4, 4, 4  # numbers of its lines
_NAMES = {
    3: ["x", "y", "z"],
    4: ["x", "y", "z", "intensity"],
    6: ["x", "y", "z", "r", "g", "b"],
    7: ["x", "y", "z", "intensity", "r", "g", "b"],
}
_SHORTEST = 6  # bytes of a line
_CHUNK = 1 << 20
_LONGEST = 1 << 12  # bytes of a line
_SKEW = 1e-3  # by which the axes of a pose may be off those of a rotation
_FULL = 255.0  # of colours


@dataclass(frozen=True, kw_only=True)
class Scan:
    """One of a file's scans.

    Attributes
    ----------
    shape : (columns, rows)
        Of its grid; points are written column by column.
    start : int
        Byte where its points begin.
    names : list of str
        What the numbers of a line are.
    turn, place : ndarray, shapes (3, 3) and (3,)
        A point p of the scanner's frame is p turn + place in that of the file.
    """

    shape: tuple[int, int]
    start: int
    names: list[str]
    turn: Array
    place: Array

    @property
    def count(self) -> int:
        """Points of the grid, those without a return among them."""
        return math.prod(self.shape)


def open_ptx(path: Path) -> CloudFile:
    """Open a PTX file; scan s of its points was taken from ``origins[s]``.

    Points without a return, 0, 0, 0, are left out, so `count` is not stated.
    """
    scans = scans_of(path)
    places = np.array([scan.place for scan in scans])
    offset = offset_near(places.mean(axis=0))

    def blocks(size: int) -> Iterator[PointCloud]:
        for number, scan in enumerate(scans):
            for table in tables_of(path, scan, size):
                yield _cloud(table[table[:, :3].any(axis=1)], scan, number, offset)

    return CloudFile(path=path, count=None, offset=offset, origins=places - offset, blocks=blocks)


def _cloud(table: Array, scan: Scan, number: int, offset: Array) -> PointCloud:
    """Points of a scan where they are in the file's coordinates, less its offset."""
    columns = _columns(table, scan) | {"scan": np.full(len(table), number, np.int32)}
    columns |= zip("xyz", (table[:, :3] @ scan.turn + (scan.place - offset)).T, strict=True)
    return replace(cloud_of(columns, np.zeros(3), full=_FULL), offset=offset)


def _columns(table: Array, scan: Scan) -> dict[str, NDArray[Any]]:
    return {name: table[:, k] for k, name in enumerate(scan.names)}


def grid_of(path: Path, scan: int | None) -> Grid:
    """Image of a scan in its own frame; 0, 0, 0 where there is no point.

    Scanners turn upwards along a column, as a rule, and those of the file are in that order.

    Raises
    ------
    PlanewiseError
        If the file holds several scans and `scan` does not choose.
    """
    scans = scans_of(path)
    chosen = scans[chosen_scan(scan, len(scans))]
    check_size(chosen.count)
    (table,) = tables_of(path, chosen, chosen.count)
    cloud = cloud_of(_columns(table, chosen), np.zeros(3), full=_FULL)

    def grid(values: NDArray[Kind]) -> NDArray[Kind]:
        return values.reshape(*chosen.shape, 3).swapaxes(0, 1)[::-1]

    return grid(cloud.coordinates), None if cloud.colour is None else grid(cloud.colour)


def tables_of(path: Path, scan: Scan, size: int) -> Iterator[Array]:
    """Lines of a scan as numbers, in blocks of so many."""
    with path.open("rb") as stream:
        stream.seek(scan.start)
        with io.TextIOWrapper(stream, encoding="ascii", errors="replace") as text:
            yield from read_words(text, len(scan.names), size, count=scan.count)


def scans_of(path: Path) -> list[Scan]:
    """Scans of a file, whose lines are counted.

    Raises
    ------
    PlanewiseError
        If it is none of PTX, or is cut short.
    """
    scans: list[Scan] = []
    with path.open("rb") as stream:
        while (head := _header(stream, len(scans))) is not None:
            (columns,), (rows,), *_, first, second, third, fourth = head
            shape, start = (_whole(columns), _whole(rows)), stream.tell()
            check_length(path, start, math.prod(shape), _SHORTEST)
            matrix = np.array([first, second, third, fourth])
            turn = matrix[:3, :3]
            if not (
                np.isfinite(matrix).all()
                and np.allclose(matrix[:, 3], (0, 0, 0, 1), atol=_SKEW)
                and np.allclose(turn @ turn.T, np.eye(3), atol=_SKEW)
            ):
                raise PlanewiseError(
                    f"has a pose of scan {len(scans)} that is none; expected a rotation and, in "
                    "its last row, a translation"
                )
            names = _names(stream.readline(_LONGEST))
            stream.seek(start)
            scan = Scan(shape=shape, start=start, names=names, turn=turn, place=matrix[3, :3])
            _skip(stream, scan.count)
            scans.append(scan)
    return scans


def _header(stream: IO[bytes], number: int) -> list[list[float]] | None:
    """Numbers of the lines before a scan; ``None`` at the end of the file."""
    out: list[list[float]] = []
    while len(out) < len(_HEADER):
        line = stream.readline(_LONGEST)
        if not line and not out and number:
            return None
        words = line.decode("ascii", "replace").replace("\0", "?").split()
        if not words and line and not out:
            continue  # between scans
        if len(words) != _HEADER[len(out)] or not all(map(is_number, words)):
            raise PlanewiseError(
                f"has no header of scan {number}: expected {counted(_HEADER[len(out)], 'number')} "
                f"in its line {len(out) + 1}, got '{' '.join(words)[:60]}'"
            )
        out.append(list(map(float, words)))
    return out


def _whole(number: float) -> int:
    if not (number >= 1 and number % 1 == 0):
        raise PlanewiseError(f"claims a grid with a side of {number:g}; expected a whole number")
    return int(number)


def _names(line: bytes) -> list[str]:
    words = line.split()
    if len(words) not in _NAMES:
        raise PlanewiseError(
            f"has {counted(len(words), 'number')} a line; expected x, y, z, then intensity, "
            "colours (r, g, b), or both"
        )
    return _NAMES[len(words)]


def _skip(stream: IO[bytes], lines: int) -> None:
    """Go to the end of so many lines; the last one of the file may have none."""
    left = lines
    while left > 0:
        start = stream.tell()
        chunk = stream.read(_CHUNK)
        if not chunk:
            break
        found = chunk.count(b"\n")
        if found >= left:
            at = -1
            for _ in range(left):
                at = chunk.index(b"\n", at + 1)
            stream.seek(start + at + 1)
            return
        left -= found
    if left > 1:
        raise PlanewiseError(
            f"is cut short: {lines - left:,} of {counted(lines, 'point')} are there"
        )
