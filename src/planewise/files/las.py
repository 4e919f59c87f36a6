"""LAS and LAZ, by laspy and lazrs: read in blocks, and copied with the planes as a dimension."""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError, needs
from planewise.files.cloud_columns import COLOUR, LOOK, cloud_of, full_colour
from planewise.files.cloud_records import check_length
from planewise.files.las_units import stated_unit
from planewise.point_cloud import Array, CloudFile, PointCloud, offset_near

_HEADER_1_2, _HEADER = 227, 375  # bytes of the headers of LAS 1.2 and 1.4
_LARGEST = 2**31 - 1
_FINEST = 1e-5  # metres; finer steps than 10 um are no measurement
_ROUNDED = 1.0  # metres by which bounds in the header may be off
_FARTHEST = 1e15  # metres: no coordinate is so large


@contextmanager
def _reader(path: Path, *, whole: bool = False) -> Iterator[Any]:
    laspy = load_laspy(f"reading {path.suffix} files")
    _check_header(path)
    # Records behind the points may be large, and say nothing about them. The parallel decoder
    # would allocate whatever a damaged file states, and end the process where it cannot.
    with laspy.open(path, read_evlrs=whole, laz_backend=laspy.LazBackend.Lazrs) as reader:
        if reader.header.are_points_compressed:
            _need_lazrs("reading compressed .laz files")
            if reader.header.point_count:
                _check_chunks(path, reader.header.offset_to_point_data)
        yield reader


def _check_header(path: Path) -> None:
    """Refuse more records than the file has room for; laspy would make them all."""
    with path.open("rb") as stream:
        head = stream.read(_HEADER)
    if head[:4] != b"LASF" or len(head) < _HEADER_1_2:
        raise PlanewiseError("is no LAS file: it does not begin with LASF and a header")
    (records,) = struct.unpack_from("<I", head, 100)
    more = struct.unpack_from("<I", head, 243)[0] if head[25] >= 4 and len(head) == _HEADER else 0
    if 54 * records + 60 * more > path.stat().st_size:
        raise PlanewiseError(
            f"is damaged: it claims {records + more:,} records before and after its points"
        )


def _check_chunks(path: Path, start: int) -> None:
    """Refuse more pieces of packed points than the file has room for; the decoder trusts them."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        places: list[int] = []
        for at in (start, size - 8):  # where a stream could not go back, the table's place is last
            stream.seek(max(at, 0))
            data = stream.read(8)
            if len(data) < 8:
                raise PlanewiseError("is cut short: its packed points are missing")
            places += struct.unpack("<q", data)
        for place in places:
            if 0 <= place <= size - 8:
                stream.seek(place)
                _, pieces = struct.unpack("<II", stream.read(8))
                if pieces > size:
                    raise PlanewiseError(f"is damaged: it claims {pieces:,} pieces of points")
                return
    raise PlanewiseError("is damaged or cut short: the table of its packed points is missing")


def load_laspy(purpose: str) -> Any:
    """Import laspy, or say which extra has it."""
    with needs("laspy", purpose, "cloud"):
        import laspy  # type: ignore[import-untyped, import-not-found, unused-ignore]
    # What it logs it raises, too; without a handler Python would print it.
    logging.getLogger("laspy").addHandler(logging.NullHandler())
    return laspy


def _need_lazrs(purpose: str) -> None:
    with needs("lazrs", purpose, "cloud"):
        import lazrs  # type: ignore[import-untyped, import-not-found, unused-ignore]  # noqa: F401


def open_las(path: Path) -> CloudFile:
    """Open a LAS or LAZ file; coordinates are its whole numbers times its scale.

    The offset is of whole hundreds of metres near the middle of the file, and its points are
    float64, so that nothing of the scaled numbers is lost.
    """
    with _reader(path) as reader:
        header = reader.header
        count = int(header.point_count)
        if not header.are_points_compressed:
            check_length(path, header.offset_to_point_data, count, header.point_format.size)
        scales, own = np.array(header.scales), np.array(header.offsets)
        names = set(header.point_format.dimension_names)
        with np.errstate(over="ignore", invalid="ignore"):
            possible = (scales > 0) & (np.abs(own) + scales * _LARGEST < _FARTHEST)
        if not possible.all():
            raise PlanewiseError(f"has scales {scales} and offsets {own} that are none")
        unit = stated_unit(header.vlrs)
        first = reader.read_points(LOOK) if count else None
        bounds = _bounds(header, scales, own)
    offset = np.zeros(3)
    if first is not None:
        some = np.stack((first.x, first.y, first.z), axis=1)
        if bounds is not None and (np.abs(some - some.clip(*bounds)) > _ROUNDED).any():
            bounds = None  # of other points, or never filled in
        offset = offset_near(np.median(some, axis=0) if bounds is None else bounds.mean(axis=0))
    colours = () if first is None or "red" not in names else (first[name] for name in COLOUR)
    full = full_colour(*map(np.asarray, colours))

    def blocks(size: int) -> Iterator[PointCloud]:
        done = 0
        with _reader(path) as reader:
            for rows in reader.chunk_iterator(size):
                done += len(rows)
                yield _cloud(rows, names, scales, own, offset, full)
        if done < count:
            raise PlanewiseError(f"is cut short: {done:,} of {count:,} points are there")

    return CloudFile(
        path=path,
        count=count,
        offset=offset,
        blocks=blocks,
        bounds=bounds if count else None,
        unit=unit,
    )


def _bounds(header: Any, scales: Array, own: Array) -> Array | None:
    """Least and largest coordinates by the header, shape (2, 3), where any point can have them."""
    bounds = np.array((header.mins, header.maxs), np.float64)
    with np.errstate(over="ignore"):
        possible = np.abs(bounds - own) <= scales * (_LARGEST + 2)  # NaN is not
    return bounds if possible.all() else None


def _cloud(
    rows: Any, names: set[str], scales: Array, own: Array, offset: Array, full: float | None
) -> PointCloud:
    # The offsets meet first: they are near each other, and small numbers keep all digits.
    columns: dict[str, NDArray[Any]] = {
        name: np.asarray(rows[name.upper()]) * scales[k] + (own[k] - offset[k])
        for k, name in enumerate("xyz")
    }
    if "red" in names:
        columns |= {name: np.asarray(rows[name]) for name in COLOUR}
    if "intensity" in names:
        columns["intensity"] = np.asarray(rows["intensity"])
    if "plane" in names:
        value = np.asarray(rows["plane"])
        if value.ndim == 1:  # else it is something of that name
            columns["plane"] = value
    return replace(cloud_of(columns, np.zeros(3), full=full), offset=offset)


def copy_with_planes(
    source: Path, target: Path, labels: NDArray[np.uint16], size: int = 1_000_000
) -> None:
    """Copy a LAS or LAZ file with one dimension more, `plane`; all others stay as they are.

    Parameters
    ----------
    source : Path
        File to copy.
    target : Path
        New file; its ending says whether it is compressed.
    labels : ndarray of uint16, shape (k,)
        Plane of each point, 0 for none.
    size : int
        Points held in memory at a time.
    """
    laspy = load_laspy("writing .las files")
    if target.suffix.lower() == ".laz":
        _need_lazrs("writing .laz files")
    with _reader(source, whole=True) as reader:
        header = _with_plane(laspy, reader.header, int(labels.max(initial=0)))
        with laspy.open(target, mode="w", header=header) as writer:
            done = 0
            for rows in reader.chunk_iterator(size):
                out = laspy.ScaleAwarePointRecord.zeros(len(rows), header=header)
                # As stored: scaled numbers would be rounded, or not fit, on their way back.
                for name in rows.array.dtype.names:
                    if name != "plane":
                        out.array[name] = rows.array[name]
                out["plane"] = labels[done : done + len(rows)]
                writer.write_points(out)
                done += len(rows)
            if header.evlrs:
                writer.write_evlrs(header.evlrs)


def _with_plane(laspy: Any, header: Any, most: int) -> Any:
    """Header with a dimension that holds labels up to `most`, without the order of a COPC file."""
    from copy import deepcopy

    header = deepcopy(header)
    for records in (header.vlrs, header.evlrs or []):
        for ordering in [each for each in records if each.user_id == "copc"]:
            records.remove(ordering)
    if "plane" in set(header.point_format.dimension_names):
        there = header.point_format.dimension_by_name("plane")
        plain = there.num_elements == 1 and there.scales is None
        if not plain or (there.dtype.kind in "iu" and np.iinfo(there.dtype).max < most):
            header.remove_extra_dim("plane")
    if "plane" not in set(header.point_format.dimension_names):
        header.add_extra_dim(
            laspy.ExtraBytesParams(name="plane", type=np.uint16, description="plane, 0 for none")
        )
    return header


def write_las(
    target: Path,
    blocks: Iterable[tuple[PointCloud, NDArray[np.uint16], NDArray[np.uint8]]],
    bounds: Array,
    brightest: float = 1.0,
) -> None:
    """Write points as LAS 1.4 or LAZ with colours and the dimension `plane`.

    Parameters
    ----------
    target : Path
        New file; its ending says whether it is compressed.
    blocks : iterable of (PointCloud, ndarray, ndarray)
        Points, their planes, shape (n,), and colours, shape (n, 3). Points that are not finite,
        or much farther off than the bounds, cannot be written and are left out.
    bounds : ndarray, shape (2, 3)
        Of the coordinates of most, metres. Their extent fixes the step: 32 bits have to hold it.
    brightest : float
        Largest intensity; up to 1 they are shares of what 16 bits hold.
    """
    laspy = load_laspy("writing .las files")
    if target.suffix.lower() == ".laz":
        _need_lazrs("writing .laz files")
    header = laspy.LasHeader(point_format=7, version="1.4")
    extent = float(np.max(bounds[1] - bounds[0]))
    header.scales = np.full(3, max(_FINEST, 10.0 ** np.ceil(np.log10(max(extent, 1e-9) / 1e9))))
    header.offsets = np.round(bounds.mean(axis=0))
    header = _with_plane(laspy, header, 0)
    with laspy.open(target, mode="w", header=header) as writer:
        for cloud, labels, colour in blocks:
            whole = np.round((cloud.points + (cloud.offset - header.offsets)) / header.scales)
            keep = (np.abs(whole) <= _LARGEST).all(axis=1)  # NaN is not
            out = laspy.ScaleAwarePointRecord.zeros(int(keep.sum()), header=header)
            for k, name in enumerate("XYZ"):
                out[name] = whole[keep, k].astype(np.int32)
            out["plane"] = labels[keep]
            for k, name in enumerate(COLOUR):
                out[name] = colour[keep, k].astype(np.uint16) * 257
            if cloud.intensity is not None:
                largest = 65535.0
                bright = cloud.intensity[keep] * (largest if brightest <= 1 else 1.0)
                out["intensity"] = np.nan_to_num(bright).clip(0, largest).round().astype(np.uint16)
            writer.write_points(out)
