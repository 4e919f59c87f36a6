"""``planes.json``: in plain types what was found, in what and how."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise._version import __version__
from planewise.camera import Camera
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
            "file": _as_text(source),
            "width": width,
            "height": height,
            "depth_scale": float(depth_scale or sensor.resolution) if integer else None,
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
            "file": _as_text(source),
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


def _as_text(name: str) -> str:
    """Name of a file as valid Unicode, whatever bytes and locale it comes from."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def number_or_none(value: float) -> float | None:
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
        "significance": number_or_none(plane.significance),
        "residual_correlation": number_or_none(plane.residual_correlation),
        "area": number_or_none(plane.area),
        "centroid": plane.centroid.tolist(),
        "bounding_box": [int(edge) for edge in plane.bounding_box] or None,
        "covariance": covariance.tolist() if np.isfinite(covariance).all() else None,
    }
