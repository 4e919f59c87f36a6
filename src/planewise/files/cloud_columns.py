"""Columns of points as files name them, and what they mean."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.point_cloud import Array, CloudFile, PointCloud, less, offset_of

Column = NDArray[Any]

LOOK = 10_000
"""Points that tell the offset, and how colours are counted."""

COLOUR = ("red", "green", "blue")
"""As most files name it, those that are written among them."""

_ROUNDING = 1e-4  # of colours as shares, which may come out above 1

_POSITION = ("x", "y", "z")
_COLOURS = (
    COLOUR,
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)
_INTENSITY = ("intensity", "scalar_intensity", "reflectance", "reflectivity", "i")
_LABELS = ("plane", "gt", "label", "labels", "instance", "scalar_label")
_SCAN = ("scan", "scan_id", "scan_index")
_KNOWN = {*_POSITION, *_INTENSITY, *_LABELS, *_SCAN}.union(*_COLOURS)


def positions(names: Sequence[str]) -> list[int]:
    """Where x, y and z stand among the names of a file's columns.

    Raises
    ------
    PlanewiseError
        If one is missing or there twice.
    """
    lower = [name.lower() for name in names]
    for name in _POSITION:
        if lower.count(name) != 1:
            found = ", ".join(names) or "none"
            raise PlanewiseError(f"must have one column {name}; its columns are {found}")
    return [lower.index(name) for name in _POSITION]


def unknown(names: Sequence[str]) -> set[int]:
    """Where columns stand whose names say nothing that is read of them."""
    return {k for k, name in enumerate(names) if name.lower() not in _KNOWN}


def cloud_file(
    path: Path,
    count: int | None,
    tables: Callable[[int], Iterator[Mapping[str, Column]]],
    origin: Array | None = None,
    shape: tuple[int, int] | None = None,
) -> CloudFile:
    """Make a cloud file of named columns; its first points tell its offset and range of colours.

    Parameters
    ----------
    path : Path
        The file.
    count : int, optional
        Number of its points, where that is known.
    tables : callable
        Reads the file from its beginning in blocks of so many points.
    origin : ndarray, shape (3,), optional
        Where the scanner stood.
    shape : (height, width), optional
        Of the image that the points are of.
    """
    offset, full = np.zeros(3), None
    head = None if count == 0 else next(tables(LOOK), None)
    if head is not None:
        known = _lower(head)
        offset = offset_of(np.stack([known[name] for name in _POSITION], axis=1))
        full = full_colour(*_colours(known))
    origins = None if origin is None else (origin - offset)[None]

    def blocks(size: int) -> Iterator[PointCloud]:
        for columns in tables(size):
            yield cloud_of(columns, offset, origins, full)

    return CloudFile(
        path=path, count=count, offset=offset, origins=origins, blocks=blocks, shape=shape
    )


def cloud_of(
    columns: Mapping[str, Column],
    offset: Array,
    origins: Array | None = None,
    full: float | None = None,
) -> PointCloud:
    """Make a cloud of named columns; those of unknown meaning are left out.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (k,)
        Numbers; capitals in names do not matter. Colours are brought to 0 ... 255.
    offset : ndarray, shape (3,)
        What to subtract from the coordinates.
    origins : ndarray, shape (s, 3), optional
        Where the scanner stood, relative to `offset`.
    full : float, optional
        Largest number that a colour may have (`full_colour`).
    """
    known = _lower(columns)

    def first(names: Sequence[str]) -> Column | None:
        return next((known[name] for name in names if name in known), None)

    colours = _colours(known)
    intensity, labels, scan = first(_INTENSITY), first(_LABELS), first(_SCAN)
    return PointCloud(
        points=less(np.stack([known[name] for name in _POSITION], axis=1), offset),
        offset=offset,
        colour=eight_bits(np.stack(colours, axis=1), full) if colours else None,
        intensity=None if intensity is None else intensity.astype(np.float32),
        labels=None if labels is None else _whole(labels),
        scan=None if scan is None else _whole(scan),
        origins=origins,
    )


def full_colour(*colours: Column) -> float | None:
    """Largest number that colours such as these may have: 1, 255 or 65,535.

    ``None`` where it cannot be told: of black ones, or of none.
    """
    known = (each[np.isfinite(each)] for each in colours)
    largest = max((float(each.max()) for each in known if each.size), default=0.0)
    if largest <= 0:
        return None
    if largest <= 1 + _ROUNDING and all(each.dtype.kind == "f" for each in colours):
        return 1.0
    return 255.0 if largest <= 255 else 65535.0


def eight_bits(colour: Column, full: float | None = None) -> NDArray[np.uint8]:
    """Colours of any type, shape (k, 3), as 8 bits; `full` as their file's first ones have it."""
    if colour.dtype == np.uint8:
        return colour
    full = max(full or 0.0, full_colour(colour) or 0.0) or 255.0
    bounded = np.nan_to_num(colour.astype(np.float64)).clip(0, full)
    return np.asarray((bounded * (255.0 / full)).round().astype(np.uint8))


def _lower(columns: Mapping[str, Column]) -> dict[str, Column]:
    return {name.lower(): column for name, column in columns.items()}


def _colours(known: Mapping[str, Column]) -> list[Column]:
    """Red, green and blue, where all three are there."""
    names = next((names for names in _COLOURS if all(name in known for name in names)), ())
    return [known[name] for name in names]


def _whole(column: Column) -> NDArray[np.int32]:
    """Numbers of planes or scans; what is none is 0."""
    bounded = np.nan_to_num(column.astype(np.float64), posinf=0, neginf=0)
    return np.asarray(np.clip(bounded, -(2**31), 2**31 - 1).astype(np.int32))
