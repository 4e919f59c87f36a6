"""Smooth curves of sigma over depth through a few measured points."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from planewise.noise import Polynomial

Array = NDArray[np.float64]

_OFFSETS = np.linspace(0.0, 0.9, 4)  # shares of the nearest depth
_SETS = np.array(sorted(product((1, 0), repeat=3), key=sum)[1:], bool)  # constant first
_TIED = 0.01  # nats: points at one depth cannot tell a constant from a slope or a square
_SINGULAR = 1e-9  # determinant of scaled normal equations
_ROUNDS = 8  # of moving points that lie far off, and fitting again
_SETTLED = 1e-3  # relative change of the curve that ends it
_TOLERATED = 2.0  # standard deviations that a point is off at most


def fit_polynomial(depth: Array, sigma: Array, error: Array) -> Polynomial:
    """Curve sigma = a + b z + c (z - d)^2 without negative terms, as simple as the points allow.

    Terms are chosen by code length: half of chi^2 plus 1/2 ln B nats for each number, B the number
    of points. d is less than the smallest depth; below d the square is 0. Points far from the
    others' curve count little. Where points lie at one depth, which every term fits, sigma is taken
    to be constant.

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
    >>> fit_polynomial(z, 0.001 + 0.002 * z**2, np.full(7, 0.01))([1.0, 4.0]).round(3)
    array([0.003, 0.033])
    """
    curve = _median_curve(depth, sigma, error)
    for _ in range(_ROUNDS):
        target, weight = _winsorised(curve, depth, sigma, error)
        last, curve = curve, _simplest(depth, target, weight)
        if np.allclose(curve(depth), last(depth), rtol=_SETTLED, atol=0.0):
            break
    return curve


def _median_curve(depth: Array, sigma: Array, error: Array) -> Polynomial:
    """One term, put through the weighted median of the points: the term they differ least from."""
    best = (np.inf, Polynomial(constant=1.0))
    weight = error**-2.0
    for power in range(3):
        level = np.log(sigma / depth**power)
        order = np.argsort(level)
        share = np.cumsum(weight[order])
        middle = level[order[np.searchsorted(share, 0.5 * share[-1])]]
        cost = float(weight @ np.abs(level - middle))
        if cost < best[0] - 1e-9:
            size = np.where(np.arange(3) == power, np.exp(middle), 0.0)
            best = (cost, Polynomial(*map(float, size)))
    return best[1]


def _winsorised(curve: Polynomial, depth: Array, sigma: Array, error: Array) -> tuple[Array, Array]:
    """Points, those far from a curve moved to twice the scatter of all, and their weights."""
    expected = curve(depth)
    off = np.log(sigma / expected) / error
    scatter = max(1.0, 1.4826 * float(np.median(np.abs(off))))
    most = _TOLERATED * scatter
    target = expected * np.exp(error * np.clip(off, -most, most))
    return np.asarray(target), np.asarray(1.0 / (expected * error * scatter))


def _simplest(depth: Array, sigma: Array, weight: Array) -> Polynomial:
    """Curve of the shortest code for weighted points: least squares for every set of terms."""
    offset = (_OFFSETS * depth.min())[:, None]
    powers = np.broadcast_arrays(np.ones(len(depth)), depth, (depth - offset) ** 2)
    rows = np.stack(powers, axis=1) * weight  # (offsets, 3, B)
    matrix, target = rows @ rows.swapaxes(1, 2), rows @ (sigma * weight)
    scale = 1.0 / np.sqrt(np.einsum("oii->oi", matrix))
    matrix = matrix * scale[:, :, None] * scale[:, None, :]
    # Terms that a set lacks are solved for as zero.
    used = _SETS[:, :, None] & _SETS[:, None, :]
    systems = np.where(used, matrix[:, None], np.eye(3))
    right = np.where(_SETS, (target * scale)[:, None], 0.0)
    singular = np.linalg.det(systems) < _SINGULAR
    systems[singular] = np.eye(3)
    size = np.linalg.solve(systems, right[..., None])[..., 0] * scale[:, None]
    chi2 = (weight @ (weight * sigma**2)) - (size * target[:, None]).sum(axis=2)
    numbers = _SETS.sum(axis=1) + (offset > 0)
    cost = 0.5 * chi2 + 0.5 * np.log(len(depth)) * numbers
    refused = singular | (np.where(_SETS, size, 1.0) <= 0).any(axis=2)
    # An offset needs a square to move, and noise at the offset itself.
    refused |= (offset > 0) & ~(_SETS[:, 2] & (_SETS.sum(axis=1) > 1))
    cost[refused] = np.inf
    best = np.unravel_index(np.argmax(cost <= cost.min() + _TIED), cost.shape)
    a, b, c = size[best].tolist()
    return Polynomial(a, b, c, float(offset[best[0], 0]))


def refit(curve: Polynomial, depth: Array, sigma: Array, error: Array, sets: Array) -> Array:
    """The same terms fitted to other points, with the weights of the first.

    Parameters
    ----------
    curve : Polynomial
        Fitted to `depth`, `sigma` and `error` (`fit_polynomial`); says which terms there are.
    sets : ndarray, shape (S, B)
        Other values at the same depths, metres.

    Returns
    -------
    ndarray, shape (S, B)
        Each set's curve at `depth`, in metres.
    """
    sizes = np.array((curve.constant, curve.linear, curve.quadratic))
    terms = np.stack((np.ones(len(depth)), depth, (depth - curve.offset) ** 2))[sizes > 0]
    target, weight = _winsorised(curve, depth, sigma, error)
    solve = np.linalg.pinv((terms * weight).T)
    return np.asarray((sets * (target / sigma) * weight) @ solve.T @ terms)
