"""Compile the loops of the later stages in processes of their own, while the first ones are.

``python -m planewise.warm_up describing valuing labelling surfaces`` is what `compilation.announce`
starts, or several such processes where there are more cores; what they compile is found in Numba's
cache by the time the call that waits gets there. They begin with the last stage, so that a single
one and the call meet, whichever is faster.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.camera import PinholeCamera
from planewise.compilation import confirm
from planewise.kernels.cells import MOMENTS, SEGMENT, SIDE
from planewise.kernels.curvature import (
    QUADRIC,
    find_round,
    inner_units,
    leave_out,
    meet,
    surface_borders,
)
from planewise.kernels.faces import give_back, wait_about
from planewise.kernels.folds import profiles
from planewise.kernels.forms import FORM
from planewise.kernels.labels import rename
from planewise.kernels.planes import in_space
from planewise.kernels.quadrics import spread
from planewise.kernels.segments import agglomerate, room
from planewise.runtime.workspace import Workspace
from planewise.spatial.cells import Cells
from planewise.spatial.describe import describe_image
from planewise.spatial.faces import LabelPixels, misfits_of, parted
from planewise.spatial.frame import ErrorTable, Frame
from planewise.spatial.frame_error import FrameError
from planewise.spatial.gaps import join_through_gaps
from planewise.spatial.information import book_of, groups_of, mask_of
from planewise.spatial.joining import joined
from planewise.spatial.labels import label_planes
from planewise.spatial.marks import Marks
from planewise.spatial.merging import merged
from planewise.spatial.refit import refitted
from planewise.spatial.search import Segmentation
from planewise.spatial.segments import Segments
from planewise.spatial.units import residual_correlation, units_inside

_SIZE = 36  # pixels to a side of the frame
_CREASE = 0.18  # where its two planes meet, in units of 100 pixels
_PLANES = np.array([[0.5 + _CREASE, -1.0, 0.0], [0.5 - _CREASE, 1.0, 0.0]])  # w = t0 + t1 x + t2 y
_LIMITS = 10.0, 0.001  # R and eps in metres
_CAMERA = PinholeCamera(fx=500, fy=500, cx=0, cy=0)


@dataclass(frozen=True)
class _Valley:
    """A made-up frame of two planes, whose arrays have the types and layouts of a real one's.

    Attributes
    ----------
    frame, cells
        Every cell is a unit.
    labels : ndarray of uint16, shape (H, W)
        1 on the first plane and 2 on the second.
    rows : ndarray, shape (2, 13)
        Of both as segments of a cell.
    of_unit : ndarray of int32, shape (units,)
        On which of them every unit is.
    """

    frame: Frame
    cells: Cells
    labels: NDArray[np.uint16]
    rows: NDArray[np.float64]
    of_unit: NDArray[np.int32]


def _valley() -> _Valley:
    y, x = np.indices((_SIZE, _SIZE), np.float32) / np.float32(100)
    frame = Frame(
        w=(0.5 + np.abs(x - _CREASE)).astype(np.float32),
        p=np.full(x.shape, 1e6, np.float32),
        x=x,
        y=y,
        straight=True,
        table=ErrorTable((1000.0, 0.0, 0.0), 1.0, 1, *np.full((4, 4000), 1e-7)),
        known=True,
        measured=True,
        resolution=_LIMITS[1],
        sectors=_CAMERA.sectors((_SIZE, _SIZE)),
    )
    side = _SIZE // SIDE
    of_unit = (np.arange(side * side) % side >= side // 2).astype(np.int32)
    rows = np.array([_row(plane) for plane in _PLANES])
    labels = np.where(x < _CREASE, 1, 2).astype(np.uint16)
    return _Valley(frame, _cells(rows[of_unit]), labels, rows, of_unit)


def describing() -> None:
    """Describe the planes, the last stage."""
    valley = _valley()
    frame, table, labels = valley.frame, valley.frame.table, valley.labels
    area, place = _CAMERA.pixel_area(labels.shape), np.arange(3, dtype=np.uint16)
    rows, covariances = np.empty((2, 4)), np.empty((2, 4, 4))
    in_space(
        _PLANES, np.tile(np.eye(3), (2, 1, 1)), table.drift, table.ranging[0], 1.0, 1.0,
        np.eye(3), rows, covariances,
    )  # fmt: skip
    describe_image(frame, area, _PLANES, rows, covariances, labels, place)


def valuing() -> None:
    """Say what planes are worth, the stage before."""
    valley = _valley()
    frame, cells, labels = valley.frame, valley.cells, valley.labels
    groups = groups_of(frame, cells, labels, 2, *_LIMITS, (0.002, 0.002))
    found = Segmentation(np.tile(np.eye(3), (2, 1, 1)), labels, np.ones(2), _PLANES)
    joined(groups, found, np.zeros(2), 1e9)
    _, data = refitted(groups, _PLANES, groups.data(_PLANES))
    book_of(groups, data, mask_of(frame, labels), *_LIMITS)
    residual_correlation(cells, units_inside(frame, cells, labels), _PLANES, frame.sectors)
    rename(labels.reshape(-1), np.arange(3, dtype=np.uint16), labels.reshape(-1))


def labelling() -> None:
    """Part both planes of the valley, as if they were one, and label pixels; the last loops first.

    Here the call may come up: it should not have to compile a loop that takes seconds, too.
    """
    valley = _valley()
    labels = np.ones((_SIZE, _SIZE), np.uint16)
    one, work = valley.rows.sum(axis=0)[None], Workspace()
    chi2, count = misfits_of(valley.frame, 1.0, one, labels).T
    doubtful = LabelPixels.of(labels, chi2 > 0.0, count, work)
    _, _, pixels = parted(valley.frame, 1.0, one, labels, doubtful, 1.0, 0.0)
    images = valley.frame.w, valley.frame.p, *valley.frame.sectors.coordinates
    ends = np.zeros(1, np.int64), np.array([len(pixels)])
    out, sides = np.empty((1, 2, 3)), np.empty((1, 2))
    profiles(pixels, *ends, *images, 1.0, np.zeros((1, 3)), 1, 0.0, 1.0, 1.0, out, sides)
    marks = Marks.of(labels.shape, work)
    named = np.ones(3, np.bool_)
    marks.label[:], marks.seen[:] = 0, False
    wait_about(pixels, labels, named, marks.label, marks.state, marks.busy, marks.seen)
    give_back(labels, marks.label, marks.seen, named, *images, 1.0)
    cells, both = valley.cells, np.arange(2)
    limits: Any = SimpleNamespace(range=_LIMITS[0], resolution=_LIMITS[1])
    of_planes = cells, valley.of_unit, both, valley.rows[None], both, limits, None, 1.0
    label_planes(valley.frame, *of_planes)


def surfaces() -> None:
    """Join segments through gaps, and before that look for curved ones; the last loop first.

    Here a single process and the call meet, and in the same order both would compile the same.
    """
    valley = _valley()
    rows, cells = valley.rows, valley.cells
    segments = Segments(
        rows=rows,
        drift=cells.drift[:2],
        offset_prior=cells.offset_prior[:2],
        slope_prior=cells.slope_prior[:2],
        home=np.zeros(2, np.int32),
        of_unit=valley.of_unit,
    )
    join_through_gaps(segments, np.ones(2), np.ones(2, np.bool_), valley.frame.sectors)
    ends, border, curved = np.array([[0, 1]], np.int32), np.zeros(2), np.zeros(2, np.bool_)
    pairs, points, states = ends.copy(), np.zeros(1, np.float32), np.zeros(1, np.int8)
    of_unit, at = np.arange(2, dtype=np.int32), np.zeros(1, np.int32)
    how, turns = np.zeros((2, 1), np.int8)
    quadrics, chosen = np.ones((2, QUADRIC)), np.ones(2, np.bool_)
    leave_out(pairs, states, curved, curved)
    inner_units(cells.grid, valley.of_unit, np.empty_like(valley.of_unit))
    spread(border, border, pairs, points, states, curved)
    surface_borders(
        ends, ends, rows, quadrics, np.arange(2), how, turns, border, pairs, points, states
    )
    find_round(ends, at, ends, of_unit, rows, quadrics, chosen, False, how)
    meet(ends, ends, rows, quadrics, 1.0, how, turns)


def merging() -> None:
    """Merge cells into segments, by the largest of all loops first."""
    valley = _valley()
    cells, turns = valley.cells, valley.frame.sectors.turns
    rows, grid = cells.rows.copy(), cells.grid
    forms, home = np.ones((len(rows), FORM)), np.zeros(len(rows), np.int32)
    ints, floats = room(2 * grid.size, len(rows))
    agglomerate(
        grid, np.ones((2, *grid.shape)), (0.0, 0.0, 1.0), rows, forms, cells.drift.copy(),
        0.0, cells.offset_prior, cells.slope_prior, home, turns, False, 1.0, 1.0, 4.0, home.copy(),
        home.copy(), np.empty(ints, np.int32), np.empty(floats),
    )  # fmt: skip
    merged(cells, valley.frame.sectors, 1.0, Workspace())


def _row(plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """Segment row of a cell on a plane."""
    row, information = np.zeros(SEGMENT), np.array([1e6, 1e4, 1e4])
    row[[0, 3, 5]], row[6:9], row[10] = information, information * plane, SIDE * SIDE
    return row


def _cells(rows: NDArray[np.float64]) -> Cells:
    """Every cell of the frame a unit."""
    count = len(rows)
    side = _SIZE // SIDE
    return Cells(
        grid=np.arange(count, dtype=np.int32).reshape(side, side),
        count=np.full((side, side), SIDE * SIDE, np.uint8),
        tiles=np.ones((-(-side // 3), MOMENTS + 1, -(-side // 3))),
        rows=rows,
        whole=np.zeros(count, np.bool_),
        squares=np.full((side // 2, side // 2), -1, np.int32),
        drift=np.full(count, 1e-7),
        told_drift=np.full(count, 1e-7),
        offset_prior=np.ones(count),
        slope_prior=np.ones(count),
        error=FrameError(),
    )


_PARTS = {part.__name__: part for part in (describing, valuing, labelling, surfaces, merging)}


def later_stages(parts: Iterable[str] = tuple(_PARTS)) -> None:
    """Compile these parts of them, in this order."""
    for name in parts:
        _PARTS[name]()


if __name__ == "__main__":
    gc.disable()  # a short life
    later_stages(sys.argv[1:])
    confirm()
    gc.freeze()  # nor at its end
