"""How far what a method found is from the truth of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.metrics import ContingencyTable, clustering, contingency_table
from planewise.reproduce.experiment import Row
from planewise.reproduce.methods import Found
from planewise.scenes.scene import Scene

Array = NDArray[np.float64]
Labels = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of the parameters of every true plane; NaN where none of its readings is on a plane.

    Attributes
    ----------
    normals : ndarray, shape (N,)
        Angle to the true normal, degrees.
    distances : ndarray, shape (N,)
        Difference from the true distance, metres, with its sign.
    """

    normals: Array
    distances: Array


def parameter_errors(scene: Scene, found: Found) -> Errors:
    """Errors of the found plane on which most readings of each true plane are.

    Two true planes that were found as one are both held against that one.
    """
    table = contingency_table(found.labels, scene.labels)
    normals = np.full(len(scene.planes), np.nan)
    distances = normals.copy()
    for row, true in enumerate(table.truth_labels[1:] - 1, start=1):
        counts = table.counts[row, 1:]
        if not counts.any():
            continue
        plane = found.planes[table.predicted_labels[1:][counts.argmax()] - 1]
        truth = scene.planes[true]
        sine = np.linalg.norm(np.cross(plane[:3], truth[:3]))
        normals[true] = np.degrees(np.arctan2(sine, plane[:3] @ truth[:3]))
        distances[true] = plane[3] - truth[3]
    return Errors(normals=normals, distances=distances)


def partners(table: ContingencyTable) -> dict[int, int]:
    """For every true plane the label that is its own: the most readings in common first."""
    counts = table.counts[1:, 1:].copy()
    out: dict[int, int] = {}
    while counts.size and counts.max() > 0:
        row, column = np.unravel_index(counts.argmax(), counts.shape)
        out[int(table.truth_labels[1:][row])] = int(table.predicted_labels[1:][column])
        counts[row], counts[:, column] = 0, 0
    return out


@dataclass(frozen=True, kw_only=True)
class Placed:
    """Readings by what became of them.

    Attributes
    ----------
    right : int
        On the plane that is their true one's own.
    wrong : int
        On another plane.
    none : int
        On no plane.
    """

    right: int
    wrong: int
    none: int

    @property
    def share_right(self) -> float:
        """Of all readings."""
        return self.right / (self.right + self.wrong + self.none)


def placed(scene: Scene, labels: NDArray[np.integer]) -> Placed:
    """Count the readings that are on their plane, on another, and on none."""
    table = contingency_table(labels, scene.labels)
    own = partners(table)
    place = {int(label): at for at, label in enumerate(table.predicted_labels)}
    right = sum(
        int(table.counts[row, place[own[int(true)]]])
        for row, true in enumerate(table.truth_labels)
        if int(true) in own
    )
    none = int(table.counts[1:, 0].sum())
    return Placed(right=right, wrong=int(table.counts[1:].sum()) - right - none, none=none)


def like_the_truth(scene: Scene, labels: NDArray[np.integer]) -> Labels:
    """Label image in which a true plane's own label is that of the truth; others follow."""
    own = {label: true for true, label in partners(contingency_table(labels, scene.labels)).items()}
    new = np.zeros(int(labels.max(initial=0)) + 1, np.int64)
    others = len(scene.planes)
    for label in range(1, len(new)):
        if label not in own:
            others += 1
        new[label] = own.get(label, others)
    return np.asarray(new[labels])


def scored(scene: Scene, found: Found) -> Row:
    """All scores of a frame by name."""
    agreement = clustering(contingency_table(found.labels, scene.labels).counts[1:])
    errors = parameter_errors(scene, found)
    return {
        "planes": len(found.planes),
        "true_planes_found": int(scene.found(found.labels).sum()),
        "voi_bits": agreement.variation_of_information,
        "rand_index": agreement.rand_index,
        "covering": agreement.covering,
        "normal_error_deg": float(np.mean(errors.normals)),
        "distance_error_mm": float(1000 * np.mean(np.abs(errors.distances))),
        "time_ms": 1000 * found.seconds,
    }
