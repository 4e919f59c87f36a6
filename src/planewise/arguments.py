"""What an argument may be: numbers of Python or NumPy, Python's once taken, and masked arrays."""

from __future__ import annotations

import math
from collections.abc import Callable
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def unmasked(image: ArrayLike) -> NDArray[Any]:
    """An array, 0 where a masked one is masked."""
    return np.asarray(np.ma.filled(image, 0) if np.ma.isMaskedArray(image) else image)


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
    return not isinstance(value, bool) and isinstance(value, Integral)


def checked_scale(depth_scale: float | None) -> float | None:
    """Metres per unit of integer depth, if it is said.

    Raises
    ------
    ValueError
        If it is no positive number.
    """
    if depth_scale is None:
        return None
    if not (is_finite(depth_scale) and depth_scale > 0):
        raise ValueError(f"depth_scale must be a positive number of metres, got {depth_scale!r}")
    return float(depth_scale)


def make_plain(record: object, kind: Callable[[Any], Any], *names: str) -> None:
    """Let attributes of a frozen record, unless they are ``None``, be of a plain kind.

    Result files can hold Python's numbers, but not NumPy's.
    """
    for name in names:
        if (value := getattr(record, name)) is not None:
            object.__setattr__(record, name, kind(value))
