"""What stands off a wall by a small step is a plane of its own, in clouds, too."""

import numpy as np
import pytest
from benchmarks.cloud_steps import undivided
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import planewise as pw
from planewise.clouds import steps
from planewise.clouds.cells import cells_of
from planewise.clouds.cloud import cloud_of
from planewise.clouds.memory import Memory
from planewise.clouds.rows import planes_of
from planewise.information import plane_information
from planewise.kernels.cloud_planes import add_rows
from planewise.kernels.cloud_rows import COUNT, FREE, ROW
from planewise.metrics import evaluate

SIGMA = 0.002
SENSOR = pw.Sensor(max_depth=100.0, noise=SIGMA)


def wall(off, boards=((1.0, 1.0), (3.0, 2.0), (4.6, 0.9)), count=120_000, seed=0):
    """A wall of 6 x 3 m, turned at random, with boards of 60 cm before it; on what points are."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform((0, 0), (6, 3), (count, 2)).T
    on = np.any([(np.abs(x - u) < 0.3) & (np.abs(y - v) < 0.3) for u, v in boards], axis=0)
    points = np.column_stack((x, y, off * on + rng.normal(0, SIGMA, count)))
    return points @ Rotation.random(random_state=seed).as_matrix().T + 5.0, 1 + on


def voi(labels, truth):
    return evaluate(labels[None], truth[None].astype(int)).row()["voi_labelled"]


@pytest.mark.parametrize("noise", [SIGMA, "auto"])
@pytest.mark.parametrize(("off", "most"), [(2.0, 0.06), (3.0, 0.03), (4.0, 0.02)])
def test_boards_before_a_wall_are_told_from_it(off, most, noise):
    """By standard deviations of a point, all within what walls may bulge by."""
    points, truth = wall(off * SIGMA)
    sensor = pw.Sensor(max_depth=100.0, noise=noise)
    with undivided():
        assert len(pw.detect_planes_in_points(points, sensor)) == 1
    model = pw.detect_planes_in_points(points, sensor)
    assert len(model) == 2
    assert voi(model.labels, truth) < most
    assert max(plane.rms for plane in model.planes) < 1.03 * SIGMA


def test_a_wall_that_bulges_stays_one_plane():
    x, y = np.random.default_rng(0).uniform((0, 0), (6, 3), (60_000, 2)).T
    noise = np.random.default_rng(1).normal(0, SIGMA, len(x))
    points = np.column_stack((x, y, 0.005 * np.sin(x) * np.sin(y) + noise))
    assert len(pw.detect_planes_in_points(points, SENSOR)) == 1


def segmented(points):
    """Cells of a cloud, and all of them as one segment."""
    cells = cells_of(cloud_of(points, SENSOR, None, 1))
    rows, of_cell = np.zeros((1, ROW)), np.zeros(len(cells.rows), np.int64)
    add_rows(cells.rows, of_cell, rows)
    return cells, rows, of_cell


def divided(cells, rows, of_cell, curved=False, cost=30.0):
    return steps.at_steps(
        cells, rows, of_cell, np.full(len(rows), curved), cost, 1, 10_000, Memory()
    )


@pytest.mark.parametrize("curved", [False, True])  # it is all there is, and wide
def test_parts_are_in_place_of_the_segment_and_behind(curved):
    points, truth = wall(5 * SIGMA)
    cells, rows, of_cell = segmented(points)
    before = rows.copy(), of_cell.copy()
    out, of = divided(cells, rows, of_cell, curved)
    assert_array_equal(rows, before[0])
    assert_array_equal(of_cell, before[1])
    assert len(out) == 3  # the wall, the boards, and what lies across their edges
    assert_allclose(out[:, COUNT], np.bincount(of, cells.rows[:, COUNT]))
    assert out[0, COUNT] > 0.9 * np.count_nonzero(truth == 1)
    assert out[1, COUNT] > 0.8 * np.count_nonzero(truth == 2)
    assert_allclose(out[:2, FREE], np.bincount(of, cells.rows[:, FREE])[:2])
    assert out[2, FREE] == 0.0
    normals = planes_of(out[:2])
    assert abs(abs(normals[0] @ normals[1][:4] - normals[0, 3] * normals[1, 3]) - 1) < 1e-5
    assert_allclose(abs(normals[0, 3] - normals[1, 3]), 5 * SIGMA, rtol=0.1)


def test_what_is_no_step_or_costs_too_much_stays_whole():
    flat = segmented(wall(0.0)[0])
    out, of = divided(*flat)
    assert out is flat[1]
    assert of is flat[2]
    broken = segmented(wall(5 * SIGMA)[0])
    dear = plane_information(3, 100.0, 0.001) * 1e3
    assert len(divided(*broken, cost=dear)[0]) == 1


def test_narrow_pieces_of_curved_surfaces_are_not_looked_at():
    cells, rows, of_cell = segmented(wall(5 * SIGMA)[0])
    more = np.concatenate((rows, rows))  # another of as many points and more beside it
    more[1, COUNT] *= 30
    out, _ = steps.at_steps(
        cells, more, of_cell, np.array([True, False]), 30.0, 1, 10_000, Memory()
    )
    assert len(out) == 2
