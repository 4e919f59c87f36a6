"""Which segments of a depth image are pieces of curved surfaces.

Where a surface bends, cells merge into facets, as many as noise lets one tell, and each is as flat
as a plane. What tells them from planes is that they go on bending across their borders, while
planes meet in edges, which are sharp. The same as `clouds.curvature`, for inverse depth in the
image, of which a plane is an affine function and what bends is nearly a quadric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import curvature as kernels
from planewise.kernels.cells import UNIT
from planewise.kernels.quadrics import BENDS, FLAT, UNTOLD, spread
from planewise.kernels.units import sum_units
from planewise.runtime.workspace import Workspace
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells
from planewise.spatial.seams import Neighbours
from planewise.spatial.segments import Segments
from planewise.spatial.units import sector_of_units

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]
Pairs = NDArray[np.int32]

_NEAR = 0.25  # of its border, at most, where what ends at breaks turns by less than 60 degrees


def curved_segments(
    cells: Cells,
    segments: Segments,
    accepted: Chosen,
    doubtful: Chosen,
    small: Chosen,
    beside: Neighbours,
    whole: Array,
    ends: Pairs,
    units: Pairs,
    at: NDArray[np.int32],
    sectors: Sectors,
    workspace: Workspace,
) -> tuple[Chosen, Chosen]:
    """Find the segments that are pieces of curved surfaces, and doubtful ones that are not.

    Each has a quadric. Across a border the surface goes on if the quadrics of both sides turn by
    less than half of what their planes do where they meet, one of them being clearly bent; or, if
    the planes turn by less than 60 degrees, where both are too narrow to tell, as at the rims of
    round things, and where their own cells turn by less than half of that, as in the folds of
    cloth. A segment is curved if its surface goes on across most of its border with others, as are
    those among them. Side by side there are at least three, doubtful ones among them: two that go
    on into each other may be the sides of a rounded edge; and not only narrow ones, unless these
    turn one way, as those of a pillar do: corrugated sheets are such, and ground that few beams
    see.

    Parameters
    ----------
    cells : Cells
        Of the frame.
    segments : Segments
        Neighbouring cells that are one plane.
    accepted : ndarray of bool, shape (n,)
        Those that pay for being planes.
    doubtful : ndarray of bool, shape (n,)
        Others that pay for it if they are sharp; none where there are several sectors.
    small : ndarray of bool, shape (n,)
        Those of them that are sharp, too, if they end at breaks.
    beside : Neighbours
        Which cells are beside each other.
    whole : ndarray, shape (n,)
        Sides of cells about each segment, those to cells of none among them.
    ends, units, at : ndarray of int32, shapes (m, 2), (m, 2) and (m,)
        Segments, units and place (`kernels.borders.segment_borders`) of the two cells at every side
        between two segments.
    sectors : Sectors
        Of the frame. Where there are several, what of a segment lies in each has a quadric.
    workspace : Workspace
        Memory to work in.

    Returns
    -------
    curved : ndarray of bool, shape (n,)
        Of accepted ones, among each other.
    sharp : ndarray of bool, shape (n,)
        Of doubtful ones: those that do not bend, as enough cells tell, and are not curved among
        all of both. And small ones that too few cells tell of, where most of the border does: in
        front of others, behind them, or meeting them at 60 degrees or more.
    """
    every, parts = accepted | doubtful, _parts(cells, segments, sectors)
    chosen = every[parts.segment]
    quadrics = np.empty((len(parts.rows), kernels.QUADRIC))
    kernels.quadrics_of(cells.rows, parts.of_unit, parts.rows, parts.drift, chosen, quadrics)
    sharp = doubtful.copy()
    if sectors.count == 1:
        bent = doubtful & (quadrics[:, kernels.BENT] == BENDS)
        if cells.error.smooth and bent.any():
            # Cells at a rim are mixed of both sides: what is flat within does not bend.
            inner = workspace.empty(len(segments.of_unit), np.int32)
            kernels.inner_units(beside.grid, segments.of_unit, inner)
            within = np.empty_like(quadrics)
            kernels.quadrics_of(cells.rows, inner, parts.rows, parts.drift, bent, within)
            flat = bent & (within[:, kernels.BENT] == FLAT)
            quadrics[flat] = within[flat]
        sharp &= quadrics[:, kernels.BENT] == FLAT
    else:
        together = parts.sector[units[:, 0]] == parts.sector[units[:, 1]]
        units, at = units[together], at[together]
        ends = parts.of_unit[units]
    how, turns = np.empty((2, len(ends)), np.int8)
    kernels.meet(ends, units, cells.rows, quadrics, UNIT / sectors.mean_focal, how, turns)
    kernels.find_round(
        ends, at, beside.grid, parts.of_unit, cells.rows, quadrics, chosen, beside.wraps, how
    )  # fmt: skip

    if small.any():
        near = ends[how >= kernels.NEAR]
        ended = np.bincount(near.reshape(-1), minlength=len(whole)) <= _NEAR * whole
        sharp |= small & ended & (quadrics[:, kernels.BENT] != BENDS)

    def surfaces() -> tuple[Pairs, NDArray[np.int8], Chosen]:
        border, curved = np.empty(len(every)), np.empty(len(every), np.bool_)
        pairs = workspace.empty(ends.shape, np.int32)
        points = workspace.empty(len(ends), np.float32)
        states = workspace.empty(len(ends), np.int8)
        found = kernels.surface_borders(
            ends, units, cells.rows, quadrics, parts.segment, how, turns, border, pairs, points,
            states,
        )  # fmt: skip
        pairs, states = pairs[:found], states[:found]
        spread(border, whole, pairs, points[:found], states, curved)
        return pairs, states, curved

    pairs, states, curved = surfaces()
    among_all = curved & every
    if doubtful.any():
        quadrics[doubtful, kernels.C : kernels.EXTENT] = 0.0
        quadrics[doubtful, kernels.SIZE :] = 0.0, UNTOLD  # as if they had none
        _, _, curved = surfaces()
    curved &= accepted
    kernels.leave_out(pairs, states, among_all | curved, curved)
    kernels.leave_out(pairs, states, among_all, among_all)
    return curved, sharp & ~among_all


@dataclass(frozen=True)
class _Parts:
    """What of each segment lies in one sector, in the coordinates of that.

    Attributes
    ----------
    rows, drift : ndarray, shapes (m, 13) and (m,)
        As of `Segments`.
    segment : ndarray of int, shape (m,)
        What each is a part of.
    of_unit, sector : ndarray of int32, shape (units,)
        Part of every unit, and where it lies.
    """

    rows: Array
    drift: Array
    segment: NDArray[np.intp]
    of_unit: NDArray[np.int32]
    sector: NDArray[np.int32]


def _parts(cells: Cells, segments: Segments, sectors: Sectors) -> _Parts:
    """Parts of the segments; in one sector, the segments."""
    sector, of_unit = sector_of_units(cells, sectors), segments.of_unit
    if sectors.count == 1:
        return _Parts(segments.rows, segments.drift, np.arange(len(segments.rows)), of_unit, sector)
    key, part = np.unique(sectors.count * of_unit.astype(np.int64) + sector, return_inverse=True)
    segment, of_unit = key // sectors.count, part.astype(np.int32)
    rows = np.empty((len(key), segments.rows.shape[1]))
    sum_units(cells.rows, of_unit, rows, np.empty(len(key), int))
    return _Parts(rows, segments.drift[segment], segment, of_unit, sector)
