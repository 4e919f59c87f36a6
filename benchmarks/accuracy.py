"""Truth of the detector on labelled frames, one configuration for all: prints a Markdown table.

python -m benchmarks.accuracy [--data FOLDER] [--sets nyu_dpd rooms ...] [--quick] [-o FILE.json]
        [--search S] [--objective O] [--max-planes N] [--with NAME=VALUE ...]
        [--sensor-noise auto|METRES|PERCENT] [--sigma-factor F] [--shifts N]

Means over frames. VOI in bits and SC: pixels with a true plane; F1, P and R: of planes at the IoU
stated; correct: Hoover et al., tolerance 0.8; exact: share of the frames with the true number of
planes; ms: median of the detection alone, one thread. Under each set its two halves by room, the
target ("must", "aim") and the best rival's figure. * reaches "must", ** reaches "aim". room_faces
are the rooms with every flat face labelled, those that are clutter in rooms, too.

--shifts scores crops instead, N of every frame, without up to 47 of its first rows and columns: the
grid of cells lies elsewhere in each. Figures of one position alone differ by chance, and settings
chosen on them are chosen on that, too.
"""

from __future__ import annotations

import argparse
import inspect
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.frames import DATA
from benchmarks.labelled import REAL, SYNTHETIC, AbsentError, LabelledFrame, frames_of
from planewise.metrics import evaluate, summarise

COLUMNS = {
    "VOI": "voi_labelled",
    "SC": "sc_labelled",
    "F1@.5": "f1@0.5",
    "F1@.8": "f1@0.8",
    "P@.5": "precision@0.5",
    "R@.5": "recall@0.5",
    "correct": "hoover_correct",
    "planes": "planes_predicted",
    "true": "planes_true",
    "exact": "exact",
    "VOI frame": "voi_frame",
    "ms": "ms",
}
LOW_IS_GOOD = {"VOI", "VOI frame", "planes", "ms"}
DECIMALS = {"correct": 1, "planes": 1, "true": 1, "ms": 0, "exact": 2}

# Best rival: each at its best of three settings a set, the best of them in every column by itself.
TARGETS: dict[str, dict[str, dict[str, float]]] = {
    "nyu_dpd": {
        "must": {"VOI": 0.65, "SC": 0.86, "F1@.5": 0.70, "F1@.8": 0.42},
        "aim": {"VOI": 0.50, "SC": 0.90, "F1@.5": 0.82, "F1@.8": 0.60},
        "rival": {"VOI": 0.98, "SC": 0.77, "F1@.5": 0.64, "F1@.8": 0.34, "VOI frame": 1.71},
    },
    "abw_segcomp": {
        "must": {"VOI": 0.24, "F1@.5": 0.94, "F1@.8": 0.86, "correct": 15.5},
        "aim": {"VOI": 0.17, "F1@.5": 0.97, "F1@.8": 0.93, "correct": 17.5},
        "rival": {
            "VOI": 0.30, "SC": 0.95, "F1@.5": 0.94, "F1@.8": 0.80, "correct": 13.8,
            "VOI frame": 0.33,
        },
    },
    "mosd_boxes": {
        "must": {"VOI": 0.065, "F1@.5": 0.975, "F1@.8": 0.95},
        "aim": {"VOI": 0.045, "F1@.5": 0.99, "F1@.8": 0.985},
        "rival": {"VOI": 0.07, "F1@.5": 0.97, "F1@.8": 0.94, "VOI frame": 0.06},
    },
    "mosd_curved": {"must": {"planes": 1.3}, "aim": {"planes": 1.0}, "rival": {"planes": 1.0}},
    "rooms": {
        "must": {"VOI": 0.05, "SC": 0.99, "P@.5": 0.95, "R@.5": 0.95},
        "aim": {"VOI": 0.03, "SC": 0.995, "P@.5": 0.99, "R@.5": 0.99},
        "rival": {"VOI": 0.39, "SC": 0.93, "P@.5": 0.65, "R@.5": 0.62},
    },
    "room_faces": {},
    "staircase": {"must": {"VOI": 0.03, "exact": 1.0}, "rival": {"VOI": 0.04, "SC": 0.99}},
    "corner": {"must": {"VOI": 0.03, "exact": 1.0}, "rival": {"VOI": 0.43, "SC": 0.94}},
}  # fmt: skip

_SHIFT = 48  # pixels: a side of the largest squares that cells are joined to at once

Row = dict[str, float]


@dataclass(frozen=True)
class Configuration:
    """What all frames have in common.

    Attributes
    ----------
    options : dict
        Keywords of `planewise.detect_planes`.
    noise : str, optional
        Replaces the noise of every sensor.
    factor : float
        Multiplies it.
    """

    options: dict[str, Any]
    noise: str | None = None
    factor: float = 1.0

    def sensor(self, sensor: pw.Sensor) -> pw.Sensor:
        """Sensor as it is to be described to the detector."""
        noise: Any = sensor.noise
        if self.noise is not None and self.noise.endswith("%"):
            noise = pw.noise.proportional(float(self.noise[:-1]) / 100)
        elif self.noise is not None:
            noise = self.noise if self.noise == "auto" else pw.noise.constant(float(self.noise))
        if self.factor != 1:
            known = noise

            def noise(z: Any) -> Any:
                return self.factor * known(z)

        return sensor if noise is sensor.noise else replace(sensor, noise=noise, parts=None)

    def run(self, labelled: LabelledFrame) -> Row:
        """Detect, time and score."""
        frame = replace(labelled.frame, sensor=self.sensor(labelled.frame.sensor))
        options = dict(self.options)
        spatial = options.get("objective") in (None, "spatial")
        if labelled.per_surface and spatial and options.get("search", "joint") == "joint":
            options.setdefault("instances", True)
        start = time.perf_counter()
        model = frame.detect(threads=1, **options)
        milliseconds = 1e3 * (time.perf_counter() - start)
        parameters = labelled.planes if len(model.coefficients) == model.labels.max() else None
        scores = evaluate(
            model.labels,
            labelled.truth,
            valid=np.nan_to_num(np.asarray(frame.depth, np.float64)) > 0,
            predicted_planes=None if parameters is None else model.coefficients,
            truth_planes=parameters,
        )
        exact = float(scores.predicted_planes == scores.true_planes)
        return scores.row() | {"exact": exact, "ms": milliseconds}


def means(rows: list[Row]) -> Row:
    """Means over frames of the columns; the median of the times."""
    summary = summarise(rows)
    out = {column: summary[key].mean for column, key in COLUMNS.items()}
    return out | {"ms": float(np.median([row["ms"] for row in rows]))}


def crops(frames: Iterator[LabelledFrame], shifts: int) -> Iterator[LabelledFrame]:
    """So many crops of every frame, the same in every run; the frames themselves if 0."""
    rng = np.random.default_rng(0)
    for each in frames:
        corners = rng.integers(_SHIFT, size=(shifts, 2)).tolist()
        yield from (each.cropped(*corner) for corner in corners) if shifts else (each,)


def reached(column: str, value: float, targets: Mapping[str, Row]) -> str:
    """Stars for a value: which targets it reaches."""
    sign = 1 if column in LOW_IS_GOOD else -1
    for kind, stars in (("aim", "**"), ("must", "*")):
        bound = targets.get(kind, {}).get(column)
        if bound is not None and sign * value <= sign * bound + 1e-9:
            return stars
    return ""


def line(
    name: str,
    values: Row,
    count: int | None = None,
    targets: Mapping[str, Row] | None = None,
) -> None:
    """Print a row of the table, with stars where there are targets."""
    cells = [name, "" if count is None else str(count)]
    for column in COLUMNS:
        value = values.get(column, math.nan)
        text = "" if math.isnan(value) else f"{value:.{DECIMALS.get(column, 3)}f}"
        cells.append(text + reached(column, value, targets or {}))
    print("| " + " | ".join(cells) + " |", flush=True)


def report(name: str, frames: list[tuple[LabelledFrame, Row]]) -> dict[str, Any]:
    """Print the rows of one set and give what goes into the file."""
    halves = {
        "all": [row for _, row in frames],
        "choose": [row for each, row in frames if each.chosen_on],
        "report": [row for each, row in frames if not each.chosen_on],
    }
    targets = TARGETS[name]
    for half, rows in halves.items():
        if rows:
            label = f"**{name}**" if half == "all" else half
            line(label, means(rows), len(rows), targets)
    for kind, target in targets.items():
        line({"rival": "best rival"}.get(kind, kind), target)
    return {
        "means": {half: means(rows) for half, rows in halves.items() if rows},
        "intervals": {
            half: {key: asdict(each) for key, each in summarise(rows).items()}
            for half, rows in halves.items()
            if rows
        },
        "frames": {each.frame.name: row for each, row in frames},
    }


def finite(tree: Any) -> Any:
    """Replace NaN by null, which JSON has."""
    if isinstance(tree, Mapping):
        return {key: finite(value) for key, value in tree.items()}
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = parser_of(__doc__)
    known = (*REAL, *SYNTHETIC)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--sets", nargs="+", choices=known, default=known, metavar="SET")
    parser.add_argument("--quick", action="store_true", help="5 seeds of synthetic scenes")
    parser.add_argument("--search")
    parser.add_argument("--objective")
    parser.add_argument("--max-planes", type=int)
    parser.add_argument("--with", dest="more", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--sensor-noise", metavar="auto|METRES|PERCENT%")
    parser.add_argument("--sigma-factor", type=float, default=1.0)
    parser.add_argument("--shifts", type=int, default=0, metavar="N", help="crops of every frame")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.json")
    return parser.parse_args()


def configuration(given: argparse.Namespace) -> Configuration:
    """One configuration from the command line; values of --with are JSON, else text."""
    options: dict[str, Any] = {
        name: getattr(given, name)
        for name in ("search", "objective", "max_planes")
        if getattr(given, name) is not None
    }
    for pair in given.more:
        name, _, value = pair.partition("=")
        try:
            options[name] = json.loads(value)
        except json.JSONDecodeError:
            options[name] = value
    unknown = options.keys() - inspect.signature(pw.detect_planes).parameters.keys()
    if unknown:
        sys.exit(f"error: detect_planes has no option {', '.join(sorted(unknown))}")
    if given.sensor_noise == "auto" and given.sigma_factor != 1:
        sys.exit("error: a noise that is estimated has no --sigma-factor")
    return Configuration(options, given.sensor_noise, given.sigma_factor)


def main() -> None:
    given = parse()
    setting = configuration(given)
    print(
        f"options {setting.options or 'default'}, noise {setting.noise or 'of the sensor'}", end=""
    )
    print(f", times {setting.factor:g}\n" if setting.factor != 1 else "\n")
    try:
        setting.run(next(frames_of("corner", given.data)))  # compiles, and checks the settings
    except ValueError as error:
        sys.exit(f"error: {error}")
    print(f"| set | frames | {' | '.join(COLUMNS)} |\n|{'---|' * (len(COLUMNS) + 2)}")
    sets: dict[str, Any] = {}
    skipped: dict[str, str] = {}
    for name in given.sets:
        try:
            frames = crops(frames_of(name, given.data, quick=given.quick), given.shifts)
        except AbsentError as reason:
            skipped[name] = str(reason)
            continue
        sets[name] = report(name, [(each, setting.run(each)) for each in frames])
    for name, why in skipped.items():
        print(f"\n{name} was skipped: {why}")
    if given.output is not None:
        record = {"configuration": asdict(setting), "sets": sets, "skipped": skipped}
        text = json.dumps(finite(record), indent=1, allow_nan=False)
        given.output.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
