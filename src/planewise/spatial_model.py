"""From readings to a ranked model under the spatial objective."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from planewise.cells import cells_of
from planewise.evaluate import covariance_of_plane
from planewise.frame import frame_of
from planewise.model import Curve, Move, PlaneModel
from planewise.observation import RayObservation
from planewise.rank import describe_image
from planewise.spatial import segment, turn_to_theta
from planewise.spatial_information import book_of, groups_of
from planewise.spatial_refit import refitted
from planewise.stages import stage
from planewise.workspace import Workspace

_MANY = 100  # readings that could show a plane


def spatial_model(
    observation: RayObservation,
    *,
    instances: bool,
    max_planes: int,
    significance: float,
    settings: Mapping[str, object],
    workspace: Workspace | None = None,
) -> PlaneModel:
    """Find, rank and describe the planes of a depth image under the spatial objective.

    Parameters
    ----------
    observation : RayObservation
        Of a depth image.
    instances : bool
        Keep coplanar surfaces that do not touch apart.
    max_planes : int
        Largest number of planes.
    significance : float
        Nats that a plane has to save beyond its costs.
    settings : Mapping
        Recorded in the model.
    workspace : Workspace, optional
        Memory to work in.

    Returns
    -------
    PlaneModel
        With exact Phi of its planes and labels.
    """
    size = observation.pixel_size
    with stage("frame"):
        frame = frame_of(observation, workspace)
    with stage("cells"):
        cells = cells_of(frame, size, workspace)
    found = segment(
        observation,
        frame,
        cells,
        instances=instances,
        max_planes=max_planes,
        significance=significance,
        workspace=workspace,
    )

    with stage("ledger"):
        limits = observation.range, observation.resolution
        labels = found.labels
        groups = groups_of(frame, cells, labels, len(found.affine), *limits, size, workspace)
        affine, data = refitted(groups, found.affine)
        book = book_of(frame, labels, groups, data, *limits)
    moves = [Move(kind="agglomerate", planes=len(book.order), information=float(book.curve[-1]))]
    best = int(np.argmin(book.curve))
    if best < len(book.order):
        # What does not pay for itself by exact Phi goes.
        moves.append(Move(kind="cut", planes=best, information=float(book.curve[best])))
    order = book.order[:best]
    place = np.zeros(len(book.order) + 1, np.uint16)
    place[order + 1] = np.arange(1, best + 1)
    phi = book.curve[: best + 1]

    affine = affine[order]
    theta = affine @ turn_to_theta(size).T
    length = np.linalg.norm(theta, axis=1, keepdims=True)
    rows = np.hstack((-theta / length, 1.0 / length))
    covariances = covariance_of_plane(theta, found.covariance[order])
    with stage("describe"):
        planes, labels = describe_image(
            frame, observation.camera, affine, rows, covariances, labels, place
        )
    reason = "no plane saves more than it costs" if not best else "no merge saves anything"
    if cells is None and observation.count >= _MANY:
        reason = (
            "no cell of 3 x 3 pixels is filled with readings near a plane; "
            "objective='paper' takes sparse depth"
        )
    if found.left_out:
        reason = f"reached max_planes = {max_planes}"
    return PlaneModel(
        labels=labels,
        planes=tuple(
            replace(
                plane,
                information=float(book.worth[j]),
                significance=float(found.significance[order[j]]),
                residual_correlation=float(found.residual_correlation[order[j]]),
            )
            for j, plane in enumerate(planes)
        ),
        information=float(phi[-1]),
        curve=Curve(information=book.curve, chosen=best, reason=reason, moves=tuple(moves)),
        readings=observation.count,
        prefix=tuple(phi.tolist()),
        search="joint",
        objective="spatial",
        note="" if best else reason,
        settings=settings,
    )
