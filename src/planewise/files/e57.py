"""E57, by pye57: each scan in blocks, moved to its pose, with the place of its scanner.

A scan whose points are said to be in rows and columns is an image, too, in its own frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from os import SEEK_END
from pathlib import Path
from struct import Struct
from typing import IO, Any
from xml.parsers.expat import ParserCreate

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError, needs
from planewise.files.scans import Grid, chosen_scan, gridded
from planewise.point_cloud import BLOCK, Array, CloudFile, PointCloud, offset_near

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLOURS = ("colorRed", "colorGreen", "colorBlue")
_INDEX = ("rowIndex", "columnIndex")
_FAR = 10_000.0
_HEADER = Struct("<8s2I4Q")  # signature, version, bytes, place and bytes of the XML, of a page
_PAGE, _CHECKSUM = 1024, 4
_LARGEST_XML = 1 << 25  # bytes; a scan takes a few thousand
_DEEPEST_XML = 100  # elements within one another; the format has about eight


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    with needs("pye57", f"reading {path.suffix} files", "cloud"):
        import pye57  # type: ignore[import-untyped, import-not-found, unused-ignore]
    with path.open("rb") as stream:
        _check_xml(_xml(stream))
    with pye57.E57(str(path)) as reader:
        counts = [reader.get_header(k).point_count for k in range(reader.scan_count)]
        if not counts:
            raise PlanewiseError("holds no scans")
        if sum(counts) > 8 * path.stat().st_size:  # not a bit for each
            raise PlanewiseError(
                f"claims {sum(counts):,} points, which cannot be in a file of its size"
            )
        yield reader


def _xml(stream: IO[bytes]) -> bytes:
    """The XML that describes the scans: its pages without their checksums."""
    head = stream.read(_HEADER.size)
    if not head.startswith(b"ASTM-E57"):
        raise PlanewiseError("is no E57 file: it does not begin with ASTM-E57")
    if len(head) < _HEADER.size:
        raise PlanewiseError("is cut short: its header has no end")
    *_, place, size, page = _HEADER.unpack(head)
    if page != _PAGE:
        raise PlanewiseError(f"claims pages of {page:,} bytes; those of E57 have {_PAGE:,}")
    if size > _LARGEST_XML:
        raise PlanewiseError(f"claims {size:,} bytes of XML; at most {_LARGEST_XML:,} are read")
    data = _PAGE - _CHECKSUM
    skipped = place % _PAGE
    stream.seek(min(place - skipped, stream.seek(0, SEEK_END)))
    paged = stream.read(((skipped + size) // data + 1) * _PAGE)
    pages = (paged[start : start + data] for start in range(0, len(paged), _PAGE))
    xml = b"".join(pages)[min(skipped, data) :][:size]
    if len(xml) < size:
        raise PlanewiseError(f"is cut short: {len(xml):,} of {size:,} bytes of its XML are there")
    return xml


def _check_xml(xml: bytes) -> None:
    """Refuse XML by which the library's parser would open other files, or not come to an end."""
    parser, depth = ParserCreate("UTF-8"), 0

    def declaration(_version: str, encoding: str | None, _standalone: int) -> None:
        if encoding is not None and encoding.upper() != "UTF-8":
            raise PlanewiseError(f"has XML in {encoding}; that of E57 is in UTF-8")

    def doctype(*_: object) -> None:
        raise PlanewiseError("has XML with a DOCTYPE, for which E57 has no use; it is not read")

    def start(_name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST_XML:
            raise PlanewiseError(f"has XML with more than {_DEEPEST_XML} elements in one another")
        if any(name.endswith("chemaLocation") for name in attributes):
            raise PlanewiseError("has XML that names a schema in another file, which is not read")

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    if b"\0" in xml:
        raise PlanewiseError("has XML in UTF-16 or UTF-32; that of E57 is in UTF-8")
    parser.XmlDeclHandler, parser.StartDoctypeDeclHandler = declaration, doctype
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(xml, True)


def open_e57(path: Path) -> CloudFile:
    """Open an E57 file; scan s of its points was taken from ``origins[s]``.

    Points that the file marks as invalid are left out, so `count` is an upper bound where a scan
    marks any, and is then not stated.
    """
    with _reader(path) as reader:
        headers = [reader.get_header(k) for k in range(reader.scan_count)]
        count = sum(header.point_count for header in headers)
        marks = any(_mark(header.point_fields) for header in headers)
        places = np.array([_pose(header)[1] for header in headers])
        if not np.isfinite(places).all():
            raise PlanewiseError("has a scan whose pose is not finite")
        middles = np.array([_middle(header) for header in headers])
        offset = offset_near(middles.mean(axis=0))

    def blocks(size: int) -> Iterator[PointCloud]:
        with _reader(path) as reader:
            for scan in range(reader.scan_count):
                yield from _scan(reader, scan, size, offset)

    return CloudFile(
        path=path,
        count=None if marks else count,
        offset=offset,
        origins=places - offset,
        blocks=blocks,
    )


def _mark(fields: list[str]) -> str | None:
    """Name of the field that says which points are invalid."""
    names = ("cartesianInvalidState", "sphericalInvalidState")
    return next((name for name in names if name in fields), None)


def _pose(header: Any) -> tuple[Array, Array]:
    """Rotation and place of a scan; one that states none is in the file's coordinates."""
    if not header.has_pose():  # which not every version of pye57 reads
        return np.eye(3), np.zeros(3)
    return header.rotation_matrix, np.asarray(header.translation, np.float64)


def _middle(header: Any) -> Array:
    """Middle of a scan in the file's coordinates: that of its bounds, moved, else its scanner's.

    Some writers state bounds in the scan's own frame, as the format has it, others in the file's.
    """
    _, place = _pose(header)
    if "cartesianBounds" not in header.scan_fields:
        return place
    box = header.cartesianBounds
    low, high = (
        np.array([float(box[axis + end].value()) for axis in "xyz"])
        for end in ("Minimum", "Maximum")
    )
    middle = (low + high) / 2
    # A bound that is already far out is not moved a second time.
    return np.asarray(middle + place if np.abs(middle).max() < _FAR else middle)


def _scan(reader: Any, scan: int, size: int, offset: Array) -> Iterator[PointCloud]:
    header = reader.get_header(scan)
    limit = _limit(header)
    turn, place = _pose(header)
    for table in _tables(reader, scan, size):
        local = _local(table)
        shine = table.get("intensity")
        yield PointCloud(
            points=local @ turn.T + (place - offset),
            offset=offset,
            colour=_colour(table, limit),
            intensity=None if shine is None else shine.astype(np.float32),
            scan=np.full(len(local), scan, np.int32),
        )


def grid_of(path: Path, scan: int | None) -> Grid:
    """Image of a scan in its own frame; NaN where there is no point.

    Of several points in one row and column, as of several returns, the nearest counts.

    Raises
    ------
    PlanewiseError
        If its points are not said to be in rows and columns, or the file holds several scans and
        `scan` does not choose.
    """
    with _reader(path) as reader:
        scan = chosen_scan(scan, reader.scan_count)
        header = reader.get_header(scan)
        if missing := [name for name in _INDEX if name not in header.point_fields]:
            raise PlanewiseError(
                f"has points without {' and '.join(missing)}, which are no image; 'planewise "
                "points' takes it"
            )
        limit = _limit(header)
        points, colours, places = [], [], []  # 31 bytes a point
        for table in _tables(reader, scan, BLOCK, _INDEX):
            points.append(_local(table).astype(np.float32))  # 1 um at 10 m
            if (colour := _colour(table, limit)) is not None:
                colours.append(colour)
            places.append(np.stack([table[name] for name in _INDEX], axis=1))
    if not sum(map(len, points)):
        raise PlanewiseError(f"has no valid points in scan {scan}")
    coloured = np.concatenate(colours) if colours else None
    return gridded(np.concatenate(points), coloured, np.concatenate(places))


def _tables(
    reader: Any, scan: int, size: int, index: tuple[str, ...] = ()
) -> Iterator[dict[str, Array]]:
    """What is said of the valid points of a scan, in blocks that last until the next."""
    header = reader.get_header(scan)
    fields = header.point_fields
    names = next((each for each in (_CARTESIAN, _SPHERICAL) if set(each) <= set(fields)), None)
    if names is None:
        raise PlanewiseError(f"has a scan without coordinates; its fields are {', '.join(fields)}")
    count = header.point_count
    if not count:
        return
    mark = _mark(fields)
    colours = _COLOURS if set(_COLOURS) <= set(fields) else ()
    bright = ["intensity"] if "intensity" in fields else []
    # Whole numbers are asked for as float64, too: int64 is taken for one of 32 bits.
    wanted: dict[str, type] = dict.fromkeys((*names, *colours, *bright, *index), np.float64)
    marks: dict[str, type] = {mark: np.int8} if mark else {}
    size = min(size, count)
    columns, buffers = _buffers(reader, wanted | marks, size)
    stream = header.points.reader(buffers)
    done = 0
    try:
        while done < count and (here := stream.read()):
            done += here
            keep = slice(here) if mark is None else np.flatnonzero(columns[mark][:here] == 0)
            yield {name: columns[name][keep] for name in wanted}
    finally:
        stream.close()
    if done < count:
        raise PlanewiseError(f"is cut short: scan {scan} has {done:,} of {count:,} points")


def _local(table: dict[str, Array]) -> Array:
    """Points in the frame of their scan."""
    if _CARTESIAN[0] in table:
        return np.stack([table[name] for name in _CARTESIAN], axis=1)
    return _cartesian(np.stack([table[name] for name in _SPHERICAL], axis=1))


def _buffers(reader: Any, wanted: dict[str, type], size: int) -> tuple[dict[str, Any], Any]:
    from pye57 import libe57

    columns: dict[str, Any] = {name: np.empty(size, kind) for name, kind in wanted.items()}
    buffers = libe57.VectorSourceDestBuffer()
    for name, column in columns.items():
        # Converted to this type, and scaled where the file has scaled whole numbers.
        buffers.append(libe57.SourceDestBuffer(reader.image_file, name, column, size, True, True))
    return columns, buffers


def _limit(header: Any) -> float:
    if "colorLimits" not in header.scan_fields:
        return 255.0
    limits = header["colorLimits"]
    name = "colorRedMaximum"
    return float(limits[name].value()) if limits.isDefined(name) else 255.0


def _colour(table: dict[str, Array], limit: float) -> NDArray[np.uint8] | None:
    if _COLOURS[0] not in table:
        return None
    columns = np.stack([table[name] for name in _COLOURS], axis=1)
    scaled = columns * (255.0 / limit if limit > 0 else 1.0)
    return np.asarray(scaled.clip(0, 255).round().astype(np.uint8))


def _cartesian(spherical: Array) -> Array:
    """Range, azimuth and elevation (radians, from the x-y plane) to x, y, z."""
    distance, azimuth, elevation = spherical.T
    flat = distance * np.cos(elevation)
    return np.stack(
        (flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)), axis=1
    )
