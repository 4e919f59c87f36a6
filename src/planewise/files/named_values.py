"""Named values of calibration files, which are JSON or YAML."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planewise.errors import PlanewiseError, in_one_line, needs
from planewise.files.numbers import first_of

_MAX_BYTES = 1_000_000  # calibrations are a page of text
_MAX_YAML = 200_000  # characters, which take seconds; OpenCV may write a target's points, too
_DEEPEST = 20  # of lists and named values in others; calibrations have some four
_TOO_LARGE = "is too large to be a calibration file"
_TOO_DEEP = "is nested too deeply to be a calibration file"


def read_mapping(path: Path) -> Mapping[str, Any]:
    """Named values of a JSON or YAML file; those of a part ``camera`` stand beside the others.

    Raises
    ------
    PlanewiseError
        If it is too large or nested too deeply, has aliases, or is neither of the two.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise PlanewiseError(_TOO_LARGE)
    try:
        text = path.read_text(encoding="utf-8-sig")  # some editors put a mark before the text
    except UnicodeDecodeError:
        raise PlanewiseError("is not a text file; expected JSON or YAML") from None
    try:
        content = json.loads(text)
        _check_depth(content)
    except RecursionError:
        raise PlanewiseError(_TOO_DEEP) from None
    except json.JSONDecodeError as error:
        if path.suffix.lower() == ".json":
            raise PlanewiseError(f"is not valid JSON ({error})") from None
        content = _parse_yaml(text)
    if not isinstance(content, dict):
        raise PlanewiseError(
            "holds no named values; expected a camera's K or fx, fy, cx, cy, or a LiDAR's elevation"
        )
    parts = [name for name in content if re.fullmatch(r"cam\d+", str(name))]
    if len(parts) > 1:
        raise PlanewiseError(
            f"states {len(parts)} cameras ({', '.join(parts):.60}); give a file of the depth "
            "camera's"
        )
    inner = first_of(content, "camera", "intrinsics", "intrinsic", *parts)
    return {**content, **inner} if isinstance(inner, dict) else content


def _check_depth(value: Any, left: int = _DEEPEST) -> None:
    if not left:
        raise PlanewiseError(_TOO_DEEP)
    if isinstance(value, (dict, list)):
        for each in value.values() if isinstance(value, dict) else value:
            _check_depth(each, left - 1)


def _parse_yaml(text: str) -> Any:
    with needs("pyyaml", "reading YAML files"):
        import yaml
    if len(text) > _MAX_YAML:
        raise PlanewiseError(_TOO_LARGE)
    # OpenCV writes its own YAML: a "%YAML:1.0" line and tagged matrices.
    text = re.sub(r"\A%YAML:1\.0\s*", "", text).replace("!!opencv-matrix", "")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # several times as fast
    depth = 0
    try:
        # Before anything is built: that takes a stack as deep, and aliases of aliases can stand
        # for more than memory holds.
        for event in yaml.parse(text, loader):
            if isinstance(event, yaml.AliasEvent):
                raise PlanewiseError(
                    f"has a YAML alias (*{event.anchor:.20}); write in its place what it stands for"
                )
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST:
                raise PlanewiseError(_TOO_DEEP)
        # An echoed ROS message ends with a document separator.
        return next((part for part in yaml.load_all(text, loader) if part is not None), None)
    except yaml.YAMLError as error:
        raise PlanewiseError(f"is not valid YAML ({in_one_line(error):.100})") from None
