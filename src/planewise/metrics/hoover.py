"""Five counts that compare two segmentations.

A. Hoover et al., "An experimental comparison of range image segmentation algorithms", IEEE
Transactions on Pattern Analysis and Machine Intelligence 18(7), 1996.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import is_finite

Array = NDArray[np.float64]

_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class HooverCounts:
    """How the regions of two segmentations correspond.

    Attributes
    ----------
    correct : int
        Pairs, each of which contains most of the other.
    over : int
        True regions that several predicted ones make up.
    under : int
        Predicted regions that several true ones make up.
    missed : int
        True regions in none of these.
    noise : int
        Predicted regions in none of these.
    tolerance : float
        Share that counts as "most".
    """

    correct: int
    over: int
    under: int
    missed: int
    noise: int
    tolerance: float


@dataclass(frozen=True)
class _Instance:
    """Regions that correspond, and the mean of the shares they have in common."""

    kind: str
    truth: tuple[int, ...]
    predicted: tuple[int, ...]
    measure: float


def hoover_counts(counts: ArrayLike, *, tolerance: float = 0.8) -> HooverCounts:
    """Count correct, over- and under-segmented, missed and noise regions.

    A region that is part of several instances keeps the one whose two overlap measures have the
    highest mean; between equals, correct goes before over- before under-segmentation, and lower
    labels before higher ones.

    Parameters
    ----------
    counts : array_like, shape (G + 1, P + 1)
        Contingency table; row 0 and column 0 are label 0.
    tolerance : float
        T of the paper, above 0.5 and at most 1.

    Returns
    -------
    HooverCounts
        The counts; no region is too small for them.

    Raises
    ------
    ValueError
        If `tolerance` is out of range or `counts` is no such table.

    Examples
    --------
    >>> hoover_counts([[0, 0, 0], [5, 95, 0], [0, 0, 50]])
    HooverCounts(correct=2, over=0, under=0, missed=0, noise=0, tolerance=0.8)
    """
    if not (is_finite(tolerance) and 0.5 < tolerance <= 1):
        raise ValueError(f"tolerance must lie above 0.5 and not above 1, got {tolerance!r}")
    table = np.asarray(counts, np.float64)
    if table.ndim != 2 or 0 in table.shape or not (np.isfinite(table) & (table >= 0)).all():
        raise ValueError(
            "counts must be finite numbers of at least 0 of shape (G + 1, P + 1), "
            f"got shape {table.shape}"
        )
    taken_truth: set[int] = set()
    taken_predicted: set[int] = set()
    number = {"correct": 0, "over": 0, "under": 0}
    instances = _instances(table, tolerance)
    for each in sorted(instances, key=lambda each: -round(each.measure, 12)):  # stable
        if taken_truth.isdisjoint(each.truth) and taken_predicted.isdisjoint(each.predicted):
            taken_truth.update(each.truth)
            taken_predicted.update(each.predicted)
            number[each.kind] += 1
    return HooverCounts(
        **number,
        missed=int((table.sum(axis=1)[1:] > 0).sum()) - len(taken_truth),
        noise=int((table.sum(axis=0)[1:] > 0).sum()) - len(taken_predicted),
        tolerance=tolerance,
    )


def _instances(table: Array, tolerance: float) -> list[_Instance]:
    """Everything that corresponds: correct first, then over-, then under-segmentation."""
    common = table[1:, 1:]
    truth, predicted = table.sum(axis=1)[1:], table.sum(axis=0)[1:]
    in_truth = _most(common, predicted, tolerance)
    in_predicted = _most(common, truth[:, None], tolerance)
    found = [
        _Instance(
            kind="correct",
            truth=(g,),
            predicted=(p,),
            measure=(common[g, p] / truth[g] + common[g, p] / predicted[p]) / 2,
        )
        for g, p in np.argwhere(in_truth & in_predicted).tolist()
    ]
    found += [
        _Instance(kind="over", truth=(whole,), predicted=parts, measure=measure)
        for whole, parts, measure in _made_up(common, truth, predicted, in_truth, tolerance)
    ]
    found += [
        _Instance(kind="under", truth=parts, predicted=(whole,), measure=measure)
        for whole, parts, measure in _made_up(common.T, predicted, truth, in_predicted.T, tolerance)
    ]
    return found


def _most(common: Array, size: Array, tolerance: float) -> NDArray[np.bool_]:
    return np.asarray((common > 0) & (common >= tolerance * size - _ROUNDING))


def _made_up(
    common: Array, wholes: Array, parts: Array, inside: NDArray[np.bool_], tolerance: float
) -> list[tuple[int, tuple[int, ...], float]]:
    """Wholes that two or more parts, each mostly inside, cover to the tolerance."""
    out = []
    for whole, size in enumerate(wholes):
        pieces = np.flatnonzero(inside[whole])
        shared = common[whole, pieces].sum()
        if len(pieces) >= 2 and shared >= tolerance * size - _ROUNDING:
            measure = (shared / parts[pieces].sum() + shared / size) / 2
            out.append((whole, tuple(pieces.tolist()), float(measure)))
    return out
