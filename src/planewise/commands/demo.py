"""The command demo: a synthetic room, its planes and their pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planewise.commands import terminal
from planewise.commands.command_line import check_seed, reported
from planewise.commands.jobs import find_planes
from planewise.errors import PlanewiseError
from planewise.files.result_names import PARAMETERS, stale_files
from planewise.results.image import write_image, write_results
from planewise.whole_files import output_folder

_ROOM = ("depth.png", "rgb.png", "truth.png")


def demo(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="OUT", help="Folder for the pictures.")
    ] = Path("planewise-demo"),
    seed: Annotated[int, typer.Option(help="Every seed is another room.")] = 0,
) -> None:
    """Build a synthetic room, find its planes and draw them."""
    with reported():
        check_seed(seed)
        for name in () if _holds_demo(output) else _ROOM:
            if (output / name).exists():
                raise PlanewiseError(
                    f"output: {output / name} is no demo's and would be replaced; "
                    "give another folder with -o"
                )
        with output_folder(output, stale_files(output)) as folder:
            from planewise import scenes
            from planewise.drawing.overlay import draw_labels
            from planewise.options import Options

            room = scenes.room(seed)
            options = Options()
            model, seconds, _ = find_planes(room.depth, room.camera, room.sensor, None, options)
            write_image(folder / "rgb.png", room.rgb)
            write_image(folder / "depth.png", room.depth)
            write_image(folder / "truth.png", draw_labels(room.labels, room.rgb))
            write_results(
                folder,
                model,
                depth=room.depth,
                camera=room.camera,
                sensor=room.sensor,
                rgb=room.rgb,
                source="depth.png",
            )
        terminal.show_planes(model)
        terminal.show_summary(model, seconds, output)
        found = int(room.found(model.labels).sum())
        terminal.say(
            f"{found} of the room's {len(room.planes)} planes were found (more than half in common)"
        )


def _holds_demo(folder: Path) -> bool:
    """Whether an earlier demo wrote there: all its pictures, and planes of their depth."""
    if not all((folder / name).is_file() for name in (*_ROOM, PARAMETERS)):
        return False
    return b'"file": "depth.png"' in (folder / PARAMETERS).read_bytes()
