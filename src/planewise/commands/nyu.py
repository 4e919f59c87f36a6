"""The command nyu: the paper's evaluation on NYU-v2, or on what has its form."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planewise.camera import PinholeCamera
from planewise.commands import terminal
from planewise.commands.command_line import check_seed, partition_of, reported
from planewise.commands.exit_codes import FAILED
from planewise.commands.shared_options import (
    CAMERA_HELP,
    SamDevice,
    SamModel,
    Seed,
    Threads,
    optional,
)
from planewise.errors import PlanewiseError, SetupError
from planewise.files.camera import read_camera
from planewise.whole_files import output_folder
from planewise.wording import counted

if TYPE_CHECKING:
    from planewise.datasets.frames import Dataset
    from planewise.reproduce.nyu import Protocol, Row


class _Depth(StrEnum):
    filled = "filled"
    raw = "raw"


def nyu(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA",
            show_default=False,
            help="nyu_depth_v2_labeled.mat; a folder with depth/N.png (16 bits, millimetres), "
            "rgb/N.png and gt/N.png; or a folder of .npz with depth, K, rgb and gt.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="OUT", show_default=False, help="Folder for table and CSV."
        ),
    ],
    truth: Annotated[
        Path | None,
        optional(
            "Folder of true planes: plane_instance_N.npz (NYUv2-Plane), or label images N.png. "
            "Needed with the .mat, whose own labels are of objects."
        ),
    ] = None,
    depth: Annotated[
        _Depth | None,
        optional("Of the .mat: holes painted in (the default), or as measured."),
    ] = None,
    camera: Annotated[
        str | None, optional(f"{CAMERA_HELP} Default: NYU-v2's, or of a usual crop of it.")
    ] = None,
    limit: Annotated[int | None, optional("Take the first n frames that have a truth.")] = None,
    partition: Annotated[
        str | None,
        optional(
            "Regions for the paper's search: auto, graph, blocks, sam, or a folder of label images "
            "or of folders of masks named like the frames."
        ),
    ] = None,
    sam_model: SamModel = None,
    sam_device: SamDevice = None,
    seed: Seed = 0,
    threads: Threads = None,
) -> None:
    """Score the paper's search and ours on NYU-v2 as the paper does (VOI, RI, SC).

    Prints the paper's table with our rows below, and writes nyu.csv and nyu.md.
    """
    with reported():
        check_seed(seed)
        if limit is not None and limit < 1:
            raise PlanewiseError(f"limit must be at least 1, got {limit}")
        if depth is not None and data.is_dir():
            raise PlanewiseError(
                f"depth: {data} is a folder; --depth chooses among those of a .mat"
            )

        from planewise.datasets.nyu import open_nyu
        from planewise.options import Options
        from planewise.reproduce.nyu import (
            COLUMNS,
            MEANING,
            Protocol,
            lines_of,
            notes_on,
            table_of,
            write_report,
        )

        known = None if camera is None else read_camera(camera)
        if known is not None and not isinstance(known, PinholeCamera):
            raise PlanewiseError(f"camera: {camera} is a LiDAR; the dataset's is a pinhole camera")
        dataset = open_nyu(
            data,
            truth=truth,
            depth="rawDepths" if depth is _Depth.raw else "depths",
            camera=known,
        )
        named, folder_of_regions = partition_of(partition, sam_model, sam_device)
        options = {"rng": seed, "threads": threads}
        Options(**options)  # type: ignore[arg-type]
        protocol = Protocol(partition=folder_of_regions or named, options=options)
        ids = dataset.labelled[:limit]
        if not ids:
            raise PlanewiseError(f"truth: {data} brings no true planes; give a folder with --truth")
        labelled = set(dataset.labelled)
        left_out = [each for each in dataset.ids if each not in labelled]
        if left_out and truth is None:  # labels of one half, as those of NYUv2-Plane, are a choice
            terminal.notice(
                f"{len(left_out)} of {len(dataset.ids)} frames without true planes are left out: "
                f"{terminal.listed(left_out)}"
            )
        with output_folder(output) as folder:
            rows, shapes = _scored(dataset, ids, protocol)
            if not rows:
                raise PlanewiseError(f"data: none of {counted(len(ids), 'frame')} could be scored")
            lines, scored = lines_of(rows), len({row.frame for row in rows})
            notes = notes_on(protocol, dataset, scored, shapes)
            write_report(folder, lines, rows, notes)
        terminal.show_table(MEANING, table_of(lines), COLUMNS)
        for note in notes:
            terminal.say_wrapped(note)
        terminal.say(f"{scored} of {counted(len(ids), 'frame')} scored, files in {output}")
        if scored < len(ids):
            raise typer.Exit(FAILED)


def _scored(
    dataset: Dataset, ids: Sequence[str], protocol: Protocol
) -> tuple[list[Row], set[tuple[int, int]]]:
    """Rows of all frames that can be used, and the sizes of these; the others are reported."""
    rows: list[Row] = []
    shapes: set[tuple[int, int]] = set()
    for each in terminal.progress(ids, len(ids)):
        try:
            frame = dataset[each]
            rows += protocol.run(frame)
            shapes.add((frame.depth.shape[0], frame.depth.shape[1]))
        except SetupError:
            raise
        except ValueError as error:
            terminal.error(str(error))
    return rows, shapes
