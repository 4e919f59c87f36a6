"""Parts of a segment: which of its units are on planes of their own.

A unit is a point here: x, y, its height over some plane, and the precision of that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import splits as kernels

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

CLEAR = 10.0  # times the price: what the misfit of a segment costs, and each part of it saves
_FEWEST_BENT = 48  # units of a segment that bends
_WIDE = 0.05  # of the readings
_SMALL = 24, 0.02  # units, and share of the segment: fewer may be mixed cells along an edge


def points_of(x: Array, y: Array, height: Array, p: Array) -> Array:
    """Points (m, 4), x and y in roots of their variance about their mean."""
    x, y = x - x.mean(), y - y.mean()
    scale = np.sqrt((x * x + y * y).mean())
    return np.column_stack((x / scale, y / scale, height, p))


def bends(excess: Array, count: Array, price: float) -> Bools:
    """Which segments may bend, for chi^2 of so many units is in excess of what noise makes it."""
    return np.asarray((excess > 2 * price) & (count >= _FEWEST_BENT))


def is_wide(readings: Array) -> Bools:
    """Which segments hold a share of all readings for which they are divided though no planes."""
    return np.asarray(readings >= _WIDE * readings.sum())


def is_small(part: Index) -> Bools:
    """Which parts may be mixed cells along an edge."""
    few, share = _SMALL
    return np.asarray(np.bincount(part) < max(few, share * len(part)))


def sums_of(points: Array, part: Index) -> Array:
    """Sums (parts, SUMS) over the points (m, 4) of every part (`kernels.splits`)."""
    sums = np.empty((int(part.max()) + 1, kernels.SUMS))
    kernels.correlate(points, part, np.empty((0, 2), np.intp), sums, np.empty((len(sums), 3)))
    return sums


def chi2_of(sums: Array) -> Array:
    """chi^2 (n,) of the planes of sums over points (n, SUMS)."""
    out = np.empty(len(sums))
    kernels.misfits(sums, out)
    return out


def cubic_terms(points: Array) -> Array:
    """Terms of a polynomial of the third degree at points (n, 4), and their heights: (n, 11)."""
    x, y, height, _ = points.T
    xx, xy, yy = x * x, x * y, y * y
    return np.column_stack(
        (np.ones_like(x), x, y, xx, xy, yy, xx * x, xx * y, x * yy, yy * y, height)
    )


def normal_equations(terms: Array, weight: Array) -> Array:
    """Those (11, 11) of the polynomial through points of these `cubic_terms` and weights (n,)."""
    return np.asarray((terms * weight[:, None]).T @ terms)


def best_fit(normal: Array, terms: int = 10) -> tuple[float, Array]:
    """chi^2 of the best polynomial of 3, 6 or 10 terms, and its coefficients."""
    right = normal[:terms, -1]
    fitted = np.asarray(np.linalg.lstsq(normal[:terms, :terms], right, rcond=None)[0], np.float64)
    return float(normal[-1, -1] - right @ fitted), fitted


def polynomial(points: Array, terms: int) -> tuple[float, Array]:
    """`best_fit` to points (n, 4)."""
    return best_fit(normal_equations(cubic_terms(points), points[:, 3]), terms)


def chi2_of_cubic(points: Array) -> float:
    """chi^2 of the best polynomial of the third degree."""
    return polynomial(points, 10)[0]


def side_by_side(part: Index, sides: Index) -> Index:
    """Pairs (n, 2) of parts that share a side of a cell."""
    ends = part[sides]
    return np.unique(np.sort(ends[ends[:, 0] != ends[:, 1]], axis=1), axis=0)


def joined(part: Index, sums: Array, pairs: Index, price: float) -> Index:
    """The same with those of these pairs of parts (n, 2) that are one plane as one part.

    sums (parts, SUMS): of their points; price: nats that a part has to save.
    """
    root, sums = np.arange(len(sums)), sums.copy()
    while len(pairs := np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)):
        first, second = pairs.T
        chi2 = chi2_of(sums)
        lost = 0.5 * (chi2_of(sums[first] + sums[second]) - chi2[first] - chi2[second])
        least = int(lost.argmin())
        if lost[least] > price:
            break
        a, b = pairs[least]
        root[root == b], pairs[pairs == b] = a, a
        sums[a] += sums[b]
    return np.unique(root[part], return_inverse=True)[1]
