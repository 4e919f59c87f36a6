"""How fast `planewise.batch` is, how it scales, and what its workers take: generated VGA frames.

python -m benchmarks.batch [--frames 600] [--distinct 300] [--rounds 3] [--frames-of-memory 5000]

One and two workers fill a new store by turns, 16-bit PNG to label PNG and Parquet. The rate is that
of the whole run without its start (which is given apart), the last file on the disk included.
Processor time is that of all processes: with two free cores, 2000 ms / that is the rate. Memory is
what the system says of a worker (PSS: what several share is divided among them; RSS: it is not).
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.faults import children
from benchmarks.table import HEAD, RATIO, Row, row
from planewise import scenes
from planewise.batch import Batch, DepthFolder, LocalEngine, Recipe, Store
from planewise.batch.columns import TIMES
from planewise.machine import describe_machine

_SIZE = (480, 640)
_LOOKS = 10  # at the memory of workers, over a run
_MB = 1e-3  # of the system's kB
_TICK = os.sysconf("SC_CLK_TCK")


@dataclass
class Measured:
    """What a run took.

    Attributes
    ----------
    start, rate, cpu : float
        Seconds to the first frame, frames a second from then to the end, milliseconds of processor
        time a frame.
    times : dict
        Mean milliseconds a frame to read, detect and encode.
    pss, rss : list of float
        MB of the largest worker, at even intervals.
    labels, tables : float
        Bytes a frame in the store.
    """

    start: float = 0.0
    rate: float = 0.0
    cpu: float = 0.0
    times: dict[str, float] = field(default_factory=dict)
    pss: list[float] = field(default_factory=list)
    rss: list[float] = field(default_factory=list)
    labels: float = 0.0
    tables: float = 0.0


def write_frames(folder: Path, count: int, distinct: int) -> pw.Camera:
    """Write `count` frames of which `distinct` differ; the others are links to them."""
    folder.mkdir()
    for number in range(distinct):
        room = scenes.room(number, size=_SIZE)
        Image.fromarray(room.depth).save(folder / f"{number:06}.png")
    for number in range(distinct, count):
        os.link(folder / f"{number % distinct:06}.png", folder / f"{number:06}.png")
    return room.camera


def measure(frames: Path, camera: pw.Camera, store: Path, workers: int) -> Measured:
    """Fill a store."""
    recipe = Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options(), camera=camera)
    batch = Batch(source=DepthFolder(frames), store=store, recipe=recipe)
    found = Measured()
    count = len(batch.source.ids)
    begun = time.perf_counter()
    first = before = 0.0
    with batch.started(LocalEngine(workers=workers)) as run:
        for number, _ in enumerate(run):
            if number == 0:
                first, before = time.perf_counter(), _processor_time()
            if number % max(1, count // _LOOKS) == count // _LOOKS - 1:
                sizes = [_memory(worker) for worker in _workers()]
                found.pss.append(max(pss for pss, _ in sizes))
                found.rss.append(max(rss for _, rss in sizes))
            if number == count - 1 - 2 * workers:  # before any worker ends
                found.cpu = 1e3 * (_processor_time() - before) / number
    ended = time.perf_counter()
    found.start, found.rate = first - begun, (count - 1) / (ended - first)
    table = Store(store).frames
    assert table.num_rows == count
    found.times = {name: float(np.mean(table[name].to_numpy()[1:])) for name in TIMES}
    found.labels = _bytes_in(store / "labels") / count
    found.tables = (_bytes_in(store / "frames") + _bytes_in(store / "planes")) / count
    return found


def _bytes_in(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())


def _workers() -> list[int]:
    return [each for child in children(os.getpid()) for each in children(child)]


def _processor_time() -> float:
    """Seconds of processor time of this process and its workers so far."""
    total = 0.0
    for process in (os.getpid(), *_workers()):
        after_name = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        total += (int(after_name[11]) + int(after_name[12])) / _TICK
    return total


def _memory(process: int) -> tuple[float, float]:
    """PSS and RSS of a process in MB."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    sizes = {line.split(":")[0]: line.split()[1] for line in lines[1:]}
    return _MB * int(sizes["Pss"]), _MB * int(sizes["Rss"])


def rows_of(one: list[Measured], two: list[Measured]) -> list[Row]:
    """Table of rounds with one and two workers."""

    def of(runs: list[Measured], name: str) -> np.ndarray:
        return np.array([getattr(each, name) for each in runs])

    times = {name: np.array([each.times[name] for each in one]) for name in TIMES}
    files = times["read_ms"] + times["encode_ms"]
    return [
        row("two workers, end to end", "frames/s", of(two, "rate"), must=60, large=True),
        row("one worker, end to end", "frames/s", of(one, "rate")),
        row("two workers / one", RATIO, of(two, "rate") / of(one, "rate"), must=1.8, large=True),
        row("processor time a frame, two workers", "ms", of(two, "cpu"), must=2000 / 60),
        row("processor time a frame, two / one", RATIO, of(two, "cpu") / of(one, "cpu")),
        row("read and decode, one worker", "ms", times["read_ms"]),
        row("detect, one worker", "ms", times["detect_ms"]),
        row("encode, one worker", "ms", times["encode_ms"]),
        row("(read and encode) / detect", RATIO, files / times["detect_ms"]),
        row("start of a run", "s", of(two, "start")),
        row("label image", "kB", 1e-3 * of(two, "labels")),
        row("tables a frame", "kB", 1e-3 * of(two, "tables")),
    ]


def memory_rows(run: Measured, count: int) -> list[Row]:
    """Table of the memory of a long run."""
    pss, rss = np.array(run.pss), np.array(run.rss)
    return [
        row(f"worker over {count:,} frames, largest RSS", "MB", rss.max(), must=400),
        row("largest PSS", "MB", pss.max()),
        row("RSS at the end less at a tenth", "MB", rss[-1] - rss[0], must=10),
    ]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--distinct", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--frames-of-memory", type=int, default=5000)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as made:
        place = Path(made)
        distinct = min(given.distinct, given.frames)
        camera = write_frames(place / "frames", given.frames, distinct)
        one, two = [], []
        for turn in range(given.rounds):
            one.append(measure(place / "frames", camera, place / f"one-{turn}", 1))
            two.append(measure(place / "frames", camera, place / f"two-{turn}", 2))
        rows = rows_of(one, two)
        if given.frames_of_memory:
            many = place / "many"
            many.mkdir()
            for number in range(given.frames_of_memory):
                os.link(place / "frames" / f"{number % distinct:06}.png", many / f"{number:06}.png")
            long = measure(many, camera, place / "long", 2)
            rows += memory_rows(long, given.frames_of_memory)
    machine = describe_machine(("pillow", "pyarrow"))
    print(f"{machine['processor']}, {machine['processors']} processors, {machine['versions']}")
    print(f"load {before:.1f} before, {os.getloadavg()[0]:.1f} after\n\n{HEAD}")
    for each in rows:
        print(each.line())
    if given.json:
        record = {"machine": machine, "rows": [each.record() for each in rows]}
        given.json.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
