"""Cameras as a store describes them, in ``store.json`` and in its table of frames."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from planewise.camera import Camera, PinholeCamera
from planewise.errors import PlanewiseError
from planewise.files.lidar import spherical_camera

_INTRINSICS = ("fx", "fy", "cx", "cy")
_PINHOLE = (*_INTRINSICS, "distortion")


def described_camera(described: Mapping[str, Any]) -> Camera | None:
    """Camera of its description; ``None`` for one of a user's own kind.

    Raises
    ------
    ValueError
        If such a camera cannot be.
    """
    if described.get("model") == "spherical":
        return spherical_camera(described)
    if described.keys() - {"distortion", "radial"} != set(_INTRINSICS):
        return None
    return PinholeCamera(**described)


def description_of(row: Mapping[str, Any]) -> dict[str, Any]:
    """Description of the camera of a row of the table of frames.

    Raises
    ------
    PlanewiseError
        If there is none.
    """
    if row["fx"] is not None:
        return {name: row[name] for name in _PINHOLE if row[name] is not None}
    try:
        described = json.loads(row["camera"])
    except (TypeError, ValueError, RecursionError):
        described = None
    if not isinstance(described, dict):
        raise PlanewiseError(f"store: the camera of the frame {row['frame']} is damaged")
    return described
