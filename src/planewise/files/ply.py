"""PLY: points from ASCII and binary files of either byte order, and binary files written.

The format is a few lines of text and rows of numbers (Turk, "The PLY Polygon File Format", 1994).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.files.cloud_columns import cloud_file, positions
from planewise.files.cloud_records import (
    LONGEST_HEADER,
    as_stated,
    check_end,
    check_last,
    check_length,
    point_lines,
    read_rows,
    read_words,
)
from planewise.point_cloud import Array, CloudFile

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
_NAMES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint",
          "f4": "float", "f8": "double"}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, kw_only=True)
class _Element:
    """Rows of one kind: how many, and name and type of each number; lists have no fixed width."""

    name: str
    count: int
    fields: dict[str, str]
    lists: bool = False

    def row(self, order: str) -> np.dtype[Any]:
        return np.dtype([(name, order + kind) for name, kind in self.fields.items()])


@dataclass(frozen=True, kw_only=True)
class _Header:
    order: str
    elements: list[_Element]
    start: int  # byte after it


def open_ply(path: Path) -> CloudFile:
    """Open a PLY file; its element `vertex` is the cloud, `camera` (as PCL writes) the scanner."""
    header = _read_header(path)
    before = []
    for vertex in header.elements:
        if vertex.name == "vertex":
            break
        before.append(vertex)
    else:
        raise PlanewiseError("holds no element named vertex, which is where PLY has its points")
    if vertex.lists:
        raise PlanewiseError("has lists in its points; a point has one number of each kind")
    after = header.elements[len(before) + 1 :]
    names = list(vertex.fields)
    positions(names)
    if not header.order:
        lines = sum(element.count for element in before)
        check_length(path, header.start, lines, 1)
        check_length(path, header.start, vertex.count, 2 * len(names))
        return _ascii(path, header, vertex, lines, sum(element.count for element in after))
    if any(element.lists for element in before):
        raise PlanewiseError("has lists before its points; write the element vertex first")
    row = vertex.row(header.order)
    start = header.start + _bytes_of(before, header.order)
    check_length(path, start, vertex.count, row.itemsize)
    end = start + vertex.count * row.itemsize
    if not any(each.count and each.lists for each in after):  # lists are of any length
        rest = _bytes_of(after, header.order)
        check_end(path, end + rest, vertex.count, row.itemsize)

    def tables(size: int) -> Iterator[dict[str, NDArray[Any]]]:
        for rows in read_rows(path, start, vertex.count, row, size):
            yield {name: rows[name] for name in names}

    origin = _camera(path, header.order, after, end)
    return cloud_file(path, vertex.count, tables, origin)


def _bytes_of(elements: Iterable[_Element], order: str) -> int:
    """How many bytes elements without lists have."""
    return sum(each.count * each.row(order).itemsize for each in elements)


def _ascii(path: Path, header: _Header, vertex: _Element, before: int, after: int) -> CloudFile:
    names = list(vertex.fields)
    at = positions(names)

    def words(size: int) -> Iterator[NDArray[np.float64]]:
        with path.open("rb") as stream:
            stream.seek(header.start)
            with _as_text(stream) as text:
                lines = point_lines(text)
                for _ in range(before):
                    next(lines, None)
                yield from read_words(text, len(names), size, count=vertex.count)
                check_last(text, vertex.count, len(names), after)

    def tables(size: int) -> Iterator[dict[str, NDArray[Any]]]:
        for table in words(size):
            columns = dict(zip(names, table.T, strict=True))
            # The file has decimals, which float64 keeps better whatever the header says of x, y, z.
            for k, (name, kind) in enumerate(vertex.fields.items()):
                if k not in at and np.isfinite(columns[name]).all():
                    columns[name] = as_stated(columns[name], kind, name)
            yield columns

    return cloud_file(path, vertex.count, tables)


def _as_text(stream: IO[bytes]) -> Any:
    import io

    return io.TextIOWrapper(stream, encoding="ascii", errors="replace")


def _camera(path: Path, order: str, after: list[_Element], end: int) -> Array | None:
    """Place of the scanner, where the element `camera` follows the points."""
    for element in after:
        row = element.row(order)
        names = ("view_px", "view_py", "view_pz")
        if element.name == "camera" and not element.lists and set(names) <= set(row.names or ()):
            if not element.count or path.stat().st_size < end + row.itemsize:
                return None
            place = next(read_rows(path, end, 1, row, 1))[0]
            origin = np.array([float(place[name]) for name in names])
            return origin if np.isfinite(origin).all() else None
        if element.lists:
            return None
        end += element.count * row.itemsize
    return None


def _read_header(path: Path) -> _Header:
    with path.open("rb") as stream:
        head = stream.read(LONGEST_HEADER)
    ending = re.search(rb"^end_header\b", head, re.MULTILINE)  # comments may hold the word, too
    if head[:3] != b"ply" or ending is None:
        raise PlanewiseError("is no PLY file: its header does not begin or end as it should")
    end = ending.start()
    start = head.find(b"\n", end) + 1
    if start == 0:
        raise PlanewiseError("is cut short: its header has no end")
    order, elements = None, []
    for line in head[:end].decode("ascii", "replace").splitlines()[1:]:
        words = line.split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, _] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, number] if number.isdecimal():
                elements.append(_Element(name=name, count=int(number), fields={}))
            case ["property", "list", _, _, name] if elements:
                last = elements.pop()
                elements.append(
                    _Element(name=last.name, count=last.count, fields=last.fields, lists=True)
                )
            case ["property", kind, name] if elements and kind in _TYPES:
                if name in elements[-1].fields:
                    raise PlanewiseError(f"has two properties named {name}")
                elements[-1].fields[name] = _TYPES[kind]
            case _:
                raise PlanewiseError(f"has a header line that is not PLY: '{line.strip()[:60]}'")
    if order is None:
        raise PlanewiseError(f"states no format; expected one of {', '.join(_ORDERS)}")
    return _Header(order=order, elements=elements, start=start)


def write_ply(
    path: Path, count: int, blocks: Iterable[Mapping[str, NDArray[Any]]], comments: Iterable[str]
) -> None:
    """Write points as binary PLY.

    Parameters
    ----------
    path : Path
        New file.
    count : int
        Points in all.
    blocks : iterable of mapping of str to ndarray, shape (n,)
        Columns by name, the same names and types in every block.
    comments : iterable of str
        Lines for the header.
    """
    written, row = 0, None
    with path.open("wb") as stream:
        for columns in blocks:
            if row is None:
                kinds = {name: each.dtype.newbyteorder("<") for name, each in columns.items()}
                row = np.dtype(list(kinds.items()))
                stream.write(_header_of(count, row, comments))
            rows = np.empty(len(next(iter(columns.values()))), row)
            for name, each in columns.items():
                rows[name] = each
            rows.tofile(stream)
            written += len(rows)
        if row is None:
            nothing = np.dtype([(name, "<f4") for name in "xyz"])
            stream.write(_header_of(0, nothing, comments))
    if written != count:
        raise PlanewiseError(f"{path.name}: {written:,} points came where {count:,} were announced")


def _header_of(count: int, row: np.dtype[Any], comments: Iterable[str]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {each}" for each in comments)]
    return "\n".join([*lines, *vertex_header(count, row), "end_header\n"]).encode()


def vertex_header(count: int, row: np.dtype[Any]) -> list[str]:
    """Header lines of points whose rows have this structure."""
    kinds = [(each, row[each].str[1:]) for each in row.names or ()]
    return [
        f"element vertex {count}",
        *(f"property {_NAMES[kind]} {each}" for each, kind in kinds),
    ]
