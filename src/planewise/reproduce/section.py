"""What a section of the report is made of, before it becomes a page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Check:
    """A claim of the paper, or a target of ours, against what was measured.

    One that is not met is open where it was missed by no more than so few frames are uncertain.
    """

    text: str
    measured: str
    met: bool
    claim: bool = False
    open: bool = False

    @property
    def verdict(self) -> str:
        """In a word or two."""
        if self.open:
            return "not decided"
        if self.claim:
            return "confirmed" if self.met else "not confirmed"
        return "met" if self.met else "missed"

    @property
    def source(self) -> str:
        """Whose it is."""
        return "claim of the paper" if self.claim else "target"


@dataclass(frozen=True, kw_only=True)
class Table:
    """Text in rows and columns; the first `heads` columns name the row.

    Columns behind them may be grouped, each group with a title and a number of columns.
    """

    kind: ClassVar[str] = "table"
    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    heads: int = 2
    groups: Sequence[tuple[str, int]] = ()


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A PNG with the words that stand for it."""

    name: str
    alt: str
    png: bytes = field(repr=False)
    title: str = ""
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """Pictures side by side, row by row, each row with a name."""

    kind: ClassVar[str] = "pictures"
    caption: str
    rows: Sequence[tuple[str, Sequence[Picture]]]


@dataclass(frozen=True, kw_only=True)
class Chart:
    """A drawing as SVG, whose ink is the colour `planewise.reproduce.charts.INK`."""

    kind: ClassVar[str] = "chart"
    name: str
    alt: str
    caption: str
    svg: str = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of the report.

    Attributes
    ----------
    title : str
        Heading.
    text : sequence of str
        Paragraphs: what was done.
    blocks : sequence of Table, Pictures or Chart
        What came out.
    remarks : sequence of str
        Paragraphs below them.
    checks : sequence of Check
        Claims and targets.
    files : dict
        Rows of every CSV file by its name without ending.
    """

    title: str
    text: Sequence[str]
    blocks: Sequence[Table | Pictures | Chart]
    remarks: Sequence[str] = ()
    checks: Sequence[Check] = ()
    files: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    @property
    def pictures(self) -> list[Picture]:
        """All pictures, each once."""
        shown = [each for each in self.blocks if isinstance(each, Pictures)]
        by_name = {one.name: one for each in shown for _, row in each.rows for one in row}
        return list(by_name.values())


def spread(values: Sequence[float], digits: int) -> str:
    """Mean and standard deviation as text, without what is not defined.

    Examples
    --------
    >>> spread([1, 3], 1), spread([4, 4], 1), spread([float("nan")], 2)
    ('2.0 ± 1.4', '4', '–')
    """
    known = np.array([each for each in values if math.isfinite(each)], np.float64)
    if not known.size:
        return "–"
    if (known == known[0]).all():
        whole = known[0] == round(known[0])
        return f"{known[0]:,.0f}" if whole else f"{known[0]:,.{digits}f}"
    return f"{known.mean():,.{digits}f} ± {known.std(ddof=1):,.{digits}f}"


def length(metres: float) -> str:
    """Millimetres as text.

    Examples
    --------
    >>> length(0.005)
    '5 mm'
    """
    return f"{1000 * metres:g} mm"
