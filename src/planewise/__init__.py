"""Find every plane a depth image or point cloud can justify, how many there are, and rank them.

>>> import planewise as pw
>>> camera = pw.cameras.NYU
>>> sensor = pw.Sensor(max_depth=10.0, resolution=0.001, noise=pw.noise.proportional(0.01))

``pw.detect_planes(depth, camera, sensor)`` does everything; `Detector` is the same call for a
stream; `detect_planes_in_points` takes free points. The parts they are made of can be composed by
hand: `observe`, `information`, `find`.

Frame: x right, y down, z forward. Planes: normal . x + distance = 0, |normal| = 1, distance >= 0:
normals face the sensor, those of clouds the origin of their coordinates. Information in nats; that
of a plane is negative when it pays.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from planewise import cameras, noise, sensors
from planewise._version import __version__
from planewise.camera import Camera, PinholeCamera
from planewise.information import information
from planewise.model import Curve, Move, Plane, PlaneModel
from planewise.objective import Objective
from planewise.observation import observe
from planewise.point_observation import observe_points
from planewise.sensor import Sensor
from planewise.spherical import SphericalCamera

if TYPE_CHECKING:
    from planewise import batch, datasets, errors, metrics, partition, scenes
    from planewise.calibration.calibrate import calibrate
    from planewise.calibration.estimate import NoiseEstimate, estimate_noise
    from planewise.cloud_image import image_of_cloud
    from planewise.clouds.noise import CloudNoise, estimate_cloud_noise
    from planewise.detect import Detector, detect_planes, detect_planes_in_points
    from planewise.detect_in_cloud import detect_planes_in_cloud
    from planewise.files.cloud import open_cloud, read_cloud
    from planewise.options import Options
    from planewise.organised import image_of_points
    from planewise.outlines.cloud import outline_points
    from planewise.outlines.image import outline_image
    from planewise.paper.reassign import NormalReassignment
    from planewise.point_cloud import PointCloud
    from planewise.search import find

__all__ = [
    "Camera",
    "CloudNoise",
    "Curve",
    "Detector",
    "Move",
    "NoiseEstimate",
    "NormalReassignment",
    "Objective",
    "Options",
    "PinholeCamera",
    "Plane",
    "PlaneModel",
    "PointCloud",
    "Sensor",
    "SphericalCamera",
    "__version__",
    "batch",
    "calibrate",
    "cameras",
    "datasets",
    "detect_planes",
    "detect_planes_in_cloud",
    "detect_planes_in_points",
    "errors",
    "estimate_cloud_noise",
    "estimate_noise",
    "find",
    "image_of_cloud",
    "image_of_points",
    "information",
    "metrics",
    "noise",
    "observe",
    "observe_points",
    "open_cloud",
    "outline_image",
    "outline_points",
    "partition",
    "read_cloud",
    "scenes",
    "sensors",
]

# Numba takes longer to import than everything else together: it waits for the first detection.
_LAZY = {
    **dict.fromkeys(("Detector", "detect_planes", "detect_planes_in_points"), "detect"),
    "Options": "options",
    "find": "search",
    **dict.fromkeys(("NoiseEstimate", "estimate_noise"), "calibration.estimate"),
    "calibrate": "calibration.calibrate",
    "NormalReassignment": "paper.reassign",
    **dict.fromkeys(("CloudNoise", "estimate_cloud_noise"), "clouds.noise"),
    "PointCloud": "point_cloud",
    **dict.fromkeys(("open_cloud", "read_cloud"), "files.cloud"),
    "image_of_cloud": "cloud_image",
    "image_of_points": "organised",
    "outline_image": "outlines.image",
    "outline_points": "outlines.cloud",
    "detect_planes_in_cloud": "detect_in_cloud",
}


if not TYPE_CHECKING:  # by which a name that there is not would have a type

    def __getattr__(name: str) -> Any:
        if name in ("batch", "datasets", "errors", "metrics", "partition", "scenes"):
            return import_module(f"planewise.{name}")
        if name in _LAZY:
            return getattr(import_module(f"planewise.{_LAZY[name]}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
