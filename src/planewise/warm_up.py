"""Compile the loops of the later stages in a process of their own, while the first ones are.

``python -m planewise.warm_up`` is what `compilation.announce` starts; what it compiles is found in
Numba's cache by the time the call that waits gets there. It begins with the last stage, so that the
two meet, whichever is faster.
"""

from __future__ import annotations

import gc
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
    leave_out,
    meet,
    surface_borders,
)
from planewise.kernels.forms import FORM
from planewise.kernels.planes import in_space
from planewise.kernels.quadrics import spread
from planewise.spatial.cells import Cells
from planewise.spatial.describe import describe_image
from planewise.spatial.frame import ErrorTable, Frame
from planewise.spatial.frame_error import FrameError
from planewise.spatial.gaps import join_through_gaps
from planewise.spatial.information import book_of, groups_of, mask_of
from planewise.spatial.joining import joined
from planewise.spatial.labels import label_planes, residual_correlation, units_inside
from planewise.spatial.refit import refitted
from planewise.spatial.search import Segmentation
from planewise.spatial.segments import Segments

_SIZE = 36  # pixels to a side of the frame
_CREASE = 0.18  # where its two planes meet, in units of 100 pixels
_PLANES = np.array([[0.5 + _CREASE, -1.0, 0.0], [0.5 - _CREASE, 1.0, 0.0]])  # w = t0 + t1 x + t2 y


def later_stages() -> None:
    """Describe, value, label and join the two planes of a made-up frame, a valley.

    Its arrays have the types and layouts of a real one's.
    """
    camera = PinholeCamera(fx=500, fy=500, cx=0, cy=0)
    y, x = np.indices((_SIZE, _SIZE), np.float32) / np.float32(100)
    frame = Frame(
        w=(0.5 + np.abs(x - _CREASE)).astype(np.float32),
        p=np.full(x.shape, 1e6, np.float32),
        x=x,
        y=y,
        straight=True,
        table=ErrorTable(1000.0, 1, *np.full((4, 4000), 1e-7)),
        known=True,
        estimated=False,
        resolution=0.001,
        sectors=camera.sectors((_SIZE, _SIZE)),
    )
    labels = np.where(x < _CREASE, 1, 2).astype(np.uint16)
    area, place = camera.pixel_area(labels.shape), np.arange(3, dtype=np.uint16)
    rows, covariances = np.empty((2, 4)), np.empty((2, 4, 4))
    in_space(_PLANES, np.tile(np.eye(3), (2, 1, 1)), np.eye(3), rows, covariances)
    describe_image(frame, area, _PLANES, rows, covariances, labels, place)

    side = _SIZE // SIDE
    of_unit = (np.arange(side * side) % side >= side // 2).astype(np.int32)
    rows = np.array([_row(plane) for plane in _PLANES])
    cells = _cells(rows[of_unit])
    groups = groups_of(frame, cells, labels, 2, 10.0, 0.001, (0.002, 0.002))
    found = Segmentation(np.tile(np.eye(3), (2, 1, 1)), labels, np.ones(2), _PLANES)
    before = groups.data(_PLANES)
    joined(groups, found, before, 1e9)
    _, data = refitted(groups, _PLANES, before)
    book_of(groups, data, mask_of(frame, labels), 10.0, 0.001)

    limits: Any = SimpleNamespace(range=10.0, resolution=0.001)
    both = np.arange(2)
    residual_correlation(cells, units_inside(frame, cells, labels), _PLANES, frame.sectors)
    label_planes(frame, cells, of_unit, both, rows[None], both, limits)
    segments = Segments(
        rows=rows,
        forms=np.ones((2, FORM)),
        drift=cells.drift[:2],
        offset_prior=cells.offset_prior[:2],
        slope_prior=cells.slope_prior[:2],
        home=np.zeros(2, np.int32),
        of_unit=of_unit,
    )
    join_through_gaps(segments, np.ones(2), np.ones(2, np.bool_), frame.sectors)
    _surfaces(rows)


def _surfaces(rows: NDArray[np.float64]) -> None:
    """Two segments side by side, as if one of them were bent; the last loop first.

    Here the two processes meet, and in the same order both would compile the same loops.
    """
    ends, border, curved = np.array([[0, 1]], np.int32), np.zeros(2), np.zeros(2, np.bool_)
    pairs, points, states = ends.copy(), np.zeros(1, np.float32), np.zeros(1, np.int8)
    of_unit, at, how = np.arange(2, dtype=np.int32), np.zeros(1, np.int32), np.zeros(1, np.int8)
    quadrics, chosen = np.ones((2, QUADRIC)), np.ones(2, np.bool_)
    leave_out(pairs, states, curved, curved)
    spread(border, pairs, points, states, curved)
    surface_borders(ends, ends, rows, quadrics, np.arange(2), how, border, pairs, points, states)
    find_round(ends, at, ends, of_unit, rows, quadrics, chosen, False, how)
    meet(ends, ends, rows, quadrics, 1.0, how)


def _row(plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """Segment row of a cell on a plane."""
    row, information = np.zeros(SEGMENT), np.array([1e6, 1e4, 1e4])
    row[[0, 3, 5]], row[6:9], row[10] = information, information * plane, SIDE * SIDE
    return row


def _cells(rows: NDArray[np.float64]) -> Cells:
    """Every cell of the frame a unit."""
    count = len(rows)
    side = _SIZE // SIDE
    moments = np.ones((side, MOMENTS + 1, side))
    moments[:, 10] = SIDE * SIDE
    return Cells(
        grid=np.arange(count, dtype=np.int32).reshape(side, side),
        moments=moments,
        rows=rows,
        whole=np.zeros(count, np.bool_),
        squares=np.full((side // 2, side // 2), -1, np.int32),
        drift=np.full(count, 1e-7),
        told_drift=np.full(count, 1e-7),
        offset_prior=np.ones(count),
        slope_prior=np.ones(count),
        error=FrameError(),
    )


if __name__ == "__main__":
    gc.disable()  # a short life
    later_stages()
    confirm()
