"""From free points to a ranked model under the spatial objective."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from planewise.cloud import Cloud, cloud_of
from planewise.cloud_cells import CloudCells, CloudError, cells_of
from planewise.cloud_information import CloudGroups, data_of, groups_of, ledger, refitted
from planewise.cloud_labels import label_points
from planewise.cloud_segments import CloudSegments, segments_of
from planewise.information import coordinate_information, plane_information
from planewise.kernels import cloud_rows
from planewise.kernels.cloud_rows import AREA, COUNT, CX, CY, CZ, NX, NZ, WEIGHT, XX, ZZ
from planewise.model import Curve, Move, Plane, PlaneModel
from planewise.sensor import Sensor
from planewise.stages import stage

Array = NDArray[np.float64]

_LEAST = 1.0  # times 3 ln(R / eps): what the points of a plane have to be shorter by
_FEWEST_PAIRS = 10  # of cells side by side that tell how white a plane's residuals are


def cloud_model(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: Array | None,
    *,
    instances: bool,
    max_planes: int,
    significance: float,
    settings: Mapping[str, object],
    workers: int,
) -> PlaneModel:
    """Find, rank and describe the planes of free points in space.

    Parameters
    ----------
    points : ndarray of float, shape (k, 3)
        Metres, any origin; rows that are not finite are no reading.
    sensor : Sensor
        Range, resolution and noise.
    sigma : ndarray, shape (k,), optional
        Standard deviation of every point, in place of the sensor's noise.
    instances : bool
        Keep coplanar surfaces that do not touch apart.
    max_planes : int
        Largest number of planes.
    significance : float
        Nats that a plane has to save beyond its costs.
    settings : Mapping
        Recorded in the model.
    workers : int
        Threads.

    Returns
    -------
    PlaneModel
        With exact Phi of its planes and labels.
    """
    with stage("observe"):
        cloud = cloud_of(points, sensor, sigma, workers)
    if cloud is None:
        there = int(np.isfinite(points).all(axis=1).sum())
        note = f"{there} finite points; 3 are needed for a plane"
        return _nothing(len(points), there, there * 3.0, note, sensor, settings)
    with stage("cells"):
        cells = cells_of(cloud)
    if cells is None:
        note = "no patch of points is flat, wide and dense enough to tell a plane"
        count = len(cloud.local)
        return _nothing(len(points), count, _none_at_all(cloud, sensor), note, sensor, settings)
    cost = plane_information(3, sensor.range, sensor.resolution)
    with stage("segments"):
        found = segments_of(
            cells,
            cost,
            sensor.range,
            instances=instances,
            significance=significance,
            max_planes=max_planes,
            workers=workers,
        )
    areas = found.rows[:, AREA]
    with stage("labels"):
        labels = label_points(
            cloud,
            cells,
            found.of_cell,
            planes_of(found.rows),
            areas,
            coordinate_information(sensor.range, sensor.resolution),
            sensor.resolution,
        )
    with stage("ledger"):
        limits = sensor.range, sensor.resolution
        groups = groups_of(cloud, labels, cells.error)
        data = data_of(cloud, groups, planes_of(found.rows), areas, cells.error, *limits)
        rows = refitted(groups, *data, areas, cells.error)
        rows = _determined(rows, found.rows)
        alone, data_now = data_of(cloud, groups, planes_of(rows), areas, cells.error, *limits)
        book = ledger(cloud, labels, groups, alone, data_now, len(rows), *limits)
    curve = book.curve[: np.count_nonzero(book.worth < -_LEAST * cost) + 1]
    best = int(np.argmin(curve))
    moves = [Move(kind="agglomerate", planes=len(rows), information=float(book.curve[-1]))]
    if best < len(rows):
        # What does not pay for itself by exact Phi goes.
        moves.append(Move(kind="cut", planes=best, information=float(curve[best])))
    order = book.order[:best]
    with stage("describe"):
        planes = _described(cloud, cells, groups, found, rows, book.worth, order)
        place = np.zeros(len(rows) + 1, np.uint16)
        place[order + 1] = np.arange(1, best + 1)
        ranked = np.zeros(len(points), np.uint16)
        ranked[cloud.order.rows] = place[labels]
    reason = "no merge saves anything" if best else "no plane saves more than it costs"
    if found.left_out:
        reason = f"reached max_planes = {max_planes}"
    phi = curve[: best + 1]
    return PlaneModel(
        labels=ranked,
        planes=planes,
        information=float(phi[-1]),
        curve=Curve(information=curve, chosen=best, reason=reason, moves=tuple(moves)),
        readings=len(cloud.local),
        prefix=tuple(phi.tolist()),
        search="joint",
        objective="spatial",
        note="" if best else reason,
        settings=settings,
    )


def planes_of(rows: Array) -> Array:
    """(normal, distance) of rows, shape (N, 4), relative to the centre of the cloud."""
    normals = rows[:, NX : NZ + 1]
    return np.column_stack((normals, -(normals * rows[:, CX : CZ + 1]).sum(axis=1)))


def _determined(rows: Array, before: Array) -> Array:
    """Refitted rows with their normals; those before where no points say."""
    told = (rows[:, COUNT] >= 3) & (rows[:, WEIGHT] > 0)
    out = np.where(told[:, None], rows, before)
    cloud_rows.write_normals(out)
    return out


def _described(
    cloud: Cloud,
    cells: CloudCells,
    groups: CloudGroups,
    found: CloudSegments,
    rows: Array,
    worth: Array,
    order: NDArray[np.intp],
) -> tuple[Plane, ...]:
    """Planes in this order, in the frame of the input."""
    local = planes_of(rows)
    g, labels = groups.rows, groups.label
    on = labels > 0
    g, owner = g[on], labels[on] - 1
    normal = local[owner, :3]
    off = (normal * g[:, CX : CZ + 1]).sum(axis=1) + local[owner, 3]
    across = _quadratic(g[:, XX : ZZ + 1], normal) * g[:, COUNT] / g[:, WEIGHT]
    n = len(rows)
    count = np.bincount(owner, g[:, COUNT], n)
    squares = np.bincount(owner, across * cells.error.white + g[:, COUNT] * off * off, n)
    centroid = np.column_stack(
        [np.bincount(owner, g[:, COUNT] * g[:, e], n) for e in (CX, CY, CZ)]
    ) / np.maximum(count, 1.0)[:, None]
    correlation = _residual_correlation(cells, found.of_cell, local)
    planes = []
    for rank, j in enumerate(order):
        unit = local[j, :3]
        distance = float(local[j, 3] - unit @ cloud.centre)
        sign = -1.0 if distance < 0 else 1.0
        covariance = _covariance(rows[j], cloud.centre)
        planes.append(
            Plane(
                normal=sign * unit,
                distance=sign * distance,
                information=float(worth[rank]),
                count=int(count[j]),
                rms=float(np.sqrt(squares[j] / max(count[j], 1.0))),
                centroid=centroid[j] + cloud.centre,
                covariance=covariance,
                significance=float(found.significance[j]),
                residual_correlation=float(correlation[j]),
                area=float(found.rows[j, AREA] * count[j] / found.rows[j, COUNT]),
            )
        )
    return tuple(planes)


def _quadratic(scatter: Array, normal: Array) -> Array:
    """n' S n of rows of (xx, xy, xz, yy, yz, zz)."""
    x, y, z = normal.T
    xx, xy, xz, yy, yz, zz = scatter.T
    return np.asarray(
        xx * x * x + yy * y * y + zz * z * z + 2 * (xy * x * y + xz * x * z + yz * y * z)
    )


def _covariance(row: Array, centre: Array) -> Array:
    """Of (normal, distance), from the information on offset and slopes in the plane's own frame."""
    xx, xy, xz, yy, yz, zz = row[XX : ZZ + 1]
    scatter = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    values, axes = np.linalg.eigh(scatter)
    inside = axes[:, 1:]
    slopes = np.diag(1.0 / np.maximum(values[1:], 1e-300))
    turn = -inside  # of the normal by the slopes
    at = row[CX : CZ + 1] + centre
    jacobian = np.zeros((4, 3))
    jacobian[:3, 1:] = turn
    jacobian[3, 0] = -1.0
    jacobian[3, 1:] = -at @ turn
    spread = np.zeros((3, 3))
    spread[0, 0], spread[1:, 1:] = 1.0 / row[WEIGHT], slopes
    return np.asarray(jacobian @ spread @ jacobian.T)


def _residual_correlation(
    cells: CloudCells, of_cell: NDArray[np.int64], planes: Array
) -> Array:
    """Correlation of the residuals of cells side by side on every plane, shape (N,).

    NaN with fewer than ten pairs of cells.
    """
    n = len(planes)
    residual = np.zeros(len(of_cell))
    on = of_cell >= 0
    row = planes[of_cell[on]]
    centroid = cells.rows[on][:, CX : CZ + 1]
    off = (row[:, :3] * centroid).sum(axis=1) + row[:, 3]
    residual[on] = off * np.sqrt(cells.rows[on, WEIGHT])
    u, v = cells.ends.T
    same = on[u] & (of_cell[u] == of_cell[v])
    u, v = u[same], v[same]
    plane = of_cell[u]
    together = np.bincount(plane, residual[u] * residual[v], n)
    apart = np.bincount(plane, 0.5 * (residual[u] ** 2 + residual[v] ** 2), n)
    told = (np.bincount(plane, minlength=n) >= _FEWEST_PAIRS) & (apart > 0)
    return np.divide(together, apart, np.full(n, np.nan), where=told)


def _none_at_all(cloud: Cloud, sensor: Sensor) -> float:
    """Phi without planes of points of which no patch tells one, each as it is."""
    limits = sensor.range, sensor.resolution
    labels = np.zeros(len(cloud.local), np.uint16)
    error = CloudError(1.0, 0.0)
    groups = groups_of(cloud, labels, error)
    alone, data = data_of(cloud, groups, np.empty((0, 4)), np.empty(0), error, *limits)
    return float(ledger(cloud, labels, groups, alone, data, 0, *limits).curve[0])


def _nothing(
    size: int,
    readings: int,
    phi: float,
    note: str,
    sensor: Sensor,
    settings: Mapping[str, object],
) -> PlaneModel:
    return PlaneModel(
        labels=np.zeros(size, np.uint16),
        planes=(),
        information=phi,
        curve=Curve(information=np.array([phi]), chosen=0, reason=note),
        readings=readings,
        prefix=(phi,),
        search="joint",
        objective="spatial",
        note=note,
        settings=settings,
    )
