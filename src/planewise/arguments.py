"""What an argument may be: numbers of Python or NumPy, Python's once taken, and masked arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

LEAST_LENGTH, MOST_LENGTH = 1e-12, 1e9
"""Metres; beyond, squares and fourth powers of lengths and of resolutions are no numbers."""

FINEST = 1e-12
"""Least noise as a share of depth; less is lost in the rounding of doubles."""

# What is given as a rule comes first: asking an abstract class takes ten times as long.
_WHOLE = int, Integral
_SEQUENCES = tuple, Sequence, np.ndarray


def unmasked(name: str, given: ArrayLike) -> NDArray[Any]:
    """An array, 0 where a masked one is masked.

    Raises
    ------
    ValueError
        If it cannot be one, such as a list of rows of several lengths.
    """
    if np.ma.isMaskedArray(given):
        return np.asarray(np.ma.filled(given, 0))
    try:
        return np.asarray(given)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} cannot be made an array: {error}") from None


def unit_told(depth: NDArray[np.generic], depth_scale: float | None) -> bool:
    """Whether the unit of readings is stated, and not taken from the sensor's resolution."""
    return depth_scale is not None or depth.dtype.kind == "f"


def checked_points(points: ArrayLike, columns: int | None = None) -> NDArray[np.floating]:
    """Points as an array of floating-point numbers, the same one where they are; NaN where masked.

    Raises
    ------
    ValueError
        If they are no real numbers in so many columns, or in at least two.
    """
    if isinstance(points, np.ma.MaskedArray):
        points = np.ma.filled(points.astype(np.float64), np.nan)
    if hasattr(points, "points"):
        raise ValueError(
            "points must be an array; of a cloud that is cloud.points, and detect_planes_in_cloud "
            "takes clouds"
        )
    array = unmasked("points", points)
    wide = array.ndim == 2 and (array.shape[1] == columns if columns else array.shape[1] >= 2)
    if not wide or array.dtype.kind not in "fiu":
        expected = f"(k, {columns})" if columns else "(k, n) with n >= 2"
        raise ValueError(
            f"points must be real numbers of shape {expected}, one point a row, "
            f"got shape {array.shape} of {array.dtype}"
        )
    return array if array.dtype in (np.float32, np.float64) else array.astype(np.float64)


def checked_metres(name: str, given: ArrayLike) -> NDArray[np.float64]:
    """Array of metres.

    Raises
    ------
    ValueError
        If it is not of numbers, or some are masked.
    """
    if np.ma.is_masked(given):
        raise ValueError(f"{name} must not be masked; leave those out, or give a number for them")
    return real_numbers(name, given, "numbers (metres)")


def checked_pixels(pixels: ArrayLike) -> NDArray[np.float64]:
    """Places in an image, shape (..., 2).

    Raises
    ------
    ValueError
        If they are no pairs of numbers.
    """
    array = real_numbers("pixels", pixels, "numbers")
    if array.shape[-1:] != (2,):
        raise ValueError(f"pixels must have shape (..., 2), x and y, got shape {array.shape}")
    return array


def real_numbers(name: str, given: ArrayLike, expected: str) -> NDArray[np.float64]:
    """Array of real numbers.

    Raises
    ------
    ValueError
        If it cannot be one.
    """
    try:
        if not np.iscomplexobj(given):  # NumPy would but warn, and drop what is imaginary
            return np.asarray(given, np.float64)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(f"{name} must be {expected}, got {shown(given)}")


def shown(value: Any) -> str:
    """What was given, or the beginning of it, in one line.

    Examples
    --------
    >>> shown(np.eye(2))
    'array([[1., 0.], [0., 1.]])'
    """
    return f"{' '.join(repr(value).split()):.60}"


def plane_rows(name: str, planes: Any, columns: int) -> NDArray[np.float64]:
    """Rows (normal, distance) of `planewise.Plane` or of array_like; their lengths are unchecked.

    Raises
    ------
    ValueError
        If they are no numbers, or not in so many columns.
    """
    if not isinstance(planes, Iterable):
        raise ValueError(f"{name} must be a list, such as model.planes, got {planes!r}")
    if np.ma.is_masked(planes):
        raise ValueError(f"{name} must not be masked; leave those out")
    rows: Any = [getattr(plane, "coefficients", plane) for plane in planes]
    rows = unmasked(name, rows)
    rows = rows.reshape(-1, columns) if not len(rows) else rows
    if rows.ndim != 2 or rows.shape[1] != columns or rows.dtype.kind not in "fiu":
        raise ValueError(
            f"{name}: expected numbers of shape (N, {columns}), got {rows.dtype} of {rows.shape}"
        )
    return np.asarray(rows, np.float64)


def is_finite(value: Any) -> bool:
    """Whether it is a real number, and finite, also as a float.

    Examples
    --------
    >>> is_finite(1.5), is_finite("1.5"), is_finite(float("nan")), is_finite(True)
    (True, False, False, False)
    >>> is_finite(10**300), is_finite(10**400)
    (True, False)
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer that no float can hold
        return False


def is_whole(value: Any) -> bool:
    """Whether it is an integer.

    Examples
    --------
    >>> is_whole(3), is_whole(3.0), is_whole(True)
    (True, False, False)
    """
    return not isinstance(value, bool) and isinstance(value, _WHOLE)


def checked_count(name: str, value: Any, least: int = 1) -> int:
    """Whole number, as Python's.

    Raises
    ------
    ValueError
        If it is none, or too small.
    """
    if not (is_whole(value) and value >= least):
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return int(value)


def checked_shape(name: str, shape: Any) -> tuple[int, int]:
    """Height and width of an image; a list will do.

    Raises
    ------
    ValueError
        If they are not two whole numbers of pixels.
    """
    row = isinstance(shape, _SEQUENCES) and getattr(shape, "ndim", 1) == 1
    given = tuple(shape) if row else ()
    if len(given) != 2 or not all(is_whole(each) and each >= 1 for each in given):
        raise ValueError(
            f"{name} must be (height, width), whole numbers of pixels, got {shown(shape)}"
        )
    return int(given[0]), int(given[1])


def checked_seed(name: str, rng: Any) -> int | np.random.Generator:
    """Seed, as a number of Python, or generator.

    Raises
    ------
    ValueError
        If it is neither.
    """
    if isinstance(rng, np.random.Generator):
        return rng
    if not (is_whole(rng) and rng >= 0):
        raise ValueError(
            f"{name} must be a seed, not negative, or a numpy.random.Generator, got {rng!r}"
        )
    return int(rng)


def checked_scale(depth_scale: float | None) -> float | None:
    """Metres per unit of integer depth, if it is said.

    Raises
    ------
    ValueError
        If it is no positive number, or that of no sensor.
    """
    if depth_scale is None:
        return None
    if not (is_finite(depth_scale) and depth_scale > 0):
        raise ValueError(
            f"depth_scale must be a positive number of metres, got {shown(depth_scale)}"
        )
    if not LEAST_LENGTH <= depth_scale <= MOST_LENGTH:
        raise ValueError(
            f"depth_scale must lie within {LEAST_LENGTH:g} and {MOST_LENGTH:g} metres, "
            f"got {depth_scale!r}"
        )
    return float(depth_scale)


def make_plain(record: object, kind: Callable[[Any], Any], *names: str) -> None:
    """Let attributes of a frozen record, unless they are ``None``, be of a plain kind.

    Result files can hold Python's numbers, but not NumPy's.
    """
    for name in names:
        if (value := getattr(record, name)) is not None:
            object.__setattr__(record, name, kind(value))


def make_shares(record: object, *names: str) -> None:
    """Let attributes of a frozen record be plain numbers between 0 and 1, both excluded."""
    for name in names:
        value = getattr(record, name)
        if not (is_finite(value) and 0 < value < 1):
            raise ValueError(f"{name} must lie between 0 and 1, both excluded, got {value!r}")
    make_plain(record, float, *names)


def make_counts(record: object, *names: str, least: int = 1) -> None:
    """Let attributes of a frozen record be whole numbers, as `checked_count` gives them."""
    for name in names:
        object.__setattr__(record, name, checked_count(name, getattr(record, name), least))
