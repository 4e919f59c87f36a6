"""The problem a search solves: readings, an objective, and exact Phi of any set of planes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.paper.evaluate import Assignment, Evaluator

Array = NDArray[np.float64]

_STEPS = 50
_LONGEST = 8.0


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Readings and what planes cost.

    Attributes
    ----------
    evaluator : Evaluator
        The readings.
    empty : float
        Phi of no plane, its mask excluded: every reading an outlier (`Objective.all_outliers`).
    structure : ndarray, shape (M + 1,)
        Mask and parameters of 0 ... M planes in nats.
    weight : float
        Readings that each one of the evaluator stands for: 1, or more on a sample.
    tolerance : float
        Nats; a step that saves less is no progress.
    """

    evaluator: Evaluator
    empty: float
    structure: Array
    weight: float = 1.0
    tolerance: float = 0.0

    @property
    def max_planes(self) -> int:
        """Largest number of planes a model may have."""
        return len(self.structure) - 1

    def phi(self, planes: int, gain: float) -> float:
        """Phi of a model from its number of planes and the sum of its gains."""
        return self.empty + float(self.structure[planes]) + self.weight * gain

    def phis(self, assignment: Assignment) -> Array:
        """Phi with the first 0 ... N planes alone, shape (N + 1,)."""
        sums = assignment.cumulative
        return np.array([self.phi(n, float(gain)) for n, gain in enumerate(sums)])

    def solve(self, parameters: Array) -> Solution:
        """Label the readings with these planes."""
        assignment = self.evaluator.assign(parameters)
        return Solution(parameters, assignment, self.phi(len(parameters), assignment.gain))

    def refine(self, solution: Solution, steps: int = _STEPS, stretch: float = 1.0) -> Solution:
        """Refit all planes and label again, as long as Phi falls.

        The refit is the likelihood's own least squares. It lowers Phi for fixed labels and the
        labelling lowers it for fixed planes. Steps are stretched while that pays, for alternation
        alone converges slowly; a plain step that does not lower Phi is refused and ends it.
        """
        for _ in range(steps):
            start, labels = solution.parameters, solution.assignment.labels
            refitted = self.solve(self.evaluator.refit(start, labels, stretch))
            if stretch > 1.0 and not refitted.phi < solution.phi - self.tolerance:
                stretch = 1.0
                refitted = self.solve(self.evaluator.refit(start, labels))
            if not refitted.phi < solution.phi - self.tolerance:
                break
            solution = refitted
            stretch = min(2.0 * stretch, _LONGEST)
        return solution

    def refine_one(
        self, plane: Array, floor: Array | None = None, steps: int = 8
    ) -> tuple[Array, float]:
        """Refit one plane on the readings it takes from `floor`, as long as that saves more.

        Returns
        -------
        plane : ndarray, shape (p,)
        saved : float
            Sum of min(0, gain - floor) over the readings, negative; the weight is not applied.
        """
        saved, moved = self.evaluator.offer(plane, floor)
        for _ in range(steps):
            saving, further = self.evaluator.offer(moved, floor)
            if not self.weight * saving < self.weight * saved - self.tolerance:
                break
            plane, saved, moved = moved, saving, further
        return plane, saved


@dataclass(frozen=True)
class Solution:
    """Planes, the labelling they imply, and Phi in nats."""

    parameters: Array
    assignment: Assignment
    phi: float

    def __len__(self) -> int:
        return len(self.parameters)
