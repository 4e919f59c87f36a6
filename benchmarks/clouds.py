"""Clouds of points: time and memory, a generated building and airborne roofs against others.

    python -m benchmarks.clouds speed       # seconds, processor seconds and memory by size
    python -m benchmarks.clouds building    # F1 and time at 200,000 points, all methods
    python -m benchmarks.clouds roofs       # F1 by group, all methods
    python -m benchmarks.clouds noise       # noise="auto" against sigma given
    python -m benchmarks.clouds curved      # planes in what is curved, and in what is not
    python -m benchmarks.clouds pictures    # of scans without labels, into OUT/

F1 is that of planes at IoU 0.5, planes of fewer than 50 points (roofs: all count) left out. Others
share the machine: processor seconds and ratios say more than seconds.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.building import building
from benchmarks.cloud_rivals import CloudMethod, Scan, usable
from benchmarks.curved_clouds import curved_clouds
from benchmarks.frames import DATA
from benchmarks.processes import peak_memory
from planewise.clouds import segments
from planewise.metrics.scores import Detection, evaluate
from planewise.runtime.stages import recorded

_SIZES = (100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
_SENSOR = pw.Sensor(max_depth=20.0, resolution=0.001, noise=0.01)
_AIRBORNE = 0.05  # standard deviation of airborne points, metres: one setting for all sets
_PICTURED = {"lidar": (100.0, 0.01, 0.03), "clouds_indoor": (10.0, 0.001, 0.01)}
_WHAT = ("speed", "one", "building", "roofs", "noise", "curved", "pictures")
_CURVED = ((100_000, 0.005), (100_000, 0.02), (30_000, 0.01))  # points, sigma
_DRAWN = 60_000  # points of a picture
_VIEWS = ((0.0, 90.0), (35.0, 30.0), (125.0, 25.0))  # azimuth and elevation in degrees


def f1(labels: NDArray[np.int64], truth: NDArray[np.int64], smallest: int) -> Detection:
    """Precision, recall and F1 of planes at IoU 0.5."""
    scores = evaluate(labels[None], truth[None], minimum_pixels=smallest)
    return scores.detections[0]


def speed() -> None:
    print("| points | s | processor s | us a point | MB | MB of points | load |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for size in _SIZES:
            path = Path(folder, "points.npy")
            np.save(path, building(size).points)
            # A process of its own: peak memory is that of this size.
            command = [sys.executable, "-m", "benchmarks.clouds", "one", "--points", str(path)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            print(done.stdout.strip(), flush=True)
            print(done.stderr.strip(), file=sys.stderr)


def one(path: Path) -> None:
    points = np.load(path)
    size = len(points)
    pw.detect_planes_in_points(points[:50_000], _SENSOR)
    best, busy = np.inf, np.inf
    for _ in range(3):
        start, used = time.perf_counter(), time.process_time()
        with recorded() as stages:
            pw.detect_planes_in_points(points, _SENSOR)
        best = min(best, time.perf_counter() - start)
        busy = min(busy, time.process_time() - used)
    peak = peak_memory()
    print(
        f"| {size:,} | {best:.2f} | {busy:.2f} | {1e6 * busy / size:.2f} | {peak:.0f} | "
        f"{points.nbytes / 1e6:.0f} | {os.getloadavg()[0]:.1f} |"
    )
    print({name: round(seconds, 2) for name, seconds in stages.items()}, file=sys.stderr)


def in_building(seeds: int, size: int) -> None:
    methods = usable()
    print(f"{size:,} points, sigma 1 cm; {seeds} buildings\n")
    print("| method | setting | s | times ours | P | R | F1 | planes | true |")
    print("|---|---|---|---|---|---|---|---|---|")
    rows: dict[tuple[str, str], list[list[float]]] = defaultdict(list)
    for seed in range(seeds):
        made = building(size, seed=seed)
        scan = Scan("building", made.points, made.labels.astype(np.int64), 0.01, 20.0)
        counted = int((np.bincount(scan.truth)[1:] >= 50).sum())
        mine = 0.0
        for method in methods:
            if method.name == "planewise":
                mine = min(method.run(scan)[0] for _ in range(3))
            seconds, labels = method.run(scan)
            found = f1(labels, scan.truth, 50)
            rows[method.name, method.setting].append(
                [
                    seconds,
                    seconds / mine,
                    found.precision,
                    found.recall,
                    found.f1,
                    float(labels.max()),
                    float(counted),
                ]
            )
    for (name, setting), measured in rows.items():
        s, ratio, p, r, f, n, true = np.mean(measured, axis=0)
        print(
            f"| {name} | {setting} | {s:.2f} | {ratio:.0f} | {p:.2f} | {r:.2f} | {f:.2f} | "
            f"{n:.0f} | {true:.0f} |"
        )


def roof_scans() -> Iterator[tuple[str, Scan]]:
    """Roofs and their groups."""
    for path in sorted((DATA / "roofs").glob("*.npz")):
        with np.load(path) as data:
            truth = np.maximum(data["gt"].astype(np.int64), 0)
            points = data["points"].astype(np.float64)
        group = path.name.split("_")
        name = group[0] if group[0] == "building3d" else " ".join(group[:2])
        name = name.replace("pyramid", "raw").replace("two-sided", "raw")
        yield name, Scan(path.stem, points, truth, _AIRBORNE, 30.0, 0.01)


def on_roofs() -> None:
    scans, methods = list(roof_scans()), usable()
    methods[0].run(scans[0][1])  # compiles
    groups = sorted({group for group, _ in scans})
    print("| method | setting | " + " | ".join(groups) + " | s |")
    print("|---|---|" + "---|" * (len(groups) + 1))
    for method in methods:
        print(_roof_row(method, scans, groups), flush=True)


def _roof_row(method: CloudMethod, scans: list[tuple[str, Scan]], groups: list[str]) -> str:
    scores: dict[str, list[float]] = defaultdict(list)
    spent = 0.0
    for group, scan in scans:
        seconds, labels = method.run(scan)
        spent += seconds
        scores[group].append(f1(labels, scan.truth, 1).f1)
    means = " | ".join(f"{np.mean(scores[group]):.2f}" for group in groups)
    return f"| {method.name} | {method.setting} | {means} | {spent:.1f} |"


def noise(seeds: int, size: int) -> None:
    """What noise="auto" makes of sigma and F1, and of scans without labels."""
    print("| | sigma | estimated / sigma | F1, given | estimated |", end="")
    print(" planes, given | estimated | time, of the same |")
    print("|---|---|---|---|---|---|---|---|")
    pw.detect_planes_in_points(building(20_000).points, replace(_SENSOR, noise="auto"))
    for sigma in (0.002, 0.01, 0.03):
        made = [building(size, sigma=sigma, seed=seed) for seed in range(seeds)]
        scans = [Scan("", b.points, b.labels.astype(np.int64), sigma, 20.0) for b in made]
        print(_noise_row("building", scans, 50))
    roofs = defaultdict(list)
    for group, scan in roof_scans():
        roofs[group].append(scan)
    for group, scans in roofs.items():
        print(_noise_row(f"roofs, {group}", scans, 1))
    print("\n| | given | estimated | planes, given | estimated | on a plane, given | estimated |")
    print("|---|---|---|---|---|---|---|")
    for name, points, sensor in unlabelled():
        said = pw.detect_planes_in_points(points, sensor)
        estimated = replace(sensor, noise="auto")
        auto = pw.detect_planes_in_points(points, estimated, as_image=False)
        told = auto.settings["noise"]["noise"]  # type: ignore[index]
        on = " | ".join(f"{(each.labels > 0).mean():.2f}" for each in (said, auto))
        print(f"| {name} | {sensor.noise} | {told} | {len(said)} | {len(auto)} | {on} |")


def _noise_row(name: str, scans: list[Scan], smallest: int) -> str:
    ratios, rows = [], []
    for scan in scans:
        row: list[float] = []
        known = pw.Sensor(max_depth=scan.range, resolution=scan.resolution, noise=scan.sigma)
        for sensor in (known, replace(known, noise="auto")):
            start = time.perf_counter()
            model = pw.detect_planes_in_points(scan.points, sensor, instances=True)
            seconds = time.perf_counter() - start
            row += [f1(model.labels.astype(np.int64), scan.truth, smallest).f1, len(model), seconds]
        rows.append(row)
        told = pw.estimate_cloud_noise(scan.points, sensor).noise
        ratios.append(told.constant / scan.sigma)
    said, planes, spent, auto, more, longer = np.mean(rows, axis=0)
    between = f"{min(ratios):.2f} ... {max(ratios):.2f}"
    return (
        f"| {name} | {scans[0].sigma:g} | {between} | {said:.2f} | {auto:.2f} | {planes:.0f} | "
        f"{more:.0f} | {longer / spent:.1f} |"
    )


def curved(settings: tuple[tuple[int, float], ...] = _CURVED) -> None:
    """Planes found, without and with looking for what is curved."""
    names = [f"{n:,}, {1e3 * sigma:g} mm" for n, sigma in settings]
    print("| | true | " + " | ".join(f"{name}: before | now" for name in names) + " |")
    print("|---|---|" + "---|---|" * len(names))
    rows: dict[str, list[str]] = {}
    for n, sigma in settings:
        for name, (points, truth) in curved_clouds(n, sigma):
            extent = float(np.linalg.norm(np.ptp(points, axis=0)))
            sensor = pw.Sensor(max_depth=extent, resolution=0.001, noise=sigma)
            before = len(_with_facets(points, sensor))
            now = pw.detect_planes_in_points(points, sensor)
            hit = f1(now.labels.astype(np.int64), truth, 50).hits if truth.any() else 0
            row = rows.setdefault(name, [str(truth.max())])
            row += [str(before), str(len(now)) + (f", {hit} true" if truth.any() else "")]
    for name, row in rows.items():
        print(f"| {name} | " + " | ".join(row) + " |")


def _with_facets(points: NDArray[np.float64], sensor: pw.Sensor) -> pw.PlaneModel:
    """Planes if facets of curved surfaces were planes."""
    with (
        mock.patch.object(
            segments, "curved_segments", lambda rows, _: np.zeros(len(rows), np.bool_)
        ),
        mock.patch.object(segments, "nearly_flat", lambda rows, _: np.arange(len(rows))),
    ):
        return pw.detect_planes_in_points(points, sensor)


def unlabelled() -> Iterator[tuple[str, NDArray[np.float64], pw.Sensor]]:
    """Scans without labels: name, points and a sensor that somebody chose."""
    for kind, (extent, resolution, sigma) in _PICTURED.items():
        sensor = pw.Sensor(max_depth=extent, resolution=resolution, noise=sigma)
        for path in sorted((DATA / kind).glob("*.npz")):
            with np.load(path) as data:
                yield path.stem, data["points"].astype(np.float64), sensor


def pictures(out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    for name, points, sensor in unlabelled():
        model = pw.detect_planes_in_points(points, sensor)
        draw(points, model.labels, out / f"{name}.png", f"{name}: {len(model)}")
        print(f"{name}: {len(points)} points, {len(model)} planes", flush=True)


def draw(points: NDArray[np.float64], labels: NDArray[np.uint16], path: Path, title: str) -> None:
    """Draw points in the colour of their plane, grey on none, from three sides."""
    from matplotlib.figure import Figure

    rng = np.random.default_rng(0)
    colours = rng.uniform(0.2, 0.95, (int(labels.max()) + 1, 3))
    colours[0] = 0.75
    chosen = rng.permutation(len(points))[:_DRAWN]
    seen, painted = points[chosen] - np.median(points, axis=0), colours[labels[chosen]]
    figure = Figure(figsize=(21, 7))
    for axes, (azimuth, elevation) in zip(figure.subplots(1, 3), _VIEWS, strict=True):
        a, e = np.radians((azimuth, elevation))
        right = np.array([-np.sin(a), np.cos(a), 0])
        towards = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
        up = np.cross(towards, right)
        order = np.argsort(seen @ towards)
        x, y = (seen @ right)[order], (seen @ up)[order]
        axes.scatter(x, y, c=painted[order], s=1.2, linewidths=0)
        axes.set(aspect="equal", xlim=np.percentile(x, [1, 99]), ylim=np.percentile(y, [1, 99]))
        axes.axis("off")
    figure.suptitle(title)
    figure.tight_layout()
    figure.savefig(path, dpi=60)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=_WHAT)
    parser.add_argument("--size", type=int, default=200_000)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--points", type=Path, help="of `one`")
    parser.add_argument("--out", type=Path, default=Path("bench-output/clouds"))
    given = parser.parse_args()
    if given.what == "speed":
        speed()
    elif given.what == "one":
        one(given.points)
    elif given.what == "building":
        in_building(given.seeds, given.size)
    elif given.what == "roofs":
        on_roofs()
    elif given.what == "noise":
        noise(given.seeds, given.size)
    elif given.what == "curved":
        curved()
    else:
        pictures(given.out)


if __name__ == "__main__":
    main()
