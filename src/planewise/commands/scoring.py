"""From pairs of label images to a table of scores: what ``planewise eval`` does."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from planewise.commands.jobs import Failed
from planewise.commands.label_pairs import Pairs
from planewise.errors import PlanewiseError
from planewise.files.labels import Labelled, read_labels
from planewise.metrics import MINIMUM_PIXELS, FrameScores, evaluate
from planewise.whole_files import written_whole


@dataclass(frozen=True, kw_only=True)
class Scored:
    """Scores of one frame."""

    name: str
    scores: FrameScores


@dataclass(frozen=True, kw_only=True)
class Scoring:
    """How to score; see `planewise.metrics.evaluate`."""

    iou: tuple[float, ...] = (0.5, 0.8)
    minimum_pixels: int = MINIMUM_PIXELS
    tolerance: float = 0.8

    def __post_init__(self) -> None:
        # A setting out of range is wrong once, not once a frame.
        evaluate(
            [[0]],
            [[0]],
            iou=self.iou,
            minimum_pixels=self.minimum_pixels,
            tolerance=self.tolerance,
        )

    def run(self, predicted: Path | Labelled, truth: Path) -> FrameScores:
        """Score one file against another.

        Raises
        ------
        ValueError
            If a file holds no labels, their sizes differ, or a setting is out of range.
        """
        found, true = read_labels(predicted), read_labels(truth)
        if found.labels.shape != true.labels.shape:
            raise PlanewiseError(
                f"predicted: {predicted} has shape {found.labels.shape}, its truth {truth} has "
                f"{true.labels.shape}"
            )
        known = found.planes is not None and true.planes is not None
        return evaluate(
            found.labels,
            true.labels,
            valid=true.valid,
            predicted_planes=found.planes if known else None,
            truth_planes=true.planes if known else None,
            iou=self.iou,
            minimum_pixels=self.minimum_pixels,
            tolerance=self.tolerance,
        )

    def run_pairs(self, pairs: Pairs) -> Iterator[Scored | Failed]:
        """Score every pair; one that cannot be used is reported, and the others go on."""
        for name, predicted, truth in pairs.paired:
            try:
                yield Scored(name=name, scores=self.run(predicted, truth))
            except (ValueError, OSError) as error:
                yield Failed(path=truth, reason=f"{name}: {error}")


def write_table(path: Path, frames: Sequence[Scored]) -> None:
    """Write one line a frame as CSV; what is not defined stays empty.

    The file is complete or, after an error, as it was before.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [frame.scores.row() for frame in frames]
    with (
        written_whole(path) as partial,
        partial.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.writer(stream)
        writer.writerow(("frame", *(rows[0] if rows else ())))
        for frame, row in zip(frames, rows, strict=True):
            cells = ("" if math.isnan(value) else value for value in row.values())
            writer.writerow((frame.name, *cells))
