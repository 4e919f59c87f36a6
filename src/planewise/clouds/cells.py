"""Cells of a cloud: the smallest cubes whose points tell a plane, and the size of their error.

As in depth images, the cells themselves say how far points lie from planes (white noise) and how
far neighbouring cells disagree beyond it (drift): quantiles, for edges and clutter only add.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cloud import (
    FEWEST,
    FEWEST_TOLD,
    LEVELS,
    STEEPEST,
    Cloud,
    over_part,
    roughness_of,
)
from planewise.flatness import LEAN
from planewise.kernels import cloud_cells as kernels
from planewise.kernels import cloud_sheets as sheets
from planewise.kernels.cloud_rows import COUNT, ROW
from planewise.kernels.pairs import add_products, pairs_once
from planewise.kernels.walk import PLANE_RESIDUAL, SATURATION

Array = NDArray[np.float64]

HOPELESS = 4.0  # times the white variance: points farther from a plane have none
SHARED = 0.09  # of the white variance: what the points of a cell share, for cubes cut sheets
PRIOR = (4.0, 1.0)  # variances of a free plane: of its offset in areas of the cell, of its slopes
_WIDER = 5.0  # deviations: points of a scanner's line are as wide as thick, and tell no plane
_SHEET = 6.0  # standard deviations of a sheet that still fits into a cube
_GROWN = 2.0  # times the variance in cubes of half the side: that of a volume is four times
_DRIFTING, _CHI2_3 = 0.1, 0.5844  # share of the pairs that tells the drift; that quantile of chi^2
_SAMPLE = 2_000  # pairs
_BISECTIONS = 14
_BISECTED = (1e-4, 1e4)
_LEAST_BORDER = 10.0  # points along borders of cells that tell how white residuals are
_LEAST_DRIFT = 0.01  # of the white variance, over 16 cells
HIGHEST = 8  # levels above the least cubes at which cells are looked for
_LEAST_PART = 2_000  # cubes that are worth a thread
_THICKEST = 1.3  # variance of the points of a whole sheet, times the white one
_WIDEST = 2.0  # area of a whole sheet, times that of a side of a cube
_ABSORBED = 2  # times that loose cubes beside cells become part of them


@dataclass(frozen=True)
class CloudError:
    """Size of the error against its description.

    Attributes
    ----------
    white : float
        Variance of points about the planes of cells, at least 1.
    drift : float
        Of the error between cells, square metres a metre.
    lean : float
        Square of the angle by which pieces of one surface lean (`planewise.flatness`).
    sliced : bool
        Whether cubes cut many sheets (`Cloud.cuts_sheets`).
    """

    white: float
    drift: float
    lean: float = 0.0
    sliced: bool = False

    @property
    def wander(self) -> tuple[float, float]:
        """What makes pieces of one plane differ (`kernels.cloud_rows.compare`)."""
        return self.drift, self.lean

    @property
    def of_readings(self) -> CloudError:
        """Without what surfaces are bent by: between those that do not touch."""
        return replace(self, lean=0.0)

    def about_planes(self, areas: Array) -> Array:
        """Variance of points about the planes of squares, besides their own, in m^2."""
        side = np.sqrt(areas)
        return np.asarray(PLANE_RESIDUAL * (self.drift + self.lean * side) * side)

    def limits(self) -> tuple[float, float, float, float, float, tuple[float, float], float]:
        """What makes points a cell (`kernels.cloud_rows.make_plane`)."""
        # Slices of sheets are as thin as lines.
        wider = 0.0 if self.sliced else _WIDER
        return self.white, HOPELESS, STEEPEST, FEWEST, SHARED, PRIOR, wider


@dataclass(frozen=True)
class CloudCells:
    """Cells, and which of them touch.

    Attributes
    ----------
    rows : ndarray, shape (m, 18)
        As `kernels.cloud_rows` has them, in Morton order.
    keys : ndarray of uint64, shape (m,)
        Of the first cube of each.
    owner : ndarray of int, shape (n,)
        Cell that each cube of the cloud is part of, -1 for none.
    ends : ndarray of int, shape (e, 2)
        Pairs of cells side by side.
    sides : ndarray of float32, shape (e,)
        Points along their common border.
    error : CloudError
        Size of the error.
    """

    rows: Array
    keys: NDArray[np.uint64]
    owner: NDArray[np.int64]
    ends: NDArray[np.int32]
    sides: NDArray[np.float32]
    error: CloudError


class _Grown(NamedTuple):
    """As of `CloudCells`; level_of (m,): how many levels above the least cubes each cell is."""

    rows: Array
    keys: NDArray[np.uint64]
    level_of: NDArray[np.int64]
    owner: NDArray[np.int64]


def cells_of(cloud: Cloud) -> CloudCells | None:
    """Cells of a cloud; ``None`` if there is none."""
    nodes, keys = cloud.sample
    white = _white(cloud)
    drift = _drift(cloud, nodes, keys, white)
    least = _LEAST_DRIFT * white * float(np.median(cloud.variance)) / (16.0 * cloud.side)
    sliced = cloud.cuts_sheets(white)
    error = CloudError(white, max(SATURATION * drift, least), LEAN**2, sliced)

    cells = _grown(cloud, error)
    rows, owner = cells.rows, cells.owner
    if not len(rows):
        return None
    chosen = np.empty(len(owner), np.int64)
    for _ in range(_ABSORBED):
        cloud.over_cubes(
            lambda first, last: kernels.absorb(
                cloud.nodes, cloud.about, rows, white, owner, first, last, chosen
            )
        )
        taken = 0
        for first, last in cloud.runs():
            part = slice(first, last)
            taken += kernels.take_in(
                cloud.nodes[part], white, SHARED, chosen[part], rows, owner[part]
            )
        if not taken:
            break
    if sliced:
        cells = _whole_sheets(cloud, cells, error)
    return CloudCells(cells.rows, cells.keys, cells.owner, *_neighbours(cloud, cells), error)


def _whole_sheets(cloud: Cloud, cells: _Grown, error: CloudError) -> _Grown:
    """Cells with the slices that cubes cut of one sheet joined, those of few points first."""
    rows, memory, root = cells.rows, cloud.memory, np.empty(len(cells.rows), np.int64)
    sheets.join_slices(
        cloud.about, cloud.nodes, cells.owner, cells.level_of,
        np.argsort(rows[:, COUNT], kind="stable"), error.limits(), _THICKEST,
        _WIDEST * cloud.side**2, rows, memory.empty(rows.shape), root,
    )  # fmt: skip
    whole = root == np.arange(len(root))
    place = np.append(np.cumsum(whole)[root] - 1, -1)
    kept = memory.empty((int(np.count_nonzero(whole)), ROW))
    np.compress(whole, rows, axis=0, out=kept)
    return _Grown(kept, cells.keys[whole], cells.level_of[whole], place[cells.owner])


def _grown(cloud: Cloud, error: CloudError) -> _Grown:
    """Cells, as `kernels.grow_cells` finds them."""
    memory = cloud.memory
    rows, keys = memory.growing(np.float64, ROW), memory.growing(np.uint64)
    levels = memory.growing(np.int64)
    owner, cells = np.empty(len(cloud.cubes), np.int64), 0
    for first, last in cloud.runs():
        n, part = last - first, slice(first, last)
        out, spans = np.empty((n, ROW)), np.empty((n, 2), np.int64)
        level_of = np.empty(n, np.int64)
        nodes, states = _with_states(cloud.nodes[part], error, cloud.workers)
        found = kernels.grow_cells(
            nodes, states, cloud.cubes[part].copy(), HIGHEST, error.limits(),
            np.empty(n, np.int64), np.empty(n, np.int64), out, spans, level_of,
        )  # fmt: skip
        order = np.argsort(spans[:found, 0], kind="stable")
        kernels.owners(spans[order], cells, owner[part])
        rows.append(out[order])
        keys.append(cloud.cubes[part][spans[order, 0]])
        levels.append(level_of[order])
        cells += found
    return _Grown(rows.array(), keys.taken(), levels.taken(), owner)


def _with_states(nodes: Array, error: CloudError, workers: int) -> tuple[Array, NDArray[np.int8]]:
    """Copy of nodes, those of a plane as rows of it, and their states (`kernels.node_states`)."""
    nodes, states = nodes.copy(), np.empty(len(nodes), np.int8)
    over_part(
        lambda first, last: kernels.node_states(nodes, error.limits(), first, last, states),
        0, len(nodes), workers, _LEAST_PART,
    )  # fmt: skip
    return nodes, states


def _neighbours(cloud: Cloud, cells: _Grown) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """`CloudCells.ends` and `sides`."""
    all_ends, all_sides = cloud.memory.growing(np.int32, 2), cloud.memory.growing(np.float32)
    for run in cloud.runs():
        ends, sides = _neighbours_in(cloud, cells, *run)
        all_ends.append(ends)
        all_sides.append(sides)
    return all_ends.array(), all_sides.array()


def _neighbours_in(
    cloud: Cloud, cells: _Grown, begin: int, end: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The same of a run of cubes."""
    most = kernels.NEIGHBOURS
    ends = np.empty((most * (end - begin), 2), np.int32)
    sides = np.empty(len(ends), np.float32)
    parts: list[slice] = []

    def look(first: int, last: int) -> None:
        place = most * (first - begin)
        found = kernels.neighbours(
            cloud.cubes, cloud.about, cells.owner, cells.level_of, cloud.nodes, cells.rows,
            first, last, ends[place:], sides[place:],
        )  # fmt: skip
        parts.append(slice(place, place + found))

    over_part(look, begin, end, cloud.workers, _LEAST_PART)
    parts.sort(key=lambda part: part.start)
    ends = np.concatenate([ends[part] for part in parts])
    sides = np.concatenate([sides[part] for part in parts])
    found = pairs_once(ends, sides, len(cells.rows))
    return ends[:found].copy(), sides[:found].copy()


def as_loud_as_seen(made: Callable[[float], Cloud | None]) -> tuple[Cloud | None, float]:
    """Cloud of as many times the described deviation as its points have, and how many times.

    made: returns the cloud for so many times.
    """
    cloud = made(1.0)
    louder = 1.0 if cloud is None else times_louder(cloud)
    if louder > 1.0:
        del cloud  # before the next, for it may be as large as the disk
        cloud = made(louder)
    return cloud, louder


def times_louder(cloud: Cloud) -> float:
    """How many times the described deviation points have, where cubes are too small for that.

    Cubes that are thinner than the sheets in them show no planes. If sheets fit into cubes of twice
    the side, and are hardly thicker there, as volumes would be, these say it; else the description
    stands.
    """
    told = cloud.roughness
    if told is None or _fits(cloud, told, cloud.side):
        return 1.0
    nodes, keys = cloud.sample
    parents, above = np.empty_like(nodes), np.empty_like(keys)
    found = kernels.parents_of(nodes, keys, parents, above)
    larger = roughness_of(parents[:found], cloud.workers)
    if larger is None or larger > _GROWN * told:
        return 1.0
    return max(1.0, math.sqrt(larger)) if _fits(cloud, larger, 2.0 * cloud.side) else 1.0


def _white(cloud: Cloud) -> float:
    """White variance against the description: the quietest quarter of the cells says it.

    Of points that fill their cubes it says nothing: where there are no sheets, the description
    stands.
    """
    factor = max(1.0, cloud.roughness or 1.0)
    return factor if _fits(cloud, factor, cloud.side) else 1.0


def _fits(cloud: Cloud, white: float, side: float) -> bool:
    """Whether a sheet of so much variance, against the description, fits into cubes of a side."""
    return white * float(np.median(cloud.variance)) <= (side / _SHEET) ** 2


def _drift(cloud: Cloud, nodes: Array, keys: NDArray[np.uint64], white: float) -> float:
    """Drift of the error: from cubes side by side, of several sizes.

    The smallest of what they say counts: more is shape, or what a cube cuts off.
    """
    typical = white * float(np.median(cloud.variance))
    levels = [(nodes, keys)]
    while len(levels) < LEVELS:
        nodes, keys = levels[-1]
        parents, above = np.empty_like(nodes), np.empty_like(keys)
        found = kernels.parents_of(nodes, keys, parents, above)
        levels.append((parents[:found], above[:found]))
    told = math.inf
    for level in reversed(range(LEVELS)):
        # Large cubes come first: where they agree, no more has to be asked.
        nodes, keys = levels[level]
        planes, states = _with_states(nodes, CloudError(white, 0.0), cloud.workers)
        ends = np.empty((_SAMPLE, 2), np.int64)
        ends = ends[: kernels.sibling_pairs(states, keys, ends)]
        if len(ends) >= FEWEST_TOLD:
            told = min(told, _bisected(planes, ends, typical / (cloud.side * 2**level)))
        if told == 0.0:
            break
    return told if told < math.inf else 0.0


def _bisected(rows: Array, ends: NDArray[np.int64], unit: float) -> float:
    """Drift at which a quantile of the pairs' discords is that of chi^2, or 0.

    A low one, for edges go through many cubes, and one that so many pairs are sure of.
    """
    discords = np.empty(len(ends))
    unsure = 2.0 * math.sqrt(_DRIFTING * (1.0 - _DRIFTING) / len(ends))
    share = max(_DRIFTING - unsure, 0.0)
    low, high = _BISECTED
    for step in range(_BISECTIONS + 1):
        factor = math.sqrt(low * high) if step else 0.0
        kernels.pair_discords(rows, ends, (factor * unit, 0.0), discords)
        above = float(np.quantile(discords, share)) > _CHI2_3
        if not step and not above:
            return 0.0
        if step:
            low, high = (factor, high) if above else (low, factor)
    return math.sqrt(low * high) * unit


def residual_correlation(cells: CloudCells, of_cell: NDArray[np.int64], planes: Array) -> Array:
    """Correlation of the residuals of cells side by side on every plane, shape (N,).

    Pairs count by the points along their border. NaN where these are fewer than ten in all.
    """
    residual, sums = np.empty(len(of_cell)), np.zeros((len(planes), 3))
    kernels.cell_residuals(cells.rows, of_cell, planes, residual)
    add_products(cells.ends, cells.sides, of_cell, residual, sums)
    together, apart, border = sums.T
    told = (border >= _LEAST_BORDER) & (apart > 0)
    return np.asarray(np.divide(together, apart, np.full(len(planes), np.nan), where=told))
