"""What each part of the objective does: every set under several configurations.

python -m benchmarks.ablation [--data FOLDER] [--quick]

Prints two Markdown tables; every row is one configuration for all sets. Columns as in
`benchmarks.accuracy`; exact: share of the frames with the true number of planes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.accuracy import COLUMNS, DECIMALS, Configuration, means
from benchmarks.arguments import parser_of
from benchmarks.frames import DATA
from benchmarks.labelled import AbsentError, frames_of
from planewise import noise
from planewise.information import mask_information
from planewise.kernels.cells import FREE, SIDE
from planewise.spatial import frame_error, merging
from planewise.spatial import information as spatial_information
from planewise.spatial import search as spatial
from planewise.spatial import solution as spatial_solution
from planewise.spatial.mask_code import MaskCounts

SHOWN = {
    "nyu_dpd": ("VOI", "SC", "F1@.5", "F1@.8"),
    "abw_segcomp": ("VOI", "F1@.5", "F1@.8", "correct"),
    "mosd_boxes": ("VOI", "F1@.5", "F1@.8"),
    "mosd_curved": ("planes",),
    "rooms": ("VOI", "SC", "P@.5", "R@.5"),
    "room_faces": ("P@.5", "R@.5"),
    "staircase": ("exact",),
    "corner": ("exact",),
}
SYNTHETIC_SHOWN = {"staircase": ("exact", "planes"), "corner": ("exact", "planes")}
PAPER: dict[str, Any] = {"objective": "paper"}
FACTORS = {"2.5 times too small": 0.4, "right": 1.0, "2 times too large": 2.0}


@contextmanager
def free_borders() -> Iterator[None]:
    """A border costs nothing, neither in merges nor for planes."""
    free = ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    with (
        patch.object(merging, "_MERGE_BORDER", free),
        patch.object(spatial, "_PLANE_BORDER", free),
    ):
        yield


@contextmanager
def no_distortion() -> Iterator[None]:
    """Wide planes are no farther from their readings than neighbours drift apart."""
    with patch.object(frame_error, "_DISTORTED", np.inf):
        yield


@contextmanager
def no_extra_prices() -> Iterator[None]:
    """Borders and planes cost as much where error drifts as where it is white."""
    with (
        patch.object(merging, "_MERGE_BORDER", 2 * merging._MERGE_BORDER[:1]),
        patch.object(spatial, "_PLANE_BORDER", 2 * spatial._PLANE_BORDER[:1]),
        patch.object(spatial, "_PLANE_COST", 2 * spatial._PLANE_COST[:1]),
        patch.object(spatial_solution, "_LEAST", 2 * spatial_solution._LEAST[:1]),
    ):
        yield


@contextmanager
def uniform_mask() -> Iterator[None]:
    """The paper's k ln(N + 1) for the mask in Phi."""

    def information(counts: Any, readings: Any, place: Any) -> Any:
        count = int(readings.sum())
        return np.array([mask_information(count, planes) for planes in range(len(place))])

    with patch.object(MaskCounts, "lengths", information):
        yield


@contextmanager
def uniform_null() -> Iterator[None]:
    """A reading on no plane takes ln(R / eps), however smooth the surface."""
    segment, agglomerate = spatial.segment, merging.merged
    saved: NDArray[np.float64] = np.empty(0)

    def segment_of(observation: Any, frame: Any, cells: Any, **options: Any) -> Any:
        """Keep what the readings of every unit save on a plane that fits as noise lets it."""
        nonlocal saved
        if cells is not None:
            height, width = frame.w.shape
            unit = np.repeat(np.repeat(cells.grid, SIDE, 0), SIDE, 1)
            unit = unit[:height, :width]
            on = (unit >= 0) & (frame.p > 0)
            sigma = np.sqrt(cells.error.white / frame.p[on]) / frame.w[on] ** 2
            tau = np.log(observation.range / (sigma * np.sqrt(2 * np.pi))) - 0.5
            saved = np.asarray(np.bincount(unit[on], tau, len(cells.rows)), np.float64)
        return segment(observation, frame, cells, **options)

    def agglomerate_all(*arguments: Any, **options: Any) -> Any:
        segments, beside = agglomerate(*arguments, **options)
        rows = segments.rows
        rows[:, FREE] = np.bincount(segments.of_unit, saved, len(rows))
        return segments, beside

    with (
        patch.object(spatial_solution, "segment", segment_of),
        patch.object(spatial, "merged", agglomerate_all),
        patch.object(spatial, "_FEWEST_OFF", sys.maxsize),  # which knows parts of frames only
        patch.object(spatial_information, "_SURFACE", np.inf),
    ):
        yield


@dataclass(frozen=True)
class Independent(Configuration):
    """Sensors described without the parts of their error that neighbouring readings share."""

    def sensor(self, sensor: pw.Sensor) -> pw.Sensor:
        """Sensor of white noise alone."""
        described = super().sensor(sensor)
        white: Any = described.noise if described.parts is None else described.parts.white
        alone = noise.ErrorParts(white=white, shared=noise.NOTHING, drift=noise.NOTHING)
        return replace(described, parts=alone)


@dataclass(frozen=True)
class Variant:
    """One row: a configuration, and what is taken out of the objective meanwhile."""

    name: str
    setting: Configuration
    without: Callable[[], AbstractContextManager[None]] = field(default=nullcontext)


VARIANTS = (
    Variant("paper, sequential", Configuration(PAPER | {"search": "sequential"})),
    Variant("paper, joint", Configuration(PAPER)),
    Variant("paper, joint, noise auto", Configuration(PAPER, "auto")),
    Variant("spatial, independent error", Independent({})),
    Variant("spatial, no distortion", Configuration({}), no_distortion),
    Variant("spatial, prices of white error", Configuration({}), no_extra_prices),
    Variant("spatial, borders free", Configuration({}), free_borders),
    Variant("spatial, uniform mask", Configuration({}), uniform_mask),
    Variant("spatial, uniform null", Configuration({}), uniform_null),
    Variant("**spatial**", Configuration({})),
    Variant("spatial, noise auto", Configuration({}, "auto")),
)


def row(variant: Variant, shown: Mapping[str, tuple[str, ...]], data: Path, quick: bool) -> None:
    """Print one row; sets that are not at hand stay empty."""
    cells = []
    for name, columns in shown.items():
        try:
            frames = frames_of(name, data, quick=quick)
        except AbsentError:
            cells += [""] * len(columns)
            continue
        with variant.without():
            values = means([variant.setting.run(each) for each in frames])
        cells += [f"{values[column]:.{DECIMALS.get(column, 2)}f}" for column in columns]
    print(f"| {variant.name} | {' | '.join(cells)} |", flush=True)


def head(first: str, shown: Mapping[str, tuple[str, ...]]) -> None:
    """Print the head of a table."""
    names = [f"{name} {column}" for name, columns in shown.items() for column in columns]
    print(f"| {first} | {' | '.join(names)} |\n|{'---|' * (len(names) + 1)}")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--quick", action="store_true", help="5 seeds of synthetic scenes")
    given = parser.parse_args()
    assert all(column in COLUMNS for columns in SHOWN.values() for column in columns)
    head("objective", SHOWN)
    for variant in VARIANTS:
        row(variant, SHOWN, given.data, given.quick)
    print()
    head("assumed sigma", SYNTHETIC_SHOWN)
    for name, factor in FACTORS.items():
        variant = Variant(name, Configuration({}, factor=factor))
        row(variant, SYNTHETIC_SHOWN, given.data, given.quick)
    row(Variant("auto", Configuration({}, "auto")), SYNTHETIC_SHOWN, given.data, given.quick)


if __name__ == "__main__":
    main()
