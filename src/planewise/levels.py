"""Steps: where units of one segment lie on several levels, as boards before a wall do.

Surfaces lean (`planewise.flatness`): the discord of a wide segment with what stands a little off it
stops to grow with both, and their border does not cost enough to keep them apart. But units on its
two sides are in clear discord wherever they meet, or lie on, above or below the smooth surface that
most of the segment is on: no surface goes on there, of whatever shape the border is. Units across
it, which are on both, are on neither plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.components import components
from planewise.parts import (
    CLEAR,
    best_fit,
    chi2_of,
    cubic_terms,
    joined,
    normal_equations,
    side_by_side,
    sums_of,
)

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

_BROKEN = 11.34  # discord of units side by side, or with a surface: chi^2 of three, 99 %
CLEARLY = 2 * _BROKEN  # one that is larger says no more
_STEP = 5.0  # mean discord along a step, at least; where there is none it is 3
_LEFT = 0.25  # most of a segment that may be units across steps
_FEWEST = 12  # units of a part; what has none inside it is a row of them along a step
_BEYOND = 0.25  # of the sides of a unit inside, fewer are beside another part
_MOST = 64  # parts that are looked at, the largest
_SETTLED = 10  # steps in which the surface of most is found


def parts_at_steps(
    points: Array, discord: Array, sides: Index, price: float
) -> tuple[Index, Bools] | None:
    """Parts of a segment that is broken by steps.

    Parameters
    ----------
    points : ndarray, shape (m, 4)
        Its units (`planewise.parts`).
    discord : ndarray, shape (n,)
        Of those side by side.
    sides : ndarray of int, shape (n, 2)
        Which are.
    price : float
        Nats of a plane.

    Returns
    -------
    part : ndarray of int, shape (m,)
        Of every unit, the widest first.
    across : ndarray of bool, shape (parts,)
        Which parts, the last if any, are units across steps. Or None, where it is one part.
    """
    return _parts(points, _pieces(_level(points), discord, sides), sides, price)


def _pieces(level: Index, discord: Array, sides: Index) -> Index:
    """Pieces (m,) of units on levels (m,) that hang together by sides (., 2) no step breaks.

    A level ends in a step if units beside each other are in discord all along its border, and not
    where a surface bends.
    """
    goes_on, apart = discord <= _BROKEN, level[sides[:, 0]] != level[sides[:, 1]]
    piece = components(len(level), sides[goes_on & ~apart])
    ends = np.sort(piece[sides[apart]], axis=1)
    border = np.unique(ends[:, 0] * len(level) + ends[:, 1], return_inverse=True)[1]
    total = np.bincount(border, np.minimum(discord[apart], CLEARLY))
    mean = total / np.maximum(np.bincount(border), 1)
    goes_on[apart] &= mean[border] <= _STEP
    return np.unique(components(len(level), sides[goes_on]), return_inverse=True)[1]


def _level(points: Array) -> Index:
    """Where points (n, 4) lie by the smooth surface of most: -1 below it, 1 above it, 0 on it."""
    terms, p = cubic_terms(points), points[:, 3]
    weight = p
    for _ in range(_SETTLED):
        _, surface = best_fit(normal_equations(terms, weight))
        off = np.sqrt(p) * (terms[:, -1] - terms[:, :-1] @ surface)
        # The weights of Geman and McClure, for as much as the middle half is off.
        usual = max(1.0, float(np.median(np.abs(off))) / 0.6745)
        weight = p / (1 + (off / usual) ** 2) ** 2
    return np.where(off * off > _BROKEN * usual * usual, np.sign(off), 0.0).astype(np.intp)


def _parts(points: Array, piece: Index, sides: Index, price: float) -> tuple[Index, Bools] | None:
    """Part of every point (m, 4) of a segment in pieces (m,), and which are units across steps.

    None if it is one part. sides (., 2): points side by side.
    """
    other = sides[piece[sides[:, 0]] != piece[sides[:, 1]]]
    beside, beyond = (np.bincount(ends.ravel(), minlength=len(piece)) for ends in (sides, other))
    size = np.bincount(piece)
    size[(size < _FEWEST) | (np.bincount(piece, beyond < _BEYOND * beside) == 0)] = 0
    widest_first = np.argsort(-size, kind="stable")
    size[widest_first[_MOST:]] = 0
    mine = size[piece] > 0
    if np.count_nonzero(size) < 2 or np.count_nonzero(~mine) > _LEFT * len(piece):
        return None
    some, part = points[mine], np.argsort(widest_first, kind="stable")[piece[mine]]
    pairs = np.stack(np.triu_indices(part.max() + 1, 1), axis=1)
    part = joined(part, sums_of(some, part), pairs, CLEAR * price)
    chi2 = chi2_of(sums_of(some, part))
    across = len(chi2)
    out = np.full(len(piece), across)
    out[mine] = part
    terms, p = cubic_terms(some), some[:, 3]
    cubic = [normal_equations(terms[part == k], p[part == k]) for k in range(across)]
    for a, b in side_by_side(_with_steps(out, across, sides), sides).tolist():
        if b < across and best_fit(cubic[a] + cubic[b])[0] <= chi2[a] + chi2[b]:
            return None  # a smooth surface goes on all the same
    return (out, np.arange(out.max() + 1) == across) if across > 1 else None


def _with_steps(part: Index, across: int, sides: Index) -> Index:
    """Parts (m,) with those units across steps that are next to one, or next to such."""
    out, both = part.copy(), np.concatenate((sides, sides[:, ::-1]))
    for _ in range(2):
        here, there = both[(out[both[:, 0]] == across) & (out[both[:, 1]] != across)].T
        out[here] = out[there]
    return out
