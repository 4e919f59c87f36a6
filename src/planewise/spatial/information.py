"""Phi under the spatial objective: a code length for any planes and labels of a depth image.

    Phi = mask + N * 3 ln(R / eps) + sum over groups of their data

A group is the readings of one label in one block of 9 x 9 pixels, 3 x 3 of the finest cells. Its
data are normal with the white variance of each reading, times a power of two that is the group's
own (`kernels.group_data`), chi^2 not below what undithered quantisation makes of it, and

- on a plane, with a random offset and tilt that the whole group shares: the marginal likelihood
  with these integrated out, their variances those at the group's mean inverse depth and, where
  the error drifts, times 4^k, k = 0 ... 3, which is the plane's own and takes (k + 1) ln 2 nats,
- on none, on a smooth surface whose depth there takes ln(R / eps) nats and whose slopes are drawn
  from a broad prior,
- in either case anything at all where that is shorter, ln(R / eps) nats a reading; ln 2 says which.

Readings that were set aside as wild take ln(R / eps) nats each and which they are, on any planes.

A group labelled with a plane is a smooth surface of its own with probability 1/20: books on a table
may be labelled as the table, which costs nats, but not without bound.

Both are closed forms of the group's moments. The mask is the adaptive code of `spatial.mask_code`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planewise.information import coordinate_information, plane_information
from planewise.kernels import cells as kernels
from planewise.kernels import group_data as loops
from planewise.kernels import groups as tiles
from planewise.kernels.frame_error import TILT
from planewise.kernels.walk import PLANE_BEND, PLANE_RESIDUAL
from planewise.observation import RayObservation
from planewise.runtime.workspace import Workspace
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells, cells_of, moments_of
from planewise.spatial.frame import Frame
from planewise.spatial.frame_error import FrameError
from planewise.spatial.mask_code import MaskCounts
from planewise.spatial.tame_frame import tame_frame

Array = NDArray[np.float64]

_SURFACE = 1.0  # times ln(R / eps): what the depth of a smooth surface takes
_FEW = 4  # groups of a block with several, as a rule
_LEVELS = 4  # of what the groups of a plane share
_DRIFTING = 0.5  # of frames whose planes have several
_LN2 = math.log(2)
MOST_LABELS = np.iinfo(np.uint16).max - 1  # the last one stands for no reading (`kernels`)


@dataclass(frozen=True)
class Ledger:
    """What a model costs.

    Attributes
    ----------
    order : ndarray of int, shape (N,)
        Planes, best first: by worth, unless told otherwise.
    worth, saved : ndarray, shape (N,)
        Nats by which each plane's readings, in this order, are shorter on it than on none, and than
        if each of them might be anything at all; negative.
    curve : ndarray, shape (N + 1,)
        Phi in nats if only the first 0 ... N planes in this order were there and the readings of
        the others on none; the last is Phi of the model.
    """

    order: NDArray[np.intp]
    worth: Array
    saved: Array
    curve: Array


@dataclass(frozen=True)
class GroupData:
    """What groups take in nats.

    Attributes
    ----------
    total : float
        All of them.
    worth, even, saved : ndarray, shape (N,)
        By plane: what its groups take on it less what on none, as it is and if k were 0 for all
        planes, and less what as anything at all.
    leaving : ndarray, shape (N K + 1,)
        By label: what groups in blocks with that label alone take more without it.
    """

    total: float
    worth: Array
    even: Array
    saved: Array
    leaving: Array

    def copy(self) -> GroupData:
        """One more of the same, to be used up."""
        return replace(self, leaving=self.leaving.copy())


@dataclass(frozen=True)
class Groups:
    """Groups of a frame under some labels, and what their data depend on besides planes.

    Attributes
    ----------
    moments, label, first
        As `kernels.groups` writes them.
    readings : ndarray of int, shape (N K + 1,)
        Of every label.
    sectors : Sectors
        Labels are those of planes in sectors.
    table : tuple
        Variances by depth (shared, step, drift), and `ErrorTable.ranging`.
    sizes : tuple of float
        Factors of the variances of a group's offset and tilt, and more (`kernels.group_data`).
    prior : tuple of float
        Of groups on none.
    distorted : float
        Readings of a plane whose drift is twice as large, as in `FrameError`.
    wild : float
        Nats of readings that are in no group, as in `Frame`.
    levels : int
        Of what the groups of a plane share, in Phi.
    nats : ndarray, shape (2 + levels, groups)
        Room for the nats of every group on none, for the precision of its readings, times the
        frame's, and for its nats as labelled, of every level.
    """

    moments: Array
    label: NDArray[np.uint16]
    first: NDArray[np.int32]
    readings: NDArray[np.int64]
    sectors: Sectors
    table: tuple[Array, Array, Array, tuple[float, float, float]]
    sizes: tuple[float, ...]
    prior: tuple[float, ...]
    distorted: float
    wild: float
    levels: int
    nats: Array

    def planes(self, affine: Array) -> Array:
        """Planes by label as `kernels.group_data` takes them, shape (5, N K + 1)."""
        by_label = np.empty((5, len(affine) + 1))
        by_label[:3, 0] = 0.0
        by_label[:3, 1:] = affine.T
        by_label[3:] = self._widths
        return by_label

    @cached_property
    def _widths(self) -> Array:
        """By label: the last rows of `planes`, which they all share."""
        widths = np.zeros((2, len(self.readings)))
        count = self.sectors.repeated(self.sectors.summed(self.readings[1:]))
        widths[1, 1:] = np.sqrt(count) / kernels.UNIT
        widths[0, 1:] = widths[1, 1:] * (1.0 + count / self.distorted)
        return widths

    def data(self, affine: Array, levels: int = 1) -> GroupData:
        """What the groups take on planes, shape (N K, 3); overwrites `nats`.

        levels: of what the groups of a plane share, the best one for each.
        """
        saved, leaving = np.zeros((2, len(affine) + 1))
        shared, step, drift, ranging = self.table
        alone, white, data = self.nats[0], self.nats[1], self.nats[2 : 2 + levels]
        worth = np.zeros((levels, len(saved)))
        total = loops.group_data(
            self.moments, self.label, self.first, self.planes(affine), shared, step, drift,
            ranging, self.sizes, self.prior, alone, white, data, worth, saved, leaving,
        )  # fmt: skip
        even = best = worth[0]
        if levels > 1:
            told = np.zeros_like(worth)  # the probability of a level is 2^-(k + 1)
            told[:, 1:] = _LN2 * np.arange(1, levels + 1)[:, None]
            taken = worth + told
            level = taken.argmin(axis=0)
            best, told = taken.min(axis=0), told[level, np.arange(len(level))]
            label, blocks = self.label[: self.first[-1]], self.first[0]
            more = data[level[label], np.arange(len(label))] - data[0, : len(label)]
            data[0, : len(label)] += more
            total += more.sum() + told.sum()
            saved += np.bincount(label, more, len(saved)) + told
            leaving -= np.bincount(label[:blocks], more[:blocks], len(saved)) + told
        by_plane = self.sectors.summed
        return GroupData(
            float(total), by_plane(best[1:]), by_plane(even[1:]), by_plane(saved[1:]), leaving
        )


def ledger(
    frame: Frame,
    cells: Cells | None,
    affine: Array,
    labels: NDArray[np.integer],
    range: float,
    resolution: float,
    pixel_size: tuple[float, float],
    workspace: Workspace | None = None,
    order: NDArray[np.intp] | None = None,
) -> Ledger:
    """Rank planes, with exact Phi of them all and of every shorter list of the best.

    Parameters
    ----------
    frame : Frame
        The readings.
    cells : Cells, optional
        Of the frame; ``None`` if no cell has a plane.
    affine : ndarray, shape (N K, 3)
        (t0, t1, t2) of w = t0 + t1 x + t2 y, of every plane in every sector.
    labels : ndarray of int, shape (H, W')
        In sectors: 0 for none, j for row j - 1.
    range, resolution : float
        R and eps in metres.
    pixel_size : (float, float)
        Of a pixel on the plane z = 1, in metres.
    workspace : Workspace, optional
        Memory to work in.
    order : ndarray of int, shape (N,), optional
        Best first; by worth unless given.

    Returns
    -------
    Ledger
    """
    mask = np.ascontiguousarray(labels, np.uint16)
    groups = groups_of(frame, cells, mask, len(affine), range, resolution, pixel_size, workspace)
    data = groups.data(affine, groups.levels)
    return book_of(groups, data, mask_of(frame, mask), range, resolution, order)


def information_of_rows(
    observation: RayObservation, rows: Array, marks: NDArray[np.integer]
) -> float:
    """Phi of planes (normal, distance), shape (N, 4), and of the label of every reading, (k,).

    Raises
    ------
    ValueError
        If a plane passes through the sensor, where no ray meets it, or there are too many.
    """
    if not rows[:, 3].all():
        raise ValueError("planes: one passes through the sensor, which sees nothing of it")
    frame = tame_frame(observation)
    sectors, size = frame.sectors, observation.pixel_size
    if len(rows) * sectors.count > MOST_LABELS:
        raise ValueError(f"planes: at most {MOST_LABELS // sectors.count} are told apart")
    image = np.zeros(observation.shape, np.int64)
    image.reshape(-1)[observation.index] = marks
    affine = sectors.affine(-rows[:, :3] / rows[:, 3:])
    labels = sectors.labels(image).astype(np.uint16)
    limits, cells = (observation.range, observation.resolution), cells_of(frame, size)
    either = (None,) if cells is None else cells.by_error
    return min(
        float(ledger(frame, each, affine, labels, *limits, size).curve[-1]) for each in either
    )


def book_of(
    groups: Groups,
    data: GroupData,
    mask: MaskCounts,
    range: float,
    resolution: float,
    order: NDArray[np.intp] | None = None,
) -> Ledger:
    """`ledger` of what the groups took last, in any order; uses the data up.

    mask: `mask_of` the same labels.
    """
    worth, saved, leaving, sectors = data.worth, data.saved, data.leaving, groups.sectors
    planes = len(worth)
    if order is None:
        order = np.argsort(worth, kind="stable")
    place = sectors.places(order, planes)
    _, step, _, ranging = groups.table
    loops.groups_left(
        groups.moments, groups.label, groups.first, place, step, ranging, groups.prior,
        groups.nats[2], leaving,
    )  # fmt: skip
    curve = np.full(planes + 1, data.total + groups.wild)
    # Planes are taken away from the last on.
    curve[:planes] += sectors.summed(leaving[1:])[order][::-1].cumsum()[::-1]
    curve += np.arange(planes + 1) * plane_information(3, range, resolution)
    curve += mask.lengths(groups.readings, place)[: planes + 1]
    return Ledger(order=order, worth=worth[order], saved=saved[order], curve=curve)


class Blocks:
    """Moments of square blocks of cells whose readings share an offset and a tilt, all labels.

    Parameters
    ----------
    frame, cells
        As `ledger` takes them.
    resolution : float
        eps in metres.
    workspace : Workspace
        Memory that they last in.

    Attributes
    ----------
    moments : ndarray, shape (12, blocks)
        As `kernels.groups.correct_tiles` writes them, once `add_up` was called.
    factor : ndarray, shape (blocks,)
        What w was multiplied by: what noise adds to weighted means is taken off.
    finer : ndarray, shape (blocks,) or empty
        Where readings are ranges, r = z / c, a step of eps is one of c eps in z, c that of the
        block's mean direction: -ln c, which was added to the norm of every reading.
    white, constant : float
        As `kernels.groups.sum_groups` takes them.
    """

    def __init__(
        self, frame: Frame, cells: Cells | None, resolution: float, workspace: Workspace
    ) -> None:
        self._frame, self._error = frame, FrameError() if cells is None else cells.error
        self._tiles = moments_of(frame, workspace).tiles if cells is None else cells.tiles
        count = self._tiles.shape[0] * self._tiles.shape[2]
        self.moments: Array = workspace.kept((tiles.NORM + 1, count))
        self.factor, self.finer = np.empty(0), np.empty(0)
        self.white = self._error.white
        self.constant = float(np.log(2 * np.pi * self.white / resolution**2))

    def add_up(self) -> Blocks:
        """Write them, if they are not yet."""
        if self.factor.size:
            return self
        sectors = self._frame.sectors
        means = np.empty((3, self.moments.shape[1]))
        tiles.tile_means(self._tiles, means)
        depth = means[2]
        if sectors.ratio is not None:
            squared = sectors.squared_stretch(means[0], means[1])
            self.finer = 0.5 * np.log(squared)
            depth = depth / np.sqrt(squared)  # inverse range
        self.factor = 1.0 + self._error.seen * self._frame.table.noise_bias(depth)
        tiles.correct_tiles(
            self._tiles, self.white, self.constant, self.factor, self.finer, self.moments
        )
        return self


def mask_of(frame: Frame, labels: NDArray[np.uint16]) -> MaskCounts:
    """What the length of the mask depends on."""
    return MaskCounts.of(frame.sectors.image(labels), frame.sectors.image(frame.p))


def groups_of(
    frame: Frame,
    cells: Cells | None,
    labels: NDArray[np.uint16],
    planes: int,
    range: float,
    resolution: float,
    pixel_size: tuple[float, float],
    workspace: Workspace | None = None,
    blocks: Blocks | None = None,
) -> Groups:
    """Groups of a frame; arguments as of `ledger`, planes: the number of planes in sectors, N K.

    blocks: those of the frame, if they were made before.
    """
    workspace = workspace or Workspace()
    error = FrameError() if cells is None else cells.error
    blocks = (blocks or Blocks(frame, cells, resolution, workspace)).add_up()
    moments, label, first, readings = _groups(frame, blocks, labels, planes, workspace)
    # Random effects of groups: variances of what near readings share and of what drifts.
    sizes = (
        error.near,
        error.drift * PLANE_RESIDUAL,
        error.bent * TILT**2,
        error.drift * PLANE_BEND[0] / (tiles.BLOCK / kernels.UNIT),
        error.lateral,
        frame.sectors.lean,
    )
    coordinate = coordinate_information(range, resolution)
    # Of a surface about which nothing is known, inclined by about 1.
    slopes = kernels.UNIT**2 * pixel_size[0] * pixel_size[1]
    table = frame.table
    levels = _LEVELS if error.drifting > _DRIFTING and frame.sectors.count == 1 else 1
    return Groups(
        moments=moments,
        label=label,
        first=first,
        readings=readings,
        sectors=frame.sectors,
        table=(table.shared, table.step, table.drift, table.ranging),
        sizes=sizes,
        prior=(slopes, _SURFACE * coordinate, coordinate),
        distorted=error.distorted,
        wild=frame.wild,
        levels=levels,
        nats=workspace.empty((2 + levels, moments.shape[1])),
    )


def _groups(
    frame: Frame, blocks: Blocks, labels: NDArray[np.uint16], planes: int, workspace: Workspace
) -> tuple[Array, NDArray[np.uint16], NDArray[np.int32], NDArray[np.int64]]:
    """Moments and labels of groups, where those of each block with several begin, and readings.

    Corrections are the same in all a block, so Phi of fewer planes, whose groups are larger, is
    that of the same data.
    """
    rows, columns = (-(-n // tiles.BLOCK) for n in labels.shape)
    block = workspace.empty((rows, columns), np.int32)
    work = np.empty((6, tiles.BLOCK * columns), np.uint16)
    several = tiles.label_blocks(labels, frame.p, block, work)
    first, readings = np.empty(several + 1, np.int32), np.empty(planes + 1, np.int64)
    end, room = -1, block.size + _FEW * several
    while end < 0:
        # Most blocks with several labels have two or three: seldom is there need for more room.
        moments = workspace.empty((tiles.NORM + 1, room))
        moments[:, : block.size] = blocks.moments
        label = workspace.empty(room, np.uint16)
        end = tiles.sum_groups(
            labels, frame.w, frame.p, *frame.sectors.coordinates, block, blocks.white,
            blocks.constant, first, moments, label, readings,
        )  # fmt: skip
        room += tiles.BLOCK**2 * several
    tiles.correct_groups(moments, first, block, blocks.factor, blocks.finer)
    return moments, label, first, readings
