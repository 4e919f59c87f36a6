"""The commands of the command line that are not in a module of their own, and the list of all."""

from __future__ import annotations

import platform
from pathlib import Path
from typing import Annotated

import typer

from planewise import cameras, sensors, terminal
from planewise._version import __version__
from planewise.batch_command import batch
from planewise.bench_command import bench
from planewise.calibrate_command import calibrate
from planewise.camera import PinholeCamera
from planewise.camera_files import NOISE_HELP, read_camera
from planewise.command_line import (
    CAMERA_HELP,
    DEPTH_SCALE_HELP,
    FAILED,
    MAX_DEPTH_HELP,
    OUTLINES_HELP,
    RESOLUTION_HELP,
    ObjectiveName,
    ReassignName,
    SearchName,
    check_numbers,
    optional,
    partition_of,
    reported,
    sensor_of,
)
from planewise.depth_files import list_depth_files
from planewise.errors import PlanewiseError
from planewise.export_command import export
from planewise.frames_command import frames
from planewise.jobs import Failed, Job, find_planes
from planewise.nyu_command import nyu
from planewise.points_command import points
from planewise.reproduce_command import reproduce
from planewise.result_files import output_folder, parent_folder, write_image, write_results
from planewise.spherical import SphericalCamera
from planewise.view_command import view

app = typer.Typer(
    name="planewise",
    help="Find every plane a depth image or point cloud can justify, how many, and rank them.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


_NAMED = 20  # frames that a warning lists


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
        optional(CAMERA_HELP),
    ] = None,
    sensor: Annotated[
        str | None,
        optional(
            "Preset (see 'planewise info'), or a file that 'planewise calibrate' wrote. Not "
            "needed where the camera's preset has the same name, or --noise is given."
        ),
    ] = None,
    noise: Annotated[
        str | None,
        optional(
            f"Standard deviation of a reading: {NOISE_HELP}; or auto: estimated from each frame."
        ),
    ] = None,
    max_depth: Annotated[float | None, optional(MAX_DEPTH_HELP)] = None,
    resolution: Annotated[float | None, optional(RESOLUTION_HELP)] = None,
    depth_scale: Annotated[
        float | None,
        optional(DEPTH_SCALE_HELP),
    ] = None,
    search: Annotated[
        SearchName, typer.Option(help="All planes together, or one after the other (the paper's).")
    ] = SearchName.joint,
    objective: Annotated[
        ObjectiveName | None,
        optional(
            "What is minimised: an information with a spatial mask code, correlated error and a "
            "smooth null (the default, joint search only), or the paper's."
        ),
    ] = None,
    instances: Annotated[
        bool,
        typer.Option(
            "--instances",
            help="Keep surfaces of one plane that do not touch apart (spatial objective).",
        ),
    ] = False,
    significance: Annotated[
        float,
        typer.Option(help="Nats a plane has to save beyond its costs (spatial objective)."),
    ] = 0.0,
    max_planes: Annotated[
        int | None, optional("Largest number of planes. Default: 64, sequential 8.")
    ] = None,
    confidence: Annotated[
        float, typer.Option(help="Sequential: probability that a plane's sample is pure.")
    ] = 0.99,
    inlier_ratio: Annotated[
        float, typer.Option(help="Sequential: share of the readings on the smallest plane.")
    ] = 0.1,
    reassign: Annotated[
        ReassignName | None,
        optional(
            "The paper's step after the search: readings that fit several planes go to the one "
            "whose normal is most like theirs (paper's objective)."
        ),
    ] = None,
    partition: Annotated[
        str | None,
        optional(
            "Regions to search: auto, graph, blocks, sam, a label image (PNG, .npy, .npz), or a "
            "folder of masks; with a folder of depth images, a folder of these of the same names."
        ),
    ] = None,
    sam_model: Annotated[
        str | None,
        optional("Folder or hub name of the weights of Segment Anything, for --partition sam."),
    ] = None,
    sam_device: Annotated[
        str | None, optional("Where Segment Anything runs: cpu (the default), cuda, cuda:1 ...")
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same result.")] = 0,
    threads: Annotated[int | None, optional("Default: one per processor.")] = None,
    rgb: Annotated[
        Path | None,
        optional(
            "Picture of the same view to draw the planes over, and for --partition to look at; "
            "with a folder of depth images, a folder of pictures of the same names."
        ),
    ] = None,
    outlines: Annotated[bool, typer.Option("--outlines", help=OUTLINES_HELP)] = False,
) -> None:
    """Find the planes of a depth image, or of every one in a folder.

    Writes labels.png (16-bit), planes.json, overlay.png and curve.png.
    """
    with reported():
        check_numbers(depth_scale, seed)
        if rgb is not None and not rgb.exists():
            raise PlanewiseError(f"rgb: there is no file {rgb}")
        known_camera = None if camera is None else read_camera(camera)
        known_sensor = sensor_of(sensor, camera, noise, max_depth, resolution)

        from planewise.options import Options

        named, regions = partition_of(partition, sam_model, sam_device)
        options = Options(
            partition=named,
            search=search.value,
            objective=None if objective is None else objective.value,
            instances=instances,
            significance=significance,
            max_planes=max_planes,
            confidence=confidence,
            inlier_ratio=inlier_ratio,
            reassign=None if reassign is None else "normals",
            rng=seed,
            threads=threads,
        )
        job = Job(
            sensor=known_sensor,
            options=options,
            camera=known_camera,
            depth_scale=depth_scale,
            rgb=rgb,
            outlines=outlines,
            partition=regions,
        )
        if depth.is_dir():
            _detect_folder(job, depth, output)
            return
        done = job.run(depth, output)
        terminal.show_planes(done.model)
        terminal.show_summary(done.model, done.seconds, done.folder)


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
        raise typer.Exit(FAILED)


app.command()(points)
app.command()(batch)
app.command()(view)
app.command()(export)
app.command()(calibrate)
app.command()(frames)


@app.command()
def demo(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="OUT", help="Folder for the pictures.")
    ] = Path("planewise-demo"),
    seed: Annotated[int, typer.Option(help="Every seed is another room.")] = 0,
) -> None:
    """Build a synthetic room, find its planes and draw them."""
    with reported():
        if seed < 0:
            raise PlanewiseError(f"seed must not be negative, got {seed}")
        with output_folder(output) as folder:
            from planewise import scenes
            from planewise.draw import draw_labels
            from planewise.options import Options

            room = scenes.room(seed)
            options = Options()
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
            "such as 'planewise detect' makes, or a store of 'planewise batch'.",
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
    with reported():
        from planewise.label_files import pair_files
        from planewise.metrics import summarise
        from planewise.scoring import Scoring, check_table, write_table

        pairs = pair_files(predicted, truth)
        if output is not None:
            check_table(output, pairs)
        for names, folder in ((pairs.only_true, predicted), (pairs.only_predicted, truth)):
            if names:
                more = " ..." if len(names) > _NAMED else ""
                shown = ", ".join(names[:_NAMED])
                terminal.warning(f"{folder} lacks {len(names)}: {shown}{more}")
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
            raise typer.Exit(FAILED)


app.command()(bench)
app.command()(nyu)
app.command()(reproduce)


@app.command()
def info() -> None:
    """Print versions, threads, where compiled code is kept, and the presets."""
    with reported():
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
        terminal.show_table(
            "cameras",
            (
                (
                    name,
                    f"{camera.width} x {camera.height}",
                    *(f"{value:.2f}" for value in (camera.fx, camera.fy, camera.cx, camera.cy)),
                )
                for name, camera in cameras.PRESETS.items()
                if isinstance(camera, PinholeCamera)
            ),
            ("--camera", "pixels", "fx", "fy", "cx", "cy"),
        )
        terminal.show_table(
            "LiDAR",
            (
                (
                    name,
                    f"{camera.shape[1]} x {camera.shape[0]}",
                    f"{max(camera.elevation):g} ... {min(camera.elevation):g}",
                )
                for name, camera in cameras.PRESETS.items()
                if isinstance(camera, SphericalCamera)
            ),
            ("--camera", "pixels", "elevation in degrees"),
        )
        terminal.show_table(
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
