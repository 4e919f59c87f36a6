"""Outlines of the planes of a depth image: regions of pixels, laid on planes along the rays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import is_finite
from planewise.camera import Camera
from planewise.model import Plane, PlaneModel, checked_model
from planewise.outlines.label_borders import regions
from planewise.outlines.outlines import PlaneFrame, Surface, dot, load_shapely, surfaces_of
from planewise.own_camera import check_own, checked_camera

Array = NDArray[np.float64]

_BEYOND = 1.5  # how much further than its furthest pixel a corner of a region may lie
_STRAIGHT = 8.0  # pixels over which a distorted camera's straight lines are taken as straight


def outline_image(
    model: PlaneModel,
    camera: Camera,
    *,
    tolerance: float = 1.5,
    instances: bool = False,
    max_depth: float = math.inf,
) -> tuple[Surface, ...]:
    """Outline the planes of a depth image.

    The region of a plane's pixels, each a square, is cut out of the plane by the rays through its
    corners. Neighbouring planes keep a common border in the image.

    Parameters
    ----------
    model : PlaneModel
        Of a depth image.
    camera : Camera
        That took it.
    tolerance : float
        How far borders may be from those of the pixels, in pixels; 0 keeps every step, and pieces
        and holes that are nowhere wider than a pixel, which are left out otherwise.
    instances : bool
        One surface for each connected piece, numbered from the largest; otherwise one a plane.
    max_depth : float
        Metres; pixels whose ray meets the plane beyond are left out, at infinity none.

    Returns
    -------
    tuple of Surface
        By plane. One without polygons where no area is left, except with `instances`.

    Raises
    ------
    ValueError
        If the model is of no image, or the camera of another one, the tolerance is negative, or
        `max_depth` is not positive.
    MissingExtraError
        Without shapely (extra 'cloud').
    """
    if checked_model(model).labels.ndim != 2:
        raise ValueError(f"model must be of a depth image, got labels of {model.labels.shape}")
    if not (is_finite(tolerance) and tolerance >= 0):
        raise ValueError(f"tolerance must be a number of pixels, not negative, got {tolerance!r}")
    if not (max_depth == math.inf or (is_finite(max_depth) and max_depth > 0)):
        raise ValueError(f"max_depth must be a positive number of metres, got {max_depth!r}")
    height, width = model.labels.shape
    checked_camera(camera).check((height, width))
    check_own(camera, (height, width))
    rays = camera.ray_rows((height, width))
    theta = np.array([(0.0, 0.0, 0.0), *(_theta(plane) for plane in model.planes)])
    flat = model.labels.reshape(-1)
    near = np.einsum("ck,kc->k", rays, theta[flat])  # 1 / z on the pixel's plane
    seen = near > 1 / max_depth
    labels = np.where(seen, flat, 0)
    least = np.full(len(model) + 1, np.inf)
    np.minimum.at(least, flat[seen], near[seen])
    found = regions(labels.reshape(height, width), tolerance)

    shapely = load_shapely()
    out: list[Surface] = []
    for label, plane in enumerate(model.planes, start=1):
        frame = PlaneFrame.of(plane)

        def laid(pixels: Array, label: int = label, frame: PlaneFrame = frame) -> Array:
            at = camera.unproject(pixels)
            nearness = np.maximum(dot(at, theta[label]), least[label] / _BEYOND)
            return frame.to_plane(at / nearness[:, None])

        pieces = found.get(label, [])
        if camera.bends:
            pieces = shapely.segmentize(pieces, _STRAIGHT)
        pieces = [shapely.transform(piece, laid) for piece in pieces]
        sound = [each for piece in pieces for each in _valid(piece) if each.area > 0]
        out.extend(surfaces_of(label, frame, sound, instances=instances))
    return tuple(out)


def _theta(plane: Plane) -> Array:
    """theta . r = 1 / z on a plane: -n / d. Zero for one through the camera, which sees none."""
    return np.asarray(plane.normal / -plane.distance if plane.distance > 0 else np.zeros(3))


def _valid(piece: Any) -> list[Any]:
    """Polygons of a piece that its way to the plane may have folded at its furthest corners."""
    shapely = load_shapely()
    if shapely.is_valid(piece):
        return [piece]
    parts = shapely.get_parts(shapely.make_valid(piece, method="structure", keep_collapsed=False))
    return [each for each in parts if each.geom_type == "Polygon"]
