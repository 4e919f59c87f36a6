"""What an experiment is: trials that can be measured in any order, and a section made of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.reproduce.section import Section

Row = dict[str, Any]
"""One line of a CSV file: numbers and words by column."""

TRUE_SIGMA = 0.005
"""Standard deviation of the noise of the scenes, metres."""

SIGMAS = (0.002, 0.005, 0.010)
"""What methods are told it is, metres."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How thoroughly to measure.

    Attributes
    ----------
    methods : tuple of str
        Methods that can be run here; see `planewise.reproduce.methods`.
    seeds : int
        Frames of every scene with noise.
    size : (height, width)
        Pixels of the scenes.
    quick : bool
        Fewer angles and fewer timed runs.
    """

    methods: tuple[str, ...]
    seeds: int = 10
    size: tuple[int, int] = (480, 640)
    quick: bool = False


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One frame to give to every method; it says all that the measuring process has to know.

    Attributes
    ----------
    scene : str
        Name of a function of `planewise.scenes`.
    seed : int
        Of the noise and of the methods.
    size : (height, width)
        Pixels.
    methods : tuple of str
        Which methods to run.
    noise : float
        True standard deviation, metres.
    angle : float
        Between the planes, degrees, where the scene has one.
    """

    scene: str
    seed: int
    size: tuple[int, int]
    methods: tuple[str, ...]
    noise: float = TRUE_SIGMA
    angle: float = float("nan")


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A line of numbers, and the label image where it is to be shown."""

    row: Row
    labels: NDArray[np.integer] | None = field(default=None, repr=False)


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One section of the report.

    Attributes
    ----------
    name : str
        On the command line and of files.
    trials : callable
        From settings to trials, which have to survive a journey to another process.
    measure : callable
        Function of a module, from a trial to what was measured.
    section : callable
        From settings and everything measured, in the order of the trials, to the section.
    files : tuple of str
        Names of all files that its section can ask for, whatever the settings.
    alone : bool
        Times are the result: nothing else may run beside it.
    """

    name: str
    trials: Callable[[Settings], Sequence[Any]]
    measure: Callable[[Any], list[Measured]]
    section: Callable[[Settings, Sequence[Measured]], Section]
    files: tuple[str, ...]
    alone: bool = False
