"""How numbers are put into words."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any


def counted(number: int, noun: str) -> str:
    """Number and noun.

    Examples
    --------
    >>> counted(1, "plane"), counted(1200, "plane")
    ('1 plane', '1,200 planes')
    """
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def unusual(record: Any, but: Iterable[str] = ()) -> str:
    """Fields of a dataclass that differ from their defaults, in words that go on a sentence.

    Examples
    --------
    >>> from planewise.partition import Graph
    >>> unusual(Graph(colour=0.25, reach=3, least=50), but=["least"])
    ', colour 0.25, reach 3'
    """
    said = ""
    for each in fields(record):
        value = getattr(record, each.name)
        if each.name not in but and value != each.default:
            said += f", {each.name} {value if isinstance(value, str) else format(value, '.15g')}"
    return said
