"""Rows of a table of measurements, each held against what it must and what it aims to be."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

RATIO = "x"

HEAD = (
    "| what | median | quartiles | unit | runs | must | aim | |\n"
    "|---|---:|---:|---|---:|---:|---:|---|"
)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measurement.

    Attributes
    ----------
    what, unit : str
        Of the table.
    values : list of float
        Every run; the median counts.
    must, aim : float, optional
        Largest median that holds, and that is aimed at; smallest ones where `large` is good.
    large : bool
        The larger the better.
    details : dict
        More numbers, for the file only.
    """

    what: str
    unit: str
    values: list[float]
    must: float | None = None
    aim: float | None = None
    large: bool = False
    details: dict[str, Any] = field(default_factory=dict)

    @property
    def median(self) -> float:
        """Of all runs."""
        return float(np.median(self.values))

    @property
    def quartiles(self) -> list[float]:
        """Of all runs."""
        return [float(each) for each in np.percentile(self.values, (25, 75))]

    @property
    def verdict(self) -> str:
        """Which bound the median keeps; empty where there is none."""
        sign = -1 if self.large else 1
        for name, bound in (("aim", self.aim), ("held", self.must)):
            if bound is not None and sign * self.median <= sign * bound:
                return name
        return "" if self.must is None else "MISSED"

    def line(self) -> str:
        """Row as Markdown."""
        spread = " ... ".join(self._text(each) for each in self.quartiles)
        sign = ">=" if self.large else "<="
        bounds = ["" if each is None else f"{sign} {self._text(each)}" for each in self._bounds]
        runs = len(self.values)
        cells = [self.what, self._text(self.median), spread if runs > 1 else "", self.unit]
        return f"| {' | '.join([*cells, str(runs), *bounds, self.verdict])} |"

    def record(self) -> dict[str, Any]:
        """Row in plain types, for the file."""
        found = {"median": self.median, "quartiles": self.quartiles, "verdict": self.verdict}
        return asdict(self) | found

    @property
    def _bounds(self) -> tuple[float | None, float | None]:
        return self.must, self.aim

    def _text(self, value: float) -> str:
        if self.unit == RATIO and 0 < value < 0.05:
            return f"1/{1 / value:,.0f}"
        return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def row(what: str, unit: str, values: NDArray[np.float64], **more: Any) -> Row:
    """Row of measured numbers."""
    return Row(what=what, unit=unit, values=np.ravel(values).tolist(), **more)
