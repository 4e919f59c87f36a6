"""One NumPy archive a frame: labels, planes and camera, as ``numpy.load`` reads them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.batch.frame_names import safe_name
from planewise.batch.source import SourceFrame
from planewise.batch.store import StoredFrame
from planewise.exports.form import Form

_COLUMNS = ("information", "rms", "significance", "area")
_NOT_A_NUMBER = np.full(16, np.nan)


class NpzExport(Form):
    """``ID.npz``; see `Form`.

    Arrays: ``labels`` (H, W) uint16, ``planes`` (N, 4) rows (normal, distance), ``information``,
    ``rms``, ``significance``, ``area`` (N,), ``readings`` (N,) int64, ``covariance`` (N, 4, 4),
    ``K`` (fx, fy, cx, cy) and ``distortion``, or ``camera`` (JSON) of one that is no pinhole,
    ``frame`` (its id) and, where there is one, ``timestamp``. What is not known is NaN.
    """

    def add(self, frame: StoredFrame, seen: SourceFrame | None) -> None:
        """See `Form`."""
        row, planes = frame.row, frame.plane_table
        arrays: dict[str, NDArray[np.generic]] = {
            "labels": frame.labels,
            "planes": frame.planes,
            "readings": planes["readings"].to_numpy(),
            "covariance": np.array(
                [_NOT_A_NUMBER if each is None else each for each in _list(planes, "covariance")]
            ).reshape(-1, 4, 4),
            "frame": np.array(frame.id),
        }
        if row["fx"] is None:
            arrays["camera"] = np.array(row["camera"])
        else:
            arrays["K"] = np.array([row["fx"], row["fy"], row["cx"], row["cy"]])
            arrays["distortion"] = np.array(row["distortion"] or [], np.float64)
        for name in _COLUMNS:
            arrays[name] = np.array(_list(planes, name), np.float64)
        if row["timestamp"] is not None:
            arrays["timestamp"] = np.array(row["timestamp"])
        np.savez_compressed(self.path(safe_name(frame.id, ".npz")), **arrays)  # type: ignore[arg-type]

    def finish(self) -> None:
        """See `Form`."""


def _list(planes: object, name: str) -> list[object]:
    return planes[name].to_pylist()  # type: ignore[index, no-any-return]
