"""Points in Morton order: the octree in which cells of a cloud are found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise import threads
from planewise.clouds.memory import Memory
from planewise.kernels import cloud_keys as kernels

Array = NDArray[np.float64]
Keys = NDArray[np.uint64]

_LEAST_PART = 50_000  # points that are worth a thread
_BLOCK = 1_000_000  # points that are looked at together


@dataclass(frozen=True)
class Order:
    """Points sorted by the Morton key of a turned grid.

    Attributes
    ----------
    keys : ndarray of uint64, shape (k,)
        Sorted; only of points that are finite.
    rows : ndarray of uint32, shape (k,)
        Row of the input that each stood in.
    centre : ndarray, shape (3,)
        What coordinates are taken relative to.
    side : float
        Of the finest cubes, metres.
    """

    keys: Keys
    rows: NDArray[np.uint32]
    centre: Array
    side: float


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


def extent_in_blocks(
    points: NDArray[np.floating], workers: int, memory: Memory
) -> tuple[Array, Array, int]:
    """`extent_of`, a million points at a time."""
    low, high, count = np.full(3, np.inf), np.full(3, -np.inf), 0
    for first in range(0, len(points), _BLOCK):
        part = extent_of(points[first : first + _BLOCK], workers)
        low, high = np.minimum(low, part[0]), np.maximum(high, part[1])
        count += part[2]
        memory.release()
    return low, high, count


def order_of(
    points: NDArray[np.floating], centre: Array, reach: float, side: float, workers: int
) -> Order:
    """Sort points by Morton key.

    Parameters
    ----------
    points : ndarray of float, shape (k, 3)
        Rows that are not finite, or farther than `reach` off, are left out.
    centre : ndarray, shape (3,)
        Of the grid.
    reach : float
        Farthest distance from the centre, metres.
    side : float
        Least side of the finest cubes, metres; larger where 2^21 of them do not reach.
    workers : int
        Threads.
    """
    side = max(side, 2.0 * reach / (1 << kernels.LEVELS) * (1 + 1e-6))
    keys = np.empty(len(points), np.uint64)
    threads.over_chunks(
        lambda first, last: kernels.point_keys(
            points, centre, side, kernels.TURN, first, last, keys
        ),
        len(points),
        workers,
        _LEAST_PART,
    )
    keys, rows = radix_sort(keys, workers)
    # Keys of points without one are the largest of all.
    there = int(np.searchsorted(keys, kernels.NO_KEY))
    return Order(keys[:there], rows[:there], centre, side)


def positions(keys: Keys, axis: int) -> Array:
    """Coordinate of keys along an axis of the grid."""
    out = np.zeros(len(keys))
    for bit in range(kernels.LEVELS):
        out += ((keys >> np.uint64(3 * bit + axis)) & np.uint64(1)) * float(1 << bit)
    return out


def radix_sort(keys: Keys, workers: int) -> tuple[Keys, NDArray[np.uint32]]:
    """Sort keys, equal ones in the order in which they came; returns them and where they stood."""
    rows = np.arange(len(keys), dtype=np.uint32)
    if len(keys) < 2:
        return keys, rows
    parts = max(1, min(workers, len(keys) // _LEAST_PART))
    bounds = _parts(len(keys), parts)
    other_keys, other_rows = np.empty_like(keys), np.empty_like(rows)
    counts = np.empty((parts, 1 << kernels.DIGIT), np.int64)
    differing = int(np.bitwise_or.reduce(keys)) ^ int(np.bitwise_and.reduce(keys))
    for shift in range(0, 64, kernels.DIGIT):
        if not (differing >> shift) & ((1 << kernels.DIGIT) - 1):
            continue

        def count(first: int, last: int, shift: int = shift, keys: Keys = keys) -> None:
            for part in range(first, last):
                kernels.count_digits(keys, shift, bounds[part], bounds[part + 1], counts[part])

        threads.over_chunks(count, parts, parts)
        # Smaller digits first, and of one digit those of earlier parts.
        ends = counts.T.ravel().cumsum()
        places = np.ascontiguousarray((ends - counts.T.ravel()).reshape(-1, parts).T)

        def move(
            first: int,
            last: int,
            shift: int = shift,
            keys: Keys = keys,
            rows: NDArray[np.uint32] = rows,
            places: NDArray[np.int64] = places,
            to: tuple[Keys, NDArray[np.uint32]] = (other_keys, other_rows),
        ) -> None:
            for part in range(first, last):
                kernels.scatter(
                    keys, rows, shift, bounds[part], bounds[part + 1], places[part], *to
                )

        threads.over_chunks(move, parts, parts)
        keys, other_keys = other_keys, keys
        rows, other_rows = other_rows, rows
    return keys, rows


def _parts(size: int, parts: int) -> list[int]:
    return [size * part // parts for part in range(parts + 1)]
