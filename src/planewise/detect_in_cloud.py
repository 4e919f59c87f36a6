"""Find planes in clouds larger than memory: points and all that is made of them are on a disk."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise import compilation
from planewise.arguments import checked_count, shown
from planewise.clouds.memory import Disk, Memory
from planewise.errors import PlanewiseError
from planewise.files.cloud import open_cloud
from planewise.model import PlaneModel
from planewise.noise import AUTO
from planewise.options import Options, Seed
from planewise.point_cloud import BLOCK, CloudFile, PointCloud
from planewise.point_observation import checked_origin, checked_sigma
from planewise.runtime import threads
from planewise.runtime.stages import stage
from planewise.search import find_in_cloud, noted
from planewise.sensor import Sensor, checked_sensor

TILE_POINTS = 4_000_000
"""Points of a tile unless another number is asked for."""

FROM_FILE = "file"
"""In place of an origin: where the file says that its scanners stood."""

_LARGEST = 2**32 - 1  # points


def detect_planes_in_cloud(
    cloud: str | Path | CloudFile | PointCloud,
    sensor: Sensor,
    *,
    sigma: ArrayLike | None = None,
    origin: ArrayLike | Literal["file"] | None = None,
    tile_points: int = TILE_POINTS,
    folder: str | Path | None = None,
    instances: bool = False,
    significance: float = 0.0,
    max_planes: int | None = None,
    rng: Seed = 0,
    threads: int | None = None,
) -> PlaneModel:
    """Find the planes of a cloud that may be larger than memory, a tile at a time.

    The result is that of `detect_planes_in_points` for all points at once, with ``as_image=False``,
    but for points that are there twice: a tile takes each for a reading of its own.

    Parameters
    ----------
    cloud : path, CloudFile or PointCloud
        File, or points that lie on a disk (`points_on_disk`).
    sensor : Sensor
        As in `detect_planes_in_points`.
    sigma : array_like, shape (k,), optional
        Standard deviation of every point in metres, in place of the sensor's noise. An array that
        is mapped from a file (``numpy.load(path, mmap_mode="r")``) is not read as a whole.
    origin : array_like, shape (3,) or (k, 3), or "file", optional
        Where the scanner stood, for all points or each, relative to the cloud's offset: noise is
        then along the rays from there. "file": what the file says, of every scan.
    tile_points : int
        Points of a tile; of fewer than some thousands results depend on it. A cloud of no more is
        searched in memory.
    folder : path, optional
        Where temporary files without a name are put, some 70 to 250 bytes a point; by default
        beside the cloud's file, else the system's folder for them.
    instances, significance, max_planes, rng, threads
        See `Options`.

    Returns
    -------
    PlaneModel
        Planes are relative to the cloud's offset. `labels`, shape (k,) in the order of the file, is
        an array like any other whose content lies in a temporary file; it goes when the array does.

    Raises
    ------
    ValueError
        If an argument is malformed.
    PlanewiseError
        If the file is damaged, or temporary files cannot be written.
    """
    options = Options(
        instances=instances,
        significance=significance,
        max_planes=max_planes,
        rng=rng,
        threads=threads,
    ).resolved(spatial=True)
    checked_sensor(sensor)
    tile_points = checked_count("tile_points", tile_points)
    if isinstance(cloud, str | Path):
        cloud = open_cloud(cloud)
    if folder is None and isinstance(cloud, CloudFile):
        folder = cloud.path.parent
    if not isinstance(cloud, CloudFile | PointCloud):
        raise ValueError(
            f"cloud must be a path, CloudFile or PointCloud, got {type(cloud).__name__}; "
            "detect_planes_in_points takes arrays"
        )
    if not isinstance(folder, str | PathLike | None):
        raise ValueError(f"folder must be a path, got {shown(folder)}")
    disk = Disk(None if folder is None else Path(folder))
    if isinstance(cloud, CloudFile):
        cloud = points_on_disk(cloud, disk)
    points = cloud.points
    errors = checked_sigma(sigma, len(points))
    if isinstance(origin, str):
        if origin != FROM_FILE:
            raise ValueError(f"origin must be coordinates or {FROM_FILE!r}, got {origin!r}")
        place: NDArray[np.float64] | None = origins_of(cloud, disk)
    else:
        place = checked_origin(origin, points.shape)
    if len(points) <= tile_points:
        return find_in_cloud(points, sensor, errors, place, options)
    if len(points) > _LARGEST:
        raise ValueError(f"cloud must have at most {_LARGEST:,} points, got {len(points):,}")
    return noted(_find_in_tiles(points, sensor, errors, place, options, tile_points, disk))


def _find_in_tiles(
    points: NDArray[np.floating],
    sensor: Sensor,
    sigma: NDArray[np.float64] | None,
    origin: NDArray[np.float64] | None,
    options: Options,
    tile_points: int,
    disk: Disk,
) -> PlaneModel:
    compilation.announce("cloud")
    # Its compiled loops are loaded only where they are used.
    from planewise.clouds.cells import as_loud_as_seen
    from planewise.clouds.missing import without_missing
    from planewise.clouds.model import found_in, nothing_in, ranked_model, told_apart
    from planewise.clouds.noise import cloud_noise
    from planewise.clouds.tiles import tiled_cloud

    workers, settings = threads.chosen(options.threads), options.describe()
    most = options.most_planes
    with stage("observe"):
        points = without_missing(points, sensor, sigma, origin, disk)
    if sensor.noise == AUTO and sigma is None:
        with stage("noise"):
            estimate = cloud_noise(points, sensor, origin, workers, disk)
        sensor, settings["noise"] = estimate.sensor(sensor), estimate.describe()
    with stage("observe"):
        cloud, _ = as_loud_as_seen(
            lambda louder: tiled_cloud(
                points, sensor, sigma, origin, workers, tile_points, disk, louder
            )
        )
    if cloud is None:
        finite = int(np.isfinite(points).all(axis=1).sum())
        return nothing_in(len(points), finite, sensor, settings)
    found = found_in(cloud, sensor, options.significance)
    if options.instances:
        found = told_apart(found, options.significance)
    return ranked_model(len(points), found, sensor, most, settings)


def points_on_disk(file: CloudFile, disk: Disk) -> PointCloud:
    """Copy the points of a file, their intensities and scans, to a disk.

    Parameters
    ----------
    file : CloudFile
        Read block by block.
    disk : Disk
        Where the arrays of the result lie.

    Returns
    -------
    PointCloud
        Without colours and labels.
    """
    points, intensity, scan = None, disk.growing(np.float32), disk.growing(np.int32)
    count, shining, scanned = 0, 0, 0
    for block in file.chunks():
        if points is None:
            points = disk.growing(block.points.dtype, 3)
        points.append(block.points)
        count += len(block)
        if block.intensity is not None:
            intensity.append(block.intensity)
            shining += len(block)
        if block.scan is not None:
            scan.append(block.scan)
            scanned += len(block)
    return PointCloud(
        points=np.empty((0, 3)) if points is None else points.array(),
        offset=file.offset,
        intensity=intensity.array() if shining == count > 0 else None,
        scan=scan.array() if scanned == count > 0 else None,
        origins=file.origins,
    )


def origins_of(cloud: PointCloud, memory: Memory) -> NDArray[np.float64]:
    """Where the scanner of a cloud stood, relative to its offset: shape (3,), or (k, 3) for scans.

    Raises
    ------
    PlanewiseError
        If the cloud does not say it.
    """
    if cloud.origins is None or not len(cloud.origins):
        raise PlanewiseError("origin: the file does not say where its scanner stood; give x,y,z")
    if len(cloud.origins) == 1:
        return np.asarray(cloud.origins[0], np.float64)
    if cloud.scan is None:
        raise PlanewiseError(
            f"origin: the file says where {len(cloud.origins)} scanners stood, but not whose each "
            "point is; give x,y,z"
        )
    out: NDArray[np.float64] = memory.empty((len(cloud), 3))
    for first in range(0, len(cloud), BLOCK):
        scan = cloud.scan[first : first + BLOCK]
        if scan.min() < 0 or scan.max() >= len(cloud.origins):
            raise PlanewiseError(
                f"origin: points name scans {scan.min()} to {scan.max()}, but the file says of "
                f"{len(cloud.origins)} where they stood"
            )
        out[first : first + BLOCK] = cloud.origins[scan]
        memory.release()
    return out
