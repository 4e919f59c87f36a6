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

from planewise.density import has_reading, spread, spread_rows
from planewise.enlarged.lines import Index, Lines

Array = NDArray[np.float64]
Image = NDArray[Any]

_LEAST, _MOST = 1.15, 16.5  # times as high
_FEWEST = 32  # own rows: fewer repeat by chance
_COLUMNS = 8, 32  # that are looked at; to tell the own rows
_REGULAR = 30.0  # power of the period against the median: 29 of what was not, 47 if very smooth
_OTHER, _CLEAR = 0.3, 0.05  # of what straight lines half an own row off leave, at most
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

    def coarser(self) -> Iterator[Knots]:
        """Own rows all of which are among these, the fewest first."""
        corners = self.first == 0.0
        for part in range(self.own // 2, 1, -1):
            own, rest = divmod(self.own - corners, part)
            if rest == 0 and own + corners > 1 and (corners or part % 2 == 1):
                yield Knots.of(self.size, own + corners)[corners]

    @property
    def lines(self) -> Lines:
        """Which rows are nearest to every own one."""
        between = np.ceil(self._places[:-1] + self.times / 2 - 1e-9).astype(np.intp)
        edges = np.concatenate(([0], between, [self.size]))
        return Lines(first=edges[:-1], count=np.diff(edges), known=(self.times, self.first))

    def own_rows(self, image: Array) -> Array:
        """Own rows of an image, by least squares, shape (own, W).

        NaN are no readings. What these do not tell is what the nearest row of the image is.
        """
        from planewise.kernels import knots as kernels  # loads Numba

        own = np.empty((image.shape[1], self.own))
        kernels.own_readings(np.ascontiguousarray(image.T), *self._neighbours, own)
        nearest = image[np.rint(self._places).astype(np.intp)]
        return np.where(np.isnan(own.T), nearest, own.T)

    def enlarged(self, own: Array) -> Array:
        """The image of own rows, NaN where these are."""
        above, share = self._neighbours
        here, behind, part = own[above], own[above + 1], share[:, None]
        mixed = (1 - part) * here + part * behind
        return np.where(part == 0, here, np.where(part == 1, behind, mixed))

    @cached_property
    def _places(self) -> Array:
        return np.asarray(self.first + self.times * np.arange(self.own), np.float64)

    @cached_property
    def _neighbours(self) -> tuple[Index, Array]:
        """Of every row of the image the own one above it, and how far it is to the next, 0 to 1."""
        place = np.clip((np.arange(self.size) - self.first) / self.times, 0, self.own - 1)
        whole = np.rint(place)
        place = np.where(np.abs(place - whole) < 1e-9, whole, place)
        above = np.minimum(place.astype(np.intp), self.own - 2)
        return above, place - above


def interpolated(image: Image) -> tuple[tuple[Lines, Lines], Image] | None:
    """Rows and columns of own pixels of an image that was enlarged linearly, and these pixels.

    Rows and columns must be within 1.2 and 16 times as many as they were, and as many times for
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
    readings = _readings(image)
    if not alike or (readings < 0).any():
        return None
    own = columns.own_rows(rows.own_rows(readings).T).T
    if _is_smooth(own):
        return None
    own[~(own > _NOTHING * np.nanmedian(own))] = 0  # NaN, too
    if image.dtype.kind in "iu":
        own = np.rint(own)
    return (rows.lines, columns.lines), own.astype(image.dtype)


def _readings(image: Image) -> Array:
    """Float depth, NaN where there is none."""
    out = image.astype(np.float64)
    out[~has_reading(out)] = np.nan
    return out


def _some_columns(image: Image, count: int) -> Array:
    """Readings of so many columns, or a few more."""
    return _readings(spread_rows(image.T, count).T)


def _knots(image: Image) -> tuple[Knots, float] | None:
    """Own rows of an image, and what they leave of others; None where it was not interpolated."""
    period = _period(image)
    if period is None:
        return None
    some = _some_columns(image, _COLUMNS[1])
    found, left = None, _OTHER
    for knots in _candidates(len(image), period):
        share = _left(some, knots)
        if share < left:
            found, left = knots, share
        if left < _CLEAR:
            # Lines between some rows are lines between more of them, too.
            found = next((each for each in knots.coarser() if _left(some, each) < _CLEAR), knots)
            break
    return None if found is None or found.own < _FEWEST else (found, left)


def _candidates(size: int, period: float) -> Iterator[Knots]:
    """Own rows that come again after so many of the image's: of it, an alias or a harmonic."""
    for turns in (1 / period, 1 - 1 / period):
        for part in (1, 2, 3, 4):
            about = round(size * turns / part)
            for own in (about, about - 1, about + 1):
                if own >= _FEWEST and _LEAST <= size / own <= _MOST:
                    yield from Knots.of(size, own)


def _period(image: Image) -> float | None:
    """After how many rows the same comes again in the second differences along columns."""
    if len(image) < 2 * _FEWEST:
        return None
    signals, readings, bends = _bends(image, _COLUMNS[0])
    if 2 * bends < readings:
        return None  # lines through readings far apart leave nothing
    signals -= signals.sum(axis=1, keepdims=True) / signals.shape[1]
    waves = np.fft.rfft(signals)
    power = (waves.real**2 + waves.imag**2).sum(axis=0)
    first, half = int(np.ceil(signals.shape[1] / _MOST)), power.size // 2
    best = first + int(power[first:].argmax())
    regular = power[best] > _REGULAR * np.partition(power, half)[half]
    return signals.shape[1] / best if regular else None


def _bends(image: Image, columns: int) -> tuple[Array, int, int]:
    """What second differences along so many columns, or a few more, show (`kernels.knots`)."""
    from planewise.kernels import knots as kernels  # loads Numba

    signals, step = np.empty((2, len(image) - 4)), spread(image.shape[1], columns)
    return signals, *kernels.bends_along(as_loops_take(image), step // 2, step, signals)


def as_loops_take(image: Image) -> Image:
    """An image in one piece, of numbers that compiled loops know: itself, as a rule."""
    kind = image.dtype.newbyteorder("=")
    known = kind.kind != "f" or kind.itemsize in (4, 8)
    return np.ascontiguousarray(image, kind if known else np.float64)


def _is_smooth(image: Array) -> bool:
    """Whether errors of neighbours are alike; else their second differences are opposed."""
    both = (_bends(each, _COLUMNS[1])[0] for each in (image, image.T))
    return sum(float(signals[0].mean()) for signals in both) > 0


def _left(image: Array, knots: Knots) -> float:
    """What lines between own rows leave of an image, against lines half an own row off."""
    off, other = (
        np.abs(each.enlarged(each.own_rows(image)) - image) for each in (knots, knots.shifted())
    )
    off, other = off[np.isfinite(off)], other[np.isfinite(other)]
    return float(off.mean() / other.mean()) if off.size and other.any() else np.inf
