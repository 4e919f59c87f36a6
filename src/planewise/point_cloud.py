"""A point cloud in memory, and one in a file that is read block by block.

Coordinates far from their origin are kept as points less an offset of whole metres: a map grid's
millions of metres then cost the points no digits, for the difference of two floats that near is
exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import checked_count, checked_metres, checked_points, shown, unmasked
from planewise.errors import PlanewiseError, SetupError, in_one_line

Array = NDArray[np.float64]
Points = NDArray[np.float32] | Array

BLOCK = 1_000_000
"""Points that are read at a time unless another number is asked for."""

_FAR = 10_000.0  # metres from which a coordinate gets an offset
_SAMPLED = 100_000  # points that say where most of them lie
_MOST, _STRAY = 0.9, 100.0  # this share of them; times as far from the middle: no place of a cloud
_STEP = 100.0  # offsets are multiples of it
_SAMPLE = 10_000  # points that tell to what step all were rounded


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class PointCloud:
    """Points with what a file knows of them; row i of every array is one point.

    Attributes
    ----------
    points : ndarray of float32 or float64, shape (k, 3)
        Metres, relative to `offset`. Rows that are not finite are no reading.
    offset : ndarray, shape (3,)
        What the file's coordinates have in addition: coordinate = point + offset.
    colour : ndarray of uint8, shape (k, 3), optional
        Red, green, blue.
    intensity : ndarray of float32, shape (k,), optional
        In the file's own unit.
    scan : ndarray of int32, shape (k,), optional
        Row of `origins` that each point was measured from.
    origins : ndarray, shape (s, 3), optional
        Where the scanner stood, metres, relative to `offset`.
    labels : ndarray of int32, shape (k,), optional
        True plane of each point, 0 for none.

    Raises
    ------
    ValueError
        If an array has another shape, or is none.
    """

    points: Points
    offset: Array = field(default_factory=lambda: np.zeros(3))
    colour: NDArray[np.uint8] | None = None
    intensity: NDArray[np.float32] | None = None
    scan: NDArray[np.int32] | None = None
    origins: Array | None = None
    labels: NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", checked_points(self.points, 3))
        offset = checked_metres("offset", self.offset)
        if offset.shape != (3,) or not np.isfinite(offset).all():
            raise ValueError(f"offset must be three finite numbers, got {shown(self.offset)}")
        object.__setattr__(self, "offset", offset)
        count = len(self.points)
        for name, row, kind in (
            ("colour", (3,), np.uint8),
            ("intensity", (), np.float32),
            ("scan", (), np.int32),
            ("labels", (), np.int32),
        ):
            if (given := getattr(self, name)) is None:
                continue
            value = unmasked(name, given)
            if value.shape != (count, *row):
                raise ValueError(
                    f"{name} must have shape {(count, *row)}, one row a point, got {value.shape}"
                )
            object.__setattr__(self, name, _as_kind(name, value, kind))
        if self.origins is not None:
            origins = checked_metres("origins", self.origins)
            if origins.shape[1:] != (3,):
                raise ValueError(f"origins must have shape (s, 3), got {origins.shape}")
            object.__setattr__(self, "origins", origins)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def coordinates(self) -> Array:
        """Points as the file has them, shape (k, 3), metres."""
        return np.asarray(self.points + self.offset)

    @property
    def rounding(self) -> float:
        """Step in metres to which numbers of 32 bits rounded far coordinates; 0 if they did not.

        That of the axis where it is largest. Points may be of 64 bits by now: what was rounded are
        multiples of the step, some of them odd ones.

        Examples
        --------
        >>> place = np.random.default_rng(0).uniform(0, 5, (100, 3)) + (0, 5_000_000, 0)
        >>> PointCloud(points=place).rounding, PointCloud(points=place.astype(np.float32)).rounding
        (0.0, 0.5)
        """
        some = self.points[:: len(self) // _SAMPLE + 1].astype(np.float64)
        some = some[np.isfinite(some).all(axis=1)] + self.offset
        largest = 0.0
        for coordinate in some.T if len(some) else ():
            nearest = np.abs(coordinate).min()
            if not _FAR <= nearest <= np.finfo(np.float32).max:
                continue
            # The step of binary fractions is finest where they are least.
            step = float(np.spacing(np.float32(nearest)))
            multiple = coordinate / step
            if (multiple % 1 == 0).all() and (multiple % 2 == 1).any():
                largest = max(largest, step)
        return largest


def _as_kind(name: str, value: NDArray[Any], kind: type[np.generic]) -> NDArray[Any]:
    """Numbers of a column as what it is made of, where that holds them."""
    if value.dtype == kind:
        return value
    if value.dtype.kind in "fiu":
        with np.errstate(all="ignore"):
            made = value.astype(kind)
        if kind is np.float32 or np.array_equal(made, value):
            return made
    raise ValueError(f"{name} must be numbers that {kind.__name__} can hold, got {value.dtype}")


@dataclass(frozen=True, kw_only=True, eq=False)
class CloudFile:
    """A file of points that is read block by block.

    Attributes
    ----------
    path : Path
        The file.
    count : int, optional
        Number of points; ``None`` where only reading the whole file tells.
    bounds : ndarray, shape (2, 3), optional
        Least and largest coordinates as the file states them, metres; ``None`` where it does not.
    offset : ndarray, shape (3,)
        Offset of all its blocks.
    origins : ndarray, shape (s, 3), optional
        Where the scanner stood, relative to `offset`.
    unit : str
        What its coordinates are in, where it says so and that is not metres throughout; else empty.
    shape : (height, width), optional
        Of the image whose pixels its points are, row by row (`planewise.image_of_points`); ``None``
        where the file states none.
    """

    path: Path
    count: int | None
    offset: Array
    blocks: Callable[[int], Iterator[PointCloud]] = field(repr=False)
    bounds: Array | None = None
    origins: Array | None = None
    unit: str = ""
    shape: tuple[int, int] | None = None

    def chunks(self, size: int = BLOCK) -> Iterator[PointCloud]:
        """Read the file in blocks; no more than one is held in memory.

        Parameters
        ----------
        size : int
            Largest number of points of a block.

        Yields
        ------
        PointCloud
            In the order of the file, all with its `offset`.

        Raises
        ------
        PlanewiseError
            If the file turns out to be damaged, or has changed since it was opened.
        """
        checked_count("size", size)
        with readable(self.path):
            yield from self.blocks(size)

    def read(self) -> PointCloud:
        """Read the whole file.

        Raises
        ------
        PlanewiseError
            If it is damaged.
        """
        return joined(list(self.chunks()), self.offset, self.origins)


def joined(blocks: Sequence[PointCloud], offset: Array, origins: Array | None) -> PointCloud:
    """Put blocks of one offset together.

    Parameters
    ----------
    blocks : sequence of PointCloud
        In order. What one of them lacks is left out of the result.
    offset, origins
        Of the result.
    """
    if not blocks:
        return PointCloud(points=np.empty((0, 3)), offset=offset, origins=origins)
    if len(blocks) == 1:
        return replace(blocks[0], origins=origins)

    def column(name: str) -> NDArray[np.generic] | None:
        parts = [getattr(block, name) for block in blocks]
        return None if any(part is None for part in parts) else np.concatenate(parts)

    names = ("points", "colour", "intensity", "scan", "labels")
    return PointCloud(
        offset=offset,
        origins=origins,
        **{name: column(name) for name in names},  # type: ignore[arg-type]
    )


def offset_of(coordinates: NDArray[np.floating] | Array) -> Array:
    """Choose an offset for coordinates, by their middle (`offset_near`).

    Parameters
    ----------
    coordinates : ndarray, shape (k, 3)
        Metres; rows that are not finite, and strays (`extent_of_most`), are ignored.

    Returns
    -------
    ndarray, shape (3,)
        Multiples of 100 m.
    """
    low, high = extent_of_most(coordinates)[0]
    return offset_near(low / 2 + high / 2)  # whose sum may be too large for a number


@np.errstate(over="ignore", invalid="ignore")  # of damaged points, which may be of any size
def extent_of_most(points: NDArray[np.floating]) -> tuple[Array, int]:
    """Least and largest coordinates of the finite points but for strays, and how many these are.

    Of shape (2, 3), zeros without any. Points may lie on a disk: they are looked at block by block.
    Strays are a hundred times as far off as most points, such as missing ones at the origin of a
    cloud in map coordinates.
    """
    some = points[:: 1 + len(points) // _SAMPLED]
    some = some[np.isfinite(some).all(axis=1)].astype(np.float64)
    if not len(some):
        return np.zeros((2, 3)), 0
    # Missing points share one place, however many they are; places by a number of their own.
    some = some[np.unique(some @ (1.0, math.e, math.pi), return_index=True)[1]]
    middle = np.median(some, axis=0)
    usual = float(np.quantile(np.abs(some - middle).max(axis=1), _MOST))
    return _extent(points, middle, _STRAY * usual or np.inf)


def _extent(points: NDArray[np.floating], middle: Array, farthest: float) -> tuple[Array, int]:
    """Extent of the finite points that are near enough, and how many others there are."""
    low, high, others = np.full(3, np.inf), np.full(3, -np.inf), 0
    for first in range(0, len(points), BLOCK):
        block = points[first : first + BLOCK]
        finite = block[np.isfinite(block).all(axis=1)]
        near = finite
        if farthest < np.inf:
            near = finite[(np.abs(finite - middle) <= farthest).all(axis=1)]
        others += len(finite) - len(near)
        if len(near):
            low, high = np.minimum(low, near.min(axis=0)), np.maximum(high, near.max(axis=0))
    return np.array((low, high)) if (low <= high).all() else np.zeros((2, 3)), others


def offset_near(middle: Array) -> Array:
    """Offset for points about a place: its nearest multiples of 100 m.

    A coordinate within 10 km of zero keeps its digits as it is, and has none.
    """
    far = np.abs(middle) >= _FAR
    return np.asarray(np.where(far, np.round(middle / _STEP) * _STEP, 0.0))


def less(coordinates: NDArray[np.generic], offset: Array) -> Points:
    """Coordinates relative to an offset, float32 where they were; the subtraction is exact.

    Damaged ones may be too large for float32 and are infinite then.
    """
    kind = np.float32 if coordinates.dtype == np.float32 else np.float64
    moved = coordinates.astype(np.float64) - offset if offset.any() else coordinates
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(moved, dtype=kind)  # type: ignore[return-value]


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn whatever reading foreign bytes raises into one line that names the file."""
    try:
        yield
    except (SetupError, GeneratorExit, KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except PlanewiseError as error:
        message = _printable(str(error), 300)
        raise PlanewiseError(
            message if message.startswith("cloud: ") else f"cloud: {path.name} {message}"
        ) from None
    except OSError as error:
        raise PlanewiseError(f"cloud: {path} cannot be read ({error.strerror or error})") from error
    except BaseException as error:  # decoders may raise anything, those in Rust no Exception
        detail = _printable(in_one_line(error))
        raise PlanewiseError(
            f"cloud: {path.name} cannot be read; it is damaged or not what its name says ({detail})"
        ) from error


def _printable(text: str, most: int = 120) -> str:
    """A line that a terminal can show: files may put anything into what is quoted of them."""
    shown = "".join(letter if letter.isprintable() else "?" for letter in text)
    return shown if len(shown) <= most else shown[: most - 3] + "..."
