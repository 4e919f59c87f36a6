"""Clouds larger than memory: sorted into tiles on a disk, and searched as if they lay in memory.

A tile is a run of cubes in Morton order. All tiles share one grid, one size of the error and one
numbering, and their arrays are one array in a file, so that cells, labels and Phi are those of the
cloud in one piece. Only the merging of cells looks at all of them at once: see
`clouds.segments.merged_cells` for what happens where they are too many.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import HIGHEST
from planewise.clouds.cloud import (
    FINER,
    POINTS,
    SHIFT,
    THICK,
    Cloud,
    grid_about,
    separations,
    side_for,
    summed,
    write_about,
)
from planewise.clouds.memory import Disk
from planewise.clouds.order import Order, extent_in_blocks, radix_sort
from planewise.kernels import cloud_keys
from planewise.kernels.cloud_rows import ROW
from planewise.sensor import Sensor
from planewise.threads import over_chunks

Array = NDArray[np.float64]
Keys = NDArray[np.uint64]
Points = NDArray[np.floating]

_SAMPLE = 200_000  # points that stand for the cloud, at most
_BLOCK = 1_000_000  # points that are looked at together
_LEAST_PART = 50_000  # points that are worth a thread
_MOST_TILES = 180  # whose files are open at a time, two to five of each


def tiled_cloud(
    points: Points,
    sensor: Sensor,
    sigma: Array | None,
    origin: Array | None,
    workers: int,
    tile_points: int,
    disk: Disk,
) -> Cloud | None:
    """Sort points into cubes as `clouds.cloud.cloud_of` does, a tile at a time.

    Parameters
    ----------
    points : ndarray of float, shape (k, 3)
        On the disk.
    sensor : Sensor
        Its noise is evaluated at the distance from the origin of the coordinates, or at the range.
    sigma : ndarray, shape (k,), optional
        Standard deviations of the points, in place of the sensor's.
    origin : ndarray, shape (3,) or (k, 3), optional
        Where the scanner stood.
    workers : int
        Threads.
    tile_points : int
        Points of a tile, about.
    disk : Disk
        Where the sorted points and their cubes are put.

    Returns
    -------
    Cloud or None
        ``None`` if fewer than three points are finite.
    """
    low, high, count = extent_in_blocks(points, workers, disk)
    if count < 3:
        return None
    seen_from = np.zeros(3) if origin is None else origin
    centre, reach, typical = grid_about(points, low, high, sensor, sigma, seen_from)

    grid = centre, _finest(reach, 4.0 * typical)
    counts = _all_separations(points, grid, workers, tile_points, disk)
    side = max(side_for(grid[1], counts, POINTS), THICK * typical)
    grid = centre, _finest(reach, side / (1 << FINER))

    cubes, starts, total = disk.growing(np.uint64), [np.zeros(1, np.int64)], 0
    keys, rows = disk.growing(np.uint64), disk.growing(np.uint32)
    local, nodes = disk.growing(np.float32, 3), disk.growing(np.float64, ROW)
    variance = disk.growing(np.float64)
    of_each = None if origin is None or origin.ndim == 1 else origin
    columns = [each for each in (points, sigma, of_each) if each is not None]
    for tile in _sorted_tiles(points, grid, workers, tile_points, disk, columns):
        order, mine = Order(tile.keys, tile.order, *grid), list(tile.columns)
        begins, inside, moments, noise = summed(
            mine.pop(0),
            order,
            sensor,
            None if sigma is None else mine.pop(0),
            origin if of_each is None else mine.pop(0),
            workers,
        )
        starts.append(begins[1:] + total)
        total += len(tile.keys)
        cubes.append(tile.keys[begins[:-1]] >> np.uint64(SHIFT))
        keys.append(tile.keys)
        rows.append(tile.rows[tile.order])
        local.append(inside)
        nodes.append(moments)
        variance.append(noise)
        disk.release()
    if total < 3:
        return None
    begins, in_order = np.concatenate(starts), cubes.taken()
    parts = tile_bounds(in_order, begins, tile_points)
    about = disk.empty((len(in_order), 27), np.int32)
    for first, last in parts:
        about[first:last] = -1
    for first, last in parts:
        write_about(in_order, first, last, about, workers)
        disk.release()
    return Cloud(
        Order(keys.array(), rows.array(), *grid), local.array(), begins, in_order, about,
        nodes.array(), variance.taken(), side=grid[1] * (1 << FINER), shift=SHIFT,
        workers=workers, on_rays=origin is not None, memory=disk, parts=parts,
    )  # fmt: skip


def tile_bounds(cubes: Keys, starts: NDArray[np.int64], most: int) -> tuple[tuple[int, int], ...]:
    """Runs of cubes of at most so many points, cut between the largest cubes that cells may have.

    Where such a cube holds more it is cut between smaller ones; a single least cube stays whole.
    """
    bounds = [0]
    for first, last in _blocks(cubes, starts, most, 0, len(cubes), HIGHEST):
        if starts[last] - starts[bounds[-1]] > most and first > bounds[-1]:
            bounds.append(first)
    return tuple(pairwise([*bounds, len(cubes)]))


def _blocks(
    cubes: Keys, starts: NDArray[np.int64], most: int, first: int, last: int, level: int
) -> Iterator[tuple[int, int]]:
    """Runs of cubes[first:last] that are one cube of a level, or of a lower one where too full."""
    above = cubes[first:last] >> np.uint64(3 * level)
    changes = first + 1 + np.flatnonzero(above[1:] != above[:-1])
    for begin, end in pairwise([first, *changes.tolist(), last]):
        if level and starts[end] - starts[begin] > most:
            yield from _blocks(cubes, starts, most, begin, end, level - 1)
        else:
            yield begin, end


def _finest(reach: float, side: float) -> float:
    """Side of the finest cubes: larger where the grid would not reach."""
    return max(side, 2.0 * reach / (1 << cloud_keys.LEVELS) * (1 + 1e-6))


def _keys_of(points: Points, grid: tuple[Array, float], workers: int) -> Keys:
    keys = np.empty(len(points), np.uint64)
    over_chunks(
        lambda first, last: cloud_keys.point_keys(
            points, *grid, cloud_keys.TURN, first, last, keys
        ),
        len(points), workers, _LEAST_PART,
    )  # fmt: skip
    return keys


@dataclass(frozen=True)
class _Tile:
    """Points of a run of cubes: their sorted keys, where each stood among rows, and those rows.

    columns: what is known of the points besides, in the order of rows.
    """

    keys: Keys
    order: NDArray[np.uint32]
    rows: NDArray[np.uint32]
    columns: list[NDArray[Any]]


def _sorted_tiles(
    points: Points,
    grid: tuple[Array, float],
    workers: int,
    tile_points: int,
    disk: Disk,
    columns: Sequence[NDArray[Any]] = (),
) -> Iterator[_Tile]:
    """Sort the finite points, about `tile_points` at a time, with their rows of some arrays."""
    between = _splits(points, grid, workers, tile_points)
    disk.release()
    tiles = [
        [disk.growing(np.uint64), disk.growing(np.uint32)]
        + [disk.growing(each.dtype, 0 if each.ndim == 1 else each.shape[1]) for each in columns]
        for _ in range(len(between) + 1)
    ]
    for first in range(0, len(points), _BLOCK):
        block = points[first : first + _BLOCK]
        keys = _keys_of(block, grid, workers)
        rows = np.flatnonzero(keys != cloud_keys.NO_KEY)
        number = np.searchsorted(between, keys[rows], side="right").astype(np.uint16)
        order = np.argsort(number, kind="stable")
        ends = np.searchsorted(number[order], np.arange(len(tiles) + 1))
        rows = rows[order]
        for tile, (begin, end) in zip(tiles, pairwise(ends), strict=True):
            mine = rows[begin:end]
            tile[0].append(keys[mine])
            tile[1].append((mine + first).astype(np.uint32))
            for grown, each in zip(tile[2:], columns, strict=True):
                grown.append(each[first : first + _BLOCK][mine])
        disk.release()
    while tiles:
        of_keys, of_rows, *rest = (each.taken() for each in tiles.pop(0))
        if len(of_keys):
            sorted_keys, place = radix_sort(of_keys, workers)
            yield _Tile(sorted_keys, place, of_rows, rest)


def _splits(points: Points, grid: tuple[Array, float], workers: int, tile_points: int) -> Keys:
    """Keys at which tiles of about `tile_points` points begin, by a sample of them."""
    tiles = min(-(-len(points) // tile_points), _MOST_TILES)
    sample = np.array(points[:: 1 + len(points) // _SAMPLE])
    keys = np.sort(_keys_of(sample, grid, workers))
    keys = keys[keys != cloud_keys.NO_KEY]
    if tiles < 2 or not len(keys):
        return np.empty(0, np.uint64)
    at = keys[np.arange(1, tiles) * len(keys) // tiles]
    # A cube is never cut.
    return np.unique((at >> np.uint64(SHIFT)) << np.uint64(SHIFT))


def _all_separations(
    points: Points, grid: tuple[Array, float], workers: int, tile_points: int, disk: Disk
) -> NDArray[np.int64]:
    """`clouds.cloud.separations` of all keys: of every tile, and from each to the next."""
    counts = np.zeros(cloud_keys.LEVELS + 1, np.int64)
    before = np.empty(0, np.uint64)
    for tile in _sorted_tiles(points, grid, workers, tile_points, disk):
        counts += separations(np.append(before, tile.keys))
        before = tile.keys[-1:]
    return counts
