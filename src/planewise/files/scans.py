"""Scans of a file as images: which of them, points in rows and columns, the right way up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.files.depth import check_size
from planewise.organised import PointImage
from planewise.spherical import SphericalCamera

Grid = tuple[NDArray[np.floating], NDArray[np.uint8] | None]
"""Points (rows, columns, 3) and their colours, if they have any."""


def chosen_scan(scan: int | None, count: int) -> int:
    """Number of the one scan that a file of so many has, or of the one that was asked for.

    Raises
    ------
    PlanewiseError
        If there is no such scan, or nothing says which of several.
    """
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


def upright(
    image: PointImage, rgb: NDArray[np.uint8] | None
) -> tuple[PointImage, NDArray[np.uint8] | None]:
    """Turn the image of a scan, and its picture: the highest row first, columns left to right.

    Formats leave to scanners where rows begin, and which way these turn. Images of cameras stay.
    """
    camera = image.camera
    if not isinstance(camera, SphericalCamera):
        return image, rgb
    down = 1 if camera.elevation[0] > camera.elevation[-1] else -1
    along = 1 if camera.azimuth[0] > camera.azimuth[-1] else -1  # without jumps of 360
    turned = replace(
        camera,
        elevation=camera.elevation[::down],
        azimuth=camera.azimuth[::along],
        azimuth_offset=camera.azimuth_offset[::down],
    )
    way = np.s_[::down, ::along]
    picture = None if rgb is None else rgb[way].copy()
    return PointImage(depth=image.depth[way].copy(), camera=turned), picture
