"""Columns of points as files name them, and what they mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.point_cloud import Array, PointCloud, less

Column = NDArray[Any]

_POSITION = ("x", "y", "z")
_COLOURS = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)
_INTENSITY = ("intensity", "scalar_intensity", "reflectance", "reflectivity", "i")
_LABELS = ("plane", "gt", "label", "labels", "instance", "scalar_label")
_SCAN = ("scan", "scan_id", "scan_index")


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


def cloud_of(
    columns: Mapping[str, Column], offset: Array, origins: Array | None = None
) -> PointCloud:
    """Make a cloud of named columns; those of unknown meaning are left out.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (k,)
        Numbers; capitals in names do not matter. Colours of 16 bits and of 0 ... 1 are brought to
        0 ... 255.
    offset : ndarray, shape (3,)
        What to subtract from the coordinates.
    origins : ndarray, shape (s, 3), optional
        Where the scanner stood, relative to `offset`.
    """
    known = {name.lower(): column for name, column in columns.items()}

    def first(names: Sequence[str]) -> Column | None:
        return next((known[name] for name in names if name in known), None)

    colour = next((names for names in _COLOURS if all(name in known for name in names)), None)
    intensity, labels, scan = first(_INTENSITY), first(_LABELS), first(_SCAN)
    return PointCloud(
        points=less(np.stack([known[name] for name in _POSITION], axis=1), offset),
        offset=offset,
        colour=None if colour is None else eight_bits(*(known[name] for name in colour)),
        intensity=None if intensity is None else intensity.astype(np.float32),
        labels=None if labels is None else _whole(labels),
        scan=None if scan is None else _whole(scan),
        origins=origins,
    )


def eight_bits(red: Column, green: Column, blue: Column) -> NDArray[np.uint8]:
    """Colours of any type as 8 bits, shape (k, 3)."""
    colour = np.stack((red, green, blue), axis=1)
    if colour.dtype == np.uint8:
        return colour
    largest = 0 if not colour.size else np.nanmax(colour)
    if colour.dtype.kind == "f" and largest <= 1:
        colour = colour * 255
    elif largest > 255:  # 16 bits
        colour = colour / 257
    return np.nan_to_num(colour.astype(np.float64)).clip(0, 255).round().astype(np.uint8)


def _whole(column: Column) -> NDArray[np.int32]:
    """Numbers of planes or scans; what is none is 0."""
    bounded = np.nan_to_num(column.astype(np.float64), posinf=0, neginf=0)
    return np.asarray(np.clip(bounded, -(2**31), 2**31 - 1).astype(np.int32))
