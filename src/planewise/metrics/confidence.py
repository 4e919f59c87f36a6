"""Mean over frames and the interval it is known to, from Student's t."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, kw_only=True)
class Interval:
    """Mean of a number over frames, and its confidence interval.

    Attributes
    ----------
    mean : float
        Over the frames where the number is defined; NaN where it is on none.
    low, high : float
        Ends of the interval; NaN with fewer than two frames.
    count : int
        Frames where the number is defined.
    """

    mean: float
    low: float
    high: float
    count: int


def mean_interval(values: ArrayLike, *, coverage: float = 0.95) -> Interval:
    """Mean and confidence interval of independent frames; NaN is "not defined" and left out.

    Parameters
    ----------
    values : array_like, shape (n,)
        One number a frame.
    coverage : float
        Probability that the interval contains the expected value, were the numbers normal.

    Returns
    -------
    Interval
        mean -+ t s / sqrt(n), with the unbiased standard deviation s and t of n - 1 degrees of
        freedom.

    Raises
    ------
    ValueError
        If `values` is not a row of finite numbers and NaN, or `coverage` not between 0 and 1.

    Examples
    --------
    >>> mean_interval([1.0, 2.0, 3.0])
    Interval(mean=2.0, low=-0.48..., high=4.48..., count=3)
    """
    row = np.asarray(values, np.float64)
    if row.ndim != 1 or np.isinf(row).any():
        raise ValueError(
            f"values must be finite numbers (or NaN) of shape (n,), got shape {row.shape}"
            + (" with infinity among them" if row.ndim == 1 else "")
        )
    row = row[~np.isnan(row)]
    t = student_t(coverage, max(1, row.size - 1))
    if not row.size:
        return Interval(mean=math.nan, low=math.nan, high=math.nan, count=0)
    mean = float(row.mean())
    if row.size < 2:
        return Interval(mean=mean, low=math.nan, high=math.nan, count=1)
    half = t * float(row.std(ddof=1)) / math.sqrt(row.size)
    return Interval(mean=mean, low=mean - half, high=mean + half, count=row.size)


def student_t(coverage: float, freedom: int) -> float:
    """Return t with P(|T| <= t) = `coverage` for Student's T of so many degrees of freedom.

    Raises
    ------
    ValueError
        If `coverage` is not between 0 and 1, or `freedom` below 1.

    Examples
    --------
    >>> round(student_t(0.95, 1), 3), round(student_t(0.95, 34), 3)
    (12.706, 2.032)
    """
    if not 0 < coverage < 1:
        raise ValueError(f"coverage must lie between 0 and 1, got {coverage}")
    if freedom < 1:
        raise ValueError(f"freedom must be at least 1, got {freedom}")
    low, high = 0.0, math.pi / 2
    for _ in range(60):  # bisection to the last bit
        middle = (low + high) / 2
        if _share_within(middle, freedom) < coverage:
            low = middle
        else:
            high = middle
    return math.sqrt(freedom) * math.tan(low)


def _share_within(angle: float, freedom: int) -> float:
    """P(|T| <= sqrt(freedom) tan(angle)): Abramowitz and Stegun, 26.7.3 and 26.7.4."""
    odd = freedom % 2
    step = np.arange(1, (freedom - odd) // 2)
    ratio = (2 * step - 1 + odd) / (2 * step + odd)
    series = math.sin(angle) * (1 + float(np.cumprod(ratio * math.cos(angle) ** 2).sum()))
    if not odd:
        return series
    return 2 / math.pi * (angle + (math.cos(angle) * series if freedom > 1 else 0))
