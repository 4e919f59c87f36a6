"""Depth images, points and cameras in messages of ROS, as its ``sensor_msgs`` define them."""

from __future__ import annotations

import struct
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.camera import PinholeCamera
from planewise.errors import PlanewiseError
from planewise.files.camera import REGION, camera_of_mapping
from planewise.files.depth import check_size, read_depth_picture

MILLIMETRE = 0.001
"""Unit of integer depth, metres (REP 118)."""

_ENCODINGS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
_PNG = b"\x89PNG\r\n\x1a\n"
_HEADER = struct.Struct("<i2f")  # of compressedDepth: format, two parameters
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def is_depth(message: Any) -> bool:
    """Whether an Image or CompressedImage is of depth, as far as its encoding tells."""
    if hasattr(message, "encoding"):
        return message.encoding in ("16UC1", "32FC1")
    return "compressedDepth" in message.format or message.format.startswith(("16UC1", "32FC1"))


def seconds(message: Any) -> float | None:
    """Time that the message's header states; ``None`` where it states none."""
    stamp = message.header.stamp
    return float(stamp.sec + stamp.nanosec / 1e9) if stamp.sec or stamp.nanosec else None


def depth_of(message: Any) -> NDArray[Any]:
    """Depth of an Image (16UC1, mono16, 32FC1) or a CompressedImage (compressedDepth, PNG).

    Returns
    -------
    ndarray, shape (H, W)
        uint16 millimetres or float32 metres.

    Raises
    ------
    PlanewiseError
        If it is of another encoding, too large or damaged.
    """
    return _plain(message) if hasattr(message, "encoding") else _compressed(message)


def _plain(message: Any) -> NDArray[Any]:
    height, width, step = int(message.height), int(message.width), int(message.step)
    kind = _ENCODINGS.get(message.encoding)
    if kind is None:
        raise PlanewiseError(
            f"the image's encoding is {message.encoding!r}; depth is {', '.join(_ENCODINGS)}"
        )
    check_size(height * width)
    dtype = np.dtype((">" if message.is_bigendian else "<") + kind)
    row = width * dtype.itemsize
    if step < row or len(message.data) < step * height:
        raise PlanewiseError(
            f"the image is damaged: {len(message.data):,} bytes and rows of {step} for {width} x "
            f"{height} readings"
        )
    rows = np.asarray(message.data, np.uint8)[: step * height].reshape(height, step)[:, :row]
    return np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="))


def _compressed(message: Any) -> NDArray[Any]:
    data = bytes(message.data)
    if data.startswith(_PNG):
        return read_depth_picture(BytesIO(data))
    if not data[_HEADER.size :].startswith(_PNG):
        raise PlanewiseError(f"the image is {message.format!r}; compressed depth is read from PNG")
    _, scale, offset = _HEADER.unpack_from(data)
    coded = read_depth_picture(BytesIO(data[_HEADER.size :]))
    if not message.format.startswith("32FC1"):
        return coded
    # Inverse depth was coded: code = scale / depth + offset, 0 for no reading.
    depth = np.zeros(coded.shape, np.float32)
    seen = coded > max(offset, 0.0)
    depth[seen] = scale / (coded[seen] - offset)
    return depth


def camera_of(message: Any, rectified: bool) -> PinholeCamera:
    """Camera of a CameraInfo.

    Parameters
    ----------
    message : CameraInfo
        Of ROS 1 or 2.
    rectified : bool
        Whether images are rectified: then it is the camera of P, without distortion.

    Raises
    ------
    PlanewiseError
        If it is not calibrated, or its distortion is none that is known.
    """

    def field(name: str) -> NDArray[np.float64]:
        value = getattr(message, name, None)
        return np.asarray(getattr(message, name.upper()) if value is None else value, np.float64)

    region = {name: int(getattr(message.roi, name)) for name in REGION}
    values: dict[str, Any] = {
        name: int(getattr(message, name)) for name in ("width", "height", "binning_x", "binning_y")
    } | {"roi": region, "distortion_model": message.distortion_model}
    values |= {name: field(name) for name in ("k", "d", "p")}
    rectified &= bool(values["p"].any())
    if not rectified and not values["k"].any():
        raise PlanewiseError("holds no calibration (K is zero)")
    return camera_of_mapping(values, rectified=rectified)


def points_of(message: Any) -> tuple[NDArray[np.floating], NDArray[np.float32] | None]:
    """Points and intensities of a PointCloud2, shapes (k, 3) and (k,).

    Raises
    ------
    PlanewiseError
        If it has no x, y and z of floating-point numbers, is too large or damaged.
    """
    fields = {each.name: each for each in message.fields}
    height, width = int(message.height), int(message.width)
    check_size(height * width)
    step, row = int(message.point_step), int(message.row_step)
    order = ">" if message.is_bigendian else "<"
    names = [name for name in ("x", "y", "z", "intensity") if name in fields]
    kinds = [_NUMBERS.get(fields[name].datatype, "") for name in names]
    if names[:3] != ["x", "y", "z"] or any(kind[:1] != "f" for kind in kinds[:3]):
        raise PlanewiseError("the cloud has no x, y and z of floating-point numbers")
    offsets = [int(fields[name].offset) for name in names]
    if row < step * width or len(message.data) < row * height:
        raise PlanewiseError(
            f"the cloud is damaged: {len(message.data):,} bytes for {height} x {width} points"
        )
    layout = np.dtype(
        {
            "names": names,
            "formats": [order + kind for kind in kinds],
            "offsets": offsets,
            "itemsize": step,
        }
    )
    rows = np.asarray(message.data, np.uint8)[: row * height].reshape(height, row)
    table = np.ascontiguousarray(rows[:, : step * width]).reshape(-1).view(layout)
    kind = np.float64 if "f8" in kinds[:3] else np.float32
    points = np.stack([table[name].astype(kind) for name in names[:3]], axis=1)
    intensity = table["intensity"].astype(np.float32) if "intensity" in names else None
    return points, intensity
