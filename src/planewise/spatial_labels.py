"""Labels of the spatial search: pixels near borders, planes once more, lines where planes meet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.cells import Cells
from planewise.frame import Frame
from planewise.kernels import labels as label_loops
from planewise.kernels.cells import SIDE, UNIT
from planewise.observation import RayObservation

Array = NDArray[np.float64]
Labels = NDArray[np.int32]

_DIFFERING = 1.0  # nats per neighbouring pixel with another label
_PIXEL_DRIFT = 1.5  # of the drift over 100 pixels: how far a reading may lie from its plane
_SWEEPS = 6
_CREASE_REACH = 5  # pixels beside a border where the two planes are compared
_CREASE_BAND = 4  # pixels about a border that are looked at
_CREASE_SIGMA = 0.05  # pixels by which a border may leave the line of intersection
_CREASE_HIDDEN = 4.0  # standard deviations within which two planes cannot be told apart
_CREASE_FAR = 8.0  # pixels from the line of intersection
_FEWEST_PURE = 4  # cells wholly inside a label that are needed to refit its plane
_FEWEST_PAIRS = 10  # of cells side by side that tell how white a plane's residuals are


def affine_planes(rows: Array) -> Array:
    """(t0, t1, t2) of w = t0 + t1 x + t2 y: the plane of every segment row."""
    matrix = rows[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    scale = 1.0 / np.sqrt(np.einsum("nii->ni", matrix))
    scaled = matrix * scale[:, :, None] * scale[:, None, :]
    return np.asarray(scale * np.linalg.solve(scaled, (rows[:, 6:9] * scale)[..., None])[..., 0])


def label_planes(
    frame: Frame,
    cells: Cells,
    root: NDArray[np.int32],
    accepted: NDArray[np.int64],
    planes: Array,
    owner: NDArray[np.int64],
    observation: RayObservation,
) -> tuple[Array, Labels]:
    """Give every pixel near a border its label, refit the planes, put creases in their place.

    Returns the rows of the refitted planes and the labels.
    """
    height, width = frame.w.shape
    number = np.zeros(len(cells.rows) + 1, np.int32)
    number[accepted] = owner + 1
    coarse = np.where(cells.grid >= 0, number[root[cells.grid]], 0).astype(np.int32)
    labels = np.repeat(np.repeat(coarse, SIDE, 0), SIDE, 1)[:height, :width].copy()
    labels[frame.p == 0] = 0
    affine = np.vstack((np.zeros((1, 3)), affine_planes(planes)))
    error = cells.error
    table = frame.table
    by_depth = error.near * (table.shared + table.step) + _PIXEL_DRIFT * error.drift * table.drift
    slow = np.zeros(frame.w.shape)
    row = np.rint(table.per_metre / frame.w[frame.p > 0]).astype(np.intp)
    slow[frame.p > 0] = by_depth[np.minimum(row, by_depth.size - 1)]
    null = float(np.log(observation.range / observation.resolution))
    arguments = (frame.p / error.white, frame.x, frame.y, slow)
    label_loops.label_pixels(
        labels,
        _settled(coarse),
        SIDE,
        frame.w,
        *arguments,
        affine,
        _lateral(cells, affine),
        null,
        _DIFFERING,
        _SWEEPS,
    )
    planes = _refit(cells, _units_inside(cells, labels), planes)
    affine = np.vstack((np.zeros((1, 3)), affine_planes(planes)))
    kinds = np.zeros((len(affine), len(affine)), np.int8)
    label_loops.crease_kinds(labels, affine, frame.p, frame.x, frame.y, _CREASE_REACH, kinds)
    if kinds.any():
        offset = np.empty((len(affine), len(affine)))
        label_loops.crease_offsets(
            labels,
            affine,
            kinds,
            frame.w,
            *arguments,
            _lateral(cells, affine),
            UNIT,
            _CREASE_BAND,
            _CREASE_SIGMA,
            offset,
        )
        band = np.empty(labels.shape, np.bool_)
        label_loops.crease_band(labels, kinds, _CREASE_BAND, band)
        label_loops.snap_creases(
            labels,
            band,
            affine,
            kinds,
            offset,
            *arguments,
            UNIT,
            _CREASE_HIDDEN,
            _CREASE_FAR,
            2 * _CREASE_BAND,
        )
    return planes, labels


def _settled(coarse: Labels) -> NDArray[np.bool_]:
    """Cells on a plane whose neighbours are on it too: their pixels need no look."""
    padded = np.pad(coarse, 1, mode="edge")
    rows, columns = coarse.shape
    same = coarse > 0
    for i in range(3):
        for j in range(3):
            same &= padded[i : i + rows, j : j + columns] == coarse
    return same


def _lateral(cells: Cells, affine: Array) -> Array:
    """Variance of w by an error of half a pixel across the image, for every plane."""
    slope = affine[:, 1] ** 2 + affine[:, 2] ** 2
    return np.asarray(cells.error.lateral / UNIT**2 * slope)


def _units_inside(cells: Cells, labels: Labels) -> NDArray[np.int32]:
    """Label of every unit that lies wholly inside one, 0 of the others."""
    inside = np.empty(len(cells.rows), np.int32)
    label_loops.units_inside(labels, cells.grid.reshape(-1), SIDE, cells.grid.shape[1], inside)
    return inside


def _refit(cells: Cells, of_unit: NDArray[np.int32], planes: Array) -> Array:
    """Rows of the planes once more, from the units that lie wholly inside their label."""
    sums = np.zeros((len(planes) + 1, cells.rows.shape[1]))
    np.add.at(sums, of_unit, cells.rows)
    enough = np.bincount(of_unit, minlength=len(planes) + 1)[1:] >= _FEWEST_PURE
    return np.where(enough[:, None], sums[1:], planes)


def residual_correlation(cells: Cells, labels: Labels, affine: Array) -> Array:
    """Correlation of the residuals of cells side by side on every plane, shape (N,).

    Residuals are those of mean inverse depth in standard deviations of the cell's own error. Where
    the surface is a plane and the error white it is about 0; a surface that bends, or an error that
    drifts, brings it towards 1. NaN with fewer than ten pairs of cells.
    """
    of_unit = _units_inside(cells, labels)
    t = np.vstack((np.zeros((1, 3)), affine))[of_unit]
    m = cells.rows
    off = m[:, 6] - t[:, 0] * m[:, 0] - t[:, 1] * m[:, 1] - t[:, 2] * m[:, 2]
    off /= np.sqrt(m[:, 0])
    together, apart = np.zeros(len(affine) + 1), np.zeros(len(affine) + 1)
    pairs = np.zeros(len(affine) + 1)
    for cells_in_rows in (cells.grid, cells.grid.T):
        a, b = cells_in_rows[:, :-1].reshape(-1), cells_in_rows[:, 1:].reshape(-1)
        side = (a >= 0) & (b >= 0) & (a != b)
        a, b = a[side], b[side]
        label = of_unit[a]
        on = (label > 0) & (label == of_unit[b])
        a, b, label = a[on], b[on], label[on]
        together += np.bincount(label, off[a] * off[b], len(together))
        apart += np.bincount(label, 0.5 * (off[a] ** 2 + off[b] ** 2), len(together))
        pairs += np.bincount(label, minlength=len(together))
    told = (pairs >= _FEWEST_PAIRS) & (apart > 0)
    return np.asarray(np.divide(together, apart, np.full(told.shape, np.nan), where=told)[1:])
