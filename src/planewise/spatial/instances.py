"""Surfaces of one plane that do not touch, told apart: ``instances=True``.

They share the parameters of their plane, which all of its readings tell and pay for. Each has to
pay for what else a plane costs: scraps of a wall between the legs of a chair are no surfaces.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from planewise.kernels.cells import SIDE
from planewise.kernels.pieces import label_pieces
from planewise.model import Move
from planewise.observation import RayObservation
from planewise.ranks import ranks
from planewise.runtime.workspace import Workspace
from planewise.spatial.cells import Cells
from planewise.spatial.frame import Frame
from planewise.spatial.information import MOST_LABELS
from planewise.spatial.solution import SpatialSolution, judged
from planewise.spatial.sparse import usual_share

_REACH = SIDE  # pixels from one to another that touch, where no reading is missing


def told_apart(
    observation: RayObservation,
    frame: Frame,
    cells: Cells | None,
    solution: SpatialSolution,
    *,
    significance: float,
    workspace: Workspace,
) -> SpatialSolution:
    """Surfaces in place of planes, with exact Phi; what a plane saves is shared by its pixels.

    Parameters
    ----------
    observation, frame, cells
        The readings.
    solution : SpatialSolution
        Planes, of which those that pay are looked at.
    significance : float
        Nats that a surface has to save beyond its costs.
    workspace : Workspace
        Memory to work in.

    Returns
    -------
    SpatialSolution
        The same object where every plane is one surface.
    """
    sectors, found = frame.sectors, solution.found
    paying = np.sort(solution.book.order[: solution.best])
    if not len(paying):
        return solution
    place = sectors.places(paying, len(solution.book.order))
    image = sectors.image(place[found.labels])
    most = MOST_LABELS // sectors.count
    pieces, label = np.empty(image.shape, np.uint16), np.empty(most, np.uint16)
    with workspace.stage():
        room = workspace.empty(image.size, np.int32)
        count = label_pieces(image, _reach(frame), sectors.wraps, room, label, pieces)
    if count == len(paying) or count > most:
        return solution
    plane = label[:count].astype(np.intp) - 1  # of those that pay
    pixels = np.bincount(pieces.reshape(-1), minlength=count + 1)[1:]
    share = pixels / np.bincount(plane, pixels)[plane]
    row = paying[plane]
    saved = found.significance[row] * share
    keep = np.flatnonzero(saved > significance)
    kept = ranks(keep, count)
    row = row[keep]
    of_plane = solution.affine.reshape(-1, sectors.count, 3)
    split = replace(
        found,
        information=found.information[row],
        labels=np.ascontiguousarray(sectors.labels(kept[pieces]), np.uint16),
        significance=saved[keep],
        affine=of_plane[row].reshape(-1, 3),
        residual_correlation=found.residual_correlation[row],
    )
    with workspace.stage():
        out = judged(observation, frame, cells, split, workspace, paid=True)
    move = Move(kind="instances", planes=out.best, information=out.information)
    return replace(out, moves=(*solution.moves, move))


def _reach(frame: Frame) -> int:
    """Pixels between readings side by side on one surface, where some are missing."""
    return math.ceil(_REACH / math.sqrt(usual_share(frame)))
