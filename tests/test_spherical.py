"""The spherical camera: directions, points to range images and back, files, what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import planewise as pw
from planewise import angles, cameras
from planewise.errors import PlanewiseError
from planewise.files.camera import read_camera

CAMERA = pw.SphericalCamera(
    elevation=[20, 11, 3, 0, -8, -20],
    azimuth=np.linspace(100, -100, 41),
    azimuth_offset=[1, -1, 0.5, 0, -0.5, 1],
)

TURN = Rotation.from_euler("xyz", [4, -7, 100], degrees=True).as_matrix()


def test_rays_are_those_of_the_angles():
    rays = CAMERA.rays(CAMERA.shape)
    assert rays.shape == (6, 41, 3)
    assert not rays.flags.writeable
    a, e = np.radians(100 - 5 * 7 - 1), np.radians(11)
    expected = np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)
    assert_allclose(rays[1, 7], expected, rtol=1e-12)
    assert_allclose(CAMERA.ray_rows(CAMERA.shape)[:, 41 + 7], expected, rtol=1e-12)
    assert not CAMERA.wraps
    assert_allclose(CAMERA.pixel_size, np.radians([5, 8]))  # means: rows are uneven


def test_places_between_pixels():
    rows, columns = np.indices(CAMERA.shape)
    pixels = np.stack((columns, rows), axis=-1)
    assert_allclose(CAMERA.unproject(pixels), CAMERA.rays(CAMERA.shape), atol=1e-12)
    plain = pw.SphericalCamera(elevation=[10, 0], azimuth=[30, 20, 10])
    a, e = np.radians((25, 35, 5)), np.radians((5, 15, -5))
    expected = np.stack((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)), axis=-1)
    found = plain.unproject(np.array([[0.5, 0.5], [-0.5, -0.5], [2.5, 1.5]]))
    assert_allclose(found, expected, atol=1e-12)


def test_a_tilted_sensor_has_axes_of_its_own():
    tilted, shape = replace(CAMERA, turn=TURN.T.tolist()), CAMERA.shape
    assert repr(tilted) == repr(CAMERA).replace(">", ", turned>")
    assert_allclose(tilted.rays(shape), CAMERA.rays(shape) @ TURN.T, atol=1e-12)
    assert_allclose(tilted.unproject((7.5, 1.5)), TURN @ CAMERA.unproject((7.5, 1.5)), atol=1e-12)
    assert_allclose(tilted.axes, TURN.T)
    ranges = np.random.default_rng(0).uniform(1, 50, shape)
    assert_allclose(tilted.from_points(tilted.points(ranges).reshape(-1, 3)), ranges)
    assert replace(CAMERA, turn=np.eye(3)) == replace(CAMERA, turn=np.empty(0)) == CAMERA


def test_planes_of_a_tilted_sensor_are_turned():
    scene = pw.scenes.panorama(1, camera=pw.SphericalCamera.panorama(128))
    tilted = replace(scene.camera, turn=TURN.T)
    for options in ({}, {"objective": "paper"}):
        level, turned = (
            pw.detect_planes(scene.depth, camera, scene.sensor, **options)
            for camera in (scene.camera, tilted)
        )
        assert len(level) > 6
        assert (level.labels == turned.labels).mean() > 0.999
        assert turned.information == pytest.approx(level.information, rel=1e-4)
        wide = zip(level.planes[:6], turned.planes[:6], strict=True)
        for one, other in wide:
            assert_allclose(other.normal, TURN @ one.normal, atol=1e-3)
            assert_allclose(other.centroid, TURN @ one.centroid, atol=5e-3)
            assert other.distance == pytest.approx(one.distance, abs=1e-3)
            both = np.eye(4)
            both[:3, :3] = TURN
            expected, size = both @ one.covariance @ both.T, np.trace(one.covariance)
            assert_allclose(other.covariance, expected, atol=0.1 * size)


def test_pixels_cover_the_band_between_the_outermost_beams():
    camera = pw.SphericalCamera.spinning(np.linspace(30, -30, 61), 360)
    area = camera.pixel_area(camera.shape)
    assert area.sum() == pytest.approx(2 * np.pi * 2 * np.sin(np.radians(30.5)), rel=1e-9)
    assert_allclose(camera.pixel_size, np.radians([1, 1]))


def test_rows_at_the_poles_reach_no_farther():
    camera = pw.SphericalCamera.spinning(np.linspace(90, -90, 61), 120)
    area = camera.pixel_area(camera.shape)
    assert area.min() > 1e-5
    assert area.sum() == pytest.approx(4 * np.pi, rel=1e-9)


@pytest.mark.parametrize("columns", [2, 3, 4, 5, 6])
def test_the_usual_step_is_the_median(columns):
    azimuth = -np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, columns))
    assert angles.usual_step(azimuth) == pytest.approx(np.median(-np.diff(azimuth)))


def test_azimuth_may_jump_by_a_turn():
    jumping = np.mod(np.arange(0, 360, 10) + 200, 360)
    camera = pw.SphericalCamera(elevation=[5, 0, -5], azimuth=jumping)
    assert camera.wraps
    assert_allclose(camera.rays((3, 36))[1, 16], [1, 0, 0], atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), wraps=st.booleans(), upward=st.booleans())
def test_points_come_back_to_their_pixels(seed, wraps, upward):
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(2, 12), rng.integers(4, 40)
    elevation = np.cumsum(rng.uniform(0.5, 3, rows)) * (1 if upward else -1)
    span = 360 * (1 - 1 / columns) if wraps else rng.uniform(20, 300)
    azimuth = rng.uniform(-180, 180) + rng.choice((-1, 1)) * np.linspace(0, span, columns)
    step = span / (columns - 1)
    offset = rng.uniform(-0.9, 0.9, rows) * min(step, 20) if wraps else ()
    camera = pw.SphericalCamera(elevation=elevation, azimuth=azimuth, azimuth_offset=offset)
    assert camera.wraps or not wraps
    ranges = rng.uniform(1, 50, camera.shape) * (rng.random(camera.shape) < 0.8)
    points = camera.points(ranges)
    assert_array_equal(np.isnan(points[..., 0]), ranges == 0)
    flat = points.reshape(-1, 3)
    flat = flat[rng.permutation(len(flat))]
    again = camera.from_points(np.vstack((flat, 1.5 * flat[::2])))
    assert_allclose(again, ranges, rtol=1e-12)
    row, column = camera.pixels(points.reshape(-1, 3)).T
    there = ranges.ravel() > 0
    expected = np.unravel_index(np.flatnonzero(there), camera.shape)
    assert_array_equal((row[there], column[there]), expected)
    assert (row[~there] == -1).all()


def test_points_outside_are_left_out():
    points = [[0, 0, 0], [np.nan, 1, 1], [np.inf, 1, 1], [1, 0, 1], [-1, 0, 0], [1, 0, 0]]
    assert_array_equal(CAMERA.pixels(points)[:, 0], [-1, -1, -1, -1, -1, 3])
    assert_array_equal(CAMERA.pixels(points)[:5], np.full((5, 2), -1))
    assert (CAMERA.from_points(points) > 0).sum() == 1
    assert not CAMERA.from_points(np.empty((0, 3))).any()


def test_the_outermost_rows_reach_as_far_beyond_as_to_their_neighbours():
    """Half of 9 degrees above 20, and half of 12 below -20."""
    up = np.radians([24.4, 24.6, -25.9, -26.1])
    points = np.stack((np.cos(up), np.zeros(4), np.sin(up)), axis=-1)
    assert_array_equal(CAMERA.pixels(points)[:, 0], [0, -1, 5, -1])


@pytest.mark.parametrize(("columns", "wraps"), [(360, True), (359, False)])
def test_a_turn_without_some_of_its_columns_is_none(columns, wraps):
    camera = pw.SphericalCamera(elevation=[1, 0], azimuth=180.0 - np.arange(columns))
    assert camera.wraps == wraps


def test_presets_have_their_beams():
    assert cameras.VELODYNE_VLP16.elevation == tuple(range(15, -16, -2))
    beams = {
        name: each.shape[0]
        for name, each in cameras.PRESETS.items()
        if "-" in name and hasattr(each, "elevation")
    }
    for name, count in beams.items():
        assert str(count) in name
    table = np.array(cameras.VELODYNE_VLS128.elevation)
    assert_allclose(np.diff(table)[20:100], -0.11, atol=1e-9)
    assert all(camera.wraps for camera in cameras.PRESETS.values() if not hasattr(camera, "fx"))


BAD = {
    "one beam": ({"elevation": [1], "azimuth": [0, 1]}, "at least 2 angles"),
    "beams out of order": ({"elevation": [3, 1, 2], "azimuth": [0, 1]}, "rows 1 and 2"),
    "the same beam twice": ({"elevation": [3, 1, 1], "azimuth": [0, 1]}, "rise or fall"),
    "a beam that is no number": ({"elevation": [3, np.nan], "azimuth": [0, 1]}, "not finite"),
    "words": ({"elevation": ["up", "down"], "azimuth": [0, 1]}, "angles in degrees"),
    "a table of beams": ({"elevation": [[1, 2]], "azimuth": [0, 1]}, "row of finite angles"),
    "overhead": ({"elevation": [90.1, 0], "azimuth": [0, 1]}, "within 90 degrees"),
    "columns out of order": ({"elevation": [1, 0], "azimuth": [0, 2, 1]}, "azimuth must rise"),
    "a gap": ({"elevation": [1, 0], "azimuth": [0, 1, 2, 50]}, "by about the same angle"),
    "the first column again": (
        {"elevation": [1, 0], "azimuth": np.linspace(180, -180, 361)},
        r"the last column is the first again; leave it out \(endpoint=False\)",
    ),
    "more than a turn": ({"elevation": [1, 0], "azimuth": np.arange(0, 400, 5)}, "once at most"),
    "offsets of other beams": (
        {"elevation": [1, 0], "azimuth": [0, 1], "azimuth_offset": [1]},
        "one angle for each of 2",
    ),
    "offsets of columns": (
        {"elevation": [1, 0], "azimuth": [0, 1, 2], "azimuth_offset": [0, 0, 0]},
        "one angle for each of 2 rows, got 3",
    ),
    "offsets of all": (
        {"elevation": [1, 0], "azimuth": np.arange(0, 90), "azimuth_offset": [90, 90]},
        "within 20 degrees",
    ),
    "stretched axes": (
        {"elevation": [1, 0], "azimuth": [0, 1], "turn": np.eye(3) * 1.001},
        "three axes of length 1 at right angles, right-handed, got array",
    ),
    "left-handed": (
        {"elevation": [1, 0], "azimuth": [0, 1], "turn": np.diag([1, 1, -1])},
        "right-handed",
    ),
    "axes that are no numbers": (
        {"elevation": [1, 0], "azimuth": [0, 1], "turn": np.full((3, 3), np.nan)},
        "right-handed",
    ),
    "one axis": ({"elevation": [1, 0], "azimuth": [0, 1], "turn": [0, 0, 1]}, "three axes"),
    "axes in words": ({"elevation": [1, 0], "azimuth": [0, 1], "turn": "up"}, "three axes"),
    "staggered": (
        {"elevation": [1, 0], "azimuth": np.arange(0, 90), "azimuth_offset": [3, -3]},
        "destagger",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_angles_are_refused(case):
    given, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        pw.SphericalCamera(**given)


def test_bad_images_and_points_are_refused():
    with pytest.raises(ValueError, match=r"6 rows and 41 columns.*transposed"):
        pw.observe(np.ones((41, 6)), CAMERA, pw.Sensor())
    with pytest.raises(ValueError, match="6 rows"):
        CAMERA.rays((6, 40))
    with pytest.raises(ValueError, match="2-D image of ranges"):
        CAMERA.points(np.ones(6))
    with pytest.raises(ValueError, match=r"integer depth, which needs it.*got uint16"):
        CAMERA.points(np.ones(CAMERA.shape, np.uint16))
    with pytest.raises(ValueError, match="integer depth"):
        CAMERA.points(np.ones(CAMERA.shape), depth_scale=0.001)
    with pytest.raises(ValueError, match=r"shape \(k, 3\), .* got shape \(3,\)"):
        CAMERA.from_points([1, 2, 3])
    with pytest.raises(ValueError, match="columns must be a whole number of at least 2"):
        pw.SphericalCamera.spinning([1, 0], 1)
    with pytest.raises(ValueError, match=r"0.524 degrees over 16 rows.* angles in degrees\?"):
        pw.SphericalCamera.spinning(np.radians(np.linspace(15, -15, 16)), 1800)


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        pw.SphericalCamera.spinning([2, 0, -3], 90, start=10, clockwise=False),
        replace(CAMERA, turn=TURN),
        replace(pw.SphericalCamera.spinning([2, 0, -3], 90), turn=TURN),
        # Rows closer than those of a spinning LiDAR, in a narrow view and all the way round.
        pw.SphericalCamera(elevation=np.linspace(0.9, -0.9, 200), azimuth=np.linspace(1, -1, 300)),
        pw.SphericalCamera(elevation=np.linspace(0.9, -0.9, 200), azimuth=180.0 - np.arange(360)),
    ],
)
def test_what_a_camera_describes_can_be_read_back(tmp_path, camera):
    path = tmp_path / "lidar.json"
    path.write_text(json.dumps(camera.describe()))
    assert read_camera(str(path)) == camera


def test_what_spins_is_described_by_its_columns():
    camera = pw.SphericalCamera.spinning([2, 0, -3], 90, start=10, clockwise=False)
    described = {"columns": 90, "start": 10, "clockwise": False}
    assert camera.describe() == {"model": "spherical", "elevation": [2, 0, -3]} | described


def test_a_short_file_will_do(tmp_path):
    path = tmp_path / "lidar.json"
    path.write_text('{"elevation": [15, 0, -15], "columns": 900}')
    camera = read_camera(str(path))
    assert camera == pw.SphericalCamera.spinning([15, 0, -15], 900)
    assert read_camera("ouster-os1-64").shape == (64, 1024)


@pytest.mark.parametrize("nested", [False, True])
def test_ouster_metadata(tmp_path, nested):
    """Destaggered images: what is left of the beams' azimuth is a fraction of a column."""
    beams = {
        "beam_altitude_angles": [10, 0, -10, -20],
        "beam_azimuth_angles": [4.21, 1.42, -1.41, -4.21],
    }
    if nested:
        form = {"columns_per_frame": 1024, "pixel_shift_by_row": [12, 4, -4, -12]}
        content = {"beam_intrinsics": beams, "lidar_data_format": form}
    else:
        content = {**beams, "lidar_mode": "1024x10"}
    path = tmp_path / "os1.json"
    path.write_text(json.dumps(content))
    camera = read_camera(str(path))
    assert camera.shape == (4, 1024)
    shifts, angles = [12, 4, -4, -12], beams["beam_azimuth_angles"]
    left = [360 * shift / 1024 - angle for shift, angle in zip(shifts, angles, strict=True)]
    assert_allclose(camera.azimuth_offset, left)


BAD_FILES = {
    "no columns": ({"elevation": [1, 0]}, "columns"),
    "columns that are a word": ({"elevation": [1, 0], "columns": "many"}, "columns 'many'"),
    "start that is a word": ({"elevation": [1, 0], "columns": 9, "start": "x"}, "start 'x'"),
    "turn that is a word": ({"elevation": [1, 0], "columns": 9, "clockwise": 1}, "clockwise 1"),
    "beams out of order": ({"elevation": [1, 2, 0], "columns": 90}, "rise or fall"),
    "beams without azimuth": ({"beam_altitude_angles": [1, 0]}, "beam_azimuth_angles is missing"),
    "no number of columns": (
        {"beam_altitude_angles": [1, 0], "beam_azimuth_angles": [0, 0]},
        "lidar_mode is missing",
    ),
    "beams that do not match": (
        {"beam_altitude_angles": [1, 0], "beam_azimuth_angles": [0, "a"], "lidar_mode": "9x10"},
        "cannot be read",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused(tmp_path, case):
    content, message = BAD_FILES[case]
    path = tmp_path / "lidar.json"
    path.write_text(json.dumps(content))
    with pytest.raises(PlanewiseError, match=message):
        read_camera(str(path))


@pytest.mark.parametrize("columns", [3, 4, 5, 1024])
def test_columns_of_a_turn_may_be_uneven(columns):
    """The last may be nearer to the first than to the one before it."""
    azimuth = np.linspace(180, -180, columns, endpoint=False)
    jitter = np.random.default_rng(0).uniform(-0.2, 0.2, columns) * 360 / columns
    camera = pw.SphericalCamera(elevation=[1, 0], azimuth=azimuth + jitter)
    assert camera.wraps


@pytest.mark.parametrize("azimuth", [(0, 359.6, 360), (180, -179.7, 512), (0, 359.7, 361)])
def test_a_turn_may_end_a_little_before_the_first_column(azimuth):
    camera = pw.SphericalCamera(elevation=[1, 0], azimuth=np.linspace(*azimuth))
    assert camera.wraps
    columns = camera.pixels(5 * camera.rays(camera.shape)[0])[:, 1]
    assert_array_equal(columns, np.arange(azimuth[2]))


@pytest.mark.parametrize("dtype", [np.int8, np.int16])
def test_points_may_be_the_least_integers(dtype):
    least = np.iinfo(dtype).min
    pixels = CAMERA.pixels(np.array([[least, 0, 0], [least, 0, 1]], dtype))
    assert_array_equal(pixels, CAMERA.pixels(np.array([[least, 0, 0], [least, 0, 1]], float)))


def test_masked_points_are_in_no_pixel():
    points = np.array([[2.0, 0, 0], [3.0, 0.2, 0]])
    masked = np.ma.array(points, mask=[[False] * 3, [True, False, False]])
    assert_array_equal(CAMERA.pixels(masked)[1], [-1, -1])
    assert_array_equal(CAMERA.from_points(masked), CAMERA.from_points(points[:1]))
