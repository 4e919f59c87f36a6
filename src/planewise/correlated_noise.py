"""What neighbouring readings share of their error, from cells in a row.

Three cells of one plane in a row, the outer two L apart from the middle: their mean inverse depths
are affine in position but for their errors, so that d = t w_left + (1 - t) w_right - w_middle has the
variance

    Var d = sum of c^2 (V / n + M) + rho^2 sum of c^2 s^2 + delta^2 s^2 L / 2

c = t, 1 - t, 1; V / n what n readings leave of white noise, M what rounding does; rho s is an error
that each cell has of its own, delta s what a random walk gains over 100 pixels. The median of d^2
over its variance gives the two ratios, from triples at several distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.noise import Noise
from planewise.noise_cells import NoiseCells, blurred

Array = NDArray[np.float64]

_LAGS = (1, 2, 4, 8)  # cells between the middle of a triple and its ends
_FEWEST = 50  # triples at a distance
_ROUGH = 2.0  # times its expected variance: a cell above it is on an edge
_UNLUCKY = 3.0  # times the rounding error that the fit may follow, at its worst phase
_BREAK = 3.5  # standard deviations of a triple of neighbours beyond which a surface bends
_MEDIAN_CHI2_1 = 0.455  # of one degree of freedom
_LEAST = 0.1  # of the white part: less is not told from creases and curvature
_WALK_UNIT = 100.0  # pixels over which a drift is stated


@dataclass(frozen=True, kw_only=True)
class Correlation:
    """Correlated parts of an error, as multiples of its white part.

    Attributes
    ----------
    shared : float
        Of what a cell's readings share; 0 where none shows.
    drift : float
        Of the drift over 100 pixels; 0 where none shows.
    triples : int
        Neighbouring cells in a row that it was judged by.
    """

    shared: float = 0.0
    drift: float = 0.0
    triples: int = 0


@dataclass(frozen=True)
class _Triples:
    """Squared deviations, their variance by white noise and rounding, and by a cell's own error."""

    square: Array
    known: Array
    own: Array

    def extra(self) -> float:
        """Variance, in units of the white one, that the median lacks."""
        low, high = 1e-4, 1e4
        if np.median(self.square / self.known) <= _MEDIAN_CHI2_1:
            return 0.0
        for _ in range(16):
            middle = float(np.sqrt(low * high))
            if np.median(self.square / (self.known + middle * self.own)) > _MEDIAN_CHI2_1:
                low = middle
            else:
                high = middle
        return float(np.sqrt(low * high))


def correlation(frames: Sequence[NoiseCells], white: Noise) -> Correlation:
    """Shared part and drift that the cells of some frames show.

    Parameters
    ----------
    frames : sequence of NoiseCells
        Of one sensor.
    white : callable
        Its white noise, sigma(z) in metres.

    Returns
    -------
    Correlation
    """
    surfaces = [_Surface.of(cells, white) for cells in frames]
    near = _joined([surface.triples(1) for surface in surfaces])
    if near.square.size < _FEWEST:
        return Correlation(triples=near.square.size)
    first = near.extra()
    if first < _LEAST**2:
        return Correlation(triples=near.square.size)
    rows = [(1.0, first, near.square.size)]
    for lag in _LAGS[1:]:
        far = _joined([surface.triples(lag, first) for surface in surfaces])
        if far.square.size >= _FEWEST:
            rows.append((float(lag), far.extra(), far.square.size))
    lag, extra, count = np.array(rows).T
    # Var d = 1.5 rho^2 s^2 + delta^2 s^2 L / 2: extra = rho^2 + delta^2 L / 3
    walk = lag * frames[0].side / _WALK_UNIT / 3.0
    shared, drift = _positive_line(walk, extra, np.sqrt(count) / np.maximum(extra, _LEAST**2))
    return Correlation(
        shared=float(np.sqrt(shared)), drift=float(np.sqrt(drift)), triples=near.square.size
    )


def _positive_line(x: Array, y: Array, weight: Array) -> tuple[float, float]:
    """Weighted least squares y = a + b x with neither negative."""
    w = weight**2
    mx, my = (w @ x) / w.sum(), (w @ y) / w.sum()
    spread = float(w @ (x - mx) ** 2)
    b = float(w @ ((x - mx) * (y - my))) / spread if spread > 0 else 0.0
    if b <= 0:
        return float(my), 0.0
    a = float(my - b * mx)
    return (a, b) if a >= 0 else (0.0, float((w @ (x * y)) / (w @ x**2)))


@dataclass(frozen=True)
class _Surface:
    """Means of the cells of one frame, and the variances of their errors in w.

    Attributes
    ----------
    flat : ndarray of bool, shape (rows, columns)
        Whether the cell is full and about as smooth as white noise allows.
    inverse, known, own : ndarray, shape (rows, columns)
        w, its variance by white noise and rounding, and the white variance of one reading.
    centroid : ndarray, shape (2, rows, columns)
    """

    flat: NDArray[np.bool_]
    inverse: Array
    known: Array
    own: Array
    centroid: Array

    @classmethod
    def of(cls, cells: NoiseCells, white: Noise) -> _Surface:
        there = cells.usable
        depth = np.where(there, cells.depth, 1.0)
        sigma = np.asarray(white(depth))
        step = np.where(there, cells.step, 0.0)
        ratio = np.divide(sigma, step, out=np.full(step.shape, 9.0), where=step > 0)
        left = blurred(ratio)
        followed = step**2 * (cells.followed * left).sum(axis=1)
        expected = sigma**2 + step**2 / 12 - followed
        flat = there & (cells.count == cells.side**2)
        variance = np.where(there, cells.variance, np.inf)
        flat &= variance <= _ROUGH * expected + _UNLUCKY * followed
        known = expected / np.maximum(cells.count, 1) + step**2 * (cells.mean * left).sum(axis=1)
        shape = cells.grid
        return cls(
            flat=flat.reshape(shape),
            inverse=np.where(there, cells.inverse, 0.0).reshape(shape),
            known=(known / depth**4).reshape(shape),
            own=(sigma**2 / depth**4).reshape(shape),
            centroid=cells.centroid.reshape(2, *shape),
        )

    def triples(self, lag: int, extra: float = 0.0) -> _Triples:
        """Triples in rows and columns between whose ends no cell is rough and no surface bends.

        extra: variance, in white ones, that neighbours are known to have on top.
        """
        return _joined([self._along(axis, lag, extra) for axis in (0, 1)])

    def _along(self, axis: int, lag: int, extra: float) -> _Triples:
        flat, w, known, own, at = (
            np.moveaxis(a, axis, 1)
            for a in (self.flat, self.inverse, self.known, self.own, self.centroid[1 - axis])
        )
        if w.shape[1] <= 2 * lag:
            return _Triples(*np.empty((3, 0)))
        if lag > 1:
            off, variance, _ = _deviations(w, known + extra * own, own, at, 1)
            flat = flat.copy()
            flat[:, 1:-1] &= off**2 < _BREAK**2 * variance
        run = np.cumsum(np.pad(flat, ((0, 0), (1, 0))), axis=1)
        whole = run[:, 2 * lag + 1 :] - run[:, : -2 * lag - 1] == 2 * lag + 1
        off, known, own = (part[whole] for part in _deviations(w, known, own, at, lag))
        return _Triples(off**2, known, own)


def _deviations(w: Array, known: Array, own: Array, at: Array, lag: int) -> tuple[Array, ...]:
    """d of every triple along the rows, and the sums of c^2 times two variances."""
    left, middle, right = np.s_[:, : -2 * lag], np.s_[:, lag:-lag], np.s_[:, 2 * lag :]
    with np.errstate(invalid="ignore", divide="ignore"):
        t = (at[right] - at[middle]) / (at[right] - at[left])
        off = t * w[left] + (1 - t) * w[right] - w[middle]
        sums = (t**2 * v[left] + (1 - t) ** 2 * v[right] + v[middle] for v in (known, own))
        return off, *sums


def _joined(parts: Sequence[_Triples]) -> _Triples:
    return _Triples(
        *(np.concatenate([getattr(p, n) for p in parts]) for n in ("square", "known", "own"))
    )
