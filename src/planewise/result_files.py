"""Write a model to a folder: labels, numbers and pictures, all of them or none.

Files are made in a hidden folder and moved into place when all are complete, so that an error or
Ctrl-C leaves nothing half-written.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise._version import __version__
from planewise.camera import Camera
from planewise.errors import MissingExtraError, PlanewiseError
from planewise.model import Plane, PlaneModel
from planewise.point_cloud import PointCloud
from planewise.sensor import Sensor

SCHEMA_VERSION = 1
"""Version of the layout of ``planes.json``; raised when a reader has to change."""

SCHEMA_FILE = Path(__file__).with_name("planes.schema.json")
"""JSON Schema of ``planes.json``."""

CLOUD_FRAME = (
    "coordinates of the file less input.offset; normal . x + distance = 0 with distance >= 0"
)
"""What the coordinates of a point cloud's planes are."""

FILES = ("labels.png", "planes.json", "overlay.png", "curve.png")
"""What `write_results` writes."""


OUTLINE_FILES = ("outlines.json", "planes.obj", "planes.mtl", "planes.ply")
"""What `planewise.outline_files.write_outlines` writes."""


@contextmanager
def output_folder(target: str | Path) -> Iterator[Path]:
    """Give a folder to write to that becomes `target` when the block ends without error.

    Parameters
    ----------
    target : path
        Folder to make, with its parents. Where it exists, files of the same names are replaced and
        others stay.

    Yields
    ------
    Path
        Empty folder on the same file system.

    Raises
    ------
    PlanewiseError
        On entry, if the folder cannot be made or written to.
    """
    target = Path(target)
    made = [path for path in (target, *target.parents) if not path.exists()]
    # Inside an existing folder, which may be a file system of its own; else beside the new one.
    place = target if target.is_dir() else target.parent
    staging = place / f".{target.name}.{os.getpid()}.partial"
    try:
        if target.exists() and not target.is_dir():
            raise PlanewiseError(f"output: {target} exists and is not a folder")
        if target.exists() and not os.access(target, os.W_OK | os.X_OK):
            raise PlanewiseError(f"output: the folder {target} cannot be written to")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            staging.mkdir()
        except OSError as error:
            raise PlanewiseError(
                f"output: the folder {target} cannot be made ({error.strerror or error})"
            ) from None
        yield staging
        _publish(staging, target)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        _remove_empty(made[1:])
        raise


@contextmanager
def parent_folder(target: str | Path) -> Iterator[Path]:
    """Make a folder for the results of many frames; it goes again if it stays empty.

    Raises
    ------
    PlanewiseError
        On entry, if it cannot be made or written to.
    """
    target = Path(target)
    made = [path for path in (target, *target.parents) if not path.exists()]
    if target.exists() and not (target.is_dir() and os.access(target, os.W_OK | os.X_OK)):
        raise PlanewiseError(f"output: {target} is not a folder that can be written to")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PlanewiseError(
            f"output: the folder {target} cannot be made ({error.strerror or error})"
        ) from None
    try:
        yield target
    finally:
        _remove_empty(made)


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # not empty, or not there
            folder.rmdir()


def _publish(staging: Path, target: Path) -> None:
    if not target.exists():
        staging.rename(target)
        return
    for path in sorted(staging.iterdir()):
        path.replace(target / path.name)
    staging.rmdir()


def write_results(
    folder: Path,
    model: PlaneModel,
    *,
    depth: NDArray[Any],
    camera: Camera,
    sensor: Sensor,
    depth_scale: float | None = None,
    rgb: NDArray[np.uint8] | None = None,
    source: str = "",
) -> None:
    """Write ``labels.png``, ``planes.json``, ``overlay.png`` and ``curve.png``.

    Parameters
    ----------
    folder : Path
        Existing folder, as `output_folder` gives it.
    model : PlaneModel
        What was found.
    depth, camera, sensor, depth_scale
        What it was found in, as `planewise.detect_planes` took it.
    rgb : ndarray of uint8, shape (H, W, 3), optional
        Picture to draw the planes over; ``None`` means the shaded depth.
    source : str
        Name of the depth file.
    """
    from planewise.chart import draw_curve
    from planewise.draw import draw_overlay

    write_image(folder / "labels.png", model.labels)
    record = describe_model(
        model, camera=camera, sensor=sensor, depth=depth, depth_scale=depth_scale, source=source
    )
    text = json.dumps(record, indent=2, allow_nan=False) + "\n"
    (folder / "planes.json").write_text(text, encoding="utf-8")
    metres = depth_in_metres(depth, sensor, depth_scale)
    write_image(folder / "overlay.png", draw_overlay(model, metres, camera, rgb=rgb))
    write_image(folder / "curve.png", draw_curve(model.curve))


def write_image(path: Path, image: NDArray[Any]) -> None:
    """Write a PNG: uint16 as 16-bit grey, uint8 with a last axis of 3 as colour."""
    try:
        from PIL import Image
    except ImportError:
        raise MissingExtraError("pillow", "writing pictures") from None
    Image.fromarray(image).save(path, compress_level=3)


def depth_in_metres(
    depth: NDArray[Any], sensor: Sensor, depth_scale: float | None = None
) -> NDArray[np.float64]:
    """Convert readings to metres, NaN where there is none or it is out of the sensor's range."""
    scale = 1.0 if depth.dtype.kind == "f" else depth_scale or sensor.resolution
    z = depth * scale
    with np.errstate(invalid="ignore"):
        valid = (z > 0) & (z >= sensor.min_depth) & (z <= sensor.max_depth * (1 + 1e-9))
    return np.where(valid, z, np.nan)


def describe_model(
    model: PlaneModel,
    *,
    camera: Camera,
    sensor: Sensor,
    depth: NDArray[Any],
    depth_scale: float | None = None,
    source: str = "",
) -> dict[str, Any]:
    """Say in plain types what was found, in what and how: the content of ``planes.json``.

    Parameters
    ----------
    model, camera, sensor, depth, depth_scale, source
        As in `write_results`.

    Returns
    -------
    dict
        Valid against the schema in `SCHEMA_FILE`; lengths in metres, information in nats.
    """
    height, width = model.labels.shape
    integer = depth.dtype.kind != "f"
    return _describe(
        model,
        sensor,
        frame=f"{camera.frame}; normal . x + distance = 0 with distance >= 0",
        camera=camera.describe(),
        what={
            "file": source,
            "width": width,
            "height": height,
            "depth_scale": (depth_scale or sensor.resolution) if integer else None,
        },
    )


def describe_cloud_model(
    model: PlaneModel, *, cloud: PointCloud, sensor: Sensor, source: str = ""
) -> dict[str, Any]:
    """Say in plain types what was found in a point cloud: the content of its ``planes.json``.

    Parameters
    ----------
    model : PlaneModel
        Of the points of `cloud`, in their coordinates.
    cloud, sensor
        What it was found in.
    source : str
        Name of the cloud's file.

    Returns
    -------
    dict
        Valid against the schema in `SCHEMA_FILE`; lengths in metres, information in nats.
    """
    return _describe(
        model,
        sensor,
        frame=CLOUD_FRAME,
        camera=None,
        what={
            "file": source,
            "points": len(cloud),
            "offset": cloud.offset.tolist(),
            "origins": None if cloud.origins is None else cloud.origins.tolist(),
        },
    )


def _describe(
    model: PlaneModel,
    sensor: Sensor,
    *,
    frame: str,
    camera: dict[str, Any] | None,
    what: dict[str, Any],
) -> dict[str, Any]:
    return {
        "schema": "planewise/planes",
        "schema_version": SCHEMA_VERSION,
        "planewise_version": __version__,
        "units": {"length": "metre", "area": "square metre", "information": "nat"},
        "frame": frame,
        "input": what,
        "camera": camera,
        "sensor": sensor.describe(),
        "options": dict(model.settings),
        "readings": model.readings,
        "information": model.information,
        "curve": {
            "information": list(model.curve),
            "chosen": model.curve.chosen,
            "reason": model.curve.reason,
            "moves": [
                {"kind": move.kind, "planes": move.planes, "information": move.information}
                for move in model.curve.moves
            ],
        },
        "note": model.note,
        "planes": [
            _describe_plane(plane, rank, model.readings)
            for rank, plane in enumerate(model.planes, start=1)
        ],
    }


def _number_or_none(value: float) -> float | None:
    """The number, or what JSON has for NaN."""
    return float(value) if math.isfinite(value) else None


def _describe_plane(plane: Plane, rank: int, readings: int) -> dict[str, Any]:
    covariance = np.asarray(plane.covariance)
    return {
        "label": rank,
        "normal": plane.normal.tolist(),
        "distance": float(plane.distance),
        "information": float(plane.information),
        "mean_information": float(plane.mean_information),
        "readings": int(plane.count),
        "share": plane.count / readings,
        "rms": float(plane.rms),
        "significance": _number_or_none(plane.significance),
        "residual_correlation": _number_or_none(plane.residual_correlation),
        "area": _number_or_none(plane.area),
        "centroid": plane.centroid.tolist(),
        "bounding_box": [int(edge) for edge in plane.bounding_box] or None,
        "covariance": covariance.tolist() if np.isfinite(covariance).all() else None,
    }
