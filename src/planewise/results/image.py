"""What is written of the planes of an image: labels, numbers and pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Camera
from planewise.errors import needs
from planewise.model import PlaneModel
from planewise.results.planes_json import describe_model
from planewise.runtime import threads
from planewise.sensor import Sensor


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
        Existing folder, as `planewise.whole_files.output_folder` gives it.
    model : PlaneModel
        What was found.
    depth, camera, sensor, depth_scale
        What it was found in, as `planewise.detect_planes` took it.
    rgb : ndarray of uint8, shape (H, W, 3), optional
        Picture to draw the planes over; ``None`` means the shaded depth.
    source : str
        Name of the depth file.
    """
    from planewise.drawing.curve import draw_curve
    from planewise.drawing.overlay import draw_overlay

    def write_curve() -> None:
        write_image(folder / "curve.png", draw_curve(model.curve))

    with threads.beside(write_curve):
        write_image(folder / "labels.png", model.labels)
        record = describe_model(
            model, camera=camera, sensor=sensor, depth=depth, depth_scale=depth_scale, source=source
        )
        text = json.dumps(record, indent=2, allow_nan=False) + "\n"
        (folder / "planes.json").write_text(text, encoding="utf-8")
        metres = depth_in_metres(depth, sensor, depth_scale)
        write_image(folder / "overlay.png", draw_overlay(model, metres, camera, rgb=rgb))


def write_image(path: Path, image: NDArray[Any]) -> None:
    """Write a PNG: uint16 as 16-bit grey, uint8 with a last axis of 3 as colour."""
    with needs("pillow", "writing pictures"):
        from PIL import Image
    # A twentieth larger than at level 3, in two thirds of the time.
    Image.fromarray(image).save(path, compress_level=1)


def depth_in_metres(
    depth: NDArray[Any], sensor: Sensor, depth_scale: float | None = None
) -> NDArray[np.float64]:
    """Convert readings to metres, NaN where there is none or it is out of the sensor's range."""
    scale = 1.0 if depth.dtype.kind == "f" else depth_scale or sensor.resolution
    z = depth * scale
    with np.errstate(invalid="ignore"):
        valid = (z > 0) & (z >= sensor.min_depth) & (z <= sensor.max_depth * (1 + 1e-9))
    return np.where(valid, z, np.nan)
