"""The command line: its commands in the order in which help lists them."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Annotated

import typer

from planewise._version import __version__
from planewise.commands import terminal

# Function of every command, in the module of its name.
_FUNCTIONS = {
    "detect": "detect",
    "points": "points",
    "batch": "batch",
    "view": "view",
    "export": "export",
    "calibrate": "calibrate",
    "frames": "frames",
    "demo": "demo",
    "eval": "evaluate",
    "bench": "bench",
    "nyu": "nyu",
    "reproduce": "reproduce",
    "info": "info",
}


def command_line(arguments: Sequence[str] = ()) -> typer.Typer:
    """Build the command line; of all commands, which help lists, or of the one that is asked for.

    Loading the others would take as long as finding planes.

    Parameters
    ----------
    arguments : sequence of str
        What follows the program's name. Options before the command take no values.
    """
    app = typer.Typer(
        name="planewise",
        help="Find every plane a depth image or point cloud can justify, how many, and rank them.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_planewise)
    asked = next((each for each in arguments if not each.startswith("-")), "")
    for name in [asked] if asked in _FUNCTIONS else _FUNCTIONS:
        module = import_module(f"planewise.commands.{name}")
        app.command(name)(getattr(module, _FUNCTIONS[name]))
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
        terminal.say(f"planewise {__version__}")
        raise typer.Exit


def _planewise(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass
