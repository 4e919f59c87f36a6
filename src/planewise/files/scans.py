"""Scans of a file as images: which of them, points in their rows and columns, the right way up."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.files.depth import check_size

Kind = TypeVar("Kind", bound=np.generic)
Grid = tuple[NDArray[np.floating], NDArray[np.uint8] | None]
"""Points (rows, columns, 3) and their colours, if they have any."""


def chosen_scan(scan: int | None, count: int) -> int:
    """Number of the one scan that a file of so many has, or of the one that was asked for.

    Raises
    ------
    PlanewiseError
        If there is no such scan, or nothing says which of several.
    """
    if count == 0:
        raise PlanewiseError("holds no scans")
    if scan is None and count > 1:
        raise PlanewiseError(
            f"holds {count} scans, each an image of its own: --scan says which, 0 to {count - 1}; "
            "'planewise points' takes all as a cloud"
        )
    if scan is not None and not 0 <= scan < count:
        raise PlanewiseError(f"holds scans 0 to {count - 1}, and no scan {scan}")
    return scan or 0


def gridded(
    points: NDArray[np.floating], colour: NDArray[np.uint8] | None, places: NDArray[np.float64]
) -> Grid:
    """Put points (k, 3) where `places` (k, 2) say, their rows and columns, from any number on.

    Of several in one place the nearest stays; NaN and 0 where there is none.

    Raises
    ------
    PlanewiseError
        If there would be more than `MAX_PIXELS` pixels, or rows and columns are no numbers.
    """
    if not np.isfinite(places).all():
        raise PlanewiseError("has points in rows or columns that are no numbers")
    first = places.min(axis=0)
    rows, columns = (int(extent) + 1 for extent in places.max(axis=0) - first)
    check_size(rows * columns)
    order = np.argsort(-np.linalg.norm(points, axis=1), kind="stable")  # the last one stays
    row, column = (places - first)[order].T.astype(np.intp)
    grid = np.full((rows, columns, 3), np.nan, points.dtype)
    grid[row, column] = points[order]
    if colour is None:
        return grid, None
    picture = np.zeros((rows, columns, 3), np.uint8)
    picture[row, column] = colour[order]
    return grid, picture


def upright(points: NDArray[np.floating], colour: NDArray[np.uint8] | None) -> Grid:
    """Turn the image of a scan about z: the highest row first, columns from left to right.

    Formats leave to scanners where rows begin, and which way these turn. An image whose points are
    all before it, z > 0, is that of a camera and stays.
    """
    x, y, z = np.moveaxis(points, -1, 0)
    if not np.any(z < 0):
        return points, colour
    there = points.any(axis=-1)  # NaN stay
    up = np.where(there, np.arctan2(z, np.hypot(x, y)), np.nan)
    around = np.where(there, np.arctan2(y, x), np.nan)
    rising = _median(np.diff(up, axis=0)) > 0
    turning = _median((np.diff(around, axis=1) + np.pi) % (2 * np.pi) - np.pi) > 0
    way = np.s_[:: -1 if rising else 1, :: -1 if turning else 1]

    def turned(image: NDArray[Kind]) -> NDArray[Kind]:
        return np.ascontiguousarray(image[way])

    return turned(points), None if colour is None else turned(colour)


def _median(steps: NDArray[np.floating]) -> float:
    known = steps[np.isfinite(steps)]
    return float(np.median(known)) if known.size else 0.0
