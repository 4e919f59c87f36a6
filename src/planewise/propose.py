"""Candidate planes for the joint search: local fits where there is an image, random samples else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise import kernels
from planewise.evaluate import Evaluator, RayEvaluator
from planewise.observation import Observation
from planewise.sequential import distinct_tuples

Array = NDArray[np.float64]

_SIDE = 8  # pixels; finest cell
_LEVELS = 4  # 8, 16, 32, 64 pixels
_FILLED = 0.25  # of a cell's pixels must be readings
_RANDOM = 512  # samples of distant readings
_RANDOM_POINTS = 4096  # the same without an image to suggest anything
_NEIGHBOURS = 32  # readings among which a local sample looks for its nearest


def propose(
    observation: Observation, evaluator: Evaluator, rng: np.random.Generator
) -> Array:
    """Candidate planes for an observation.

    Parameters
    ----------
    observation : Observation
        Where the readings are.
    evaluator : Evaluator
        The same readings, whitened.
    rng : numpy.random.Generator
        Source of the random samples.

    Returns
    -------
    ndarray, shape (T, p)
        Parameters of the candidates.
    """
    if isinstance(evaluator, RayEvaluator) and len(observation.shape) == 2:
        local = cell_planes(evaluator, observation.index, observation.shape)
        samples = _RANDOM
    else:
        local = _near_tuples(observation, evaluator, rng)
        samples = _RANDOM_POINTS
    distant = evaluator.through(
        distinct_tuples(rng, samples, evaluator.count, evaluator.dimension)
    )
    candidates = np.vstack((local, distant))
    return np.asarray(candidates[np.isfinite(candidates).all(axis=1)])


def cell_planes(
    evaluator: RayEvaluator, index: NDArray[np.int64], shape: tuple[int, ...]
) -> Array:
    """Least-squares planes of square cells of 8, 16, 32 and 64 pixels.

    The moments of a cell are the sums of those of the four cells in it, so only the finest are
    computed from readings.
    """
    height, width = shape
    top = _SIDE << (_LEVELS - 1)
    rows, columns = -(-height // top) * top // _SIDE, -(-width // top) * top // _SIDE
    moments = np.empty((rows * columns, 10))
    kernels.cell_moments(evaluator.a, evaluator.s, index, width, _SIDE, columns, moments)
    grid = moments.reshape(rows, columns, 10)
    planes = []
    for level in range(_LEVELS):
        if level:
            grid = grid[::2, ::2] + grid[1::2, ::2] + grid[::2, 1::2] + grid[1::2, 1::2]
        pixels = (_SIDE << level) ** 2
        planes.append(_solve_cells(grid.reshape(-1, 10), max(3, int(_FILLED * pixels))))
    return np.vstack(planes)


def _solve_cells(moments: Array, fewest: int) -> Array:
    """theta of every cell with enough readings: a 3 x 3 system each, scaled to unit diagonal."""
    m = moments[moments[:, 9] >= fewest]
    matrix = m[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    scale = 1.0 / np.sqrt(m[:, [0, 3, 5]])
    matrix = matrix * scale[:, :, None] * scale[:, None, :]
    regular = np.isfinite(matrix).all(axis=(1, 2))
    regular[regular] = np.linalg.det(matrix[regular]) > 1e-14
    vector = m[regular, 6:9] * scale[regular]
    solved = np.linalg.solve(matrix[regular], vector[..., None])[..., 0]
    return np.asarray(solved * scale[regular])


def _near_tuples(
    observation: Observation, evaluator: Evaluator, rng: np.random.Generator
) -> Array:
    """Planes through a reading and the nearest of a few random others: likelier to share a plane."""
    n = evaluator.dimension
    pool = min(_NEIGHBOURS, evaluator.count)
    chosen = rng.integers(evaluator.count, size=(_RANDOM_POINTS, pool))
    points = observation.positions()
    gap = np.linalg.norm(points[chosen] - points[chosen[:, :1]], axis=2)
    nearest = np.take_along_axis(chosen, np.argsort(gap, axis=1, kind="stable")[:, :n], axis=1)
    return evaluator.through(nearest)
