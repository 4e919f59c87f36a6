"""Depth that was enlarged by linear interpolation, and what it was before.

Between two own rows, depth is a straight line in every column; where these meet it bends. So
second differences along columns are 0 but in the two rows about an own one, and these are as far
from it as they are large, in every column alike: that comes again with every own row.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.own_lines import Index, Lines

Array = NDArray[np.float64]
Image = NDArray[Any]

_LEAST, _MOST = 1.45, 16.5  # times as high
_FEWEST = 16  # own rows
_COLUMNS = 8, 32  # that are looked at; to tell the own rows
_REGULAR = 25.0  # power of the period against the mean: 21 at most of what was not interpolated
_OTHER, _CLEAR = 0.75, 0.05  # of what straight lines half an own row off leave, at most
_ALIKE = 0.01  # times as high, and as wide
_NOTHING = 0.003  # of the median: what rounding leaves of interpolated zeros


@dataclass(frozen=True, kw_only=True, eq=False)
class Knots:
    """Where the own rows of an interpolated image lie among its rows.

    Attributes
    ----------
    size, own : int
        Rows of the image, and own ones.
    times, first : float
        How far own rows are apart, and where the first of them lies.
    """

    size: int
    own: int
    times: float
    first: float

    @classmethod
    def of(cls, size: int, own: int) -> tuple[Knots, Knots]:
        """Own rows that end where the image does, and those of which first and last are its."""
        between = size / own
        outer = cls(size=size, own=own, times=between, first=(between - 1) / 2)
        return outer, cls(size=size, own=own, times=(size - 1) / (own - 1), first=0.0)

    def shifted(self) -> Knots:
        """Own rows half as far from these as they are apart."""
        first = self.first + self.times / 2
        return Knots(size=self.size, own=self.own - 1, times=self.times, first=first)

    @property
    def lines(self) -> Lines:
        """Which rows are nearest to every own one."""
        between = np.ceil(self._places[:-1] + self.times / 2 - 1e-9).astype(np.intp)
        edges = np.concatenate(([0], between, [self.size]))
        return Lines(first=edges[:-1], count=np.diff(edges), known=(self.times, self.first))

    def own_rows(self, image: Array) -> Array:
        """Own rows of an image, NaN where it has none, shape (own, W).

        Of every row the lines on both of its sides tell it; their mean, where both are there, and
        the nearest row of the image, where none is.
        """
        top, bottom = self._ends
        start, end = image[top], image[bottom]
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = (end - start) / (bottom - top)[:, None]  # NaN where there is one row, or none
            below = start - slope * (top - self._places[:-1])[:, None]
            above = end + slope * (self._places[1:] - bottom)[:, None]
        # Before the first own row and behind the last all rows are like these.
        below, above = np.concatenate((below, image[-1:])), np.concatenate((image[:1], above))
        nearest = np.rint(self._places).astype(np.intp)
        below = np.where(np.isfinite(below), below, above)
        mean = (below + np.where(np.isfinite(above), above, below)) / 2
        return np.asarray(np.where(np.isfinite(mean), mean, image[nearest]))

    def enlarged(self, own: Array) -> Array:
        """The image of own rows, NaN where these are."""
        place = np.clip((np.arange(self.size) - self.first) / self.times, 0, self.own - 1)
        above = np.minimum(place.astype(np.intp), self.own - 2)
        share = (place - above)[:, None]
        here, behind = own[above], own[above + 1]
        mixed = (1 - share) * here + share * behind
        return np.asarray(np.where(share < 1e-9, here, np.where(share > 1 - 1e-9, behind, mixed)))

    @cached_property
    def _places(self) -> Array:
        return np.asarray(self.first + self.times * np.arange(self.own), np.float64)

    @cached_property
    def _ends(self) -> tuple[Index, Index]:
        """First and last of the rows between every two own ones."""
        top = np.ceil(self._places[:-1] - 1e-9).astype(np.intp)
        return top, np.maximum(np.floor(self._places[1:] + 1e-9).astype(np.intp), top)


def interpolated(image: Image) -> tuple[tuple[Lines, Lines], Image] | None:
    """Rows and columns of own pixels of an image that was enlarged linearly, and these pixels.

    Rows and columns must be within 1.5 and 16 times as many as they were, and as many times for
    both, unless that is beyond doubt: depth without noise, rounded, has regular steps, too. What is
    0 or not finite is no reading; readings that were mixed with zeros are told apart. Where errors
    of own pixels are smooth, as of networks, they stay as they are: each says what many do.
    """
    some = _knots(image)
    others = None if some is None else _knots(image.T)
    if some is None or others is None:
        return None
    (rows, left), (columns, left_there) = some, others
    alike = abs(rows.times / columns.times - 1) < _ALIKE or max(left, left_there) < _CLEAR
    if not alike or (image < 0).any():
        return None
    own = columns.own_rows(rows.own_rows(_readings(image)).T).T
    if _is_smooth(own):
        return None
    own[~(own > _NOTHING * np.nanmedian(own))] = 0  # NaN, too
    if image.dtype.kind in "iu":
        own = np.rint(own)
    return (rows.lines, columns.lines), own.astype(image.dtype)


def _readings(image: Image) -> Array:
    """Float depth, NaN where there is none."""
    out = image.astype(np.float64)
    out[~(np.isfinite(out) & (out != 0))] = np.nan
    return out


def _some_columns(image: Image, count: int) -> Array:
    """Readings of so many columns, or a few more."""
    step = max(1, image.shape[1] // count)
    return _readings(image[:, step // 2 :: step])


def _knots(image: Image) -> tuple[Knots, float] | None:
    """Own rows of an image, and what they leave of others; None where it was not interpolated."""
    period = _period(_some_columns(image, _COLUMNS[0]))
    if period is None:
        return None
    some = _some_columns(image, _COLUMNS[1])
    found, left = None, _OTHER
    for knots in _candidates(len(image), period):
        off, others = _left(some, knots), _left(some, knots.shifted())
        if off < left * others < np.inf:
            found, left = knots, off / others
        if left < _CLEAR:
            break
    return None if found is None else (found, left)


def _candidates(size: int, period: float) -> Iterator[Knots]:
    """Own rows that come again after so many of the image's: of it, an alias or a harmonic."""
    for turns in (1 / period, 1 - 1 / period):
        for part in (1, 2, 3, 4):
            about = round(size * turns / part)
            for own in (about, about - 1, about + 1):
                if own >= _FEWEST and _LEAST <= size / own <= _MOST:
                    yield from Knots.of(size, own)


def _period(image: Array) -> float | None:
    """After how many rows the same comes again in the second differences along columns."""
    if len(image) < 2 * _FEWEST:
        return None
    signals = np.stack(_bends(image))
    signals -= signals.sum(axis=1, keepdims=True) / signals.shape[1]
    waves = np.fft.rfft(signals)
    power = (waves.real**2 + waves.imag**2).sum(axis=0)
    first = int(np.ceil(signals.shape[1] / _MOST))
    best = first + int(power[first:].argmax())
    return signals.shape[1] / best if power[best] * power.size > _REGULAR * power.sum() else None


def _bends(image: Array) -> tuple[Array, Array]:
    """What second differences along columns show, two arrays of shape (H - 4,).

    How alike those of every row and the one before are, -1 to 1; and what share of the energy of
    three rows is that of the middle one.
    """
    slope = image[1:] - image[:-1]
    bend = slope[1:] - slope[:-1]
    bend[np.isnan(bend)] = 0
    energy = np.einsum("ij,ij->i", bend, bend) + np.finfo(float).tiny
    product, two = np.einsum("ij,ij->i", bend[1:-1], bend[:-2]), energy[1:] + energy[:-1]
    return 2 * product / two[:-1], energy[1:-1] / (two[:-1] + energy[2:])


def _is_smooth(image: Array) -> bool:
    """Whether errors of neighbours are alike; else their second differences are opposed."""
    sides = (image, image.T)
    return sum(float(_bends(_some_columns(each, _COLUMNS[1]))[0].mean()) for each in sides) > 0


def _left(image: Array, knots: Knots) -> float:
    """What straight lines between own rows leave of an image, as a mean; infinite where of none."""
    off = np.abs(knots.enlarged(knots.own_rows(image)) - image)
    there = np.isfinite(off)
    return float(off[there].mean()) if there.any() else np.inf
