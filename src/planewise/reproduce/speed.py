"""Speed: milliseconds a frame, one method after the other with nothing beside them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planewise import scenes
from planewise.reproduce.experiment import Experiment, Measured, Row, Settings
from planewise.reproduce.methods import OPEN3D, OURS, PAPER, Frame, prepared
from planewise.reproduce.section import Section, Table
from planewise.scenes.scene import Scene

PAPER_SECONDS = {"Python, with Segment Anything": 308, "C++": 21}
"""The paper's own figures a frame, on an Intel Core i3-10100F with an Nvidia GeForce RTX 3070."""

_RATIOS = {"staircase": 0.25, "corner": 0.25, "room": 0.1}
"""Frames that are timed, and the smallest plane's share of the readings that methods are told."""

_RUNS, _QUICK_RUNS = 15, 3


@dataclass(frozen=True, kw_only=True)
class Timing:
    """A frame on which all methods are timed by turns."""

    scene: str
    size: tuple[int, int]
    methods: tuple[str, ...]
    runs: int


def _trials(settings: Settings) -> list[Timing]:
    return [
        Timing(
            scene=name,
            size=settings.size,
            methods=settings.methods,
            runs=_QUICK_RUNS if settings.quick else _RUNS,
        )
        for name in _RATIOS
    ]


def _scene(name: str, size: tuple[int, int]) -> Scene:
    return scenes.room(0, size=size) if name == "room" else getattr(scenes, name)(size=size)


def _measure(timing: Timing) -> list[Measured]:
    scene = _scene(timing.scene, timing.size)
    sigma = float(scene.sensor.sigma(np.array([2.0]))[0])
    calls = {}
    for method in timing.methods:
        for threads in (1,) if method == OPEN3D else (1, None):
            frame = Frame(
                depth=scene.depth,
                camera=scene.camera,
                sensor=scene.sensor,
                sigma=sigma,
                inlier_ratio=_RATIOS[timing.scene],
                threads=threads,
            )
            calls[method, "all" if method == OPEN3D or threads is None else "1"] = prepared(
                method, frame
            )
    seconds: dict[tuple[str, str], list[float]] = {name: [] for name in calls}
    for turn in range(timing.runs + 1):
        for name, call in calls.items():
            # Open3D takes seconds, and has nothing to warm up.
            if turn == 0 if name[0] == OPEN3D else True:
                start = time.perf_counter()
                call()
                seconds[name].append(time.perf_counter() - start)
    return [
        Measured(row=_row(timing, *name, times if len(times) == 1 else times[1:]))
        for name, times in seconds.items()
    ]


def _row(timing: Timing, method: str, threads: str, seconds: list[float]) -> Row:
    low, middle, high = np.percentile(1000 * np.array(seconds), (25, 50, 75)).tolist()
    return {
        "scene": timing.scene,
        "method": method,
        "threads": threads,
        "runs": len(seconds),
        "median_ms": middle,
        "lower_quartile_ms": low,
        "upper_quartile_ms": high,
    }


def _section(settings: Settings, measured: Sequence[Measured]) -> Section:
    rows = [each.row for each in measured]
    height, width = settings.size
    own = " and ".join(f"{seconds} s ({what})" for what, seconds in PAPER_SECONDS.items())
    return Section(
        title="Speed",
        text=(
            f"Frames of {width} × {height} pixels: staircase and corner with r = 0.25, and a "
            "synthetic room with clutter and holes with r = 0.1, where the paper's search has to "
            "draw 4,603 samples a plane instead of 293. Methods take turns, and the median of "
            "the turns counts; Open3D runs once.",
            f"For reference, the paper reports {own} for a frame of the NYU set on an Intel Core "
            "i3-10100F with an Nvidia GeForce RTX 3070. These are other frames on another "
            "machine, and the former includes a neural segmentation: they give an idea of the "
            "size, not a comparison.",
        ),
        blocks=(_table(rows),),
        remarks=_in_words(rows),
        files={"speed": rows},
    )


def _table(rows: Sequence[Row]) -> Table:
    return Table(
        caption=(
            "Milliseconds a frame: median, and the quartiles in brackets. Open3D starts from "
            "points, the others from the depth image."
        ),
        header=("frame", "method", "one thread", "all processors"),
        rows=[
            (scene, method, _cell(rows, scene, method, "1"), _cell(rows, scene, method, "all"))
            for scene in dict.fromkeys(row["scene"] for row in rows)
            for method in dict.fromkeys(row["method"] for row in rows)
        ],
    )


def _cell(rows: Sequence[Row], scene: str, method: str, threads: str) -> str:
    for row in rows:
        if (row["scene"], row["method"], row["threads"]) == (scene, method, threads):
            low, middle, high = (
                row[f"{name}_ms"] for name in ("lower_quartile", "median", "upper_quartile")
            )
            digits = 0 if middle >= 100 else 1
            if row["runs"] == 1:
                return f"{middle:,.{digits}f}"
            return f"{middle:,.{digits}f} ({low:,.{digits}f} … {high:,.{digits}f})"
    return "–"


def _in_words(rows: Sequence[Row]) -> tuple[str, ...]:
    ratios = []
    for scene in _RATIOS:
        medians = {
            row["method"]: row["median_ms"]
            for row in rows
            if row["scene"] == scene and row["threads"] == "1"
        }
        ratios.append(f"{medians[PAPER] / medians[OURS]:.0f} ({scene})")
    return (
        f"On one thread planewise is faster than the paper's search by a factor of "
        f"{', '.join(ratios)}.",
    )


SPEED = Experiment(
    name="speed",
    trials=_trials,
    measure=_measure,
    section=_section,
    files=("speed.csv",),
    alone=True,
)
