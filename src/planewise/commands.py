"""The command line: its commands in the order in which help lists them."""

from __future__ import annotations

from typing import Annotated

import typer

from planewise import terminal
from planewise._version import __version__
from planewise.batch_command import batch
from planewise.bench_command import bench
from planewise.calibrate_command import calibrate
from planewise.demo_command import demo
from planewise.detect_command import detect
from planewise.eval_command import evaluate
from planewise.export_command import export
from planewise.frames_command import frames
from planewise.info_command import info
from planewise.nyu_command import nyu
from planewise.points_command import points
from planewise.reproduce_command import reproduce
from planewise.view_command import view

app = typer.Typer(
    name="planewise",
    help="Find every plane a depth image or point cloud can justify, how many, and rank them.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        terminal.say(f"planewise {__version__}")
        raise typer.Exit


@app.callback()
def _planewise(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass


app.command()(detect)
app.command()(points)
app.command()(batch)
app.command()(view)
app.command()(export)
app.command()(calibrate)
app.command()(frames)
app.command()(demo)
app.command("eval")(evaluate)
app.command()(bench)
app.command()(nyu)
app.command()(reproduce)
app.command()(info)
