"""Clouds of few points: planes that no cell tells, kept where they make Phi shorter.

On a face of fifty points a cell has seven and most are cut by an edge. So the planes of the paper's
objective, chosen from all points together, are tried as well: relabelled by their surroundings,
dropped and merged while Phi falls. There one plane more costs a name for every point, which a small
face beside much ground does not pay: what is on no plane is searched again, piece by piece. A point
on no plane is taken to lie anywhere within the points' own extent, of a piece within that of the
piece, not within R, or else planes would pay wherever points are but close together.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planewise.clouds.cells import SHARED, CloudError
from planewise.clouds.cloud import STEEPEST, Cloud
from planewise.clouds.groups import CloudGroups, groups_of
from planewise.clouds.information import (
    alone_of,
    data_of,
    ledger,
    refitted,
)
from planewise.clouds.masks import mask_of
from planewise.clouds.rows import planes_of, scatters
from planewise.components import components
from planewise.information import coordinate_information, plane_information
from planewise.kernels import cloud_labels as kernels
from planewise.kernels.cloud_keys import TURN
from planewise.kernels.cloud_rows import AREA, ROW, WEIGHT, write_normals
from planewise.objective import PAPER
from planewise.outlines.occupancy import FEWEST, held_area
from planewise.paper.evaluate import evaluator
from planewise.paper.joint import joint_search
from planewise.paper.problem import Problem
from planewise.paper.propose import propose
from planewise.point_observation import PointObservation
from planewise.ranks import ranks

Array = NDArray[np.float64]
Labels = NDArray[np.uint16]
Limits = tuple[float, float]

MOST = 4096  # points of a cloud that has few
POINTS = 3.0  # in a cube of such a cloud
_MOST_PLANES = 64
_RELABELLED = 3  # times
_MERGED_PLANES = 24  # above which merging them by trial takes too long
_MOST_CELLS = 300  # along a third of a plane, which may have wide gaps
_FALL = 1e-6  # nats that count as a fall
_PARALLEL = 0.9  # least cosine between planes that are merged
_LEAST_RANGE = 10.0  # times eps


def limits_of(points: Array, limits: Limits) -> Limits:
    """What is taken for R and eps: the diagonal of the points' box, if that is less than R."""
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    # Of points in one place, which have none, a coordinate still takes some nats.
    return min(limits[0], max(diagonal, _LEAST_RANGE * limits[1])), limits[1]


def fewest_nats(
    cloud: Cloud,
    error: CloudError,
    start: Labels,
    limits: Limits,
    rng: np.random.Generator,
) -> Labels:
    """Labels of the sorted points with the lowest Phi that was found, 1 ... N and 0.

    Parameters
    ----------
    cloud : Cloud
        Few points in small cubes.
    error : CloudError
        Its size.
    start : ndarray of uint16, shape (k,)
        Labels from cells, to be improved on.
    limits : (float, float)
        `limits_of` its points.
    rng : numpy.random.Generator
        For the planes that are proposed.
    """
    paper = _paper_labels(cloud, np.arange(len(start)), limits, rng)
    least = min(_paid(cloud, error, start, limits), _settled(cloud, error, paper, limits), key=_phi)
    return _merged(cloud, error, *_with_pieces(cloud, error, least, limits, rng), limits)


def plane_rows(cloud: Cloud, groups: CloudGroups, planes: int, error: CloudError) -> Array:
    """Rows (N, 18) of the planes through the points of each label, as wide as they scatter."""
    ones, zeros = np.ones(len(groups.label)), np.zeros(len(groups.label))
    rows = refitted(cloud, groups, ones, zeros, np.zeros(planes), error)
    write_normals(rows)
    inside = np.linalg.eigvalsh(scatters(rows))[:, 1:].clip(0)
    inside = np.nan_to_num(inside)
    # Of a rectangle with this scatter; of points near a line none, for they tell no plane.
    told = inside[:, 0] * STEEPEST > 1.0
    area = 12.0 * np.sqrt(inside.prod(axis=1)) / np.maximum(rows[:, WEIGHT], 1e-300)
    rows[:, AREA] = np.where(told, area, 0.0)
    return rows


def bound_areas(cloud: Cloud, labels: Labels, rows: Array) -> None:
    """Lower the areas of rows to those of cells with points, for a rectangle has no gaps or holes.

    labels: of the sorted points, j for row j - 1.
    """
    points = cloud.positions()
    for label, row in enumerate(rows, start=1):
        mine = points[labels == label]
        if row[AREA] > 0 and len(mine) >= FEWEST:
            mine -= mine.mean(axis=0)
            _, axes = np.linalg.eigh(mine.T @ mine)
            inside = mine @ axes[:, :0:-1]  # the longer way first
            row[AREA] = min(row[AREA], held_area(inside - inside.min(axis=0), _MOST_CELLS))


def _paid(cloud: Cloud, error: CloudError, labels: Labels, limits: Limits) -> tuple[float, Labels]:
    """Phi of labels, and the labels, when planes that do not pay or are not told are left out."""
    planes = int(labels.max(initial=0))
    rows = plane_rows(cloud, groups_of(cloud, labels, error), planes, error)
    told = np.flatnonzero(rows[:, AREA] > 0)
    place = ranks(told, planes)
    labels, rows = place[labels], rows[told]
    groups = groups_of(cloud, labels, error)
    alone = alone_of(cloud, groups, *limits)
    data = data_of(cloud, groups, alone, planes_of(rows), rows[:, AREA], error, *limits)
    mask = mask_of(cloud, labels, groups, len(rows), error)
    book = ledger(cloud, mask, groups, len(rows), alone, data, *limits)
    best = int(np.argmin(book.curve))
    place = ranks(book.order[:best], len(rows))
    return float(book.curve[best]), place[labels]


def _phi(paid: tuple[float, Labels]) -> float:
    return paid[0]


def _settled(
    cloud: Cloud, error: CloudError, labels: Labels, limits: Limits
) -> tuple[float, Labels]:
    """The lowest Phi of labels, as they are and relabelled again and again, and its labels."""
    tried = [_paid(cloud, error, labels, limits)]
    for _ in range(_RELABELLED):
        tried.append(_paid(cloud, error, _relabelled(cloud, error, labels, limits), limits))
        labels = tried[-1][1]
    return min(tried, key=_phi)


def _relabelled(cloud: Cloud, error: CloudError, labels: Labels, limits: Limits) -> Labels:
    """Every point on the plane that its residual and its surroundings say."""
    planes = int(labels.max(initial=0))
    rows = plane_rows(cloud, groups_of(cloud, labels, error), planes, error)
    votes = np.zeros((len(cloud.cubes), planes + 1), np.int64)
    cube = np.repeat(np.arange(len(cloud.cubes)), np.diff(cloud.starts))
    np.add.at(votes, (cube, labels), 1)
    out: Labels = np.empty(len(labels), np.uint16)
    variance = error.white * (1.0 + SHARED) * cloud.variance
    null = coordinate_information(*limits)
    nothing, no_cells = np.zeros(planes + 1), (np.empty((0, ROW)), np.empty(0, np.int64))
    kernels.label_points(
        cloud.local, cloud.starts, cloud.cubes, cloud.side, cloud.grid.middle, TURN,
        cloud.about, votes.argmax(axis=1), *no_cells, nothing, variance, nothing,
        planes_of(rows), null, limits[1], np.inf, 0, len(cloud.cubes), out,
    )  # fmt: skip
    return out


def _with_pieces(
    cloud: Cloud,
    error: CloudError,
    least: tuple[float, Labels],
    limits: Limits,
    rng: np.random.Generator,
) -> tuple[float, Labels]:
    """Add planes of pieces of what is on none, with which Phi falls, clearly by the piece's limits.

    By those of the cloud alone crowns of trees would have planes, for they are far apart.
    """
    pieces = _pieces(cloud, np.flatnonzero(least[1] == 0))
    while pieces:
        piece = pieces.pop()
        near = limits_of(cloud.positions()[piece], limits)
        found = _paper_labels(cloud, piece, near, rng)
        if not found.any():
            continue
        labels = least[1].copy()
        labels[piece] = np.where(found > 0, found + labels.max(), 0)
        phi, labels = _settled(cloud, error, labels, near)
        fall = _paid(cloud, error, least[1], near)[0] - phi
        more = _paid(cloud, error, labels, limits)
        if fall > plane_information(3, *near) and more[0] < least[0]:
            least = more
            pieces += _pieces(cloud, piece[labels[piece] == 0])
    return least


def _pieces(cloud: Cloud, points: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Points of cubes that hang together, with other points not in between."""
    cube = np.repeat(np.arange(len(cloud.cubes)), np.diff(cloud.starts))[points]
    held = np.zeros(len(cloud.cubes) + 1, np.bool_)  # the last for cubes that there are not
    held[cube] = True
    one, side = np.nonzero(held[:-1, None] & held[cloud.about])
    part = components(len(cloud.cubes), np.column_stack((one, cloud.about[one, side])))[cube]
    order = np.argsort(part, kind="stable")
    pieces = np.split(points[order], np.flatnonzero(np.diff(part[order])) + 1)
    return [piece for piece in pieces if FEWEST <= len(piece) < len(cloud.local)]


def _merged(cloud: Cloud, error: CloudError, phi: float, labels: Labels, limits: Limits) -> Labels:
    """Merge pairs of planes, the one that saves most first, while Phi falls."""
    while True:
        planes = int(labels.max(initial=0))
        if planes > _MERGED_PLANES:
            return labels
        rows = plane_rows(cloud, groups_of(cloud, labels, error), planes, error)
        normals = planes_of(rows)[:, :3]
        best = phi, labels
        for i, j in combinations(range(planes), 2):
            if abs(normals[i] @ normals[j]) < _PARALLEL:
                continue
            joint = np.where(labels == j + 1, i + 1, labels).astype(np.uint16)
            best = min(best, _paid(cloud, error, joint, limits), key=_phi)
        if not best[0] < phi - _FALL:
            return labels
        phi, labels = best
        again = _paid(cloud, error, _relabelled(cloud, error, labels, limits), limits)
        if again[0] < phi:
            phi, labels = again


def _paper_labels(
    cloud: Cloud, some: NDArray[np.intp], limits: Limits, rng: np.random.Generator
) -> Labels:
    """Labels of some of the sorted points under the paper's objective; limits: `limits_of` them."""
    points = cloud.positions()[some]
    seen = PointObservation(
        errors=np.sqrt(np.repeat(cloud.variance, np.diff(cloud.starts))[some]),
        rows=np.arange(len(points)),
        shape=(len(points),),
        range=limits[0],
        resolution=limits[1],
        points=np.ascontiguousarray(points.T),
        origin=np.zeros(3),
    )
    readings = evaluator(seen, PAPER.thresholds(seen), 1)
    structure = np.array([PAPER.structure(seen, n) for n in range(_MOST_PLANES + 1)])
    problem = Problem(evaluator=readings, empty=PAPER.empty(seen), structure=structure)
    solution, _ = joint_search(problem, propose(seen, readings, rng), rng=rng)
    return solution.assignment.labels.astype(np.uint16)
