"""From readings to a ranked model under the spatial objective."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import planes as plane_loops
from planewise.kernels.cells import UNIT
from planewise.model import Curve, Plane, PlaneModel, limited_to, reason_of
from planewise.observation import RayObservation
from planewise.partition.regions import Regions
from planewise.runtime.stages import stage
from planewise.runtime.workspace import Workspace
from planewise.spatial.cells import cells_of
from planewise.spatial.describe import describe_image, describe_ranges
from planewise.spatial.frame import Frame
from planewise.spatial.frame_error import FrameError
from planewise.spatial.solution import SpatialSolution, by_either, solve
from planewise.spatial.tame_frame import tame_frame

_MANY = 100  # readings that could show a plane


def spatial_model(
    observation: RayObservation,
    *,
    instances: bool,
    max_planes: int,
    significance: float,
    settings: Mapping[str, object],
    workspace: Workspace | None = None,
    regions: Regions | None = None,
) -> PlaneModel:
    """Find, rank and describe the planes of a depth image under the spatial objective.

    Parameters
    ----------
    observation : RayObservation
        Of a depth image.
    instances : bool
        Tell surfaces of one plane that do not touch apart.
    max_planes : int
        Largest number of planes.
    significance : float
        Nats that a plane has to save beyond its costs.
    settings : Mapping
        Recorded in the model.
    workspace : Workspace, optional
        Memory to work in.
    regions : Regions, optional
        That suggest further planes.

    Returns
    -------
    PlaneModel
        With exact Phi of its planes and labels.

    Raises
    ------
    ValueError
        If there are regions, and the camera's image has several sectors.
    """
    workspace, size = workspace or Workspace(), observation.pixel_size
    with stage("frame"):
        frame = tame_frame(observation, workspace)
    if regions is not None and frame.sectors.column is not None:
        raise ValueError(
            "partition with objective='spatial' needs a pinhole camera; range images of a "
            "SphericalCamera take it with objective='paper'"
        )
    with stage("cells"), workspace.stage():
        cells = cells_of(frame, size, workspace)
    solution = solve(
        observation,
        frame,
        cells,
        significance=significance,
        workspace=workspace,
    )
    either, cells = cells, solution.cells
    if regions is not None and cells is not None:
        # Its compiled loops are loaded only where they are used.
        from planewise.spatial.regions import with_regions

        with stage("regions"):
            solution = with_regions(
                observation,
                frame,
                cells,
                solution,
                regions,
                significance=significance,
                workspace=workspace,
            )
    if instances:
        # Its compiled loops are loaded only where they are used.
        from planewise.spatial.instances import told_apart

        with stage("instances"):
            solution = told_apart(
                observation,
                frame,
                cells,
                solution,
                significance=significance,
                workspace=workspace,
            )
    if either is not None:
        with stage("ledger"):
            solution = by_either(observation, frame, either, solution, workspace)
    # Of more than are asked for the best ones are given: a limit makes no other search.
    best = min(solution.best, max_planes)
    phi = solution.curve[: best + 1]
    curve = phi if best < solution.best else solution.curve
    with stage("describe"):
        error = FrameError() if cells is None else cells.error
        planes, labels = _described(observation, frame, solution, error, best)
    settings = dict(settings)
    if cells is not None:
        settings["frame_error"] = error.describe()
    if frame.waves is not None:
        settings["waves"] = frame.waves.describe()
    reason = reason_of(best, significance)
    if cells is None and observation.count >= _MANY:
        reason = (
            "in no cell of 6 x 6 pixels do enough readings lie near a plane; "
            "detect_planes_in_points takes readings that lie far apart"
        )
    if best < solution.best:
        reason = limited_to(max_planes)
    return PlaneModel(
        labels=labels,
        planes=tuple(planes),
        information=float(phi[-1]),
        curve=Curve(information=curve, chosen=best, reason=reason, moves=solution.moves),
        readings=observation.count,
        prefix=tuple(phi.tolist()),
        search="joint",
        objective="spatial",
        note="" if best else reason,
        settings=settings,
    )


def _described(
    observation: RayObservation,
    frame: Frame,
    solution: SpatialSolution,
    error: FrameError,
    best: int,
) -> tuple[Sequence[Plane], NDArray[np.uint16]]:
    """Give the best planes by rank, and the label image, shape (H, W)."""
    found, book = solution.found, solution.book
    order = book.order[:best]
    place = frame.sectors.places(order, len(book.order))
    rows, covariances = np.empty((best, 4)), np.empty((best, 4, 4))
    affine = solution.affine[:: frame.sectors.count][order]
    ratio = frame.table.ratio
    plane_loops.in_space(
        affine, found.information[order], frame.table.drift, frame.table.ranging[0] / ratio,
        error.walk / ratio**2, math.sqrt(frame.w.size) / UNIT, frame.sectors.turn[0], rows,
        covariances,
    )  # fmt: skip
    told = {
        "information": book.saved[:best].tolist(),
        "significance": found.significance[order].tolist(),
        "residual_correlation": found.residual_correlation[order].tolist(),
    }
    if frame.sectors.column is None:
        area = observation.camera.pixel_area(observation.shape)
        return describe_image(frame, area, affine, rows, covariances, found.labels, place, **told)
    return describe_ranges(
        frame, observation.camera, rows, covariances, found.labels, place, **told
    )
