"""Label images as small PNG files."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from planewise.drawing.overlay import borders
from planewise.drawing.palette import distinct_colours
from planewise.errors import needs
from planewise.reproduce.scores import like_the_truth
from planewise.reproduce.section import Picture
from planewise.scenes.scene import Scene

NO_PLANE = (38, 41, 46)
"""Colour of readings on no plane."""

BORDER = (255, 255, 255)
"""Colour of the lines between planes."""


def mask(scene: Scene, labels: NDArray[np.integer], name: str, title: str, note: str) -> Picture:
    """Picture of a label image: every true plane's own label in the same colour everywhere."""
    alt = f"Plane mask, {title}: {note}" if note else f"Plane mask, {title}"
    return Picture(
        name=name,
        alt=alt,
        png=_labels(like_the_truth(scene, labels)),
        title=title,
        note=note,
    )


def depth(scene: Scene, name: str) -> Picture:
    """Picture of a depth image, near bright."""
    z = np.asarray(scene.depth, np.float64)
    near, far = np.percentile(z, (0.5, 99.5))
    grey = 235 - 200 * np.clip((z - near) / max(far - near, 1e-9), 0, 1)
    metres = scene.sensor.resolution if scene.depth.dtype.kind != "f" else 1.0
    note = f"{metres * near:.2f} to {metres * far:.2f} m, near is bright"
    return Picture(
        name=name,
        alt=f"Depth image, {note}",
        png=_encoded(grey.round().astype(np.uint8)),
        title="depth image",
        note=note,
    )


def _labels(labels: NDArray[np.int64]) -> bytes:
    """PNG of labels with a palette; lines between planes, as not all eyes tell all colours."""
    line = 1 + min(int(labels.max(initial=0)), 254)
    image = np.minimum(labels, line - 1).astype(np.uint8)
    image[borders(labels)] = line
    palette = [*NO_PLANE, *distinct_colours(line - 1).ravel().tolist(), *BORDER]
    return _encoded(image, palette)


def _encoded(grey: NDArray[np.uint8], palette: list[int] | None = None) -> bytes:
    with needs("pillow", "the report", extra="reproduce"):
        from PIL import Image
    image = Image.fromarray(grey)
    if palette is not None:
        image.putpalette(palette)
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True)
    return out.getvalue()
