"""The command line: its commands in the order in which help lists them."""

from __future__ import annotations

from typing import Annotated

import typer

from planewise._version import __version__
from planewise.commands import terminal
from planewise.commands.batch import batch
from planewise.commands.bench import bench
from planewise.commands.calibrate import calibrate
from planewise.commands.demo import demo
from planewise.commands.detect import detect
from planewise.commands.eval import evaluate
from planewise.commands.export import export
from planewise.commands.frames import frames
from planewise.commands.info import info
from planewise.commands.nyu import nyu
from planewise.commands.points import points
from planewise.commands.reproduce import reproduce
from planewise.commands.view import view

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
