"""Free points in space under the spatial objective, from the call to the model."""

import re

import numpy as np
import pytest
from benchmarks.building import building
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import planewise as pw
from planewise.clouds.cells import cells_of
from planewise.clouds.cloud import cloud_of
from planewise.copies import places_of

SIGMA = 0.01
SENSOR = pw.Sensor(max_depth=10.0, resolution=0.001, noise=SIGMA)


def box(count=12_000, seed=0, size=(3.0, 2.0, 1.5), at=(0, 0, 0)):
    """Noisy points on the six faces of a box and on a ball in it; the face of each, ball 0."""
    rng = np.random.default_rng(seed)
    size = np.asarray(size)
    area = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
    face = rng.choice(6, count, p=np.tile(area, 2) / (2 * area.sum()))
    points = rng.uniform(0, 1, (count, 3)) * size
    points[np.arange(count), face % 3] = np.where(face < 3, 0, size[face % 3])
    ball = rng.normal(size=(count // 10, 3))
    ball = size / 2 + 0.4 * ball / np.linalg.norm(ball, axis=1, keepdims=True)
    points = np.vstack((points, ball)) + rng.normal(0, SIGMA, (count + len(ball), 3)) + at
    order = rng.permutation(len(points))
    return points[order], np.concatenate((face + 1, np.zeros(len(ball), int)))[order]


def matching(labels, truth):
    """Share of points whose label is the one most common on their face."""
    table = np.zeros((truth.max() + 1, labels.max() + 1))
    np.add.at(table, (truth, labels), 1)
    return table.max(axis=1)[1:].sum() / table[1:].sum()


POINTS, TRUTH = box()


@pytest.fixture(scope="module")
def model():
    return pw.detect_planes_in_points(POINTS, SENSOR)


def test_the_faces_of_a_box_and_not_the_ball_in_it(model):
    assert len(model) == 6
    assert model.labels.dtype == np.uint16
    assert matching(model.labels, TRUTH) > 0.97
    assert (model.labels[TRUTH == 0] > 0).mean() < 0.1
    assert model.objective == "spatial"
    assert not model.note


def test_planes_are_described(model):
    size = np.array([3.0, 2.0, 1.5])
    for j, plane in enumerate(model.planes, start=1):
        mine = POINTS[model.labels == j]
        axis = np.abs(plane.normal).argmax()
        assert abs(plane.normal[axis]) > 0.9999
        assert plane.distance >= 0
        assert plane.count == len(mine)
        assert_allclose(plane.centroid, mine.mean(axis=0), atol=1e-5)
        off = mine @ plane.normal + plane.distance
        assert plane.rms == pytest.approx(np.sqrt((off**2).mean()), rel=1e-3)
        assert plane.area == pytest.approx(size.prod() / size[axis], rel=0.1)
        assert plane.information < 0
        assert plane.significance > 0
        assert abs(plane.residual_correlation) < 0.5


def test_information_is_what_points_save_against_outliers(model):
    # Of white noise: -ln of the density, times eps, less ln(R / eps); two coordinates cancel.
    each = 0.5 * np.log(2 * np.pi * np.e * (SIGMA / 0.001) ** 2) - np.log(10 / 0.001)
    for plane in model.planes:
        assert plane.mean_information == pytest.approx(each, rel=0.06)
        # Against a smooth surface, which explains most of it, they save less.
        assert plane.significance < -0.5 * plane.information


def test_phi_of_fewer_planes_and_the_curve(model):
    assert model.information == model.curve[model.curve.chosen] == min(model.curve)
    assert len(model.prefix) == 7
    assert np.all(np.diff(model.prefix) < 0)
    assert [p.information for p in model.planes] == sorted(p.information for p in model.planes)
    best = model.top(2)
    assert best.information == model.prefix[2]
    assert best.labels.max() == 2


def test_coordinates_in_the_millions_lose_nothing():
    shift = np.array([592_345.5, 6_740_321.25, 120.0])
    near = pw.detect_planes_in_points(POINTS, SENSOR)
    far = pw.detect_planes_in_points(POINTS + shift, SENSOR)
    assert_array_equal(near.labels, far.labels)
    for a, b in zip(near.planes, far.planes, strict=True):
        sign = np.sign(a.normal @ b.normal)
        assert_allclose(sign * b.normal, a.normal, atol=1e-7)
        # Both are as far from the same points.
        here = a.centroid @ a.normal + a.distance
        there = (a.centroid + shift) @ b.normal + b.distance
        assert there == pytest.approx(sign * here, abs=1e-7)
        assert_allclose(b.centroid - shift, a.centroid, atol=1e-6)


@pytest.mark.parametrize(("along", "apart", "sigma"), [(0.005, 0.5, 0.003), (0.02, 1.0, 0.01)])
def test_a_floor_of_lines_is_one_plane(along, apart, sigma):
    """A line alone, which is as thick as it is wide, would do with any plane through it."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(0, 10, along), np.arange(0, 10, apart))
    points = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))
    points += rng.normal(0, sigma, points.shape)
    model = pw.detect_planes_in_points(points, pw.Sensor(max_depth=20, noise=sigma))
    assert len(model) == 1
    assert abs(model.planes[0].normal[2]) > 0.9999
    assert np.mean(model.labels) > 0.8


@pytest.mark.parametrize("seed", range(3))
def test_few_exact_points_have_their_own_rms(seed):
    """Twenty shots of a total station at a wall of 30 m."""
    rng = np.random.default_rng(seed)
    shots = np.column_stack((rng.uniform(0, 30, (20, 2)), rng.normal(0, 2e-4, 20)))
    points = Rotation.from_euler("y", 0.7).apply(shots)
    (plane,) = pw.detect_planes_in_points(points, pw.Sensor(max_depth=100, noise=3e-4)).planes
    off = points @ plane.normal + plane.distance
    assert plane.rms == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-3)


@pytest.mark.parametrize("noise", [SIGMA, "auto"])
@pytest.mark.parametrize("share", [0.2, 1.0])
def test_points_all_over_cost_no_plane(share, noise):
    rng = np.random.default_rng(1)
    strays = rng.uniform(-25, 25, (int(share * len(POINTS)), 3))
    sensor = pw.Sensor(max_depth=100.0, noise=noise)
    found = pw.detect_planes_in_points(np.vstack((POINTS, strays)), sensor)
    assert len(found) == 6
    assert matching(found.labels[: len(POINTS)], TRUTH) > 0.97
    assert (found.labels[len(POINTS) :] > 0).mean() < 0.01


def two_sides(gap, turn):
    """Points on both sides of a wall, and on which they are."""
    rng = np.random.default_rng(turn)
    xy, side = rng.uniform(0, 3, (10_000, 2)), np.repeat((0.0, gap), 5_000)
    points = np.column_stack((xy, side + rng.normal(0, SIGMA, 10_000)))
    return points @ Rotation.random(random_state=turn).as_matrix().T, side


def test_sheets_that_are_too_near_are_said_to_be():
    found = pw.detect_planes_in_points(two_sides(0.09, 3)[0], SENSOR)
    assert len(found) == 0
    assert re.search(r"; sheets nearer to each other than 0\.\d+ m are not told apart$", found.note)


@pytest.mark.parametrize("gap", [0.12, 0.15, 0.2])
@pytest.mark.parametrize("turn", range(4))
def test_two_sides_of_a_wall_are_two_planes(turn, gap):
    points, side = two_sides(gap, turn)
    found = pw.detect_planes_in_points(points, SENSOR)
    assert len(found) == 2
    assert matching(found.labels, 1 + (side > 0)) > 0.99


def test_single_precision_is_searched_as_it_is():
    double = pw.detect_planes_in_points(POINTS.astype(np.float32).astype(np.float64), SENSOR)
    single = pw.detect_planes_in_points(POINTS.astype(np.float32), SENSOR)
    assert_array_equal(single.labels, double.labels)
    assert_allclose(single.coefficients, double.coefficients, atol=1e-9)


def test_no_result_depends_on_threads_and_no_input_changes():
    points = building(60_000).points
    before = points.copy()
    found = [pw.detect_planes_in_points(points, SENSOR, threads=n) for n in (1, 2, 3)]
    assert_array_equal(points, before)
    for other in found[1:]:
        assert_array_equal(found[0].labels, other.labels)
        assert found[0].information == other.information
        assert_array_equal(found[0].coefficients, other.coefficients)


@settings(max_examples=6)
@given(seed=st.integers(0, 1000))
def test_shuffled_points_have_the_same_planes_and_their_own_labels(model, seed):
    order = np.random.default_rng(seed).permutation(len(POINTS))
    shuffled = pw.detect_planes_in_points(POINTS[order], SENSOR)
    assert len(shuffled) == len(model)
    assert (shuffled.labels == model.labels[order]).mean() > 0.999
    assert_allclose(shuffled.coefficients, model.coefficients, atol=1e-6)


@settings(max_examples=8)
@given(seed=st.integers(0, 1000), shift=st.floats(-1e6, 1e6), scale=st.floats(0.01, 100))
def test_turned_moved_and_scaled_clouds_have_turned_moved_and_scaled_planes(
    model, seed, shift, scale
):
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    sensor = pw.Sensor(max_depth=10 * scale, resolution=0.001 * scale, noise=SIGMA * scale)
    moved = pw.detect_planes_in_points(scale * POINTS @ turn.T + shift, sensor)
    assert matching(moved.labels, TRUTH) > 0.95
    assert len(moved) == len(model)
    for plane in model.planes:
        agreement = [abs(other.normal @ turn @ plane.normal) for other in moved.planes]
        other = moved.planes[int(np.argmax(agreement))]
        assert max(agreement) > 1 - 1e-5
        # Of the cells, which lie otherwise on a turned plane.
        assert other.area == pytest.approx(plane.area * scale**2, rel=0.3)


@pytest.mark.parametrize("turned", [(1, 0, 0), (0, 1, 0), (2, 2, -1)])
def test_a_wall_along_the_faces_of_the_grid_is_one_plane(turned):
    rng = np.random.default_rng(0)
    normal = np.array(turned) / np.linalg.norm(turned)
    inside = np.linalg.svd(normal[None])[2][1:]
    for offset in np.linspace(0, 0.1, 5):
        points = rng.uniform(-2, 2, (20_000, 2)) @ inside
        points += (offset + rng.normal(0, SIGMA, 20_000))[:, None] * normal
        found = pw.detect_planes_in_points(points, SENSOR)
        assert len(found) == 1
        assert (found.labels > 0).mean() > 0.98


def tables(gap=1.0):
    rng = np.random.default_rng(0)
    first = np.column_stack((rng.uniform(0, 1, (3000, 2)), rng.normal(0.7, SIGMA, 3000)))
    second = np.column_stack((rng.uniform(0, 1, (3000, 2)), rng.normal(0.7, SIGMA, 3000)))
    floor = np.column_stack((rng.uniform(-1, 4, (20_000, 2)), rng.normal(0, SIGMA, 20_000)))
    return np.vstack((first, second + np.array((1 + gap, 0, 0)), floor))


def test_two_tables_are_one_plane_or_two_surfaces():
    together = pw.detect_planes_in_points(tables(), SENSOR)
    apart = pw.detect_planes_in_points(tables(), SENSOR, instances=True)
    assert len(together) == 2
    assert len(apart) == 3
    assert set(apart.labels[:3000]) - {0} != set(apart.labels[3000:6000]) - {0}


def test_the_number_of_planes_is_bounded_and_so_is_significance():
    few = pw.detect_planes_in_points(POINTS, SENSOR, max_planes=3)
    assert len(few) == 3
    assert "max_planes = 3" in few.curve.reason
    strict = pw.detect_planes_in_points(POINTS, SENSOR, significance=1e6)
    assert len(strict) == 0
    assert strict.note


def test_sigma_may_be_a_number_a_function_or_one_a_point(model):
    of_point = pw.detect_planes_in_points(POINTS, SENSOR, sigma=np.full(len(POINTS), SIGMA))
    assert_array_equal(of_point.labels, model.labels)
    function = pw.Sensor(max_depth=10, resolution=0.001, noise=lambda z: 0 * z + SIGMA)
    assert_array_equal(pw.detect_planes_in_points(POINTS, function).labels, model.labels)


def test_noisier_points_count_less():
    rng = np.random.default_rng(1)
    sigma = np.where(np.arange(8000) % 2, 0.005, 0.05)
    points = np.column_stack((rng.uniform(0, 2, (8000, 2)), 1 + rng.normal(0, sigma)))
    found = pw.detect_planes_in_points(points, SENSOR, sigma=sigma)
    assert len(found) == 1
    assert found.planes[0].distance == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("factor", [2.5, 10.0, 100.0])
def test_a_sigma_that_is_too_small_is_raised_by_the_points(factor):
    sensor = pw.Sensor(max_depth=10.0, resolution=0.001, noise=SIGMA / factor)
    found = pw.detect_planes_in_points(POINTS, sensor)
    assert matching(found.labels, TRUTH) > 0.95
    assert len(found) <= 8


@pytest.mark.parametrize("sigma", [0.01, 0.004, 0.001])
def test_sheets_that_are_thicker_than_cubes_of_dense_points(sigma):
    """A corner, 1 cm of noise, of so many points that cubes have a side of 3 cm."""
    rng = np.random.default_rng(0)
    faces = rng.random((3, 100_000, 3)) * 3
    for axis, face in enumerate(faces):
        face[:, axis] = 0.0
    points = faces.reshape(-1, 3) + rng.normal(0, 0.01, (300_000, 3))
    found = pw.detect_planes_in_points(points, pw.Sensor(max_depth=10.0, noise=sigma))
    assert matching(found.labels, np.repeat([1, 2, 3], 100_000)) > 0.95
    assert len(found) == 3


def test_points_that_fill_their_cubes_do_not_raise_sigma():
    leaves = np.random.default_rng(0).random((50_000, 3)) * 4
    for sigma in (0.01, 0.002, 0.0005):
        assert len(pw.detect_planes_in_points(leaves, pw.Sensor(max_depth=10.0, noise=sigma))) == 0


def floor_seen_from(origin, count=30_000):
    """A floor whose noise is along rays from an origin: across it, far off, there is little."""
    rng = np.random.default_rng(0)
    points = np.column_stack((rng.uniform(-6, 6, (count, 2)), np.zeros(count)))
    points[::2, 2] = 0.08 * (points[::2, 0] > 4)  # half of the points are on a low step, far off
    rays = points - origin
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return points + along * rng.normal(0, 0.03, (count, 1))


def test_noise_along_rays_is_small_across_what_they_graze():
    origin = np.array([0.0, 0.0, 1.2])
    points = floor_seen_from(origin)
    sensor = pw.Sensor(max_depth=20.0, resolution=0.001, noise=0.03)
    plain = pw.detect_planes_in_points(points, sensor)
    known = pw.detect_planes_in_points(points, sensor, origin=origin)
    each = pw.detect_planes_in_points(points, sensor, origin=np.tile(origin, (len(points), 1)))
    assert_array_equal(known.labels, each.labels)
    floor = known.planes[0]
    assert abs(floor.normal[2]) > 0.9999
    # Less noise across the floor: the same readings take fewer nats.
    limit = 2 * len(points) * np.log(20 / 0.001)  # of two coordinates, which a ray fixes
    assert known.information < plain.information - limit
    assert floor.covariance[3, 3] < plain.planes[0].covariance[3, 3]
    shift = np.array([592_000.0, 6_740_000.0, 30.0])
    moved = pw.detect_planes_in_points(points + shift, sensor, origin=origin + shift)
    assert (moved.labels == known.labels).mean() > 0.999


@pytest.mark.parametrize("count", [300, 2500])
def test_a_roof_of_few_points(count):
    rng = np.random.default_rng(count)
    plan = rng.uniform(-4, 4, (count, 2))
    slopes = np.array([[0.6, 0], [-0.6, 0], [0, 0.6], [0, -0.6]])
    heights = plan @ slopes.T
    points = np.column_stack((plan, 5 - heights.max(axis=1) + rng.normal(0, 0.04, count)))
    truth = heights.argmax(axis=1) + 1
    sensor = pw.Sensor(max_depth=30, resolution=0.01, noise=0.04)
    found = pw.detect_planes_in_points(points, sensor)
    assert len(found) == 4
    assert matching(found.labels, truth) > 0.85
    order = rng.permutation(count)
    shuffled = pw.detect_planes_in_points(points[order], sensor)
    assert_array_equal(shuffled.labels, found.labels[order])


def level_ground(count, rng):
    return np.column_stack((rng.uniform(-20, 20, (count, 2)), rng.normal(0, 0.05, count)))


@pytest.mark.parametrize("count", [500, 1000, 2000, 3500])
def test_faces_of_sixty_points_above_however_much_ground(count):
    rng = np.random.default_rng(0)
    parts = [level_ground(count, rng)]
    for across in np.array([(1, 0), (-1, 0), (0, 1), (0, -1)]):  # down the four slopes of a roof
        down = 4 * np.sqrt(rng.uniform(0, 1, 60))
        along = rng.uniform(-down, down)
        plan = (3, -5) + down[:, None] * across + along[:, None] * across[::-1]
        parts.append(np.column_stack((plan, 7 - 0.6 * down + rng.normal(0, 0.05, 60))))
    truth = np.repeat(np.arange(1, 6), [count, 60, 60, 60, 60])
    found = pw.detect_planes_in_points(np.vstack(parts), pw.Sensor(max_depth=100, noise=0.05))
    assert len(found) == 5
    assert matching(found.labels, truth) > 0.95


@pytest.mark.parametrize("seed", [4, 8, 11])
def test_crowns_of_trees_above_ground_are_no_planes(seed):
    rng = np.random.default_rng(seed)
    parts = [level_ground(1500, rng)]
    for _ in range(12):
        crown = rng.normal(size=(rng.integers(20, 200), 3))
        crown *= (rng.random(len(crown)) ** (1 / 3) / np.linalg.norm(crown, axis=1))[:, None]
        parts.append(crown * (2, 2, 2.5) + (*rng.uniform(-18, 18, 2), 5))
    found = pw.detect_planes_in_points(np.vstack(parts), pw.Sensor(max_depth=100, noise=0.05))
    assert len(found) == 1
    assert not found.labels[1500:].any()


@pytest.mark.parametrize("reach", [6.0, 30.0, 100.0])
def test_what_only_lies_together_is_no_plane_however_far_the_sensor_reaches(reach):
    """A wall and a bush; the diagonal of the box around both is six metres."""
    rng = np.random.default_rng(1)
    wall = np.column_stack((rng.uniform(0, 1, (1500, 2)) * (3, 2), rng.normal(0, SIGMA, 1500)))
    bush = rng.normal((1.5, 1, -2.5), 0.4, (1500, 3))
    sensor = pw.Sensor(max_depth=reach, resolution=0.001, noise=SIGMA)
    found = pw.detect_planes_in_points(np.vstack((wall, bush)), sensor)
    assert len(found) == 1
    assert (found.labels[:1500] > 0).mean() > 0.98
    assert not found.labels[1500:].any()


@pytest.mark.parametrize("extent", [0.0, 1e-5, 0.002, 0.02])
def test_few_points_within_the_resolution_or_the_noise_show_no_plane(extent):
    points = np.random.default_rng(0).uniform(0, extent, (100, 3))
    assert len(pw.detect_planes_in_points(points, SENSOR)) == 0


def flat(plan, noise=0.01):
    rng = np.random.default_rng(len(plan))
    points = np.column_stack((plan, 2 + rng.normal(0, noise, len(plan))))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return points @ turn.T, pw.Sensor(max_depth=200, noise=noise)


@pytest.mark.parametrize("count", [100, 1000])
def test_gaps_between_few_points_are_no_area(count):
    plan = np.random.default_rng(0).uniform(0, 2, (count, 2))
    plan[::2, 0] += 50
    points, sensor = flat(plan)
    found = pw.detect_planes_in_points(points, sensor)
    assert len(found) == 1
    assert found.planes[0].area == pytest.approx(8, rel=0.4 if count == 100 else 0.15)


def test_a_ring_of_few_points_has_a_hole():
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0, 2 * np.pi, 3000), rng.uniform(9.5, 10, 3000)
    plan = np.column_stack((np.cos(angle), np.sin(angle))) * radius[:, None]
    found = pw.detect_planes_in_points(*flat(plan))
    assert len(found) == 1
    assert 30 < found.planes[0].area < 45  # 30.6; a square that scatters so has 570


@pytest.mark.parametrize("count", [100, 1000, 4000])
def test_a_rectangle_of_few_points_has_the_area_of_one_that_scatters_so(count):
    plan = np.random.default_rng(count).uniform(0, 1, (count, 2)) * (3, 2)
    found = pw.detect_planes_in_points(*flat(plan))
    assert found.planes[0].area == pytest.approx(6, rel=3 / np.sqrt(count))


def test_covariance_is_the_scatter_of_the_estimates():
    found, claimed = [], []
    normal = np.array([0.0, 0.6, 0.8])
    inside = np.linalg.svd(normal[None])[2][1:]
    for seed in range(40):
        rng = np.random.default_rng(seed)
        points = rng.uniform(-1, 1, (6000, 2)) @ inside
        points += (rng.normal(0, SIGMA, 6000) - 1.5)[:, None] * normal
        model = pw.detect_planes_in_points(points, SENSOR)
        assert len(model) == 1
        found.append(model.coefficients[0])
        claimed.append(model.planes[0].covariance)
    expected = np.mean(claimed, axis=0)
    spread = np.cov(np.array(found).T)
    # What points of a cell are taken to share makes the claim the larger one, not by much.
    assert np.trace(spread) < 1.5 * np.trace(expected)
    assert np.trace(expected) < 4 * np.trace(spread)


BAD = {
    "nothing": np.empty((0, 3)),
    "two points": np.zeros((2, 3)),
    "nowhere": np.full((9, 3), np.nan),
    "all equal": np.ones((5000, 3)),
    "equal and far": np.full((5000, 3), 1e7),
    "collinear": np.outer(np.linspace(0, 1, 5000), [1.0, 2.0, 3.0]),
    "volume": np.random.default_rng(0).uniform(0, 5, (6000, 3)),
    "infinite": np.array([[np.inf, 0, 0], [0, -np.inf, 0], [0, 0, np.nan]]),
}


@pytest.mark.parametrize("name", BAD)
def test_points_that_show_no_plane_give_an_empty_model_that_says_why(name):
    found = pw.detect_planes_in_points(BAD[name], SENSOR)
    assert len(found) == 0
    assert found.note
    assert np.isfinite(found.information)
    assert not found.labels.any()
    assert found.labels.shape == (len(BAD[name]),)


def test_points_in_other_units_than_metres_are_told_so():
    rng = np.random.default_rng(0)
    wall = np.column_stack((rng.uniform(0, 4, (20_000, 2)), rng.normal(0, 0.005, 20_000)))
    sensor = pw.Sensor(max_depth=10, noise=0.005)
    found = pw.detect_planes_in_points(1000 * wall, sensor)
    assert not len(found)
    assert found.note.startswith(found.curve.reason + "; the points reach over")
    assert "range of 10 m: are they in metres?" in found.note
    assert not pw.detect_planes_in_points(wall, sensor).note


@pytest.mark.parametrize(("share", "times"), [(1.0, 2), (0.1, 10), (0.01, 100)])
def test_copies_of_points_are_no_readings(share, times):
    """Without this 95 planes of a building of 101,000 points became 132, 113 and 89."""
    points = building(20_000, seed=1).points
    points = points[np.lexsort(points.T)]  # the mask code sees the order within a least cube
    rng = np.random.default_rng(0)
    copied = np.flatnonzero(rng.uniform(size=len(points)) < share)
    rows = np.concatenate((np.arange(len(points)), np.repeat(copied, times - 1)))
    rng.shuffle(rows)
    sigma = np.full(len(points), SIGMA)
    origins = np.tile(points.mean(axis=0), (len(points), 1))
    for told in ({}, {"sigma": sigma}, {"origin": origins}):
        first = pw.detect_planes_in_points(points, SENSOR, **told)
        each = {name: values[rows] for name, values in told.items()}
        found = pw.detect_planes_in_points(points[rows], SENSOR, **each)
        assert_array_equal(found.labels, first.labels[rows])
        assert found.information == pytest.approx(first.information, rel=1e-9)
        assert [plane.count for plane in found.planes] == np.bincount(found.labels)[1:].tolist()
        assert found.readings == len(rows)


@pytest.mark.parametrize("places", [1, 2])
def test_copies_of_too_few_points_are_named_as_such(places):
    model = pw.detect_planes_in_points(np.repeat(np.eye(3)[:places], 500, axis=0), SENSOR)
    points = "1 distinct point" if places == 1 else "2 distinct points"
    assert model.note == model.curve.reason == f"{points}; 3 are needed for a plane"
    assert model.readings == 500 * places
    alone = pw.detect_planes_in_points(np.eye(3)[:places], SENSOR)
    assert alone.note == model.note.replace("distinct", "finite")


def test_places_of_points():
    """Against a NumPy oracle; rows that are not finite are no copies of each other."""
    rng = np.random.default_rng(3)
    for dtype in (np.float64, np.float32):
        points = rng.integers(0, 12, (4000, 3)).astype(dtype)
        points[::50] = np.nan
        points[7::50, 1] = np.inf
        places = places_of(points)
        there = np.isfinite(points).all(axis=1)
        different = np.unique(points[there], axis=0)
        assert len(places.rows) == len(different) + np.count_nonzero(~there)
        assert_array_equal(points[places.rows][places.of_point], points)
        assert_array_equal(places.of_point[places.rows], np.arange(len(places.rows)))
    assert places_of(rng.uniform(size=(5000, 3))) is None
    assert places_of(np.empty((0, 3))) is None


def test_bad_rows_duplicates_and_strays_leave_the_rest_alone(model):
    points = np.vstack(
        (POINTS, POINTS[:500], [[np.nan, 0, 0], [np.inf, 0, 0], [1e9, 0, 0], [0, 1e300, 0]])
    )
    found = pw.detect_planes_in_points(points, SENSOR)
    assert found.readings == len(points) - 4
    assert not found.labels[-4:].any()
    assert len(found) == len(model)
    assert matching(found.labels[: len(POINTS)], TRUTH) > 0.95


@pytest.mark.parametrize("count", [600, 12_000])
@pytest.mark.parametrize("missing", [1, 60])
def test_points_on_their_own_origin_are_no_readings(count, missing):
    """As missing returns are written; all else is as if those rows were not finite."""
    points, _ = box(count, at=(1.0, 2.0, -0.5))
    rows = np.arange(missing) * 7
    several = np.random.default_rng(0).normal(1.0, 0.5, points.shape)
    for told in ({}, {"noise": "auto"}, {"origin": (1.5, 3.0, 0.0)}, {"origin": several},
                 {"noise": 0.01, "origin": several}, {"objective": "paper"}):  # fmt: skip
        options = dict(told)
        sensor = pw.Sensor(noise=options.pop("noise", pw.noise.proportional(0.01)))
        places = np.broadcast_to(options.get("origin", np.zeros(3)), points.shape)
        given, without = points.copy(), points.copy()
        given[rows], without[rows] = places[rows], np.nan
        before = given.copy()
        found = pw.detect_planes_in_points(given, sensor, **options)
        other = pw.detect_planes_in_points(without, sensor, **options)
        assert_array_equal(given, before)
        assert found.information == other.information
        assert_array_equal(found.labels, other.labels)
        assert not found.labels[rows].any()
        assert found.readings == len(points) - missing
        assert len(found)


def test_where_noise_depends_on_no_distance_a_point_at_the_origin_is_one():
    x, y = np.meshgrid(np.arange(30) * 0.1, np.arange(30) * 0.1)
    floor = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))
    for options in ({}, {"sigma": np.full(len(floor), SIGMA)}, {"objective": "paper"}):
        assert pw.detect_planes_in_points(floor, SENSOR, **options).labels[0] == 1


@pytest.mark.parametrize("noise", [pw.noise.proportional(0.01), pw.noise.quadratic(0.01, 0.002)])
def test_noise_is_asked_for_readings_alone(noise):
    """Strays may lie where it is too large to be one."""
    sensor = pw.Sensor(noise=noise)
    strays = [[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, 1.7e308], [0, 0, -1e300], [1e12, 0, 0]]
    for count in (600, 12_000):
        points, truth = box(count, at=(1.0, 2.0, -0.5))
        for options in ({}, {"origin": (1.5, 3.0, 0.0)}):
            found = pw.detect_planes_in_points(np.vstack((points, strays)), sensor, **options)
            assert found.readings == len(points)
            assert matching(found.labels[: len(points)], truth) > 0.8


def test_few_points_that_are_wider_than_keys_reach():
    """As of millimetres that are taken for metres."""
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 20_000, (1000, 3))
    points[:500, 2] = 0
    points += rng.normal(0, 0.001, points.shape)
    found = pw.detect_planes_in_points(points, pw.Sensor(max_depth=10.0, noise=0.001))
    assert 3 <= found.readings < len(points)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma": np.ones(3)}, "sigma must hold one number a point"),
        ({"sigma": np.zeros(len(POINTS))}, "sigma must be positive"),
        ({"sigma": 1.0, "objective": "paper"}, "sigma needs objective='spatial'"),
        ({"origin": np.zeros(2)}, r"origin must be one place or one a point"),
        ({"origin": np.full(3, np.nan)}, "origin must be finite"),
        ({"origin": (0, 1e300, 0)}, r"origin must be finite \(metres, at most 1e\+09\)"),
        ({"origin": "file"}, "origin must be numbers .*, got 'file'"),
        ({"sigma": ["a"]}, "sigma must be numbers"),
        ({"sigma": np.full(len(POINTS), 1e200)}, "sigma must be positive and finite"),
        ({"sigma": np.ma.masked_less(np.ones(len(POINTS)), 2)}, "sigma must not be masked"),
        ({"origin": np.ma.masked_less(np.zeros(3), 1)}, "origin must not be masked"),
        ({"origin": np.zeros(3), "objective": "paper"}, "origin needs objective='spatial'"),
        ({"instances": True, "objective": "paper"}, "instances needs objective='spatial'"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        pw.detect_planes_in_points(POINTS, SENSOR, **options)


def test_clouds_and_arrays_are_told_apart():
    cloud = pw.PointCloud(points=POINTS)
    with pytest.raises(ValueError, match=r"of a cloud that is cloud\.points"):
        pw.detect_planes_in_points(cloud, SENSOR)
    with pytest.raises(ValueError, match=r"got ndarray; detect_planes_in_points takes arrays"):
        pw.detect_planes_in_cloud(POINTS, SENSOR)


def test_hyperplanes_have_no_spatial_objective():
    points = np.random.default_rng(0).normal(size=(100, 4))
    with pytest.raises(ValueError, match=r"shape \(k, 3\), got \(100, 4\)"):
        pw.detect_planes_in_points(points, SENSOR, objective="spatial")
    assert pw.detect_planes_in_points(points, SENSOR).objective == "paper"


def test_most_of_a_building_is_found():
    made = building(100_000, floors=1, rooms=(2, 1))
    found = pw.detect_planes_in_points(made.points, SENSOR, instances=True)
    table = np.zeros((made.labels.max() + 1, len(found) + 1))
    np.add.at(table, (made.labels, found.labels), 1)
    sizes = table.sum(axis=1)[1:]
    union = sizes[:, None] + table.sum(axis=0)[None, 1:] - table[1:, 1:]
    overlap = table[1:, 1:] / union
    assert (overlap.max(axis=1)[sizes > 150] > 0.5).mean() > 0.95
    assert (overlap.max(axis=0) > 0.5).mean() > 0.95


def test_what_does_not_pay_goes_and_what_is_worth_less_but_pays_stays():
    made = building(200_000, sigma=0.03, seed=2)
    sensor = pw.Sensor(max_depth=20.0, resolution=0.001, noise=0.03)
    found = pw.detect_planes_in_points(made.points, sensor)
    assert found.information == min(found.curve)
    moves = found.curve.moves
    assert [move.kind for move in moves] == ["agglomerate", "cut"]
    assert len(found) == moves[1].planes < moves[0].planes
    assert moves[1].information < moves[0].information


def wandering(rng, side=8.0, n=512):
    """Heights on a grid whose differences have a variance of their distance."""
    k = np.fft.fftfreq(n, side / n)
    k = np.hypot(*np.meshgrid(k, k))
    k[0, 0] = np.inf
    walk = np.fft.ifft2(np.fft.fft2(rng.normal(size=(n, n))) * k**-1.5).real
    lag = 32
    square = ((walk[:, lag : n // 2] - walk[:, : n // 2 - lag]) ** 2).mean()
    return walk / np.sqrt(square / (lag * side / n))


def test_drift_is_told_and_independent_noise_has_none():
    rng = np.random.default_rng(0)
    plan = rng.uniform(0, 4, (60_000, 2))
    at = tuple((plan.T * 64).astype(int))
    white, walk = rng.normal(0, 0.005, 60_000), wandering(rng)[at]
    sensor = pw.Sensor(max_depth=10, noise=0.005)

    def told(drift):
        points = np.column_stack((plan, white + np.sqrt(drift) * walk))
        return cells_of(cloud_of(points, sensor, None, 2)).error.drift

    assert told(0.0) < 1e-6
    assert 2e-4 < told(3e-3) < 3e-3  # a third of it: between segments it levels off
    # Walls 20 cm thick go through many cubes of 24 cm.
    made = building(200_000, sigma=0.03)
    error = cells_of(cloud_of(made.points, pw.Sensor(max_depth=20, noise=0.03), None, 2)).error
    assert error.drift < 0.02 * 0.03**2


@pytest.mark.parametrize(("count", "sigma"), [(100_000, 0.03), (500_000, 0.01)])
@pytest.mark.parametrize("turn", [(45, 35, 0), (30, 20, 10), (0, 0, 0)])
def test_a_dense_wall_that_is_thick_beside_its_cubes_is_one_plane(count, sigma, turn):
    rng = np.random.default_rng(0)
    points = np.column_stack((rng.uniform(0, 3, count), rng.uniform(0, 2, count), np.zeros(count)))
    points += rng.normal(0, sigma, points.shape)
    turned = Rotation.from_euler("xyz", turn, degrees=True)
    shift = np.array([0.013, 5.017, 0.0071])
    points = turned.apply(points) + shift
    (plane,) = pw.detect_planes_in_points(points, pw.Sensor(max_depth=8.0, noise=sigma)).planes
    normal = turned.apply([0, 0, 1])
    assert plane.count > 0.99 * count
    sign = np.sign(plane.normal @ normal)
    off = np.append(sign * plane.normal - normal, sign * plane.distance + normal @ shift)
    assert np.linalg.norm(off[:3]) < np.radians(0.03)
    covered = np.linalg.pinv(plane.covariance, rcond=1e-9, hermitian=True)
    assert off @ covered @ off < 7.8  # the 95th percentile of chi^2 with three degrees of freedom
    middle = turned.apply([1.5, 1, 0]) + shift
    assert abs(middle @ plane.normal + plane.distance) < 0.05 * sigma
    assert 6 < plane.area < 9  # some cells lie above others


@pytest.mark.parametrize("sigma", [1e-5, 1e-7, 1e-9])
def test_points_err_by_no_less_than_their_resolution(sigma):
    """Two walls, exact but for rounding: Phi is positive, and that of any smaller sigma."""
    rng = np.random.default_rng(0)
    inside, off = rng.uniform(0, 3, (12_000, 2)), rng.normal(0, sigma, 12_000)
    first = np.column_stack((inside[:6000], off[:6000]))
    points = np.vstack((first, np.column_stack((off[6000:], inside[6000:]))))
    sensor = pw.Sensor(max_depth=50.0, resolution=0.001, noise=sigma)
    model = pw.detect_planes_in_points(points, sensor)
    assert len(model) == 2
    assert model.information > 0
    each = pw.detect_planes_in_points(points, sensor, sigma=np.full(12_000, sigma))
    assert_allclose(each.information, model.information, rtol=1e-9)


def test_points_that_lie_farther_from_planes_than_told_are_said_to():
    rng = np.random.default_rng(3)
    wall = np.column_stack((rng.uniform(0, 10, (20_000, 2)), rng.normal(0, 0.05, 20_000)))
    told = pw.Sensor(max_depth=30, resolution=0.001, noise=0.004)
    model = pw.detect_planes_in_points(wall, told)
    assert len(model) == 1
    assert model.settings["sigma_factor"] == pytest.approx(0.05 / 0.004, rel=0.25)
    right = pw.detect_planes_in_points(wall, pw.Sensor(max_depth=30, resolution=0.001, noise=0.05))
    assert right.settings["sigma_factor"] == pytest.approx(1.0, abs=0.1)


def test_lines_of_two_strips_one_above_the_other_are_no_walls():
    """Lines of a strip lie along those of the other, farther above them than either errs."""
    rng, strips = np.random.default_rng(0), []
    for shift, height in ((0.0, 0.0), (0.17, 0.05)):
        x, y = np.meshgrid(np.arange(-20, 20, 0.15) + shift, np.arange(-20, 20, 0.5))
        x, z = x + rng.normal(0, 0.02, x.shape), height + rng.normal(0, 0.01, x.shape)
        strips.append(np.column_stack((x.ravel(), y.ravel(), z.ravel())))
    sensor = pw.Sensor(max_depth=100.0, resolution=0.001, noise=0.01)
    model = pw.detect_planes_in_points(np.vstack(strips), sensor)
    assert len(model) == 1
    assert (model.labels > 0).mean() > 0.99
    assert model.settings["sigma_factor"] > 2.0


def test_arrays_of_a_cloud_may_be_lists():
    cloud = pw.PointCloud(points=[[0, 0, 1], [1, 0, 1]], offset=[5, 0, 0], origins=[[0, 0, 0]])
    assert_array_equal(cloud.coordinates, [[5, 0, 1], [6, 0, 1]])
    assert cloud.origins.shape == (1, 3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"points": [[0, 0], [1]]}, "points cannot be made an array"),
        ({"points": [["a", "b", "c"]]}, r"points must be real numbers of shape \(k, 3\)"),
        ({"offset": None}, "offset must be three finite numbers, got None"),
        ({"offset": "abc"}, "offset must be numbers"),
        ({"origins": [0, 0]}, r"origins must have shape \(s, 3\)"),
        ({"intensity": [1, 2]}, r"intensity must have shape \(1,\)"),
    ],
)
def test_what_is_no_cloud_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        pw.PointCloud(**{"points": [[0.0, 0.0, 1.0]], **wrong})
