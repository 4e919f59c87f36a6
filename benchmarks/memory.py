"""Memory of a Detector at 640 x 480 in a process of its own: prints JSON, in MB.

python -m benchmarks.memory [--runs 5]

What Python and NumPy allocate is seen; arrays that compiled code makes for itself are not.
"""

from __future__ import annotations

import gc
import json
import subprocess
import sys
import tracemalloc

import numpy as np

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.frames import rooms

_WARM = 3
_MB = 1e-6


def measured(runs: int = 5) -> dict[str, list[float]]:
    """Memory `held` between frames, and `allocated` for each warm one beyond its result."""
    command = [sys.executable, "-m", "benchmarks.memory", "--runs", str(runs)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout))


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    frame = next(iter(rooms(1)))
    # A small frame first: modules and compiled code are loaded before anything is counted.
    camera = pw.PinholeCamera(fx=50, fy=50, cx=32, cy=24)
    pw.detect_planes(np.full((48, 64), 2.0), camera, frame.sensor, threads=1)
    gc.collect()
    tracemalloc.start()
    start = tracemalloc.get_traced_memory()[0]
    detector = pw.Detector(frame.camera, frame.sensor, threads=1)
    for _ in range(_WARM):
        detector(frame.depth)
    gc.collect()
    held = tracemalloc.get_traced_memory()[0] - start
    allocated = []
    for _ in range(runs):
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        model = detector(frame.depth)
        after, peak = tracemalloc.get_traced_memory()
        allocated.append(_MB * (peak - max(before, after)))
        del model
        gc.collect()
    print(json.dumps({"held": [_MB * held], "allocated": allocated}))


if __name__ == "__main__":
    main()
