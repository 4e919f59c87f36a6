"""Run experiments and write their report: pictures, CSV files and one page."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

from planewise.errors import needs
from planewise.machine import describe_machine
from planewise.reproduce.experiment import Experiment, Measured, Row, Settings
from planewise.reproduce.methods import CONFIDENCE, OPEN3D
from planewise.reproduce.open3d_ransac import why_missing
from planewise.reproduce.page import page
from planewise.reproduce.section import Chart, Section
from planewise.reproduce.tasks import compile_once, each_in_order
from planewise.wording import counted

PAGE = "report.html"

Watch = Callable[[Iterator[list[Measured]], int], Iterable[list[Measured]]]
"""Passes results on while it shows how many of how many there are."""


def check_extra() -> None:
    """Refuse to start without the packages that the report is made with.

    Raises
    ------
    MissingExtraError
        Which names the extra.
    """
    for package, module in (("matplotlib", "matplotlib"), ("jinja2", "jinja2"), ("pillow", "PIL")):
        with needs(package, "the report", extra="reproduce"):
            import_module(module)


def run(
    experiments: Sequence[Experiment], settings: Settings, processes: int, watch: Watch
) -> dict[str, Section]:
    """Measure all trials, those that are timed at the end and alone, and make the sections.

    Parameters
    ----------
    experiments : sequence of Experiment
        In the order of the page.
    settings : Settings
        How thoroughly.
    processes : int
        For the experiments whose result is not a time.
    watch : callable
        Shows how far it is.

    Returns
    -------
    dict of Section
        By the names of the experiments.
    """
    trials = {each.name: each.trials(settings) for each in experiments}
    together = [each for each in experiments if not each.alone]
    work = [(each.measure, trial) for each in together for trial in trials[each.name]]
    alone = [
        (each.measure, trial) for each in experiments if each.alone for trial in trials[each.name]
    ]
    total = len(work) + len(alone)
    results = iter(watch(_measured(work, alone, processes), total))
    ordered = [*together, *(each for each in experiments if each.alone)]
    measured = {
        each.name: [one for _ in trials[each.name] for one in next(results)] for each in ordered
    }
    for _ in results:  # lets the watcher finish
        pass
    return {each.name: each.section(settings, measured[each.name]) for each in experiments}


def _measured(
    work: Sequence[tuple[Callable[[Any], list[Measured]], Any]],
    alone: Sequence[tuple[Callable[[Any], list[Measured]], Any]],
    processes: int,
) -> Iterator[list[Measured]]:
    yield from each_in_order(work, processes)
    if alone:
        compile_once()
    for measure, trial in alone:
        yield measure(trial)


def describe_run(settings: Settings, seconds: float, command: str) -> dict[str, str]:
    """Say what was run, when and on what, for the head of the page."""
    machine = describe_machine(("open3d",))
    versions = dict(machine["versions"])
    known = ", ".join(f"{name} {each}" for name, each in versions.items() if name != "planewise")
    height, width = settings.size
    without = (
        {}
        if OPEN3D in settings.methods
        else {
            "without Open3D": f"it cannot be imported here ({why_missing()}); its rows are left "
            "out. It comes with the extra reproduce where there are wheels of it."
        }
    )
    return {
        "version": f"planewise {versions['planewise']}",
        "command": command,
        "date": f"{datetime.now(UTC):%d %B %Y, %H:%M} UTC; {_duration(seconds)}",
        "machine": f"{machine['processor']}, {machine['processors']} processors, "
        f"{machine['system']}",
        "with": known,
        "frames": f"{width} × {height} pixels, {counted(settings.seeds, 'seed')}",
        "Open3D": "segment_plane again and again on the readings that are left, distance "
        f"threshold σ, as many samples as c = {CONFIDENCE} and r ask for "
        "(ln(1 - c) / ln(1 - r³)), probability c",
        "paper's search": 'planewise with search="sequential", which minimises the paper\'s '
        "objective, with the paper's c, r and N",
        "planewise": "detect_planes without options: no c, no r and no number of planes",
        **without,
    }


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def write(folder: Path, about: Mapping[str, str], sections: Mapping[str, Section]) -> None:
    """Write the page, and beside it its pictures and the numbers behind it."""
    (folder / PAGE).write_text(page(about, sections), encoding="utf-8")
    for section in sections.values():
        for picture in section.pictures:
            (folder / f"{picture.name}.png").write_bytes(picture.png)
        for block in section.blocks:
            if isinstance(block, Chart):
                paper = block.svg.replace("<svg ", '<svg style="background: #fff" ', 1)
                (folder / f"{block.name}.svg").write_text(paper, encoding="utf-8")
        for name, rows in section.files.items():
            _write_csv(folder / f"{name}.csv", rows)


def _write_csv(path: Path, rows: Sequence[Row]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)


def _cell(value: object) -> object:
    """Numbers to ten digits; nothing for what is not defined."""
    if isinstance(value, float):
        return f"{value:.10g}" if math.isfinite(value) else ""
    return value
