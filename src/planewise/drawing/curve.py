"""Picture of the curve: information against the number of planes.

Drawn with Pillow alone: loading a plotting library takes as long as finding the planes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planewise.drawing.axes import (
    BOTTOM,
    CHOSEN,
    FINE,
    HEIGHT,
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
from planewise.model import Curve
from planewise.wording import counted

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw as Pen
    from PIL.ImageFont import FreeTypeFont, ImageFont

Array = NDArray[np.float64]


def draw_curve(curve: Curve) -> NDArray[np.uint8]:
    """Draw information against the number of planes, with the chosen number marked.

    Parameters
    ----------
    curve : Curve
        Of a model.

    Returns
    -------
    ndarray of uint8, shape (500, 800, 3)
    """
    axes = Axes("drawing the curve")
    pen = axes.pen
    values = np.array(list(curve))
    ticks, unit = _ticks(values.min(), values.max())
    x_at, y_at = _scales(values, ticks)

    axes.levels(zip(map(y_at, ticks), write_ticks(ticks, unit), strict=True))
    numbers = range(0, len(values), max(1, round(round_step(len(values) - 1, 14))))
    axes.floor(((x_at(number), str(number)) for number in numbers), "planes in the model")
    name = {1: "nats", 1_000: "thousand nats", 1_000_000: "million nats"}[unit]
    before = any(move.kind == "reassign" for move in curve.moves)
    axes.heading(f"information of the model{' before reassignment' * before}, {name}")

    points = [(x_at(number), y_at(value)) for number, value in enumerate(values)]
    _mark_chosen(pen, points, curve, axes.title)
    if len(points) > 1:
        pen.line(points, fill=LINE, width=2 * FINE, joint="curve")
    for number, point in enumerate(points):
        chosen = number == curve.chosen
        pen.circle(point, (7 if chosen else 4) * FINE, fill=CHOSEN if chosen else LINE)
    return axes.image()


def _mark_chosen(
    pen: Pen,
    points: list[tuple[float, float]],
    curve: Curve,
    font: FreeTypeFont | ImageFont,
) -> None:
    """Dashed line through the chosen point, and what it says in words, clear of the curve."""
    x, y = points[curve.chosen]
    dash = 6 * FINE
    for top in range(TOP * FINE, (HEIGHT - BOTTOM) * FINE, 2 * dash):
        pen.line((x, top, x, top + dash), fill=CHOSEN, width=FINE)
    text = f"{counted(curve.chosen, 'plane')}\n{curve[curve.chosen]:,.0f} nats"
    gap = 14 * FINE
    box = pen.multiline_textbbox((0, 0), text, font=font)
    wide, tall = box[2] - box[0], box[3] - box[1]
    places = [
        (x + side * gap - (wide if side < 0 else 0), high)
        for high in (*(y - n * gap - tall for n in (1, 2)), TOP * FINE, y - 5 * gap - tall, y + gap)
        for side in (1.0, -1.0)
    ]

    def badness(place: tuple[float, float]) -> float:
        """Points and lines of the curve under the words; leaving the axes is worst."""
        px, py = place
        inside = px >= LEFT * FINE and px + wide <= (WIDTH - 4) * FINE
        inside = inside and py >= (TOP - 6) * FINE and py + tall <= (HEIGHT - BOTTOM) * FINE
        line = _along(points)
        near = (line[:, 0] > px - gap / 2) & (line[:, 0] < px + wide + gap / 2)
        near &= (line[:, 1] > py - 0.9 * gap) & (line[:, 1] < py + tall + 0.9 * gap)
        return 1e6 * (not inside) + float(near.sum())

    place = min(places, key=badness)
    pen.multiline_text((place[0] - box[0], place[1] - box[1]), text, fill=CHOSEN, font=font)


def _along(points: list[tuple[float, float]]) -> Array:
    """Dense points on the curve."""
    xy = np.array(points)
    at = np.linspace(0, len(xy) - 1, 40 * len(xy))
    number = np.arange(len(xy))
    return np.column_stack((np.interp(at, number, xy[:, 0]), np.interp(at, number, xy[:, 1])))


def _scales(values: Array, ticks: Array) -> tuple[Scale, Scale]:
    low, high = min(values.min(), ticks[0]), max(values.max(), ticks[-1])
    room = 0.06 * (high - low)
    last = max(len(values) - 1, 1)
    x = Scale(-0.03 * last, last * 1.02, LEFT * FINE, (WIDTH - RIGHT) * FINE)
    y = Scale(low - room, high + room, (HEIGHT - BOTTOM) * FINE, TOP * FINE)
    return x, y


def _ticks(low: float, high: float) -> tuple[Array, int]:
    """Round numbers that span the values, and the unit to write them in."""
    if high - low < 1e-9 * max(1.0, abs(high)):
        low, high = low - 0.5 * max(1.0, abs(low)), high + 0.5 * max(1.0, abs(high))
    step = round_step(high - low, 6)
    ticks = step * np.arange(math.ceil(low / step), math.floor(high / step) + 1, dtype=np.float64)
    largest = max(abs(low), abs(high))
    unit = 1_000_000 if largest >= 2e7 else 1_000 if largest >= 2e4 else 1
    return ticks, unit
