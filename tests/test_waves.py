"""Errors that come again along range, depth or disparity: found, taken off, calibrated, kept."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import scenes, sensors
from planewise.errors import PlanewiseError
from planewise.kernels import waves as kernels
from planewise.metrics import evaluate
from planewise.spatial.frame import frame_of
from planewise.spatial.tame_frame import bends_of as bends_of_frame
from planewise.spatial.tame_frame import tame_frame
from planewise.waves import ALONG, Wave, Waves
from planewise.waves.bends import Bends
from planewise.waves.search import waves_of

from .command import run
from .conftest import render
from .test_other_sensors import CAMERA, CORNER, SHAPE

SENSOR = pw.Sensor(max_depth=10, noise=0.002)
ERRORS = {
    "range": Waves("range", [Wave(0.5, 0.004, 0.7)]),
    "depth": Waves("depth", [Wave(0.4, 0.003, -2.0)]),
    "disparity": Waves("disparity", [Wave(0.025, 0.001, 1.0)]),
}


@pytest.fixture(scope="module")
def corner():
    """Floor and two walls without any error, and which is where."""
    return render(CORNER, CAMERA, SHAPE)


def stretch():
    return np.linalg.norm(CAMERA.ray_rows(SHAPE), axis=0).reshape(SHAPE)


def read(z, waves, sigma=0.002, seed=0):
    """Depth as a sensor with these waves and white noise reads it."""
    noise = sigma * np.random.default_rng(seed).standard_normal(z.shape)
    if waves.along == "disparity":
        return 1 / (1 / z + waves.error(1 / z)) + noise
    scale = stretch() if waves.along == "range" else 1.0
    return z + waves.error(z * scale) / scale + noise


def bends_of(depth, camera=CAMERA, sensor=SENSOR):
    return bends_of_frame(frame_of(pw.observe(depth, camera, sensor)))


def alike(found, true):
    """Whether waves are those: coordinate, period, and error where there are readings."""
    assert found is not None
    assert found.along == true.along
    (one,), (other,) = found.parts, true.parts
    assert_allclose(one.period, other.period, rtol=0.01)
    assert_allclose(one.amplitude, other.amplitude, rtol=0.15)
    u = np.linspace(0.35, 0.7, 500) if true.along == "disparity" else np.linspace(1.5, 3, 500)
    # A wave of a coordinate is known but for what moves planes to planes.
    free = np.stack((np.ones_like(u), u, 1 / u if true.along == "disparity" else u * u), axis=1)
    off = found.error(u) - true.error(u)
    off -= free @ np.linalg.lstsq(free, off, rcond=None)[0]
    assert np.sqrt(np.mean(off**2)) < 0.2 * other.amplitude


@pytest.mark.parametrize("along", ALONG)
def test_a_wave_is_found(corner, along):
    true = ERRORS[along]
    for seed in range(3):
        alike(waves_of(bends_of(read(corner[0], true, seed=seed))), true)


@pytest.mark.parametrize("missing", [0.02, 0.1, 0.2])
def test_readings_may_be_missing_all_over(corner, missing):
    """And without a wave none is found."""
    there = np.random.default_rng(0).random(SHAPE) >= missing
    for true in ERRORS.values():
        alike(waves_of(bends_of(read(corner[0], true) * there)), true)
    none = Waves("range", [Wave(0.5, 0.0, 0.0)])
    assert waves_of(bends_of(read(corner[0], none) * there)) is None


@pytest.mark.parametrize("along", ALONG)
def test_planes_are_found_through_a_wave(corner, along):
    """Which come in ribs without; Phi is that of the readings without the wave, and says so."""
    z, truth = corner
    depth = read(z, ERRORS[along])
    model = pw.detect_planes(depth, CAMERA, SENSOR)
    assert len(model) == 3
    assert evaluate(model.labels, truth).row()["voi_labelled"] < 0.03
    alike(Waves.of(model.settings["waves"]), ERRORS[along])
    seen = pw.observe(depth, CAMERA, SENSOR)
    again = pw.information(seen, model.planes, model.labels, objective="spatial")
    assert_allclose(again, model.information, rtol=1e-9)
    blind = pw.detect_planes(depth, CAMERA, replace(SENSOR, parts=quiet()))
    assert "waves" not in blind.settings
    assert evaluate(blind.labels, truth).row()["voi_labelled"] > 0.1


def quiet():
    """Parts of a sensor without waves."""
    return pw.noise.ErrorParts(white=0.002, shared=0.0, drift=0.0)


def test_a_second_wave_is_found(corner):
    true = Waves("range", [Wave(0.3, 0.003, 0.0), Wave(0.55, 0.004, 1.0)])
    found = waves_of(bends_of(read(corner[0], true)))
    assert_allclose(sorted(part.period for part in found.parts), (0.3, 0.55), rtol=0.02)


def test_a_radial_camera_has_waves_of_its_range(corner):
    z, truth = corner
    true, length = ERRORS["range"], corner[0] * stretch()
    noise = 0.002 * np.random.default_rng(0).standard_normal(z.shape)
    camera = replace(CAMERA, radial=True)
    model = pw.detect_planes(length + true.error(length) + noise, camera, SENSOR)
    alike(Waves.of(model.settings["waves"]), true)
    assert evaluate(model.labels, truth).row()["voi_labelled"] < 0.03


@pytest.mark.parametrize("sigma", [0.0005, 0.002, 0.01])
def test_noise_is_no_wave(corner, sigma):
    nothing = Waves("range", [Wave(1.0, 0.0, 0.0)])
    for seed in range(3):
        assert waves_of(bends_of(read(corner[0], nothing, sigma, seed))) is None


@pytest.mark.parametrize("seed", range(6))
def test_rooms_with_the_noise_of_a_kinect_have_no_wave(seed):
    room = scenes.room(seed)
    assert waves_of(bends_of(room.depth, room.camera, replace(room.sensor, parts=None))) is None


@pytest.mark.parametrize("angle", [75, 150, 175])
def test_walls_upright_in_the_image_have_no_wave(angle):
    """Their blocks lie at regular steps of depth, about which noise moves them."""
    for seed in range(4):
        scene = scenes.two_planes(angle, size=SHAPE, rng=seed)
        depth = 0.001 * (scene.depth + 0.5)
        assert waves_of(bends_of(depth, scene.camera, replace(SENSOR, noise=0.005))) is None


@pytest.mark.parametrize("seed", [200, 202, 205, 208])
@pytest.mark.parametrize("sigma", [0.001, 0.003, 0.01])
def test_steps_between_readings_are_no_wave(seed, sigma):
    """Which come again, too; and nothing could be taken off."""
    room = scenes.room(seed, sigma=sigma)
    assert waves_of(bends_of(room.depth, room.camera, replace(room.sensor, parts=None))) is None


@pytest.mark.parametrize("rise", [0.1, 0.15, 0.2, 0.3])
@pytest.mark.parametrize("shape", ["steps", "zigzag"])
def test_stairs_that_fill_the_frame_are_no_wave(rise, shape):
    """What comes again along depth on surfaces that lean alike may well be their shape."""
    rows = np.arange(SHAPE[0])[::-1]
    for width in (16, 24, 40):
        height = rise * (rows // width) + rise / 12 * np.maximum(rows % width - width // 2, 0)
        if shape == "zigzag":
            height = rise * (0.2 * rows / width + np.abs(rows / width % 1 - 0.5))
        for turn in (0.0, 0.002):
            depth = 2 + height[:, None] + turn * np.arange(SHAPE[1])
            depth += 0.002 * np.random.default_rng(0).standard_normal(SHAPE)
            assert waves_of(bends_of(depth)) is None


def test_a_wave_has_to_be_seen_on_surfaces_that_lean_across_each_other(corner):
    """On a floor alone it may be its relief."""
    depth = read(corner[0], ERRORS["range"])
    assert waves_of(bends_of(depth)) is not None
    assert waves_of(bends_of(np.where(corner[1] == 1, depth, 0))) is None


@pytest.mark.parametrize("radius", [0.5, 1.0, 2.0])
def test_what_is_curved_is_no_wave(radius):
    """Along one that is long enough a ball would be a plane."""
    rays = CAMERA.ray_rows(SHAPE)
    middle = np.array([0.1, -0.2, 2.0 + radius])
    a, b, c = (rays**2).sum(axis=0), middle @ rays, middle @ middle - radius**2
    with np.errstate(invalid="ignore"):
        z = np.nan_to_num((b - np.sqrt(b * b - a * c)) / a).reshape(SHAPE)
    z[z == 0] = 2.5 + radius
    z += 0.001 * np.random.default_rng(0).standard_normal(SHAPE)
    assert waves_of(bends_of(z, sensor=replace(SENSOR, noise=0.001))) is None


def test_real_frames_show_none(every_real_frame):
    """Kinects do not err alike in each of four steps, which is no wave."""
    for frame in every_real_frame:
        found = pw.estimate_noise(frame.depth, frame.camera, SENSOR, depth_scale=frame.depth_scale)
        assert found.waves is None, frame.name


def test_little_tells_of_no_wave():
    for shape in ((2, 2), (5, 700), (30, 30)):
        focal = max(shape)
        camera = pw.PinholeCamera(fx=focal, fy=focal, cx=shape[1] / 2, cy=shape[0] / 2)
        assert waves_of(bends_of(np.full(shape, 2.0), camera)) is None
    assert waves_of(bends_of(np.full(SHAPE, 2.0))) is None


def test_what_a_sensor_is_known_to_have_is_taken_off(corner):
    true = ERRORS["range"]
    depth = read(corner[0], true)
    for parts in (None, quiet()):
        sensor = replace(SENSOR, waves=true, parts=parts)
        model = pw.detect_planes(depth, CAMERA, sensor)
        assert model.settings["waves"] == true.describe()
        assert len(model) == 3
    seen = pw.observe(depth, CAMERA, sensor)
    frame = tame_frame(seen)
    assert_allclose(frame.w, 1 / true.taken_off(seen.depth, seen.rays).reshape(SHAPE), rtol=1e-6)
    assert_allclose(frame.wild, 1.5 * np.log(depth.size))  # what the wave costs in Phi


def test_range_images_have_known_waves_alone():
    camera = pw.SphericalCamera.panorama(64, 512)
    room = np.array([[1.0, 0, 0, 3], [-1, 0, 0, 4], [0, 1, 0, 3], [0, -1, 0, 2.5], [0, 0, 1, 1.5]])
    rays = camera.ray_rows((64, 512))
    with np.errstate(divide="ignore"):
        along = -room[:, 3:] / (room[:, :3] @ rays)
    distance = np.where(along > 0, along, 50).min(axis=0).reshape(64, 512)
    true = Waves("range", [Wave(0.8, 0.02, 0.0)])
    depth = distance + true.error(distance)
    sensor = pw.Sensor(max_depth=20, noise=0.005)
    assert tame_frame(pw.observe(depth, camera, sensor)).waves is None
    here = frame_of(pw.observe(distance, camera, sensor))
    found = tame_frame(pw.observe(depth, camera, replace(sensor, waves=true)))
    there = here.p > 0
    assert_allclose(found.w[there], here.w[there], rtol=2e-5)
    assert_array_equal(found.w > 0, here.w > 0)  # margins, too


@pytest.mark.parametrize("along", ALONG)
@pytest.mark.parametrize("scale", [1e-3, 1e-2, 1e3])
def test_waves_of_another_unit_leave_depth_what_it_is(corner, along, scale):
    """Ten millimetres of a centimetre, as of a sensor whose unit was mistaken."""
    sensor = pw.Sensor(max_depth=10 * scale, resolution=1e-5 * scale, noise=0.002 * scale)
    seen = pw.observe(scale * corner[0], CAMERA, replace(sensor, waves=ERRORS[along]))
    frame = tame_frame(seen)
    assert (np.abs(frame.w * seen.depth.reshape(SHAPE) - 1) < 0.26).all()
    assert pw.detect_planes(scale * corner[0], CAMERA, seen.sensor).readings == seen.count


def test_a_frame_without_readings_has_none():
    assert len(pw.detect_planes(np.zeros(SHAPE), CAMERA, SENSOR)) == 0
    model = pw.detect_planes(np.zeros(SHAPE), CAMERA, replace(SENSOR, waves=ERRORS["range"]))
    assert len(model) == 0


def test_the_papers_objective_reads_what_is_there(corner):
    depth = read(corner[0], ERRORS["range"])
    sensor = replace(SENSOR, noise=0.01)
    plain, told = (
        pw.detect_planes(depth, CAMERA, each, objective="paper")
        for each in (sensor, replace(sensor, waves=ERRORS["range"]))
    )
    assert plain.information == told.information
    assert "waves" not in told.settings


def test_bends_are_those_of_three_blocks_in_a_row(corner):
    """And what is missing is in none; where some is, pixels opposite each other say the mean."""
    z = read(corner[0], ERRORS["depth"])
    z[30:40, 50:90] = 0
    z[np.random.default_rng(0).random(SHAPE) < 0.05] = 0
    frame = frame_of(pw.observe(z, CAMERA, SENSOR))
    found = bends_of_frame(frame)
    side = 3  # of a small image
    rows, columns = SHAPE[0] // side, SHAPE[1] // side
    cut = frame.w[: rows * side, : columns * side].astype(float)
    parts = cut.reshape(rows, side, columns, side)
    pairs = (parts > 0) & (parts > 0)[:, ::-1, :, ::-1]
    w = np.where(pairs, parts, 0).sum(axis=(1, 3)) / np.maximum(pairs.sum(axis=(1, 3)), 1)
    w[2 * pairs.sum(axis=(1, 3)) < side * side] = 0
    assert_allclose(found.w.reshape(rows, columns), w, rtol=1e-6)
    a, b, c = found.index
    assert (w.reshape(-1)[found.index] > 0).all()
    assert_allclose(found.bend, (2 * found.w[b] - found.w[a] - found.w[c]), rtol=1e-9)
    step = b - a
    assert_array_equal(c - b, step)
    assert set(np.unique(step)) == {1, 2, 4, columns, 2 * columns, 4 * columns}
    same_row = (step < columns) & (a // columns == c // columns)
    assert (same_row | (step >= columns)).all()
    i, j = b // columns, b % columns
    far = 4  # blocks
    around = np.pad(w, far)
    left, right, up, below = (
        around[far + i + down, far + j + along]
        for down, along in ((0, -far), (0, far), (-far, 0), (far, 0))
    )
    known = np.minimum(np.minimum(left, right), np.minimum(up, below)) > 0
    assert_allclose(found.lean, np.where(known, (right - left, below - up), 0), atol=1e-7)
    assert 0.5 < known.mean() < 1
    start = 0
    for lag, end in zip((1, 2, 4), found.ends, strict=True):
        assert set(np.unique(step[start:end])) == {lag, lag * columns}
        start = end


def test_the_spectrum_is_that_of_normal_equations(corner):
    """Of any frequency, against sines and cosines put into three blocks in a row."""
    bends = bends_of(read(corner[0], ERRORS["depth"]))
    u, rate = bends.coordinate("range")
    knots, weights = 512, bends.weights(bends.bend)
    seen = u[bends.w > 0]
    first, last = seen.min(), seen.max()
    place = np.maximum(np.rint((u - first) * (knots - 1) / (last - first)), 0).astype(np.int32)
    together, (sums, apart, own) = np.empty(2 * knots), np.empty((3, knots))
    kernels.spectrum_sums(bends.index, place, rate, bends.bend, weights, sums, apart, together, own)
    squares = weights * bends.bend**2 / 6
    expected = sum(
        np.bincount(place[of], part * squares, knots)
        for of, part in zip(bends.index, (1, 4, 1), strict=True)
    )
    assert_allclose(own, expected, rtol=1e-9, atol=1e-12 * expected.max())
    for frequency in (0.003, 0.05, 0.31):  # in turns of a knot
        angle = 2 * np.pi * frequency * place
        rows = np.stack([bends.of_blocks(rate * wave) for wave in (np.sin(angle), np.cos(angle))])
        normal, right = (rows * weights) @ rows.T, (rows * weights) @ bends.bend
        turn = np.exp(2j * np.pi * frequency * np.arange(2 * knots))
        minus, plus, b = apart @ turn[:knots], together @ turn, sums @ turn[:knots]
        assert_allclose((b.imag, b.real), right, rtol=1e-8)
        of_both = (minus.real - plus.real) / 2, (minus.real + plus.real) / 2, plus.imag / 2
        assert_allclose(of_both, (normal[0, 0], normal[1, 1], normal[0, 1]), rtol=1e-8)


def test_bends_of_frames_together(corner):
    frames = [bends_of(read(corner[0], ERRORS["range"], seed=seed)) for seed in range(3)]
    some = [each.thinned(3) for each in frames]
    for each, whole in zip(some, frames, strict=True):
        assert each.bend.size == -(-whole.bend.size // 3)
        assert_allclose(each.bend, each.of_blocks(each.w), rtol=1e-12)
        assert each.ends[-1] == each.bend.size
    both = Bends.together(some)
    assert_allclose(both.bend, both.of_blocks(both.w), rtol=1e-12)
    assert both.ends[-1] == both.bend.size
    assert_allclose(
        both.weights(both.bend), np.concatenate([each.weights(each.bend) for each in some])
    )
    alike(waves_of(both), ERRORS["range"])


def test_what_is_taken_off_is_the_same_for_any_coordinates(corner):
    """A row and a column of them, or images as of a lens that bends."""
    frame = frame_of(pw.observe(corner[0], CAMERA, SENSOR))
    straight = frame.sectors.coordinates
    whole = tuple(np.ascontiguousarray(np.broadcast_to(each, SHAPE)) for each in straight)
    error = np.linspace(-0.02, 0.02, 4096)
    out = np.empty((2, *SHAPE), np.float32)
    for inverse in (False, True):
        ranging = 800.0, *((0.0, 0.0) if inverse else frame.sectors.slants)
        for coordinates, each in zip((straight, whole), out, strict=True):
            kernels.take_off(frame.w, *coordinates, inverse, ranging, 0.2, error, each)
        assert_array_equal(*out)
        w = frame.w.astype(float)
        u = w if inverse else stretch() / w
        off = np.interp((u - 0.2) * 800, np.arange(4096), error)
        right = w - off if inverse else 1 / (1 / w - off / stretch())
        assert_allclose(out[0], right, rtol=1e-5)


@given(st.floats(0.01, 5), st.floats(0, 0.6), st.floats(-4, 4), st.floats(0, 1), st.floats(0, 20))
def test_what_is_read_is_told_from_what_is_true(period, steep, phase, share, u):
    """As long as the error grows by less than six tenths of what it is an error of."""
    slopes = steep * share, steep * (1 - share)
    parts = [
        Wave(period / k, slope * period / k / (2 * np.pi), phase * k)
        for k, slope in enumerate(slopes, start=1)
    ]
    waves, true = Waves("depth", parts), np.array([u])
    assert_allclose(waves.true(true + waves.error(true)), true, atol=1e-9)


def test_waves_say_what_they_are():
    assert str(ERRORS["range"]) == "4 mm every 0.5 m of range"
    assert str(ERRORS["disparity"]) == "0.001 1 / m every 0.025 1 / m of inverse depth"
    assert Waves.of(json.loads(json.dumps(ERRORS["depth"].describe()))) == ERRORS["depth"]
    assert hash(ERRORS["depth"]) == hash(replace(ERRORS["depth"]))
    assert replace(SENSOR, waves=ERRORS["range"]).describe()["waves"] == str(ERRORS["range"])
    assert "waves" not in SENSOR.describe()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Wave(0.0, 0.001, 0.0), "period must be positive and finite, got 0.0"),
        (lambda: Wave(1.0, np.inf, 0.0), "amplitude must be finite"),
        (lambda: Wave(1.0, 0.1, None), "phase must be finite"),
        (lambda: Waves("range", [Wave(1.0, 0.1, 0.0)] * 2), "different true depths would be read"),
        (lambda: Waves("height", [Wave(1.0, 0.01, 0.0)]), "along must be one of range, depth"),
        (lambda: Waves("range", 3), "parts must be a sequence of Wave, got 3"),
        (lambda: Waves("range", []), "one Wave or more"),
        (lambda: Waves("range", [0.01]), "one Wave or more"),
        (lambda: pw.Sensor(waves=3), r"waves must be planewise\.waves\.Waves or None, got 3"),
    ],
)
def test_what_are_no_waves(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_waves_survive_a_file(tmp_path):
    sensor = replace(SENSOR, waves=ERRORS["disparity"], parts=quiet())
    path = tmp_path / "sensor.json"
    sensors.save(sensor, path)
    assert sensors.load(path) == sensor
    record = json.loads(path.read_text())
    for waves, message in (
        (3, "waves must be null, or hold along and parts"),
        ({"along": "range"}, r"waves\.parts must be a list of waves with period"),
        ({"along": "range", "parts": [{"period": 1}]}, r"waves\.amplitude must be a finite"),
        ({"along": "up", "parts": [sensor.waves.describe()["parts"][0]]}, "along must be one of"),
        ({"along": "range", "parts": []}, "one Wave or more"),
    ):
        path.write_text(json.dumps({**record, "waves": waves}))
        with pytest.raises(PlanewiseError, match=message):
            sensors.load(path)


@pytest.fixture(scope="module")
def frames(corner):
    return [read(corner[0], ERRORS["range"], seed=seed).round(3) for seed in range(4)]


def test_a_calibrated_sensor_has_the_waves_of_its_frames(frames, corner):
    """And no drift, for which they would be taken."""
    found = pw.calibrate(frames, CAMERA, pw.Sensor())
    alike(found.waves, ERRORS["range"])
    sensor = found.sensor(pw.Sensor())
    assert sensor.waves == found.waves
    assert sensor.parts.drift is pw.noise.NOTHING
    model = pw.detect_planes(frames[0], CAMERA, sensor)
    assert len(model) == 3
    again = pw.calibrate(frames, CAMERA, sensor)  # what is known is not looked for
    assert again.sensor(sensor).waves == sensor.waves
    assert_allclose(again.noise([2.0]), found.noise([2.0]), rtol=0.02)
    assert pw.calibrate([corner[0]], CAMERA, pw.Sensor()).waves is None


@pytest.mark.parametrize("along", ALONG)
def test_waves_are_taken_off_frames_that_do_not_show_them(corner, along):
    """As a floor alone does not: what its cells share would be taken for drift."""
    one, two, three = (read(corner[0], ERRORS[along], seed=seed) for seed in range(3))
    floor = np.where(corner[1] == 1, three, 0)
    assert pw.estimate_noise(floor, CAMERA, SENSOR).waves is None
    found = pw.calibrate([one, two, floor], CAMERA, pw.Sensor())
    alike(found.waves, ERRORS[along])
    assert found.shared_ratio < 0.06


def test_noise_is_estimated_without_waves(corner):
    true = ERRORS["range"]
    found = pw.estimate_noise(read(corner[0], true), CAMERA, pw.Sensor(noise="auto"))
    alike(found.waves, true)
    assert found.drift is found.shared is pw.noise.NOTHING
    model = pw.detect_planes(read(corner[0], true), CAMERA, pw.Sensor(noise="auto"))
    assert model.settings["noise"]["waves"] == str(found.waves)
    assert model.settings["waves"] == found.waves.describe()
    assert len(model) == 3
    known = pw.Sensor(noise="auto", waves=true)
    assert pw.detect_planes(read(corner[0], true), CAMERA, known).settings["waves"] == (
        true.describe()
    )


def test_waves_at_the_command_line(frames, tmp_path):
    for k, depth in enumerate(frames):
        np.save(tmp_path / f"{k}.npy", depth)
    camera = ("--camera", "262,262,159.5,119.5")
    file = tmp_path / "out" / "sensor.json"
    code, text, _ = run("calibrate", tmp_path, *camera, "--sensor", "azure-kinect", "-o", file)
    assert code == 0
    assert re.search(r"waves: .* mm every 0\.5.* m of range, taken off by the spatial obj", text)
    for sensor in ("azure-kinect", file):
        code, text, _ = run(
            "detect", tmp_path / "0.npy", *camera, "--sensor", sensor, "-o", tmp_path / "found"
        )
        assert code == 0
        assert re.search(r"waves that were taken off: .* mm every 0\.(49|5).* m of range", text)
        written = json.loads((tmp_path / "found" / "planes.json").read_text())
        assert written["options"]["waves"]["along"] == "range"
