"""Axes of the pictures drawn with Pillow: sizes, colours, scales and round numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from planewise.errors import needs

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


def write_ticks(ticks: NDArray[np.float64], unit: float = 1.0) -> list[str]:
    """Equally spaced ticks as text, all with the decimals that their step needs.

    Examples
    --------
    >>> write_ticks(np.array([234_800, 235_000, 235_200]), 1000)
    ['234.8', '235.0', '235.2']
    """
    step = (ticks[1] - ticks[0]) / unit if len(ticks) > 1 else 1.0
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return [f"{tick / unit:,.{decimals}f}" for tick in ticks]


class Axes:
    """An empty picture, then the lines and words about a curve; `pen` draws the rest.

    Parameters
    ----------
    what : str
        What is to be drawn, for the error where Pillow is missing.
    """

    def __init__(self, what: str) -> None:
        with needs("pillow", what):
            from PIL import Image, ImageDraw, ImageFont
        self._canvas = Image.new("RGB", (WIDTH * FINE, HEIGHT * FINE), "white")
        self.pen = ImageDraw.Draw(self._canvas)
        self.font = ImageFont.load_default(17 * FINE)
        self.title = ImageFont.load_default(18 * FINE)

    def levels(self, ticks: Iterable[tuple[float, str]]) -> None:
        """Horizontal lines at pixels, with what they stand for."""
        for y, text in ticks:
            self.pen.line((LEFT * FINE, y, (WIDTH - RIGHT) * FINE, y), fill=GRID, width=FINE)
            at = ((LEFT - 10) * FINE, y)
            self.pen.text(at, text, fill=FAINT, font=self.font, anchor="rm")

    def floor(self, ticks: Iterable[tuple[float, str]], name: str) -> None:
        """The horizontal axis, its ticks at pixels, and its name."""
        y = (HEIGHT - BOTTOM) * FINE
        self.pen.line((LEFT * FINE, y, (WIDTH - RIGHT) * FINE, y), fill=INK, width=FINE)
        for x, text in ticks:
            self.pen.line((x, y, x, y + 6 * FINE), fill=INK, width=FINE)
            self.pen.text((x, y + 12 * FINE), text, fill=FAINT, font=self.font, anchor="mt")
        middle = ((LEFT + WIDTH - RIGHT) / 2 * FINE, (HEIGHT - 12) * FINE)
        self.pen.text(middle, name, fill=INK, font=self.title, anchor="mb")

    def heading(self, text: str) -> None:
        """What the vertical axis shows."""
        self.pen.text((16 * FINE, 12 * FINE), text, fill=INK, font=self.title, anchor="lt")

    def image(self) -> NDArray[np.uint8]:
        """The picture, reduced to its size."""
        from PIL import Image

        return np.asarray(self._canvas.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS))
