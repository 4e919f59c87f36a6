"""Presets of depth cameras, each with the source of its numbers.

Only `NYU` is a calibration. The others are nominal: derived from the field of view in the maker's
data sheet (f = width / 2 / tan(fov / 2), principal point in the middle). A device knows its own
intrinsics better: read them from its driver (a ROS ``camera_info`` file will do).
"""

from __future__ import annotations

import math

from planewise.camera import PinholeCamera


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

AZURE_KINECT = PinholeCamera(fx=504.0, fy=504.0, cx=319.5, cy=319.5, width=640, height=576)
"""Azure Kinect, NFOV unbinned: typical of factory calibrations (about 504 px); distortion left to
the caller."""

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

PRESETS: dict[str, PinholeCamera] = {
    "nyu": NYU,
    "kinect-v1": KINECT_V1,
    "azure-kinect": AZURE_KINECT,
    "realsense-d415": REALSENSE_D415,
    "realsense-d435": REALSENSE_D435,
    "realsense-d455": REALSENSE_D455,
    "gemini-2-xl": GEMINI_2_XL,
    "structure": STRUCTURE,
    "iphone-lidar": IPHONE_LIDAR,
    "paper": PAPER,
}
"""Names of the presets at the command line."""
