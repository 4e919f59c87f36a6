"""Angles of the rows and columns of LiDAR images, in degrees: checked, and places among them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_STEEPEST = 90.0  # degrees of elevation: straight up
_UNEVEN = 4.0  # times the usual step that columns may be apart
_AGAIN = 0.1  # of a step: nearer to the first column the last one is the first again
_STAGGER = 2.0  # columns by which rows beside each other may be out of step
_ROUNDED = 1e-9  # degrees
_FARTHEST = 20.0  # degrees that a row may be off its columns


def degrees(name: str, values: Sequence[float]) -> tuple[float, ...]:
    """Angles as they are kept.

    Raises
    ------
    ValueError
        If they are not a row of finite numbers.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"camera: {name} must be angles in degrees, got {values!r}") from None
    if array.ndim != 1 or not np.isfinite(array).all():
        raise ValueError(
            f"camera: {name} must be a row of finite angles in degrees, got shape {array.shape}"
            + ("" if np.isfinite(array).all() else " with angles that are not finite")
        )
    return tuple(array.tolist())


def check_elevation(elevation: Array) -> None:
    """Refuse rows out of order or too steep."""
    step = np.diff(elevation)
    if not (np.all(step > 0) or np.all(step < 0)):
        at = int(np.argmax(np.sign(step) != np.sign(elevation[-1] - elevation[0])))
        raise ValueError(
            "camera: elevation must rise or fall from row to row, got "
            f"{elevation[at]:g} and {elevation[at + 1]:g} degrees in rows {at} and {at + 1}; "
            "sort the beams, and the rows of the image with them"
        )
    if np.abs(elevation).max() > _STEEPEST:
        raise ValueError(
            f"camera: elevation must lie within {_STEEPEST:g} degrees of the horizon, got "
            f"{elevation[np.argmax(np.abs(elevation))]:g}; are the angles in degrees?"
        )


def usual_step(azimuth: Array) -> float:
    """Median angle between columns. NumPy loads masked arrays for its own, with any preset."""
    steps = np.sort(np.abs(np.diff(azimuth)))
    return float(steps[(len(steps) - 1) // 2] + steps[len(steps) // 2]) / 2


def check_azimuth(azimuth: Array) -> None:
    """Refuse columns, their azimuth without jumps, that are uneven or go round more than once."""
    step, usual = np.diff(azimuth), usual_step(azimuth)
    if not (np.all(step > 0) or np.all(step < 0)) or np.abs(step).max() > _UNEVEN * usual:
        raise ValueError(
            "camera: azimuth must rise or fall from column to column by about the same angle, "
            f"got steps from {step.min():g} to {step.max():g} degrees"
        )
    turn = np.abs(step).sum()
    if turn > 360.0 + 0.5 * usual:
        raise ValueError(f"camera: azimuth must go round once at most, got {turn:g} degrees")
    if turn > 360.0 - _AGAIN * usual:
        raise ValueError(
            f"camera: azimuth goes round by {turn:g} degrees: the last column is the first again; "
            "leave it out (endpoint=False)"
        )


def check_offset(offset: Array, step: float) -> None:
    """Refuse rows that are off their columns, which are `step` apart, or staggered."""
    farthest = np.abs(offset).max(initial=0.0)
    if farthest > _FARTHEST:
        raise ValueError(
            f"camera: azimuth_offset must lie within {_FARTHEST:g} degrees, got {farthest:g}; "
            "what all rows share belongs to azimuth"
        )
    out_of_step = np.abs(np.diff(offset)).max(initial=0.0) / step
    if out_of_step > _STAGGER:
        raise ValueError(
            f"camera: azimuth_offset puts rows {out_of_step:.1f} columns out of step, at most "
            f"{_STAGGER:g} will do; destagger the image, then give what is left of the offsets"
        )


def edges_of(angles: Array) -> Array:
    """Half-way between angles in order, and as far beyond the outermost: one more of them."""
    half = 0.5 * np.diff(angles)
    return np.concatenate(([angles[0] - half[0]], angles[:-1] + half, [angles[-1] + half[-1]]))


def between(angles: Array, place: Array) -> Array:
    """Angles at places between their indices, and up to half-way beyond the ends."""
    edges, last = edges_of(angles), angles.size - 1
    places = np.concatenate(([-0.5], np.arange(angles.size), [last + 0.5]))
    return np.interp(place, places, np.concatenate((edges[:1], angles, edges[-1:])))


def nearest(angles: Array, wanted: Array) -> NDArray[np.intp]:
    """Index of the nearest of angles that rise or fall, -1 beyond both ends."""
    edges = edges_of(angles)
    sign = 1.0 if edges[-1] > edges[0] else -1.0
    edges[-1] += sign * _ROUNDED  # straight up and down are in the image whose edge they are
    place = np.searchsorted(sign * edges, sign * wanted, side="right") - 1
    return np.where(place < angles.size, place, -1)
