"""The command batch: a whole dataset into a store."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planewise.arguments import checked_scale
from planewise.commands import terminal
from planewise.commands.batch_progress import Progress, show_damaged, show_forecast, show_result
from planewise.commands.command_line import (
    check_seed,
    of_samples,
    partition_of,
    preset_of,
    reported,
    sensor_of,
)
from planewise.commands.exit_codes import FAILED
from planewise.commands.interrupts import interrupted
from planewise.commands.shared_options import (
    CameraInstead,
    CameraTopic,
    Confidence,
    DepthScale,
    Every,
    InlierRatio,
    Kind,
    Limit,
    MaxDepth,
    MaxPlanes,
    NoiseAsForDetect,
    ObjectiveName,
    ReassignName,
    Resolution,
    SamDevice,
    SamModel,
    SearchName,
    Seed,
    Topic,
    optional,
)
from planewise.errors import NO_ROOM, PlanewiseError
from planewise.files.camera import no_camera, read_camera, with_changes
from planewise.files.labels import STORE_FILE
from planewise.runtime import threads

if TYPE_CHECKING:
    from planewise.batch import Batch, Source
    from planewise.batch.engine import Engine
    from planewise.partition import Partitioner
    from planewise.sensor import Sensor

_TRIED = 5  # frames by which a dry run estimates


class _Engine(StrEnum):
    local = "local"
    ray = "ray"


class _Labels(StrEnum):
    png = "png"
    rle = "rle"


def batch(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            show_default=False,
            help="Folder of depth images, or a dataset of any kind that 'planewise frames' knows.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="STORE",
            show_default=False,
            help="Folder of the results: new, or one that this command began.",
        ),
    ],
    kind: Kind = None,
    topic: Topic = None,
    camera: CameraInstead = None,
    camera_topic: CameraTopic = None,
    sensor: Annotated[
        str | None,
        optional("As for detect. Default: the dataset's, or the preset of the camera's name."),
    ] = None,
    noise: NoiseAsForDetect = None,
    max_depth: MaxDepth = None,
    resolution: Resolution = None,
    depth_scale: DepthScale = None,
    search: Annotated[SearchName, typer.Option(help="As for detect.")] = SearchName.joint,
    objective: Annotated[ObjectiveName | None, optional("As for detect.")] = None,
    instances: Annotated[
        bool, typer.Option("--instances", help="Keep surfaces that do not touch apart.")
    ] = False,
    significance: Annotated[
        float, typer.Option(help="Nats a plane has to save beyond its costs.")
    ] = 0.0,
    max_planes: MaxPlanes = None,
    confidence: Confidence = None,
    inlier_ratio: InlierRatio = None,
    reassign: Annotated[ReassignName | None, optional("As for detect (paper's objective).")] = None,
    partition: Annotated[
        str | None, optional("Regions to search, as for detect: auto, graph, blocks or sam.")
    ] = None,
    sam_model: SamModel = None,
    sam_device: SamDevice = None,
    seed: Seed = 0,
    labels: Annotated[
        _Labels, typer.Option(help="Label images as 16-bit PNG, or COCO's run lengths in Parquet.")
    ] = _Labels.png,
    limit: Limit = None,
    every: Every = 1,
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="Take the I-th of N parts, for one machine each.")
    ] = "1/1",
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Try frames again that failed before.")
    ] = False,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Say what there is to do and how long it takes, and stop."),
    ] = False,
    engine: Annotated[
        _Engine, typer.Option(help="Processes of this machine, or a Ray cluster.")
    ] = _Engine.local,
    workers: Annotated[
        int | None, optional("Frames at a time. Default: one per processor, or all of the cluster.")
    ] = None,
    address: Annotated[
        str | None, optional("Ray: address of the cluster, or auto. Default: this machine alone.")
    ] = None,
    gpus: Annotated[float, typer.Option(help="Ray: GPUs for each frame at a time.")] = 0.0,
) -> None:
    """Find the planes of all frames of a dataset, into a store of labels and tables.

    Started again, it goes on where it was, however it was ended.
    """
    with reported():
        checked_scale(depth_scale)
        check_seed(seed)
        known_camera = None if camera is None else read_camera(camera)

        from planewise.batch import Batch, DepthFolder, Recipe, Selection, open_source
        from planewise.batch.source import parse_shard
        from planewise.options import Options

        chosen = _engine(engine, workers, address, gpus)
        frames = open_source(
            source,
            kind,
            camera=known_camera,
            depth_scale=depth_scale,
            topic=topic,
            camera_topic=camera_topic,
            pictures=partition is not None,
        )
        if (
            known_camera is None
            and isinstance(frames, DepthFolder)
            and not frames.may_state_cameras
        ):
            raise no_camera(frames.name)
        options = Options(
            partition=_partition(partition, sam_model, sam_device),
            reassign=None if reassign is None else "normals",
            search=search.value,
            objective=None if objective is None else objective.value,
            instances=instances,
            significance=significance,
            max_planes=max_planes,
            **of_samples(search, confidence, inlier_ratio, partition),
            rng=seed,
        )
        recipe = Recipe(
            sensor=_sensor(frames, sensor, camera, noise, max_depth, resolution),
            options=options,
            camera=known_camera,
            depth_scale=depth_scale,
            labels=labels.value,
        )
        job = Batch(
            source=frames,
            store=output,
            recipe=recipe,
            selection=Selection(every=every, shard=parse_shard(shard), limit=limit),
            retry_failed=retry_failed,
        )
        if dry_run:
            _forecast(job, workers or threads.available())
        else:
            _run(job, chosen)


def _engine(engine: _Engine, workers: int | None, address: str | None, gpus: float) -> Engine:
    from planewise.batch import LocalEngine, RayEngine

    if engine is _Engine.ray:
        return RayEngine(address=address, workers=workers, gpus=gpus)
    if address is not None or gpus:
        raise PlanewiseError("engine: --address and --gpus go with --engine ray")
    return LocalEngine(workers=threads.available() if workers is None else workers)


def _sensor(
    source: Source,
    name: str | None,
    camera: str | None,
    noise: str | None,
    max_depth: float | None,
    resolution: float | None,
) -> Sensor:
    """Sensor as asked for, or that of the dataset with what is given replaced."""
    from planewise.batch.open_source import sensor_of_source

    stated = sensor_of_source(source)
    if name is not None or stated is None or preset_of(camera) is not None:
        return sensor_of(name, camera, noise, max_depth, resolution)
    return with_changes(stated, noise=noise, max_depth=max_depth, resolution=resolution)


def _partition(name: str | None, model: str | None, device: str | None) -> Partitioner | None:
    """Partition by its name; regions of a file would be the same for all frames."""
    named, path = partition_of(name, model, device)
    if path is not None:
        raise PlanewiseError(f"partition: batch takes a name such as graph, not a file ({path})")
    return named


def _forecast(job: Batch, workers: int) -> None:
    """Say what a run would do, after doing its first frames without a store."""
    from planewise.batch.frame_work import FrameWork

    plan = job.plan()
    work = FrameWork(job.source, job.recipe)
    first = plan.to_do[:_TRIED]
    if first:
        fatal = work(*first[0]).fatal  # loads what the others find loaded
        if fatal:
            raise PlanewiseError(fatal)
    show_forecast(job, plan, [work(*each) for each in first], workers)


def _run(job: Batch, engine: Engine) -> None:
    try:
        with job.started(engine) as run:
            plan = run.plan
            show_damaged(plan)
            progress = Progress(plan, job.recipe)
            with progress:
                for outcome in run:
                    progress.count(outcome)
    except KeyboardInterrupt:
        terminal.error(f"interrupted; {_left(job.store)}")
        raise typer.Exit(interrupted()) from None
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        raise PlanewiseError(
            f"store: there is no room left for {job.store} ({error.strerror}); {_left(job.store)}"
        ) from None
    show_result(progress, job.store)
    if progress.failed + plan.failed and not progress.done + plan.done:
        raise typer.Exit(FAILED)


def _left(store: Path) -> str:
    """What an end before time leaves: a store without a frame may have been removed."""
    if (store / STORE_FILE).exists():
        return f"what is done is in {store}, and the same command goes on"
    return "nothing was left"
