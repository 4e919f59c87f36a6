"""What one process can write and what a store of millions of frames takes to go on with: simulated.

python -m benchmarks.scale [--written 20000] [--held 2500000]

Outcomes of one real frame, under other ids, go to the writer of a store as fast as it takes them;
and a store whose segments are copies of one, under other ids, is opened as a run opens it.
"""

from __future__ import annotations

import json
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.faults import batch_of, fill, write_frames
from planewise import scenes
from planewise.batch import Outcome, Recipe, Store
from planewise.batch.frame_names import safe_name
from planewise.batch.frame_work import FrameWork
from planewise.batch.segments import FOLDERS, segments_of
from planewise.batch.staging import Staging
from planewise.batch.store_info import info_of
from planewise.batch.store_writer import opened
from planewise.batch.tables import arrow, parquet_of
from planewise.files.depth import DepthFile

_SEGMENT = 2000
_FRAMES_A_SCENE = 1650  # of ScanNet, on average


class OneFrame:
    """A room of 640 x 480 pixels under many ids."""

    name = "one"

    def __init__(self, count: int) -> None:
        room = scenes.room(0)
        self._frame = DepthFile(depth=room.depth, camera=room.camera)
        self.ids = [f"scene{n // _FRAMES_A_SCENE:04}_00--{n:07}" for n in range(count)]

    def __getitem__(self, frame: str) -> DepthFile:
        """Return the room."""
        return self._frame


def written(place: Path, count: int) -> tuple[float, float, Outcome]:
    """Frames a second that the writer takes, milliseconds of a processor for one, and the frame."""
    source = OneFrame(count)
    recipe = Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options())
    store = place / "written"
    for name in FOLDERS:
        (store / name).mkdir(parents=True)
    (store / "store.json").write_text(json.dumps(info_of(source, recipe)))
    one = FrameWork(source, recipe)(0, source.ids[0])
    assert one.label_file is not None
    label, first = one.label_file[1], json.dumps(source.ids[0]).encode()
    staging = Staging(store / ".unfinished-all")
    begun, used = time.perf_counter(), time.process_time()
    with opened(store, "all", staging) as writer:
        for number, frame in enumerate(source.ids):
            scene, _, name = frame.partition("--")
            writer.add(
                replace(
                    one,
                    number=number,
                    frame=frame,
                    record=one.record.replace(first, json.dumps(frame).encode()),
                    label_file=(f"labels/{safe_name(f'{scene}/{name}', '.png')}", label),
                )
            )
    seconds, used = time.perf_counter() - begun, time.process_time() - used
    assert len(Store(store)) == count
    return count / seconds, 1e3 * used / count, one


def held(place: Path, count: int) -> tuple[float, float]:
    """Seconds of a processor to learn which frames a store holds, and MB that this takes."""
    camera = write_frames(place / "frames", 1)
    fill(batch_of(place / "frames", place / "held", camera))
    (segment,) = segments_of(place / "held")
    one, _ = segment.tables()
    pa = arrow()
    row = one.to_pylist()[0]
    staging = Staging(place / "held" / ".unfinished")
    for first in range(0, count, _SEGMENT):
        numbers = range(first, min(count, first + _SEGMENT))
        rows = [row | {"number": n, "frame": f"scene{n:07}"} for n in numbers]
        table = pa.Table.from_pylist(rows, schema=one.schema)
        path = place / "held" / "frames" / f"all-{first // _SEGMENT + 1:06}.parquet"
        staging.write(parquet_of(table)).replace(path)
    staging.close()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun = time.process_time()
    assert len(Store(place / "held").ids) == count
    seconds = time.process_time() - begun
    return seconds, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--written", type=int, default=20_000)
    parser.add_argument("--held", type=int, default=2_500_000)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        rate, used, one = written(Path(made), given.written)
        assert one.label_file is not None
        label = len(one.label_file[1])
        print(
            f"writer alone: {rate:,.0f} frames/s over {given.written:,}, {used:.2f} ms of a "
            f"processor each; label image {label:,} bytes, journal {len(one.record):,}, "
            f"{one.planes} planes"
        )
        seconds, memory = held(Path(made), given.held)
        print(
            f"a store of {given.held:,} frames is opened in {seconds:.1f} s of a processor, "
            f"{memory:,.0f} MB"
        )


if __name__ == "__main__":
    main()
