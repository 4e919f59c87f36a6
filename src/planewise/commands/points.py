"""The command `points`: the planes of a point cloud."""

from __future__ import annotations

import time
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from planewise.cloud_image import CloudImage, image_of_cloud
from planewise.clouds.memory import Disk, Memory
from planewise.commands import terminal
from planewise.commands.command_line import check_kept, check_seed, reported
from planewise.commands.shared_options import (
    Outlines,
    Output,
    Seed,
    Threads,
    optional,
)
from planewise.errors import PlanewiseError
from planewise.files.camera import read_length
from planewise.files.result_names import CLOUD_FILES, LAS_FILES, OUTLINE_FILES, stale_files
from planewise.machine import installed_memory
from planewise.model import PlaneModel
from planewise.noise import AUTO, Auto
from planewise.outlines.outlines import Surface, load_shapely
from planewise.point_cloud import CloudFile, PointCloud, extent_of_most
from planewise.runtime.threads import allowed, chosen
from planewise.sensor import Sensor
from planewise.whole_files import output_folder
from planewise.wording import counted

Coordinates = NDArray[np.float64]

_ABSURD = 100.0  # times the extent of a cloud that no scanner is away from it
_FAR_OFF = 2.0  # times sigma: worth saying
_LARGEST = 1e8  # metres that points may lie apart
_FARTHEST = 1e12  # metres from zero, beyond which numbers of 64 bits tell no millimetres
_FROM_FILE = "file"  # as of `detect_planes_in_cloud`
_AUTO = "auto"
_NEEDED = 200  # bytes of memory that a point takes in one piece
_SHORTEST_LINE = 20  # bytes of a point in a text file
_RESOLUTION = 0.001  # metres; eps of the paper, as for depth images


class Taken(StrEnum):
    """`--as`."""

    auto = "auto"
    image = "image"
    points = "points"


def points(
    cloud: Annotated[
        Path,
        typer.Argument(
            metavar="CLOUD",
            show_default=False,
            help="Point cloud: PLY, PCD, PTX, XYZ, TXT, CSV, PTS, .npy, .npz, and with the "
            "extra 'cloud' LAS, LAZ and E57. Metres, z up.",
        ),
    ],
    output: Output,
    sigma: Annotated[
        str,
        typer.Option(
            metavar="auto|LENGTH",
            help="Standard deviation of a point from its surface: 0.01 (metres) or 10mm. 'auto': "
            "estimated from the points.",
        ),
    ] = _AUTO,
    origin: Annotated[
        str | None,
        optional(
            "Where the scanner stood: x,y,z in the file's coordinates, or 'file' for what the file "
            "says. Points then lie on its rays, and sigma is along them."
        ),
    ] = None,
    resolution: Annotated[float, typer.Option(help="Step between two readings in metres.")] = (
        _RESOLUTION
    ),
    taken: Annotated[
        Taken,
        typer.Option(
            "--as",
            help="Points of one depth image may be searched as that image, which tells their "
            "planes better. 'auto': where that is what they are, and sigma is 'auto', too.",
        ),
    ] = Taken.auto,
    max_planes: Annotated[int | None, optional("Largest number of planes. Default: none.")] = None,
    seed: Seed = 0,
    threads: Threads = None,
    outlines: Outlines = False,
    instances: Annotated[
        bool,
        typer.Option("--instances", help="With --outlines: each connected piece on its own."),
    ] = False,
    tiles: Annotated[
        str,
        typer.Option(
            metavar="auto|N",
            help="Points of a tile, for clouds larger than memory; with some thousands "
            "the result is the same. 'auto': none while the cloud fits into half of the memory at "
            "200 bytes a point.",
        ),
    ] = _AUTO,
    las: Annotated[
        bool, typer.Option("--las", help="Write labelled.las, too; done anyway for LAS and LAZ.")
    ] = False,
) -> None:
    """Find the planes of a point cloud.

    Writes labelled.ply (plane of each point), planes.json and two pictures.

    For LAS and LAZ there is a copy with the dimension 'plane', too.
    """
    with reported():
        check_seed(seed)
        if instances and not outlines:
            raise PlanewiseError(
                "instances: outlines are what it tells apart; give --outlines, too"
            )
        noise = _noise(sigma)
        place = None if origin is None else _check_origin(origin)

        from planewise.detect_in_cloud import points_on_disk
        from planewise.files.cloud import open_cloud
        from planewise.results.cloud import write_cloud_results

        stale = stale_files(output)
        written = (*CLOUD_FILES, *LAS_FILES, *OUTLINE_FILES, *stale)
        check_kept([output / name for name in written], [cloud])
        if outlines:
            load_shapely()
        if las:
            from planewise.files.las import load_laspy

            load_laspy("writing .las files")
        file = open_cloud(cloud)
        tile_points = _tile_points(tiles, file)
        if tile_points and taken == Taken.image:
            raise PlanewiseError("as: an image is searched in one piece, without --tiles")
        with output_folder(output, stale) as folder:
            memory = Disk(folder) if tile_points else Memory()
            read = points_on_disk(file, memory) if isinstance(memory, Disk) else file.read()
            if step := read.rounding:
                terminal.warning(
                    f"coordinates of {cloud.name} were rounded to {step:.3g} m by numbers of 32 "
                    "bits, and planes may be of these steps: write it with 64 bits, or with "
                    "coordinates less an offset"
                )
            if file.unit:
                terminal.warning(
                    f"coordinates of {cloud.name} are in {file.unit}, and taken for metres: "
                    "lengths here and in the files are as the file counts them, and normals are "
                    "right only where its three axes share a unit"
                )
            box = _extent(read)
            stood = None if origin is None else _origin(place, read, box, memory)
            seen = None
            if taken != Taken.points and not tile_points:
                seen = _depth_image(read, stood, needed=taken == Taken.image)
            image = seen if taken == Taken.image or noise == AUTO else None
            # R of the paper: the diagonal of the box, which no coordinate exceeds; points in one
            # place have none, and are not refused for it.
            extent = float(np.linalg.norm(np.ptp(box, axis=0))) or 10 * resolution
            sensor = Sensor(max_depth=extent, resolution=resolution, noise=noise)
            options: dict[str, Any] = {"max_planes": max_planes, "rng": seed, "threads": threads}
            if tile_points:
                options |= {"tile_points": tile_points, "folder": folder}
            model, seconds = _find(read if image is None else image, sensor, stood, options)
            if origin is not None:
                told_origin = _FROM_FILE if place is None else place.tolist()
                model = replace(model, settings={**model.settings, "origin": told_origin})
            surfaces: tuple[Surface, ...] = ()
            if outlines:
                from planewise.outlines.cloud import outline_points
                from planewise.results.outlines import write_outlines

                surfaces = outline_points(model, read.points, instances=instances)
                write_outlines(folder, surfaces, frame="the cloud file's", offset=read.offset)
            with allowed(chosen(threads)):
                write_cloud_results(
                    folder,
                    model,
                    cloud=read,
                    sensor=sensor,
                    source=cloud,
                    las=las,
                    surfaces=surfaces,
                    memory=memory,
                )
        terminal.show_planes(model)
        if len(model) and read.offset.any():
            place_of = " ".join(f"{each:.0f}" for each in read.offset)
            terminal.say(f"distances are from {place_of}, which is subtracted from coordinates")
        if isinstance(told := model.settings.get("noise"), dict):
            terminal.say(f"sigma = {told['noise']}, {told['source']}")
        elif model.settings.get("sigma_factor", 1.0) > _FAR_OFF:  # type: ignore[operator]
            terminal.warning(
                f"sigma: points lie {model.settings['sigma_factor']:.1f} times as far from planes, "
                "which was taken instead; volumes of points, such as crowns, look like this, too"
            )
        terminal.show_summary(model, seconds, output)
        if seen is not None:
            height, width = seen.depth.shape
            terminal.say(
                f"these are points of one depth image, {width} x {height} pixels, "
                + (
                    "and searched as that; '--as points' takes them as points"
                    if image
                    else "and '--as image' tells its planes better"
                )
            )


def _depth_image(cloud: PointCloud, origin: Coordinates | None, needed: bool) -> CloudImage | None:
    """The depth image whose points a cloud has, seen from where its camera may have stood.

    That is where it is said to have been, or where the file says, or where its coordinates begin.

    Raises
    ------
    PlanewiseError
        Why there is none, if one is needed.
    """
    places = [-cloud.offset] if origin is None else [origin]
    if origin is None and cloud.origins is not None and len(cloud.origins) == 1:
        (said,) = cloud.origins
        places = places if np.array_equal(said, places[0]) else [said, *places]
    reasons = []
    for place in places:
        try:
            return image_of_cloud(cloud.points, place)
        except ValueError as error:
            reasons.append(str(error))
    if needed:
        raise PlanewiseError(f"as: {reasons[0]}")
    return None


def _noise(text: str) -> float | Auto:
    """Standard deviation that is asked for."""
    if text == _AUTO:
        return AUTO
    sigma = read_length(text)
    if sigma is None or not 0 < sigma < float("inf"):
        raise PlanewiseError(
            f"sigma must be a positive length, such as 0.01 (metres) or 10mm, or '{_AUTO}', "
            f"got '{text}'"
        )
    return sigma


def _tile_points(text: str, file: CloudFile) -> int:
    """Points of a tile; 0 for the cloud in one piece."""
    from planewise.detect_in_cloud import TILE_POINTS

    if text == _AUTO:
        count = file.count
        if count is None:
            count = file.path.stat().st_size // _SHORTEST_LINE
        memory = installed_memory()
        return TILE_POINTS if memory and _NEEDED * count > memory // 2 else 0
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise PlanewiseError(
            f"tiles must be a number of points, such as 4000000, or '{_AUTO}', got '{text}'"
        )
    return number


def _check_origin(text: str) -> Coordinates | None:
    """Place that is asked for; None for the one in the file."""
    if text == _FROM_FILE:
        return None
    try:
        place = np.array([float(word) for word in text.split(",")])
    except ValueError:
        place = np.empty(0)
    if place.shape != (3,) or not (np.abs(place) <= _FARTHEST).all():
        raise PlanewiseError(
            f"origin must be x,y,z in metres, at most {_FARTHEST:g}, or '{_FROM_FILE}' for the "
            f"file's own, got '{text}'"
        )
    return place


def _origin(
    place: Coordinates | None, cloud: PointCloud, box: Coordinates, memory: Memory
) -> Coordinates:
    """Where the scanner stood, relative to the cloud's offset: (3,), or (k, 3) for many scans."""
    from planewise.detect_in_cloud import origins_of

    if place is None:
        return origins_of(cloud, memory)
    origin = np.asarray(place - cloud.offset)
    away = float(np.linalg.norm(origin - np.clip(origin, *box)))
    if away > _ABSURD * np.linalg.norm(np.ptp(box, axis=0)):
        terminal.warning(
            f"origin: that is {away:,.0f} m from the points; it has to be in the file's coordinates"
        )
    return origin


def _extent(cloud: PointCloud) -> Coordinates:
    """Least and largest coordinates of the points but for strays, shape (2, 3)."""
    box, strays = extent_of_most(cloud.points)
    if strays:
        terminal.warning(
            f"left out: {counted(strays, 'point')}, a hundred times as far off as most others; "
            "missing ones, such as 0, 0, 0?"
        )
    with np.errstate(over="ignore"):
        sides = np.ptp(box, axis=0).astype(np.float64)
        farthest = np.abs(box + cloud.offset).max()
    if not sides.max() <= _LARGEST:
        raise PlanewiseError(
            f"cloud: its points are up to {sides.max():.3g} m apart, more than the earth is wide; "
            "expected metres"
        )
    if farthest > _FARTHEST:
        raise PlanewiseError(
            f"cloud: it lies {farthest:.3g} m from the origin of its coordinates; expected metres"
        )
    return box


def _find(
    cloud: PointCloud | CloudImage,
    sensor: Sensor,
    origin: Coordinates | None,
    options: dict[str, Any],
) -> tuple[PlaneModel, float]:
    from planewise.detect import detect_planes_in_points
    from planewise.detect_in_cloud import detect_planes_in_cloud
    from planewise.options import Options
    from planewise.search import find_in_image

    started = time.perf_counter()
    if isinstance(cloud, CloudImage):
        model = find_in_image(cloud, sensor, Options(**options).resolved(spatial=True))
        return model, time.perf_counter() - started
    if origin is not None:
        options = {**options, "origin": origin}
    if "tile_points" in options:
        model = detect_planes_in_cloud(cloud, sensor, **options)
    else:
        model = detect_planes_in_points(cloud.points, sensor, as_image=False, **options)
    return model, time.perf_counter() - started
