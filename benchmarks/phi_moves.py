"""Exact Phi of any planes and labels of a frame, and moves that lower it.

A move takes a solution and gives back one that is no higher, with as many of its changes as gain.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.frames import Frame
from planewise.kernels import labels as label_loops
from planewise.model import MAX_PLANES
from planewise.observation import RayObservation
from planewise.runtime.workspace import Workspace
from planewise.sectors import turn_to_theta
from planewise.spatial import labels as spatial_labels
from planewise.spatial.cells import cells_of
from planewise.spatial.frame import frame_of
from planewise.spatial.information import Ledger, ledger
from planewise.spatial.marks import Marks
from planewise.spatial.model import spatial_model
from planewise.spatial.segments import affine_planes, with_none
from planewise.spatial.units import planes_of_units

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]
Region = NDArray[np.bool_]

_LEAST = 0.01  # nats: what gains less is no gain
_PARTS = 150  # connected parts that are moved one by one, the largest
_FEW = 30  # pixels: what differs by less is the same
_TOGETHER = (3, 10, 30, 100, 300)  # pixels of parts that are moved at once
_DIFFERING = (0.3, 0.6, 1.0, 1.5, 2.5)  # nats a neighbour of another label, in sweeps,
_NULL = (0.4, 0.7, 1.0)  # cost of none, times ln(R / eps),
_DRIFT = (0.3, 1.5, 5.0)  # and drift of a reading about its plane
_SWEEPS = 30


@dataclass(frozen=True)
class Solution:
    """Planes and labels of a frame, and their exact Phi in nats.

    affine (N, 3): w = t0 + t1 x + t2 y; labels (H, W): 0 for none, j for row j - 1.
    """

    phi: float
    affine: Array
    labels: Labels

    def __len__(self) -> int:
        return len(self.affine)


class Judge:
    """Exact Phi of any planes and labels of one frame.

    Raises
    ------
    ValueError
        If no cell of the frame has a plane.
    """

    def __init__(self, frame: Frame) -> None:
        seen = pw.observe(frame.depth, frame.camera, frame.sensor, depth_scale=frame.depth_scale)
        assert isinstance(seen, RayObservation)
        self.observation, self.frame = seen, frame_of(seen)
        cells = cells_of(self.frame, seen.pixel_size)
        if cells is None:
            raise ValueError(f"{frame.name} has no cell with a plane")
        self.cells, self.workspace = cells, Workspace()
        self._limits = seen.range, seen.resolution, seen.pixel_size

    def book(self, affine: Array, labels: Labels) -> Ledger:
        """Ledger of planes and labels."""
        with self.workspace.frame():
            return ledger(self.frame, self.cells, affine, labels, *self._limits, self.workspace)

    def solution(self, affine: Array, labels: Labels) -> Solution:
        """What pays of planes and labels, best first."""
        book = self.book(affine, labels)
        best = int(np.argmin(book.curve))
        order = book.order[:best]
        place = np.zeros(len(affine) + 1, np.uint16)
        place[order + 1] = np.arange(1, best + 1)
        return Solution(float(book.curve[best]), affine[order], place[labels])

    def nothing(self) -> Solution:
        """No plane."""
        return self.solution(np.empty((0, 3)), np.zeros(self.frame.w.shape, np.uint16))

    def default(self, **options: Any) -> Solution:
        """What the default call finds with the constants that hold now."""
        model = spatial_model(
            self.observation,
            **({"instances": False, "significance": 0.0} | options),
            max_planes=MAX_PLANES,
            settings={},
        )
        theta = -model.coefficients[:, :3] / model.coefficients[:, 3:]
        affine = theta @ np.linalg.inv(turn_to_theta(self.observation.pixel_size)).T
        return Solution(float(self.book(affine, model.labels).curve.min()), affine, model.labels)

    def lower(self, now: Solution, affine: Array, labels: Labels) -> Solution:
        """Other planes and labels where their Phi is lower; planes keep their numbers."""
        phi = float(self.book(affine, labels).curve.min())
        return Solution(phi, affine, labels) if phi < now.phi - _LEAST else now


Move = Callable[[Judge, Solution, Sequence[Solution]], Solution]


def drop(judge: Judge, now: Solution, others: Sequence[Solution]) -> Solution:
    """Take a plane away, the least first."""
    for j in range(len(now), 0, -1):
        now = judge.lower(now, now.affine, _with(now, now.labels == j, 0))
    return now


def join(judge: Judge, now: Solution, others: Sequence[Solution]) -> Solution:
    """Make two planes one: the better of them, or that of all their readings."""
    for worse in range(len(now), 0, -1):
        for better in range(1, worse):
            labels = _with(now, now.labels == worse, better)
            if np.array_equal(labels, now.labels):
                break  # it is gone
            before = now
            now = judge.lower(now, now.affine, labels)
            now = judge.lower(now, _moved(now, better, _plane_of(judge, labels == better)), labels)
            if now is not before:
                break
    return now


def refit(judge: Judge, now: Solution, others: Sequence[Solution]) -> Solution:
    """Move a plane to that of its readings or of its cells, or along what it is least sure of."""
    none = np.zeros((len(now), judge.cells.rows.shape[1]))
    rows, _ = planes_of_units(judge.frame, judge.cells, now.labels, none)
    for j in range(1, len(now) + 1):
        mine = now.labels == j
        if not mine.any():
            continue
        if rows[j - 1].any():
            plane = affine_planes(rows[j - 1 : j])[0]
            now = judge.lower(now, _moved(now, j, plane), now.labels)
        now = judge.lower(now, _moved(now, j, _plane_of(judge, mine)), now.labels)
        values, vectors = np.linalg.eigh(_normal_equations(judge, mine)[0])
        for step in (vectors / np.sqrt(values)).T:
            now = _descended(judge, now, j, step)
    return now


def relabel(judge: Judge, now: Solution, others: Sequence[Solution]) -> Solution:
    """Sweep over all pixels at several prices of borders, none and drift."""
    for differing in _DIFFERING:
        for null in _NULL:
            for drift in _DRIFT:
                labels = _swept(judge, now, differing, null, drift)
                now = judge.lower(now, now.affine, labels)
    return now


def give(judge: Judge, now: Solution, others: Sequence[Solution]) -> Solution:
    """Give connected parts of labels, holes too, to a neighbour or to none."""
    number, parts = _parts(judge, now.labels)
    old = np.array([now.labels.flat[where[0]] for where, _ in parts], np.uint16)
    most = np.array([beside[0] if beside else 0 for _, beside in parts], np.uint16)
    size = np.array([where.size for where, _ in parts])
    for limit in _TOGETHER:
        to = np.append(np.where(size <= limit, most, old), np.uint16(0))  # the last: no reading
        now = judge.lower(now, now.affine, to[number - 1])
    for k in np.argsort(-size, kind="stable")[:_PARTS]:
        where, beside = parts[k]
        for label in dict.fromkeys((*beside[:3], 0)):
            labels = now.labels.copy()
            labels.flat[where] = label
            now = judge.lower(now, now.affine, labels)
    return now


def add(judge: Judge, now: Solution, others: Sequence[Solution]) -> Solution:
    """Add a plane of another solution on its readings that are on none here."""
    for other in others:
        for j, plane in enumerate(other.affine, start=1):
            there = (other.labels == j) & (now.labels == 0)
            if np.count_nonzero(there) > _FEW:
                now = judge.lower(now, np.vstack((now.affine, plane)), _with(now, there))
    return now


def cross(judge: Judge, now: Solution, others: Sequence[Solution]) -> Solution:
    """Take a plane of another solution with its labels: beside the one that it overlaps, or for it.

    Then the rest of that one goes to the new plane or to none.
    """
    for other in others:
        for j, plane in enumerate(other.affine, start=1):
            there = other.labels == j
            shares = np.bincount(now.labels[there], minlength=len(now) + 1)
            here = int(np.argmax(shares[1:])) + 1 if len(now) else 0
            mine = now.labels == here
            if not here or not shares[here] or np.count_nonzero(mine ^ there) <= _FEW:
                continue
            more, instead = np.vstack((now.affine, plane)), _moved(now, here, plane)
            rest = np.where(there, here, _with(now, mine, 0)).astype(np.uint16)
            for affine, labels in (
                (more, _with(now, there)),
                (instead, _with(now, there, here)),
                (instead, rest),
                (now.affine, rest),
            ):
                now = judge.lower(now, affine, labels)
    return now


MOVES: tuple[Move, ...] = (relabel, drop, join, refit, give, add, cross)


def _with(now: Solution, where: Region, label: int | None = None) -> Labels:
    """Labels with another in a region: by default that of one more plane."""
    return np.where(where, len(now) + 1 if label is None else label, now.labels).astype(np.uint16)


def _moved(now: Solution, label: int, plane: Array) -> Array:
    affine = now.affine.copy()
    affine[label - 1] = plane
    return affine


def _descended(judge: Judge, now: Solution, label: int, step: Array) -> Solution:
    """Plane moved to and fro, in larger steps where that gains and smaller ones where not."""
    size = 10.0
    while abs(size) > 0.5:
        plane = now.affine[label - 1] + size * step
        before, now = now, judge.lower(now, _moved(now, label, plane), now.labels)
        if now is not before:
            size *= 2.0
        else:
            size = -size if size > 0 else -0.25 * size
    return now


def _normal_equations(judge: Judge, where: Region) -> tuple[Array, Array]:
    frame = judge.frame
    x: Array = np.stack((np.ones(frame.x[where].shape), frame.x[where], frame.y[where]))
    weighted = x * (frame.p[where] / judge.cells.error.white)
    return weighted @ x.T, weighted @ frame.w[where]


def _plane_of(judge: Judge, where: Region) -> Array:
    """Plane of least squares of readings."""
    return np.asarray(np.linalg.lstsq(*_normal_equations(judge, where), rcond=None)[0])


def _swept(judge: Judge, now: Solution, differing: float, null: float, drift: float) -> Labels:
    """Labels after the sweeps of the default search, over all pixels and until nothing changes."""
    frame, cells = judge.frame, judge.cells
    there = frame.p > 0
    marks = Marks.of(there.shape, Workspace())
    inside = np.s_[1 : there.shape[0] + 1, 1 : there.shape[1] + 1]
    marks.label[:], marks.state[:], marks.busy[:] = label_loops.NONE, label_loops.FIXED, True
    marks.label[inside] = np.where(there, now.labels, label_loops.NONE)
    marks.state[inside] = np.where(there, 1, label_loops.FIXED)
    with patch.object(spatial_labels, "_PIXEL_DRIFT", drift):
        variance = spatial_labels._variances(frame, cells)
    affine = with_none(now.affine)
    anything = np.log(judge.observation.range / judge.observation.resolution)
    label_loops.label_pixels(
        marks.label.reshape(-1), marks.state.reshape(-1), marks.busy.reshape(-1),
        marks.seen.reshape(-1), marks.label.shape[1], frame.w.reshape(-1), frame.x.reshape(-1),
        frame.y.reshape(-1), there.shape[1], variance, frame.table.ranging, affine,
        spatial_labels._lateral(cells, affine), null * anything, differing, _SWEEPS,
    )  # fmt: skip
    return np.maximum(marks.label[inside], 0).astype(np.uint16)


def _parts(
    judge: Judge, labels: Labels
) -> tuple[NDArray[np.int64], list[tuple[NDArray[np.int64], list[int]]]]:
    """Connected parts: their numbers, 0 without a reading; and pixels and labels beside of each.

    Labels beside are in the order of how many pixels touch.
    """
    there = np.where(judge.frame.p > 0, labels.astype(np.int64) + 1, 0)
    number = import_module("skimage.measure").label(there, background=0, connectivity=1)
    beside: list[Counter[int]] = [Counter() for _ in range(number.max() + 1)]
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        for one, other in ((a, b), (b, a)):
            meet = (number[one] != number[other]) & (number[one] > 0) & (number[other] > 0)
            pairs = np.column_stack((number[one][meet], labels[other][meet]))
            found, counts = np.unique(pairs, axis=0, return_counts=True)
            for (n, label), count in zip(found.tolist(), counts.tolist(), strict=True):
                beside[n][label] += count
    order = np.argsort(number, axis=None, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(number.ravel(), minlength=len(beside)))[:-1])
    return number, [
        (where, [label for label, _ in each.most_common()])
        for where, each in zip(parts[1:], beside[1:], strict=True)
    ]
