"""Rectangular blocks, the partition of Yang and Foerstner (2010)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planewise.arguments import make_counts
from planewise.partition.regions import Regions

if TYPE_CHECKING:
    from planewise.partition.partitioner import View


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """Rectangular blocks, left to right and top to bottom; those at the edges may be smaller.

    Parameters
    ----------
    rows, columns : int
        Pixels of a block.
    """

    rows: int = 120
    columns: int = 160

    def __post_init__(self) -> None:
        make_counts(self, "rows", "columns", least=2)

    def __call__(self, view: View) -> Regions:
        """Block of every pixel, from 1."""
        height, width = view.depth.shape
        down, across = np.arange(height) // self.rows, np.arange(width) // self.columns
        return np.asarray(1 + down[:, None] * (across[-1] + 1) + across, np.int32)

    def describe(self) -> str:
        """Say what it is."""
        return f"blocks of {self.rows} x {self.columns} pixels"
