"""A depth image whose planes are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Camera
from planewise.sensor import Sensor

Array = NDArray[np.float64]
Seed = int | np.random.Generator


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class Scene:
    """A depth image whose planes are known.

    Attributes
    ----------
    depth : ndarray of uint16, shape (H, W)
        Readings in millimetres, or float metres for scenes made with ``quantise=False``; 0 where
        there is none.
    camera : Camera
        Its rays.
    sensor : Sensor
        Its range, resolution and true noise; it leaves out the steps that readings of a `room`
        fall into.
    labels : ndarray of uint16, shape (H, W)
        True plane of every pixel that has a reading: 0 for none, j for ``planes[j - 1]``.
    planes : ndarray, shape (N, 4)
        Rows (normal, distance) with normal . x + distance = 0 and distance >= 0.
    rgb : ndarray of uint8, shape (H, W, 3)
        Shaded picture of the scene.
    """

    depth: NDArray[np.uint16] | Array
    camera: Camera
    sensor: Sensor
    labels: NDArray[np.uint16]
    planes: Array
    rgb: NDArray[np.uint8]

    def found(self, labels: NDArray[np.integer], *, overlap: float = 0.5) -> NDArray[np.bool_]:
        """Which of the true planes another labelling contains.

        Parameters
        ----------
        labels : ndarray of int, shape (H, W)
            0 for no plane.
        overlap : float
            Intersection over union above which two regions are the same plane; from 0.5 on no
            region can count twice.

        Returns
        -------
        ndarray of bool, shape (N,)
            True where some region overlaps the true plane by more than `overlap`.
        """
        truth, other = self.labels.astype(np.int64), labels.astype(np.int64)
        width = int(other.max(initial=0)) + 1
        joint = np.bincount(
            (truth * width + other).ravel(), minlength=(len(self.planes) + 1) * width
        )
        joint = joint.reshape(-1, width)
        union = joint.sum(axis=1)[1:, None] + joint.sum(axis=0)[None, 1:] - joint[1:, 1:]
        ratio = joint[1:, 1:] / np.maximum(union, 1)
        return np.asarray(ratio.max(axis=1, initial=0.0) > overlap)
