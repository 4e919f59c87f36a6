"""The command `planewise`: guards around the commands, whose imports may fail or be interrupted.

What Python imports before, the package itself, is not guarded: Ctrl-C within its 0.2 s ends as in
any other program of Python, with a traceback.
"""

from __future__ import annotations

import codecs
import gc
import io
import os
import sys

from planewise.commands.exit_codes import CLOSED_PIPE
from planewise.commands.interrupts import heed_interrupts, interrupted, was_interrupted

_WORDS = {"σ": "sigma", "±": "+-", "×": "x", "–": "-"}
_COLLECT_AFTER = 1_000_000  # objects; what is imported and loaded lives on, and looking takes 0.2 s


def _encode_all() -> None:
    """Have the streams write words for what they cannot encode, which is no error."""
    codecs.register_error("planewise", _in_words)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
            stream.reconfigure(errors="planewise")


def _in_words(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    signs = error.object[error.start : error.end]
    return "".join(_WORDS.get(sign, "?") for sign in signs), error.end


def main() -> None:
    """Run the command line; never ends with a traceback for what a user can put right."""
    gc.set_threshold(_COLLECT_AFTER)
    _encode_all()
    if os.environ.get("COLUMNS") == "0":  # as where there is no terminal; Rich would write nothing
        del os.environ["COLUMNS"]
    heed_interrupts()
    try:
        try:
            from planewise.commands.app import command_line

            app = command_line(sys.argv[1:])
        except ModuleNotFoundError as error:
            if error.name is None or error.name.split(".")[0] not in ("typer", "rich"):
                raise
            sys.stderr.write(
                f"planewise: the command line needs the package {error.name}, which is part of the "
                "extra 'cli': pip install 'planewise[cli]'\n"
            )
            raise SystemExit(1) from None
        try:
            app(prog_name="planewise")
        except SystemExit as end:
            if end.code == 1:  # as Rich and Typer end where a pipe is closed, and no command does
                raise SystemExit(CLOSED_PIPE) from None
            raise
    except (KeyboardInterrupt, Exception) as error:
        if not (isinstance(error, KeyboardInterrupt) or was_interrupted()):
            raise
        sys.stderr.write("error: interrupted; nothing was left half-written\n")
        raise SystemExit(interrupted()) from None
    finally:
        gc.freeze()  # at exit, too, Python would look through all objects


if __name__ == "__main__":
    main()
