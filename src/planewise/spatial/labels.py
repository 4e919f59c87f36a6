"""Labels of the spatial search: pixels near borders, planes once more, lines where planes meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import creases as crease_loops
from planewise.kernels import faces as face_loops
from planewise.kernels import frame_error as error_loops
from planewise.kernels import labels as label_loops
from planewise.kernels.cells import COUNT, SIDE, UNIT
from planewise.observation import RayObservation
from planewise.runtime import threads
from planewise.runtime.workspace import Workspace
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells
from planewise.spatial.faces import ROUGH, LabelPixels, may_be_two, misfits_of, parted
from planewise.spatial.folds import are_folds, may_be_strips
from planewise.spatial.frame import Frame, Image
from planewise.spatial.marks import Marks
from planewise.spatial.segments import kept_planes, planes_by_label, with_none
from planewise.spatial.units import planes_of_units, sector_of_units

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]

_DIFFERING = 1.6  # nats per neighbouring pixel with another label
_PIXEL_DRIFT = 1.5  # of the drift over 100 pixels: how far a reading may lie from its plane
_SWEEPS = 6
_CREASE_REACH = 15  # pixels beside a border where the two planes are compared
_CREASE_BAND = 4  # pixels about a border whose readings say where it lies
_CREASE_SIGMA = 0.05  # pixels by which a border may leave the line of intersection
_CREASE_APART = 50.0  # nats by which readings have to speak against that line for it to be none
_CREASE_ROOM = 16  # pixels that may change sides together, times rows and columns
_CREASE_STEP = 8  # rows and columns between pixels that may lie beyond it and touch no border
_CREASE_PRICE = 2.4  # nats per pixel of a border elsewhere
_OWN = 0.05  # of a plane's readings: what lies in cells wholly inside its label, at least ...
_STRIP = 2.0 * SIDE  # ... or it is no wider than so many pixels, and none


def label_planes(
    frame: Frame,
    cells: Cells,
    root: NDArray[np.int32],
    accepted: NDArray[np.int64],
    planes: Array,
    owner: NDArray[np.int64],
    observation: RayObservation,
    workspace: Workspace | None = None,
    price: float | None = None,
    significance: float = 0.0,
) -> tuple[Array, Labels, Array, NDArray[np.int64]]:
    """Give every pixel near a border its label, refit the planes, put creases in their place.

    A strip that is left next to no units of its own is no plane, but cells across an edge, whose
    pixels are those of the planes on either side; nor is one of something that bends.

    Parameters
    ----------
    frame, cells
        The readings.
    root : ndarray of int, shape (units,)
        Segment of every unit.
    accepted, owner : ndarray of int
        Segments that are part of a plane, and its row in `planes`, -1 for none.
    planes : ndarray, shape (K, N, 13)
        Rows of segments (`kernels.cells`) in the coordinates of every sector.
    observation : RayObservation
        For range and resolution.
    workspace : Workspace, optional
        Memory to work in; the labels returned are part of it.
    price, significance : float, optional
        Nats that a plane takes, and has to save beyond, where those that are two faces are parted,
        and strips of what bends left out.

    Returns
    -------
    planes : ndarray, shape (N K, 13)
        Rows of the refitted planes, those of one plane in all sectors together.
    labels : ndarray of uint16, shape (H, W')
        In sectors: 0 for none, j for row j - 1.
    saved : ndarray
        Nats that each of the last planes saves: those that were parted from others.
    owner : ndarray of int
        As it was given, of the planes that are left.
    """
    workspace = workspace or Workspace()
    labels: Labels = workspace.kept(frame.w.shape, np.uint16)
    null = float(np.log(observation.range / observation.resolution))
    variance, saved = _variances(frame, cells, workspace), np.empty(0)
    white = cells.error.white
    while True:
        marks = Marks.of(frame.w.shape, workspace)
        number = _numbers(cells, root, accepted, owner, frame.sectors)
        rows = planes.transpose(1, 0, 2).reshape(-1, planes.shape[2])
        _label_pixels(frame, cells, number, rows, variance, null, marks, workspace)
        label_loops.without_margin(marks.label, labels)
        rows, own = planes_of_units(frame, cells, labels, rows)
        left = own > _OWN * planes[0, :, COUNT]
        for j in (~left).nonzero()[0].tolist():
            left[j] = not _is_strip(labels, j, frame.sectors.count)
        if price is not None and left.all():
            misfits = misfits_of(frame, white, rows, labels)
            two = may_be_two(white, misfits, price, significance)
            strips = may_be_strips(rows)
            pixels = LabelPixels.of(labels, two | strips, misfits[:, 1], workspace)
            left = ~are_folds(frame, white, rows, labels, pixels.only(strips))
        if left.all():
            break
        planes, owner = kept_planes(planes, owner, left.nonzero()[0])
    if price is not None:
        rows, saved, changed = parted(
            frame, white, rows, labels, pixels.only(two), price, significance
        )
        if len(saved):
            _look_again(frame, cells, rows, variance, null, marks, labels, changed)
            label_loops.without_margin(marks.label, labels)
    if _put_creases(frame, cells, rows, variance, marks, labels, workspace):
        label_loops.without_margin(marks.label, labels)
    return rows, labels, saved, owner


def _is_strip(labels: Labels, plane: int, sectors: int) -> bool:
    """Whether the pixels of a plane are at most two cells wide in one direction."""
    mine = np.flatnonzero((labels > plane * sectors) & (labels <= (plane + 1) * sectors))
    if mine.size < 2:
        return True
    spread = np.linalg.eigvalsh(np.cov(np.divmod(mine, labels.shape[1]), bias=True))
    return bool(12.0 * spread[0] < _STRIP * _STRIP)  # that of a rectangle


def _numbers(
    cells: Cells,
    root: NDArray[np.int32],
    accepted: NDArray[np.int64],
    owner: NDArray[np.int64],
    sectors: Sectors,
) -> NDArray[np.int16]:
    """Label of every unit, from its segment's plane."""
    segment = np.zeros(len(cells.rows), np.int16)
    segment[accepted] = owner + 1
    number = segment.take(root)
    if sectors.count > 1:
        number = (number > 0) * ((number - 1) * sectors.count + 1 + sector_of_units(cells, sectors))
        number = number.astype(np.int16)
    return number


def _label_pixels(
    frame: Frame,
    cells: Cells,
    number: NDArray[np.int16],
    planes: Array,
    variance: Array,
    null: float,
    marks: Marks,
    workspace: Workspace,
) -> None:
    """Labels of pixels, from those of units, `number`."""
    rows, columns = cells.grid.shape
    coarse = workspace.empty((rows + 2, columns + 2), np.int16)
    apart = workspace.empty((rows, columns), np.bool_)
    affine = planes_by_label(planes)
    bound = cells.error.white * null  # a pixel that costs less among its own kind needs no look
    x, y = frame.sectors.coordinates

    def lay_out(first: int, last: int) -> None:
        label_loops.lay_out(
            cells.grid, number, cells.count, frame.p, first, last, coarse, apart,
            marks.label, marks.state,
        )  # fmt: skip
        label_loops.find_waiting(
            coarse, apart, frame.w, frame.p, x, y, affine, bound, first, last,
            marks.state, marks.busy,
        )  # fmt: skip

    threads.halves(lay_out, rows)
    marks.show_beyond(frame.sectors)
    marks.seen[:] = marks.busy
    _sweep(frame, cells, marks, frame.w, x, y, affine, variance, null)
    marks.hide_beyond(frame.sectors)


def _look_again(
    frame: Frame,
    cells: Cells,
    planes: Array,
    variance: Array,
    null: float,
    marks: Marks,
    labels: Labels,
    pixels: NDArray[np.int32],
) -> None:
    """Label pixels of second faces once more, and those without a plane about them."""
    mine = np.zeros(len(planes) + 1, np.bool_)
    mine[labels.reshape(-1)[pixels]] = mine[0] = True
    before, marks = marks.seen, replace(marks, seen=np.zeros_like(marks.seen))
    face_loops.wait_about(pixels, labels, mine, marks.label, marks.state, marks.busy, marks.seen)
    affine, coordinates = planes_by_label(planes), frame.sectors.coordinates
    _sweep(frame, cells, marks, frame.w, *coordinates, affine, variance, null)
    mine[0] = False
    face_loops.give_back(
        labels, marks.label, marks.seen, mine, frame.w, frame.p, *coordinates,
        ROUGH * cells.error.white,
    )  # fmt: skip
    before |= marks.seen


def _sweep(
    frame: Frame,
    cells: Cells,
    marks: Marks,
    w: Image,
    x: Image,
    y: Image,
    affine: Array,
    variance: Array,
    null: float,
) -> None:
    """Label the pixels that wait in `marks`, of a part w, x, y of the frame or all of it."""
    label_loops.label_pixels(
        marks.label.reshape(-1),
        marks.state.reshape(-1),
        marks.busy.reshape(-1),
        marks.seen.reshape(-1),
        marks.label.shape[1],
        w.reshape(-1),
        x.reshape(-1),
        y.reshape(-1),
        w.shape[1],
        variance,
        frame.table.ranging,
        affine,
        _lateral(cells, affine),
        null,
        _DIFFERING,
        _SWEEPS,
    )


def _borders(marks: Marks, workspace: Workspace) -> NDArray[np.int32]:
    """Pixels beside a border, as `kernels.creases.find_borders` writes them."""
    most = 2 * label_loops.CHUNK * int(np.count_nonzero(marks.seen))
    borders: NDArray[np.int32] = workspace.empty((most, 3), np.int32)
    flat = marks.label.reshape(-1), marks.seen.reshape(-1)
    return borders[: crease_loops.find_borders(*flat, marks.label.shape[1], borders)]


def _put_creases(
    frame: Frame,
    cells: Cells,
    planes: Array,
    variance: Array,
    marks: Marks,
    labels: Labels,
    workspace: Workspace,
) -> bool:
    """Move borders to where planes intersect, in `marks` only; whether there is such a place."""
    borders = _borders(marks, workspace)
    affine = planes_by_label(planes)
    crease = np.empty((len(affine), len(affine)), np.int32)
    lines = np.empty((len(affine) * len(planes) // 2, 3))
    coordinates, ranging = frame.sectors.coordinates, frame.table.ranging
    lateral = _lateral(cells, affine)
    found = crease_loops.find_creases(
        borders, labels, affine, *coordinates, _CREASE_REACH, UNIT, crease, lines
    )
    if not found:
        return False
    offset = np.empty(found)
    crease_loops.crease_offsets(
        borders,
        labels,
        crease,
        lines,
        affine,
        frame.w,
        *coordinates,
        variance,
        ranging,
        lateral,
        _CREASE_BAND,
        _CREASE_SIGMA,
        _CREASE_APART,
        offset,
    )
    marks.state[:] = 0
    strays = workspace.empty((2 * len(borders) + labels.size // _CREASE_STEP**2, 3), np.int32)
    straying = crease_loops.find_strays(
        borders, labels, crease, lines, offset, *coordinates, _CREASE_STEP, strays
    )
    crease_loops.put_creases(
        strays[:straying],
        marks.label,
        crease,
        lines,
        offset,
        affine,
        lateral,
        frame.w,
        *coordinates,
        variance,
        ranging,
        _CREASE_PRICE,
        _CREASE_APART,
        marks.state,
        workspace.empty((_CREASE_ROOM * sum(frame.w.shape), 2), np.int32),
    )
    return True


def misfits(
    frame: Frame, cells: Cells, affine: Array, label: NDArray[np.integer], pixels: NDArray[np.intp]
) -> Array:
    """Half the squared residual in variances of pixels of such a label; infinite on no plane."""
    w, x, y = (image.reshape(-1)[pixels] for image in (frame.w, frame.x, frame.y))
    by_depth = _variances(frame, cells)
    planes = with_none(affine)
    t, lateral = planes[label], _lateral(cells, planes)[label]
    stretch = frame.sectors.squared_stretch(x, y)
    with np.errstate(divide="ignore"):
        row = frame.table.ranging[0] / w * np.sqrt(stretch) + 0.5
    row = np.minimum(row, by_depth.size - 1).astype(np.intp)
    residual = w - t[:, 0] - t[:, 1] * x - t[:, 2] * y
    out = 0.5 * residual**2 / (stretch * by_depth[row] + lateral)
    return np.where((label > 0) & (w > 0), out, np.inf)


def relabelled(
    frame: Frame,
    cells: Cells,
    affine: Array,
    labels: Labels,
    inside: NDArray[np.int64],
    null: float,
    reach: int,
) -> Labels:
    """Labels after sweeps over some pixels, and over those about them that change.

    Parameters
    ----------
    frame, cells
        The readings.
    affine : ndarray, shape (N, 3)
        (t0, t1, t2) of w = t0 + t1 x + t2 y.
    labels : ndarray of uint16, shape (H, W)
        0 for none, j for row j - 1.
    inside : ndarray of int
        Pixels, as places in the flattened image.
    null : float
        Nats of a reading on none.
    reach : int
        Pixels about the rectangle of `inside` where labels may change.
    """
    height, width = labels.shape
    rows, columns = np.divmod(inside, width)
    top, left = max(0, rows.min() - reach), max(0, columns.min() - reach)
    bottom, right = min(height, rows.max() + reach + 1), min(width, columns.max() + reach + 1)
    box = np.s_[top:bottom, left:right]
    w, x, y = (np.ascontiguousarray(image[box]) for image in (frame.w, frame.x, frame.y))
    there = frame.p[box] > 0
    marks = Marks.of(w.shape, Workspace())
    marks.label[:], marks.state[:] = label_loops.NONE, label_loops.FIXED
    marks.busy[:], marks.seen[:] = True, False
    inner = np.s_[1 : w.shape[0] + 1, 1 : w.shape[1] + 1]
    marks.label[inner] = np.where(there, labels[box], label_loops.NONE)
    state = np.where(there, np.uint8(0), label_loops.FIXED)
    state[rows - top, columns - left] = label_loops.WAITING
    for edge, end in ((0, top > 0), (-1, bottom < height)):
        state[edge] = label_loops.FIXED if end else state[edge]
    for edge, end in ((0, left > 0), (-1, right < width)):
        state[:, edge] = label_loops.FIXED if end else state[:, edge]
    marks.state[inner] = state
    variance = _variances(frame, cells)
    _sweep(frame, cells, marks, w, x, y, with_none(affine), variance, null)
    out = labels.copy()
    label_loops.without_margin(marks.label, out[box])
    return out


def _variances(frame: Frame, cells: Cells, workspace: Workspace | None = None) -> Array:
    """Variance of a reading about its plane by depth, shape (L,)."""
    table, error = frame.table, cells.error
    drift = error.local if error.walk else 0.0  # not what a frame shows of it by chance
    variance: Array = (workspace or Workspace()).empty(table.white.size)
    sizes = error.white, error.near, _PIXEL_DRIFT * drift
    error_loops.reading_variances(
        table.white, table.shared, table.drift, table.step, sizes, variance
    )
    return variance


def _lateral(cells: Cells, affine: Array) -> Array:
    """Variance of w by the error across the image (`FrameError.lateral`), for every plane."""
    slope = affine[:, 1] ** 2 + affine[:, 2] ** 2
    return np.asarray(cells.error.lateral / UNIT**2 * slope)
