"""Spherical cameras as users write them down, and as Ouster's metadata files state them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from planewise.arguments import shown
from planewise.errors import PlanewiseError
from planewise.spherical import SphericalCamera

_PANORAMA = re.compile(r"panorama:(\d+)x(\d+)", re.IGNORECASE)
_TABLE = "expected elevation and azimuth in degrees, or elevation and columns"


def panorama_camera(text: str) -> SphericalCamera | None:
    """Camera of ``panorama:WIDTHxHEIGHT``; ``None`` of other text.

    Raises
    ------
    ValueError
        If there is no panorama of so few pixels.
    """
    size = _PANORAMA.fullmatch(text)
    return None if size is None else SphericalCamera.panorama(int(size[2]), int(size[1]))


def is_spherical(values: Mapping[str, Any]) -> bool:
    """Whether named values, in lower case, describe a spherical camera."""
    return values.get("model") == "spherical" or any(
        key in values for key in ("elevation", "beam_intrinsics", "beam_altitude_angles")
    )


def spherical_camera(values: Mapping[str, Any]) -> SphericalCamera:
    """Spherical camera from named values, keys in lower case.

    Parameters
    ----------
    values : Mapping
        ``elevation`` and ``azimuth``, or ``elevation`` and ``columns`` (with ``start`` and
        ``clockwise`` as `SphericalCamera.spinning` takes them), and ``azimuth_offset``, all in
        degrees, and ``turn``, the sensor's axes; or Ouster's metadata with
        ``beam_altitude_angles`` and ``beam_azimuth_angles``, for its destaggered images.

    Raises
    ------
    PlanewiseError
        If they describe none.
    ValueError
        If angles are malformed.
    """
    if "elevation" not in values:
        return _of_ouster(values)
    offset, turn = values.get("azimuth_offset", ()), values.get("turn", ())
    if "azimuth" in values:
        return SphericalCamera(
            elevation=values["elevation"],
            azimuth=values["azimuth"],
            azimuth_offset=offset,
            turn=turn,
        )
    if "columns" not in values:
        raise PlanewiseError(f"describes no spherical camera; {_TABLE}")
    start, clockwise = values.get("start", 180.0), values.get("clockwise", True)
    if isinstance(start, bool) or not isinstance(start, int | float):
        raise PlanewiseError(f"has start {shown(start)}; expected degrees")
    if not isinstance(clockwise, bool):
        raise PlanewiseError(f"has clockwise {shown(clockwise)}; expected true or false")
    camera = SphericalCamera.spinning(
        values["elevation"],
        _columns(values["columns"]),
        start=start,
        clockwise=clockwise,
        azimuth_offset=offset,
    )
    return replace(camera, turn=turn)


def _of_ouster(values: Mapping[str, Any]) -> SphericalCamera:
    """Camera of the destaggered images of an Ouster, in its sensor frame.

    A row of the destaggered image is that of the packets moved by its pixel shift; what is left of
    its beam's azimuth is less than a column. The beams' origin, a few centimetres from the axis, is
    taken to be on it.
    """
    beams, form = _part(values, "beam_intrinsics"), _part(values, "lidar_data_format")
    try:
        elevation = [float(angle) for angle in beams["beam_altitude_angles"]]
        around = [float(angle) for angle in beams["beam_azimuth_angles"]]
        columns = form.get("columns_per_frame")
        if columns is None:
            mode = values.get("lidar_mode") or _part(values, "config_params")["lidar_mode"]
            columns = int(str(mode).partition("x")[0])
        columns = _columns(columns)
        shifts = form.get("pixel_shift_by_row")
        if shifts is None:
            shifts = [round(angle * columns / 360.0) for angle in around]
        offset = [
            360.0 * int(shift) / columns - angle
            for shift, angle in zip(shifts, around, strict=True)
        ]
    except KeyError as error:
        raise PlanewiseError(
            f"describes no spherical camera: {error.args[0]} is missing; {_TABLE}"
        ) from None
    except (TypeError, ValueError) as error:
        raise PlanewiseError(f"has beams that cannot be read ({error!s:.100})") from None
    return SphericalCamera.spinning(elevation, columns, azimuth_offset=offset)


def _part(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Part of a file, or the whole where the part's values stand by themselves."""
    part = values.get(name)
    return part if isinstance(part, Mapping) else values


def _columns(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 2 <= value <= 1 << 16:
        raise PlanewiseError(f"has columns {shown(value)}; expected a number of columns, 2 or more")
    return value
