"""What the coordinates of a LAS file are in: by its keys of GeoTIFF, or by well-known text."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

_MODEL, _GEOGRAPHIC = 1024, 2  # key of the kind of coordinates, and its value for degrees
_HORIZONTAL, _VERTICAL = 3076, 4099  # keys of units
_UNITS = {9001: "metres", 9002: "feet", 9003: "US survey feet"}
_METRES = {"m", "metre", "metres", "meter", "meters"}

_TOKEN = re.compile(r'"([^"]*)"|\b(\w+)\s*[\[(]|[\])]')
_UNIT = {"UNIT", "LENGTHUNIT", "ANGLEUNIT"}
_OF_SYSTEMS = {"COMPD_CS", "COMPOUNDCRS", "BOUNDCRS", "SOURCECRS"}  # hold systems, have no axes


def stated_unit(records: Iterable[Any]) -> str:
    """Units of the coordinates, where records of laspy say that not all are metres; else empty.

    A code of a projection alone says nothing here: its unit is in a database.
    """
    for record in records:
        if keys := getattr(record, "geo_keys", ()):
            horizontal, vertical = _of_keys({key.id: key.value_offset for key in keys})
        else:
            horizontal, vertical = _of_words(getattr(record, "string", ""))
        if horizontal or vertical:
            return _told(horizontal, vertical)
    return ""


def _told(horizontal: str, vertical: str) -> str:
    if {horizontal, vertical} <= {"metres", ""}:
        return ""
    if vertical in (horizontal, ""):
        return horizontal
    return f"{horizontal or 'the unit of their projection'}, heights in {vertical}"


def _of_keys(keys: dict[int, int]) -> tuple[str, str]:
    horizontal = _UNITS.get(keys.get(_HORIZONTAL, 0), "")
    if keys.get(_MODEL) == _GEOGRAPHIC:
        horizontal = "degrees"
    return horizontal, _UNITS.get(keys.get(_VERTICAL, 0), "")


def _of_words(text: str) -> tuple[str, str]:
    """Horizontal and vertical unit of well-known text: the first and the last of its axes."""
    path: list[str] = []
    units = []
    for token in _TOKEN.finditer(text):
        name, keyword = token.groups()
        if keyword is not None:
            path.append(keyword.upper())
        elif name is None:
            del path[-1:]
        elif path and path[-1] in _UNIT and _is_of_axes(path[:-1]):
            units.append(_plain(name))
    return (units[0], units[-1]) if units else ("", "")


def _is_of_axes(path: list[str]) -> bool:
    """Whether a unit there is that of axes: not of an ellipsoid, a parameter or a base system."""
    systems = [each for each in path if each.endswith(("CS", "CRS")) and each not in _OF_SYSTEMS]
    return len(systems) == 1 and systems == [each for each in path if each != "AXIS"][-1:]


def _plain(name: str) -> str:
    if name.lower() in _METRES:
        return "metres"
    return "degrees" if "degree" in name.lower() else name
