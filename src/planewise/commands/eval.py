"""The command eval: scores of predicted label images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planewise.commands import terminal
from planewise.commands.command_line import check_output, reported
from planewise.commands.exit_codes import FAILED
from planewise.commands.jobs import Failed
from planewise.files.labels import STORE_FILE
from planewise.wording import counted


def evaluate(
    predicted: Annotated[
        Path,
        typer.Argument(
            metavar="PRED",
            show_default=False,
            help="Label image (16-bit PNG, .npy, or .npz with labels or gt), or a folder of them, "
            "such as 'planewise detect' makes, or a store of 'planewise batch'.",
        ),
    ],
    truth: Annotated[
        Path,
        typer.Argument(
            metavar="GT",
            show_default=False,
            help="The same with the truth, but no store; 0 is no plane.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="CSV", show_default=False, help="File for one line a frame."
        ),
    ] = None,
    iou: Annotated[
        list[float], typer.Option(help="Overlap above which a plane is found; may be repeated.")
    ] = [0.5, 0.8],  # noqa: B006 (typer copies it)
    minimum_pixels: Annotated[
        int, typer.Option(help="True planes smaller than this are neither hit nor miss.")
    ] = 400,
    tolerance: Annotated[
        float, typer.Option(help="Overlap that the five counts of Hoover et al. ask for.")
    ] = 0.8,
) -> None:
    """Score predicted label images against true ones.

    Prints means over the frames with 95 % confidence intervals.
    """
    with reported():
        from planewise.commands.label_pairs import pair_files
        from planewise.commands.scoring import Scoring, write_table
        from planewise.metrics import summarise

        pairs = pair_files(predicted, truth)
        if output is not None:
            check_output(output, ".csv", pairs.files)
            if (predicted / STORE_FILE).is_file():
                from planewise.batch.store_info import check_outside

                check_outside(predicted, output)
        for names, folder in ((pairs.only_true, predicted), (pairs.only_predicted, truth)):
            if names:
                terminal.warning(f"{folder} lacks {len(names)}: {terminal.listed(names)}")
        scoring = Scoring(iou=tuple(iou), minimum_pixels=minimum_pixels, tolerance=tolerance)
        results = list(terminal.progress(scoring.run_pairs(pairs), len(pairs.paired)))
        frames = [each for each in results if not isinstance(each, Failed)]
        for each in results:
            if isinstance(each, Failed):
                terminal.error(each.reason)
        if frames:
            terminal.show_scores(summarise(each.scores.row() for each in frames))
            if output is not None:
                write_table(output, frames)
        if len(results) > 1 or output is not None:
            where = ""
            if output is not None and frames:
                where = f", scores in {output}"
            elif output is not None and output.exists():
                where = f"; {output} still has what an earlier run wrote"
            terminal.say(f"{len(frames)} of {counted(len(results), 'frame')} scored{where}")
        if len(frames) < len(results):
            raise typer.Exit(FAILED)
