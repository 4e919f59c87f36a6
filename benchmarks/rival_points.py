"""Frames as other detectors take them: points, depth in metres, one standard deviation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.frames import Frame

Labels = NDArray[np.integer]
Points = NDArray[np.float64]


@dataclass(frozen=True)
class Cloud:
    """Points of a frame, shape (k, 3), the pixels that have one, and sigma at the median depth."""

    points: Points
    there: NDArray[np.bool_]
    sigma: float

    @classmethod
    def of(cls, frame: Frame) -> Cloud:
        """Points of the readings within the sensor's range."""
        z = metres(frame)
        there = np.isfinite(z)
        points = (frame.camera.rays((z.shape[0], z.shape[1])) * z[..., None])[there]
        return cls(points, there, sigma_of(frame, z))

    def image(self, labels: NDArray[np.integer]) -> Labels:
        """Label image from labels of the points."""
        out = np.zeros(self.there.shape, np.int64)
        out[self.there] = labels
        return out


def labels_of_patches(boxes: Iterable[Any], points: Points, vector: Any) -> NDArray[np.int64]:
    """Of the boxes that hold a point, the nearest plane; vector: the points as Open3D has them."""
    labels, nearest = np.zeros(len(points), np.int64), np.full(len(points), np.inf)
    for label, box in enumerate(boxes, start=1):
        held = np.asarray(box.get_point_indices_within_bounding_box(vector), np.intp)
        distance = np.abs((points[held] - box.center) @ box.R[:, 2])
        closer = distance < nearest[held]
        nearest[held[closer]], labels[held[closer]] = distance[closer], label
    return labels


def metres(frame: Frame) -> NDArray[np.float64]:
    """Depth in metres, NaN where there is no reading."""
    z = np.asarray(frame.depth, np.float64)
    if not np.issubdtype(frame.depth.dtype, np.floating):
        z = z * (frame.depth_scale or frame.sensor.resolution)
    with np.errstate(invalid="ignore"):
        return np.where((z > 0) & (z <= frame.sensor.max_depth), z, np.nan)


def sigma_of(frame: Frame, z: NDArray[np.float64]) -> float:
    """Standard deviation of a reading at the median depth, metres."""
    return float(frame.sensor.sigma(np.array([np.nanmedian(z)]))[0])
