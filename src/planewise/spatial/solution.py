"""Planes and labels of a frame with exact Phi, and only those that pay for themselves by it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planewise import prices
from planewise.information import plane_information
from planewise.kernels.labels import rename
from planewise.model import Move
from planewise.observation import RayObservation
from planewise.ranks import ranks
from planewise.runtime import threads
from planewise.runtime.stages import stage
from planewise.runtime.workspace import Workspace
from planewise.spatial.cells import Cells
from planewise.spatial.frame import Frame
from planewise.spatial.frame_error import FrameError
from planewise.spatial.information import (
    Blocks,
    GroupData,
    Groups,
    Ledger,
    book_of,
    groups_of,
    ledger,
    mask_of,
)
from planewise.spatial.joining import joined
from planewise.spatial.mask_code import MaskCounts
from planewise.spatial.pieces import in_pieces
from planewise.spatial.refit import refitted
from planewise.spatial.search import Segmentation, price_of_planes, segment
from planewise.spatial.sparse import is_sparse, segment_points
from planewise.spatial.units import BENT, residual_correlation, units_inside

Array = NDArray[np.float64]

_LEAST = 3.0, prices.LEAST  # as `spatial.search.price_of_planes` takes it
_PAID = _LEAST[0] - 1, _LEAST[1] - 1  # the same of one whose parameters are paid for
_WIDE = 0.01  # of the readings: no search is made again for a plane of fewer
_LEFT_OUT = 0.05  # the same, for what may be planes that were joined to what bends
_SURE = 4.0  # times `prices.LEAST`: no plane that saves more is cut


@dataclass(frozen=True)
class SpatialSolution:
    """What a search found, and what it is worth.

    Attributes
    ----------
    cells : Cells, optional
        By whose error it was found.
    found : Segmentation
        All planes found, and labels.
    affine : ndarray, shape (N K, 3)
        Its planes in every sector, refitted.
    book : Ledger
        Order and exact Phi of all planes found.
    curve : ndarray, shape (M + 1,)
        Phi with the best 0 ... M planes, of those whose readings are shorter on them.
    moves : tuple of Move
        What the search did.
    """

    cells: Cells | None
    found: Segmentation
    affine: Array
    book: Ledger
    curve: Array
    moves: tuple[Move, ...]

    @cached_property
    def best(self) -> int:
        """Number of planes that pay for themselves."""
        return int(self.curve.argmin())

    @property
    def bent(self) -> NDArray[np.bool_]:
        """Which planes have residuals that are not white."""
        return self.found.residual_correlation > BENT  # not where it is NaN

    @property
    def information(self) -> float:
        """Phi in nats with these planes."""
        return float(self.curve.min())

    @property
    def planes(self) -> tuple[NDArray[np.uint16], Array]:
        """Labels, and planes that pay, of one sector (`spatial.pieces`)."""
        paying = np.sort(self.book.order[: self.best])
        return ranks(paying, len(self.affine))[self.found.labels], self.affine[paying]


def solve(
    observation: RayObservation,
    frame: Frame,
    cells: Cells | None,
    *,
    significance: float,
    workspace: Workspace,
) -> SpatialSolution:
    """Search by the error that makes Phi lower, and again closer where a plane turns out to bend.

    An error that is smooth over a few pixels, as of stereo, may drift besides, or hardly: by a
    drift that is not there faces of a box are one plane, and without one that is walls fall into
    pieces. What cells in a row show does not tell, so such a frame is searched by either. Where
    planes are in pieces then that hardly turn, it does drift. So is one in steps much coarser than
    its noise, by errors that cells on one step share, or do not.

    A plane of readings with little but white noise is allowed to bend more than they say, for the
    sake of mixed pixels and surfaces that are nearly flat. Of what was joined only for that, such
    as two walls at 175 degrees, residuals are correlated; or it bends so much that it is taken for
    a curved surface. Then readings are taken at their word, if that makes Phi lower and residuals
    white; surfaces that bend all the way would fall into as many planes as the noise lets one see.

    Parameters
    ----------
    observation, frame, cells, significance, workspace
        As `spatial.search.segment` takes them.
    """
    blocks = Blocks(frame, cells, observation.resolution, workspace)

    def judge(cells: Cells | None, found: Segmentation) -> SpatialSolution:
        return judged(observation, frame, cells, found, workspace, blocks, join=True)

    if is_sparse(frame, observation.tame.count):
        with stage("points"):
            found = segment_points(
                observation,
                frame,
                significance=significance,
            )
        with stage("ledger"), workspace.stage():
            return judge(cells, found)

    def meanwhile() -> None:
        with stage("ledger"):
            blocks.add_up()

    def look(cells: Cells | None, drift: Array | None = None) -> SpatialSolution:
        found = segment(
            observation,
            frame,
            cells if cells is None or drift is None else replace(cells, drift=drift),
            significance=significance,
            workspace=workspace,
            meanwhile=meanwhile,
        )
        with stage("ledger"), workspace.stage():
            return judge(cells, found)

    def searched(cells: Cells) -> SpatialSolution:
        """Search, and again by what readings tell."""
        first = look(cells)
        if not cells.bends_more_than_told:
            return first
        # Of planes that hardly pay, bends say nothing.
        limits = observation.range, observation.resolution
        sure = _SURE * prices.LEAST * plane_information(3, *limits)
        telling = first.bent & (first.found.significance > sure)
        left_out = first.found.left_out >= _LEFT_OUT * observation.count
        if not left_out and (not telling.any() or not (telling & _wide(frame, first.found)).any()):
            return first
        again = look(cells, cells.told_drift)
        bent = again.bent & (again.found.significance > sure)
        return again if again.information < first.information and not bent.any() else first

    if cells is None:
        return look(None)
    best = searched(cells)
    if cells.other is None:
        return best
    other = searched(cells.other)
    lower = other.information < best.information
    return other if lower and not in_pieces(frame, best.planes, other.planes) else best


def by_either(
    observation: RayObservation,
    frame: Frame,
    cells: Cells,
    solution: SpatialSolution,
    workspace: Workspace,
) -> SpatialSolution:
    """A solution with Phi of every list of its planes by that error of two that makes it less.

    cells: the first one's, and by `other` the second's, of which one is the solution's.
    """
    if len(cells.by_error) == 1:
        return solution
    first, second = cells.by_error
    other = second if solution.cells is first else first
    limits, size = (observation.range, observation.resolution), observation.pixel_size
    planes, order = (solution.affine, solution.found.labels), solution.book.order
    with workspace.stage():
        book = ledger(frame, other, *planes, *limits, size, workspace, order)
    curve = np.minimum(solution.curve, book.curve[: len(solution.curve)])
    best = int(curve.argmin())
    *moves, last = solution.moves
    moves.append(replace(last, planes=best, information=float(curve[best])))
    return replace(solution, curve=curve, moves=tuple(moves))


def _wide(frame: Frame, found: Segmentation) -> NDArray[np.bool_]:
    """Planes of so many of the readings that it is worth while to search again for their sake."""
    count = np.bincount(found.labels.reshape(-1), minlength=len(found.affine) + 1)[1:]
    return np.asarray(frame.sectors.summed(count) >= _WIDE * np.count_nonzero(frame.p))


def judged(
    observation: RayObservation,
    frame: Frame,
    cells: Cells | None,
    found: Segmentation,
    workspace: Workspace,
    blocks: Blocks | None = None,
    *,
    join: bool = False,
    paid: bool = False,
) -> SpatialSolution:
    """Refit the planes, and cut what exact Phi says is shorter without.

    Parameters
    ----------
    observation, frame, cells
        The readings.
    found : Segmentation
        Of which planes and labels are judged.
    workspace : Workspace
        Memory to work in.
    blocks : Blocks, optional
        Of the frame, if they were made before.
    join : bool
        Make those planes one that turn out to be (`spatial.joining`), and name labels anew.
    paid : bool
        Whether they are surfaces of planes that pay: they keep these, whose parameters are paid.
    """
    limits, size = (observation.range, observation.resolution), observation.pixel_size
    cost = plane_information(3, *limits)
    planes, labels = len(found.affine), found.labels
    masks: list[MaskCounts] = []
    with threads.beside(lambda: masks.append(mask_of(frame, labels))):
        groups = groups_of(frame, cells, labels, planes, *limits, size, workspace, blocks)
        data, place = groups.data(found.affine), None
        if join:
            groups, found, place = joined(groups, found, data.worth, cost)
            data = data if place is None else groups.data(found.affine)
        affine = found.affine
        if not paid:
            affine, data = refitted(groups, affine, data)
        if groups.levels > 1:
            data = groups.data(affine, groups.levels)
    mask = masks[0]
    if place is not None:
        mask = mask.renamed(place)
        rename(labels.reshape(-1), place, labels.reshape(-1))
    correlation: list[Array] = []

    def correlate() -> None:
        if cells is not None:
            inside = units_inside(frame, cells, found.labels)
            correlation.append(residual_correlation(cells, inside, affine, frame.sectors))

    with threads.beside(correlate):
        error = FrameError() if cells is None else cells.error
        least = price_of_planes(_PAID if paid else _LEAST, error.drifting, frame.sectors, cost)
        pays = _paying(groups, data, mask, *limits, least, least if paid else _SURE * least)
        order = np.lexsort((data.saved, ~pays))
        book = book_of(groups, data, mask, *limits, order)
    if correlation:
        found = replace(found, residual_correlation=correlation[0])
    curve = book.curve[: np.count_nonzero(pays) + 1]
    moves = [Move(kind="agglomerate", planes=len(order), information=float(book.curve[-1]))]
    best = int(curve.argmin())
    if best < len(order):
        moves.append(Move(kind="cut", planes=best, information=float(curve[best])))
    return SpatialSolution(cells, found, affine, book, curve, tuple(moves))


def _paying(
    groups: Groups,
    data: GroupData,
    mask: MaskCounts,
    range: float,
    resolution: float,
    least: float,
    own: float,
) -> NDArray[np.bool_]:
    """Which planes have readings that are clearly shorter on them, and a lower Phi with them.

    least: nats that the readings of each have to be shorter by; own: the same of a plane that
    errs by more than its frame, as small pieces of what is curved would.
    """
    pays = (data.even < -least) | (data.worth < -own)
    if (data.worth[pays] > -_SURE * least).any():
        # Phi is lower without some of these, maybe: of the last of them by worth.
        order = np.lexsort((data.worth, ~pays))
        book = book_of(groups, data.copy(), mask, range, resolution, order)
        curve = book.curve[: np.count_nonzero(pays) + 1]
        best = int(curve.argmin())
        pays[order[best : len(curve) - 1][np.diff(curve[best:]) > 0.0]] = False
    return pays
