"""Points in Morton order: the octree in which cells of a cloud are found."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.memory import Memory
from planewise.kernels import cloud_keys as kernels
from planewise.runtime import threads

Array = NDArray[np.float64]
Keys = NDArray[np.uint64]

_LEAST_PART = 50_000  # points that are worth a thread
_BLOCK = 1_000_000  # points that are looked at together
_LEAST_BITS = 1 << 20  # that cubes are counted by
_ALONE = 0.22  # cubes of one point beside others in clouds of even density
_UNSURE = 8  # standard deviations of a count that say something
_DIGIT = 11  # bits a pass of the sort, at most


@dataclass(frozen=True)
class Grid:
    """Grid of cubes, turned against the axes.

    Attributes
    ----------
    centre : ndarray, shape (3,)
        Its middle.
    side : float
        Of a cube, metres.
    levels : int
        There are 2^levels cubes along an axis.
    reach : float
        Metres from its middle, along its axes, beyond which points are not in it, whatever the
        cubes, which reach farther.
    """

    centre: Array
    side: float
    levels: int
    reach: float

    @property
    def middle(self) -> float:
        """Coordinate of its middle along every axis, in cubes."""
        return 2.0 ** (self.levels - 1)

    @classmethod
    def reaching(cls, centre: Array, reach: float, side: float) -> Grid:
        """Grid that reaches so far; its cubes are larger where 2^21 of them would not."""
        wide = 2.0 * reach * (1 + 1e-6)
        side = max(side, wide / (1 << kernels.LEVELS))
        levels = min(max(math.ceil(math.log2(wide / side)), 1), kernels.LEVELS)
        return cls(centre, side, levels, reach * (1 + 5e-7))  # either way more than rounding

    def keys(self, points: NDArray[np.floating], workers: int) -> Keys:
        """Morton keys of points, shape (k,); 8^levels of those that are nowhere in the grid."""
        keys = np.empty(len(points), np.uint64)
        grid = self.centre, self.side, self.levels, self.reach, kernels.TURN
        threads.over_chunks(
            lambda first, last: kernels.point_keys(points, *grid, first, last, keys),
            len(points),
            workers,
            _LEAST_PART,
        )
        return keys


@dataclass(frozen=True)
class Order:
    """Points sorted by their Morton keys.

    Attributes
    ----------
    keys : ndarray of uint64, shape (k,)
        Sorted; only of points that are in the grid.
    rows : ndarray of uint32, shape (k,)
        Row of the input that each stood in.
    grid : Grid
        Of the finest cubes.
    """

    keys: Keys
    rows: NDArray[np.uint32]
    grid: Grid

    def starts(self, shift: int) -> NDArray[np.int64]:
        """Where runs of keys equal above `shift` bits begin, and where the last one ends."""
        starts = np.empty(len(self.keys) + 1, np.int64)
        runs = kernels.run_starts(self.keys, shift, starts)
        starts[runs] = len(self.keys)
        return starts[: runs + 1].copy()


def extent_of(points: NDArray[np.floating], workers: int) -> tuple[Array, Array, int]:
    """Least and largest coordinates of the finite points, and how many there are."""
    low, high = np.empty((2, workers, 3))
    count = np.zeros(workers, np.int64)
    bounds = _parts(len(points), workers)

    def look(first: int, last: int) -> None:
        for part in range(first, last):
            kernels.extent(points, bounds[part], bounds[part + 1], part, low, high, count)

    threads.over_chunks(look, workers, workers)
    return low.min(axis=0), high.max(axis=0), int(count.sum())


def blocks_of(points: NDArray[np.floating], memory: Memory) -> Iterator[NDArray[np.floating]]:
    """Points a million at a time."""
    for first in range(0, len(points), _BLOCK):
        yield points[first : first + _BLOCK]
        memory.release()


def extent_in_blocks(
    points: NDArray[np.floating], workers: int, memory: Memory
) -> tuple[Array, Array, int]:
    """`extent_of`, a million points at a time."""
    low, high, count = np.full(3, np.inf), np.full(3, -np.inf), 0
    for block in blocks_of(points, memory):
        part = extent_of(block, workers)
        low, high = np.minimum(low, part[0]), np.maximum(high, part[1])
        count += part[2]
    return low, high, count


def held_by(
    points: NDArray[np.floating], grid: Grid, workers: int, memory: Memory
) -> tuple[float, float]:
    """Points in an occupied cube, on average: of all, and without lonely points.

    Those are alone in their cubes, as far as more cubes are so than in clouds of even density.

    Cubes are not sorted to be counted: of m bits, n cubes that take theirs at random leave
    m exp(-n / m) unset (linear counting), which tells n to some 0.1 %; those of one point set
    theirs once, but for a share of exp(-n / m) that another cube sets as well.

    Parameters
    ----------
    points : ndarray of float, shape (k, 3)
        May lie on a disk.
    grid : Grid
        Of the cubes.
    workers : int
        Threads.
    memory : Memory
        Where the points lie.
    """
    size = max(_LEAST_BITS, 1 << (len(points) // 8).bit_length())
    bits, again = np.zeros((2, workers, size // 64), np.uint64)
    there = np.zeros(workers, np.int64)
    for block in blocks_of(points, memory):
        bounds = _parts(len(block), workers)

        def mark(first: int, last: int, block: Any = block, bounds: list[int] = bounds) -> None:
            for part in range(first, last):
                there[part] += kernels.mark_cubes(
                    block, grid.centre, grid.side, grid.levels, grid.reach, kernels.TURN,
                    bounds[part], bounds[part + 1], bits[part], again[part],
                )  # fmt: skip

        threads.over_chunks(mark, workers, workers)
    for part in range(1, workers):
        again[0] |= again[part] | (bits[0] & bits[part])
        bits[0] |= bits[part]
    marked, twice = kernels.count_bits(bits[0]), kernels.count_bits(again[0])
    unset, count = max(size - marked, 1), max(int(there.sum()), 1)
    cubes = max(size * math.log(size / unset), 1.0)
    alone = (marked - twice) * size / unset
    unsure = _UNSURE * math.sqrt(size * max(size / unset - cubes / size - 1.0, 0.0))
    if cubes - alone <= max(unsure, 0.5):
        return count / cubes, count / cubes
    lonely = max(alone - _ALONE * (cubes - alone), 0.0)
    return count / cubes, (count - lonely) / (cubes - lonely)


def order_of(points: NDArray[np.floating], grid: Grid, workers: int) -> Order:
    """Sort the points in a grid by Morton key."""
    keys, rows = radix_sort(grid.keys(points, workers), 3 * grid.levels + 1, workers)
    # Keys of points without one are the largest of all.
    there = int(np.searchsorted(keys, np.uint64(1 << 3 * grid.levels)))
    return Order(keys[:there], rows[:there], grid)


def positions(keys: Keys, axis: int) -> Array:
    """Coordinate of keys along an axis of the grid."""
    out = np.zeros(len(keys))
    for bit in range(kernels.LEVELS):
        out += ((keys >> np.uint64(3 * bit + axis)) & np.uint64(1)) * float(1 << bit)
    return out


def radix_sort(keys: Keys, bits: int, workers: int) -> tuple[Keys, NDArray[np.uint32]]:
    """Sort keys of so many bits, equal ones in the order in which they came.

    Returns them and where they stood; keys is worked in.
    """
    rows = np.arange(len(keys), dtype=np.uint32)
    if len(keys) < 2:
        return keys, rows
    parts = max(1, min(workers, len(keys) // _LEAST_PART))
    now, other = (keys, rows), (np.empty_like(keys), np.empty_like(rows))
    passes = -(-bits // _DIGIT)
    digit = -(-bits // passes)
    counts = np.empty((parts, 1 << digit), np.int64)
    for shift in range(0, bits, digit):
        _sort_by_digit(*now, shift, counts, *other)
        now, other = other, now
    return now


def _sort_by_digit(
    keys: Keys,
    rows: NDArray[np.uint32],
    shift: int,
    counts: NDArray[np.int64],
    sorted_keys: Keys,
    sorted_rows: NDArray[np.uint32],
) -> None:
    """Sort keys, and rows with them, by their bits from `shift` on; counts (parts, digits)."""
    parts = len(counts)
    bounds = _parts(len(keys), parts)

    def count(first: int, last: int) -> None:
        for part in range(first, last):
            kernels.count_digits(keys, shift, bounds[part], bounds[part + 1], counts[part])

    threads.over_chunks(count, parts, parts)
    # Smaller digits first, and of one digit those of earlier parts.
    ends = counts.T.ravel().cumsum()
    places = np.ascontiguousarray((ends - counts.T.ravel()).reshape(-1, parts).T)

    def move(first: int, last: int) -> None:
        for part in range(first, last):
            kernels.scatter(
                keys, rows, shift, bounds[part], bounds[part + 1], places[part],
                sorted_keys, sorted_rows,
            )  # fmt: skip

    threads.over_chunks(move, parts, parts)


def _parts(size: int, parts: int) -> list[int]:
    return [size * part // parts for part in range(parts + 1)]
