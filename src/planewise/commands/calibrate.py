"""The command calibrate: from frames of a camera to a file that describes its sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planewise.arguments import checked_scale, unit_told
from planewise.commands import terminal
from planewise.commands.command_line import (
    check_output,
    check_seed,
    preset_of,
    reported,
    unusual_unit,
)
from planewise.commands.exit_codes import FAILED
from planewise.commands.frame_doubts import FrameDoubts
from planewise.commands.frame_sizes import FrameSizes
from planewise.commands.shared_options import (
    CameraName,
    CameraTopic,
    DepthScale,
    MaxDepth,
    Resolution,
    Topic,
    optional,
)
from planewise.errors import PlanewiseError, SetupError
from planewise.files.camera import no_camera, read_camera, read_sensor
from planewise.files.depth import list_depth_files, read_depth
from planewise.sensor import Sensor
from planewise.whole_files import written_whole
from planewise.wording import counted

if TYPE_CHECKING:
    from planewise.batch.source import SourceFrame
    from planewise.calibration.frame_noise import FrameNoise
    from planewise.camera import Camera

_MOST_FRAMES = 300  # more are thinned out evenly: their cells are kept in memory


def calibrate(
    frames: Annotated[
        list[Path],
        typer.Argument(
            metavar="FRAMES",
            show_default=False,
            help="Depth images, folders of them, or datasets that 'planewise frames' knows.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="JSON", show_default=False, help="File for the sensor."
        ),
    ],
    camera: CameraName = None,
    topic: Topic = None,
    camera_topic: CameraTopic = None,
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
        known = None if camera is None else read_camera(camera)
        every = _frames(frames, known, depth_scale, topic, camera_topic)
        read = {each.path for each in every}
        inputs = (*frames, *read, *_of_datasets(read, output, picture), camera, sensor)
        check_output(output, ".json", inputs)
        if picture is not None:
            check_output(picture, ".png", inputs, "picture")
        found = _thinned(every)
        name = sensor or preset_of(camera)
        base = read_sensor(name, max_depth=max_depth, resolution=resolution)

        from planewise.calibration.calibrate import describe_calibration, pooled
        from planewise.sensors import save

        job = _Reading(base, known, depth_scale, FrameSizes(known), FrameDoubts())
        seen: list[FrameNoise] = []
        failed = 0
        for result in terminal.progress(job.run(found), len(found)):
            if isinstance(result, str):
                failed += 1
                terminal.error(result)
            else:
                seen.append(result)
        if not job.unit_told and (unit := unusual_unit(base.resolution)):
            terminal.warning(unit)
        job.doubts.warn()
        if not seen:
            raise typer.Exit(FAILED)
        noise = pooled(seen, base, seed)
        output.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as files:  # both or neither
            if picture is not None:
                from planewise.drawing.noise import draw_noise
                from planewise.results.image import write_image

                known_noise = base.noise if name is not None and callable(base.noise) else None
                drawn = draw_noise(noise, known_noise, name or "")
                picture.parent.mkdir(parents=True, exist_ok=True)
                write_image(files.enter_context(written_whole(picture)), drawn)
            save(noise.sensor(base), output, calibration=describe_calibration(noise))
        terminal.show_noise(noise, base if name is not None else None)
        if noise.caution:
            terminal.warning(noise.caution)
        terminal.say(f"{len(seen)} of {counted(len(found), 'frame')} used, sensor in {output}")
        if failed:
            raise typer.Exit(FAILED)


@dataclass(frozen=True)
class _Frame:
    """A frame that is yet to be read, of a file or of a dataset."""

    name: str
    path: Path
    read: Callable[[], SourceFrame]


@dataclass
class _Reading:
    """What all frames have in common; what is ``None`` their files have to say.

    `unit_told` becomes false with the first frame whose unit nobody states.
    """

    sensor: Sensor
    camera: Camera | None
    depth_scale: float | None
    sizes: FrameSizes
    doubts: FrameDoubts
    unit_told: bool = True

    def run(self, frames: list[_Frame]) -> Iterator[FrameNoise | str]:
        """What every frame says, or why it cannot be used."""
        for each in frames:
            try:
                yield self._noise(each)
            except SetupError:
                raise
            except (ValueError, OSError) as error:
                yield f"{each.name}: {str(error).removeprefix(f'{each.name}: ')}"

    def _noise(self, given: _Frame) -> FrameNoise:
        from planewise.calibration.cells import FEWEST
        from planewise.calibration.estimate import own_readings, too_few
        from planewise.calibration.frame_noise import noise_of_frame
        from planewise.misread import misread

        frame = given.read()
        self.sizes.see(given.name, frame.depth.shape)
        camera = self.camera or frame.camera
        if camera is None:
            raise no_camera("the file")
        scale = frame.depth_scale if self.depth_scale is None else self.depth_scale
        self.unit_told &= unit_told(frame.depth, scale)
        seen = own_readings(frame.depth, camera, self.sensor, scale)
        self.doubts.see(misread(seen))
        noise = noise_of_frame(seen).thinned()
        flat = int(noise.cells.usable.sum())
        if flat < FEWEST:
            raise PlanewiseError(
                f"{too_few(flat)}; take frames of walls, floors or tables, and check the unit of "
                "the depth"
            )
        return noise


def _frames(
    given: list[Path],
    camera: Camera | None,
    depth_scale: float | None,
    topic: str | None,
    camera_topic: str | None,
) -> list[_Frame]:
    """Files as given, folders as the depth files in them, datasets as their frames; each once."""
    from planewise.batch.open_source import open_source
    from planewise.datasets.archives import ArchiveFolder
    from planewise.datasets.opening import holds_depth_images, reader_of

    frames: dict[tuple[Path, str], _Frame] = {}
    for path in given:
        if not path.exists():
            raise PlanewiseError(f"frames: there is no file or folder {path}")
        files = path.is_file() or holds_depth_images(path)
        if files and reader_of(path) in (None, ArchiveFolder) and topic is camera_topic is None:
            for each in list_depth_files(path) if path.is_dir() else [path]:
                read = partial(read_depth, each)
                frames.setdefault((each.resolve(), ""), _Frame(each.name, each, read))
            continue
        source = open_source(
            path,
            camera=camera,
            depth_scale=depth_scale,
            topic=topic,
            camera_topic=camera_topic,
        )
        for frame in source.ids:
            name, read_one = f"{source.name}, frame {frame}", partial(source.__getitem__, frame)
            frames.setdefault((path.resolve(), frame), _Frame(name, path, read_one))
    return list(frames.values())


def _of_datasets(read: set[Path], *written: Path | None) -> list[Path]:
    """Of files to be written those that are there and below the folder of a dataset."""
    folders = {each.resolve() for each in read if each.is_dir()}
    there = (each for each in written if each is not None and each.exists())
    return [each for each in there if not folders.isdisjoint(each.resolve().parents)]


def _thinned(frames: list[_Frame]) -> list[_Frame]:
    """At most 300 of the frames, evenly spaced."""
    count = len(frames)
    if count <= _MOST_FRAMES:
        return frames
    terminal.notice(f"{_MOST_FRAMES} of {count} frames are taken, evenly spaced")
    return [frames[k * count // _MOST_FRAMES] for k in range(_MOST_FRAMES)]
