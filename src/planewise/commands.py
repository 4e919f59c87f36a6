"""The commands of the command line: detect, demo, eval, info."""

from __future__ import annotations

import logging
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from planewise import cameras, sensors, terminal
from planewise._version import __version__
from planewise.camera_files import NOISE_HELP, read_camera, read_sensor
from planewise.cli import INTERRUPTED
from planewise.depth_files import list_depth_files
from planewise.errors import PlanewiseError
from planewise.jobs import Failed, Job, find_planes
from planewise.result_files import output_folder, parent_folder, write_image, write_results
from planewise.sensor import Sensor

_FAILED = 2

app = typer.Typer(
    name="planewise",
    help="Find every plane a depth image can justify, how many there are, and rank them.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class _Search(StrEnum):
    joint = "joint"
    sequential = "sequential"


class _Objective(StrEnum):
    paper = "paper"
    spatial = "spatial"


class _OnStderr(logging.Handler):
    """Shows what the library logs, such as that the first run has to compile."""

    def emit(self, record: logging.LogRecord) -> None:
        terminal.notice(record.getMessage())


@contextmanager
def _reported() -> Iterator[None]:
    """Turn what a user can put right into one line on stderr and exit code 2."""
    log = logging.getLogger("planewise")
    log.handlers, log.propagate = [_OnStderr(logging.WARNING)], False
    try:
        yield
    except ValueError as error:
        terminal.error(str(error))
    except MemoryError:
        terminal.error("there is not enough memory for this image")
    except OSError as error:
        terminal.error(f"{error.filename or 'file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        terminal.error("interrupted; nothing was left half-written")
        raise typer.Exit(INTERRUPTED) from None
    else:
        return
    raise typer.Exit(_FAILED)


def _print_version(wanted: bool) -> None:
    if wanted:
        terminal.say(f"planewise {__version__}")
        raise typer.Exit


@app.callback()
def _planewise(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass


def _optional(help_text: str, *names: str) -> typer.models.OptionInfo:
    return typer.Option(*names, show_default=False, help=help_text)  # type: ignore[no-any-return]


@app.command()
def detect(
    depth: Annotated[
        Path,
        typer.Argument(
            metavar="DEPTH",
            show_default=False,
            help="Depth image (16-bit PNG, TIFF or PGM, .npy, .npz, EXR), or a folder of them.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="OUT", show_default=False, help="Folder for the results."
        ),
    ],
    camera: Annotated[
        str | None,
        _optional(
            "Preset (see 'planewise info'), fx,fy,cx,cy in pixels, or a JSON, YAML or ROS "
            "camera_info file. Not needed where an .npz holds K.",
        ),
    ] = None,
    sensor: Annotated[
        str | None,
        _optional(
            "Preset (see 'planewise info'). Not needed where the camera's preset has the same "
            "name, or --noise is given."
        ),
    ] = None,
    noise: Annotated[
        str | None, _optional(f"Standard deviation of a reading: {NOISE_HELP}.")
    ] = None,
    max_depth: Annotated[
        float | None, _optional("Largest depth in metres; what is beyond is no reading.")
    ] = None,
    resolution: Annotated[float | None, _optional("Step between two readings in metres.")] = None,
    depth_scale: Annotated[
        float | None,
        _optional(
            "Metres per unit of an integer image. Default: what an .npz states, else the "
            "resolution."
        ),
    ] = None,
    search: Annotated[
        _Search, typer.Option(help="All planes together, or one after the other (the paper's).")
    ] = _Search.joint,
    objective: Annotated[
        _Objective,
        typer.Option(
            help="What is minimised: the paper's information, or one with a spatial mask code, "
            "correlated error and a smooth null, which suits real sensors."
        ),
    ] = _Objective.paper,
    instances: Annotated[
        bool,
        typer.Option(
            "--instances",
            help="Keep surfaces of one plane that do not touch apart (spatial objective).",
        ),
    ] = False,
    max_planes: Annotated[
        int | None, _optional("Largest number of planes. Default: 64, sequential 8.")
    ] = None,
    confidence: Annotated[
        float, typer.Option(help="Sequential: probability that a plane's sample is pure.")
    ] = 0.99,
    inlier_ratio: Annotated[
        float, typer.Option(help="Sequential: share of the readings on the smallest plane.")
    ] = 0.1,
    seed: Annotated[int, typer.Option(help="The same seed gives the same result.")] = 0,
    threads: Annotated[int | None, _optional("Default: one per processor.")] = None,
    rgb: Annotated[
        Path | None,
        _optional(
            "Picture of the same view to draw the planes over; with a folder of depth images, a "
            "folder of pictures of the same names."
        ),
    ] = None,
) -> None:
    """Find the planes of a depth image, or of every one in a folder.

    Writes labels.png (16-bit), planes.json, overlay.png and curve.png.
    """
    with _reported():
        if depth_scale is not None and not 0 < depth_scale < float("inf"):
            raise PlanewiseError(
                f"depth_scale must be a positive number of metres, got {depth_scale}"
            )
        if seed < 0:
            raise PlanewiseError(f"seed must not be negative, got {seed}")
        if rgb is not None and not rgb.exists():
            raise PlanewiseError(f"rgb: there is no file {rgb}")
        known_camera = None if camera is None else read_camera(camera)
        known_sensor = _sensor(sensor, camera, noise, max_depth, resolution)

        from planewise.detect import Options

        options = Options(
            search=search.value,
            objective=objective.value,
            instances=instances,
            max_planes=max_planes,
            confidence=confidence,
            inlier_ratio=inlier_ratio,
            rng=seed,
            threads=threads,
        )
        job = Job(
            sensor=known_sensor,
            options=options,
            camera=known_camera,
            depth_scale=depth_scale,
            rgb=rgb,
        )
        if depth.is_dir():
            _detect_folder(job, depth, output)
            return
        done = job.run(depth, output)
        terminal.show_planes(done.model)
        terminal.show_summary(done.model, done.seconds, done.folder)


def _sensor(
    name: str | None,
    camera: str | None,
    noise: str | None,
    max_depth: float | None,
    resolution: float | None,
) -> Sensor:
    """Sensor as asked for; where it is not named, that of the camera, or one with given noise."""
    if name is None and camera is not None and camera.lower() in sensors.PRESETS:
        name = camera
    if name is None and noise is None:
        raise PlanewiseError(
            f"sensor: give --sensor as one of {', '.join(sensors.PRESETS)}, or at least --noise"
        )
    return read_sensor(name, noise=noise, max_depth=max_depth, resolution=resolution)


def _detect_folder(job: Job, folder: Path, output: Path) -> None:
    paths = list_depth_files(folder)
    failed = 0
    with parent_folder(output):
        results = terminal.progress(job.run_folder(paths, output), len(paths))
        for path, result in zip(paths, results, strict=True):
            if isinstance(result, Failed):
                failed += 1
                terminal.error(result.reason)
                continue
            planes = "1 plane" if len(result.model) == 1 else f"{len(result.model)} planes"
            terminal.say(f"{path.name}: {planes}, {1000 * result.seconds:.0f} ms")
            if not len(result.model):
                terminal.warning(f"{path.name}: no plane was found: {result.model.note}")
    terminal.say(f"{len(paths) - failed} of {len(paths)} frames done, files in {output}")
    if failed:
        raise typer.Exit(_FAILED)


@app.command()
def demo(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="OUT", help="Folder for the pictures.")
    ] = Path("planewise-demo"),
    seed: Annotated[int, typer.Option(help="Every seed is another room.")] = 0,
) -> None:
    """Build a synthetic room, find its planes and draw them."""
    with _reported():
        if seed < 0:
            raise PlanewiseError(f"seed must not be negative, got {seed}")
        with output_folder(output) as folder:
            from planewise import scenes
            from planewise.detect import Options
            from planewise.draw import draw_labels

            room = scenes.room(seed)
            options = Options(objective="spatial")
            model, seconds = find_planes(room.depth, room.camera, room.sensor, None, options)
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
            f"{found} of the room's {len(room.planes)} planes were found "
            "(more than half of the joint area in common)"
        )


@app.command("eval")
def evaluate(
    predicted: Annotated[
        Path,
        typer.Argument(
            metavar="PRED",
            show_default=False,
            help="Label image (16-bit PNG, .npy, or .npz with labels or gt), or a folder of them, "
            "such as 'planewise detect' makes.",
        ),
    ],
    truth: Annotated[
        Path,
        typer.Argument(
            metavar="GT", show_default=False, help="The same with the truth; 0 is no plane."
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
    with _reported():
        from planewise.label_files import pair_files
        from planewise.metrics import summarise
        from planewise.scoring import Scoring, check_table, write_table

        pairs = pair_files(predicted, truth)
        if output is not None:
            check_table(output, pairs)
        for names, folder in ((pairs.only_true, predicted), (pairs.only_predicted, truth)):
            if names:
                terminal.warning(f"{folder} lacks {len(names)}: {', '.join(names)}")
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
            where = f", scores in {output}" if output is not None and frames else ""
            terminal.say(f"{len(frames)} of {len(results)} frames scored{where}")
        if len(frames) < len(results):
            raise typer.Exit(_FAILED)


@app.command()
def info() -> None:
    """Print versions, threads, where compiled code is kept, and the presets."""
    with _reported():
        import numba
        import numpy as np

        from planewise import compilation, threads

        state = "compiled" if compilation.is_cached() else "not compiled yet"
        terminal.say(f"planewise {__version__}")
        terminal.say(
            f"Python {platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}"
        )
        terminal.say(f"threads: {threads.available()}")
        terminal.say(f"cache: {compilation.cache_directory()} ({state})")
        terminal.show_presets(
            "cameras",
            (
                (
                    name,
                    f"{camera.width} x {camera.height}",
                    *(f"{value:.2f}" for value in (camera.fx, camera.fy, camera.cx, camera.cy)),
                )
                for name, camera in cameras.PRESETS.items()
            ),
            ("--camera", "pixels", "fx", "fy", "cx", "cy"),
        )
        terminal.show_presets(
            "sensors",
            (
                (
                    name,
                    f"{sensor.min_depth:g} - {sensor.max_depth:g} m",
                    f"{1000 * sensor.resolution:g} mm",
                    str(sensor.noise),
                )
                for name, sensor in sensors.PRESETS.items()
            ),
            ("--sensor", "range", "resolution", "noise"),
        )
