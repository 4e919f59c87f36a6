"""Numbers among the named values of a calibration file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import shown
from planewise.errors import PlanewiseError


def first_of(values: Mapping[str, Any], *names: str) -> Any:
    """Value of the first of these names that has one, ``None`` where none has."""
    return next((values[name] for name in names if values.get(name) is not None), None)


def numbers_of(value: Any) -> NDArray[np.float64]:
    """All numbers of a value or text, in a row; of OpenCV's and ROS's matrices those in ``data``.

    Raises
    ------
    PlanewiseError
        If it holds anything else.
    """
    if isinstance(value, dict):
        value = value.get("data")
    try:
        numbers = value.split() if isinstance(value, str) else value
        return np.asarray(numbers, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise PlanewiseError(f"holds {shown(value)} where numbers are expected") from None
    except OverflowError:
        raise PlanewiseError("holds an integer that is too large for any camera") from None
