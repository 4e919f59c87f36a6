"""Columns of the two tables of a store, by Arrow's names of their types."""

from __future__ import annotations

SCHEMA_VERSION = 1
"""Version of the layout of a store; raised when a reader has to change."""

FRAMES = {
    "frame": "string",
    "number": "int64",
    "status": "string",
    "reason": "string",
    "width": "int32",
    "height": "int32",
    "readings": "int64",
    "planes": "int32",
    "information": "double",
    "curve": "list<double>",
    "note": "string",
    "fx": "double",
    "fy": "double",
    "cx": "double",
    "cy": "double",
    "distortion": "list<double>",
    "camera": "string",
    "depth_scale": "double",
    "timestamp": "double",
    "noise": "string",
    "fingerprint": "string",
    "labels": "string",
    "read_ms": "float",
    "detect_ms": "float",
    "encode_ms": "float",
}
"""One row a frame."""

OF_ALL = ("frame", "number", "status")
"""The columns that every frame has."""

OF_DONE = (
    "width", "height", "readings", "planes", "information", "curve", "note", "fingerprint",
)  # fmt: skip
"""Those that every frame has that is done."""

PLANES = {
    "frame": "string",
    "label": "uint16",
    "normal_x": "double",
    "normal_y": "double",
    "normal_z": "double",
    "distance": "double",
    "information": "double",
    "readings": "int64",
    "rms": "double",
    "significance": "double",
    "residual_correlation": "double",
    "area": "double",
    "centroid_x": "double",
    "centroid_y": "double",
    "centroid_z": "double",
    "top": "int32",
    "left": "int32",
    "bottom": "int32",
    "right": "int32",
    "covariance": "list<double>",
    "rle": "string",
}
"""One row a plane."""

TIMES = ("read_ms", "detect_ms", "encode_ms")
"""The columns that differ from run to run."""

DONE, FAILED = "done", "failed"
"""What `status` may be."""
