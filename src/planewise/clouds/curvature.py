"""Which segments of a cloud are pieces of curved surfaces.

Where a surface bends, cells merge into facets, as many as noise lets one tell, and each is as flat
as a plane. What tells them from planes is that they go on bending across their borders, while
planes meet in edges, which are sharp.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import HOPELESS, SHARED, CloudCells, CloudError
from planewise.clouds.cloud import Cloud
from planewise.clouds.groups import CloudGroups
from planewise.clouds.memory import Memory
from planewise.kernels import cloud_curvature as kernels
from planewise.kernels.cloud_cells import FACES_EDGES
from planewise.kernels.cloud_rows import CELLS, COUNT, CX, CZ, WEIGHT, XX, ZZ
from planewise.kernels.quadrics import HEIGHTS, spread

Array = NDArray[np.float64]


def curved_segments(
    cells: CloudCells, rows: Array, of_cell: NDArray[np.int64], at_once: int, memory: Memory
) -> NDArray[np.bool_]:
    """Find the segments that are pieces of curved surfaces.

    Each has a quadric. Across a border the surface goes on if the quadrics of both sides turn by
    less than half the angle of their planes where they meet, one of them being clearly bent; a
    segment is curved if its surface goes on across most of its border.

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

    Returns
    -------
    ndarray of bool, shape (N,)
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
            cells.ends[part], cells.sides[part], of_cell, cells.rows, rows, quadrics, border,
            ends, along, how,
        )  # fmt: skip
        pairs.append(ends[:found].copy())
        points.append(along[:found].copy())
        states.append(how[:found].copy())
        memory.release()
    all_pairs, curved = np.concatenate(pairs), np.empty(len(rows), np.bool_)
    spread(border, all_pairs, np.concatenate(points), np.concatenate(states), curved)
    pieces, place = np.flatnonzero(curved), np.cumsum(curved) - 1
    joined = place[all_pairs[curved[all_pairs].all(axis=1)]]
    curved[pieces] = ~_flat_together(rows[pieces], joined)
    return curved


def _flat_together(rows: Array, pairs: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Rows that lie on one plane with all that pairs join them to, as far from it as cells may.

    So a wall that bulges by hardly more than its noise is no curved surface.
    """
    root = np.arange(len(rows))
    while len(pairs):
        before = root.copy()
        least = root[pairs].min(axis=1)
        np.minimum.at(root, pairs[:, 0], least)
        np.minimum.at(root, pairs[:, 1], least)
        root = root[root]
        if (root == before).all():
            break
    weight, count = rows[:, WEIGHT], rows[:, COUNT]
    total = np.bincount(root, weight, len(rows))
    at = rows[:, CX : CZ + 1]
    centre = np.column_stack([np.bincount(root, weight * x, len(rows)) for x in at.T])
    off = at - (centre / np.maximum(total, 1e-300)[:, None])[root]
    i, j = np.triu_indices(3)
    parts = rows[:, XX : ZZ + 1] + weight[:, None] * off[:, i] * off[:, j]
    scatter = np.zeros((len(rows), 3, 3))
    for k, part in enumerate(parts.T):
        scatter[:, i[k], j[k]] = scatter[:, j[k], i[k]] = np.bincount(root, part, len(rows))
    # Of a point: the weight of a cell has what its points share, too.
    variance = count / weight / (1.0 + SHARED * count / rows[:, CELLS])
    white = np.bincount(root, weight * variance, len(rows))
    across = np.linalg.eigvalsh(scatter)[:, 0]
    return np.asarray((across <= (HOPELESS - 1.0) * white)[root])


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
    return curved_segments(cells, rows, label[labelled], max(len(ends), 1), cloud.memory)
