"""Phi of the default call against a long search for a lower one: prints Markdown tables.

python -m benchmarks.long_run [--data FOLDER] [--frames 5] [--restarts 60] [--seconds 12]

The search starts from the default's planes and from restarts: the same pipeline with its constants
drawn at random. To the best of them it does every move of `benchmarks.phi_moves`, the planes of
other restarts included, until none lowers exact Phi or its time is up. Nobody knows what the lowest
Phi is; this is how far below the default one can get. VOI and F1 at an IoU of 0.5 say whether a
lower Phi is a better segmentation: coplanar surfaces are joined in both.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

import numpy as np

from benchmarks.arguments import parser_of
from benchmarks.frames import DATA, Frame
from benchmarks.labelled import AbsentError, LabelledFrame, frames_of
from benchmarks.phi_moves import MOVES, Judge, Move, Solution
from planewise.metrics import evaluate
from planewise.spatial import cells, frame_error, merging
from planewise.spatial import labels as spatial_labels
from planewise.spatial import search as spatial
from planewise.spatial import solution as spatial_solution

Gains = dict[str, float]

SETS = {"rooms": 5, "nyu_dpd": 5, "abw_segcomp": 3, "mosd_boxes": 3}  # frames at most
_OTHERS = 8  # restarts whose planes are tried

# What restarts draw. Factors are log-normal with this deviation; the rest is picked.
_SCALED: tuple[tuple[ModuleType, str, float], ...] = (
    (merging, "_SAME", 0.5),
    (cells, "_SPLIT", 0.7),
    (cells, "SATURATION", 0.7),
    (frame_error, "_DISTORTED", 0.7),
    (spatial_labels, "_DIFFERING", 0.5),
    (spatial_labels, "_PIXEL_DRIFT", 0.5),
)
_PAIRS: tuple[tuple[ModuleType, str, float | tuple[float, ...]], ...] = (
    (cells, "_HOPELESS", 0.5),
    (merging, "_TAILS", 0.3),
    (spatial, "_PLANE_COST", 0.7),
    (spatial_solution, "_LEAST", 1.5),
    (merging, "_MERGE_BORDER", (0.5, 0.5, 0.3)),
    (spatial, "_PLANE_BORDER", (0.5, 0.5, 0.3)),
)
_PICKED: tuple[tuple[ModuleType, str, tuple[float, ...]], ...] = (
    (merging, "_LEVELS", (0, 1, 2, 3)),
    (merging, "_SHARE_POWER", (0.0, 0.125, 0.25, 0.5)),
)
_SIGNIFICANCE = (0.0, 0.0, 30.0, 100.0)


@dataclass(frozen=True)
class Result:
    """What a long search of a frame came to.

    Attributes
    ----------
    empty : float
        Phi without planes.
    default, best : Solution
        Of the default search, and the lowest found.
    start : str
        What the best was made from.
    gains : dict
        Nats by move, `restart` among them.
    """

    empty: float
    default: Solution
    best: Solution
    start: str
    gains: Gains = field(default_factory=dict)

    @property
    def gap(self) -> float:
        """Of the default above the best, in percent of Phi."""
        return 100 * (self.default.phi - self.best.phi) / abs(self.best.phi)

    @property
    def unsaved(self) -> float:
        """Of the default above the best, in percent of what the best planes save."""
        saved = self.empty - self.best.phi
        return 100 * (self.default.phi - self.best.phi) / saved if saved > 0 else 0.0


def restart(judge: Judge, rng: np.random.Generator) -> Solution:
    """Segment the frame with constants drawn at random."""
    with ExitStack() as stack:
        for module, name, spread in _SCALED:
            value = getattr(module, name) * np.exp(spread * rng.standard_normal())
            stack.enter_context(patch.object(module, name, float(value)))
        for module, name, spreads in _PAIRS:
            drawn = np.exp(spreads * rng.standard_normal(np.shape(spreads)))
            both = tuple((price * drawn).tolist() for price in np.array(getattr(module, name)))
            stack.enter_context(patch.object(module, name, both))
        for module, name, values in _PICKED:
            stack.enter_context(patch.object(module, name, values[rng.integers(len(values))]))
        least = _SIGNIFICANCE[rng.integers(len(_SIGNIFICANCE))]
        return judge.default(instances=bool(rng.integers(2)), significance=least)


def descend(
    judge: Judge,
    start: Solution,
    others: Sequence[Solution],
    gains: Gains,
    seconds: float = np.inf,
    moves: Sequence[Move] = MOVES,
) -> Solution:
    """Move by move until none lowers Phi; adds to gains what each came to."""
    now, idle, until = start, 0, time.monotonic() + seconds
    while idle < len(moves):
        for move in moves:
            found = move(judge, now, others)
            gains[move.__name__] = gains.get(move.__name__, 0.0) + now.phi - found.phi
            idle = 0 if found.phi < now.phi else idle + 1
            if found is not now:
                now = judge.solution(found.affine, found.labels)
            if idle == len(moves) or time.monotonic() > until:
                return now
    return now


def long_run(frame: Frame, restarts: int, seconds: float, seed: int = 0) -> Result:
    """Search a frame for a lower Phi than the default's."""
    judge, rng = Judge(frame), np.random.default_rng(seed)
    empty, default = judge.nothing(), judge.default()
    found = sorted((restart(judge, rng) for _ in range(restarts)), key=lambda each: each.phi)
    others = [default, *found[:_OTHERS]]
    runs = []
    for name, start in zip(("default", "restart"), others, strict=False):
        gains: Gains = {"restart": default.phi - start.phi}
        best = descend(judge, start, others, gains, seconds / 2)
        runs.append(Result(empty.phi, default, best, name, gains))
    return min(runs, key=lambda run: run.best.phi)


def frames(folder: Path, most: int) -> Iterator[tuple[str, LabelledFrame]]:
    """Frames of all sets that are at hand, with their set; says which are not."""
    for name, count in SETS.items():
        try:
            for each in islice(frames_of(name, folder), min(count, most)):
                yield name, each
        except AbsentError as reason:
            print(f"{name} was skipped: {reason}")


def figures(labelled: LabelledFrame, run: Result) -> dict[str, float]:
    """Gaps; number of planes, VOI and F1 of the default and of the best."""
    out = {"gap": run.gap, "unsaved": run.unsaved}
    valid = np.nan_to_num(np.asarray(labelled.frame.depth, np.float64)) > 0
    for name, solution in (("default", run.default), ("best", run.best)):
        scores = evaluate(solution.labels, labelled.truth, valid=valid).row()
        out[f"{name} planes"] = len(solution)
        out[f"{name} VOI"], out[f"{name} F1"] = scores["voi_labelled"], scores["f1@0.5"]
    return out


def cells_of_row(values: Mapping[str, float], digits: int) -> str:
    """Figures as cells of a table, planes with so many digits."""
    cells = [f"{values['gap']:.3f} | {values['unsaved']:.2f}"]
    for name, places in (("planes", digits), ("VOI", 3), ("F1", 3)):
        cells += [f"{values[f'{which} {name}']:.{places}f}" for which in ("default", "best")]
    return " | ".join(cells)


_HEAD = (
    "gap, % of Phi | % of what planes save | planes | best | VOI | best | F1@.5 | best |",
    8 * "---:|",
)


def table(labelled: Iterable[tuple[str, LabelledFrame]], restarts: int, seconds: float) -> None:
    """Print one row a frame, means by set, and what each move gained."""
    print(f"| frame | no plane | default | best | {_HEAD[0]} from | most by |")
    print(f"|---|---:|---:|---:|{_HEAD[1]}---|---|")
    found: dict[str, list[dict[str, float]]] = {}
    shares: Gains = {}
    for name, each in labelled:
        run = long_run(each.frame, restarts, seconds)
        found.setdefault(name, []).append(figures(each, run))
        move, nats = max(run.gains.items(), key=lambda item: item[1])
        print(
            f"| {each.frame.name} | {run.empty:.0f} | {run.default.phi:.0f} | {run.best.phi:.0f} "
            f"| {cells_of_row(found[name][-1], 0)} | {run.start} | {move}: {nats:.0f} |",
            flush=True,
        )
        for kind, gained in run.gains.items():
            shares[kind] = shares.get(kind, 0.0) + 100 * gained / abs(run.best.phi)
    every = [values for rows in found.values() for values in rows]
    if not every:
        return
    print(f"\n| frames | n | {_HEAD[0]}\n|---|---:|{_HEAD[1]}")
    for name, rows in (*found.items(), ("all", every)):
        means = {key: float(np.mean([values[key] for values in rows])) for key in rows[0]}
        print(f"| {name} | {len(rows)} | {cells_of_row(means, 1)} |")
    print("\n| move | gain, % of Phi |\n|---|---:|")
    for kind, share in sorted(shares.items(), key=lambda item: -item[1]):
        print(f"| {kind} | {share / len(every):.4f} |")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--frames", type=int, default=5, help="of each set, at most")
    parser.add_argument("--restarts", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=12.0, help="of moves, a frame")
    given = parser.parse_args()
    table(frames(given.data, given.frames), given.restarts, given.seconds)


if __name__ == "__main__":
    main()
