"""What neighbouring readings share of their error, from cells in a row.

Of three cells of one plane in a row, mean inverse depths are affine in position but for their
errors, so that d = t w_left + (1 - t) w_right - w_middle has the variance

    Var d = sum of c^2 [s^2 / n + rho^2 s^2],   c = t, 1 - t, 1

s^2 / n is what n readings leave of their noise, and rho s an error that each cell has of its own.
The median of d^2 over its variance gives rho.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.calibration.cells import NoiseCells, blurred
from planewise.noise import Noise

Array = NDArray[np.float64]

_NEAR, _FAR = 2, 6  # cells from the middle of a triple to its ends: slow errors grow between
_CORRELATED = 0.64  # shared part against what noise leaves of a cell's mean: less is chance
_SMOOTH = 1.5  # times the noise: more is shared only of an error that is smooth over a few pixels
_GROWN = 1.2, 3.0  # times as much three times as far apart: of a walk 1.7, of what bends up to 9
_FEWEST = 50  # triples that can tell
_ROUGH = 2.0  # times its expected variance: a cell above it is on an edge
_UNLUCKY = 3.0  # times the rounding error that the fit may follow, at its worst phase
_MEDIAN_CHI2_1 = 0.455  # of one degree of freedom
_CREASE = 9.0  # chi^2 of a triple that lies across one
_ROUNDED = 0.1  # variance by rounding of a mean, against that by noise, that it may have
_BISECTIONS = 8


def by_chance(frames: Sequence[NoiseCells]) -> float:
    """`shared_ratio` of frames that chance and creases give."""
    return _CORRELATED / min(each.side for each in frames)


def is_walk(frames: Sequence[NoiseCells], white: Noise, near: float) -> bool:
    """Whether what cells share grows with distance as a random walk does, or is nothing.

    An error that is smooth over a few pixels, as of stereo, is far more than readings err by
    themselves, and as large near as far; one that bends, of a lens or with bumps, grows faster.

    Parameters
    ----------
    frames, white
        As in `shared_ratio`.
    near : float
        What it says.
    """
    far, (least, most) = shared_ratio(frames, white, apart=_FAR), _GROWN
    chance = by_chance(frames)
    if near < chance and far < chance:  # NaN is not
        return True
    return near <= _SMOOTH and least * near <= far <= most * near


def shared_ratio(frames: Sequence[NoiseCells], white: Noise, *, apart: int = _NEAR) -> float:
    """Error that a cell's readings share, against the whole noise of one reading.

    Parameters
    ----------
    frames : sequence of NoiseCells
        Of one sensor.
    white : callable
        Its white noise, sigma(z) in metres.
    apart : int
        Cells from the middle of three to the others.

    Returns
    -------
    float
        rho; 0 where readings err independently, NaN where too few flat cells in a row tell.
    """
    triples = [_triples(each, white, axis, apart) for each in frames for axis in (0, 1)]
    square, known, own = np.concatenate(triples, axis=1)
    if square.size < _FEWEST:
        return np.nan

    def excess(ratio: float) -> float:
        """Median above that of chi^2; triples across a crease are left out."""
        chi2 = square / (known + ratio**2 * own)
        return float(np.median(chi2[chi2 < _CREASE]) if chi2.min() < _CREASE else np.inf)

    low, high = 0.0, 1.0
    if excess(low) <= _MEDIAN_CHI2_1:
        return 0.0
    while excess(high) > _MEDIAN_CHI2_1:
        low, high = high, 2 * high
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > _MEDIAN_CHI2_1 else (low, middle)
    return high


def _triples(cells: NoiseCells, white: Noise, axis: int, apart: int) -> Array:
    """d^2, its variance by what is known, and by s, of flat triples in columns or rows; (3, T)."""
    depth = np.where(cells.usable, cells.depth, 1.0)
    step = np.where(cells.usable, cells.step, 0.0)
    sigma = np.asarray(white(depth))
    left = blurred(np.divide(sigma, step, out=np.full(step.shape, 9.0), where=step > 0))
    followed = step**2 * (cells.followed * left).sum(axis=1)
    noise = sigma**2 + step**2 / 12
    rough = _ROUGH * (noise - followed) + _UNLUCKY * followed
    flat: NDArray[np.bool_] = np.where(cells.usable, cells.variance, np.inf) <= rough
    mean = (noise - followed) / np.maximum(cells.count, 1)
    # A mean that rounding governs tells nothing.
    flat &= step**2 * (cells.mean * left).sum(axis=1) <= _ROUNDED * mean

    def ahead(values: NDArray[Any], k: int) -> NDArray[Any]:
        """Values of the k-th cell of all triples along the axis."""
        rows = values.reshape(cells.grid)
        rows = rows if axis else rows.T
        return rows[:, apart * k : max(rows.shape[1] - 2 * apart, 0) + apart * k]

    whole = ahead(flat, 0) & ahead(flat, 1) & ahead(flat, 2)
    # Coordinates start anew where sectors meet: cells on both sides are not in order there.
    near, middle, far = (ahead(cells.centroid[1 - axis], k) for k in range(3))
    whole &= (middle - near) * (far - middle) > 0
    # w = 1 / z and z = c depth: the variance of depth over z^2 depth^2 is that of w.
    to_w = np.where(cells.usable, cells.inverse / depth, 0.0) ** 2
    x, y, w, known, own = (
        [ahead(values, k)[whole] for k in range(3)]
        for values in (*cells.centroid[[1 - axis, axis]], cells.inverse, mean * to_w, noise * to_w)
    )
    t = (x[2] - x[1]) / (x[2] - x[0])
    off = t * w[0] + (1 - t) * w[2] - w[1]
    # Where readings are missing, centroids are not in line.
    off -= ahead(cells.slope[axis], 1)[whole] * (t * y[0] + (1 - t) * y[2] - y[1])
    sums = [t**2 * v[0] + (1 - t) ** 2 * v[2] + v[1] for v in (known, own)]
    return np.stack((off**2, *sums))
