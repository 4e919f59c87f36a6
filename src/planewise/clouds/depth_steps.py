"""Steps that coordinates were rounded to: those of a file, and those of the depth of a camera.

Points that were rounded lie on slices, one a step, each as flat as if there were no noise. What is
flat then says nothing of the noise across several steps. Files round all three coordinates alike; a
cloud may also be a depth image in the frame of its camera, which tells depth in steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import MOST_LENGTH
from planewise.depth_image import reading_steps

Array = NDArray[np.float64]
Points = NDArray[np.floating]

_FILE_STEPS = (1.0, 0.5, 0.25, 0.2, 0.1, 0.05, 0.025, 0.02, 0.01, 0.005, 0.0025, 0.002, 0.001)
_SAMPLE = 20_000  # points that say which coordinate takes few values
_HELD = 20  # of them to a value of that coordinate, at least
_FEWEST = 20  # values
_WIDEST = 2.0  # tangent of the angle from the axis that few points lie beyond
_BEYOND = 0.01  # share of these few
_GRID = 1e-5  # metres: depths closer than that are one
_PIXEL = 1e-5  # tangents closer than that are of one column or row of pixels ...
_SHARED = 4  # with so many points of the sample on it, at least
_GROWN = 1.1  # times the nearest steps: the farthest ones, but for a lattice, whose are alike


@dataclass(frozen=True, kw_only=True)
class Rounding:
    """Least variance that the points of a cloud may have: that of rounding.

    Attributes
    ----------
    least : float
        By the sensor's resolution and the steps of the file, in square metres.
    ranges, variances : ndarray, shape (k,) or empty
        Range of every point of a depth image, and its variance by the steps of depth; empty where
        the cloud is none, or has too many steps to tell.
    """

    least: float
    ranges: Array
    variances: Array

    @classmethod
    def of(cls, points: Points, resolution: float, origin: Array | None = None) -> Rounding:
        """Of points (k, 3) in the frame of their file; origin: where the scanner stood, if known.

        They are a depth image if a single coordinate takes few values, farther from each other the
        larger they are, and all points lie before the origin along that axis.
        """
        least, steps = max(resolution, _step_of_file(points)) ** 2 / 12.0, None
        if len(points) and (origin is None or not origin.any()):
            steps = _steps(points)
        if steps is None:
            return cls(least=least, ranges=np.empty(0), variances=np.empty(0))
        ranges = np.linalg.norm(points, axis=1)
        return cls(least=least, ranges=ranges, variances=steps**2 / 12.0)

    @property
    def has_steps(self) -> bool:
        """Whether the points are a depth image's."""
        return self.variances.size > 0

    def between(self, low: float, high: float) -> float:
        """Median variance of the points whose range lies between two."""
        mine = self.variances[(self.ranges >= low) & (self.ranges < high)]
        return max(self.least, float(np.median(mine)) if mine.size else 0.0)


def _step_of_file(points: Points) -> float:
    """Metres that all differences of coordinates are multiples of, the same along every axis; or 0.

    Examples
    --------
    >>> points = np.random.default_rng(0).normal(size=(20_000, 3))
    >>> _step_of_file(points), _step_of_file(points.round(2) + 0.123)
    (0.0, 0.01)
    """
    if not len(points):
        return 0.0
    found = np.inf
    for column in points[:: 1 + len(points) // _SAMPLE].T:
        rounding = 4.0 * float(np.spacing(np.abs(column).max()))
        apart = column.astype(np.float64) - column[0]
        if not apart.any():
            return 0.0
        for step in _FILE_STEPS:
            if np.abs(apart - step * np.rint(apart / step)).max() <= 0.01 * step + rounding:
                found = min(found, step)
                break
        else:
            return 0.0
    return found


def _steps(points: Points) -> Array | None:
    """Step of depth at every point; None where they are no depth image."""
    sample = points[:: 1 + len(points) // _SAMPLE]
    values = np.array([np.unique(column).size for column in sample.T])
    few = np.flatnonzero(values * _HELD <= len(sample))
    if few.size != 1 or values[few[0]] < _FEWEST:
        return None
    ahead = sample[:, few[0]]
    aside = np.abs(np.delete(sample, few[0], axis=1)).max(axis=1)
    if ahead.min() <= 0 <= ahead.max() or np.mean(aside > _WIDEST * np.abs(ahead)) > _BEYOND:
        return None
    depth = np.abs(points[:, few[0]])
    if depth.max() > MOST_LENGTH:  # far beyond, there are no whole numbers of the grid
        return None
    levels, place = np.unique(np.rint(depth / _GRID).astype(np.int64), return_inverse=True)
    steps = _GRID * reading_steps(levels)
    third = len(steps) // 3
    if np.median(steps[-third:]) < _GROWN * np.median(steps[:third]):
        columns = np.rint(np.delete(sample, few[0], axis=1) / (_PIXEL * ahead[:, None]))
        if max(np.unique(column).size for column in columns.T) * _SHARED > len(sample):
            return None
    return np.asarray(steps[place])
