"""Write what was found in a point cloud: labelled points, numbers and a picture."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise._version import __version__
from planewise.clouds.memory import Memory
from planewise.drawing.palette import distinct_colours
from planewise.files.cloud_columns import COLOUR
from planewise.files.ply import write_ply
from planewise.model import PlaneModel
from planewise.outlines.outlines import Surface
from planewise.point_cloud import BLOCK, PointCloud, extent_of_most
from planewise.results.image import write_image
from planewise.results.planes_json import describe_cloud_model
from planewise.runtime import threads
from planewise.sensor import Sensor

_LAS = (".las", ".laz")
_NO_PLANE = (150, 152, 156)


def write_cloud_results(
    folder: Path,
    model: PlaneModel,
    *,
    cloud: PointCloud,
    sensor: Sensor,
    source: Path,
    las: bool = False,
    surfaces: Sequence[Surface] = (),
    memory: Memory | None = None,
) -> None:
    """Write ``labelled.ply``, ``planes.json``, ``preview.png`` and ``curve.png``.

    A LAS or LAZ file is copied as well, to ``labelled.las`` or ``labelled.laz``, with all that it
    holds and the dimension `plane`.

    Parameters
    ----------
    folder : Path
        Existing folder, as `planewise.whole_files.output_folder` gives it.
    model : PlaneModel
        What was found in the points of `cloud`.
    cloud, sensor
        What it was found in.
    source : Path
        File of the cloud.
    las : bool
        Write ``labelled.las`` of other files, too.
    surfaces : sequence of Surface
        Outlines to draw in the picture.
    memory : Memory, optional
        Where the points and labels lie.
    """
    from planewise.drawing.cloud import draw_cloud
    from planewise.drawing.curve import draw_curve

    def draw() -> None:
        write_image(folder / "preview.png", draw_cloud(cloud.points, model, surfaces=surfaces))
        write_image(folder / "curve.png", draw_curve(model.curve))

    memory = memory or Memory()
    with threads.beside(draw):
        record = describe_cloud_model(model, cloud=cloud, sensor=sensor, source=source.name)
        text = json.dumps(record, indent=2, allow_nan=False) + "\n"
        (folder / "planes.json").write_text(text, encoding="utf-8")
        _write_ply(folder / "labelled.ply", cloud, model, memory)
        ending = source.suffix.lower()
        if ending in _LAS:
            from planewise.files.las import copy_with_planes

            copy_with_planes(source, folder / f"labelled{ending}", model.labels)
        elif las:
            _write_las(folder / "labelled.las", cloud, model, memory)


def plane_colours(model: PlaneModel) -> NDArray[np.uint8]:
    """Colour of each label, grey for none, shape (N + 1, 3)."""
    return np.vstack((np.array([_NO_PLANE], np.uint8), distinct_colours(len(model))[: len(model)]))


def _rows(cloud: PointCloud, memory: Memory) -> Iterator[slice]:
    for first in range(0, len(cloud), BLOCK):
        yield slice(first, first + BLOCK)
        memory.release()


def _write_ply(path: Path, cloud: PointCloud, model: PlaneModel, memory: Memory) -> None:
    colours = plane_colours(model)
    # Coordinates as the file has them; far from their origin single precision is too short.
    kind = np.float64 if cloud.offset.any() else cloud.points.dtype

    def columns(rows: slice) -> dict[str, NDArray[Any]]:
        coordinates = (cloud.points[rows] + cloud.offset).astype(kind)
        labels = model.labels[rows]
        out: dict[str, NDArray[Any]] = {n: coordinates[:, k] for k, n in enumerate("xyz")}
        out |= {n: colours[labels, k] for k, n in enumerate(COLOUR)}
        out["plane"] = labels
        if cloud.intensity is not None:
            out["intensity"] = cloud.intensity[rows]
        return out

    comments = [f"planewise {__version__}: plane is the rank of the point's plane, 0 for none"]
    write_ply(path, len(cloud), map(columns, _rows(cloud, memory)), comments)


def _write_las(path: Path, cloud: PointCloud, model: PlaneModel, memory: Memory) -> None:
    from planewise.files.las import write_las

    colours = plane_colours(model)

    def part(rows: slice) -> tuple[PointCloud, NDArray[np.uint16], NDArray[np.uint8]]:
        intensity = None if cloud.intensity is None else cloud.intensity[rows]
        some = PointCloud(points=cloud.points[rows], offset=cloud.offset, intensity=intensity)
        return some, model.labels[rows], colours[model.labels[rows]]

    brightest = 0.0
    if cloud.intensity is not None:
        for rows in _rows(cloud, memory):
            brightest = max(brightest, float(np.nan_to_num(cloud.intensity[rows]).max()))
    bounds = extent_of_most(cloud.points)[0] + cloud.offset
    write_las(path, map(part, _rows(cloud, memory)), bounds, brightest)
