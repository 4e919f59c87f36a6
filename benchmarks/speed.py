"""Times of the detector on this machine, one thread, on a synthetic room at 640 x 480.

python -m benchmarks.speed [--runs 21]
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
from PIL import Image

from benchmarks.frames import Frame, rooms


def timed(work: Callable[[], object], runs: int) -> list[float]:
    """Milliseconds of each run, after one that does not count."""
    work()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - start))
    return times


def process(code: list[str], **environment: str) -> Callable[[], object]:
    """Run a whole Python process."""
    return lambda: subprocess.run(
        [sys.executable, *code], check=True, capture_output=True, env=os.environ | environment
    )


def report(what: str, times: list[float], bound: float | None = None) -> None:
    """Print median and spread, and the bound it is held against."""
    middle = float(np.median(times))
    spread = f"{min(times):.0f} ... {max(times):.0f}"
    held = "" if bound is None else f"{'<=' if middle <= bound else 'ABOVE'} {bound:.0f}"
    print(f"| {what} | {middle:.1f} | {spread} | {len(times)} | {held} |", flush=True)


def frame_times(frame: Frame, runs: int) -> None:
    """Both searches on one frame."""
    report(
        f"{frame.name}: default call",
        timed(lambda: frame.detect(threads=1), runs),
        80,
    )
    report(
        f"{frame.name}: objective paper",
        timed(lambda: frame.detect(objective="paper", threads=1), runs),
        60,
    )
    report(
        f"{frame.name}: sequential, c = 0.99, r = 0.1, N = 8",
        timed(lambda: frame.detect(search="sequential", threads=1), max(7, runs // 3)),
        600,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=21)
    options = parser.parse_args()
    print(
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} processors, "
        f"Python {platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}\n"
    )
    print("| what | median ms | spread | runs | bound |\n|---|---|---|---|---|")
    frames = list(rooms(3))
    for frame in frames:
        frame_times(frame, options.runs)
    report("python -c 'pass'", timed(process(["-c", "pass"]), 7))
    report("import numpy", timed(process(["-c", "import numpy"]), 7))
    report("import planewise", timed(process(["-c", "import planewise"]), 7), 300)
    with tempfile.TemporaryDirectory() as folder:
        depth = Path(folder) / "depth.png"
        Image.fromarray(np.asarray(frames[0].depth, np.uint16)).save(depth)
        detect = ["-m", "planewise", "detect", str(depth), "--camera", "kinect-v1"]
        detect += ["--sensor", "kinect-v1", "-o", str(Path(folder) / "out")]
        report("whole process, planewise detect", timed(process(detect), 7), 1500)
        start = time.perf_counter()
        process(detect, NUMBA_CACHE_DIR=str(Path(folder) / "cache"))()
        report("the same, nothing compiled yet", [1e3 * (time.perf_counter() - start)], 25000)


if __name__ == "__main__":
    main()
