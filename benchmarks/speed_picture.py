"""Picture of time against accuracy: every method a point, on synthetic and on real frames."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.methods import Result

PANELS = {
    "rooms": "synthetic rooms with clutter and holes",
    "nyu_dpd": "Kinect frames of rooms (NYU)",
}
"""Sets that are drawn where they were measured, and their titles."""

_COLOURS = {
    "planewise": "#0b5fff",
    "OpenCV": "#d9480f",
    "Open3D": "#2b8a3e",
    "CGAL": "#862e9c",
    "pyransac3d": "#866600",
}
_NEAR = 12  # points, beyond which a line leads from the name to the mark
_INK, _GRID = "#222222", "#e3e6ea"
# Where a label may be, in points from its mark: the first free place is taken.
_PLACES = tuple(
    (x, y)
    for distance in (9, 18, 30, 44)
    for x, y in ((distance, 0), (-distance, 0), (0, distance), (0, -distance),
                 (8, distance), (8, -distance), (-8, distance), (-8, -distance))
)  # fmt: skip


def draw(results: list[Result], path: Path) -> None:
    """Draw F1 of planes over milliseconds, one panel for each set in PANELS that was measured.

    Parameters
    ----------
    results : list of dict
        From `benchmarks.methods.compare`.
    path : Path
        File to write; its ending says the format.
    """
    import_module("matplotlib").use("Agg")
    pyplot = import_module("matplotlib.pyplot")
    panels = [name for name in PANELS if any(each["set"] == name for each in results)]
    if not panels:
        return
    size = (6.4 * len(panels) + 0.4, 5.2)
    figure, axes = pyplot.subplots(1, len(panels), figsize=size, sharey=True, squeeze=False)
    for axis, name in zip(axes[0], panels, strict=True):
        _panel(axis, name, [each for each in results if each["set"] == name])
    axes[0][0].set_ylabel("F1 of planes at an overlap of 0.5")
    figure.suptitle("Time against accuracy: up and to the left is better", color=_INK, y=0.985)
    figure.tight_layout()
    figure.canvas.draw()
    for axis, name in zip(axes[0], panels, strict=True):
        _label(figure, axis, [each for each in results if each["set"] == name])
    figure.savefig(path, dpi=150, facecolor="white")
    pyplot.close(figure)


def _panel(axis: Any, name: str, results: list[Result]) -> None:
    """Axes and marks of one set."""
    times = [each["ms"] for each in results]
    axis.set_xscale("log")
    axis.set_xlim(min(times) / 2.5, max(times) * 6)
    axis.set_ylim(0, 1.06)
    axis.set_title(f"{PANELS[name]}, {results[0]['frames']} frames", fontsize=10, color=_INK)
    axis.set_xlabel("one core, median time of a frame; lines: quartiles over the frames")
    axis.xaxis.set_major_formatter(lambda value, _: _duration(value))
    axis.grid(color=_GRID, which="major")
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    axis.minorticks_off()
    for each in results:
        ours = each["method"].startswith("planewise")
        low, high = each["quartiles_ms"]
        colour = _colour(each["method"])
        axis.plot([low, high], [each["F1@.5"]] * 2, color=colour, alpha=0.45, linewidth=2)
        axis.plot(
            each["ms"], each["F1@.5"], "D" if ours else "o", color=colour,
            markersize=9 if each["method"] == "planewise" else 7, markeredgecolor="white",
        )  # fmt: skip


def _label(figure: Any, axis: Any, results: list[Result]) -> None:
    """Names beside the marks, each in the first place that is free."""
    box = import_module("matplotlib.transforms").Bbox
    renderer = figure.canvas.get_renderer()
    frame = axis.get_window_extent(renderer)
    taken: list[Any] = []
    for each in results:
        x, y = axis.transData.transform((each["ms"], each["F1@.5"]))
        left, right = (axis.transData.transform((time, 0))[0] for time in each["quartiles_ms"])
        taken.append(box.from_extents(x - 10, y - 10, x + 10, y + 10))
        taken.append(box.from_extents(left - 2, y - 4, right + 2, y + 4))
    for each in sorted(results, key=lambda result: -result["F1@.5"]):
        at, colour = (each["ms"], each["F1@.5"]), _colour(each["method"])
        for dx, dy in _PLACES:
            text = axis.annotate(
                each["method"], at, (dx, dy), textcoords="offset points",
                fontsize=8.5, color=colour,
                fontweight="bold" if each["method"] == "planewise" else "normal",
                ha="left" if dx > 0 else "right" if dx < 0 else "center",
                va="bottom" if dy > 0 else "top" if dy < 0 else "center",
            )  # fmt: skip
            extent = text.get_window_extent(renderer).padded(1)
            inside = frame.x0 <= extent.x0 and extent.x1 <= frame.x1 and extent.y0 >= frame.y0
            if inside and extent.count_overlaps(taken) == 0:
                break
            text.remove()
        taken.append(extent)
        if max(abs(dx), abs(dy)) > _NEAR:
            line = {"arrowstyle": "-", "color": colour, "linewidth": 0.7, "shrinkA": 0}
            axis.annotate("", at, (dx, dy), textcoords="offset points", arrowprops=line)


def _colour(method: str) -> str:
    return next(colour for name, colour in _COLOURS.items() if method.startswith(name))


def _duration(milliseconds: float) -> str:
    return f"{milliseconds:g} ms" if milliseconds < 1000 else f"{milliseconds / 1000:g} s"
