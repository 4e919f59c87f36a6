"""The spatial search: cells, agglomeration by information, labels near borders.

A mask of connected surfaces is cheap to write down and neighbouring readings share their error, so
neighbours are merged first: two segments become one where the evidence that they are one plane and
the border that disappears outweigh their discord. A plane is accepted where it saves more against a
smooth surface, of which every cell has its own plane, than its parameters and its border cost.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planewise.information import plane_information
from planewise.kernels import borders
from planewise.kernels import segments as loops
from planewise.kernels.cells import COUNT, FREE, MISFIT
from planewise.observation import RayObservation
from planewise.runtime.stages import stage
from planewise.runtime.workspace import Workspace
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells
from planewise.spatial.curvature import curved_segments
from planewise.spatial.frame import Frame
from planewise.spatial.gaps import join_through_gaps
from planewise.spatial.labels import label_planes
from planewise.spatial.merging import Border, between, merged
from planewise.spatial.seams import Neighbours
from planewise.spatial.segments import (
    Segments,
    affine_planes,
    information_matrices,
    kept_planes,
)
from planewise.spatial.splitting import split

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

# Prices where error is white, and where it drifts (`FrameError.drifting`; of planes `priced`). Of
# borders: nats per pixel where the surface breaks and where it goes on, and the discord half-way.
_PLANE_BORDER = (0.0, 4.0, 8.0), (0.25, 1.25, 30.0)  # that a plane has to pay for
_PLANE_COST = 1.0, 3.5  # times 3 ln(R / eps): what a plane has to save (`price_of_planes`)
_AS_DRIFTING = 0.8  # of the price where it drifts: planes of range images
_MOST_DRIFTING = 0.5  # of frames where what would pay but for its border is looked at again
_STEADY = 0.1  # drift of frames whose planes have residuals that are all but white
_OFF = 64.0  # squared offset of a cell against its variance, where error drifts: too far off
_FEWEST_OFF = 12  # cells side by side that might be a plane of their own
_MOST_NUMBERS = np.iinfo(np.int16).max  # of planes in sectors, while pixels are labelled


@dataclass(frozen=True)
class Charges:
    """What a segment has to save to be a plane.

    Where the error drifts, as that of a depth camera does, clutter looks like small planes, which
    have much border for what they save, and distortion bends the wide ones. Where it is white, a
    facet of a smooth surface is as flat as a plane, but the surface goes on at its border.

    Attributes
    ----------
    plane : float
        Nats for its parameters.
    border : Border
        For its border.
    distorted : float
        As in `FrameError`.
    """

    plane: float
    border: Border
    distorted: float

    @classmethod
    def of(cls, cells: Cells, sectors: Sectors, cost: float) -> Charges:
        """Those of a frame; cost: 3 ln(R / eps)."""
        plane = price_of_planes(_PLANE_COST, cells.error.priced, sectors, cost)
        (low, high, knee), drifting = _PLANE_BORDER
        white = low, high, knee + cells.error.turning
        border = between((white, drifting), cells.error.drifting)
        return cls(plane, border, cells.error.distorted)

    def misfit(self, rows: Array) -> Array:
        """Half the misfit of segments, but for what distortion makes of it."""
        return np.asarray(0.5 * rows[:, MISFIT] / (1.0 + rows[:, COUNT] / self.distorted))


@dataclass(frozen=True)
class Segmentation:
    """Planes and labels found by the spatial search.

    Attributes
    ----------
    information : ndarray, shape (N, 3, 3)
        On (t0, t1, t2) of the first sector, the error that near readings share included.
    labels : ndarray of uint16, shape (H, W')
        In sectors: 0 for none, n K + k + 1 for plane n in sector k of K.
    significance : ndarray, shape (N,)
        Nats that each plane saves against a smooth surface, all its costs paid.
    affine : ndarray, shape (N K, 3)
        The same planes as w = t0 + t1 x + t2 y (`spatial.frame.Frame`) in every sector.
    residual_correlation : ndarray, shape (N,)
        Of cells side by side on each plane (`spatial.units`), once that was looked at.
    left_out : float
        Readings of the largest segment that is no plane.
    """

    information: Array
    labels: Labels
    significance: Array
    affine: Array
    residual_correlation: Array = field(default_factory=lambda: np.empty(0))
    left_out: float = 0.0


def segment(
    observation: RayObservation,
    frame: Frame,
    cells: Cells | None,
    *,
    significance: float = 0.0,
    workspace: Workspace | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> Segmentation:
    """Find planes and labels under the spatial objective.

    Parameters
    ----------
    observation : RayObservation
        Of a depth image.
    frame, cells
        The same readings as images, and their cells.
    significance : float
        Nats that a segment has to save beyond its costs.
    workspace : Workspace, optional
        Memory to work in.
    meanwhile : callable, optional
        Work that may be done beside.

    Returns
    -------
    Segmentation
    """
    workspace = workspace or Workspace()
    if cells is None:
        return _nothing(frame.w.shape)
    cost = plane_information(3, observation.range, observation.resolution)
    with stage("segments"), workspace.stage():
        segments, beside = merged(cells, frame.sectors, cost, workspace, meanwhile=meanwhile)
        charges = Charges.of(cells, frame.sectors, cost)
        worth, accepted = _accept(
            cells, frame.sectors, beside, segments, charges, significance, workspace,
            sides=beside.sides,
        )  # fmt: skip
        steady = frame.sectors.count == 1 and cells.error.priced < _STEADY
        if steady:
            segments, worth, accepted = _without_bends(
                cells, frame.sectors, beside, segments, worth, accepted, charges, significance,
                workspace,
            )  # fmt: skip
        if frame.sectors.count == 1 and cells.error.drifting:
            segments, worth, accepted = _looked_at_again(
                cells, frame.sectors, segments, worth, accepted, cost, significance, workspace
            )
        left_out = float(segments.rows[~accepted, COUNT].max(initial=0.0))
        chosen, owner, planes = join_through_gaps(segments, worth, accepted, frame.sectors)
        worth = worth[chosen]
    count, most = planes.shape[1], _MOST_NUMBERS // frame.sectors.count
    if count > most:
        planes, owner = _most_significant(planes, owner, worth, most)
    if not count:
        return _nothing(frame.w.shape, left_out)
    with stage("labels"), workspace.stage():
        rows, labels, saved, owner = label_planes(
            frame, cells, segments.of_unit, chosen, planes, owner, observation, workspace,
            charges.plane if steady else None, significance,
        )  # fmt: skip
    left = len(rows) // frame.sectors.count - len(saved)
    total = np.bincount(owner + 1, worth, left + 1)[1:]  # -1 is no plane
    worth = np.concatenate((total, saved))
    return Segmentation(
        information=information_matrices(rows[:: frame.sectors.count]),
        labels=labels,
        significance=worth,
        affine=affine_planes(rows),
        left_out=left_out,
    )


def planes_within(
    cells: Cells,
    sectors: Sectors,
    inside: NDArray[np.bool_],
    settled: NDArray[np.bool_],
    cost: float,
    significance: float,
    workspace: Workspace,
) -> tuple[Segments, Array, NDArray[np.intp]]:
    """Planes that the search finds in a part of a frame, as if nothing else could be joined.

    Parameters
    ----------
    cells : Cells
        Of the frame, or of a rectangle of it.
    sectors : Sectors
        Of the frame; one.
    inside : ndarray of bool, shape (units,)
        Units that may be joined.
    settled : ndarray of bool, shape (units,)
        Others that are on planes already, which pay for the borders with them.
    cost : float
        3 ln(R / eps).
    significance : float
        Nats that a plane has to save beyond its costs.
    workspace : Workspace
        Memory to work in.

    Returns
    -------
    Segments
        Of the units, settled ones among them.
    ndarray, shape (n,)
        What each saves in nats; infinite for settled ones.
    ndarray of int
        Those inside that are planes.
    """
    grid = np.where(np.append(inside, False)[cells.grid], cells.grid, np.int32(-1))
    segments, beside = merged(cells, sectors, cost, workspace, grid)
    charges, beside = Charges.of(cells, sectors, cost), replace(beside, grid=cells.grid)
    worth, accepted = _accept(
        cells, sectors, beside, segments, charges, significance, workspace, settled & ~inside
    )
    mine = np.zeros(len(worth), np.bool_)
    mine[segments.of_unit[inside]] = True
    return segments, worth, np.flatnonzero(mine & accepted)


def _without_bends(
    cells: Cells,
    sectors: Sectors,
    beside: Neighbours,
    segments: Segments,
    worth: Array,
    accepted: NDArray[np.bool_],
    charges: Charges,
    significance: float,
    workspace: Workspace,
) -> tuple[Segments, Array, NDArray[np.bool_]]:
    """Segments, what they save and which are planes; split, or none, where these bend.

    They are split only if more of them are planes then.
    """
    parts, curved = split(cells, segments, accepted, sectors, charges.plane)
    if parts is not segments:
        saved, pays = _accept(cells, sectors, beside, parts, charges, significance, workspace)
        if np.count_nonzero(pays) > np.count_nonzero(accepted):
            segments, worth, accepted = parts, saved, pays
    (no_planes,) = curved[: len(worth)].nonzero()
    accepted[no_planes], worth[no_planes] = False, 0.0
    return segments, worth, accepted


def _looked_at_again(
    cells: Cells,
    sectors: Sectors,
    segments: Segments,
    worth: Array,
    accepted: NDArray[np.bool_],
    cost: float,
    significance: float,
    workspace: Workspace,
) -> tuple[Segments, Array, NDArray[np.bool_]]:
    """Segments, what they save and which are planes, with planes among cells far off their own.

    A long border that goes on, as in-painting and smoothing leave one about what stands before a
    wall, is worth more to a merge than all the discord of a screen 20 cm before it. Such cells save
    nothing as part of the wall, whose worth stays as it is. The less the error drifts the farther
    off they have to be: no such merge is forgiven, and what lies off a wall is distortion.
    """
    planes, place = np.flatnonzero(accepted), np.full(len(accepted), -1, np.int32)
    place[planes] = np.arange(len(planes))
    affine, off = affine_planes(segments.rows[planes]), np.empty(len(cells.rows), np.bool_)
    limit = _OFF / cells.error.drifting
    far = loops.far_off(cells.rows, cells.drift, segments.of_unit, place, affine, limit, off)
    if far < _FEWEST_OFF:
        return segments, worth, accepted
    piece, boxes = np.empty(len(off), np.int32), np.empty((far // _FEWEST_OFF, 4), np.int64)
    found = loops.connected(cells.grid, off, _FEWEST_OFF, np.empty(4 * far, int), piece, boxes)
    settled = accepted[segments.of_unit]
    for number, box in enumerate(boxes[:found].tolist()):
        part, units, _ = cells.cropped(*box)
        inside = piece[units] == number
        with workspace.stage():
            pieces, saved, chosen = planes_within(
                part, sectors, inside, settled[units], cost, significance, workspace
            )
        if len(chosen):
            segments = segments.divided(pieces, chosen, units, cells.rows)
            worth = np.concatenate((worth, saved[chosen]))
    return segments, worth, np.append(accepted, np.ones(len(worth) - len(accepted), np.bool_))


def price_of_planes(
    factors: tuple[float, float], drifting: float, sectors: Sectors, cost: float
) -> float:
    """Nats for factors of 3 ln(R / eps) where error is white and where it drifts, `cost` one.

    In range images, whose cells are wide far off, planes cost nearly as much as where it drifts.
    """
    white, most = factors
    share = drifting if sectors.count == 1 else _AS_DRIFTING
    return sectors.price(white + share * (most - white), cost)


def _accept(
    cells: Cells,
    sectors: Sectors,
    beside: Neighbours,
    segments: Segments,
    charges: Charges,
    least: float,
    workspace: Workspace,
    settled: NDArray[np.bool_] | None = None,
    sides: int | None = None,
) -> tuple[Array, NDArray[np.bool_]]:
    """What each segment saves in nats, and which are planes: those that pay and are not curved.

    A plane has to save its parameters besides its border, but what does not is worth what it saves
    as part of a plane that is paid for. A border costs so much because facets of smooth surfaces go
    on across it: where the error is white, what is flat and goes on across little of it is a plane
    if it saves its parameters. So is, in a coarse image, what ends at breaks if it saves a part of
    them besides its border; Phi asks for the rest later. Segments of `settled` units are planes,
    whatever they save. sides: as many as there are between segments at most, where that is known.
    """
    rows, of_cell = segments.rows, segments.of_cell(beside.grid, workspace)
    border = np.empty((2, len(rows)))
    ends = workspace.empty((sides or 2 * of_cell.size, 2), np.int32)
    units, at = workspace.empty(ends.shape, np.int32), workspace.empty(len(ends), np.int32)
    nats = workspace.empty(len(ends))
    found = borders.segment_borders(
        beside.grid, of_cell, beside.discords, charges.border, beside.wraps, border, ends, units,
        at, nats,
    )  # fmt: skip
    alone = rows[:, FREE] - charges.misfit(rows) - charges.plane
    worth = alone - border[0]
    if settled is not None:
        worth[segments.of_unit[settled]] = np.inf
    accepted = np.empty(len(rows), np.bool_)
    borders.accept(worth, ends[:found], nats[:found], least, accepted)
    worth[~accepted] += charges.plane
    white = cells.error.priced < _MOST_DRIFTING and sectors.count == 1
    coarse = worth - math.sqrt(sectors.fineness) * charges.plane
    small, doubtful = (~accepted & (saved > least) & white for saved in (coarse, alone))
    curved, sharp = curved_segments(
        cells, segments, accepted, doubtful | small, small, beside, border[1], ends[:found],
        units[:found], at[:found], sectors, workspace,
    )  # fmt: skip
    accepted = accepted & ~curved | sharp
    worth[curved], worth[sharp] = 0.0, np.maximum(alone, coarse)[sharp]
    return worth, accepted


def _most_significant(
    planes: Array, owner: NDArray[np.int64], worth: Array, most: int
) -> tuple[Array, NDArray[np.int64]]:
    """The planes that save most, and owners with -1 for the others' segments, too."""
    total = np.bincount(owner + 1, worth, planes.shape[1] + 1)[1:]
    return kept_planes(planes, owner, np.sort(np.argsort(-total, kind="stable")[:most]))


def _nothing(shape: tuple[int, ...], left_out: float = 0.0) -> Segmentation:
    return Segmentation(
        information=np.empty((0, 3, 3)),
        labels=np.zeros(shape, np.uint16),
        significance=np.empty(0),
        affine=np.empty((0, 3)),
        left_out=left_out,
    )
