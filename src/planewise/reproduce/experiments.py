"""The experiments that the command knows, in the order of the page.

A further one is a module with an `Experiment` and an entry here.
"""

from __future__ import annotations

from planewise.reproduce.angles import ANGLES
from planewise.reproduce.flatness import FLATNESS
from planewise.reproduce.limitation import LIMITATION
from planewise.reproduce.speed import SPEED
from planewise.reproduce.stairs_and_corner import CORNER, STAIRCASE

EXPERIMENTS = {each.name: each for each in (STAIRCASE, CORNER, FLATNESS, ANGLES, LIMITATION, SPEED)}
