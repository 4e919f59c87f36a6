"""The command frames: what a dataset is, how many frames it has, and which of them are damaged."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from planewise import sensors
from planewise.arguments import checked_scale
from planewise.commands import terminal
from planewise.commands.command_line import reported
from planewise.commands.exit_codes import FAILED
from planewise.commands.shared_options import (
    CameraInstead,
    CameraTopic,
    Kind,
    Topic,
    optional,
)
from planewise.errors import PlanewiseError, SetupError
from planewise.files.camera import read_camera
from planewise.wording import counted

if TYPE_CHECKING:
    from planewise.datasets import Dataset, DatasetFrame, PointDataset, PointFrame

_FIRST = 3  # ids that are shown, and errors that are the same
_LISTED = 16  # numbers of a camera; no distortion has more


def frames(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="PATH", show_default=False, help="Folder or file; docs/datasets.md lists kinds."
        ),
    ],
    kind: Kind = None,
    camera: CameraInstead = None,
    depth_scale: Annotated[
        float | None, optional("Metres per unit of integer depth, instead of the dataset's.")
    ] = None,
    topic: Topic = None,
    camera_topic: CameraTopic = None,
    check: Annotated[
        bool, typer.Option("--check", help="Read every frame, and report those that are damaged.")
    ] = False,
) -> None:
    """Say what a dataset is: kind, frames, camera, and with --check what is damaged."""
    with reported():
        checked_scale(depth_scale)
        from planewise import datasets
        from planewise.datasets.ros import topics_of

        known = None if camera is None else read_camera(camera)
        dataset = datasets.open(
            data,
            kind,
            camera=known,
            depth_scale=depth_scale,
            topic=topic,
            camera_topic=camera_topic,
        )
        parts = getattr(dataset, "parts", {})
        known_as = counted(len(parts), "dataset") if parts else dataset.holds
        terminal.say(f"{dataset.kind}: {known_as}")
        some = ", ".join(dataset.ids[:_FIRST]) + (" ..." if len(dataset) > _FIRST else "")
        terminal.say(f"{counted(len(dataset), 'frame')}: {some}")
        pictured = getattr(dataset, "pictured", None)
        if pictured is not None and len(pictured) < len(dataset):
            terminal.say(f"pictures: of {len(pictured):,} of {counted(len(dataset), 'frame')}")
        for option, names in topics_of(dataset).items():
            terminal.say(f"{option.replace('_', ' ')}: {', '.join(names)}")
        _show_first(dataset.without_pictures().without_poses(), quiet=check)
        if check and _damaged(dataset):
            raise typer.Exit(FAILED)


def _show_first(dataset: Dataset | PointDataset, quiet: bool) -> None:
    """Describe the first frame, which tells the camera; where it is damaged, say so or be quiet."""
    try:
        first: DatasetFrame | PointFrame = dataset[0]
    except SetupError:
        raise
    except PlanewiseError as error:
        if not quiet:
            terminal.warning(str(error))
        return
    if hasattr(first, "points"):
        terminal.say(f"first frame: {counted(len(first.points), 'point')}")
        return
    height, width = first.depth.shape
    camera = ", ".join(f"{name} {_short(each)}" for name, each in first.camera.describe().items())
    terminal.say(f"camera: {camera}")
    sensor = getattr(dataset, "sensor", None)
    presets = [name for name, each in sensors.PRESETS.items() if each == sensor]  # some are equal
    terminal.say(f"sensor: {' or '.join(presets) or 'not stated'}")
    scale = 1.0 if first.depth_scale is None else first.depth_scale
    unit = "metres" if first.depth_scale is None else f"units of {1000 * scale:g} mm"
    readings = scale * first.depth[first.valid].astype(np.float64)
    far = f", {readings.min():.2f} ... {readings.max():.2f} m" if readings.size else ""
    terminal.say(
        f"first frame: {width} x {height}, {unit}, {first.valid.mean():.0%} with a reading{far}"
    )
    try:
        first.camera.check((height, width))
    except ValueError as error:
        terminal.warning(str(error))


def _short(value: object) -> object:
    """Of long lists, such as a LiDAR's beams, the ends and the length."""
    if isinstance(value, list | tuple) and len(value) > _LISTED:
        return f"{value[0]} ... {value[-1]} ({len(value)})"
    return value


def _damaged(dataset: Dataset | PointDataset) -> int:
    """Read all frames; report and count those that cannot be read, what many have in common once.

    A camera that does not go with the images would else be said of every frame.
    """
    from planewise.datasets.frames import check_text

    damaged = 0
    alike: dict[str, list[str]] = {}  # frames by error
    for each in terminal.progress(dataset.ids, len(dataset)):
        try:
            frame: DatasetFrame | PointFrame = dataset[each]
            if not hasattr(frame, "points"):
                frame.camera.check(frame.depth.shape)
                check_text(dataset.name, each)
        except SetupError:
            raise
        except ValueError as error:
            damaged += 1
            read = not isinstance(error, PlanewiseError)  # of the camera, who knows no frame
            message = f"{dataset.name}, frame {each}: {error}" if read else str(error)
            same = alike.setdefault(message.replace(each, ""), [])
            same.append(each)
            if len(same) <= _FIRST:
                terminal.error(message)
    for first, *others in alike.values():
        if more := others[_FIRST - 1 :]:
            terminal.error(
                f"the same as of frame {first} goes for {counted(len(more), 'more frame')}: "
                f"{terminal.listed(more)}"
            )
    terminal.say(f"{len(dataset) - damaged:,} of {counted(len(dataset), 'frame')} can be read")
    return damaged
