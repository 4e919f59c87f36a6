"""Which segments of a depth image are pieces of curved surfaces.

Where a surface bends, cells merge into facets, as many as noise lets one tell, and each is as flat
as a plane. What tells them from planes is that they go on bending across their borders, while
planes meet in edges, which are sharp. The same as `clouds.curvature`, for inverse depth in the
image, of which a plane is an affine function and what bends is nearly a quadric.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import curvature as kernels
from planewise.kernels.cells import UNIT
from planewise.kernels.quadrics import spread
from planewise.spatial.cells import Cells
from planewise.spatial.segments import Segments
from planewise.workspace import Workspace

Pairs = NDArray[np.int32]


def curved_segments(
    cells: Cells,
    segments: Segments,
    accepted: NDArray[np.bool_],
    ends: Pairs,
    units: Pairs,
    focal: float,
    workspace: Workspace,
) -> NDArray[np.bool_]:
    """Find the segments that are pieces of curved surfaces.

    Each has a quadric. Across a border the surface goes on if the quadrics of both sides turn by
    less than half of what their planes do where they meet, one of them being clearly bent; a
    segment is curved if its surface goes on across most of its border, as are those among them.
    There are at least three: two that go on into each other may be the sides of a rounded edge.

    Parameters
    ----------
    cells : Cells
        Of the frame.
    segments : Segments
        Neighbouring cells that are one plane.
    accepted : ndarray of bool, shape (n,)
        Those that pay for being planes.
    ends, units : ndarray of int32, shape (m, 2)
        Segments and units of the two cells at every side between two segments.
    focal : float
        Focal length in pixels.
    workspace : Workspace
        Memory to work in.

    Returns
    -------
    ndarray of bool, shape (n,)
        Of accepted ones.
    """
    curved = np.zeros(len(segments.rows), np.bool_)
    quadrics = np.empty((len(curved), kernels.QUADRIC))
    bent = kernels.quadrics_of(
        cells.rows, segments.of_unit, segments.rows, segments.drift, accepted, quadrics
    )
    if not bent:
        return curved
    border, pairs = np.zeros(len(curved)), workspace.empty(ends.shape, np.int32)
    points = workspace.empty(len(ends), np.float32)
    states = workspace.empty(len(ends), np.int8)
    found = kernels.surface_borders(
        ends, units, cells.rows, quadrics, UNIT / focal, border, pairs, points, states
    )
    spread(border, pairs[:found], points[:found], states[:found], curved)
    curved &= accepted
    if not curved.any():
        return curved
    pieces = pairs[:found][curved[pairs[:found]].all(axis=1)]
    pieces = np.unique(np.sort(pieces, axis=1), axis=0)
    between = np.bincount(pieces.ravel(), minlength=len(curved)) > 1
    curved[:] = False
    curved[pieces[between[pieces].any(axis=1)]] = True
    return curved
