"""Every method on the same labelled frames: time beside accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.labelled import REAL, SYNTHETIC, AbsentError, LabelledFrame, frames_of
from benchmarks.rivals import Method
from benchmarks.timing import elapsed
from planewise.metrics import evaluate

COLUMNS = {
    "VOI": "voi_labelled",
    "SC": "sc_labelled",
    "F1@.5": "f1@0.5",
    "F1@.8": "f1@0.8",
    "planes": "planes_predicted",
    "true": "planes_true",
}
_ALIKE = ("staircase", "corner")  # every frame of these sets shows the same planes
_RUNS = 5

Result = dict[str, Any]


def compare(methods: Sequence[Method], data: Path, count: int) -> list[Result]:
    """Time and score methods on each labelled set that is at hand, and print the means.

    Parameters
    ----------
    methods : sequence of Method
        What to compare.
    data : Path
        Folder of the real sets.
    count : int
        Frames of each set; real ones from the half on which no setting was chosen.

    Returns
    -------
    list of dict
        For each set and method the median of the times in ms and means of the scores.
    """
    results: list[Result] = []
    for name in (*SYNTHETIC, *REAL):
        try:
            frames = chosen(name, data, count)
        except AbsentError as reason:
            print(f"{name} was skipped: {reason}\n")
            continue
        print(f"**{name}**, {len(frames)} frame{'s' if len(frames) > 1 else ''}\n")
        print(f"| method | settings | ms | {' | '.join(COLUMNS)} |\n|---|---|{'---:|' * 7}")
        for method in methods:
            rows = [measured(method, frame) for frame in frames]
            result = {
                "set": name,
                "method": method.name,
                "settings": method.settings,
                "frames": len(frames),
                "runs": len(rows[0]["times_ms"]),
                "ms": float(np.median([np.median(each["times_ms"]) for each in rows])),
                "quartiles_ms": np.percentile(
                    [np.median(each["times_ms"]) for each in rows], (25, 75)
                ).tolist(),
            } | {key: float(np.nanmean([each[key] for each in rows])) for key in COLUMNS}
            results.append(result | {"each": rows})
            cells = [f"{result[key]:.{1 if key in ('planes', 'true') else 2}f}" for key in COLUMNS]
            milliseconds = f"{result['ms']:,.{0 if result['ms'] >= 100 else 1}f}"
            cells = [method.name, method.settings, milliseconds, *cells]
            print(f"| {' | '.join(cells)} |", flush=True)
        print(flush=True)
    return results


def chosen(name: str, data: Path, count: int) -> list[LabelledFrame]:
    """Frames of a set, evenly spaced."""
    if name in _ALIKE:
        return [next(frames_of(name, data, quick=True))]
    frames = [each for each in frames_of(name, data) if name in SYNTHETIC or not each.chosen_on]
    count = min(count, len(frames))
    return [frames[k * len(frames) // count] for k in range(count)]


def measured(method: Method, labelled: LabelledFrame) -> Result:
    """Times and scores of a method on one frame."""
    ready = method.prepare(labelled.frame, labelled.per_surface)
    if not method.slow:
        ready.detect()
    answers: list[Any] = []
    runs = 1 if method.slow else _RUNS
    times = [elapsed(lambda: answers.append(ready.detect())) for _ in range(runs)]
    labels = ready.labels(answers[0])
    scores = evaluate(labels, labelled.truth).row()
    found: Result = {key: scores[name] for key, name in COLUMNS.items()}
    return found | {"frame": labelled.frame.name, "times_ms": times}
