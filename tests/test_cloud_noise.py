"""noise="auto" for clouds: what points say about their own noise."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.building import building
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import planewise as pw
from planewise import scenes
from planewise.clouds import noise as estimates
from planewise.clouds import order as cloud_order
from planewise.clouds.depth_steps import Rounding
from planewise.detect_in_cloud import detect_planes_in_cloud
from planewise.kernels import cloud_noise as kernels
from planewise.kernels import cloud_rows as rows
from planewise.metrics import evaluate

AUTO = pw.Sensor(max_depth=20.0, resolution=0.001, noise="auto")
SIZE, ORIGIN = np.array([20.0, 8.0, 4.0]), np.array([2.0, 3.0, 1.5])


def hall(count, sigma, seed=0):
    """Points on the walls of a hall as a scanner in it sees them, sigma(range) along the rays."""
    rng = np.random.default_rng(seed)
    rays = rng.normal(size=(count, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    ranges = np.where(rays > 0, (SIZE - ORIGIN) / rays, -ORIGIN / rays).min(axis=1)
    return ORIGIN + rays * (ranges + rng.normal(size=count) * sigma(ranges))[:, None]


def told(points, sensor=AUTO, **options):
    return pw.estimate_cloud_noise(points, sensor, **options)


@pytest.mark.parametrize("sigma", [0.002, 0.01, 0.03])
def test_noise_of_buildings_is_right_within_a_tenth(sigma):
    for seed in range(2):
        found = told(building(200_000, sigma=sigma, seed=seed).points)
        assert found.noise.constant == pytest.approx(sigma, rel=0.05)
        assert found.noise.linear == found.noise.quadratic == 0
        assert found.side > 8 * sigma
        assert not found.note


def test_crowns_of_trees_do_not_count():
    """Half of the points are on the ground, half fill space, whose layers pay for larger noise."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(-30, 30, (400_000, 2))
    ground = np.column_stack((xy, 0.02 * xy[:, 0] + rng.normal(0, 0.02, len(xy))))
    trees = np.column_stack((rng.uniform(-30, 30, (60, 2)), np.full(60, 6.0)))
    crowns = trees[rng.integers(0, 60, len(xy))] + rng.normal(0, 1.5, ground.shape)
    points, sensor = np.vstack((ground, crowns)), replace(AUTO, max_depth=100.0)
    assert told(points, sensor).noise.constant == pytest.approx(0.02, rel=0.05)


def kinect_points(seed=0, every=2):
    """Points of a synthetic Kinect image in the frame of its camera, and their labels."""
    scene = scenes.room(seed)
    depth = scene.depth * scene.sensor.resolution
    points = (scene.camera.rays(depth.shape) * depth[..., None])[::every, ::every]
    there = points[..., 2] > 0
    return points[there], scene.labels[::every, ::every][there]


@pytest.mark.parametrize("every", [1, 2, 4])
def test_steps_of_depth_are_no_surfaces(every):
    points, labels = kinect_points(every=every)
    found = told(points, replace(AUTO, max_depth=10.0))
    z = np.array([1.5, 2.0, 3.0])
    step = 0.00287 * z**2
    assert_allclose(found.noise(z), np.hypot(pw.noise.KINECT(z), step / np.sqrt(12)), rtol=0.3)
    model = pw.detect_planes_in_points(points, replace(AUTO, max_depth=10.0), as_image=False)
    assert 6 <= len(model) <= 14
    assert evaluate(model.labels[None], labels[None]).row()["f1@0.5"] > 0.4


def test_walls_as_thick_as_cubes_are_wide_are_planes():
    points, labels = kinect_points(every=1)
    thick = pw.noise.RootSum(
        (pw.noise.KINECT, pw.noise.quadratic(0.0, 0.00287 / np.sqrt(12)))  # and of steps
    )
    model = pw.detect_planes_in_points(points, pw.Sensor(max_depth=10.0, noise=thick))
    for wall in (1, 2):
        mine = labels == wall
        assert mine.sum() > 90_000
        best = np.bincount(model.labels[mine])[1:].argmax() + 1
        found = model.labels == best
        assert (mine & found).sum() > 0.9 * (mine | found).sum()


def test_even_steps_of_a_depth_image_are_known_by_its_pixels():
    scene = scenes.room(0)
    depth = np.round(scene.depth * scene.sensor.resolution / 0.04) * 0.04  # as if of 8 bits
    points = (scene.camera.rays(depth.shape) * depth[..., None])[depth > 0]
    rounding = Rounding.of(points, 0.001)
    assert rounding.has_steps
    assert_allclose(np.median(rounding.variances), 0.04**2 / 12, rtol=1e-6)
    off = points + np.random.default_rng(0).normal(0, 0.01, points.shape) * [1, 1, 0]
    assert not Rounding.of(off, 0.001).has_steps


def test_the_axis_and_the_order_of_a_depth_image_do_not_matter():
    points, _ = kinect_points(every=4)
    noise = told(points).noise
    rng = np.random.default_rng(0)
    turned = (points @ np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]))[
        rng.permutation(len(points))
    ]
    assert_allclose(told(turned).noise([1.0, 3.0]), noise([1.0, 3.0]), rtol=0.25)


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_coordinates_that_were_rounded_tell_no_less_noise_than_that(step):
    """Slices of a wall that leans against the axes are as flat as if there were none."""
    points = building(60_000, sigma=0.002, floors=1, rooms=(1, 1)).points
    turned = points @ Rotation.from_euler("z", 20, degrees=True).as_matrix().T
    rounded = np.round(turned / step) * step + (100.0, -200.0, 0.5 * step)
    for kind in (np.float64, np.float32):
        found = told(rounded.astype(kind)).noise.constant
        assert 0.99 * step / 12**0.5 < found < 1.15 * np.hypot(0.002, step / 12**0.5)
    true = len(pw.detect_planes_in_points(turned, AUTO))
    assert len(pw.detect_planes_in_points(rounded, AUTO)) >= 0.8 * true
    assert told(turned).noise.constant == pytest.approx(0.002, rel=0.05)


def test_what_is_no_depth_image_has_no_steps():
    points, _ = kinect_points(every=4)
    rng = np.random.default_rng(0)
    assert Rounding.of(points, 0.001).has_steps
    assert Rounding.of(points, 0.001, np.zeros(3)).has_steps
    x, y = np.meshgrid(np.arange(5, 6, 0.005), np.arange(-0.5, 0.5, 0.005))
    lattice = np.stack((x, y, rng.normal(0, 0.01, x.shape)), axis=-1).reshape(-1, 3)
    lines = lattice + rng.uniform(0, 0.005, lattice.shape) * [0, 1, 1]
    quarter = np.radians(45)
    turned = points @ [[1, 0, 0], [0, np.cos(quarter), np.sin(quarter)],
                       [0, -np.sin(quarter), np.cos(quarter)]]  # fmt: skip
    behind, aside = points - np.array([0, 0, 2.0]), points + np.array([9.0, 0, 0])
    sphere = hall(20_000, lambda z: 0.01 + 0 * z)
    rounded = np.round(points, 2)
    for cloud in (lattice, lines, turned, behind, aside, rounded, sphere, points[:0],
                  1e15 * points):  # fmt: skip
        assert not Rounding.of(cloud, 0.001).has_steps
    assert not Rounding.of(points, 0.001, np.array([0.0, 0, 1])).has_steps


def test_few_points_tell_their_noise_too():
    ratios = []
    for count in (200, 500, 2000):
        for seed in range(4):
            rng = np.random.default_rng(seed)
            plan = rng.uniform(-4, 4, (count, 2))
            height = 5 - 0.6 * np.abs(plan).max(axis=1)
            points = np.column_stack((plan, height + rng.normal(0, 0.04, count)))
            found = told(points, replace(AUTO, resolution=0.01)).noise.constant
            ratios.append(found / (0.04 / np.hypot(1, 0.6)))
    assert np.mean(ratios) == pytest.approx(1, abs=0.06)
    assert np.abs(np.array(ratios) - 1).max() < 0.25


@pytest.mark.parametrize("count", [60, 100])
def test_noise_of_a_face_of_few_points_is_assumed_by_its_residuals(count):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        face = np.column_stack((rng.uniform(0, 3, (count, 2)), rng.normal(5, 0.01, count)))
        noise = told(face)
        assert noise.noise.constant == pytest.approx(0.01, rel=0.3)
        assert noise.note.endswith(", by the planes they lie on")
        assert len(pw.detect_planes_in_points(face, AUTO)) == 1


def test_where_few_points_lie_on_no_planes_no_more_noise_is_assumed():
    bush = np.random.default_rng(0).normal(0, 0.5, (1000, 3))
    assert told(bush).note.startswith("too few points lie on something flat")


def test_the_search_uses_what_was_told_and_says_so():
    made = building(60_000, floors=1, rooms=(2, 1))
    found = pw.detect_planes_in_points(made.points, AUTO)
    noise = found.settings["noise"]
    assert noise["source"] == "estimated"
    estimate = told(made.points)
    assert noise == estimate.describe()
    assert noise["noise"] == str(estimate.noise)
    by_hand = pw.detect_planes_in_points(made.points, estimate.sensor(AUTO))
    assert_array_equal(found.labels, by_hand.labels)
    assert found.information == by_hand.information
    tiled = detect_planes_in_cloud(pw.PointCloud(points=made.points), AUTO, tile_points=20_000)
    assert_array_equal(found.labels, tiled.labels)
    assert tiled.settings["noise"] == noise
    paper = pw.detect_planes_in_points(made.points[:3000], AUTO, objective="paper")
    assert paper.settings["noise"]["source"] == "estimated"
    one_each = pw.detect_planes_in_points(
        made.points, AUTO, sigma=np.full(len(made.points), estimate.noise.constant)
    )
    assert_array_equal(found.labels, one_each.labels)
    assert "noise" not in one_each.settings


def test_threads_order_copies_and_origin_of_coordinates_do_not_matter():
    points = building(60_000, floors=1).points
    first = told(points, threads=1)
    assert told(points, threads=3) == first
    order = np.random.default_rng(0).permutation(len(points))
    assert told(points[order]).noise.constant == pytest.approx(first.noise.constant, rel=1e-6)
    copies = told(np.vstack((points, points, points[:100])))
    assert copies.noise.constant == pytest.approx(first.noise.constant, rel=1e-6)
    moved = told(points + np.array([592_000.0, 6_740_000.0, 30.0]))
    assert moved.noise.constant == pytest.approx(first.noise.constant, rel=0.01)


@pytest.mark.parametrize(
    "sigma",
    [lambda r: 0 * r + 0.01, lambda r: 0.002 * r, lambda r: 0.002 + 0.0005 * r**2],
    ids=["constant", "linear", "quadratic"],
)
def test_noise_along_rays_is_a_function_of_the_range(sigma):
    points, ranges = hall(100_000, sigma), np.array([3.0, 6.0, 12.0])
    found = told(points, origin=ORIGIN).noise
    assert_allclose(found(ranges), sigma(ranges), rtol=0.1)
    each = told(points, origin=np.tile(ORIGIN, (len(points), 1))).noise
    assert_allclose(each(ranges), found(ranges), rtol=1e-6)


def test_of_many_points_some_parts_of_space_stand_for_all(monkeypatch):
    points = building(200_000).points
    monkeypatch.setattr(estimates, "_MOST", 40_000)
    monkeypatch.setattr(estimates, "_BLOCK", 1000)
    monkeypatch.setattr(cloud_order, "_BLOCK", 30_000)
    seen = []
    grids = estimates._grids
    monkeypatch.setattr(
        estimates, "_grids", lambda points, *rest: seen.append(len(points)) or grids(points, *rest)
    )
    assert told(points).noise.constant == pytest.approx(0.01, rel=0.05)
    assert 20_000 < seen[0] < 50_000


@pytest.mark.parametrize("turn", [0, 1, 2])
def test_a_wall_of_very_many_points_that_fill_cubes(turn):
    rng = np.random.default_rng(turn)
    wall = np.column_stack((rng.uniform(0, 3, (1_000_000, 2)), rng.normal(0, 0.03, 1_000_000)))
    points = wall @ np.linalg.qr(rng.normal(size=(3, 3)))[0] if turn else wall
    found = told(points, AUTO)
    assert 0.5 < found.noise.constant / 0.03 < 1.1
    assert len(pw.detect_planes_in_points(points, AUTO)) <= 5


def test_where_most_is_rougher_than_what_is_quiet_phi_decides():
    rng = np.random.default_rng(0)
    sheets = []
    for k in range(4):  # one is calm, the others err ten times as much
        count = 20_000 if k else 12_000
        across = 4.0 * k + rng.normal(0, 0.03 if k else 0.003, count)
        sheets.append(np.column_stack((rng.uniform(0, 6, (count, 2)), across)))
    found = told(np.vstack(sheets))
    assert 0.015 < found.noise.constant < 0.05


def facade_and_ground(distance, share, sigma, count=60_000):
    """Ground before a facade that holds a share of the points, and where a scanner stands on it."""
    rng, wall = np.random.default_rng(0), int(share * count)
    place = np.array([0.0, -distance, 1.7])
    points = rng.uniform((-15, 2 - distance, 0), (15, 0, 10), (count, 3))
    points[:wall, 1], points[wall:, 2] = 0.0, 0.0
    rays = points - place
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return points + rays * rng.normal(0, sigma, (count, 1)), np.arange(count) < wall


@pytest.mark.parametrize(
    ("distance", "share", "sigma"), [(30, 0.5, 0.002), (60, 0.5, 0.01), (15, 0.3, 0.002)]
)
def test_a_facade_errs_by_more_than_the_ground_that_a_scanner_grazes(distance, share, sigma):
    points, wall = facade_and_ground(distance, share, sigma)
    model = pw.detect_planes_in_points(points, replace(AUTO, max_depth=90.0))
    assert len(model) == 2
    for mine in (wall, ~wall):
        assert (model.labels[mine] > 0).mean() > 0.99


def test_planes_confirm_no_noise_where_what_they_leave_is_flat():
    rng = np.random.default_rng(0)
    calm, loud = (
        np.column_stack((rng.uniform(0, 6, (20_000, 2)), at + rng.normal(0, sigma, 20_000)))
        for at, sigma in ((0.0, 0.004), (4.0, 0.04))
    )
    points = np.vstack((calm, loud))
    assert told(points).noise.constant > 0.015
    assert len(pw.detect_planes_in_points(points, AUTO)) == 2


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 3)),
        np.full((20, 3), np.nan),
        np.ones((5000, 3)),
        np.outer(np.linspace(0, 1, 5000), [1.0, 2.0, 3.0]),
        np.random.default_rng(0).uniform(0, 5, (40, 3)),
    ],
    ids=["none", "nowhere", "equal", "collinear", "few"],
)
def test_points_that_do_not_tell(points):
    found = told(points)
    assert "assumed" in found.note
    assert found.describe()["source"] == "assumed"
    model = pw.detect_planes_in_points(points, AUTO)
    assert len(model) == 0
    assert model.note.endswith(f"; noise: {found.note}; where that is wrong, so are planes")


def test_points_without_noise_have_that_of_their_rounding():
    rng = np.random.default_rng(0)
    wall = np.column_stack((rng.uniform(0, 3, (20_000, 2)), np.zeros(20_000)))
    assert told(wall).noise.constant == pytest.approx(0.001 / np.sqrt(12))


def test_wrong_arguments():
    with pytest.raises(ValueError, match=r"shape \(k, 3\), .* got shape \(5, 4\)"):
        told(np.zeros((5, 4)))
    with pytest.raises(ValueError, match=r"points of shape \(k, 3\), got \(50, 4\)"):
        pw.detect_planes_in_points(np.zeros((50, 4)), AUTO)
    with pytest.raises(ValueError, match="origin must be one place"):
        told(np.zeros((5, 3)), origin=(0, 0))
    with pytest.raises(ValueError, match=r"sensor must be a planewise\.Sensor"):
        pw.estimate_cloud_noise(np.zeros((5, 3)), None)
    for wrong in ("a", 1.5, True, 0, -1):
        with pytest.raises(ValueError, match="threads must be a whole number of at least 1, got"):
            told(np.zeros((5, 3)), threads=wrong)


def test_flat_cubes_are_those_of_plain_numpy():
    rng = np.random.default_rng(1)
    nodes, expected, origin = np.zeros((40, rows.ROW)), [], np.array([0.0, 0.0, 5.0])
    for k in range(40):
        count = int(rng.integers(4, 30))
        points = rng.uniform(-1, 1, (count, 3)) * rng.uniform(0, [1, 1, 0.3]) + rng.normal(size=3)
        centre = points.mean(axis=0)
        scatter = (points - centre).T @ (points - centre)
        nodes[k, rows.WEIGHT] = nodes[k, rows.COUNT] = count
        nodes[k, rows.CX : rows.CZ + 1] = centre
        nodes[k, rows.XX : rows.ZZ + 1] = scatter[np.triu_indices(3)]
        values, axes = np.linalg.eigh(scatter)
        variance = values[0] / (count - 3) if count > 3 else np.inf
        ray = centre - origin
        square = (axes[:, 0] @ ray) ** 2 / (ray @ ray)
        if count < 8 or values[1] <= 0.15 * values[2] or variance > 0.06 * values[1]:
            continue
        if square > 0.1:
            expected.append((variance / square, count - 3, np.linalg.norm(ray)))
    out = np.empty((40, 3))
    found = kernels.flat_cubes(nodes, origin[None], (8.0, 0.15, 0.06, 0.1), out)
    assert 3 < found < 40
    assert_allclose(out[:found], expected, rtol=1e-5)
