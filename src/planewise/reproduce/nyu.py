"""The paper's evaluation on NYU-v2 (paper, sec. IV-B): its table, and our rows beside it.

Pixels count inside `planewise.datasets.nyu.SCORED_CROP` of a whole frame, where there is a reading
and a true plane; frames of another size are taken to be cropped already. Of the planes found the k
best by information are kept, k the number of true ones among these pixels.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise import noise, sensors
from planewise.datasets.archives import ArchiveFolder
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.nyu import FULL, SCORED_CROP, NyuFolder, NyuLabelled
from planewise.errors import PlanewiseError
from planewise.metrics.confidence import Interval
from planewise.metrics.contingency import (
    Clustering,
    checked_labels,
    clustering,
    contingency_table,
)
from planewise.metrics.scores import summarise
from planewise.model import PlaneModel
from planewise.sensor import Sensor

PUBLISHED = {
    ("PlaneTR", ""): (1.110, 0.898, 0.726),
    ("PlaneRecTR", ""): (1.045, 0.915, 0.745),
    ("PlaneSeg", ""): (1.684, 0.856, 0.741),
    ("paper", "experimental"): (1.259, 0.890, 0.703),
    ("paper", "proportional"): (0.874, 0.934, 0.799),
}
"""VOI, RI and SC on NYUv2-Plane as the paper reports them (table I)."""

TEST_FRAMES = 654
"""Frames of NYUv2-Plane."""

SENSORS = {
    "experimental": sensors.KINECT_V1,
    "proportional": Sensor(max_depth=10.0, resolution=0.001, noise=noise.proportional(0.01)),
}
"""sigma = 0.0012 + 0.0019 (z - 0.4)^2 and sigma = 0.01 z, in metres."""

# The paper's search, and what `detect_planes` does unless told otherwise.
SEARCHES: dict[str, dict[str, Any]] = {
    "sequential": {
        "search": "sequential",
        "objective": "paper",
        "confidence": 0.99,
        "inlier_ratio": 0.1,
        "max_planes": 8,
    },
    "default": {},
}

ALL, K_BEST = "all", "k best"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One way on one frame.

    Attributes
    ----------
    frame, search, noise, kept : str
        Which frame, one of `SEARCHES`, of `SENSORS`, and whether all planes or the k best.
    true_planes, planes : int
        Among the pixels that count, and kept of those found.
    scores : Clustering
        VOI in bits, RI and SC.
    seconds : float
        Of the detection.
    """

    frame: str
    search: str
    noise: str
    kept: str
    true_planes: int
    planes: int
    scores: Clustering
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Line:
    """One way over all frames: means and 95 % confidence intervals."""

    search: str
    noise: str
    kept: str
    voi: Interval
    ri: Interval
    sc: Interval
    planes: Interval


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """How frames are searched.

    Parameters
    ----------
    partition : object, optional
        ``partition=`` of the paper's search (see `planewise.detect_planes`), which then looks for
        N = 4 planes in each region and N = 8 in what is left; or a folder of regions, as
        `planewise.results.partition.read_partition` takes it. Our default goes without.
    options : dict
        Further options of both searches, such as ``threads``.
    """

    partition: Any = None
    options: dict[str, Any] = field(default_factory=dict)

    def run(self, frame: DatasetFrame) -> list[Row]:
        """Search one frame in every way, and score what is found.

        Raises
        ------
        PlanewiseError
            If it has no true planes where there are readings.
        """
        region, truth = counted(frame)
        true_planes = np.unique(truth).size
        rows = []
        for search in SEARCHES:
            for kind, sensor in SENSORS.items():
                model, seconds = self._detect(frame, search, sensor)
                for kept, best in ((K_BEST, model.top(true_planes)), (ALL, model)):
                    rows.append(
                        Row(
                            frame=frame.id,
                            search=search,
                            noise=kind,
                            kept=kept,
                            true_planes=true_planes,
                            planes=len(best),
                            scores=scores_of(best.labels[region], truth),
                            seconds=seconds,
                        )
                    )
        return rows

    def describe(self) -> str:
        """How the paper's search is set, in words."""
        if isinstance(self.partition, Path):
            return f"in the regions of {self.partition.name}"
        if self.partition is not None:
            from planewise.partition import as_partitioner, describe

            return f"in regions ({describe(as_partitioner(self.partition))})"
        how = SEARCHES["sequential"]
        return f"N = {how['max_planes']}, c = {how['confidence']}, r = {how['inlier_ratio']}"

    def _detect(self, frame: DatasetFrame, search: str, sensor: Sensor) -> tuple[PlaneModel, float]:
        from planewise.detect import detect_planes

        options = SEARCHES[search] | self.options
        regions = self._regions(frame) if options.get("search") == "sequential" else None
        if regions is not None:
            # Every region has an N of its own.
            options |= {"max_planes": None, "partition": regions, "rgb": frame.rgb}
        started = time.perf_counter()
        model = detect_planes(
            frame.depth, frame.camera, sensor, depth_scale=frame.depth_scale, **options
        )
        return model, time.perf_counter() - started

    def _regions(self, frame: DatasetFrame) -> Any:
        if not isinstance(self.partition, Path):
            return self.partition
        from planewise.results.partition import read_partition

        return read_partition(self.partition, frame.id, many=True)


def counted(frame: DatasetFrame) -> tuple[NDArray[np.bool_], NDArray[np.integer]]:
    """Pixels that count, shape (H, W), and their true labels, shape (n,).

    Raises
    ------
    PlanewiseError
        If there are none, or labels are negative.
    """
    if frame.labels is None:
        raise PlanewiseError(f"frame {frame.id} has no true planes")
    labels = checked_labels(f"frame {frame.id}: truth", frame.labels)
    shape = frame.depth.shape[0], frame.depth.shape[1]
    region = np.zeros(shape, bool)
    region[SCORED_CROP if shape == FULL else (slice(None), slice(None))] = True
    region &= frame.valid & (labels > 0)
    if not region.any():
        raise PlanewiseError(f"frame {frame.id} has no reading on a true plane")
    return region, labels[region]


def scores_of(labels: NDArray[np.integer], truth: NDArray[np.integer]) -> Clustering:
    """VOI, RI and SC of pixels that all have a true plane; predicted 0 is one more segment."""
    return clustering(contingency_table(labels, truth).counts[1:])


def lines_of(rows: Sequence[Row]) -> list[Line]:
    """Means over frames, one line a way, in the order of the first frame."""
    ways = dict.fromkeys((row.search, row.noise, row.kept) for row in rows)
    out = []
    for way in ways:
        mine = [row for row in rows if (row.search, row.noise, row.kept) == way]
        found = summarise(
            {
                "voi_labelled": row.scores.variation_of_information,
                "ri_labelled": row.scores.rand_index,
                "sc_labelled": row.scores.covering,
                "planes_predicted": row.planes,
            }
            for row in mine
        )
        voi, ri, sc, planes = found.values()
        out.append(
            Line(search=way[0], noise=way[1], kept=way[2], voi=voi, ri=ri, sc=sc, planes=planes)
        )
    return out


def notes_on(
    protocol: Protocol, dataset: Dataset, frames: int, shapes: set[tuple[int, int]]
) -> list[str]:
    """What the numbers are of, and whether they may be compared with the published ones.

    Parameters
    ----------
    protocol : Protocol
        What they were made with.
    dataset : Dataset
        Where the frames come from.
    frames : int
        How many were scored.
    shapes : set of (height, width)
        Of them.
    """
    notes = [
        f"sequential: the paper's search as it is here, {protocol.describe()}; default: what "
        "detect does unless told otherwise. k best: the planes of most information, as many as "
        "there are true ones."
    ]
    for height, width in sorted(shapes):
        if (height, width) == FULL:
            rows, columns = SCORED_CROP
            notes.append(
                f"Frames of {height} x {width}: pixels in rows {rows.start}:{rows.stop}, columns "
                f"{columns.start}:{columns.stop} count, with a reading and a true plane."
            )
        else:
            notes.append(
                f"Frames of {height} x {width} are cropped already: all of their pixels count, "
                "with a reading and a true plane."
            )
    these = "this frame" if frames == 1 else f"these {frames} frames"
    truth = dataset.truth if isinstance(dataset, (NyuLabelled, NyuFolder)) else None
    if truth is not None and truth.is_plane_set:
        share = "all" if frames == TEST_FRAMES else f"{frames} of the"
        notes.append(f"The true planes are those of NYUv2-Plane, {share} {TEST_FRAMES} frames.")
        if frames != TEST_FRAMES:
            notes.append("The published rows are over all of them.")
    elif isinstance(dataset, ArchiveFolder) or shapes != {FULL}:
        notes.append(
            f"This is NOT the NYUv2-Plane set: the labels of {these} are other people's. The "
            "published rows are on other data; do not compare ours with them."
        )
    else:
        notes.append(
            f"Nothing in the files says that the labels of {these} are those of "
            f"NYUv2-Plane ({TEST_FRAMES} frames, plane_instance_N.npz): compare our rows with the "
            "published ones only if you know that they are."
        )
    return notes


MEANING = (
    "Means over frames ± half of their 95 % confidence intervals; where that would go beyond what "
    "a score can be, its ends"
)
COLUMNS = ("method", "noise", "kept", "VOI, bits", "RI", "SC", "planes")


def table_of(lines: Sequence[Line]) -> Iterator[tuple[str, ...]]:
    """The paper's table and our lines below it, as text."""
    for (name, kind), published in PUBLISHED.items():
        yield name, kind, "published", *(f"{each:.3f}" for each in published), ""
    for line in lines:
        scores = (_with_error(each) for each in (line.voi, line.ri, line.sc))
        yield line.search, line.noise, line.kept, *scores, f"{line.planes.mean:.1f}"


def _with_error(score: Interval) -> str:
    """Mean and half of its confidence interval, or the ends of one that is cut."""
    if score.count < 2:
        return f"{score.mean:.3f}"
    below, above = score.mean - score.low, score.high - score.mean
    if math.isclose(below, above, abs_tol=0.0005):  # half a unit of the last digit
        return f"{score.mean:.3f}±{max(below, above):.3f}"
    return f"{score.mean:.3f} ({score.low:z.3f} ... {score.high:z.3f})"


def write_report(
    folder: Path, lines: Sequence[Line], rows: Sequence[Row], notes: list[str]
) -> None:
    """Write ``nyu.csv``, one line a frame and way, and ``nyu.md``, table and notes."""
    with (folder / "nyu.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        names = ("frame", "search", "noise", "kept", "planes_true", "planes")
        writer.writerow((*names, "voi", "ri", "sc", "seconds"))
        for row in rows:
            scores = row.scores
            writer.writerow(
                (
                    *(row.frame, row.search, row.noise, row.kept, row.true_planes, row.planes),
                    *(scores.variation_of_information, scores.rand_index, scores.covering),
                    f"{row.seconds:.4f}",
                )
            )
    text = [f"| {' | '.join(COLUMNS)} |", "|---|" + "---:|" * (len(COLUMNS) - 1)]
    text += [f"| {' | '.join(cells)} |" for cells in table_of(lines)]
    text += ["", f"{MEANING}.", "", *notes, ""]
    (folder / "nyu.md").write_text("\n".join(text), encoding="utf-8")
