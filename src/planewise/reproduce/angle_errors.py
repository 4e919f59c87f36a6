"""Errors of two planes at an angle, summed up over frames and held against the bound."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planewise.reproduce.bound import Bound
from planewise.reproduce.experiment import Row

ERRORS = ("normal_error_deg", "distance_error_mm")
"""Names of the errors, in degrees and millimetres."""

RIGHT = 0.99
"""Share of the readings on their own plane from which the labelling is right."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A method at an angle and an assumed noise: root mean squares over frames and planes.

    Attributes
    ----------
    errors : dict
        Normal error in degrees and distance error in millimetres; NaN where a plane was missing in
        every frame.
    ratios : dict
        The same, divided by the bound.
    right : float
        Share of the frames whose labelling is right.
    missed : int
        Frames without any plane on some true one.
    """

    angle: float
    sigma: float
    method: str
    frames: int
    planes: float
    share_right: float
    right: float
    missed: int
    errors: dict[str, float]
    ratios: dict[str, float]

    @property
    def labelled_right(self) -> bool:
        """In every frame."""
        return self.right == 1.0

    def row(self) -> Row:
        """Line of the CSV file."""
        out: Row = {
            "angle_deg": self.angle,
            "sigma_m": self.sigma,
            "method": self.method,
            "frames": self.frames,
            "planes": self.planes,
            "share_right": self.share_right,
            "frames_labelled_right": self.right,
            "frames_with_a_plane_missed": self.missed,
        }
        for key in ERRORS:
            out[f"rms_{key}"] = self.errors[key]
            out[f"{key}_over_bound"] = self.ratios[key]
        return out


def cases(rows: Sequence[Row], bounds: dict[float, Bound]) -> list[Case]:
    """Root mean squares of every method, angle and assumed noise."""
    grouped: dict[tuple[float, float, str], list[Row]] = {}
    for row in rows:
        grouped.setdefault((row["angle_deg"], row["sigma_m"], row["method"]), []).append(row)
    return [_case(*key, mine, bounds[key[0]]) for key, mine in grouped.items()]


def _case(angle: float, sigma: float, method: str, rows: Sequence[Row], bound: Bound) -> Case:
    errors = {
        key: rms([row[f"{key}_{plane}"] for row in rows for plane in (1, 2)]) for key in ERRORS
    }
    least = limits(bound)
    return Case(
        angle=angle,
        sigma=sigma,
        method=method,
        frames=len(rows),
        planes=float(np.mean([row["planes"] for row in rows])),
        share_right=float(np.mean([row["share_right"] for row in rows])),
        right=float(np.mean([row["planes"] == 2 and row["share_right"] >= RIGHT for row in rows])),
        missed=sum(
            not all(math.isfinite(row[f"normal_error_deg_{plane}"]) for plane in (1, 2))
            for row in rows
        ),
        errors=errors,
        ratios={key: errors[key] / least[key] for key in ERRORS},
    )


def rms(values: Sequence[float]) -> float:
    """Root mean square of what is defined."""
    known = [each for each in values if math.isfinite(each)]
    return float(np.sqrt(np.mean(np.square(known)))) if known else math.nan


def limits(bound: Bound) -> dict[str, float]:
    """Root mean squares of the bound over both planes, in the units of the errors."""
    return {
        "normal_error_deg": rms(bound.normals.tolist()),
        "distance_error_mm": rms((1000 * bound.distances).tolist()),
    }
