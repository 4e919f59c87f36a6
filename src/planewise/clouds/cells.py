"""Cells of a cloud: the smallest cubes whose points tell a plane, and the size of their error.

As in depth images, the cells themselves say how far points lie from planes (white noise) and how
far neighbouring cells disagree beyond it (drift): quantiles, for edges and clutter only add.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cloud import FEWEST, STEEPEST, Cloud, over_part
from planewise.kernels import cloud_cells as kernels
from planewise.kernels.cloud_rows import CX, CZ, ROW, WEIGHT

Array = NDArray[np.float64]

HOPELESS = 4.0  # times the white variance: points farther from a plane have none
SHARED = 0.09  # of the white variance: what the points of a cell share, for cubes cut sheets
PRIOR = (4.0, 1.0)  # variances of a free plane: of its offset in areas of the cell, of its slopes
_FEWEST_TOLD = 50  # cells, or pairs of them, that can tell
_WHITE_LIMIT = 25.0  # five times the described standard deviation
_DRIFTING, _CHI2_3 = 0.1, 0.5844  # share of the pairs that tells the drift; that quantile of chi^2
_SAMPLE = 2_000  # pairs
_CUBES = 40_000  # that stand for a cloud
_LEVELS = 5  # sizes of cells at which the drift is looked for
_BISECTIONS = 14
_BISECTED = (1e-4, 1e4)
_FEWEST_PAIRS = 10  # of cells side by side that tell how white a plane's residuals are
_AT_ONCE = 1_000_000  # cells or pairs whose residuals are looked at together
_SATURATION = 0.33  # of the drift of near cells: its share between segments, for it levels off
_LEAST_DRIFT = 0.01  # of the white variance, over 16 cells
HIGHEST = 8  # levels above the least cubes at which cells are looked for
_LEAST_PART = 2_000  # cubes that are worth a thread
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
    """

    white: float
    drift: float

    def limits(self) -> tuple[float, float, float, float, float, tuple[float, float]]:
        """What makes points a cell (`kernels.cloud_rows.make_plane`)."""
        return self.white, HOPELESS, STEEPEST, FEWEST, SHARED, PRIOR


@dataclass(frozen=True)
class CloudCells:
    """Cells, and which of them touch.

    Attributes
    ----------
    rows : ndarray, shape (m, 18)
        As `kernels.cloud_rows` has them.
    owner : ndarray of int, shape (n,)
        Cell that each cube of the cloud is part of, -1 for none.
    ends : ndarray of int, shape (e, 2)
        Pairs of cells side by side; a pair may come more than once.
    sides : ndarray of float32, shape (e,)
        Points along their common border.
    error : CloudError
        Size of the error.
    """

    rows: Array
    owner: NDArray[np.int64]
    ends: NDArray[np.int32]
    sides: NDArray[np.float32]
    error: CloudError


def cells_of(cloud: Cloud) -> CloudCells | None:
    """Cells of a cloud; ``None`` if there is none."""
    nodes, keys = _sampled(cloud)
    white = _white(nodes)
    drift = _drift(cloud, nodes, keys, white)
    least = _LEAST_DRIFT * white * float(np.median(cloud.variance)) / (16.0 * cloud.side)
    error = CloudError(white, max(_SATURATION * drift, least))

    rows, owner, level_of = _grown(cloud, error)
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
            taken += kernels.take_in(cloud.nodes[part], white, chosen[part], rows, owner[part])
        if not taken:
            break
    ends, sides = _neighbours(cloud, rows, owner, level_of)
    return CloudCells(rows, owner, ends, sides, error)


def _grown(cloud: Cloud, error: CloudError) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Rows of cells, the cell of every cube, and how large each cell is (`kernels.grow_cells`)."""
    rows = cloud.memory.growing(np.float64, ROW)
    levels, cells = [], 0
    owner = np.empty(len(cloud.cubes), np.int64)
    for first, last in cloud.runs():
        n, part = last - first, slice(first, last)
        out, spans = np.empty((n, ROW)), np.empty((n, 2), np.int64)
        level_of = np.empty(n, np.int64)
        found = kernels.grow_cells(
            cloud.nodes[part].copy(), cloud.cubes[part].copy(), HIGHEST, error.limits(),
            np.empty(n, np.int64), np.empty(n, np.int64), out, spans, level_of,
        )  # fmt: skip
        kernels.owners(spans[:found], owner[part])
        owner[part] += np.where(owner[part] >= 0, cells, 0)
        rows.append(out[:found].copy())
        levels.append(level_of[:found].copy())
        cells += found
    return rows.array(), owner, np.concatenate(levels)


def _neighbours(
    cloud: Cloud, rows: Array, owner: NDArray[np.int64], level_of: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    most = kernels.NEIGHBOURS
    all_ends, all_sides = cloud.memory.growing(np.int32, 2), cloud.memory.growing(np.float32)
    for begin, end in cloud.runs():
        ends = np.empty((most * (end - begin), 2), np.int32)
        sides = np.empty(len(ends), np.float32)

        def look(
            first: int,
            last: int,
            at: int = begin,
            to: tuple[NDArray[np.int32], NDArray[np.float32]] = (ends, sides),
        ) -> None:
            part = slice(most * (first - at), most * (last - at))
            kernels.neighbours(
                cloud.cubes, cloud.about, owner, level_of, cloud.nodes, rows, first, last,
                to[0][part], to[1][part],
            )  # fmt: skip

        over_part(look, begin, end, cloud.workers, _LEAST_PART)
        found = kernels.compact(ends, sides)
        all_ends.append(ends[:found].copy())
        all_sides.append(sides[:found].copy())
    return all_ends.array(), all_sides.array()


def _sampled(cloud: Cloud) -> tuple[Array, NDArray[np.uint64]]:
    """Cubes that stand for the cloud: whole blocks of an octree, drawn by a hash of their keys."""
    keys = cloud.cubes
    stride = np.uint64(1 + len(keys) // _CUBES)
    block = (keys >> np.uint64(3 * (_LEVELS - 1))) * np.uint64(0x9E3779B97F4A7C15)
    chosen = (block >> np.uint64(32)) % stride == 0
    if stride == 1 or not chosen.any():
        return cloud.nodes, keys
    return cloud.nodes[chosen], keys[chosen]


def _white(nodes: Array) -> float:
    """White variance against the description: the quietest quarter of the cells says it.

    A cloud whose cells are farther from planes than its points can err has no such noise, but no
    planes: then the description stands.
    """
    ratios = np.empty(len(nodes))
    found = kernels.roughness(nodes, STEEPEST, FEWEST + 2.0, ratios)
    if found < _FEWEST_TOLD:
        return 1.0
    factor = max(1.0, float(np.quantile(ratios[:found], 0.25)))
    return factor if factor <= _WHITE_LIMIT else 1.0


def _drift(cloud: Cloud, nodes: Array, keys: NDArray[np.uint64], white: float) -> float:
    """Drift of the error: from cubes side by side, of several sizes.

    The smallest of what they say counts: more is shape, or what a cube cuts off.
    """
    typical = white * float(np.median(cloud.variance))
    limits = CloudError(white, 0.0).limits()
    levels = [(nodes, keys)]
    while len(levels) < _LEVELS:
        nodes, keys = levels[-1]
        parents, above = np.empty_like(nodes), np.empty_like(keys)
        found = kernels.parents_of(nodes, keys, parents, above)
        levels.append((parents[:found], above[:found]))
    told = math.inf
    for level in reversed(range(_LEVELS)):
        # Large cubes come first: where they agree, no more has to be asked.
        nodes, keys = levels[level]
        planes, ends = nodes.copy(), np.empty((_SAMPLE, 2), np.int64)
        ends = ends[: kernels.sibling_pairs(planes, keys, limits, ends)]
        if len(ends) >= _FEWEST_TOLD:
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
        kernels.pair_discords(rows, ends, factor * unit, discords)
        above = float(np.quantile(discords, share)) > _CHI2_3
        if not step and not above:
            return 0.0
        if step:
            low, high = (factor, high) if above else (low, factor)
    return math.sqrt(low * high) * unit


def residual_correlation(cells: CloudCells, of_cell: NDArray[np.int64], planes: Array) -> Array:
    """Correlation of the residuals of cells side by side on every plane, shape (N,).

    NaN with fewer than ten pairs of cells.
    """
    n = len(planes)
    residual = np.zeros(len(of_cell))
    for first in range(0, len(of_cell), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        on = of_cell[part] >= 0
        row, cell = planes[of_cell[part][on]], cells.rows[part][on]
        off = (row[:, :3] * cell[:, CX : CZ + 1]).sum(axis=1) + row[:, 3]
        residual[part][on] = off * np.sqrt(cell[:, WEIGHT])
    together, apart, pairs = np.zeros((3, n))
    for first in range(0, len(cells.ends), _AT_ONCE):
        u, v = cells.ends[first : first + _AT_ONCE].T
        same = (of_cell[u] >= 0) & (of_cell[u] == of_cell[v])
        u, v = u[same], v[same]
        plane = of_cell[u]
        together += np.bincount(plane, residual[u] * residual[v], n)
        apart += np.bincount(plane, 0.5 * (residual[u] ** 2 + residual[v] ** 2), n)
        pairs += np.bincount(plane, minlength=n)
    told = (pairs >= _FEWEST_PAIRS) & (apart > 0)
    return np.asarray(np.divide(together, apart, np.full(n, np.nan), where=told))
