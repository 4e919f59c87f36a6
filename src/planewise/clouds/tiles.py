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
    coarse,
    grid_about,
    side_for,
    summed,
    write_about,
)
from planewise.clouds.memory import Disk
from planewise.clouds.order import Grid, Order, blocks_of, extent_in_blocks, radix_sort
from planewise.kernels.cloud_rows import ROW
from planewise.sensor import Sensor

Array = NDArray[np.float64]
Keys = NDArray[np.uint64]
Points = NDArray[np.floating]

_SAMPLE = 200_000  # points that stand for the cloud, at most
_MOST_TILES = 180  # whose files are open at a time, three to five of each


def tiled_cloud(
    points: Points,
    sensor: Sensor,
    sigma: Array | None,
    origin: Array | None,
    workers: int,
    tile_points: int,
    disk: Disk,
    louder: float = 1.0,
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
    louder : float
        Times the described standard deviation.

    Returns
    -------
    Cloud or None
        ``None`` if fewer than three points are finite.
    """
    low, high, count = extent_in_blocks(points, workers, disk)
    if count < 3:
        return None
    centre, reach, typical = grid_about(points, low, high, sensor, sigma, origin)
    side = side_for(points, centre, reach, THICK * louder * typical, POINTS, workers, disk)
    grid = Grid.reaching(centre, reach, side / (1 << FINER))

    cubes, starts, total = disk.growing(np.uint64), [np.zeros(1, np.int64)], 0
    rows = disk.growing(np.uint32)
    local, nodes = disk.growing(np.float32, 3), disk.growing(np.float64, ROW)
    variance = disk.growing(np.float64)
    of_each = None if origin is None or origin.ndim == 1 else origin
    columns = [each for each in (points, sigma, of_each) if each is not None]
    for tile in _sorted_tiles(points, grid, workers, tile_points, disk, columns):
        mine = list(tile.columns)
        begins, of_cubes, inside, moments, noise = summed(
            mine.pop(0),
            tile.order,
            sensor,
            None if sigma is None else mine.pop(0),
            origin if of_each is None else mine.pop(0),
            workers,
            louder,
        )
        starts.append(begins[1:] + total)
        total += len(tile.order.keys)
        cubes.append(of_cubes)
        rows.append(tile.rows[tile.order.rows])
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
        write_about(in_order, first, last, about, workers)
        disk.release()
    return Cloud(
        coarse(grid), rows.array(), local.array(), begins, in_order, about, nodes.array(),
        variance.taken(), workers, on_rays=origin is not None, louder=louder, memory=disk,
        parts=parts,
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


@dataclass(frozen=True)
class _Tile:
    """Points of a run of cubes: their order, and the rows of the cloud that they are.

    columns: what is known of the points besides, in the order of rows.
    """

    order: Order
    rows: NDArray[np.uint32]
    columns: list[NDArray[Any]]


def _sorted_tiles(
    points: Points,
    grid: Grid,
    workers: int,
    tile_points: int,
    disk: Disk,
    columns: Sequence[NDArray[Any]],
) -> Iterator[_Tile]:
    """Sort the points in the grid, about `tile_points` at a time, with their rows of columns."""
    none = np.uint64(1 << 3 * grid.levels)
    between = _splits(points, grid, workers, tile_points)
    disk.release()
    tiles = [
        [disk.growing(np.uint64), disk.growing(np.uint32)]
        + [disk.growing(each.dtype, 0 if each.ndim == 1 else each.shape[1]) for each in columns]
        for _ in range(len(between) + 1)
    ]
    first = 0
    for block in blocks_of(points, disk):
        keys = grid.keys(block, workers)
        found = np.flatnonzero(keys != none)
        of_tile = np.searchsorted(between, keys[found], side="right").astype(np.uint16)
        order = np.argsort(of_tile, kind="stable")
        ends = np.searchsorted(of_tile[order], np.arange(len(tiles) + 1))
        found = found[order]
        for tile, (begin, end) in zip(tiles, pairwise(ends), strict=True):
            mine = found[begin:end]
            tile[0].append(keys[mine])
            tile[1].append((mine + first).astype(np.uint32))
            for grown, each in zip(tile[2:], columns, strict=True):
                grown.append(each[first : first + len(block)][mine])
        first += len(block)
    while tiles:
        of_keys, of_rows, *rest = (each.taken() for each in tiles.pop(0))
        if len(of_keys):
            in_order = Order(*radix_sort(of_keys, 3 * grid.levels, workers), grid)
            yield _Tile(in_order, of_rows, rest)


def _splits(points: Points, grid: Grid, workers: int, tile_points: int) -> Keys:
    """Keys at which tiles of about `tile_points` points begin, by a sample of them."""
    tiles = min(-(-len(points) // tile_points), _MOST_TILES)
    sample = np.array(points[:: 1 + len(points) // _SAMPLE])
    keys = np.sort(grid.keys(sample, workers))
    keys = keys[keys < np.uint64(1 << 3 * grid.levels)]
    if tiles < 2 or not len(keys):
        return np.empty(0, np.uint64)
    at = keys[np.arange(1, tiles) * len(keys) // tiles]
    # A cube is never cut.
    return np.unique((at >> np.uint64(SHIFT)) << np.uint64(SHIFT))
