"""Charts as SVG whose ink can be recoloured, for pages that are light or dark."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from planewise.errors import needs
from planewise.reproduce.methods import OPEN3D, OURS, PAPER

INK = "#1c1e22"
"""Colour of writing, axes and the bound; a page may replace it by its own."""

_STYLES = {
    OPEN3D: ("#c2620e", "s"),
    PAPER: ("#3d7fd6", "^"),
    OURS: ("#1d9a6c", "o"),
}
_GREY = "#8a8f98"

Key = tuple[str, float]


@dataclass(frozen=True, kw_only=True)
class Line:
    """Values of one method in the panel (row, column)."""

    panel: Key
    name: str
    x: Sequence[float]
    y: Sequence[float]


def errors_chart(
    lines: Sequence[Line],
    *,
    bound: Mapping[str, Sequence[float]],
    angles: Sequence[float],
    columns: Mapping[float, str],
    rows: Mapping[str, str],
) -> str:
    """Draw errors against angles, one panel for each error and assumed noise.

    Parameters
    ----------
    lines : sequence of Line
        What was measured.
    bound : dict of sequence
        The bound of every row of panels at `angles`.
    angles : sequence of float
        Degrees.
    columns, rows : dict
        Panels from left to right and from top to bottom, and how they are called.

    Returns
    -------
    str
        An ``<svg>`` element without size, ink in `INK`.
    """
    matplotlib, pyplot = _matplotlib()
    style = {
        "svg.hashsalt": "planewise",
        "font.size": 9,
        "text.color": INK,
        "axes.edgecolor": _GREY,
        "axes.labelcolor": INK,
        "xtick.color": INK,
        "ytick.color": INK,
    }
    with matplotlib.rc_context(style):
        figure, axes = pyplot.subplots(
            len(rows), len(columns), figsize=(9.6, 2.9 * len(rows)), sharex=True, sharey="row",
            squeeze=False,
        )  # fmt: skip
        for i, row in enumerate(rows):
            for j, column in enumerate(columns):
                mine = [line for line in lines if line.panel == (row, column)]
                _panel(axes[i, j], mine, angles, bound[row])
        for j, title in enumerate(columns.values()):
            axes[0, j].set_title(title, fontsize=10)
            axes[-1, j].set_xlabel("angle between the planes (degrees)")
        for i, label in enumerate(rows.values()):
            axes[i, 0].set_ylabel(label)
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="upper center", ncols=len(labels), frameon=False, fontsize=10
        )
        figure.tight_layout(rect=(0, 0, 1, 0.95))
        out = io.StringIO()
        figure.savefig(out, format="svg", transparent=True, metadata={"Date": None})
        pyplot.close(figure)
    return _element(out.getvalue())


def _panel(
    axis: Any, lines: Sequence[Line], angles: Sequence[float], bound: Sequence[float]
) -> None:
    axis.set_yscale("log")
    axis.grid(color=_GREY, alpha=0.25, linewidth=0.6)
    axis.spines[["top", "right"]].set_visible(False)
    axis.set_xticks([60, 90, 120, 150, 175])
    for line in lines:
        colour, marker = _STYLES[line.name]
        axis.plot(line.x, line.y, marker + "-", color=colour, markersize=4, linewidth=1.4,
                  label=line.name)  # fmt: skip
    axis.plot(angles, bound, "--", color=INK, linewidth=1.3, label="Cramér–Rao bound")


def _matplotlib() -> tuple[Any, Any]:
    with needs("matplotlib", "the report", extra="reproduce"):
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    return matplotlib, pyplot


def _element(document: str) -> str:
    """The svg element alone, as wide as the page lets it be."""
    element = document[document.index("<svg") :]
    return re.sub(r'\b(?:width|height)="[\d.]+pt" ?', "", element, count=2)
