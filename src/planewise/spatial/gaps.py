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
    instances: bool,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Join segments of one plane that do not touch, unless they are `instances`.

    First accepted ones, then what is left over and saves anything as part of one of those planes.
    Returns the segments of all planes, the plane of each, and the rows of the planes, (K, N, 13).
    """
    order = np.argsort(-worth, kind="stable")
    chosen = order[accepted[order]]
    home = segments.home[chosen]
    planes, owner = sectors.everywhere(segments.rows[chosen], home), np.arange(len(chosen))
    if instances or not len(chosen):
        return chosen, owner, planes
    drift = segments.drift[chosen]
    forms = _forms(planes, drift)
    slope_prior = segments.slope_prior[chosen]
    gaps.join_through_gaps(planes, forms, home, drift, slope_prior, _GAP_OFFSET, owner)
    there = np.bincount(owner, minlength=len(chosen)) > 0
    alive, owner = np.flatnonzero(there), (np.cumsum(there) - 1)[owner]
    planes = planes[:, alive]
    rest = order[~accepted[order] & (worth[order] > 0.0)]
    plane = np.empty(len(rest), np.int64)
    others = sectors.everywhere(segments.rows[rest], segments.home[rest])
    gaps.find_planes(
        np.concatenate((planes, others), axis=1),
        np.concatenate((forms[:, alive], _forms(others, segments.drift[rest])), axis=1),
        np.concatenate((home[alive], segments.home[rest])),
        np.concatenate((slope_prior[alive], segments.slope_prior[rest])),
        _GAP_OFFSET,
        planes.shape[1],
        plane,
    )
    part = plane >= 0
    return np.append(chosen, rest[part]), np.append(owner, plane[part]), planes


def _forms(rows: Array, drift: Array) -> Array:
    """Forms (K, n, 12) of segment rows (K, n, 13)."""
    out = np.empty((*rows.shape[:2], comparing.FORM))
    for of_sector, forms in zip(rows, out, strict=True):
        comparing.write_forms(of_sector, drift, forms)
    return out
