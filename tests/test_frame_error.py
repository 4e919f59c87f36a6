"""What a frame tells of its own error, and the numbers that a random walk gives."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from planewise.kernels.cells import PLANE_BEND, PLANE_OFFSET, PLANE_RESIDUAL

POINTS = 12  # to a side of a square
NEARER = 0.45  # of the smaller side: from its centre to where two planes are compared


def square(side, left):
    """Points of a square whose left side lies at `left`."""
    steps = (np.arange(POINTS) + 0.5) / POINTS * side
    x, y = np.meshgrid(left + steps, steps - side / 2)
    return np.column_stack((x.ravel(), y.ravel()))


def plane_at(points, origin):
    """Functionals of readings at points: offset at an origin and two slopes of their plane."""
    return np.linalg.pinv(np.column_stack((np.ones(len(points)), points - origin)))


def walk_covariance(points, contrasts):
    """Covariance of contrasts, whose weights sum to zero, of a random walk of D = 1."""
    assert_allclose(contrasts.sum(axis=1), 0, atol=1e-9)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    return contrasts @ (-distance / 2) @ contrasts.T


@pytest.mark.parametrize("side", [1.0, 0.5, 0.25, 0.125])
def test_planes_of_two_squares_of_a_random_walk(side):
    small, large = square(side, -side), square(1.0, 0.0)
    meeting = np.array([-side / 2 + NEARER * side, 0.0])
    gap = np.hstack((plane_at(small, meeting), -plane_at(large, meeting)))
    offset, across, along = np.diag(walk_covariance(np.vstack((small, large)), gap))
    assert_allclose(offset, PLANE_OFFSET * 1.0, rtol=0.25)
    bend = PLANE_BEND[0] / side + PLANE_BEND[1] / 1.0
    assert_allclose((across + along) / 2, bend, rtol=0.25)
    # One number for both directions: of equal squares each is off by a third.
    assert_allclose([across, along], bend, rtol=0.4)


def test_readings_of_a_random_walk_about_their_own_plane():
    points = square(1.0, 0.0)
    design = np.column_stack((np.ones(len(points)), points))
    residuals = np.eye(len(points)) - design @ np.linalg.pinv(design)
    mean = np.trace(walk_covariance(points, residuals)) / len(points)
    assert_allclose(mean, PLANE_RESIDUAL, rtol=0.05)
