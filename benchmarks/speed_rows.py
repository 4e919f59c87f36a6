"""The rows of benchmarks.speed: each function measures, on one core, and yields what it found.

A further row is a further function in ROWS.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import planewise as pw
from benchmarks import memory, rivals
from benchmarks.frames import Frame, rooms
from benchmarks.long_run import long_run
from benchmarks.processes import process
from benchmarks.rivals import Method
from benchmarks.table import RATIO, Row, row
from benchmarks.timing import Work, all_cores, elapsed, interleaved, times_of
from planewise import scenes
from planewise.runtime import threads

SIZES = ((320, 240), (640, 480), (1280, 720), (1920, 1080), (3840, 2160))
_VGA = 1  # place of 640 x 480
_TIMES = 10  # that a stream goes through all rooms
_QUICK_SIZES = 4


class SkippedError(Exception):
    """A row cannot be measured here, and why."""


@dataclass(frozen=True)
class Settings:
    """How thoroughly to measure: runs of what is fast, and whether to leave out what is slow."""

    runs: int
    quick: bool

    @property
    def few(self) -> int:
        """Runs of what takes some tenths of a second."""
        return max(3, self.runs // 3)

    @cached_property
    def rooms(self) -> list[Frame]:
        """Synthetic rooms with clutter and holes."""
        return list(rooms(3))


def calls(settings: Settings) -> Iterator[Row]:
    """Time calls of a Detector, on one core."""
    for name, method, runs, bounds in (
        ("default call", rivals.DEFAULT, settings.runs, (8.0, 2.0)),
        ("objective='paper'", rivals.PAPER, settings.runs, (60.0, None)),
        ("search='sequential', c = 0.99, r = 0.1, N = 8", rivals.SEQUENTIAL, settings.few,
         (350.0, 150.0)),
    ):  # fmt: skip
        found = [times_of(_call(method, frame), runs) for frame in settings.rooms]
        details = {
            frame.name: float(np.median(each))
            for frame, each in zip(settings.rooms, found, strict=True)
        }
        yield row(
            f"{name}, 3 rooms", "ms", np.array(found),
            must=bounds[0], aim=bounds[1], details=details,
        )  # fmt: skip


def against_opencv(settings: Settings) -> Iterator[Row]:
    """Time the default call and OpenCV's by turns."""
    method = _present(rivals.OPENCV)
    pairs = [
        interleaved(_call(rivals.DEFAULT, frame), _call(method, frame), settings.runs)
        for frame in settings.rooms
    ]
    ours, theirs = (np.array(each) for each in zip(*pairs, strict=True))
    yield row("OpenCV findPlanes, block 20, 3 rooms", "ms", theirs)
    yield row("default call / OpenCV findPlanes", RATIO, ours / theirs, must=1.0, aim=0.4)


def against_open3d(settings: Settings) -> Iterator[Row]:
    """Time the default call and Open3D's RANSAC by turns."""
    if settings.quick:
        raise SkippedError("left out by --quick")
    method, frame = _present(rivals.OPEN3D_PAPER), settings.rooms[0]
    ours, theirs = interleaved(
        _call(rivals.DEFAULT, frame), _call(method, frame), 3, repeats=7, warm=0
    )
    yield row("Open3D RANSAC, the paper's settings, 1 room", "ms", theirs)
    yield row("default call / Open3D RANSAC", RATIO, ours / theirs, must=1 / 500, aim=1 / 2000)


def pixels(settings: Settings) -> Iterator[Row]:
    """Time the default call on one room at several sizes by turns."""
    sizes = SIZES[:_QUICK_SIZES] if settings.quick else SIZES
    works = [_call(rivals.DEFAULT, _room(size)) for size in sizes]
    for work in works:
        work()
    times = np.array([[elapsed(work) for work in works] for _ in range(settings.few)])
    a_pixel = times / [width * height for width, height in sizes]
    relative = a_pixel / a_pixel[:, _VGA : _VGA + 1]
    dearest = int(np.argmax(np.median(relative, axis=0)))
    names = [f"{width} x {height}" for width, height in sizes]
    for name, each in zip(names, times.T, strict=True):
        yield row(f"default call, the room at {name}", "ms", each)
    yield row(
        f"cost a pixel at {names[dearest]} / at {names[_VGA]}, the dearest size", RATIO,
        relative[:, dearest], must=1.3,
        details=dict(zip(names, np.median(1e6 * a_pixel, axis=0).tolist(), strict=True)),
    )  # fmt: skip


def cores(settings: Settings) -> Iterator[Row]:
    """Time calls with two threads and with one by turns."""
    with all_cores():
        if threads.available() < 2:
            raise SkippedError("one processor only")
    frame = settings.rooms[0]
    cases: tuple[tuple[str, dict[str, Any], int, float], ...] = (
        ("default call", {}, settings.runs, 1.3),
        ("search='sequential'", {"search": "sequential"}, settings.few, 1.6),
    )
    for name, options, rounds, bound in cases:
        two, one = (
            pw.Detector(frame.camera, frame.sensor, threads=count, **options) for count in (2, 1)
        )
        with all_cores():
            after, before = interleaved(
                partial(two, frame.depth), partial(one, frame.depth), rounds
            )
        yield row(f"{name}, one core / two", RATIO, before / after, must=bound, large=True)
    two, one = (pw.Detector(frame.camera, frame.sensor, threads=count) for count in (2, 1))
    recording = [each.depth for each in settings.rooms] * _TIMES
    with all_cores():
        after, before = interleaved(
            lambda: list(two.stream(recording)), lambda: list(map(one, recording)), settings.few
        )
    name = f"{len(recording)} frames, one core / two by Detector.stream"
    yield row(name, RATIO, before / after, must=1.3, large=True)


def held(settings: Settings) -> Iterator[Row]:
    """Measure the memory of a Detector."""
    found = memory.measured()
    yield row("memory a Detector holds, 640 x 480", "MB", np.array(found["held"]), must=16, aim=8)
    # Small objects are always made; a byte a pixel would be 0.31 MB.
    yield row(
        "allocated in a warm frame beyond its result", "MB", np.array(found["allocated"]),
        must=0.25,
    )  # fmt: skip


def against_a_long_search(settings: Settings) -> Iterator[Row]:
    """Compare Phi of the default call with that of a search of seconds."""
    if settings.quick:
        raise SkippedError("left out by --quick: a short search finds too little to compare with")
    runs = {each.name: long_run(each, 40, 8.0) for each in settings.rooms}
    yield row(
        "Phi of the default call above a long search's, 3 rooms", "%",
        np.array([run.gap for run in runs.values()]), must=0.1, aim=0.02,
        details={name: [run.default.phi, run.best.phi] for name, run in runs.items()},
    )  # fmt: skip


def processes(settings: Settings) -> Iterator[Row]:
    """Time whole processes, files and imports included, on every processor."""
    with all_cores():
        yield from _processes(settings, 3 if settings.quick else 7)


def _processes(settings: Settings, runs: int) -> Iterator[Row]:
    for code, bound in (("pass", None), ("import numpy", None), ("import planewise", 300.0)):
        yield row(f"python -c '{code}'", "ms", times_of(process("-c", code), runs), must=bound)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        depth = folder / "depth.png"
        Image.fromarray(np.asarray(settings.rooms[0].depth, np.uint16)).save(depth)
        arguments = ("detect", str(depth), "--camera", "kinect-v1", "-o", str(folder / "out"))
        detect = partial(process, "-m", "planewise", *arguments)
        warm = times_of(detect(), runs)
        yield row("planewise detect, whole process", "s", warm / 1e3, must=1.0, aim=0.6)
        first = np.array([
            elapsed(detect(NUMBA_CACHE_DIR=str(folder / f"cache{run}")))
            for run in range(1 if settings.quick else 3)
        ])  # fmt: skip
        yield row("planewise detect, nothing compiled yet", "s", first / 1e3, must=15.0, aim=8.0)


ROWS: tuple[Callable[[Settings], Iterator[Row]], ...] = (
    calls,
    against_opencv,
    against_open3d,
    cores,
    held,
    processes,
    pixels,
    against_a_long_search,
)
"""In the order of the table."""


def _call(method: Method, frame: Frame) -> Work:
    return method.prepare(frame, False).detect


def _present(method: Method) -> Method:
    missing = method.missing()
    if missing:
        raise SkippedError(f"{method.package}: {missing}")
    return method


def _room(size: tuple[int, int]) -> Frame:
    scene = scenes.room(0, size=size[::-1])
    return Frame("room/0", scene.depth, scene.camera, scene.sensor)
