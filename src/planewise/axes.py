"""Axes of the pictures drawn with Pillow: sizes, colours, scales and round numbers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH, HEIGHT = 800, 500
LEFT, RIGHT, TOP, BOTTOM = 96, 24, 40, 64
FINE = 2  # drawn so much larger, then reduced: smooth lines
INK, FAINT, GRID = (28, 30, 34), (110, 114, 120), (228, 228, 228)
LINE, CHOSEN = (58, 110, 165), (200, 85, 61)


class Scale:
    """Linear map from a value to a pixel."""

    def __init__(self, low: float, high: float, first: float, last: float) -> None:
        self.low, self.first = low, first
        self.slope = (last - first) / (high - low)

    def __call__(self, value: float) -> float:
        """Pixel of a value."""
        return float(self.first + (value - self.low) * self.slope)


def round_step(span: float, most: int) -> float:
    """Smallest of 1, 2, 5, 10, 20 ... that divides a span into at most `most` parts."""
    rough = max(span, 1e-12) / most
    power = 10.0 ** math.floor(math.log10(rough))
    return next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough * (1 - 1e-9))
