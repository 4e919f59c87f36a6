import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from tests.lent import Lent

SENSOR = pw.Sensor(max_depth=5.0, min_depth=0.5, noise=pw.noise.proportional(0.01))


def test_invalid_readings_are_left_out(camera):
    depth = np.full((48, 64), 2.0)
    depth[0, :6] = [0, np.nan, np.inf, 0.4, 5.1, 2.0]
    observation = pw.observe(depth, camera, SENSOR)
    assert observation.count == depth.size - 5
    assert_array_equal(observation.index, np.delete(np.arange(depth.size), range(5)))


def test_the_input_is_not_changed(camera):
    depth = np.random.default_rng(0).uniform(0, 6, (48, 64))
    before = depth.copy()
    depth.flags.writeable = False
    pw.detect_planes(depth, camera, SENSOR)
    assert_array_equal(depth, before)


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.int64, np.uint8])
def test_integer_depth_is_in_units_of_the_resolution(camera, dtype):
    raw = np.random.default_rng(0).integers(0, 256, (48, 64)).astype(dtype)
    sensor = pw.Sensor(max_depth=5, resolution=0.01, noise=pw.noise.KINECT)
    ours = pw.observe(raw, camera, sensor)
    metres = pw.observe(raw * 0.01, camera, sensor)
    assert_array_equal(ours.index, metres.index)
    assert_allclose(ours.depth, metres.depth, rtol=1e-12)
    assert_allclose(ours.sigma, metres.sigma, rtol=1e-12)


def test_depth_scale_overrides_the_resolution(camera):
    raw = np.full((48, 64), 10000, np.uint16)
    observation = pw.observe(raw, camera, SENSOR, depth_scale=0.0002)
    assert_allclose(observation.depth, 2.0)
    with pytest.raises(ValueError, match="depth_scale is for integer depth"):
        pw.observe(raw * 1.0, camera, SENSOR, depth_scale=0.0002)
    for scale in (-1, "x"):
        with pytest.raises(ValueError, match=f"depth_scale must be a positive .*{scale}"):
            pw.observe(raw, camera, SENSOR, depth_scale=scale)


@pytest.mark.parametrize("largest", [3000, 300_000])
def test_noise_is_evaluated_once_per_distinct_value(camera, largest):
    seen = []

    def noise(z):
        seen.append(np.asarray(z))
        return 0.001 + 0 * z

    raw = np.tile(np.array([1000, largest, 0, 2000], np.int32), (48, 16))
    sensor = pw.Sensor(max_depth=400, resolution=0.001, noise=noise)
    pw.observe(raw, camera, sensor)
    assert_allclose(np.concatenate(seen), sorted([1.0, 2.0, largest / 1000]))


def test_readings_become_points(camera):
    depth = np.random.default_rng(1).uniform(1, 4, (48, 64))
    points = pw.observe(depth, camera, SENSOR).positions()
    assert_allclose(points[:, 2], depth.ravel())
    pixels = camera.project(points)
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    assert_allclose(pixels, np.stack((x, y), axis=-1).reshape(-1, 2), atol=1e-9)


def test_residual_is_along_the_ray(camera):
    plane = np.array([0.6, 0.0, -0.8, 2.0])
    depth = np.full((48, 64), 2.0)
    observation = pw.observe(depth, camera, SENSOR)
    on_plane = (observation.depth - observation.residuals(plane)) * observation.rays
    assert_allclose(plane[:3] @ on_plane + plane[3], 0, atol=1e-12)


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (np.ones(5), r"2-D image .* got shape \(5,\)"),
        (np.ones((2, 3, 3)), "2-D image"),
        ("depth.png", "2-D image .* got str"),
        (None, "2-D image .* got NoneType"),
        (np.ones((1, 64)), "at least 2 rows and 2 columns"),
        (np.ones((48, 1)), "at least 2 rows and 2 columns"),
        (np.ones((0, 0)), "at least 2 rows"),
        (np.full((48, 64), "a"), "got dtype <U1"),
        (np.ones((48, 64), bool), "got dtype bool"),
        (np.ones((48, 64), complex), "got dtype complex128"),
        (np.full((48, 64), -1.0), "must not be negative, got -1.0"),
        (np.full((48, 64), -3, np.int16), "must not be negative, got -3"),
    ],
)
def test_bad_depth_is_refused(camera, depth, message):
    with pytest.raises(ValueError, match=message):
        pw.observe(depth, camera, SENSOR)


NO_PARTS = pw.noise.ErrorParts(**dict.fromkeys(("white", "shared", "drift"), pw.noise.NOTHING))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"max_depth": 0}, "max_depth must be a positive"),
        ({"max_depth": np.nan}, "max_depth must be a positive"),
        ({"resolution": -0.001}, "resolution must be a positive"),
        ({"resolution": 10, "max_depth": 5}, "resolution must be smaller than the range"),
        ({"resolution": 0.5, "depth_range": 0.3}, "resolution must be smaller than the range"),
        ({"min_depth": 7, "max_depth": 5}, "min_depth must lie in"),
        ({"min_depth": 5, "max_depth": 5}, "min_depth must lie in"),
        ({"max_depth": None}, "max_depth must be a positive number of metres, got None"),
        ({"max_depth": "10"}, "max_depth must be a positive number of metres, got '10'"),
        ({"min_depth": None}, "min_depth must lie in"),
        ({"noise": None}, "noise must be a function of depth, metres or 'auto', got None"),
        ({"noise": [1, 2]}, "noise must be a function of depth, metres or 'auto', got"),
        ({"noise": "0.01"}, "noise must be a function of depth, metres or 'auto', got '0.01'"),
        ({"noise": True}, "noise must be a function of depth, metres or 'auto', got True"),
        ({"parts": "kinect"}, "parts must be planewise.noise.ErrorParts or None, got 'kinect'"),
        ({"noise": pw.noise.NOTHING}, "noise must be more than nothing"),
        ({"parts": NO_PARTS}, "parts.white must be more than"),
        ({"noise": 0.0}, "noise: sigma must be positive, got 0 m$"),
        ({"noise": -1.0}, "sigma must be positive"),
        ({"noise": float("nan")}, "sigma must be positive"),
        ({"max_depth": 1e30}, r"max_depth must be at most 1e\+09 .* the largest depth that"),
        ({"depth_range": 1.7e308}, r"depth_range must be at most 1e\+09 metres"),
        ({"resolution": 1e-310}, "resolution must be at least 1e-12 metres, got 1e-310"),
    ],
)
def test_bad_sensors_are_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        pw.Sensor(**kwargs)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (lambda z: 0 * z, "noise must be positive and finite .* sigma = 0.0"),
        (lambda z: z - 3, "noise must be positive"),
        (lambda z: "a", "noise must return one sigma per depth, got 'a'"),
        (lambda z: np.nan * z, "sigma = nan"),
        (lambda z: np.ones(3), "one sigma per depth"),
        (lambda z: z * 0.01j, "noise must return one sigma per depth, got array"),
        (1e300, r"noise must be positive and finite .* sigma = 1e\+300"),
        (1e-300, "noise must be positive and finite .* sigma = 1e-300"),
    ],
)
def test_bad_noise_is_refused_when_it_shows(camera, noise, message):
    with pytest.raises(ValueError, match=message):
        pw.observe(np.full((48, 64), 2.0), camera, pw.Sensor(noise=noise))


def test_the_first_noise_that_is_none_is_told():
    with pytest.raises(ValueError, match=r"got sigma = -1.0 at z = 2.0 m"):
        pw.Sensor(noise=lambda z: z - 3).sigma([4.0, 2.0, 1.0])
    with pytest.raises(ValueError, match=r"per depth: expected shape \(2,\), got \(1,\)"):
        pw.Sensor(noise=lambda z: np.ones(1)).sigma([4.0, 2.0])


def test_noise_is_held_against_the_depth_of_its_reading():
    """At least a millionth of a millionth of it, of strays beyond the range against that."""
    sensor = pw.Sensor(max_depth=1e6, resolution=1e-7, noise=1e-8)
    assert_array_equal(sensor.sigma([1.0, 9e3]), 1e-8)
    with pytest.raises(ValueError, match=r"sigma = 1e-08 at z = 11000"):
        sensor.sigma([1.0, 1.1e4])
    near = pw.Sensor(max_depth=10, noise=lambda z: np.where(z < 1, 1e-12, 1e-3))
    assert_array_equal(near.sigma([0.5, 1e12]), [1e-12, 1e-3])
    assert pw.Sensor(max_depth=1e9).sigma([2.0]) == 0.02


def test_a_noise_that_returns_one_number_is_constant(camera):
    observation = pw.observe(np.full((48, 64), 2.0), camera, pw.Sensor(noise=lambda z: 0.02))
    assert_allclose(observation.sigma, 0.02)


def test_a_noise_may_work_in_place(camera):
    def one_percent(z):
        z *= 0.01
        return z

    observation = pw.observe(np.full((48, 64), 2.0), camera, pw.Sensor(noise=one_percent))
    assert_allclose(observation.sigma, 0.02)
    assert_allclose(observation.depth, 2.0)


def test_why_there_are_no_readings_is_said(camera):
    far = pw.observe(np.full((48, 64), 2000.0), camera, SENSOR)
    assert "is the depth in metres?" in far.note
    fine = pw.observe(np.full((48, 64), 20_000, np.uint16), camera, SENSOR)
    taken = (
        "units were taken for 1 mm (depth_scale = 0.001); are they 1/5000 m (depth_scale = 0.0002)?"
    )
    assert fine.note.endswith(taken)
    finer = pw.observe(np.full((48, 64), 200_000), camera, SENSOR)  # more than 16 bits
    assert finer.note.endswith(taken)
    known = pw.observe(np.full((48, 64), 60_000, np.uint16), camera, SENSOR, depth_scale=0.0002)
    assert known.note.endswith("units were taken for 0.2 mm (depth_scale = 0.0002)")
    inverse = pw.observe(np.full((48, 64), 10_000, np.uint16), camera, SENSOR, depth_scale=5000)
    assert "depth_scale is metres per unit: 0.0002 rather than 5000?" in inverse.note
    assert "0 valid readings" in pw.observe(np.zeros((48, 64)), camera, SENSOR).note
    one = np.pad([[2.0]], ((0, 47), (0, 63)))
    assert pw.observe(one, camera, SENSOR).note.startswith("1 valid reading; 3 are")
    assert pw.observe_points([[1.0, 2.0]], SENSOR).note.startswith("1 finite point; 2 are")


def test_noise_models_say_what_they_are():
    assert str(pw.noise.KINECT) == "0.0012 + 0.0019 (z - 0.4)^2 m"
    assert_allclose(pw.noise.KINECT([0.4, 1.4]), [0.0012, 0.0031])
    assert_allclose(pw.noise.KINECT([0.1, 0.3]), 0.0012)  # no more towards the sensor
    assert_allclose(pw.noise.stereo(focal=500, baseline=0.1, subpixel=0.1)([2.0]), [0.008])
    with pytest.raises(ValueError, match="baseline must be positive"):
        pw.noise.stereo(focal=500, baseline=0)
    with pytest.raises(ValueError, match="focal and baseline are those of no camera"):
        pw.noise.stereo(focal=1e-200, baseline=1e-200)
    with pytest.raises(ValueError, match="sigma must be positive"):
        pw.noise.Polynomial(constant=0.01, linear=-0.001)


def test_a_noise_may_be_scaled():
    curve = pw.noise.Polynomial(0.001, 0.002, 0.003, 0.4)
    assert_allclose(curve.scaled(2.5)([0.2, 1.4]), [2.5 * 0.0014, 2.5 * 0.0068])


@pytest.mark.parametrize("part", ["constant", "linear", "quadratic"])
def test_only_a_constant_is_the_same_at_every_depth(part):
    assert pw.noise.is_constant(pw.noise.Polynomial(**{part: 0.01})) == (part == "constant")


def test_parts_and_sums_take_numbers():
    parts = pw.noise.ErrorParts(white=0.001, shared=0, drift=np.float32(0.5))
    assert parts.white == pw.noise.constant(0.001)
    assert parts.shared is pw.noise.NOTHING
    assert pw.noise.RootSum([0.003, pw.noise.constant(0.004)])(1.0) == pytest.approx(0.005)


@pytest.mark.parametrize("wrong", ["a", None, True, [0.1]])
def test_parts_that_are_no_noise_are_refused(wrong):
    with pytest.raises(ValueError, match=r"parts\.drift must be metres or a function of depth"):
        pw.noise.ErrorParts(white=0.001, shared=0, drift=wrong)
    with pytest.raises(ValueError, match="parts must be metres or a function of depth, got"):
        pw.noise.RootSum((0.001, wrong))
    with pytest.raises(ValueError, match="a sum is of a tuple of parts, got 3"):
        pw.noise.RootSum(3)


@pytest.mark.parametrize("given", [None, 4.0])
def test_the_range_is_the_largest_depth_unless_given(given):
    sensor = pw.Sensor(max_depth=10.0, depth_range=given)
    assert sensor.range == sensor.describe()["range_m"] == (given or 10.0)


@pytest.mark.parametrize("name", pw.sensors.PRESETS)
def test_sensor_presets_have_plausible_noise(name):
    sensor = pw.sensors.PRESETS[name]
    nearest = 1.0 if name.startswith(("ouster", "velodyne")) else 0.4  # metres
    z = np.linspace(max(sensor.min_depth, nearest), sensor.max_depth, 50)
    sigma = sensor.sigma(z)
    assert (sigma > 1e-4).all()
    assert (sigma < 0.06 * z).all()


def test_points_keep_their_precision_far_from_the_origin():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3)) + np.array([4e6, 5e5, 100])
    observation = pw.observe_points(points, pw.Sensor(noise=0.01))
    assert_allclose(observation.positions(), points, rtol=1e-15)
    assert np.abs(observation.points).max() < 10


@pytest.mark.parametrize("points", [np.ones(4), np.ones((4, 1)), np.full((4, 3), "x")])
def test_bad_points_are_refused(points):
    with pytest.raises(ValueError, match=r"points must be real numbers of shape \(k, n\)"):
        pw.observe_points(points, SENSOR)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32, np.float64])
def test_an_observation_does_not_change_with_the_array_it_was_made_of(dtype):
    """A camera's driver fills the same memory again and again."""
    camera = pw.PinholeCamera(fx=50, fy=50, cx=32, cy=24)
    rng = np.random.default_rng(0)
    depth = (2.0 + rng.normal(0, 0.005, (48, 64))) * (1000 if dtype == np.uint16 else 1)
    buffer = depth.astype(dtype)
    seen = pw.observe(buffer, camera, pw.Sensor(noise=0.005))
    expected = pw.find(pw.observe(buffer.copy(), camera, pw.Sensor(noise=0.005)), pw.Options())
    buffer[:] = 9000
    found = pw.find(seen, pw.Options())
    assert found.information == expected.information
    assert len(found) == 1
    assert pw.information(seen, found.planes, found.labels, objective="spatial") > 0


@pytest.mark.parametrize("kind", [Lent, memoryview, lambda array: np.ma.array(array, copy=False)])
def test_an_observation_has_a_copy_of_any_buffer(camera, kind):
    buffer = np.full((48, 64), 2.0)
    seen = pw.observe(kind(buffer), camera, SENSOR)
    buffer[:] = 3.0
    assert (seen.depth == 2.0).all()


def test_what_is_masked_is_no_reading_even_of_a_copy(camera):
    depth = np.ma.masked_greater(np.linspace(1, 4, 48 * 64).reshape(48, 64), 2.0)
    assert pw.observe(depth, camera, SENSOR).count == depth.count()


def test_rows_of_several_lengths_are_named(camera):
    with pytest.raises(ValueError, match=r"depth cannot be made an array: .* inhomogeneous"):
        pw.observe([[1.0, 2.0], [1.0]], camera, SENSOR)


def test_what_is_no_observation_is_refused():
    depth = np.full((48, 64), 2.0)
    for call in (
        lambda: pw.find(depth, pw.Options()),
        lambda: pw.information(depth, [], np.zeros((48, 64), int)),
    ):
        with pytest.raises(ValueError, match=r"planewise\.observe .* got a ndarray"):
            call()
    seen = pw.observe(depth, pw.PinholeCamera(fx=50, fy=50, cx=32, cy=24), pw.Sensor(noise=0.005))
    with pytest.raises(ValueError, match="options must be"):
        pw.find(seen, None)
    with pytest.raises(ValueError, match=r"such as model\.planes"):
        pw.information(seen, pw.find(seen, pw.Options()), np.zeros((48, 64), int))


def test_a_sum_of_functions_that_return_a_number():
    both = pw.noise.RootSum((lambda z: 0.003, 0.004))
    assert both([1.0, 2.0]).tolist() == pytest.approx([0.005, 0.005])
    with pytest.raises(ValueError, match="parts must return one sigma per depth"):
        pw.noise.RootSum((lambda z: np.ones(3), 0.004))([1.0, 2.0])


def test_a_noise_of_ones_own_is_told_by_its_name():
    class Own:
        def __call__(self, z):
            return 0.01 * z

        def by_half(self, z):
            return 0.005 * z

    for noise in (Own(), Own().by_half, lambda z: 0.01 * z):
        parts = pw.noise.ErrorParts(white=noise, shared=0, drift=pw.noise.RootSum((noise,)))
        told = pw.Sensor(noise=noise, parts=parts).describe()
        assert " at 0x" not in f"{told}"
        assert told["noise"] == getattr(noise, "__qualname__", Own.__qualname__)


@pytest.mark.parametrize("whole", [True, False])
def test_sigma_cannot_be_written_to(camera, whole):
    table = np.full(48 * 64, 0.01)
    depth = np.full((48, 64), 2000) if whole else np.full((48, 64), 2.0)
    seen = pw.observe(depth, camera, pw.Sensor(noise=0.01 if whole else lambda z: table[: z.size]))
    points = pw.observe_points(np.eye(3) + 1, pw.Sensor(noise=0.01))
    for observation in (seen, points):
        with pytest.raises(ValueError, match="read-only"):
            observation.sigma[:] = 1.0
    assert table.flags.writeable
