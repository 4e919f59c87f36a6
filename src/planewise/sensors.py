"""Presets of depth sensors and LiDAR that people own, each with the source of its numbers.

A data sheet states limits, not your device: where you can, estimate the noise of your own sensor
(``planewise calibrate``) and `load` it.
Depth cameras report millimetres, which is their resolution; LiDAR have steps of their own, and
their depth is range. How much of its error a sensor's neighbouring readings share was measured for
the Kinect only; for the others each frame tells.
"""

from __future__ import annotations

from planewise import noise
from planewise.sensor import Sensor
from planewise.sensor_files import load, save

__all__ = [
    "AZURE_KINECT",
    "FEMTO_BOLT",
    "GEMINI_2_XL",
    "IPHONE_LIDAR",
    "KINECT_V1",
    "KINECT_V2",
    "NYU",
    "OUSTER_OS0",
    "OUSTER_OS1",
    "PRESETS",
    "REALSENSE_D415",
    "REALSENSE_D435",
    "REALSENSE_D455",
    "STRUCTURE",
    "VELODYNE_HDL32E",
    "VELODYNE_HDL64E",
    "VELODYNE_VLP16",
    "VELODYNE_VLS128",
    "load",
    "save",
]


KINECT_V1 = Sensor(max_depth=10.0, resolution=0.001, noise=noise.KINECT, parts=noise.KINECT_PARTS)
"""Microsoft Kinect for Xbox 360 and Asus Xtion. Noise: axial model of Nguyen, Izadi and Lovell,
"Modeling Kinect sensor noise for improved 3D reconstruction and tracking", 3DIMPVT 2012, which the
paper uses. Range: NYU-v2 stores depths up to 10 m."""

NYU = KINECT_V1
"""The sensor of NYU-v2 is a Kinect v1."""

KINECT_V2 = Sensor(
    min_depth=0.5, max_depth=4.5, resolution=0.001, noise=noise.quadratic(0.0013, 0.0003, 0.8)
)
"""Microsoft Kinect for Xbox One, 0.5-4.5 m. Noise: within 2 % of the axial model of Fankhauser et
al., "Kinect v2 for mobile robot navigation", ICAR 2015, 1.5 - 0.5 z + 0.3 z^2 mm, on surfaces that
face it; wiggling is told by each frame (`planewise.waves`). Drivers may give up to 8 m
(``dataclasses.replace(KINECT_V2, max_depth=8.0)``)."""

AZURE_KINECT = Sensor(
    min_depth=0.5, max_depth=5.46, resolution=0.001, noise=noise.Polynomial(0.011, 0.001)
)
"""Microsoft Azure Kinect DK. Hardware specification: 0.5-3.86 m (unbinned) to 5.46 m (binned),
random error at most 17 mm, systematic error below 11 mm + 0.1 % of the distance; the latter is
taken as sigma, since measured random errors (Toelgyessy et al., Sensors 2021) are far lower."""

FEMTO_BOLT = AZURE_KINECT
"""Orbbec Femto Bolt. Hardware specification: its depth camera is Microsoft's, with the modes and
ranges of the Azure Kinect; noise as of that one."""

REALSENSE_D415 = Sensor(
    min_depth=0.3,
    max_depth=10.0,
    resolution=0.001,
    noise=noise.stereo(focal=1005.0, baseline=0.055),
)
"""Intel RealSense D415. D400 series datasheet: baseline 55 mm, horizontal field of view 65 degrees,
hence 1,005 px at 1280 x 720; ideal from 0.3 m. Noise: stereo formula of Intel's tuning guide."""

REALSENSE_D435 = Sensor(
    min_depth=0.2, max_depth=10.0, resolution=0.001, noise=noise.stereo(focal=447.0, baseline=0.050)
)
"""Intel RealSense D435 and D435i. D400 series datasheet: baseline 50 mm, horizontal field of view
87 degrees, hence 447 px at 848 x 480. Noise: stereo formula of Intel's tuning guide."""

REALSENSE_D455 = Sensor(
    min_depth=0.4, max_depth=10.0, resolution=0.001, noise=noise.stereo(focal=447.0, baseline=0.095)
)
"""Intel RealSense D455. D400 series datasheet: baseline 95 mm, horizontal field of view 87 degrees,
hence 447 px at 848 x 480. Noise: stereo formula of Intel's tuning guide."""

GEMINI_2_XL = Sensor(
    min_depth=0.4, max_depth=20.0, resolution=0.001, noise=noise.proportional(0.01)
)
"""Orbbec Gemini 2 XL, 0.4-20 m. Noise: the paper's proportional model, sigma = 0.01 z, which it
derives from this sensor's and the D435's data sheets."""

STRUCTURE = Sensor(
    min_depth=0.4, max_depth=5.0, resolution=0.001, noise=noise.quadratic(0.0, 0.0033)
)
"""Occipital Structure Sensor. Data sheet: precision 0.5 mm at 0.4 m and 30 mm at 3 m, that is
0.0033 z^2."""

IPHONE_LIDAR = Sensor(max_depth=5.0, resolution=0.001, noise=noise.constant(0.01))
"""Apple iPhone and iPad Pro LiDAR (256 x 192 depth map of ARKit). Range 5 m, accuracy +-1 cm
(Luetzenburg, Kroon, Bjoerk, Scientific Reports 2021)."""

OUSTER_OS0 = Sensor(min_depth=0.3, max_depth=50.0, resolution=0.001, noise=noise.constant(0.03))
"""Ouster OS0: 0.3-50 m, resolution 1 mm. Noise: as of the OS1, its kin."""

OUSTER_OS1 = Sensor(min_depth=0.8, max_depth=120.0, resolution=0.012, noise=noise.constant(0.03))
"""Ouster OS1. Data sheet of the first generation: 0.8-120 m, range resolution 1.2 cm, one standard
deviation of 1.5 cm with a strong and 3 cm with a fair signal, of which the latter is taken; later
ones report millimetres (give ``resolution=0.001``)."""

VELODYNE_VLP16 = Sensor(
    min_depth=0.5, max_depth=100.0, resolution=0.002, noise=noise.constant(0.03)
)
"""Velodyne VLP-16. User manual: up to 100 m, steps of 2 mm, accuracy +-3 cm (typical)."""

VELODYNE_HDL32E = Sensor(
    min_depth=0.5, max_depth=100.0, resolution=0.002, noise=noise.constant(0.02)
)
"""Velodyne HDL-32E. User manual: up to 100 m, steps of 2 mm, accuracy +-2 cm (one sigma)."""

VELODYNE_HDL64E = Sensor(
    min_depth=0.9, max_depth=120.0, resolution=0.002, noise=noise.constant(0.02)
)
"""Velodyne HDL-64E. User manual: up to 120 m, steps of 2 mm, accuracy below 2 cm (one sigma)."""

VELODYNE_VLS128 = Sensor(
    min_depth=0.5, max_depth=245.0, resolution=0.004, noise=noise.constant(0.03)
)
"""Velodyne VLS-128 (Alpha Prime). Data sheet: up to 245 m, steps of 4 mm, accuracy +-3 cm
(typical)."""

PRESETS: dict[str, Sensor] = {
    "kinect-v1": KINECT_V1,
    "nyu": NYU,
    "kinect-v2": KINECT_V2,
    "azure-kinect": AZURE_KINECT,
    "femto-bolt": FEMTO_BOLT,
    "realsense-d415": REALSENSE_D415,
    "realsense-d435": REALSENSE_D435,
    "realsense-d455": REALSENSE_D455,
    "gemini-2-xl": GEMINI_2_XL,
    "structure": STRUCTURE,
    "iphone-lidar": IPHONE_LIDAR,
    "ouster-os0": OUSTER_OS0,
    "ouster-os1": OUSTER_OS1,
    "velodyne-vlp16": VELODYNE_VLP16,
    "velodyne-hdl32e": VELODYNE_HDL32E,
    "velodyne-hdl64e": VELODYNE_HDL64E,
    "velodyne-vls128": VELODYNE_VLS128,
}
"""Names of the presets at the command line."""
