"""The command view: a page with the frames of a batch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planewise.commands import terminal
from planewise.commands.batch_progress import size
from planewise.commands.command_line import reported
from planewise.commands.shared_options import (
    Every,
    Limit,
    optional,
)
from planewise.wording import counted

_MANY = 5000  # frames that a page opens with at ease


def view(
    store: Annotated[
        Path,
        typer.Argument(metavar="STORE", show_default=False, help="What 'planewise batch' made."),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="HTML", help="File of the page.")
    ] = Path("gallery.html"),
    source: Annotated[
        Path | None,
        optional("Where the frames are now, to draw planes over them. Default: where they were."),
    ] = None,
    limit: Limit = None,
    every: Every = 1,
) -> None:
    """Write one page with pictures, planes and curves of the frames, for any browser.

    Frames can be sorted and filtered by planes, nats and failures. It needs no network.
    """
    with reported():
        from planewise.batch import Selection, Store
        from planewise.batch.stored_source import StoredSource
        from planewise.gallery import write_gallery

        read = Store(store)
        chosen = Selection(every=every, limit=limit)
        count = len(chosen.of(read.known))
        if count > _MANY:
            terminal.warning(
                f"{count:,} frames make a page that browsers take long to open; "
                f"--every {-(-count // _MANY)} takes fewer"
            )
        with terminal.bar(count) as done:
            seen = StoredSource(read, source, poses=False)
            shown = write_gallery(read, output, selection=chosen, source=seen, report=done)
        if shown.alone:
            terminal.warning(
                f"the planes of {counted(shown.alone, 'frame')} are drawn without picture or "
                f"depth: {shown.reason}"
            )
        for reason in shown.damaged:
            terminal.warning(f"not drawn: {reason}")
        terminal.say(
            f"{counted(shown.frames, 'frame')}, of which {shown.failed:,} failed, "
            f"{size(output.stat().st_size)} in {output}"
        )
