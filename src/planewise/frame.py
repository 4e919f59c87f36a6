"""A depth frame for the spatial search: images of inverse depth, and its error by depth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planewise.camera import PinholeCamera
from planewise.kernels.cells import UNIT
from planewise.observation import RayObservation
from planewise.workspace import Workspace

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_UNKNOWN_SHARED, _UNKNOWN_DRIFT = 2 / 3, 7 / 3  # of the noise, as the Kinect's, where not known


@dataclass(frozen=True)
class ErrorTable:
    """Variances of inverse depth, in 1 / m^2, by depth.

    A row between depths that occur is that of the next nearer one.

    Attributes
    ----------
    per_metre : float
        Rows per metre of depth: the row of inverse depth w is round(per_metre / w).
    white, shared, drift, step : ndarray, shape (L,)
        What is new in every reading, quantisation apart; what near readings share; how far that
        drifts over 100 pixels; and quantisation.
    """

    per_metre: float
    white: Array
    shared: Array
    drift: Array
    step: Array

    def rows(self, w: NDArray[np.floating]) -> NDArray[np.intp]:
        """Row of every inverse depth w > 0."""
        place = np.rint(self.per_metre / np.asarray(w, np.float64)).astype(np.intp)
        return np.asarray(np.minimum(place, len(self.step) - 1))


@dataclass(frozen=True)
class Frame:
    """Images (H, W) of an observation; where there is no reading `w` and `p` are zero.

    Attributes
    ----------
    w, p : ndarray of float32
        Inverse depth in 1 / m, and one over the variance of what is new in every reading.
    x, y : ndarray of float32
        Undistorted pixel coordinates about the principal point, divided by 100.
    table : ErrorTable
        All parts of the error.
    known : bool
        Whether shared and drift are what the sensor shows at most; else only their course over
        depth is taken from them, and their size from the frame.
    resolution : float
        Step between two readings in metres.
    """

    w: Image
    p: Image
    x: Image
    y: Image
    table: ErrorTable
    known: bool
    resolution: float


def frame_of(observation: RayObservation, workspace: Workspace | None = None) -> Frame:
    """Images of the readings in inverse depth."""
    workspace = workspace or Workspace()
    image, parts = observation.image, observation.sensor.parts
    z = image.depth
    quarter = 1.0 / z**4
    if parts is None:
        white = observation.level_sigma
        shared, drift = _UNKNOWN_SHARED * white, _UNKNOWN_DRIFT * white
    else:
        white, shared, drift = (np.asarray(f(z)) for f in (parts.white, parts.shared, parts.drift))
    by_level = np.empty((4, z.size))
    for row, deviation in zip(by_level, (white, shared, drift, image.steps()), strict=True):
        np.multiply(deviation * deviation, quarter, out=row)
    by_level[3] /= 12
    w: Image = workspace.empty("w", image.shape, np.float32)
    p: Image = workspace.empty("p", image.shape, np.float32)
    image.spread(1.0 / (by_level[0] + by_level[3]), w, p)

    # Rows up to the second level are those of the first one.
    ends = np.append(image.levels[1:], image.levels[-1] + 2)
    table = np.repeat(by_level, np.diff(ends, prepend=0), axis=1)
    x, y = _pixel_coordinates(observation.camera, image.shape)
    return Frame(
        w, p, x, y, ErrorTable(image.per_metre, *table), parts is not None, observation.resolution
    )


@lru_cache(maxsize=4)
def _pixel_coordinates(camera: PinholeCamera, shape: tuple[int, int]) -> tuple[Image, Image]:
    """Undistorted coordinates x and y of all pixels in units of 100 pixels."""
    u, v, _ = camera.ray_rows(shape).reshape(3, *shape)
    x, y = (u * (camera.fx / UNIT)).astype(np.float32), (v * (camera.fy / UNIT)).astype(np.float32)
    return x, y
