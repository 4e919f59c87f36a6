"""Segments that local prices leave over: planes after all, if their residuals are white.

What a segment has to save is three times its parameters, since pieces of bent surfaces save once
what a small plane does. Where readings have little but white noise, residuals tell the two apart:
on a plane those of cells side by side are independent. So a segment that saves more than its
border, and lies on no other plane, need not pay for its parameters then; exact data charge them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.cells import COUNT
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells
from planewise.spatial.labels import affine_planes, residual_correlation, sector_of_units
from planewise.spatial.segments import Segments

Array = NDArray[np.float64]

WHITE = 0.2  # correlation of residuals of cells side by side up to which they are white
ENOUGH = 700  # readings of a plane: fewer hardly tell how white they are


def flat_leftovers(
    segments: Segments, left: NDArray[np.int64], cells: Cells, sectors: Sectors
) -> tuple[NDArray[np.int64], Array]:
    """Which segments left over are planes by their residuals, and their rows.

    Parameters
    ----------
    segments : Segments
        Of the frame.
    left : ndarray of int
        Those that save more than their border, but are no plane and lie on none.
    cells : Cells
        Of the frame.
    sectors : Sectors
        Of the frame.

    Returns
    -------
    flat : ndarray of int, shape (n,)
    planes : ndarray, shape (K, n, 13)
        Their rows in the coordinates of every sector.
    """
    flat = left[segments.rows[left, COUNT] >= ENOUGH]
    planes = sectors.everywhere(segments.rows[flat], segments.home[flat])
    if not len(flat):
        return flat, planes
    label = np.zeros(len(segments.rows), np.int32)
    label[flat] = sectors.count * np.arange(len(flat)) + 1
    inside = label[segments.of_unit]
    if sectors.count > 1:
        inside += np.where(inside > 0, sector_of_units(cells, sectors), 0).astype(np.int32)
    affine = affine_planes(planes.transpose(1, 0, 2).reshape(-1, planes.shape[2]))
    # Not where it is NaN: too few cells are side by side to tell.
    white = residual_correlation(cells, inside, affine, sectors) <= WHITE
    return flat[white], planes[:, white]
