"""Clouds in tiles on a disk against the same in one piece: time, peak memory, and what differs.

    python -m benchmarks.tiles --sizes 10000000 100000000 --folder FOLDER
    python -m benchmarks.tiles --sizes 30000000 100000000 --town --folder FOLDER

Buildings of ten million points stand beside each other, as float32 in a file; or roofs, streets and
trees of a town as an airplane sees them, ten points a square metre. Every search is a
process of its own; memory is the peak of what lies in memory (VmHWM) as Linux says it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.building import building
from benchmarks.processes import peak_memory
from planewise.runtime.stages import recorded

_BUILDING = 10_000_000  # points of one, at most
_STEP = 60.0  # metres between them
_IN_MEMORY = 30_000_000  # points up to which they are searched in one piece, too
_BLOCK, _HOUSE = 20.0, 12.0  # metres of a town: one house in each block
_DENSITY = 10.0  # points a square metre
_TOWN_SIGMA = 0.02  # metres
_MOST_PLANES = 60_000
_TREES = 0.1  # share of the points
_SENSOR = pw.Sensor(max_depth=100.0, resolution=0.001, noise=0.01)


def write_buildings(path: Path, count: int) -> None:
    """Write buildings as an array (count, 3) of float32."""
    out = np.lib.format.open_memmap(path, "w+", np.float32, (count, 3))
    for number, first in enumerate(range(0, count, _BUILDING)):
        size = min(_BUILDING, count - first)
        part = building(size, seed=number).points[:size]
        part[:, :2] += _STEP * np.array([number % 4, number // 4])
        out[first : first + len(part)] = part
        out.flush()


def write_town(path: Path, count: int) -> None:
    """Write houses with gable roofs on flat ground, and trees, (count, 3) of float32."""
    rng = np.random.default_rng(0)
    blocks = max(1, int(np.sqrt(count / _DENSITY) / _BLOCK))
    height, slope = rng.uniform(5, 12, (blocks, blocks)), rng.uniform(0.3, 1.2, (blocks, blocks))
    turned = rng.random((blocks, blocks)) < 0.5
    out = np.lib.format.open_memmap(path, "w+", np.float32, (count, 3))
    for first in range(0, count, 1_000_000):
        size = min(1_000_000, count - first)
        xy = rng.uniform(0, blocks * _BLOCK, (size, 2))
        i, j = np.minimum(xy // _BLOCK, blocks - 1).astype(int).T
        inside = xy % _BLOCK - _BLOCK / 2
        roof = np.abs(inside).max(axis=1) < _HOUSE / 2
        across = np.abs(np.where(turned[i, j], inside[:, 0], inside[:, 1]))
        z = np.where(roof, height[i, j] - slope[i, j] * across, 0)
        z += rng.normal(0, _TOWN_SIGMA, size)
        tree = rng.random(size) < _TREES
        z[tree] = rng.uniform(0, 8, tree.sum())
        out[first : first + size] = np.column_stack((xy, z))


def search(path: Path, labels: Path, tile_points: int, *, town: bool) -> None:
    """Search a file, in one piece where tile_points is 0, and print a row of the table."""
    pw.detect_planes_in_points(building(50_000).points, _SENSOR)  # loads the loops
    sensor = pw.Sensor(max_depth=5000.0, resolution=0.001, noise=_TOWN_SIGMA) if town else _SENSOR
    started, used = time.perf_counter(), time.process_time()
    with recorded() as stages:
        if tile_points:
            model = pw.detect_planes_in_cloud(
                path, sensor, tile_points=tile_points, max_planes=_MOST_PLANES
            )
        else:
            points = pw.read_cloud(path).points
            model = pw.detect_planes_in_points(points, sensor, max_planes=_MOST_PLANES)
    seconds, busy = time.perf_counter() - started, time.process_time() - used
    peak = peak_memory()
    np.save(labels, model.labels)
    how = f"tiles of {tile_points:,}" if tile_points else "one piece"
    print(
        f"| {len(model.labels):,} | {how} | {seconds:.1f} | {busy:.1f} | {peak:.0f} | "
        f"{len(model)} | {model.information:.6e} |"
    )
    print({name: round(each, 1) for name, each in stages.items()}, file=sys.stderr)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1_000_000, 10_000_000])
    parser.add_argument("--tile-points", type=int, default=4_000_000)
    parser.add_argument("--folder", type=Path, help="where there is room")
    parser.add_argument("--town", action="store_true", help="seen from an airplane")
    parser.add_argument("--one", nargs=2, type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        search(asked.one[0], asked.one[1], asked.tile_points, town=asked.town)
        return
    print(f"load {os.getloadavg()[0]:.1f}\n")
    print("| points | | s | processor s | MB | planes | Phi |\n|---|---|---|---|---|---|---|")
    for size in asked.sizes:
        with TemporaryDirectory(dir=asked.folder) as folder:
            path = Path(folder, "cloud.npy")
            (write_town if asked.town else write_buildings)(path, size)
            found = []
            for tile_points in (asked.tile_points, *([0] if size <= _IN_MEMORY else [])):
                labels = Path(folder, f"labels{tile_points}.npy")
                command = [sys.executable, "-m", "benchmarks.tiles", "--one", str(path)]
                command += [str(labels), "--tile-points", str(tile_points)]
                command += ["--town"] if asked.town else []
                subprocess.run(command, check=True)
                found.append(np.load(labels, mmap_mode="r"))
            if len(found) > 1:
                print(f"\nsame labels: {(found[0] == found[1]).mean():.4%}\n")


if __name__ == "__main__":
    main()
