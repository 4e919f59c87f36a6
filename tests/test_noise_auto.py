"""noise="auto": what a frame says about the noise of its sensor."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import noise, scenes
from planewise.calibration.calibrate import describe_calibration
from planewise.calibration.cells import _harmonics, blurred, noise_cells
from planewise.calibration.fit import fit_polynomial
from planewise.files.camera import read_noise
from planewise.kernels import noise as kernels
from planewise.metrics.scores import evaluate

from .conftest import render

AUTO = pw.Sensor(noise="auto")
KINECT_STEP = 1 / (8 * 580 * 0.075)  # of inverse depth, as rooms have it


def estimate(scene, sensor=None):
    return pw.estimate_noise(scene.depth, scene.camera, sensor or scene.sensor)


def seen(found):
    """Depths that the frame has cells at."""
    return np.linspace(found.bins.depth[0], found.bins.depth[-1], 20)


@pytest.mark.parametrize("sigma", [0.0005, 0.001, 0.002, 0.005, 0.01])
@pytest.mark.parametrize("name", ["staircase", "corner", "t_junction"])
def test_the_papers_scenes_have_their_noise(name, sigma):
    scene = getattr(scenes, name)(sigma=sigma)
    found = estimate(scene)
    z = seen(found)
    assert_allclose(found.white(z), sigma, rtol=0.05)
    assert_allclose(found.noise(z), np.hypot(sigma, 0.001 / np.sqrt(12)), rtol=0.05)
    assert found.shared is noise.NOTHING
    assert found.drift is noise.NOTHING


@pytest.mark.parametrize("size", [(240, 320), (480, 640)])
@pytest.mark.parametrize(("power", "least", "most"), [(0, -3, 3), (1, -3, 3), (2, 0, 13)])
def test_walls_have_their_noise(size, power, least, most):
    """In 0.001 of it, more with z^2 as depths of a bin differ; and within the band."""
    scale, rng = 0.01 / 3**power, np.random.default_rng(power)
    focal = 0.8 * size[1]
    camera = pw.PinholeCamera(fx=focal, fy=focal, cx=size[1] / 2, cy=size[0] / 2)
    rays, frames = camera.rays(size), []
    for _ in range(6):
        depth = rng.uniform(2, 5) / (rays @ [*rng.uniform(-0.4, 0.4, 2), 1])
        frames.append(depth + scale * depth**power * rng.normal(size=size))
    found = pw.calibrate(frames, camera, pw.Sensor(max_depth=20, resolution=1e-4))
    bins = found.bins
    true = scale * bins.depth**power
    off = 1000 * (found.noise(bins.depth) / true - 1)
    assert (least < off).all()
    assert (off < most).all()
    assert ((bins.low < true) & (true < bins.high)).all()


@pytest.mark.parametrize("sigma", [None, 0.0005, 0.002, 0.005, 0.01])
def test_rooms_have_their_noise(sigma):
    scene = scenes.room(1, sigma=sigma, size=(240, 320))
    found = estimate(scene)
    z = seen(found)
    true, step = scene.sensor.noise(z), KINECT_STEP * z**2
    assert_allclose(found.noise(z), np.hypot(true, step / np.sqrt(12)), rtol=0.1)
    visible = true > 0.4 * step  # beyond, steps hide the white part
    assert_allclose(found.white(z)[visible], true[visible], rtol=0.1)
    assert_allclose(found.quantisation(z), step / np.sqrt(12), rtol=0.1)
    assert found.shared is noise.NOTHING


@pytest.mark.parametrize(
    "true",
    [noise.constant(0.0005), noise.constant(0.01), noise.quadratic(0.001, 0.002),
     noise.proportional(0.005), noise.KINECT],
    ids=str,
)  # fmt: skip
@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_what_the_caller_believes_does_not_matter(true, factor):
    camera = pw.PinholeCamera(fx=525, fy=525, cx=319.5, cy=239.5)
    planes = np.array([[0.0, -0.9, -0.436, 1.4], [0.5, 0.0, -0.866, 2.6], [-0.6, 0.0, -0.8, 3.2]])
    exact, _ = render(planes, camera, (480, 640))
    exact = np.minimum(exact, 4.0)
    depth = exact + true(exact) * np.random.default_rng(0).standard_normal(exact.shape)
    wrong = noise.RootSum((true,) * round(factor**2)) if factor > 1 else true.scaled(factor)
    believed = pw.Sensor(max_depth=8.0, resolution=1e-4, noise=wrong)
    auto = replace(believed, noise="auto")
    found = pw.estimate_noise(depth, camera, believed)
    z = seen(found)
    assert_allclose(found.noise(z), true(z), rtol=0.1)
    observation = pw.observe(depth, camera, auto)
    assert_allclose(observation.sigma, true(observation.depth), rtol=0.12)
    assert observation.estimate.describe() == found.describe()


@pytest.mark.parametrize("objective", ["paper", "spatial"])
@pytest.mark.parametrize("name", ["staircase", "corner"])
def test_planes_and_phi_are_those_of_the_run_that_is_told(name, objective):
    for seed in range(2):
        scene = getattr(scenes, name)(rng=seed)
        auto = replace(scene.sensor, noise="auto")
        model = pw.detect_planes(scene.depth, scene.camera, auto, objective=objective)
        told = pw.detect_planes(scene.depth, scene.camera, scene.sensor, objective=objective)
        assert len(model) == len(told) == 4
        assert model.information == pytest.approx(told.information, rel=0.02)
        assert (model.labels == told.labels).mean() > 0.98


def test_a_room_is_seen_as_by_the_run_that_is_told():
    scene = scenes.room(1, size=(240, 320))
    z_squared = KINECT_STEP / np.sqrt(12)
    whole = noise.RootSum((scene.sensor.noise, noise.quadratic(0.0, z_squared)))
    parts = noise.ErrorParts(white=scene.sensor.noise, shared=noise.NOTHING, drift=noise.NOTHING)
    for objective in ("paper", "spatial"):
        told, model = (
            pw.detect_planes(scene.depth, scene.camera, sensor, objective=objective)
            for sensor in (
                replace(scene.sensor, noise=whole, parts=parts),
                replace(scene.sensor, noise="auto"),
            )
        )
        assert model.information == pytest.approx(told.information, rel=0.02)
        accuracy, expected = (
            evaluate(each.labels, scene.labels, valid=scene.depth > 0).row()["sc_labelled"]
            for each in (model, told)
        )
        assert accuracy == pytest.approx(expected, rel=0.02)
        assert accuracy > 0.9 or objective == "paper"


@pytest.mark.parametrize("missing", [0.0, 0.1, 0.5])
def test_an_error_that_neighbours_share_is_seen(missing):
    camera = pw.PinholeCamera(fx=525, fy=525, cx=319.5, cy=239.5)
    exact, _ = render(np.array([[0.4, -0.3, -0.866, 2.0]]), camera, (480, 640))
    rng = np.random.default_rng(0)
    offsets = np.kron(rng.standard_normal((60, 80)), np.ones((8, 8)))
    depth = exact + 0.004 * rng.standard_normal(exact.shape) + 0.002 * offsets
    depth[rng.random(depth.shape) < missing] = 0
    found = pw.estimate_noise(depth, camera, AUTO)
    assert found.shared_ratio == pytest.approx(0.5, rel=0.1)
    z = seen(found)
    assert_allclose(found.white(z), 0.004, rtol=0.05)
    assert_allclose(found.shared(z), 0.004, rtol=0.1)
    assert_allclose(found.drift(z), 3.5 * found.shared(z))


@pytest.mark.parametrize("missing", [0.1, 0.5])
def test_missing_readings_are_no_shared_error(missing):
    """Centroids of cells that lack some are not in line: the plane leans between them."""
    camera = pw.PinholeCamera(fx=525, fy=525, cx=319.5, cy=239.5)
    exact, _ = render(np.array([[0.6, -0.5, -0.625, 2.0]]), camera, (480, 640))
    rng = np.random.default_rng(0)
    depth = exact + 0.0005 * rng.standard_normal(exact.shape)
    depth[rng.random(depth.shape) < missing] = 0
    assert pw.estimate_noise(depth, camera, AUTO).shared_ratio < 0.04


def test_what_too_few_cells_share_is_not_told(camera, tmp_path):
    """It is not 0, and binds no frame."""
    wall = np.zeros((48, 64))
    wall[:24, :24] = 2 + 0.004 * np.random.default_rng(0).standard_normal((24, 24))
    found = pw.calibrate([wall], camera, pw.Sensor())
    assert np.isnan(found.shared_ratio)
    assert not found.bounds
    assert "too few flat cells lie in a row" in found.caution
    pw.sensors.save(
        found.sensor(pw.Sensor()), tmp_path / "s.json", calibration=describe_calibration(found)
    )
    assert json.loads((tmp_path / "s.json").read_text())["calibration"]["shared_ratio"] is None


def sweep_of_a_room(columns):
    """A sweep of 64 beams in a room of 8 x 6 x 3 metres, and its ranges."""
    camera = pw.SphericalCamera.spinning(elevation=np.linspace(20, -20, 64), columns=columns)
    rays = camera.rays((64, columns))
    faces = np.abs(rays) / np.linalg.norm(rays, axis=-1, keepdims=True) / (4.0, 3.0, 1.5)
    return camera, 1 / faces.max(axis=-1)


@pytest.mark.parametrize("ratio", [0.0, 1.0])
def test_an_error_that_neighbours_of_a_sweep_share_is_seen(ratio):
    """Off the axis of its sector a ray is longer than z, by which inverse depth errs."""
    camera, exact = sweep_of_a_room(1024)
    rng = np.random.default_rng(0)
    shared = np.kron(rng.standard_normal((16, 256)), np.ones((4, 4)))
    depth = exact + 0.01 * (rng.standard_normal(exact.shape) + ratio * shared)
    found = pw.estimate_noise(depth, camera, AUTO)
    assert_allclose(found.white(seen(found)), 0.01, rtol=0.05)
    assert found.shared_ratio == pytest.approx(ratio, abs=0.05)


@pytest.mark.parametrize("columns", [48, 98])
def test_cells_of_different_sectors_are_not_in_a_row(columns):
    """Coordinates start anew in each, so that of three cells two may have the same."""
    camera, exact = sweep_of_a_room(columns)
    depth = exact + 0.01 * np.random.default_rng(0).standard_normal(exact.shape)
    assert pw.estimate_noise(depth, camera, AUTO).shared_ratio < 0.2


def test_real_kinects_are_near_what_was_measured_by_hand(real_frames):
    for folder, name in (("nyu_dpd", "nyu_0342"), ("mosd_boxes", "learn11")):
        depth, camera, scale = real_frames(folder, name)
        found = pw.estimate_noise(depth, camera, pw.sensors.KINECT_V1, depth_scale=scale)
        z = np.median(found.bins.depth)
        for part in ("white", "shared", "drift"):
            ratio = getattr(found, part)(z) / getattr(noise.KINECT_PARTS, part)(z)
            assert 1 / 2.5 < ratio < 2.5


@pytest.mark.parametrize("value", [0.0, np.nan, 2.0, 2000.0])
def test_frames_that_cannot_tell(camera, value):
    depth = np.full((48, 64), value)
    model = pw.detect_planes(depth, camera, AUTO)
    recorded = model.settings["noise"]
    if value == 2.0:
        # No noise at all: a reading is never better than the sensor's resolution.
        assert recorded["source"] == "estimated"
        assert pw.estimate_noise(depth, camera, AUTO).noise(2.0) == pytest.approx(
            0.001 / np.sqrt(12), rel=1e-3
        )
        assert len(model) == 1
    else:
        assert recorded["source"] == "assumed"
        assert "0 flat cells" in recorded["note"]
        assert len(model) == 0


def test_what_is_assumed_is_the_preset_or_one_percent(camera):
    rough = np.random.default_rng(0).uniform(0.1, 10, (48, 64))
    found = pw.estimate_noise(rough, camera, AUTO)
    assert_allclose(found.noise([1.0, 3.0]), [0.01, 0.03])
    assert found.note.endswith("0.01 z m was assumed")
    kinect = replace(pw.sensors.KINECT_V1, noise="auto")
    found = pw.estimate_noise(rough, camera, kinect)
    assert found.parts.white is noise.KINECT_PARTS.white
    assert found.parts.drift is noise.KINECT_PARTS.drift
    for objective in ("paper", "spatial"):
        assert len(pw.detect_planes(rough, camera, AUTO, objective=objective)) == 0


@pytest.mark.parametrize("apart", [(4, 4), (8, 8), (8, 1)])
def test_noise_of_readings_on_every_nth_pixel_is_estimated(apart):
    """Wider cells hold as many of them as cells of a full frame do."""
    scene = scenes.corner(sigma=0.004)
    thin = np.zeros_like(scene.depth)
    some = (slice(None, None, apart[0]), slice(None, None, apart[1]))
    thin[some] = scene.depth[some]
    found = pw.estimate_noise(thin, scene.camera, AUTO)
    assert not found.note
    assert_allclose(found.white(seen(found)), 0.004, rtol=0.05)
    if apart == (4, 4):
        model = pw.detect_planes(thin, scene.camera, AUTO)
        assert (len(model), model.note) == (4, "")


def test_a_noise_that_was_assumed_is_in_the_note():
    camera, said = pw.PinholeCamera(fx=250, fy=250, cx=240, cy=200), "noise: 9 flat cells, too few"
    wall = np.zeros((400, 480))
    wall[:24, :24] = np.random.default_rng(0).normal(2.0, 0.002, (24, 24))
    model = pw.detect_planes(wall, camera, AUTO, objective="paper")
    assert len(model) == 1
    assert model.note.startswith(said)
    assert model.note.endswith("sigma = 0.01 z m was assumed; where that is wrong, so are planes")
    model = pw.detect_planes(wall, camera, AUTO)
    assert model.note.startswith("no plane saves more than it costs; ")
    assert f"; {said}" in model.note
    empty = pw.detect_planes(np.zeros((400, 480)), camera, AUTO)
    assert empty.note.startswith("0 valid readings; 3 are needed for a plane; noise: 0 flat cells")
    wall[:24, 8:24] += 1.0
    model = pw.detect_planes(wall, camera, AUTO, objective="paper")
    assert len(model) == 2
    assert model.top(1).note == model.note != ""


@pytest.mark.parametrize("sigma", [0.0, 1e-5, 1e-4])
def test_noise_below_the_steps_is_not_zero(sigma):
    scene = scenes.corner(sigma=sigma, size=(240, 320))
    found = estimate(scene)
    z = seen(found)
    assert (found.white(z) > 0).all()
    assert (found.noise(z) >= 0.99 * 0.001 / np.sqrt(12)).all()


def test_edges_clutter_and_curves_do_not_count():
    scene = scenes.staircase(sigma=0.003)
    depth = scene.depth.astype(float) / 1000
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:480, :640]
    for _ in range(60):  # spheres
        cy, cx, r = rng.uniform(0, 480), rng.uniform(0, 640), rng.uniform(10, 40)
        inside = (y - cy) ** 2 + (x - cx) ** 2 < r**2
        depth[inside] -= 0.3 * np.sqrt(1 - ((y - cy) ** 2 + (x - cx) ** 2)[inside] / r**2)
    found = pw.estimate_noise(depth, scene.camera, scene.sensor)
    z = np.linspace(1.05, 1.3, 5)
    assert_allclose(found.white(z), 0.003, rtol=0.1)


def test_the_estimate_is_recorded_and_repeatable():
    scene = scenes.corner(size=(240, 320))
    before = scene.depth.copy()
    scene.depth.flags.writeable = False
    detector = pw.Detector(scene.camera, AUTO, objective="spatial")
    first, second = detector(scene.depth), detector(scene.depth)
    assert first.settings == second.settings
    assert first.information == second.information
    assert first.settings["noise"]["noise"].startswith("sqrt((0.00")
    assert_array_equal(scene.depth, before)
    a, b = estimate(scene), estimate(scene)
    assert_array_equal(a.bins.low, b.bins.low)
    assert (a.bins.low <= a.bins.high).all()
    assert not np.isfinite(pw.observe(scene.depth, scene.camera, AUTO).estimate.bins.low).any()


def test_without_a_depth_image_there_is_no_estimate():
    with pytest.raises(ValueError, match=r"needs a depth image or points.*noise=0.005"):
        pw.detect_planes_in_points(np.ones((9, 2)), AUTO)
    with pytest.raises(ValueError, match="estimated from a depth image"):
        AUTO.sigma([1.0])
    with pytest.raises(ValueError, match="or 'auto', got 'automatic'"):
        pw.Sensor(noise="automatic")
    said = AUTO.describe()
    assert (said["noise"], said["parts"]) == ("auto", "estimated with the noise")


@pytest.mark.parametrize("shape", [(2, 2), (5, 7), (48, 65), (3, 200)])
def test_any_image_size(shape):
    camera = pw.PinholeCamera(fx=100, fy=100, cx=shape[1] / 2, cy=shape[0] / 2)
    depth = 2.0 + np.random.default_rng(0).normal(0, 0.002, shape)
    for objective in ("paper", "spatial"):
        model = pw.detect_planes(depth, camera, AUTO, objective=objective)
        assert model.labels.shape == shape


@settings(max_examples=10)
@given(scale=st.floats(0.2, 5.0))
def test_a_scene_twice_as_large_has_twice_the_noise(scale):
    camera = pw.PinholeCamera(fx=120, fy=120, cx=79.5, cy=59.5)
    exact, _ = render(np.array([[0.4, -0.3, -0.866, 1.5]]), camera, (120, 160))
    depth = exact + 0.004 * np.random.default_rng(0).standard_normal(exact.shape)
    one, other = (
        pw.estimate_noise(s * depth, camera, pw.Sensor(max_depth=50, resolution=1e-6))
        for s in (1.0, scale)
    )
    z = np.linspace(depth.min(), depth.max(), 5)
    assert_allclose(other.white(scale * z), scale * one.white(z), rtol=0.1)


def test_cell_planes_are_least_squares():
    rng = np.random.default_rng(0)
    index = np.sort(rng.choice(20 * 24, 400, replace=False))
    rays = np.vstack((rng.uniform(-0.5, 0.5, (2, 400)), np.ones(400)))
    z = rng.uniform(1, 2, 400)
    planes = np.empty((3 * 3, kernels.PLANE))
    sums = np.empty((9, kernels.SUMS))
    kernels.cell_planes(index, z, rays, np.array([90.0, 80.0]), 24, 8, 3, sums, planes)
    cell = (index // 24) // 8 * 3 + (index % 24) // 8
    for c, row in enumerate(planes):
        mine = cell == c
        x, y, w = 90 * rays[0, mine], 80 * rays[1, mine], 1 / z[mine]
        assert_allclose(row[:4], [mine.sum(), x.mean(), y.mean(), w.mean()])
        matrix = np.column_stack((np.ones(mine.sum()), x - x.mean(), y - y.mean()))
        size, square, *_ = np.linalg.lstsq(matrix, w, rcond=None)
        assert_allclose(row[4:], [*size[1:], square[0]], rtol=1e-9)


def test_cells_of_few_readings_have_no_plane():
    rays = np.vstack((np.linspace(0, 1, 5), np.zeros(5), np.ones(5)))  # all in one line
    planes, sums = np.empty((1, kernels.PLANE)), np.empty((1, kernels.SUMS))
    kernels.cell_planes(np.arange(5), np.ones(5), rays, np.ones(2), 8, 8, 1, sums, planes)
    assert planes[0, 0] == 5
    assert np.isnan(planes[0, 1:]).all()


def test_rounding_is_followed_by_flat_cells_only():
    """The expected variance about a fit, against readings that are drawn and rounded."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:8, :8] - 3.5
    design = np.column_stack((np.ones(64), x.ravel(), y.ravel()))
    project = np.eye(64) - design @ np.linalg.pinv(design)
    step = 0.01
    for sigma, slope in ((0.003, 0.0), (0.003, 0.01), (0.005, 0.0), (0.001, 0.013)):
        true = slope * x.ravel() + rng.uniform(0, step, (4000, 1))
        noisy = true + sigma * rng.standard_normal((4000, 64))
        rounded = step * np.round(noisy / step)
        drawn = float(((rounded @ project) ** 2).sum(axis=1).mean() / 61)
        crossed = np.array([[slope * 8 / step], [0.0]])
        followed, _ = _harmonics(crossed, np.array([True]))
        expected = sigma**2 + step**2 / 12 - step**2 * float(followed[0] @ blurred(sigma / step))
        assert expected == pytest.approx(drawn, rel=0.08)


def test_unquantised_readings_have_no_step(camera):
    depth = np.random.default_rng(0).normal(1, 0.001, (48, 64)) * np.linspace(1, 3, 64)
    assert (noise_cells(pw.observe(depth, camera, pw.Sensor())).step == 0).all()


def test_one_odd_point_does_not_bend_a_curve():
    z = np.linspace(1, 4, 9)
    sigma = 0.002 * z**2
    sigma[-1] = 1e-4
    curve = fit_polynomial(z, sigma, np.full(9, 0.02))
    assert_allclose(curve(z[:-1]), sigma[:-1], rtol=0.1)


@pytest.mark.parametrize("apart", [0.0, 0.001])  # a wall in one bin, or where two bins meet
@pytest.mark.parametrize("seed", range(8))
def test_noise_at_one_depth_is_constant(apart, seed):
    z = 1.2 + apart * np.arange(2 if apart else 1)
    sigma = 0.004 + 1e-5 * np.random.default_rng(seed).standard_normal(z.size)
    curve = fit_polynomial(z, sigma, np.full(z.size, 0.02))
    assert curve == noise.constant(curve.constant)


@pytest.mark.parametrize("unit", [1e-6, 2e-5, 1e-3])  # metres
@pytest.mark.parametrize("whole", [False, True])
def test_noise_is_seen_at_the_resolution_of_any_sensor(unit, whole):
    """Of a scanner that sees micrometres, and of cameras, in a plate as far as it is wide."""
    camera = pw.PinholeCamera(fx=400, fy=400, cx=159.5, cy=119.5)
    exact, _ = render(np.array([[0.1, 0.05, -1.0, 4000.0]]), camera, (240, 320))
    noisy = np.round(exact + 5 * np.random.default_rng(0).standard_normal(exact.shape))
    depth = noisy.astype(np.uint16) if whole else noisy * unit
    sensor = pw.Sensor(max_depth=5000 * unit, resolution=unit)
    found = pw.estimate_noise(depth, camera, sensor)
    assert_allclose(found.bins.step, unit)
    z = seen(found)
    assert_allclose(found.white(z), 5 * unit, rtol=0.02)


@pytest.mark.parametrize("power", [2.5, 3.0])
def test_noise_does_not_grow_towards_the_camera(power, tmp_path):
    """Of frames of far places, whose noise grows faster than the square of depth."""
    z = np.geomspace(3, 9, 7)
    curve = fit_polynomial(z, 0.001 * z**power, np.full(7, 0.02))
    near = np.linspace(0.1, 3.0, 30)
    assert (np.diff(curve(near)) >= 0).all()
    pw.sensors.save(pw.Sensor(noise=curve), tmp_path / "far.json")
    assert_array_equal(pw.sensors.load(tmp_path / "far.json").sigma(near), curve(near))
    assert_allclose(read_noise(str(curve))(near), curve(near), rtol=1e-4)


def test_sums_of_noise_and_no_noise():
    both = noise.RootSum((noise.constant(0.003), noise.proportional(0.004)))
    assert str(both) == "sqrt((0.003)^2 + (0.004 z)^2) m"
    assert_allclose(both([1.0]), [0.005])
    assert str(noise.NOTHING) == "0 m"
    assert_allclose(noise.NOTHING([1.0, 2.0]), 0)
    with pytest.raises(ValueError, match="at least one part"):
        noise.RootSum(())


@pytest.mark.parametrize("wrong", ["a", None, -1])
def test_seeds_are_checked(camera, wrong):
    depth, sensor = np.full((48, 64), 2.0), pw.Sensor()
    for call in (
        lambda: pw.estimate_noise(depth, camera, sensor, rng=wrong),
        lambda: pw.calibrate([depth], camera, sensor, rng=wrong),
        lambda: scenes.corner(rng=wrong),
        lambda: scenes.room(wrong),
        lambda: scenes.street(wrong),
    ):
        with pytest.raises(ValueError, match=r"(rng|seed) must be a seed, not negative, or a"):
            call()


def test_readings_very_far_away_need_no_memory_of_their_own(camera):
    """As of millimetres that are taken for metres, by a sensor that sees very far."""
    depth = np.random.default_rng(0).normal(2e8, 1e5, (48, 64))
    assert pw.estimate_noise(depth, camera, pw.Sensor(max_depth=1e9)).frames == 1


def test_a_caller_may_want_all_errors_of_numbers_raised():
    room = scenes.room(0, size=(240, 320))
    with np.errstate(all="raise"):
        found = pw.estimate_noise(room.depth, room.camera, pw.Sensor())
        assert pw.detect_planes(room.depth, room.camera, pw.Sensor(noise="auto")).planes
        pw.calibrate([room.depth, room.depth], room.camera, pw.Sensor())
    assert found.describe()["source"] == "estimated"
