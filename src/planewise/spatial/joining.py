"""Planes of range images that turn out to be one, once they are refitted.

A segment of few cells is bent by those that lie across a border, so that the search takes a piece
of a floor for another plane. The groups of Phi tell: on the other's plane its readings do not take
so much more as its own parameters do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planewise.information import plane_information
from planewise.observation import RayObservation
from planewise.spatial.cells import Cells
from planewise.spatial.frame import Frame
from planewise.spatial.information import Groups, groups_of
from planewise.spatial.refit import refitted
from planewise.spatial.search import Segmentation
from planewise.workspace import Workspace

Array = NDArray[np.float64]

_FAR = 100.0  # times its parameters, by its covariance: no plane is another that is so far


def joined(
    observation: RayObservation,
    frame: Frame,
    cells: Cells,
    found: Segmentation,
    workspace: Workspace,
) -> Segmentation:
    """Planes with those made one whose parameters cost more than they save.

    Parameters
    ----------
    observation, frame, cells
        The readings.
    found : Segmentation
        Planes and labels.
    workspace : Workspace
        Memory to work in.
    """
    limits, size = (observation.range, observation.resolution), observation.pixel_size
    groups = groups_of(frame, cells, found.labels, len(found.affine), *limits, size, workspace)
    affine, data = refitted(groups, found.affine)
    information, parameters = found.information, plane_information(3, *limits)
    first = affine[:: frame.sectors.count]
    apart = first[:, None] - first
    near = 0.5 * np.einsum("nmi,nij,nmj->nm", apart, information, apart) < _FAR * parameters
    part = _parts(_costs(groups, affine, data.worth, near) - parameters)
    alive, part = np.unique(part, return_inverse=True)
    if len(alive) == len(part):
        return found
    count = frame.sectors.count
    named = 1 + count * part[:, None] + np.arange(count)
    label = np.concatenate((np.zeros(1, np.uint16), named.reshape(-1).astype(np.uint16)))
    labels = np.asarray(label[found.labels], np.uint16)
    together = np.zeros((len(alive), 3, 3))
    np.add.at(together, part, information)
    affine = affine.reshape(-1, count, 3)[alive].reshape(-1, 3)
    return replace(
        found,
        labels=labels,
        affine=affine,
        information=together,
        significance=np.asarray(np.bincount(part, found.significance), np.float64),
    )


def _costs(groups: Groups, affine: Array, worth: Array, near: NDArray[np.bool_]) -> Array:
    """Nats more (N, N) that readings of the first plane take on the second; of those near it."""
    planes = len(worth)
    first, more = np.arange(planes), np.full((planes, planes), np.inf)
    for step in range(1, planes):
        second = (first + step) % planes
        compared = near[first, second]
        if compared.any():
            moved = affine.reshape(planes, -1, 3)[np.where(compared, second, first)]
            nats = groups.data(moved.reshape(-1, 3)).worth - worth
            more[first[compared], second[compared]] = nats[compared]
    return more


def _parts(more: Array) -> NDArray[np.intp]:
    """Plane that each becomes part of, itself unless `more` nats are fewer than none."""
    part = np.arange(len(more))
    while more.size and more.min() < 0.0:
        small, large = np.unravel_index(more.argmin(), more.shape)
        part[part == small] = large
        more[small] = more[:, small] = np.inf
    return part
