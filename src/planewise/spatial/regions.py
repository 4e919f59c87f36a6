"""Regions of a partition as a source of planes for the spatial search.

What the search has found stays unless Phi falls. Inside every region, the largest first, the search
merges cells that no plane explains, as if nothing else were there. What it accepts as a plane, by
the same prices, takes its cells, as a plane of its own or as part of the one it lies on; the labels
about it are swept anew, planes are refitted, and the move is made where exact Phi is lower.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planewise.information import coordinate_information, plane_information
from planewise.kernels.cells import SIDE
from planewise.model import Move
from planewise.observation import RayObservation
from planewise.partition.regions import Regions
from planewise.runtime.workspace import Workspace
from planewise.spatial.cells import Cells
from planewise.spatial.frame import Frame
from planewise.spatial.labels import misfits, relabelled
from planewise.spatial.search import Segmentation, planes_within
from planewise.spatial.segments import affine_planes
from planewise.spatial.solution import SpatialSolution, judged
from planewise.spatial.units import pure_information

Array = NDArray[np.float64]
Pixels = NDArray[np.intp]

_LEAST = 1.0  # nats by which Phi has to fall
_UNEXPLAINED = 4.5  # nats: three standard deviations off its plane
_REACH = 12  # pixels about a plane's rectangle where labels may change


def with_regions(
    observation: RayObservation,
    frame: Frame,
    cells: Cells,
    solution: SpatialSolution,
    regions: Regions,
    *,
    significance: float,
    workspace: Workspace,
) -> SpatialSolution:
    """Try the planes that regions suggest, and keep those that lower exact Phi.

    Parameters
    ----------
    observation, frame, cells
        The readings.
    solution : SpatialSolution
        What the search has found.
    regions : Regions
        Of the frame; the remainder is one, too.
    significance : float
        Nats that a plane has to save beyond its costs.
    workspace : Workspace
        Memory to work in.

    Returns
    -------
    SpatialSolution
        With Phi lower by a nat at least; else the same object.
    """
    mover = _Mover(observation, frame, cells, workspace)
    start = now = mover.judged(replace(solution.found, affine=solution.affine))
    at = _pixels(cells, frame.w.shape)
    region = regions.reshape(-1)[at]
    sizes = np.bincount(region)
    for number in np.argsort(-sizes, kind="stable")[: np.count_nonzero(sizes)]:
        inside = region == number
        off = misfits(frame, cells, now.affine, now.found.labels.reshape(-1)[at], at) > _UNEXPLAINED
        for pixels, plane, worth in mover.planes_in(inside & off, ~off, significance):
            trials = [mover.added(now, pixels, plane, worth)]
            if len(now.affine):
                trials.append(mover.given(now, pixels))
            for trial in trials:
                if trial.information < now.information - _LEAST:
                    now = trial
    if now is start or not now.information < solution.information - _LEAST:
        return solution
    move = Move(kind="regions", planes=now.best, information=now.information)
    return replace(now, found=mover.described(now), moves=(*solution.moves, move))


@dataclass(frozen=True)
class _Mover:
    """Makes moves on one frame and judges them by exact Phi."""

    observation: RayObservation
    frame: Frame
    cells: Cells
    workspace: Workspace

    def judged(self, found: Segmentation) -> SpatialSolution:
        """Planes refitted, with exact Phi."""
        with self.workspace.stage():
            return judged(self.observation, self.frame, self.cells, found, self.workspace)

    def planes_in(
        self, units: NDArray[np.bool_], settled: NDArray[np.bool_], significance: float
    ) -> Iterator[tuple[Pixels, Array, float]]:
        """Planes of some units: their pixels, parameters and significance, the best first."""
        if not units.any():
            return
        grid, there = self.cells.grid, self.frame.p > 0
        rows, columns = np.nonzero(np.append(units, False)[grid])
        part, chosen, (top, left, bottom, right) = self.cells.cropped(
            int(rows.min()), int(columns.min()), int(rows.max()), int(columns.max())
        )
        cost = plane_information(3, self.observation.range, self.observation.resolution)
        with self.workspace.stage():
            segments, saved, planes = planes_within(
                part,
                self.frame.sectors,
                units[chosen],
                settled[chosen],
                cost,
                significance,
                self.workspace,
            )
        for k in planes[np.argsort(-saved[planes], kind="stable")]:
            mine = np.append(segments.of_unit == k, False)
            plane, worth = affine_planes(segments.rows[k : k + 1])[0], float(saved[k])
            inside = np.zeros(grid.shape, np.bool_)
            inside[top:bottom, left:right] = mine[part.grid]
            image = inside.repeat(SIDE, axis=0).repeat(SIDE, axis=1)
            yield np.flatnonzero(image[: there.shape[0], : there.shape[1]] & there), plane, worth

    def added(
        self, now: SpatialSolution, pixels: Pixels, plane: Array, worth: float
    ) -> SpatialSolution:
        """One more plane."""
        found = replace(
            now.found,
            affine=np.vstack((now.affine, plane)),
            significance=np.append(now.found.significance, worth),
        )
        return self._moved(found, pixels, len(found.affine))

    def given(self, now: SpatialSolution, pixels: Pixels) -> SpatialSolution:
        """The pixels to the plane that explains them best."""
        costs = [
            np.minimum(
                misfits(self.frame, self.cells, now.affine, np.full(pixels.shape, j), pixels),
                self._null,
            ).sum()
            for j in range(1, len(now.affine) + 1)
        ]
        found = replace(now.found, affine=now.affine)
        return self._moved(found, pixels, int(np.argmin(costs)) + 1)

    def _moved(self, found: Segmentation, pixels: Pixels, label: int) -> SpatialSolution:
        labels = found.labels.copy()
        labels.reshape(-1)[pixels] = label
        labels = relabelled(
            self.frame, self.cells, found.affine, labels, pixels, self._null, _REACH
        )
        return self.judged(replace(found, labels=labels))

    @property
    def _null(self) -> float:
        """Nats of a reading on none."""
        return coordinate_information(self.observation.range, self.observation.resolution)

    def described(self, now: SpatialSolution) -> Segmentation:
        """What was found, with what is said of planes brought up to date."""
        labels = now.found.labels
        return replace(
            now.found,
            information=pure_information(self.frame, self.cells, labels, len(now.affine)),
        )


def _pixels(cells: Cells, shape: tuple[int, int]) -> Pixels:
    """Pixel in the middle of every unit, as its place in the flattened image."""
    out = np.zeros(len(cells.rows), np.intp)
    rows, columns = np.nonzero(cells.grid >= 0)
    units = cells.grid[rows, columns]
    # The last of four cells is written last: its first pixel is in their middle.
    middle = np.where(cells.whole[units], 0, SIDE // 2)
    y, x = (
        np.minimum(at * SIDE + middle, n - 1) for at, n in zip((rows, columns), shape, strict=True)
    )
    out[units] = y * shape[1] + x
    return out
