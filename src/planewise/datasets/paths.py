"""Files of a dataset, none of which may lie outside it, whatever a list or a link in it says."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError
from planewise.files.depth import natural_order, without_results

LARGEST_TEXT = 100_000_000
"""Bytes; lists of frames are far smaller."""


def inside(root: Path, name: str | Path) -> Path:
    """Path of a file that a dataset names, if it leads nowhere else.

    Parameters
    ----------
    root : Path
        Folder of the dataset; it may be a link itself, for the user chose it.
    name : str or Path
        Below `root`.

    Raises
    ------
    PlanewiseError
        If it is absolute, climbs out by ``..``, or passes a link that leads out, or in a circle.
    """
    path = root / name
    try:
        leads_to = path.resolve()
    except (RuntimeError, OSError):  # which of them, and whether, depends on Python
        raise PlanewiseError(f"{name} is a link that leads in a circle; remove it") from None
    if not leads_to.is_relative_to(root.resolve()):
        raise PlanewiseError(f"{name} lies outside the dataset, or is a link out of it; not read")
    return path


def listed(folder: Path, wanted: Callable[[Path], bool]) -> list[Path]:
    """Files of a folder in natural order (frame 2 before frame 10).

    Hidden ones are left out, and so are pictures that a run wrote.

    Raises
    ------
    PlanewiseError
        If it is no folder.
    """
    if not folder.is_dir():
        raise PlanewiseError(f"{folder} is not a folder")
    paths = (path for path in folder.iterdir() if not path.name.startswith("."))
    return sorted(filter(wanted, without_results(paths)), key=natural_order)


def text_of(root: Path, name: str) -> str:
    """Text of a list that a dataset has of its frames.

    Raises
    ------
    PlanewiseError
        If it is missing, outside, too large or no text.
    """
    path = inside(root, name)
    if not path.is_file():
        raise PlanewiseError(f"there is no file {name}")
    if path.stat().st_size > LARGEST_TEXT:
        raise PlanewiseError(f"{name} is too large to be a list of frames")
    try:
        return path.read_text(encoding="utf-8-sig")  # some editors put a mark before the text
    except UnicodeDecodeError:
        raise PlanewiseError(f"{name} is damaged: it is no text") from None


def matrix_of(root: Path, name: str, sides: tuple[int, ...] = (4,)) -> NDArray[np.float64]:
    """Square matrix of a text file, of one of these numbers of rows."""
    words = text_of(root, name).split()
    for side in sides:
        if len(words) == side**2:
            with suppress(ValueError):
                return np.array(words, np.float64).reshape(side, side)
    raise PlanewiseError(f"{name} must hold {' or '.join(f'{n} x {n}' for n in sides)} numbers")
