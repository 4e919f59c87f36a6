"""From free points to a ranked model under the spatial objective."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.clouds import few as cloud_few
from planewise.clouds.cells import (
    CloudCells,
    CloudError,
    as_loud_as_seen,
    cells_of,
    residual_correlation,
)
from planewise.clouds.cloud import Cloud, cloud_of
from planewise.clouds.curvature import curved_planes
from planewise.clouds.groups import CloudGroups, groups_of
from planewise.clouds.information import alone_of, data_of
from planewise.clouds.instances import apart
from planewise.clouds.joining import joined
from planewise.clouds.labels import label_points, lost_most
from planewise.clouds.rows import covariances, planes_of
from planewise.clouds.segments import CloudSegments, segments_of
from planewise.clouds.weighing import CloudPlanes, weighed
from planewise.compilation import announce
from planewise.information import coordinate_information, outlier_information, plane_information
from planewise.kernels.cloud_information import add_residuals
from planewise.kernels.cloud_rows import AREA, COUNT, CX, CZ, ROW
from planewise.model import MAX_PLANES, Curve, Move, Plane, PlaneModel, limited_to, reason_of
from planewise.ranks import ranks
from planewise.runtime.stages import stage
from planewise.sensor import Sensor
from planewise.wording import counted

Array = NDArray[np.float64]


def cloud_model(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: Array | None,
    origin: Array | None = None,
    *,
    instances: bool,
    max_planes: int,
    significance: float,
    settings: Mapping[str, object],
    workers: int,
    rng: np.random.Generator,
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
    origin : ndarray, shape (3,) or (k, 3), optional
        Where the scanner stood.
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
    rng : numpy.random.Generator
        For clouds of few points.

    Returns
    -------
    PlaneModel
        With exact Phi of its planes and labels.
    """
    few = len(points) <= cloud_few.MOST
    with stage("observe"):
        cloud, louder = as_loud_as_seen(
            lambda louder: cloud_of(points, sensor, sigma, workers, origin=origin, louder=louder)
        )
    if cloud is None:
        there = int(np.isfinite(points).all(axis=1).sum())
        return nothing_in(len(points), there, sensor, settings)
    found = found_in(cloud, sensor, significance)
    if few:
        announce("points")
        with stage("few"):
            fine = cloud_of(points, sensor, sigma, workers, cloud_few.POINTS, origin, louder)
            assert fine is not None
            found = _from_few(fine, found, sensor, significance, rng)
    if instances:
        found = told_apart(found, significance)
    return ranked_model(len(points), found, sensor, max_planes, settings)


def found_in(cloud: Cloud, sensor: Sensor, significance: float) -> CloudPlanes:
    """Planes that cells tell, and every point's label."""
    with stage("cells"):
        cells = cells_of(cloud)
    if cells is None:
        labels = cloud.memory.empty(len(cloud.local), np.uint16)
        labels[:] = 0
        nothing = np.empty((0, ROW)), CloudError(1.0, 0.0), np.empty(0), np.empty(0)
        return CloudPlanes(cloud, labels, *nothing)
    with stage("segments"):
        found = segments_of(
            cells,
            plane_information(3, sensor.range, sensor.resolution),
            sensor.range,
            significance=significance,
            workers=cloud.workers,
            memory=cloud.memory,
        )
    with stage("labels"):
        told, outvoted = _told(cloud, cells, found, sensor)
    if not len(outvoted):
        return told
    with stage("ledger"):
        lowest = weighed(told, sensor).curve.min()
    while len(outvoted):
        found = found.without(outvoted)
        with stage("labels"):
            fewer, outvoted = _told(cloud, cells, found, sensor)
        with stage("ledger"):
            phi = weighed(fewer, sensor).curve.min()
        if phi >= lowest:
            break
        told, lowest = fewer, phi
    return told


def _told(
    cloud: Cloud, cells: CloudCells, found: CloudSegments, sensor: Sensor
) -> tuple[CloudPlanes, NDArray[np.intp]]:
    """Planes and labels of segments, and which of these have lost their points to others."""
    limits = sensor.range, sensor.resolution
    planes, areas = planes_of(found.rows), found.rows[:, AREA]
    null = coordinate_information(*limits)
    labels = label_points(cloud, cells, found.of_cell, planes, areas, null, sensor.resolution)
    lost = lost_most(cloud, cells, found.of_cell, labels, len(planes))
    rows, part = joined(cloud, labels, found.rows, cells.error, limits)
    saved = np.asarray(np.bincount(part, found.significance, len(rows)), np.float64)
    of_cell = np.append(part, -1)[found.of_cell]
    correlation = residual_correlation(cells, of_cell, planes_of(rows))
    told = CloudPlanes(cloud, labels, rows, cells.error, saved, correlation, found.curved)
    return told, np.flatnonzero(lost)


def _most_significant(found: CloudPlanes, least: float) -> CloudPlanes:
    """Planes that save more than `least`, if that is more than nothing, and fit a label."""
    keep = np.argsort(-found.significance, kind="stable")
    keep = keep[found.significance[keep] > least] if least else keep
    keep = np.sort(keep[:MAX_PLANES])
    if len(keep) == len(found.rows):
        return found
    place = ranks(keep, len(found.rows))
    found.cloud.rename(found.labels, place)
    return replace(
        found,
        rows=found.rows[keep],
        significance=found.significance[keep],
        correlation=found.correlation[keep],
    )


def told_apart(found: CloudPlanes, least: float) -> CloudPlanes:
    """Planes and labels by surfaces that touch; what a plane saves is shared by its points.

    Those that save no more than `least` are left out.
    """
    with stage("instances"):
        labels, row = apart(found.cloud, found.labels, found.rows)
    if len(row) == len(found.rows):
        return found
    count = np.zeros(len(row) + 1)
    for first, last in found.cloud.runs():
        part = labels[found.cloud.starts[first] : found.cloud.starts[last]]
        count += np.bincount(part, minlength=len(row) + 1)
    share = count[1:] / np.maximum(np.bincount(row, count[1:])[row], 1.0)
    rows = found.rows[row]
    rows[:, COUNT] *= share
    rows[:, AREA] *= share
    pieces = replace(
        found,
        labels=labels,
        rows=rows,
        significance=found.significance[row] * share,
        correlation=found.correlation[row],
    )
    return _most_significant(pieces, least)


def _from_few(
    cloud: Cloud,
    found: CloudPlanes,
    sensor: Sensor,
    significance: float,
    rng: np.random.Generator,
) -> CloudPlanes:
    """Planes of few points; found: what cells told."""
    limits = cloud_few.limits_of(cloud.positions(), (sensor.range, sensor.resolution))
    start = np.zeros(int(cloud.rows.max()) + 1, np.uint16)
    start[found.cloud.rows] = found.labels
    labels = cloud_few.fewest_nats(cloud, found.error, start[cloud.rows], limits, rng)
    n = int(labels.max(initial=0))
    groups = groups_of(cloud, labels, found.error)
    rows = cloud_few.plane_rows(cloud, groups, n, found.error)
    curved = curved_planes(cloud, groups, rows, found.error)
    alone = alone_of(cloud, groups, *limits)
    data = data_of(cloud, groups, alone, planes_of(rows), rows[:, AREA], found.error, *limits)
    worth = np.bincount(groups.label, alone - data, n + 1)[1:]
    saved = np.asarray(worth - plane_information(3, *limits), np.float64)
    keep = np.flatnonzero((saved > significance) & ~curved)
    labels, rows = ranks(keep, n)[labels], rows[keep]
    cloud_few.bound_areas(cloud, labels, rows)
    unknown = np.full(len(keep), np.nan)
    return CloudPlanes(cloud, labels, rows, found.error, saved[keep], unknown, int(curved.sum()))


def ranked_model(
    size: int,
    found: CloudPlanes,
    sensor: Sensor,
    max_planes: int,
    settings: Mapping[str, Any],
) -> PlaneModel:
    """Refit the planes to their points, keep those that pay by exact Phi, best first: as images.

    Of more than `max_planes` these are the best ones.
    """
    cloud, labels = found.cloud, found.labels
    with stage("ledger"):
        known = weighed(found, sensor)
    rows, book, curve = known.rows, known.book, known.curve
    paying = int(np.argmin(curve))
    best = min(paying, max_planes)
    moves = [Move(kind="agglomerate", planes=len(rows), information=float(book.curve[-1]))]
    if paying < len(rows):
        # What does not pay for itself by exact Phi goes.
        moves.append(Move(kind="cut", planes=paying, information=float(curve[paying])))
    order, phi = book.order[:best], curve[: best + 1]
    curve = phi if best < paying else curve
    with stage("describe"):
        place = ranks(order, len(rows))
        ranked = cloud.memory.empty(size, np.uint16)
        ranked[:] = 0
        for first, last in cloud.runs():
            part = slice(cloud.starts[first], cloud.starts[last])
            ranked[cloud.rows[part]] = place[labels[part]]
        planes = _described(found, known.groups, rows, book.saved, order)
    factor = found.cloud.louder * math.sqrt(found.error.white)
    settings = {**settings, "sigma_factor": round(factor, 3)}
    significance = settings.get("significance", 0.0)
    reason = reason_of(best, significance)
    if not len(rows) and not significance:
        reason = "no patch of points is flat, wide and dense enough to tell a plane"
        if found.curved:
            reason = "all patches that are flat enough are pieces of curved surfaces"
    elif not paying and not significance:
        reason += f"; sheets nearer to each other than {2 * cloud.side:.2g} m are not told apart"
    if best < paying:
        reason = limited_to(max_planes)
    return PlaneModel(
        labels=ranked,
        planes=planes,
        information=float(phi[-1]),
        curve=Curve(information=curve, chosen=best, reason=reason, moves=tuple(moves)),
        readings=len(cloud.local),
        prefix=tuple(phi.tolist()),
        search="joint",
        objective="spatial",
        note="" if best else reason + _too_wide(cloud, sensor),
        settings=settings,
    )


def _too_wide(cloud: Cloud, sensor: Sensor) -> str:
    """What may be wrong where points reach farther than a coordinate may."""
    reach = float(np.ptp(cloud.sample[0][:, CX : CZ + 1], axis=0).max(initial=0.0))
    if reach <= sensor.range:
        return ""
    return (
        f"; the points reach over {reach:.5g} m, farther than the sensor's range of "
        f"{sensor.range:g} m: are they in metres?"
    )


def _described(
    found: CloudPlanes, groups: CloudGroups, rows: Array, saved: Array, order: NDArray[np.intp]
) -> tuple[Plane, ...]:
    """Planes in this order, in the frame of the input."""
    cloud, local = found.cloud, planes_of(rows)
    sums = np.zeros((len(rows), 5))
    for first, last in cloud.runs():
        part = slice(groups.places[first], groups.places[last])
        add_residuals(groups.rows[part], groups.label[part], local, sums)
    count, squares = sums[:, :2].T
    centroid = sums[:, 2:] / np.maximum(count, 1.0)[:, None] + cloud.centre
    covariance = covariances(rows, cloud.centre)
    planes = []
    for j in order:
        distance = float(local[j, 3] - local[j, :3] @ cloud.centre)
        sign = -1.0 if distance < 0 else 1.0
        planes.append(
            Plane(
                normal=sign * local[j, :3],
                distance=sign * distance,
                information=float(saved[j]),
                count=int(count[j]),
                rms=float(np.sqrt(max(squares[j], 0.0) / max(count[j], 1.0))),
                centroid=centroid[j],
                covariance=covariance[j],
                significance=float(found.significance[j]),
                residual_correlation=float(found.correlation[j]),
                area=float(found.rows[j, AREA] * count[j] / found.rows[j, COUNT]),
            )
        )
    return tuple(planes)


def nothing_in(
    size: int, readings: int, sensor: Sensor, settings: Mapping[str, object]
) -> PlaneModel:
    """Model of too few points."""
    phi = outlier_information(3, sensor.range, sensor.resolution) * readings
    note = f"{counted(readings, 'finite point')}; 3 are needed for a plane"
    if readings >= 3:
        note = (
            f"of {counted(readings, 'finite point')} fewer than 3 lie within the sensor's range of "
            f"{sensor.range:g} m: are they in metres?"
        )
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
