"""Kill a batch again and again, and see whether its store is what it would have been.

python -m benchmarks.faults [--kills 1000] [--frames 300] [--command-kills 50]

A reference store is made without faults. Then a process that fills another store is killed
(SIGKILL) after a random time, 2 ms to 1 s, and started again, until the store is full; it is held
against the reference, and the next store begins. Groups are committed every 20 ms and journals
become Parquet after 40 frames, so that kills fall into every step.

With --command-kills, the same with `planewise batch` and two workers as they are: of three kills
one is of a worker, one of the command, one of all of them.
"""

from __future__ import annotations

import math
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from PIL import Image

import planewise as pw
from benchmarks.arguments import parser_of
from planewise import scenes
from planewise.batch import Batch, DepthFolder, Outcome, Recipe, Store, store_writer
from planewise.batch.columns import TIMES
from planewise.batch.frame_work import FrameWork

SIZE = (60, 80)
_SCENES = 30  # different ones
_SHORTEST, _LONGEST = 0.002, 1.0  # seconds a process lives
_COMMAND_LIVES = 6.0
_LOOKED_AT = 0.1  # of the stores whose process was killed
_GROUP_SECONDS, _SEGMENT_FRAMES = 0.02, 40


@dataclass
class Tally:
    """What came of the faults."""

    kills: int = 0
    ended: int = 0
    stores: int = 0
    lost: int = 0
    double: int = 0
    corrupt: int = 0
    read_while_open: int = 0
    seconds: float = field(default_factory=time.monotonic)

    def __str__(self) -> str:
        return (
            f"{self.kills} kills over {self.stores} full stores ({self.ended} processes ended "
            f"by themselves, stores read {self.read_while_open} times in between), "
            f"{time.monotonic() - self.seconds:.0f} s: "
            f"{self.lost} lost, {self.double} double, {self.corrupt} corrupt"
        )


class InOrder:
    """Engine that does frames where it is called."""

    def run(self, work: FrameWork, frames: Iterable[tuple[int, str]]) -> Iterator[Outcome]:
        """See `planewise.batch.engine.Engine`."""
        for frame in frames:
            yield work(*frame)


def write_frames(folder: Path, count: int, size: tuple[int, int] = SIZE) -> pw.Camera:
    """Write `count` depth images, of which some are the same; give their camera."""
    folder.mkdir()
    rooms = [scenes.room(seed, size=size) for seed in range(min(count, _SCENES))]
    for number in range(count):
        Image.fromarray(rooms[number % len(rooms)].depth).save(folder / f"{number:05}.png")
    return rooms[0].camera


def batch_of(frames: Path, store: Path, camera: pw.Camera) -> Batch:
    """Batch of a folder with the default options."""
    recipe = Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options(), camera=camera)
    return Batch(source=DepthFolder(frames), store=store, recipe=recipe)


def fill(batch: Batch) -> None:
    """Run a batch in this process."""
    with batch.started(InOrder()) as run:
        for _ in run:
            pass


def forked(batch: Batch) -> int:
    """Fill a store in a process made from this one; give its number."""
    child = os.fork()
    if child:
        return child
    try:
        store_writer._SECONDS_A_GROUP = _GROUP_SECONDS
        store_writer._FRAMES_A_SEGMENT = _SEGMENT_FRAMES
        fill(batch)
    finally:
        os._exit(0)


def kill_again_and_again(
    frames: Path, camera: pw.Camera, reference: Store, place: Path, kills: int, seed: int = 0
) -> Tally:
    """Kill forked processes; see the module."""
    tally, rng = Tally(), random.Random(seed)
    while tally.kills < kills:
        path = place / f"killed-{tally.stores}"
        batch = batch_of(frames, path, camera)
        while True:
            child = forked(batch)
            lives = _SHORTEST * (_LONGEST / _SHORTEST) ** rng.random()
            if _ends_within(child, lives if tally.kills < kills else math.inf):
                tally.ended += 1
                break
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            tally.kills += 1
            if rng.random() < _LOOKED_AT and (path / "store.json").exists():
                compare(Store(path), reference, tally, whole=False)
        compare(Store(path), reference, tally)
        tally.stores += 1
    return tally


def _ends_within(child: int, seconds: float) -> bool:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if os.waitpid(child, os.WNOHANG)[0]:
            return True
        time.sleep(0.001)
    return False


def compare(found: Store, reference: Store, tally: Tally, *, whole: bool = True) -> None:
    """Count what a store has lost, has twice, or has otherwise than the reference."""
    frames = found.frames.drop_columns(list(TIMES)).to_pylist()
    counts = Counter(row["frame"] for row in frames)
    tally.double += sum(count - 1 for count in counts.values())
    if whole:
        tally.lost += len(set(reference.ids) - set(counts))
    else:
        tally.read_while_open += 1
    expected = {row["frame"]: row for row in reference.frames.drop_columns(list(TIMES)).to_pylist()}
    tally.corrupt += sum(row != expected[row["frame"]] for row in frames)
    for frame, theirs in zip(found, map(reference.__getitem__, _ids(found)), strict=True):
        same = frame.plane_table.equals(theirs.plane_table)
        file = found.label_file(frame.id)
        same &= file.read_bytes() == reference.label_file(frame.id).read_bytes()
        tally.corrupt += not same


def _ids(store: Store) -> list[str]:
    return [frame.id for frame in store]


def kill_the_command(
    frames: Path, camera: pw.Camera, reference: Store, place: Path, kills: int
) -> Tally:
    """Kill `planewise batch`, its workers, or both; see the module."""
    tally, rng = Tally(), random.Random(1)
    described = camera.describe()
    numbers = ",".join(str(described[name]) for name in ("fx", "fy", "cx", "cy"))
    while tally.kills < kills:
        path = place / f"command-{tally.stores}"
        command = [sys.executable, "-m", "planewise", "batch", str(frames), "-o", str(path)]
        command += ["--camera", numbers, "--sensor", "kinect-v1", "--workers", "2"]
        while True:
            job = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL)
            limit = rng.uniform(0.0, _COMMAND_LIVES) if tally.kills < kills else None
            try:
                code = job.wait(limit)
            except subprocess.TimeoutExpired:
                tally.kills += 1
                if tally.kills % 3 == 1 and _kill_a_worker(job.pid, rng):
                    code = job.wait()
                else:
                    if tally.kills % 3 == 2:
                        os.kill(job.pid, signal.SIGKILL)
                    else:
                        os.killpg(job.pid, signal.SIGKILL)
                    job.wait()
                    continue
            tally.ended += 1
            if code:
                raise SystemExit(f"planewise batch ended with {code}")
            break
        compare(Store(path), reference, tally)
        tally.stores += 1
    return tally


def _kill_a_worker(parent: int, rng: random.Random) -> bool:
    workers = [each for child in children(parent) for each in children(child)]
    if workers:
        os.kill(rng.choice(workers), signal.SIGKILL)
    return bool(workers)


def children(process: int) -> list[int]:
    """Processes that a process has started; workers are children of a child of the command."""
    try:
        text = Path(f"/proc/{process}/task/{process}/children").read_text()
    except FileNotFoundError:
        return []
    return [int(each) for each in text.split()]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--command-kills", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        place = Path(made)
        camera = write_frames(place / "frames", given.frames)
        fill(batch_of(place / "frames", place / "reference", camera))
        reference = Store(place / "reference")
        if given.kills:
            print(kill_again_and_again(place / "frames", camera, reference, place, given.kills))
        if given.command_kills:
            done = kill_the_command(place / "frames", camera, reference, place, given.command_kills)
            print(f"planewise batch: {done}")


if __name__ == "__main__":
    main()
