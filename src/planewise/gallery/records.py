"""What the page knows of a frame: short lists, for there are thousands of them in one file.

``gallery.js`` reads them by these names.
"""

from __future__ import annotations

import math
from typing import Any

from planewise.batch.store import StoredFrame

PLANE = (
    "normal_x", "normal_y", "normal_z", "distance", "information", "readings", "rms", "area",
)  # fmt: skip
"""Columns of a plane, in the order in which the page has them."""

_DECIMALS = (4, 4, 4, 4, 3, 0, 5, 4)


def record_of(frame: StoredFrame) -> dict[str, Any]:
    """Record of a frame that is done."""
    row = frame.row
    return {
        "id": frame.id,
        "number": row["number"],
        "readings": row["readings"],
        "information": _rounded(row["information"], 3),
        "curve": [_rounded(each, 1) for each in row["curve"]],
        "note": row["note"],
        "planes": [
            [_rounded(each[name], n) for name, n in zip(PLANE, _DECIMALS, strict=True)]
            for each in frame.plane_table.select(list(PLANE)).to_pylist()
        ],
    }


def record_of_failure(number: int, frame: str, reason: str) -> dict[str, Any]:
    """Record of a frame that failed."""
    return {"id": frame, "number": number, "failed": reason, "curve": [], "planes": []}


def _rounded(value: float | None, decimals: int) -> float | int | None:
    if value is None or not math.isfinite(value):
        return None
    return round(value, decimals) if decimals else int(value)
