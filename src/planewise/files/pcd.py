"""PCD, the files of the Point Cloud Library: ascii, binary and binary_compressed."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.files.cloud_columns import COLOUR, cloud_file, positions
from planewise.files.cloud_records import (
    LONGEST_HEADER,
    as_stated,
    check_end,
    check_last,
    check_length,
    read_rows,
    read_words,
)
from planewise.point_cloud import Array, CloudFile

_KINDS = {("F", 4), ("F", 8)} | {(kind, size) for kind in "IU" for size in (1, 2, 4, 8)}
_LARGEST_RATIO = 132  # LZF writes at most 264 bytes for two


@dataclass(frozen=True, kw_only=True)
class _Header:
    """Field names (some ``_``, padding), their types and counts; points and where they begin.

    Organised points have the shape of their image.
    """

    fields: list[str]
    kinds: list[str]
    counts: list[int]
    points: int
    shape: tuple[int, int] | None
    encoding: str
    start: int
    origin: Array | None

    @property
    def row(self) -> np.dtype[Any]:
        """Structure of a point; names that are there twice, and padding, get a number."""
        names = [f"{k} {name}" for k, name in enumerate(self.fields)]
        return np.dtype(
            [
                (name, "<" + kind) if n == 1 else (name, "<" + kind, (n,))
                for name, kind, n in zip(names, self.kinds, self.counts, strict=True)
            ]
        )


def open_pcd(path: Path) -> CloudFile:
    """Open a PCD file; its viewpoint, unless it is the default, is where the scanner stood."""
    header = _read_header(path)
    positions([name for name in header.fields if name != "_"])

    def tables(size: int) -> Iterator[Mapping[str, NDArray[Any]]]:
        if header.encoding == "ascii":
            return _ascii(path, header, size)
        if header.encoding == "binary":
            rows = read_rows(path, header.start, header.points, header.row, size)
            return (_columns(header, block) for block in rows)
        return _unpacked(path, header, size)

    width = 2 * sum(header.counts) if header.encoding == "ascii" else header.row.itemsize
    if header.encoding != "binary_compressed":
        check_length(path, header.start, header.points, width)
    if header.encoding == "binary":
        check_end(path, header.start + header.points * width, header.points, width)
    return cloud_file(path, header.points, tables, header.origin, header.shape)


def _columns(header: _Header, rows: NDArray[Any]) -> dict[str, NDArray[Any]]:
    out = {}
    for k, name in enumerate(header.fields):
        column = rows[f"{k} {name}"]
        if column.ndim > 1:
            continue
        if name in ("rgb", "rgba") and column.dtype.itemsize == 4:
            packed = np.ascontiguousarray(column).view(np.uint32)
            for colour, shift in zip(COLOUR, (16, 8, 0), strict=True):
                out[colour] = (packed >> shift & 255).astype(np.uint8)
        else:
            out[name] = column
    return out


def _ascii(path: Path, header: _Header, size: int) -> Iterator[Mapping[str, NDArray[Any]]]:
    first = np.cumsum([0, *header.counts])
    with path.open("rb") as stream:
        stream.seek(header.start)
        with io.TextIOWrapper(stream, encoding="ascii", errors="replace") as text:
            for table in read_words(text, int(first[-1]), size, count=header.points):
                rows = np.empty(len(table), header.row)
                out = {}
                for k, name in enumerate(header.fields):
                    column = table[:, first[k]]
                    if name in ("rgb", "rgba") and header.counts[k] == 1:
                        # Three bytes, written as the number that their bits are.
                        rows[f"{k} {name}"] = as_stated(column, header.kinds[k], name)
                    elif header.counts[k] == 1:
                        out[name] = column
                packed = [name for name in header.fields if name in ("rgb", "rgba")]
                colours = _columns(header, rows) if packed else {}
                yield out | {name: colours[name] for name in COLOUR if name in colours}
            check_last(text, header.points, int(first[-1]))


def _unpacked(path: Path, header: _Header, size: int) -> Iterator[Mapping[str, NDArray[Any]]]:
    """One field after the other in one packed piece, which has to be unpacked as a whole."""
    row = header.row
    with path.open("rb") as stream:
        stream.seek(header.start)
        head = stream.read(8)
        if len(head) < 8:
            raise PlanewiseError("is cut short: its packed points are missing")
        packed_size, size_there = struct.unpack("<II", head)
        packed = np.frombuffer(stream.read(packed_size), np.uint8)
    wanted = header.points * row.itemsize
    if packed.size < packed_size:
        raise PlanewiseError(f"is cut short: {packed.size:,} of {packed_size:,} packed bytes")
    if size_there != wanted or wanted > _LARGEST_RATIO * packed_size:
        raise PlanewiseError(
            f"is damaged: it claims {header.points:,} points, {wanted:,} bytes, where its packed "
            f"part of {packed_size:,} bytes states {size_there:,}"
        )
    from planewise.kernels.lzf import unpack

    data = np.empty(wanted, np.uint8)
    if unpack(packed, data) != wanted:
        raise PlanewiseError("is damaged: its packed points cannot be unpacked")
    columns, at = {}, 0
    for name in row.names or ():
        kind = row[name]
        columns[name] = data[at : at + header.points * kind.itemsize].view(kind.base).reshape(
            header.points, *kind.shape
        )  # fmt: skip
        at += header.points * kind.itemsize
    for first in range(0, header.points, size):
        block = slice(first, min(first + size, header.points))
        rows = np.empty(block.stop - first, row)
        for name, column in columns.items():
            rows[name] = column[block]
        yield _columns(header, rows)


def _read_header(path: Path) -> _Header:
    with path.open("rb") as stream:
        head = stream.read(LONGEST_HEADER)
    found: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in found:
        end = head.find(b"\n", start)
        if end < 0:
            raise PlanewiseError("is no PCD file, or cut short: its header has no line DATA")
        words = head[start:end].decode("ascii", "replace").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            found[words[0].upper()] = words[1:]
    fields = found.get("FIELDS", found.get("COLUMNS"))
    if not fields:
        raise PlanewiseError("is no PCD file: its header names no FIELDS")
    sizes = _numbers(found, "SIZE", ["4"] * len(fields))
    counts = _numbers(found, "COUNT", ["1"] * len(fields))
    types = [each.upper() for each in found.get("TYPE", ["F"] * len(fields))]
    if not len(fields) == len(sizes) == len(types) == len(counts):
        raise PlanewiseError(
            f"has {len(fields)} FIELDS, but {len(sizes)} of SIZE, {len(types)} of TYPE and "
            f"{len(counts)} of COUNT"
        )
    for kind in zip(types, sizes, strict=True):
        if kind not in _KINDS:
            raise PlanewiseError(f"has a field of unknown TYPE and SIZE: {kind[0]} {kind[1]}")
    if not all(1 <= count <= 65536 for count in counts):
        raise PlanewiseError(f"has a COUNT that is none: {' '.join(found['COUNT'])}")
    width, height = (_numbers(found, name, ["1"])[0] for name in ("WIDTH", "HEIGHT"))
    points = _numbers(found, "POINTS", [str(width * height)])[0]
    if "WIDTH" in found and points != width * height:
        raise PlanewiseError(f"claims {points:,} POINTS, but {width:,} x {height:,} of them")
    encoding = " ".join(found["DATA"]).lower()
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise PlanewiseError(f"has DATA of unknown kind: '{encoding[:40]}'")
    return _Header(
        fields=fields,
        kinds=[t.lower() + str(size) for t, size in zip(types, sizes, strict=True)],
        counts=counts,
        points=points,
        shape=(height, width) if min(height, width) > 1 else None,
        encoding=encoding,
        start=start,
        origin=_origin(found.get("VIEWPOINT", [])),
    )


def _numbers(found: Mapping[str, list[str]], name: str, default: list[str]) -> list[int]:
    words = found.get(name, default)
    if not words or not all(word.isdecimal() for word in words):
        raise PlanewiseError(f"has a header line that is not PCD: {name} {' '.join(words)[:60]}")
    return [int(word) for word in words]


def _origin(viewpoint: list[str]) -> Array | None:
    """Translation of a viewpoint; that of the default says nothing, for all writers put it in."""
    try:
        place = np.array([float(word) for word in viewpoint[:3]])
    except ValueError:
        raise PlanewiseError(f"has a VIEWPOINT that is none: {' '.join(viewpoint)[:60]}") from None
    return place if place.shape == (3,) and place.any() and np.isfinite(place).all() else None
