"""The command bench: how long the detector takes here, and on what."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from planewise.arguments import checked_scale
from planewise.camera import Camera
from planewise.commands import terminal
from planewise.commands.command_line import check_output, read_size, reported, sensor_of
from planewise.commands.shared_options import (
    CameraName,
    DepthScale,
    MaxDepth,
    NoiseAsForDetect,
    Resolution,
    Threads,
    optional,
)
from planewise.errors import PlanewiseError
from planewise.files.camera import no_camera, read_camera
from planewise.files.depth import read_depth
from planewise.runtime.stages import recorded
from planewise.runtime.threads import chosen
from planewise.sensor import Sensor
from planewise.whole_files import written_whole
from planewise.wording import counted

_ROOM = "640x480"
_SIZES = range(32, 8193)  # pixels along a side; the largest room takes 15 GB to make
_REST = "rest"


def bench(
    depth: Annotated[
        Path | None,
        typer.Argument(
            metavar="DEPTH",
            show_default=False,
            help="Depth image to time, as for detect. Default: a synthetic room.",
        ),
    ] = None,
    stages: Annotated[
        bool, typer.Option("--stages", help="Also say which stage of a call takes how long.")
    ] = False,
    runs: Annotated[int, typer.Option(help="Calls that are timed, after one that is not.")] = 21,
    size: Annotated[
        str | None, optional(f"Pixels of the room, width x height. Default: {_ROOM}.")
    ] = None,
    camera: CameraName = None,
    sensor: Annotated[
        str | None, optional("As for detect; not needed where the camera's preset has its name.")
    ] = None,
    noise: NoiseAsForDetect = None,
    max_depth: MaxDepth = None,
    resolution: Resolution = None,
    depth_scale: DepthScale = None,
    threads: Threads = None,
    output: Annotated[Path | None, optional("File for all times, .json.", "--json")] = None,
) -> None:
    """Time the default detection on this machine, called again and again on one frame."""
    with reported():
        checked_scale(depth_scale)
        if runs < 1:
            raise PlanewiseError(f"runs must be at least 1, got {runs}")
        if output is not None:
            if not output.absolute().parent.is_dir():
                raise PlanewiseError(f"json: there is no folder {output.parent}")
            check_output(output, ".json", (depth, camera, sensor), "json")
        if depth is None:
            given = (camera, sensor, noise, max_depth, resolution, depth_scale)
            if any(each is not None for each in given):
                raise PlanewiseError("camera, sensor and noise go with a depth image: give DEPTH")
            frame = _room(size or _ROOM)
        else:
            if size is not None:
                raise PlanewiseError(
                    "size is that of the synthetic room: leave out --size or DEPTH"
                )
            known = sensor_of(sensor, camera, noise, max_depth, resolution)
            frame = _file(depth, camera, known, depth_scale)

        from planewise.detect import Detector
        from planewise.machine import describe_machine

        detector = Detector(
            frame.camera, frame.sensor, depth_scale=frame.depth_scale, threads=threads
        )
        used = chosen(threads)
        machine = describe_machine()
        times = timed(lambda: detector(frame.depth), runs)
        terminal.show_machine(machine, used)
        terminal.say(
            f"{frame.name}, {frame.depth.shape[1]} x {frame.depth.shape[0]}, "
            f"{counted(times.readings, 'reading')}, {counted(times.planes, 'plane')}"
        )
        terminal.show_times(times.milliseconds, times.first)
        if stages:
            terminal.show_stages(times.stages)
        if output is not None:
            record = {
                "schema": "planewise/bench",
                "schema_version": 1,
                "machine": machine,
                "threads": used,
                "frame": {
                    "name": frame.name,
                    "width": frame.depth.shape[1],
                    "height": frame.depth.shape[0],
                    "readings": times.readings,
                    "planes": times.planes,
                },
                **times.describe(),
            }
            with written_whole(output) as partial:
                partial.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
            terminal.say(f"times in {output}")


@dataclass(frozen=True, kw_only=True)
class Times:
    """Times of equal calls.

    Attributes
    ----------
    milliseconds : ndarray, shape (runs,)
        Of each call.
    stages : dict of ndarray, shape (runs,)
        Milliseconds of each stage of these calls; what is in none of them is "rest".
    first : float
        Milliseconds of the call before them, which loads or makes compiled code.
    readings, planes : int
        What was worked on, and what was found.
    """

    milliseconds: NDArray[np.float64]
    stages: dict[str, NDArray[np.float64]]
    first: float
    readings: int
    planes: int

    def describe(self) -> dict[str, object]:
        """Say in plain types how long it took, for result files."""
        low, middle, high = np.percentile(self.milliseconds, (25, 50, 75)).tolist()
        return {
            "first_call_ms": self.first,
            "median_ms": middle,
            "quartiles_ms": [low, high],
            "times_ms": self.milliseconds.tolist(),
            "stages_ms": {name: float(np.median(each)) for name, each in self.stages.items()},
        }


def timed(call: Callable[[], Any], runs: int) -> Times:
    """Time a call that returns a model, once and then `runs` times."""
    start = time.perf_counter()
    model = call()
    first = 1e3 * (time.perf_counter() - start)
    total = np.empty(runs)
    profile: dict[str, NDArray[np.float64]] = {}
    for run in range(runs):
        start = time.perf_counter()
        with recorded() as seconds:
            call()
        total[run] = 1e3 * (time.perf_counter() - start)
        for name, each in seconds.items():
            profile.setdefault(name, np.zeros(runs))[run] = 1e3 * each
    profile[_REST] = total - sum(profile.values(), np.zeros(runs))
    return Times(
        milliseconds=total,
        stages=profile,
        first=first,
        readings=model.readings,
        planes=len(model),
    )


@dataclass(frozen=True, kw_only=True)
class _Frame:
    name: str
    depth: NDArray[np.generic]
    camera: Camera
    sensor: Sensor
    depth_scale: float | None = None


def _room(size: str) -> _Frame:
    """Synthetic room of a size such as 640x480."""
    from planewise import scenes

    room = scenes.room(0, size=read_size(size, _SIZES, _ROOM))
    return _Frame(name="synthetic room", depth=room.depth, camera=room.camera, sensor=room.sensor)


def _file(path: Path, camera: str | None, sensor: Sensor, depth_scale: float | None) -> _Frame:
    """Frame of a file, and of what it states about itself."""
    read = read_depth(path)
    known = read.camera if camera is None else read_camera(camera)
    if known is None:
        raise no_camera(path.name)
    return _Frame(
        name=path.name,
        depth=read.depth,
        camera=known,
        sensor=sensor,
        depth_scale=read.depth_scale if depth_scale is None else depth_scale,
    )
