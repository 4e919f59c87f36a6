"""What an argument may be: numbers, whether Python's or NumPy's."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import Any


def is_finite(value: Any) -> bool:
    """Whether it is a real number, and finite.

    Examples
    --------
    >>> is_finite(1.5), is_finite("1.5"), is_finite(float("nan"))
    (True, False, False)
    """
    return isinstance(value, Real) and math.isfinite(value)


def is_whole(value: Any) -> bool:
    """Whether it is an integer.

    Examples
    --------
    >>> is_whole(3), is_whole(3.0)
    (True, False)
    """
    return isinstance(value, Integral)
