"""What a store was made with (``store.json``), and whether that is what is asked for now."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from planewise._version import __version__
from planewise.arguments import shown
from planewise.batch.columns import SCHEMA_VERSION
from planewise.batch.frame_work import Recipe
from planewise.batch.source import Source, path_of
from planewise.batch.stored_camera import described_camera
from planewise.datasets.ros import TOPICS, topics_of
from planewise.errors import PlanewiseError
from planewise.files.labels import STORE_FILE
from planewise.machine import versions
from planewise.noise import AUTO
from planewise.sensor import Sensor
from planewise.sensor_files import describe_exactly, whole

SCHEMA = "planewise/store"

_MAX_BYTES = 10_000_000  # a LiDAR's camera takes a hundredth of that
_NUMBER = float | int
_PARTS: dict[str, Any] = {
    "made_with": {
        "planewise": str,
        "options": {"search": str, "objective": str},
        "sensor": dict,
        "camera": dict | None,
        "depth_scale": _NUMBER | None,
        "labels": str,
    },
    "source": {
        "name": str,
        "kind": str,
        "path": str | None,
        "frames": int,
        "ids_sha256": str,
    },
    "sensor": {
        "min_depth_m": _NUMBER,
        "max_depth_m": _NUMBER,
        "resolution_m": _NUMBER,
        "noise": str,
        "parts": str,
    },
    "versions": {},
}

_NAMED = 4  # differences that a message lists
_ASKED = {"rng": "seed"}  # what users call an option
_PACKAGES = ("pillow", "pyarrow", "ray")


def info_of(source: Source, recipe: Recipe) -> dict[str, Any]:
    """Content of ``store.json``: all that the results depend on, and the versions used."""
    path, ids = path_of(source), hashlib.sha256()
    for each in source.ids:
        ids.update(each.encode("utf-8", "surrogateescape") + b"\0")
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "made_with": _made_with(recipe),
        "source": {
            "name": source.name,
            "kind": type(source).__name__,
            "path": None if path is None else str(path.absolute()),
            "frames": len(source.ids),
            "ids_sha256": ids.hexdigest(),
            **topics_of(source),
        },
        "sensor": recipe.sensor.describe(),
        "versions": versions(_PACKAGES),
    }


def _made_with(recipe: Recipe) -> dict[str, Any]:
    """What has to be the same for all frames of a store."""
    return {
        "planewise": __version__,
        "options": recipe.options.describe(),
        "sensor": _exactly(recipe.sensor),
        "camera": None if recipe.camera is None else recipe.camera.describe(),
        "depth_scale": recipe.depth_scale,
        "labels": recipe.labels,
    }


def _exactly(sensor: Sensor) -> dict[str, Any]:
    if sensor.noise == AUTO:
        return dict(sensor.describe())
    return describe_exactly(sensor)


def read_info(store: Path) -> dict[str, Any]:
    """Read ``store.json``.

    Raises
    ------
    PlanewiseError
        If there is none, or it is damaged or of another layout.
    """
    path = store / STORE_FILE
    if not store.exists():
        raise PlanewiseError(f"store: there is no folder {store}")
    if not path.is_file():
        raise PlanewiseError(f"store: {store} is none: it has no {STORE_FILE}")
    if path.stat().st_size > _MAX_BYTES:
        raise PlanewiseError(f"store: {path} is too large to describe a store")
    try:
        info = json.loads(path.read_text(encoding="utf-8"), parse_int=whole)
    except (ValueError, RecursionError) as error:
        raise PlanewiseError(f"store: {path} is damaged ({error})") from None
    if not isinstance(info, dict) or info.get("schema") != SCHEMA:
        raise PlanewiseError(f"store: {path} does not describe a store")
    if info.get("schema_version") != SCHEMA_VERSION:
        raise PlanewiseError(
            f"store: {store} has layout {shown(info.get('schema_version'))}, this program reads "
            f"{SCHEMA_VERSION}"
        )
    if damaged := _damaged(info, _PARTS) or _damaged_topics(info["source"]):
        raise PlanewiseError(f"store: {path} is damaged: it lacks {damaged}, or has it otherwise")
    try:
        described_camera(info["made_with"]["camera"] or {})
    except ValueError as error:
        raise PlanewiseError(f"store: {path} is damaged ({error})") from None
    return info


def _damaged(there: Mapping[str, Any], parts: Mapping[str, Any], at: str = "") -> str:
    """What is missing of a store's description, or is of another kind; empty if nothing is."""
    for key, kind in parts.items():
        value = there.get(key, ())  # () is of none of them
        if not isinstance(value, dict if isinstance(kind, dict) else kind):
            return at + key
        if isinstance(kind, dict) and (inner := _damaged(value, kind, f"{at}{key}.")):
            return inner
    return ""


def _damaged_topics(source: Mapping[str, Any]) -> str:
    for key in TOPICS:
        names = source.get(key, [])
        if not (isinstance(names, list) and all(isinstance(each, str) for each in names)):
            return f"source.{key}"
    return ""


def check_outside(store: Path, output: Path) -> None:
    """Refuse to write into the folder of a store what is no part of it.

    Raises
    ------
    PlanewiseError
        If it lies there.
    """
    if output.resolve().is_relative_to(store.resolve()):
        raise PlanewiseError(f"output: {output} is in the store; choose another folder")


def check_same(store: Path, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Refuse a store that was made with other options.

    Raises
    ------
    PlanewiseError
        Which says what differs.
    """
    here = json.loads(json.dumps(here))  # where tuples are lists, as there
    found: list[str] = []
    for key in TOPICS:
        if key in there["source"]:
            old, new = (_words(info["source"].get(key)) for info in (there, here))
            found += _differences(key, old, new)
    if not found and there["made_with"] == here["made_with"]:
        return
    for key in here["made_with"]:
        old, new = there["made_with"].get(key), here["made_with"][key]
        if key == "sensor" and there[key] != here[key]:
            old, new = there[key], here[key]  # the same in words
        found += _differences(key, old, new)
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    raise PlanewiseError(
        f"store: {store} was made with other options: {'; '.join(found[:_NAMED])}{more}; give "
        "these, or another folder"
    )


def _differences(name: str, there: Any, here: Any) -> Iterator[str]:
    if isinstance(there, dict) and isinstance(here, dict):
        for key in [*there, *(key for key in here if key not in there)]:
            yield from _differences(f"{name}.{key}", there.get(key), here.get(key))
    elif there != here:
        said = name.removeprefix("options.")
        yield f"{_ASKED.get(said, said)} is {_short(there)} there, {_short(here)} here"


def _words(names: list[str] | None) -> str | None:
    return None if names is None else ", ".join(names)


def _short(value: Any) -> str:
    text = "not given" if value is None else json.dumps(value)
    return text if len(text) <= 160 else text[:157] + "..."
