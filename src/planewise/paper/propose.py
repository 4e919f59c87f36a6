"""Candidate planes for the joint search: local fits in an image, random samples elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import readings as kernels
from planewise.observation import Observation
from planewise.paper.evaluate import Evaluator
from planewise.paper.ray_evaluator import RayEvaluator
from planewise.paper.sequential import distinct_tuples

Array = NDArray[np.float64]

_SIDE = 8  # pixels; finest cell
_LEVELS = 4  # 8, 16, 32, 64 pixels
_FILLED = 0.25  # of a cell's pixels must be readings
_FLAT = 1.5  # mean squared residual in sigmas below which a cell is a plane
_RANDOM = 512  # samples of distant readings
_RANDOM_POINTS = 4096  # the same without an image to suggest anything
_NEIGHBOURS = 32  # readings among which a local sample looks for its nearest


def propose(observation: Observation, evaluator: Evaluator, rng: np.random.Generator) -> Array:
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
    distant = evaluator.through(distinct_tuples(rng, samples, evaluator.count, evaluator.dimension))
    candidates = np.vstack((local, distant))
    return np.asarray(candidates[np.isfinite(candidates).all(axis=1)])


def cell_planes(evaluator: RayEvaluator, index: NDArray[np.int64], shape: tuple[int, ...]) -> Array:
    """Least-squares planes of square cells of 64, 32, 16 and 8 pixels.

    A cell is looked into only where it is not flat within the noise. The moments of a cell are the
    sums of those of the four cells in it, so only the finest are computed from readings.
    """
    height, width = shape
    top = _SIDE << (_LEVELS - 1)
    rows, columns = -(-height // top) * top // _SIDE, -(-width // top) * top // _SIDE
    moments = np.empty((rows * columns, 11))
    kernels.cell_moments(evaluator.a, evaluator.s, index, width, _SIDE, columns, moments)
    grids = [moments.reshape(rows, columns, 11)]
    for _ in range(_LEVELS - 1):
        g = grids[-1]
        grids.append(g[::2, ::2] + g[1::2, ::2] + g[::2, 1::2] + g[1::2, 1::2])
    planes = []
    open_cells = np.ones(grids[-1].shape[:2], bool)
    for level in range(_LEVELS - 1, -1, -1):
        fewest = max(3, int(_FILLED * (_SIDE << level) ** 2))
        wanted = open_cells & (grids[level][..., 10] >= fewest)
        theta, misfit = _solve_cells(grids[level][wanted])
        planes.append(theta)
        open_cells[wanted] = ~(misfit < _FLAT)
        open_cells = np.repeat(np.repeat(open_cells, 2, axis=0), 2, axis=1)
    return np.vstack(planes)


def _solve_cells(m: Array) -> tuple[Array, Array]:
    """theta of every cell and its mean squared residual in sigmas; NaN where it has no plane."""
    theta, misfit = np.full((len(m), 3), np.nan), np.full(len(m), np.nan)
    scale = 1.0 / np.sqrt(m[:, [0, 3, 5]])
    matrix = m[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    matrix = matrix * scale[:, :, None] * scale[:, None, :]
    regular = np.linalg.det(matrix) > 1e-14
    m, scale, matrix = m[regular], scale[regular], matrix[regular]
    theta[regular] = scale * np.linalg.solve(matrix, (m[:, 6:9] * scale)[..., None])[..., 0]
    chi2 = 2.0 * (m[:, 9] - np.einsum("ij,ij->i", theta[regular], m[:, 6:9]))
    misfit[regular] = chi2 / m[:, 10]
    return theta, misfit


def _near_tuples(observation: Observation, evaluator: Evaluator, rng: np.random.Generator) -> Array:
    """Planes through a reading and the nearest of a few random others, likelier to share one."""
    n = evaluator.dimension
    pool = min(_NEIGHBOURS, evaluator.count)
    chosen = rng.integers(evaluator.count, size=(_RANDOM_POINTS, pool))
    points = observation.positions()
    gap = np.linalg.norm(points[chosen] - points[chosen[:, :1]], axis=2)
    nearest = np.take_along_axis(chosen, np.argsort(gap, axis=1, kind="stable")[:, :n], axis=1)
    return evaluator.through(nearest)
