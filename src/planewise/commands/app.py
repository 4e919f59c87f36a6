"""The command line: its commands in the order in which help lists them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from planewise._version import __version__
from planewise.commands import terminal
from planewise.commands.exit_codes import FAILED

# Typer has it of Click, or of its own copy of it.
_USAGE_ERROR: Any = typer.BadParameter.__base__

_TABLES = 80  # characters that they need

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
        cls=_Commands,
        name="planewise",
        help="Find every plane a depth image or point cloud can justify, how many, and rank them.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
        # Tables of a narrow terminal would cut names of options off.
        rich_markup_mode="rich" if terminal.width() >= _TABLES else None,
    )
    app.callback()(_planewise)
    asked = next((each for each in arguments if not each.startswith("-")), "")
    for name in [asked] if asked in _FUNCTIONS else _FUNCTIONS:
        module = import_module(f"planewise.commands.{name}")
        app.command(name)(getattr(module, _FUNCTIONS[name]))
    return app


class _Commands(TyperGroup):
    """Says in one line what of the arguments cannot be used."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        for each in args:  # a path of no letters would be the current folder
            if not each or (each.startswith("--") and each.endswith("=")):
                where = each.removesuffix("=") or "an argument"
                raise _USAGE_ERROR(
                    f"{where} is empty, perhaps a variable of the shell that is not set", ctx=ctx
                )
        return super().parse_args(ctx, args)

    def main(self, *arguments: Any, standalone_mode: bool = True, **options: Any) -> NoReturn:
        try:
            code = self._run(*arguments, **options)
        except OSError as error:  # of help and version; commands report theirs
            terminal.error(f"stdout cannot be written to ({error.strerror or error})")
            code = FAILED
        sys.exit(code)

    def _run(self, *arguments: Any, **options: Any) -> Any:
        """Exit code of what was asked for."""
        try:
            return super().main(*arguments, standalone_mode=False, **options)  # type: ignore[misc]
        except _USAGE_ERROR as error:
            message = error.format_message()
            if type(error).__name__ == "NoArgsIsHelpError":
                typer.echo(message, nl=bool(message))  # the help, where Rich has not printed it
            else:
                message = message.removesuffix(".").replace("Value error, ", "")  # of pydantic
                where = "planewise" if error.ctx is None else error.ctx.command_path
                terminal.error(f"{message}; see '{where} -h'")
            return FAILED


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
