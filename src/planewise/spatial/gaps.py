"""Segments of one plane that do not touch: seen through gaps, or behind what stands before it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import forms as comparing
from planewise.kernels import gaps
from planewise.sectors import Sectors
from planewise.spatial.segments import Segments

Array = NDArray[np.float64]

_GAP_OFFSET = 0.3  # of its depth: where an unrelated plane seen through a gap may lie


def join_through_gaps(
    segments: Segments,
    worth: Array,
    accepted: NDArray[np.bool_],
    sectors: Sectors,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Join segments of one plane that do not touch.

    First accepted ones, then what is left over and saves anything as part of one of those planes.
    Returns the segments that were looked at, the plane of each, -1 for none, and the rows of the
    planes, (K, N, 13).
    """
    order = (-worth).argsort(kind="stable")
    paid = accepted[order]
    chosen, rest = order[paid], order[~paid & (worth[order] > 0.0)]
    if not len(chosen):
        rows = sectors.everywhere(segments.rows[chosen], segments.home[chosen])
        return chosen, np.arange(len(chosen)), rows
    every = np.concatenate((chosen, rest))
    drift, slope_prior = segments.drift[every], segments.slope_prior[every]
    rows = sectors.everywhere(segments.rows[every], segments.home[every])
    forms = _forms(rows, drift)
    plane, first = np.empty(len(every), np.int64), np.empty(len(chosen), np.int64)
    owner, others = plane[: len(chosen)], plane[len(chosen) :]
    gaps.join_through_gaps(rows, forms, drift, slope_prior, _GAP_OFFSET, owner)
    found = gaps.find_planes(rows, forms, slope_prior, _GAP_OFFSET, owner, others, first)
    return every, plane, rows[:, first[:found]]


def _forms(rows: Array, drift: Array) -> Array:
    """Forms (K, n, 13) of segment rows (K, n, 13): what does not touch does not lean."""
    out = np.empty((*rows.shape[:2], comparing.FORM))
    for of_sector, forms in zip(rows, out, strict=True):
        comparing.write_forms(of_sector, drift, 0.0, forms)
    return out
