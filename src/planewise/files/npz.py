"""NumPy: one array (`.npy`), or an archive of arrays (`.npz`)."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.files.cloud_columns import LOOK, cloud_of, eight_bits, full_colour
from planewise.files.npy import array_header
from planewise.point_cloud import Array, CloudFile, PointCloud, less, offset_of

_POINTS = ("points", "xyz", "arr_0")
_COLOUR = ("colour", "color", "colours", "colors", "rgb")
_COLUMNS = ("intensity", "gt", "labels", "label", "plane", "scan")
_MOST_COLUMNS = 32  # of a cloud; more are an image
_PACKED_ANYHOW = 10_000_000  # points that are read from however few bytes; grids pack well


_Member = tuple[Callable[[], IO[bytes]], int]  # a stream of it, and its bytes


class _Rows:
    """Rows of an array in a stream, read a few at a time; each column of a Fortran one apart."""

    def __init__(self, opened: Callable[[], IO[bytes]], size: int, stack: ExitStack) -> None:
        stream = stack.enter_context(opened())
        self.shape, fortran, self.dtype = array_header(stream)
        if self.dtype.kind not in "fiub":
            raise PlanewiseError(
                f"holds an array of shape {self.shape} and type {self.dtype}; expected numbers"
            )
        if len(self.shape) == 2 and self.shape[1] > _MOST_COLUMNS:
            raise PlanewiseError(
                f"holds rows of {self.shape[1]} numbers, not points; planes of a depth image are "
                "what 'planewise detect' finds"
            )
        start = stream.tell()
        there, wanted = size - start, math.prod(self.shape) * self.dtype.itemsize
        if wanted > there:
            raise PlanewiseError(
                f"is cut short or its header is wrong: it claims {wanted:,} bytes of an array, "
                f"{there:,} are there"
            )
        self._streams = [stream]
        if fortran and len(self.shape) == 2:
            for column in range(1, self.shape[1]):
                other = stack.enter_context(opened())
                other.seek(start + column * self.shape[0] * self.dtype.itemsize)
                self._streams.append(other)

    def read(self, count: int) -> NDArray[Any]:
        """Read the next `count` rows."""
        width = math.prod(self.shape[1:]) // len(self._streams)
        parts = []
        for stream in self._streams:
            data = stream.read(count * width * self.dtype.itemsize)
            if len(data) < count * width * self.dtype.itemsize:
                raise PlanewiseError("is cut short")
            parts.append(np.frombuffer(data, self.dtype))
        if len(parts) > 1:
            return np.stack(parts, axis=1)
        return parts[0].reshape(count, *self.shape[1:])


def open_npy(path: Path) -> CloudFile:
    """Open an array of shape (k, 3) or more columns; x, y, z come first, the rest is not used."""
    members: dict[str, _Member] = {"points": (lambda: path.open("rb"), path.stat().st_size)}
    return _opened(path, members, np.zeros(3), None)


def open_npz(path: Path) -> CloudFile:
    """Open an archive of `points` and what else `PointCloud` has, by its names.

    `offset`, three numbers that were subtracted from the points, is kept; `origins`, rows of three,
    are where the scanner stood, relative to the offset.
    """
    with zipfile.ZipFile(path) as archive:
        found = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}

        def small(name: str, shape: tuple[int, ...]) -> Array | None:
            if name not in found:
                return None
            with ExitStack() as stack:
                rows = _Rows(lambda: archive.open(found[name]), found[name].file_size, stack)
                if rows.shape[-1:] != (3,) or len(rows.shape) != len(shape):
                    raise PlanewiseError(f"has {name} of shape {rows.shape}; expected {shape}")
                if math.prod(rows.shape) > 3_000_000:
                    raise PlanewiseError(f"has {name} of shape {rows.shape}, which is too large")
                return rows.read(rows.shape[0]).astype(np.float64).reshape(rows.shape)

        offset, origins = small("offset", (3,)), small("origins", (-1, 3))

    def opened(info: zipfile.ZipInfo) -> Callable[[], IO[bytes]]:
        def stream() -> IO[bytes]:
            # A stream of its own for every array: an archive serves one at a time well. The file
            # stays open until the stream is closed.
            with zipfile.ZipFile(path) as archive:
                return archive.open(info)

        return stream

    members = {name: (opened(info), info.file_size) for name, info in found.items()}
    return _opened(path, members, np.zeros(3) if offset is None else offset, origins)


def _opened(
    path: Path,
    members: Mapping[str, _Member],
    stated: Array,
    origins: Array | None,
) -> CloudFile:
    key = next((name for name in _POINTS if name in members), None)
    if key is None:
        names = ", ".join(sorted(members)) or "none"
        raise PlanewiseError(f"must hold an array named 'points'; it holds {names}")
    colour = next((name for name in _COLOUR if name in members), None)
    beside = [name for name in _COLUMNS if name in members]

    with ExitStack() as stack:
        points = _Rows(*members[key], stack)
        if len(points.shape) != 2 or points.shape[1] < 3 or points.dtype.kind not in "fiu":
            raise PlanewiseError(
                f"must hold points of shape (k, 3), got {points.dtype} of shape {points.shape}"
            )
        count = points.shape[0]
        if count > max(_PACKED_ANYHOW, 8 * path.stat().st_size):  # not a bit for each
            raise PlanewiseError(
                f"claims {count:,} points, which cannot be in a file of its size; if they are, "
                "write it without compression (numpy.savez)"
            )
        for name in (*beside, *([colour] if colour else [])):
            shape = _Rows(*members[name], stack).shape
            if shape != ((count, 3) if name == colour else (count,)):
                raise PlanewiseError(f"has {name} of shape {shape} beside {count:,} points")
        own, full = offset_of(points.read(min(count, LOOK))[:, :3]), None
        if colour is not None:
            full = full_colour(_Rows(*members[colour], stack).read(min(count, LOOK)))
    offset, origins = stated + own, None if origins is None else origins - own

    def blocks(size: int) -> Iterator[PointCloud]:
        with ExitStack() as stack:
            rows = {name: _Rows(*members[name], stack) for name in (key, *beside)}
            colours = None if colour is None else _Rows(*members[colour], stack)
            for first in range(0, count, size):
                here = min(size, count - first)
                xyz = less(rows[key].read(here)[:, :3], own)
                columns: dict[str, NDArray[Any]] = {name: xyz[:, k] for k, name in enumerate("xyz")}
                columns |= {name: rows[name].read(here) for name in beside}
                block = cloud_of(columns, np.zeros(3), origins)
                rgb = None if colours is None else eight_bits(colours.read(here), full)
                yield replace(block, offset=offset, colour=rgb)

    return CloudFile(path=path, count=count, offset=offset, origins=origins, blocks=blocks)
