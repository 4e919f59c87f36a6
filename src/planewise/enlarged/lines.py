"""Rows, or columns, of an enlarged image that are one of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True, eq=False)
class Lines:
    """Rows, or columns, of an enlarged image that are one of its own.

    Attributes
    ----------
    first, count : ndarray of int, shape (n,)
        First of those that are own row i, and how many there are.
    known : (float, float), optional
        How far the middles of own rows are apart, and that of the first, where it is known and not
        what `first` and `count` show.
    """

    first: Index
    count: Index
    known: tuple[float, float] | None = None

    @property
    def times(self) -> float:
        """How many times as high the image is."""
        return self._line()[0]

    def own(self, focal: float, centre: float) -> tuple[float, float]:
        """Focal length and principal point in own pixels."""
        times, first = self._line()
        return focal / times, (centre - first) / times

    def every(self) -> tuple[Index, Index]:
        """Rows of the enlarged image that are one of its own, and which."""
        before = np.cumsum(self.count) - self.count
        rows = np.repeat(self.first - before, self.count) + np.arange(self.count.sum())
        return rows, np.repeat(np.arange(len(self.first)), self.count)

    def edges(self, top: int, bottom: int) -> tuple[int, int]:
        """First of the rows from own row `top` to before `bottom`, and that behind the last."""
        last = bottom - 1
        return int(self.first[top]), int(self.first[last] + self.count[last])

    def _line(self) -> tuple[float, float]:
        """How far the middles of own rows are apart, and that of the first, by least squares."""
        if self.known is not None:
            return self.known
        row = np.arange(1, len(self.first) - 1)  # the first and the last may be cut
        middle = (self.first + (self.count - 1) / 2)[1:-1]
        away = row - row.mean()
        times = float(away @ middle / (away @ away))
        return times, float(middle.mean() - times * row.mean())
