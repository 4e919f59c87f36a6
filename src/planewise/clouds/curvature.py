"""Which segments of a cloud are pieces of curved surfaces.

Where a surface bends, cells merge into facets, as many as noise lets one tell, and each is as flat
as a plane. What tells them from planes is that they go on bending across their borders, while
planes meet in edges, which are sharp. A wall that bulges comes in facets, too, and is one plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import HOPELESS, SHARED, CloudCells, CloudError
from planewise.clouds.cloud import Cloud
from planewise.clouds.groups import CloudGroups
from planewise.clouds.memory import Memory
from planewise.clouds.rows import scatters
from planewise.components import components
from planewise.flatness import EDGE, WARP
from planewise.kernels import cloud_curvature as kernels
from planewise.kernels.cloud_cells import FACES_EDGES
from planewise.kernels.cloud_rows import CELLS, COUNT
from planewise.kernels.cloud_segments import join_parts
from planewise.kernels.pairs import pairs_once
from planewise.kernels.quadrics import GOES_ON, HEIGHTS, NO_EDGE, spread

Array = NDArray[np.float64]


class Borders(NamedTuple):
    """Where the surfaces of segments may go on, by pairs of cells on both sides of a border.

    Attributes
    ----------
    border : ndarray, shape (N,)
        Points along the border of every segment.
    pairs : ndarray of int, shape (e, 2)
        Segments that may be one curved surface, once for every pair of their cells.
    points : ndarray of float32, shape (e,)
        Points along the border of these cells.
    states : ndarray of int8, shape (e,)
        As `kernels.cloud_curvature.borders_of` writes them.
    """

    border: Array
    pairs: NDArray[np.int32]
    points: NDArray[np.float32]
    states: NDArray[np.int8]


def borders_of(
    cells: CloudCells, rows: Array, of_cell: NDArray[np.int64], at_once: int, memory: Memory
) -> Borders:
    """Fit a quadric to every segment and look where these go on across borders.

    The surface goes on if the quadrics of both sides turn by less than half the angle of their
    planes where they meet, one of them being clearly bent.

    Parameters
    ----------
    cells : CloudCells
        Of the cloud.
    rows : ndarray, shape (N, 18)
        Of the segments.
    of_cell : ndarray of int, shape (m,)
        Segment of every cell.
    at_once : int
        Cells, and pairs of them, that are looked at together.
    memory : Memory
        Where large arrays lie.
    """
    sums = np.zeros((len(rows), HEIGHTS))
    for first in range(0, len(of_cell), at_once):
        part = slice(first, first + at_once)
        kernels.add_heights(cells.rows[part], of_cell[part], rows, sums)
        memory.release()
    quadrics = np.empty((len(rows), kernels.QUADRIC))
    kernels.quadrics_of(sums, rows, cells.error.drift, quadrics)
    border = np.zeros(len(rows))
    pairs, points = [np.empty((0, 2), np.int32)], [np.empty(0, np.float32)]
    states = [np.empty(0, np.int8)]
    for first in range(0, len(cells.sides), at_once):
        part = slice(first, first + at_once)
        n = len(cells.sides[part])
        ends, along, how = np.empty((n, 2), np.int32), np.empty(n, np.float32), np.empty(n, np.int8)
        found = kernels.borders_of(
            cells.ends[part], cells.sides[part], of_cell, cells.rows, rows, quadrics, EDGE, border,
            ends, along, how,
        )  # fmt: skip
        pairs.append(ends[:found].copy())
        points.append(along[:found].copy())
        states.append(how[:found].copy())
        memory.release()
    return Borders(border, np.concatenate(pairs), np.concatenate(points), np.concatenate(states))


def nearly_flat(rows: Array, borders: Borders) -> NDArray[np.int64]:
    """Segments that are one surface which bends, but no more than what people call a plane.

    Those whose surface goes on across most of the border between them, or turns there by less than
    an edge, and all they go on to, where these lie about one plane together
    (`planewise.flatness`): so a piece of a tower is none. Returns the first segment of the surface
    that each is part of.
    """
    pairs = borders.pairs.copy()
    on = borders.states & (GOES_ON | NO_EDGE)
    saying = np.where(on, borders.points, -borders.points)
    found = pairs_once(pairs, saying, len(rows))
    part = components(len(rows), pairs[:found][saying[:found] > 0])
    return np.where(_about_one_plane(rows, part, 1.0, WARP), part, np.arange(len(rows)))


def curved_segments(rows: Array, borders: Borders) -> NDArray[np.bool_]:
    """Find the segments that are pieces of curved surfaces.

    A segment is curved if its surface goes on across most of its border. A wall that bulges by
    hardly more than its noise is no curved surface: all its pieces lie as far from one plane as the
    points of a cell may.

    Parameters
    ----------
    rows : ndarray, shape (N, 18)
        Of the segments.
    borders : Borders
        Of the same.

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    curved = np.empty(len(rows), np.bool_)
    spread(borders.border, borders.border, borders.pairs, borders.points, borders.states, curved)
    pieces, place = np.flatnonzero(curved), np.cumsum(curved) - 1
    joined = place[borders.pairs[curved[borders.pairs].all(axis=1)]]
    part = components(len(pieces), joined)
    curved[pieces] = ~_about_one_plane(rows[pieces], part, HOPELESS - 1.0, 0.0)
    return curved


def _about_one_plane(
    rows: Array, part: NDArray[np.int64], noise: float, warp: float
) -> NDArray[np.bool_]:
    """Rows whose part lies about one plane.

    noise: variance of points about it, of the white one; warp: besides, their deviation from it, of
    their standard deviation in the direction in which they lie closest.
    """
    together = rows.copy()
    join_parts(together, part)
    across, along, _ = np.linalg.eigvalsh(scatters(together)).T
    # Of a point: the weight of a cell has what its points share, too.
    points = rows[:, COUNT] / (1.0 + SHARED * rows[:, COUNT] / rows[:, CELLS])
    white = np.bincount(part, points, len(rows))
    return np.asarray((across <= noise * white + warp**2 * along)[part])


def curved_planes(
    cloud: Cloud, groups: CloudGroups, rows: Array, error: CloudError
) -> NDArray[np.bool_]:
    """`curved_segments` of planes, rows (N, 18), by groups, where points are too few for cells.

    Neighbours are the groups of one cube, and of cubes that share a face or an edge.
    """
    of_cube = np.repeat(np.arange(len(cloud.cubes)), np.diff(groups.places))
    later = FACES_EDGES[FACES_EDGES > 13]
    near = np.column_stack((of_cube, cloud.about[of_cube][:, later]))
    u, column = np.nonzero(np.greater_equal(near, 0))
    first, last = groups.places[near[u, column]], groups.places[near[u, column] + 1]
    count = last - first
    ends = np.column_stack(
        (np.repeat(u, count), np.arange(count.sum()) + np.repeat(last - np.cumsum(count), count))
    )
    label = groups.label - 1
    same_cube = np.repeat(column == 0, count)
    ends = ends[(label[ends] >= 0).all(axis=1) & ~(same_cube & (ends[:, 0] >= ends[:, 1]))]
    sides = np.sqrt(groups.rows[ends, COUNT].min(axis=1)).astype(np.float32)
    labelled = np.flatnonzero(label >= 0)
    place = np.zeros(len(label), np.int32)
    place[labelled] = np.arange(len(labelled))
    cells = CloudCells(
        rows=groups.rows[labelled],
        keys=cloud.cubes[of_cube[labelled]],
        owner=np.empty(0, np.int64),
        ends=place[ends],
        sides=sides,
        error=error,
    )
    rows = rows.copy()
    rows[:, CELLS] = np.bincount(label[labelled], minlength=len(rows))
    of_cell, at_once = label[labelled], max(len(ends), 1)
    return curved_segments(rows, borders_of(cells, rows, of_cell, at_once, cloud.memory))
