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

_FORMS = (".4f", ".4f", ".4f", ".4f", ".3f", "", ".5g", ".5g")
"""How exactly: decimals, or digits of what spans many powers of ten."""


def record_of(frame: StoredFrame) -> dict[str, Any]:
    """Record of a frame that is done."""
    row = frame.row
    return {
        "id": frame.id,
        "number": row["number"],
        "readings": row["readings"],
        "information": _rounded(row["information"], ".3f"),
        "curve": [_rounded(each, ".1f") for each in row["curve"]],
        "note": row["note"],
        "planes": [
            [_rounded(each[name], form) for name, form in zip(PLANE, _FORMS, strict=True)]
            for each in frame.plane_table.select(list(PLANE)).to_pylist()
        ],
    }


def record_of_failure(number: int, frame: str, reason: str) -> dict[str, Any]:
    """Record of a frame that failed."""
    return {"id": frame, "number": number, "failed": reason, "curve": [], "planes": []}


def _rounded(value: float | None, form: str) -> float | int | None:
    if value is None or not math.isfinite(value):
        return None
    return value if isinstance(value, int) else float(format(value, form))
