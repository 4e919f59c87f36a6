"""The command reproduce: the paper's experiments as one report."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from planewise.commands import terminal
from planewise.commands.command_line import read_size, reported
from planewise.commands.shared_options import optional
from planewise.errors import PlanewiseError
from planewise.whole_files import output_folder

_SEEDS, _SIZE = 10, "640x480"
_QUICK_SEEDS, _QUICK_SIZE = 1, "160x120"
_SIDES = range(64, 4097)  # pixels; below, the scenes have too few readings to say anything


class _Name(StrEnum):
    staircase = "staircase"
    corner = "corner"
    flatness = "flatness"
    angles = "angles"
    limitation = "limitation"
    speed = "speed"
    all = "all"


def reproduce(
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="REPORT", show_default=False, help="Folder for the report."
        ),
    ],
    experiment: Annotated[
        _Name, typer.Argument(metavar="EXPERIMENT", help=f"One of {', '.join(_Name)}.")
    ] = _Name.all,
    seeds: Annotated[
        int | None,
        optional(f"Noisy frames of every scene. Default: {_SEEDS}, quick {_QUICK_SEEDS}."),
    ] = None,
    size: Annotated[
        str | None,
        optional(f"Pixels, width x height. Default: {_SIZE}, quick {_QUICK_SIZE}."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="A short version: small images, few angles and runs.")
    ] = False,
    processes: Annotated[
        int | None, optional("Default: one per processor. Speed is always measured alone.")
    ] = None,
) -> None:
    """Run the paper's synthetic experiments again: Open3D, the paper's search and planewise.

    Writes pictures, CSV files and report.html, which needs no other file; those of an earlier
    report in the same folder go.
    """
    with reported():
        from planewise.reproduce import report
        from planewise.reproduce.experiment import Settings
        from planewise.reproduce.experiments import EXPERIMENTS
        from planewise.reproduce.methods import available
        from planewise.runtime.threads import available as processors

        count = _at_least_one("seeds", seeds, _QUICK_SEEDS if quick else _SEEDS)
        workers = _at_least_one("processes", processes, processors())
        pixels = size or (_QUICK_SIZE if quick else _SIZE)
        settings = Settings(
            methods=available(), seeds=count, size=read_size(pixels, _SIDES, _SIZE), quick=quick
        )
        report.check_extra()
        chosen = [each for name, each in EXPERIMENTS.items() if experiment in (name, _Name.all)]
        command = f"planewise reproduce {experiment} --seeds {count} --size {pixels}"
        # Without a page there was no report: files of these names are somebody's own.
        again = (output / report.PAGE).exists()
        stale = [name for each in EXPERIMENTS.values() for name in each.files if again]
        with output_folder(output, stale) as folder:
            start = time.perf_counter()
            sections = report.run(chosen, settings, workers, terminal.progress)
            seconds = time.perf_counter() - start
            about = report.describe_run(settings, seconds, command + " --quick" * quick)
            report.write(folder, about, sections)
        if missing := about.get("without Open3D"):
            terminal.warning(f"without Open3D: {missing}")
        terminal.show_checks({each.title: each.checks for each in sections.values()})
        terminal.say(f"report in {output / report.PAGE}")


def _at_least_one(name: str, given: int | None, default: int) -> int:
    if given is not None and given < 1:
        raise PlanewiseError(f"{name} must be at least 1, got {given}")
    return default if given is None else given
