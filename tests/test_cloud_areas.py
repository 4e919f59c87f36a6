"""Areas of planes of few points."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import planewise as pw
from planewise.clouds.areas import covered_area

UP = np.array([0.0, 0.0, 1.0])


def rectangle(count, size, at=(0.0, 0.0), seed=0):
    rng = np.random.default_rng(seed)
    inside = rng.uniform(at, np.add(at, size), (count, 2))
    return np.column_stack((inside, rng.normal(0, 0.005, count)))


@pytest.mark.parametrize("count", [50, 200, 1000, 4000])
@pytest.mark.parametrize("size", [(1.0, 1.0), (4.0, 1.0)])
def test_areas_of_rectangles_however_they_lie(count, size):
    turn = Rotation.from_rotvec((0.3, -0.5, 0.7)).as_matrix()
    areas = [
        covered_area(rectangle(count, size, seed=seed) @ turn.T + 50.0, turn @ UP)
        for seed in range(8)
    ]
    assert_allclose(np.median(areas), np.prod(size), rtol=0.2 if count < 100 else 0.1)


def test_gaps_are_not_covered():
    ring = rectangle(4000, (4.0, 4.0))
    ring = ring[np.abs(ring[:, :2] - 2.0).max(axis=1) > 1.0]
    assert_allclose(covered_area(ring, UP), 12.0, rtol=0.1)


@pytest.mark.parametrize("points", [np.zeros((30, 3)), np.outer(np.arange(30.0), (1, 2, 0))])
def test_points_that_cover_nothing(points):
    assert np.isnan(covered_area(points, UP))
    assert np.isnan(covered_area(rectangle(19, (1, 1)), UP))  # too few to tell


@pytest.mark.parametrize("instances", [False, True])
def test_walls_with_a_gap_between_them(instances):
    walls = [rectangle(500, (1.0, 1.0), at=(x, 0.0), seed=x) for x in (0, 6)]
    sensor = pw.Sensor(max_depth=20.0, resolution=0.001, noise=0.005)
    model = pw.detect_planes_in_points(np.vstack(walls), sensor, instances=instances)
    areas = [plane.area for plane in model.planes]
    assert_allclose(areas, [1.0, 1.0] if instances else [2.0], rtol=0.15)
