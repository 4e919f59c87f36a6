"""The command detect: the planes of a depth image, or of a folder of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planewise.arguments import checked_scale
from planewise.commands import terminal
from planewise.commands.command_line import (
    check_seed,
    of_samples,
    partition_of,
    preset_of,
    reported,
    sensor_of,
)
from planewise.commands.exit_codes import FAILED
from planewise.commands.frame_sizes import FrameSizes
from planewise.commands.jobs import Failed, Job
from planewise.commands.shared_options import (
    CameraName,
    Confidence,
    DepthScale,
    InlierRatio,
    MaxDepth,
    MaxPlanes,
    ObjectiveName,
    Outlines,
    Output,
    ReassignName,
    Resolution,
    SamDevice,
    SamModel,
    SearchName,
    Seed,
    Threads,
    optional,
)
from planewise.errors import PlanewiseError
from planewise.files.camera import NOISE_HELP, read_camera
from planewise.files.depth import is_depth_file, list_depth_files
from planewise.whole_files import parent_folder
from planewise.wording import counted


def detect(
    depth: Annotated[
        Path,
        typer.Argument(
            metavar="DEPTH",
            show_default=False,
            help="Depth image (16-bit PNG, TIFF or PGM, .npy, .npz, EXR), or a folder of them; or "
            "organised points (PCD, PTX, E57), which tell their camera.",
        ),
    ],
    output: Output,
    camera: CameraName = None,
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
    max_depth: MaxDepth = None,
    resolution: Resolution = None,
    depth_scale: DepthScale = None,
    scan: Annotated[
        int | None, optional("Which scan of a PTX or E57 file of several, counted from 0.")
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
    max_planes: MaxPlanes = None,
    confidence: Confidence = None,
    inlier_ratio: InlierRatio = None,
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
    sam_model: SamModel = None,
    sam_device: SamDevice = None,
    seed: Seed = 0,
    threads: Threads = None,
    rgb: Annotated[
        Path | None,
        optional(
            "Picture of the same view to draw the planes over, and for --partition to look at; "
            "with a folder of depth images, a folder of pictures of the same names."
        ),
    ] = None,
    outlines: Outlines = False,
) -> None:
    """Find the planes of a depth image, or of every one in a folder.

    Writes labels.png (16-bit), planes.json, overlay.png and curve.png.
    """
    with reported():
        checked_scale(depth_scale)
        check_seed(seed)
        if not depth.exists():
            raise PlanewiseError(f"depth: there is no file or folder {depth}")
        _refuse_dataset(depth)
        if rgb is not None and not rgb.exists():
            raise PlanewiseError(f"rgb: there is no file {rgb}")
        known_camera = None if camera is None else read_camera(camera)
        named_sensor = preset_of(camera) if sensor is None else sensor
        known_sensor = sensor_of(named_sensor, camera, noise, max_depth, resolution)

        from planewise.options import Options

        named, regions = partition_of(partition, sam_model, sam_device)
        options = Options(
            partition=named,
            search=search.value,
            objective=None if objective is None else objective.value,
            instances=instances,
            significance=significance,
            max_planes=max_planes,
            **of_samples(search, confidence, inlier_ratio, partition),
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
            scan=scan,
            as_far=named_sensor is None and max_depth is None,
            read=(camera, sensor),
        )
        if depth.is_dir():
            if scan is not None:
                raise PlanewiseError(f"scan: {depth} is a folder, of images that are no scans")
            _detect_folder(job, depth, output)
            return
        done = job.run(depth, output)
        terminal.show_planes(done.model)
        terminal.show_summary(done.model, done.seconds, done.folder)
        for warning in filter(None, (done.out_of_range, done.unit)):
            terminal.warning(warning)


def _refuse_dataset(path: Path) -> None:
    """Say what takes a dataset, where there is no depth image that could be read."""
    if any(map(is_depth_file, path.iterdir() if path.is_dir() else [path])):
        return
    from planewise.datasets.opening import reader_of

    if reader := reader_of(path):
        raise PlanewiseError(
            f"depth: {path} is a dataset of the kind {reader.kind!r}; 'planewise batch' takes it"
        )


def _detect_folder(job: Job, folder: Path, output: Path) -> None:
    paths = list_depth_files(folder)
    failed, told, sizes = 0, False, FrameSizes(job.camera)
    with parent_folder(output):
        results = terminal.progress(job.run_folder(paths, output), len(paths))
        for path, result in zip(paths, results, strict=True):
            if isinstance(result, Failed):
                failed += 1
                terminal.error(result.reason)
                continue
            sizes.see(path.name, result.model.labels.shape)
            planes = counted(len(result.model), "plane")
            terminal.say(f"{path.name}: {planes}, {1000 * result.seconds:.0f} ms")
            terminal.warn_of_note(result.model, f"{path.name}: ")
            if result.out_of_range:
                terminal.warning(f"{path.name}: {result.out_of_range}")
            if result.unit and not told:
                terminal.warning(f"{path.name}: {result.unit}")
                told = True
    done = len(paths) - failed
    where = f", files in {output}" if done else ""
    terminal.say(f"{done} of {counted(len(paths), 'frame')} done{where}")
    if failed:
        raise typer.Exit(FAILED)
