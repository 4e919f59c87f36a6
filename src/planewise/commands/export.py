"""The command export: results of a batch in formats that other programs read."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from planewise.commands import terminal
from planewise.commands.command_line import reported
from planewise.commands.exit_codes import FAILED
from planewise.commands.shared_options import (
    Every,
    Limit,
    optional,
)
from planewise.wording import counted

_SHOWN = 20  # frames that could not be exported


class _Format(StrEnum):
    coco = "coco"
    planercnn = "planercnn"
    png = "png"
    npz = "npz"


def export(
    store: Annotated[
        Path,
        typer.Argument(metavar="STORE", show_default=False, help="What 'planewise batch' made."),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="OUT", show_default=False, help="New or empty folder."
        ),
    ],
    form: Annotated[
        _Format,
        typer.Option(
            "--format",
            show_default=False,
            help="COCO instances, scenes as PlaneRCNN's training reads them, 16-bit label images, "
            "or NumPy archives.",
        ),
    ],
    source: Annotated[
        Path | None,
        optional(
            "Where the frames are now, for planercnn and --pictures. Default: where they were."
        ),
    ] = None,
    pictures: Annotated[
        bool, typer.Option("--pictures", help="COCO: write the pictures of the frames, too.")
    ] = False,
    limit: Limit = None,
    every: Every = 1,
) -> None:
    """Write labels and planes of a store in a format of other programs.

    The folder is there when all is written, or not at all.
    """
    with reported():
        from planewise.batch import Selection, Store
        from planewise.batch.stored_source import StoredSource
        from planewise.exports import FORMATS
        from planewise.exports import export as exported

        read = Store(store)
        chosen = Selection(every=every, limit=limit)
        kind = FORMATS[form.value]
        takes = kind.needs_source or pictures
        frames = exported(
            read,
            kind,
            output,
            selection=chosen,
            source=StoredSource(read, source, poses=kind.needs_source) if takes else None,
            pictures=pictures,
        )
        count = len(chosen.of(read.ids))
        failed = 0
        with terminal.bar(count) as done:
            for number, frame in enumerate(frames, start=1):
                done(number)
                failed += bool(frame.reason)
                if frame.reason and failed <= _SHOWN:
                    terminal.error(frame.reason)
                    if failed == _SHOWN:
                        terminal.notice("more are counted only")
        terminal.say(f"{count - failed:,} of {counted(count, 'frame')} in {output}")
        if failed:
            raise typer.Exit(FAILED)
