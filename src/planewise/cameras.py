"""Presets of depth cameras and LiDAR, each with the source of its numbers.

Of the depth cameras only `NYU` is a calibration. The others are nominal: what is usual for the
device where its docstring says so, else derived from the field of view in the maker's data sheet
(f = width / 2 / tan(fov / 2), principal point in the middle). A device knows its own intrinsics
better: read them from its driver (the command line takes a ROS ``camera_info`` file).

LiDAR have their highest beam first, what is ahead in the middle, and as many columns as at their
usual speed. Velodyne's beams are those of the makers' tables; Ouster's are spread evenly over the
field of view of the data sheet, which is nominal: each Ouster knows its own (the command line
takes its metadata file). From other resolutions:
`SphericalCamera.spinning(preset.elevation, columns)`.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.camera import Camera, PinholeCamera
from planewise.spherical import SphericalCamera


def from_field_of_view(width: int, height: int, horizontal: float) -> PinholeCamera:
    """Camera with square pixels, centred principal point and a given field of view.

    Parameters
    ----------
    width, height : int
        Pixels.
    horizontal : float
        Horizontal field of view in degrees, below 180.
    """
    if not 0 < horizontal < 180:
        raise ValueError(f"horizontal must lie between 0 and 180 degrees, got {horizontal}")
    focal = width / 2 / math.tan(math.radians(horizontal) / 2)
    return PinholeCamera(
        fx=focal,
        fy=focal,
        cx=(width - 1) / 2,
        cy=(height - 1) / 2,
        width=width,
        height=height,
    )


NYU = PinholeCamera(
    fx=518.857901, fy=519.469611, cx=325.582449, cy=253.736166, width=640, height=480
)
"""NYU-v2, colour camera, to which its labelled depth is registered (camera_params.m of its toolbox,
Silberman et al. 2012)."""

KINECT_V1 = PinholeCamera(fx=525.0, fy=525.0, cx=319.5, cy=239.5, width=640, height=480)
"""Kinect v1 and Xtion: the nominal values of the OpenNI drivers."""

KINECT_V2 = PinholeCamera(
    fx=365.456,
    fy=365.456,
    cx=254.878,
    cy=205.395,
    distortion=(0.0905474, -0.26819, 0.0, 0.0, 0.0950862),
    width=512,
    height=424,
)
"""Kinect v2 (Xbox One), raw depth: a factory calibration that many programs come with, typical.
Where the driver has undistorted depth, take it without the distortion."""

AZURE_KINECT = PinholeCamera(fx=504.0, fy=504.0, cx=319.5, cy=319.5, width=640, height=576)
"""Azure Kinect, NFOV unbinned: typical of factory calibrations (about 504 px), but for the
distortion, which moves corners by more than 100 pixels: give all eight coefficients of the device's
own."""

REALSENSE_D415 = from_field_of_view(1280, 720, 65.0)
"""RealSense D415 at 1280 x 720: 65 degrees (Intel D400 series datasheet)."""

REALSENSE_D435 = from_field_of_view(848, 480, 87.0)
"""RealSense D435 at 848 x 480: 87 degrees (Intel D400 series datasheet)."""

REALSENSE_D455 = from_field_of_view(848, 480, 87.0)
"""RealSense D455 at 848 x 480: 87 degrees (Intel D400 series datasheet)."""

GEMINI_2_XL = from_field_of_view(1280, 800, 91.0)
"""Gemini 2 XL at 1280 x 800: 91 degrees (Orbbec product page)."""

STRUCTURE = from_field_of_view(640, 480, 58.0)
"""Structure Sensor at 640 x 480: 58 degrees (Occipital data sheet)."""

IPHONE_LIDAR = PinholeCamera(fx=212.0, fy=212.0, cx=127.5, cy=95.5, width=256, height=192)
"""iPhone LiDAR depth map, 256 x 192: typical ARKit intrinsics of the wide camera, scaled."""

PAPER = PinholeCamera(fx=500.0, fy=500.0, cx=320.0, cy=240.0, width=640, height=480)
"""The camera of the paper's synthetic scenes."""


def evenly_spread(beams: int, field_of_view: float, columns: int = 1024) -> SphericalCamera:
    """Spinning LiDAR whose beams are spread evenly about the horizon.

    Parameters
    ----------
    beams, columns : int
        Rows of its images, and columns to a turn.
    field_of_view : float
        Between the highest and the lowest beam, degrees.
    """
    half = 0.5 * field_of_view
    return SphericalCamera.spinning(np.linspace(half, -half, beams).tolist(), columns)


OUSTER_OS0_128 = evenly_spread(128, 90.0)
"""Ouster OS0, 128 beams over 90 degrees (data sheet); nominal, evenly spread."""

OUSTER_OS1_128 = evenly_spread(128, 45.0)
"""Ouster OS1, 128 beams over 45 degrees (data sheet); nominal, evenly spread."""

OUSTER_OS1_64 = evenly_spread(64, 33.2)
"""Ouster OS1 of the first generation, 64 beams over 33.2 degrees (data sheet); nominal."""

OUSTER_OS1_32 = evenly_spread(32, 45.0)
"""Ouster OS1, 32 beams over 45 degrees (data sheet); nominal, evenly spread."""

VELODYNE_VLP16 = SphericalCamera.spinning(np.arange(15.0, -16.0, -2.0).tolist(), 1800)
"""Velodyne VLP-16 (Puck): 16 beams, 2 degrees apart; 0.2 degrees between columns at 10 Hz (user
manual 63-9243)."""

VELODYNE_HDL32E = SphericalCamera.spinning(
    np.round(np.linspace(10.67, -30.67, 32), 2).tolist(), 1084
)
"""Velodyne HDL-32E: 32 beams, 1.33 degrees apart from +10.67 to -30.67 (user manual); columns as at
20 Hz, the speed of nuScenes."""

VELODYNE_HDL64E = SphericalCamera.spinning(
    [*np.linspace(2.0, -8.33, 32).tolist(), *np.linspace(-8.83, -24.33, 32).tolist()], 2083
)
"""Velodyne HDL-64E: an upper block of 32 beams 1/3 degree apart from +2, a lower one 1/2 degree
apart from -8.83 (user manual, nominal: every device has its own calibration, and its blocks do not
share an origin); columns as at 10 Hz, the speed of KITTI."""

VELODYNE_VLS128 = SphericalCamera.spinning(
    [
        *(15.0, 11.75, 9.7, 8.43, 7.58, 6.98, 6.48, 6.08, 5.73, 5.43, 5.18, 4.98),
        *np.round(np.linspace(4.83, -6.5, 104), 2).tolist(),
        *(-6.65, -6.85, -7.15, -7.65, -8.352, -9.244, -10.346, -11.742),
        *(-13.565, -16.042, -19.582, -25.0),
    ],
    1875,
)
"""Velodyne VLS-128 (Alpha Prime): 128 beams, 0.11 degrees apart in the middle (user manual; a scan
at hand has the same angles to 0.001 degrees); 0.192 degrees between columns at 10 Hz."""

PRESETS: dict[str, Camera] = {
    "nyu": NYU,
    "kinect-v1": KINECT_V1,
    "kinect-v2": KINECT_V2,
    "azure-kinect": AZURE_KINECT,
    "realsense-d415": REALSENSE_D415,
    "realsense-d435": REALSENSE_D435,
    "realsense-d455": REALSENSE_D455,
    "gemini-2-xl": GEMINI_2_XL,
    "structure": STRUCTURE,
    "iphone-lidar": IPHONE_LIDAR,
    "paper": PAPER,
    "ouster-os0-128": OUSTER_OS0_128,
    "ouster-os1-32": OUSTER_OS1_32,
    "ouster-os1-64": OUSTER_OS1_64,
    "ouster-os1-128": OUSTER_OS1_128,
    "velodyne-vlp16": VELODYNE_VLP16,
    "velodyne-hdl32e": VELODYNE_HDL32E,
    "velodyne-hdl64e": VELODYNE_HDL64E,
    "velodyne-vls128": VELODYNE_VLS128,
}
"""Names of the presets at the command line."""
