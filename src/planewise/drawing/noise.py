"""Picture of a noise curve: sigma against depth, with what was measured and its confidence band.

Drawn with Pillow alone, like the other chart.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planewise.calibration.estimate import NoiseEstimate
from planewise.drawing.axes import (
    BOTTOM,
    CHOSEN,
    FAINT,
    FINE,
    HEIGHT,
    INK,
    LEFT,
    LINE,
    RIGHT,
    TOP,
    WIDTH,
    Axes,
    Scale,
    round_step,
    write_ticks,
)  # fmt: skip
from planewise.noise import Noise

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw as Pen

Array = NDArray[np.float64]
Colour = tuple[int, int, int]

_BAND = (214, 226, 240)
_POINTS = 200  # along a curve
_DASH = 5


def draw_noise(
    estimate: NoiseEstimate, known: Noise | None = None, name: str = ""
) -> NDArray[np.uint8]:
    """Draw sigma against depth: bins, the curve through them, its 95 % band.

    Parameters
    ----------
    estimate : NoiseEstimate
        With at least one bin.
    known : callable, optional
        A curve to compare with, sigma(z) in metres, dashed.
    name : str
        What to call it.

    Returns
    -------
    ndarray of uint8, shape (500, 800, 3)
    """
    axes = Axes("drawing the noise")
    pen = axes.pen
    bins = estimate.bins
    margin = 0.04 * (np.ptp(bins.depth) or bins.depth[0])
    depth = np.linspace(max(bins.depth[0] - margin, 0.0), bins.depth[-1] + margin, _POINTS)
    curve = 1e3 * np.asarray(estimate.noise(depth))
    other = None if known is None else 1e3 * np.asarray(known(depth))
    heights = [curve, 1e3 * bins.sigma, 1e3 * np.nan_to_num(bins.high)]
    top = 1.08 * max(part.max() for part in (*heights, *([] if other is None else [other])))

    x_at = Scale(depth[0], depth[-1], LEFT * FINE, (WIDTH - RIGHT) * FINE)
    y_at = Scale(0.0, top, (HEIGHT - BOTTOM) * FINE, TOP * FINE)

    def line(x: Array, y: Array) -> list[tuple[float, float]]:
        return [(x_at(a), y_at(b)) for a, b in zip(x, y, strict=True)]

    levels = _ticks(0.0, top, 6)
    axes.levels(zip(map(y_at, levels), write_ticks(levels), strict=True))
    banded = len(bins.depth) > 1 and bool(np.isfinite(bins.low).all())
    if banded:
        outline = line(bins.depth, 1e3 * bins.high) + line(bins.depth, 1e3 * bins.low)[::-1]
        pen.polygon(outline, fill=_BAND)
    ticks = _ticks(float(depth[0]), float(depth[-1]), 8)
    axes.floor(zip(map(x_at, ticks), write_ticks(ticks), strict=True), "depth, m")
    axes.heading("sigma of a reading, mm")

    if other is not None:
        _dashed(pen, line(depth, other), FAINT)
    pen.line(line(depth, curve), fill=LINE, width=2 * FINE, joint="curve")
    for point in line(bins.depth, 1e3 * bins.sigma):
        pen.circle(point, 4 * FINE, fill=CHOSEN)

    left, right, row = (LEFT + 16) * FINE, (LEFT + 52) * FINE, (TOP + 16) * FINE
    entries = [("measured", CHOSEN), ("curve", LINE)]
    if banded:  # often thinner than the curve, which hides it
        widest = float(((bins.high - bins.low) / (2 * bins.sigma)).max())
        entries.append((f"95 % band, on walls: at most ± {100 * widest:.1f} %", _BAND))
    if other is not None:
        entries.append((name or "known", FAINT))
    for text, colour in entries:
        if colour == CHOSEN:
            pen.circle(((left + right) / 2, row), 4 * FINE, fill=colour)
        elif colour == FAINT:
            _dashed(pen, [(x, row) for x in np.linspace(left, right, 3 * _DASH)], colour)
        else:
            thick = (12 if colour == _BAND else 2) * FINE
            pen.line((left, row, right, row), fill=colour, width=thick)
        ink = INK if colour == _BAND else colour
        pen.text((right + 10 * FINE, row), text, fill=ink, font=axes.font, anchor="lm")
        row += 24 * FINE
    return axes.image()


def _ticks(low: float, high: float, most: int) -> Array:
    """Round numbers within bounds."""
    step = round_step(high - low, most)
    count = np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    return np.asarray(step * count, dtype=np.float64)


def _dashed(pen: Pen, points: list[tuple[float, float]], colour: Colour) -> None:
    """Every other stretch of a line of many points."""
    for start in range(0, len(points) - 1, 2 * _DASH):
        pen.line(points[start : start + _DASH + 1], fill=colour, width=2 * FINE)
