"""Smooth curves of sigma over depth through a few measured points."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from planewise.noise import Polynomial

Array = NDArray[np.float64]

_OFFSETS = np.linspace(0.0, 1.0, 6)  # shares of the nearest depth
_SUBSETS = [s for n in (1, 2, 3) for s in itertools.combinations(range(3), n)]


def fit_polynomial(depth: Array, sigma: Array, error: Array) -> Polynomial:
    """Curve sigma = a + b z + c (z - d)^2 without negative terms, as simple as the points allow.

    Terms are chosen by code length: half of chi^2 plus 1/2 ln B nats for each number, B the number
    of points. d is at most the smallest depth.

    Parameters
    ----------
    depth, sigma : ndarray, shape (B,)
        Points, in metres; sigma positive.
    error : ndarray, shape (B,)
        Relative standard deviations of `sigma`.

    Returns
    -------
    Polynomial

    Examples
    --------
    >>> z = np.linspace(1, 4, 7)
    >>> print(fit_polynomial(z, 0.001 + 0.002 * z**2, np.full(7, 0.01)))
    0.001 + 0.002 z^2 m
    """
    best = (np.inf, Polynomial(constant=float(np.median(sigma))))
    price = 0.5 * np.log(len(depth))
    for offset in _OFFSETS * depth.min():
        terms = np.stack((np.ones(len(depth)), depth, (depth - offset) ** 2))
        scaled = terms / (sigma * error)
        for subset in _SUBSETS:
            chosen = list(subset)
            if offset > 0 and (2 not in subset or len(subset) == 1):
                continue  # no square to move, or no noise at all at the offset
            size = _least_squares(scaled[chosen], 1.0 / error)
            if size is None:
                continue
            off = size @ scaled[chosen] - 1.0 / error
            cost = 0.5 * float(off @ off) + price * (len(subset) + (offset > 0))
            if cost < best[0] - 1e-9:
                a, b, c = (float(size[chosen.index(k)]) if k in chosen else 0.0 for k in range(3))
                best = (cost, Polynomial(a, b, c, float(offset)))
    return best[1]


def refit(curve: Polynomial, depth: Array, sigma: Array, error: Array) -> Array:
    """The same terms fitted to other points.

    Parameters
    ----------
    curve : Polynomial
        Says which terms there are.
    depth, error : ndarray, shape (B,)
        As in `fit_polynomial`.
    sigma : ndarray, shape (S, B)
        Sets of points.

    Returns
    -------
    ndarray, shape (S, B)
        Each set's curve at `depth`, in metres.
    """
    sizes = np.array((curve.constant, curve.linear, curve.quadratic))
    terms = np.stack((np.ones(len(depth)), depth, (depth - curve.offset) ** 2))[sizes > 0]
    # Weights stay those of the first fit, so that all sets share one pseudo-inverse.
    weight = 1.0 / (curve(depth) * error)
    solve = np.linalg.pinv((terms * weight).T)
    return np.asarray((sigma * weight) @ solve.T @ terms)


def _least_squares(rows: Array, target: Array) -> Array | None:
    """Solve for positive factors of the rows, or ``None`` where some are not."""
    matrix = rows @ rows.T
    scale = 1.0 / np.sqrt(np.diag(matrix))
    matrix = matrix * scale * scale[:, None]
    if np.linalg.det(matrix) < 1e-9:
        return None
    size = scale * np.linalg.solve(matrix, scale * (rows @ target))
    return np.asarray(size) if (size > 0).all() else None
