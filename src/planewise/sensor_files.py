"""Sensors as JSON files: range, resolution, noise, its parts, waves; what they were measured from.

A curve is a list of terms, sigma(z) the root of the sum of their squares; no term means no error.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planewise._version import __version__
from planewise.arguments import is_finite
from planewise.errors import PlanewiseError
from planewise.noise import NOTHING, ErrorParts, Noise, Nothing, Polynomial, RootSum
from planewise.sensor import Sensor, checked_sensor
from planewise.waves import Waves
from planewise.whole_files import written_whole

SCHEMA = "planewise/sensor"
SCHEMA_VERSION = 1
"""Version of the layout; raised when a reader has to change."""

_MAX_BYTES = 1_000_000
_MOST_DIGITS = 300  # of an integer that a float holds
_TERM = {
    "constant_m": "constant",
    "linear_m_per_m": "linear",
    "quadratic_m_per_m2": "quadratic",
    "offset_m": "offset",
}
_LENGTHS = {
    "max_depth_m": "max_depth",
    "min_depth_m": "min_depth",
    "range_m": "depth_range",
    "resolution_m": "resolution",
}
_WAVE = "period", "amplitude", "phase"
_PARTS = {"white": "white", "shared": "shared", "drift_per_100_px": "drift"}


def save(sensor: Sensor, path: str | Path, *, calibration: Mapping[str, Any] | None = None) -> None:
    """Write a sensor to a JSON file, complete or not at all.

    Parameters
    ----------
    sensor : Sensor
        Its noise must be made of the curves of `planewise.noise`.
    path : path
        Replaced if it exists.
    calibration : Mapping, optional
        What the noise was measured from, in plain types; kept for people to read.

    Raises
    ------
    PlanewiseError
        If the noise is a function of another kind, or "auto".
    """
    path = Path(path)
    record: dict[str, Any] = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "planewise_version": __version__,
        **describe_exactly(sensor),
    }
    if calibration is not None:
        record["calibration"] = dict(calibration)
    text = json.dumps(record, indent=2, allow_nan=False) + "\n"
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def describe_exactly(sensor: Sensor) -> dict[str, Any]:
    """Say in plain types what a sensor is, so that it can be made again from them.

    Raises
    ------
    PlanewiseError
        As `save`.
    """
    parts = checked_sensor(sensor).parts
    waves = {} if sensor.waves is None else {"waves": sensor.waves.describe()}
    return waves | {
        **{key: getattr(sensor, name) for key, name in _LENGTHS.items()},
        "noise": _terms(sensor.noise),
        "parts": None
        if parts is None
        else {k: _terms(getattr(parts, n)) for k, n in _PARTS.items()} | {"bounds": parts.bounds},
    }


def load(path: str | Path) -> Sensor:
    """Read a sensor that `save` or ``planewise calibrate`` wrote.

    Parameters
    ----------
    path : path
        JSON file.

    Raises
    ------
    PlanewiseError
        If there is no such file, or it does not describe a sensor; the message says what is wrong.
    """
    path = Path(path)
    if not path.is_file():
        raise PlanewiseError(f"sensor: there is no file {path}")
    try:
        return _from_record(_parse(path))
    except ValueError as error:
        raise PlanewiseError(f"sensor: {path.name}: {error}") from None


def _terms(noise: object) -> list[dict[str, float]]:
    if isinstance(noise, Nothing):
        return []
    if isinstance(noise, Polynomial):
        return [{key: getattr(noise, name) for key, name in _TERM.items()}]
    if isinstance(noise, RootSum):
        return [term for part in noise.parts for term in _terms(part)]
    if isinstance(noise, str):
        raise PlanewiseError(
            f"sensor: the noise {noise!r} is not known yet; estimate it first (planewise calibrate)"
        )
    raise PlanewiseError(
        "sensor: only noise made of planewise.noise's curves can be written to a file, "
        f"got {noise!r}"
    )


def _parse(path: Path) -> dict[str, Any]:
    if path.stat().st_size > _MAX_BYTES:
        raise PlanewiseError("is too large to describe a sensor")
    try:
        record = json.loads(path.read_text(encoding="utf-8-sig"), parse_int=whole)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise PlanewiseError(f"is not valid JSON ({error})") from None
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise PlanewiseError(
            f'does not describe a sensor: expected "schema": "{SCHEMA}", as planewise calibrate '
            "writes it"
        )
    if record.get("schema_version") != SCHEMA_VERSION:
        raise PlanewiseError(
            f"has schema version {record.get('schema_version')!r}, this program reads "
            f"{SCHEMA_VERSION}; calibrate again, or install the version that wrote it "
            f"({record.get('planewise_version', 'unknown')})"
        )
    return record


def whole(digits: str) -> int | float:
    """Integer of a file; infinite where no float holds it, which Python may refuse to read."""
    return int(digits) if len(digits) <= _MOST_DIGITS else float(digits)


def _from_record(record: Mapping[str, Any]) -> Sensor:
    lengths = {
        name: None if key == "range_m" and record.get(key) is None else _number(record, key)
        for key, name in _LENGTHS.items()
    }
    noise = _curve(record.get("noise"), "noise")
    if noise is NOTHING:
        raise PlanewiseError("noise must have at least one term")
    parts, waves = _parts(record.get("parts")), _waves(record.get("waves"))
    return Sensor(noise=noise, parts=parts, waves=waves, **lengths)  # type: ignore[arg-type]


def _parts(value: object) -> ErrorParts | None:
    if value is None:
        return None
    if not isinstance(value, dict):
        raise PlanewiseError("parts must be null, or hold white, shared, drift_per_100_px (terms)")
    curves = {name: _curve(value.get(key), f"parts.{key}") for key, name in _PARTS.items()}
    if curves["white"] is NOTHING:
        raise PlanewiseError("parts.white must have at least one term")
    return ErrorParts(**curves, bounds=value.get("bounds", True))


def _waves(value: object) -> Waves | None:
    if value is None:
        return None
    if not isinstance(value, dict):
        raise PlanewiseError("waves must be null, or hold along and parts")
    parts = value.get("parts")
    if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts):
        raise PlanewiseError(f"waves.parts must be a list of waves with {', '.join(_WAVE)}")
    rows = [{name: _number(part, name, "waves") for name in _WAVE} for part in parts]
    try:
        return Waves.of({"along": value.get("along"), "parts": rows})
    except ValueError as error:
        raise PlanewiseError(str(error)) from None


def _curve(value: object, where: str) -> Noise:
    if not isinstance(value, list) or not all(isinstance(term, dict) for term in value):
        raise PlanewiseError(f"{where} must be a list of terms with {', '.join(_TERM)}")
    terms = []
    for term in value:
        numbers = {name: _number(term, key, where) for key, name in _TERM.items()}
        try:
            terms.append(Polynomial(**numbers))
        except ValueError as error:
            raise PlanewiseError(f"{where}: {str(error).removeprefix('noise: ')}") from None
    if not terms:
        return NOTHING
    return terms[0] if len(terms) == 1 else RootSum(tuple(terms))


def _number(record: Mapping[str, Any], key: str, where: str = "") -> float:
    value: Any = record.get(key)
    if not is_finite(value):
        name = f"{where}.{key}" if where else key
        raise PlanewiseError(f"{name} must be a finite number, got {value!r}")
    return float(value)
