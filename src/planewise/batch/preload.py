"""Import and compiled code that workers are born with: the process they are forked from loads this.

Where workers are not forked, they load the same with their first frame.
"""

from __future__ import annotations

import numpy as np

from planewise.camera import PinholeCamera
from planewise.compilation import wait_for_help
from planewise.detect import detect_planes
from planewise.sensor import Sensor

_SIZE = 48  # pixels to a side of the frame that is searched


def _load() -> None:
    """Search a valley of two planes, which takes all the loops of the default detection."""
    across = np.abs(np.arange(_SIZE) - _SIZE // 2)
    depth = np.tile(1.0 / (0.5 + 0.005 * across), (_SIZE, 1))
    camera = PinholeCamera(fx=50.0, fy=50.0, cx=24.0, cy=24.0)
    detect_planes(depth, camera, Sensor(noise=0.002), threads=1)


_load()
wait_for_help()  # the process that is forked from complains of children that it did not start
