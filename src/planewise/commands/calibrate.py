"""The command calibrate: from frames of a camera to a file that describes its sensor."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planewise.arguments import checked_scale
from planewise.commands import terminal
from planewise.commands.command_line import check_output, check_seed, preset_of, reported
from planewise.commands.exit_codes import FAILED
from planewise.commands.frame_sizes import FrameSizes
from planewise.commands.shared_options import (
    CameraName,
    DepthScale,
    MaxDepth,
    Resolution,
    optional,
)
from planewise.errors import PlanewiseError
from planewise.files.camera import no_camera, read_camera, read_sensor
from planewise.files.depth import list_depth_files, read_depth
from planewise.sensor import Sensor
from planewise.whole_files import written_whole
from planewise.wording import counted

if TYPE_CHECKING:
    from planewise.calibration.cells import NoiseCells
    from planewise.camera import Camera

_MOST_FRAMES = 300  # more are thinned out evenly: their cells are kept in memory


def calibrate(
    frames: Annotated[
        list[Path],
        typer.Argument(
            metavar="FRAMES", show_default=False, help="Depth images, or folders of them."
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="JSON", show_default=False, help="File for the sensor."
        ),
    ],
    camera: CameraName = None,
    sensor: Annotated[
        str | None,
        optional(
            "Preset or file whose range and resolution are taken, and whose noise is compared. "
            "Default: the preset of the camera's name, else 10 m and 1 mm."
        ),
    ] = None,
    max_depth: MaxDepth = None,
    resolution: Resolution = None,
    depth_scale: DepthScale = None,
    picture: Annotated[
        Path | None, optional("File for a picture of the curve, .png.", "--picture")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the confidence band.")] = 0,
) -> None:
    """Estimate the noise of a sensor from frames of it.

    Frames of rooms will do: what counts is flat places at all depths. The file serves as --sensor.
    """
    with reported():
        checked_scale(depth_scale)
        check_seed(seed)
        paths = _thinned(_depth_files(frames))
        inputs = (*paths, camera, sensor)
        check_output(output, ".json", inputs)
        if picture is not None:
            check_output(picture, ".png", inputs, "picture")
        known = None if camera is None else read_camera(camera)
        name = sensor or preset_of(camera)
        base = read_sensor(name, max_depth=max_depth, resolution=resolution)

        from planewise.calibration.calibrate import describe_calibration, pooled
        from planewise.sensors import save

        job = _Reading(base, known, depth_scale, FrameSizes(known))
        cells: list[NoiseCells] = []
        failed = 0
        for result in terminal.progress(job.run(paths), len(paths)):
            if isinstance(result, str):
                failed += 1
                terminal.error(result)
            else:
                cells.append(result)
        if not cells:
            raise typer.Exit(FAILED)
        found = pooled(cells, base, seed)
        output.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as files:  # both or neither
            if picture is not None:
                from planewise.drawing.noise import draw_noise
                from planewise.results.image import write_image

                known_noise = base.noise if name is not None and callable(base.noise) else None
                drawn = draw_noise(found, known_noise, name or "")
                picture.parent.mkdir(parents=True, exist_ok=True)
                write_image(files.enter_context(written_whole(picture)), drawn)
            save(found.sensor(base), output, calibration=describe_calibration(found))
        terminal.show_noise(found, base if name is not None else None)
        terminal.say(f"{len(cells)} of {counted(len(paths), 'frame')} used, sensor in {output}")
        if failed:
            raise typer.Exit(FAILED)


@dataclass(frozen=True)
class _Reading:
    """What all frames have in common; what is ``None`` their files have to say."""

    sensor: Sensor
    camera: Camera | None
    depth_scale: float | None
    sizes: FrameSizes

    def run(self, paths: list[Path]) -> Iterator[NoiseCells | str]:
        """Cells of every frame, or why it cannot be used."""
        for path in paths:
            try:
                yield self._cells(path)
            except (ValueError, OSError) as error:
                yield f"{path.name}: {error}"

    def _cells(self, path: Path) -> NoiseCells:
        from planewise.calibration.bins import FEWEST
        from planewise.calibration.estimate import cells_of_frame, too_few

        frame = read_depth(path)
        self.sizes.see(path.name, frame.depth.shape)
        camera = self.camera or frame.camera
        if camera is None:
            raise no_camera("the file")
        scale = frame.depth_scale if self.depth_scale is None else self.depth_scale
        cells = cells_of_frame(frame.depth, camera, self.sensor, scale)
        flat = int(cells.usable.sum())
        if flat < FEWEST:
            raise PlanewiseError(
                f"{too_few(flat)}; take frames of walls, floors or tables, and check the unit of "
                "the depth"
            )
        return cells


def _depth_files(given: list[Path]) -> list[Path]:
    """Files as given, folders as the depth files in them; each file once."""
    files: dict[Path, Path] = {}
    for path in given:
        if not path.exists():
            raise PlanewiseError(f"frames: there is no file or folder {path}")
        for each in list_depth_files(path) if path.is_dir() else [path]:
            files.setdefault(each.resolve(), each)
    return list(files.values())


def _thinned(paths: list[Path]) -> list[Path]:
    """At most 300 of the frames, evenly spaced."""
    count = len(paths)
    if count <= _MOST_FRAMES:
        return paths
    terminal.notice(f"{_MOST_FRAMES} of {count} frames are taken, evenly spaced")
    return [paths[k * count // _MOST_FRAMES] for k in range(_MOST_FRAMES)]
