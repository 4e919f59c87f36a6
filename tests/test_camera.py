from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree

import planewise as pw
from planewise import lens

SHAPE = (48, 64)
# Of an Azure Kinect: corners of the image are up to 162 pixels from where a pinhole has them.
AZURE = (3.130577, 2.324939, 0.000081, -0.000051, 0.130416, 3.458652, 3.350115, 0.662942)


def test_ray_of_the_principal_point_is_the_axis():
    camera = pw.PinholeCamera(fx=50, fy=60, cx=10, cy=20)
    rays = camera.rays(SHAPE)
    assert_allclose(rays[20, 10], [0, 0, 1])
    assert_allclose(rays[20 + 6, 10 + 5], [0.1, 0.1, 1])
    assert_allclose(camera.pixel_size, (1 / 50, 1 / 60))


@settings(max_examples=30)
@given(k1=st.floats(-0.2, 0.2), k2=st.floats(-0.05, 0.05), p=st.floats(-0.01, 0.01))
def test_distortion_is_undone(k1, k2, p):
    camera = pw.PinholeCamera(fx=60, fy=60, cx=31, cy=23, distortion=(k1, k2, p, -p))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    assert_allclose(camera.project(camera.rays(SHAPE)), np.stack((x, y), axis=-1), atol=1e-6)


@pytest.mark.parametrize(
    ("fx", "distortion"),
    [
        (577, (-0.3, 0, 0, 0)),  # r (1 - 0.3 r^2) grows up to 0.703; the corner is at 0.693
        (450, (0.5, 0.5, 0, 0)),
        (380, (0.2, 0.1, 0.002, -0.002, 0.3)),
        (440, (-0.3255, 0.1307, 0.0001, -0.0001, -0.0276)),  # one step of Newton's leads beyond
        (504, AZURE),
    ],
)
def test_strong_distortion_is_undone_up_to_where_it_folds(fx, distortion):
    camera = pw.PinholeCamera(fx=fx, fy=fx, cx=319.5, cy=239.5, distortion=distortion)
    pixels = camera.project(camera.rays((480, 640)))
    x, y = np.meshgrid(np.arange(640), np.arange(480))
    np.testing.assert_allclose(pixels, np.stack((x, y), axis=-1), atol=1e-6)
    step = np.diff(np.hypot(*np.moveaxis(camera.rays((480, 640))[240, 320:, :2], -1, 0)))
    assert (step > 0).all()


@pytest.mark.parametrize(
    "distortion",
    [
        (-0.6, 0, 0, 0),  # grows up to 0.5 only
        (-1.2, 0.5, 0, 0),  # falls and grows again: three places are seen in one
        (0, 0, 0.9, 0),
    ],
)
def test_distortion_that_folds_a_part_of_the_image_is_refused(distortion):
    camera = pw.PinholeCamera(fx=577, fy=577, cx=319.5, cy=239.5, distortion=distortion)
    with pytest.raises(ValueError, match="cannot be undone"):
        camera.rays((480, 640))


def test_pixels_beyond_a_fold_hold_no_readings():
    # r (1 - 0.33 r^2) grows up to 0.67; the corner is at 0.693.
    camera = pw.PinholeCamera(fx=577, fy=577, cx=319.5, cy=239.5, distortion=(-0.33, 0, 0, 0))
    rays = camera.rays((480, 640))
    y, x = np.mgrid[:480, :640]
    blind = np.isnan(rays[..., 0])
    distance = np.hypot(x - 319.5, y - 239.5) / 577
    limit = 2 / 3 / np.sqrt(3 * 0.33)
    assert blind[distance > limit].all()
    assert not blind[distance < limit - 2 / 577].any()
    assert_allclose(camera.project(rays[~blind]), np.stack((x, y), axis=-1)[~blind], atol=1e-6)
    assert np.isfinite(camera.pixel_area((480, 640))).all()
    assert np.isnan(camera.unproject([0, 0])[:2]).all()
    wall = np.full((480, 640), 2000, np.uint16)
    for depth in (wall, wall * 1e-3):
        model = pw.detect_planes(depth, camera, pw.Sensor(noise=0.002))
        assert len(model) == 1
        assert_allclose(model.planes[0].distance, 2.0, atol=1e-3)
        assert model.planes[0].count == np.count_nonzero(~blind)
        np.testing.assert_array_equal(model.labels == 0, blind)
    assert (wall == 2000).all()


@pytest.mark.parametrize(
    ("fx", "distortion"), [(504, AZURE), (461, AZURE[:4]), (450, (0.26, -0.8, -0.001, 0.002, 0.9))]
)
def test_lenses_are_those_of_opencv(fx, distortion):
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    if distortion is not AZURE:
        distortion = tuple(0.1 * k for k in distortion)
    camera = pw.PinholeCamera(fx=fx, fy=fx + 1, cx=332, cy=326, distortion=distortion)
    matrix = np.array([[fx, 0, 332], [0, fx + 1, 326], [0, 0, 1]], np.float64)
    rays = camera.rays((576, 640))[::5, ::5].reshape(-1, 3)
    pixels = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, np.array(distortion))[0]
    assert_allclose(camera.project(rays), pixels[:, 0], atol=1e-6)
    x, y = np.meshgrid(np.arange(0, 640, 5), np.arange(0, 576, 5))
    assert_allclose(pixels[:, 0], np.stack((x, y), axis=-1).reshape(-1, 2), atol=1e-5)


@pytest.mark.parametrize("distortion", [AZURE, (-0.3, 0.1, 0.01, -0.02, 0.05)])
def test_a_lens_stretches_as_differences_say(distortion):
    u, v = np.random.default_rng(0).uniform(-0.8, 0.8, (2, 50))
    step = 1e-6

    def slope(du, dv):
        further, before = (lens.distort(distortion, u + k * du, v + k * dv) for k in (1, -1))
        return (np.array(further) - before) / (2 * step)

    (along_u, across), (_, along_v) = slope(step, 0), slope(0, step)
    assert_allclose(lens._stretch(distortion, u, v), (along_u, along_v, across), atol=1e-8)


def test_rays_come_back_from_where_a_lens_hardly_tells_them_apart():
    """Short of its fold: from where they are seen itself, steps of Newton's would lead nowhere."""
    distortion = (0.524, -0.104, 0.0, -0.009, -0.159)
    u, v = (each.ravel() for each in np.meshgrid(np.linspace(-0.8, 0.8, 9), [-0.75, 0.0, 0.75]))
    found = lens.undistort(distortion, *lens.distort(distortion, u, v))
    assert_allclose(found, (u, v), atol=1e-6)


def test_what_no_ray_short_of_the_fold_is_seen_at_has_none():
    distortion = (0.005, -0.121, -0.002, -0.033)
    rays = np.meshgrid(np.linspace(-1.3, 1.3, 261), np.linspace(-1.3, 1.3, 261))  # it is at 1.14
    seen = cKDTree(np.reshape(lens.distort(distortion, *rays), (2, -1)).T)
    places = np.reshape(
        np.meshgrid(np.linspace(-1.2, 1.2, 25), np.linspace(-0.9, 0.9, 19)), (2, -1)
    )
    unseen = seen.query(places.T)[0] > 0.02
    assert unseen.sum() > 20
    assert np.isnan(lens.undistort(distortion, *places[:, unseen])).all()


def test_distortion_that_folds_the_image_is_refused():
    camera = pw.PinholeCamera(fx=30, fy=30, cx=31, cy=23, distortion=(-2.0, 0, 0, 0))
    with pytest.raises(ValueError, match="cannot be undone"):
        camera.rays(SHAPE)


def test_pixel_areas_sum_to_the_field():
    camera = pw.PinholeCamera(fx=60, fy=50, cx=31.5, cy=23.5)
    assert_allclose(camera.pixel_area(SHAPE).sum(), 64 * 48 / 60 / 50)
    bent = pw.PinholeCamera(fx=60, fy=50, cx=31.5, cy=23.5, distortion=(1e-6, 0, 0, 0))
    assert_allclose(bent.pixel_area(SHAPE), camera.pixel_area(SHAPE), rtol=1e-4)


def test_crop_and_scale_keep_the_rays():
    camera = pw.cameras.NYU
    crop = camera.cropped(44, 40, (427, 564))
    assert_allclose(crop.rays((427, 564)), camera.rays((480, 640))[44:471, 40:604])
    half = camera.scaled(0.5).rays((240, 320))
    full = camera.rays((480, 640))
    assert_allclose(half[3, 5], (full[6:8, 10:12]).mean(axis=(0, 1)))
    smaller = camera.scaled(0.57)  # 364.8 x 273.6 pixels
    assert (smaller.width, smaller.height) == (365, 274)
    lens = pw.PinholeCamera(fx=504, fy=504, cx=332, cy=326, distortion=AZURE)
    crop = lens.cropped(76, 40, (400, 500)).rays((400, 500))
    assert_allclose(crop, lens.rays((576, 640))[76:476, 40:540], atol=1e-8)
    assert_allclose(lens.binned(2, 2).rays((288, 320))[9, 7], lens.unproject([14.5, 18.5]))
    assert pw.PinholeCamera(**lens.describe()) == lens


@pytest.mark.parametrize("factor", [0, -1, np.nan, np.inf, "half"])
def test_a_factor_that_is_none_is_refused(factor):
    with pytest.raises(ValueError, match="factor must be a positive number, got"):
        pw.cameras.NYU.scaled(factor)


@pytest.mark.parametrize("size", [(0, 1), (1, -2), (1.5, 1), (True, 1)])
def test_bins_are_whole_pixels(size):
    with pytest.raises(ValueError, match="must be a whole number of at least 1, got"):
        pw.cameras.NYU.binned(*size)


@pytest.mark.parametrize(
    ("crop", "message"),
    [
        ((-1, 0, (9, 9)), "top must be a whole number of at least 0, got -1"),
        ((0, 0.5, (9, 9)), "left must be a whole number of at least 0, got 0.5"),
        ((0, 0, (0, 9)), r"shape must be \(height, width\), whole numbers of pixels, got \(0, 9\)"),
        ((0, 0, (9, 9, 3)), r"shape must be \(height, width\)"),
        ((0, 600, (9, 99)), "no part of the camera's image of 640 x 480 pixels"),
        ((475, 0, (9, 9)), "no part of the camera's image of 640 x 480 pixels"),
    ],
)
def test_crops_lie_inside_the_image(crop, message):
    with pytest.raises(ValueError, match=message):
        pw.cameras.NYU.cropped(*crop)


def test_a_crop_may_lie_far_from_the_principal_point():
    crop = pw.cameras.NYU.cropped(380, 0, (40, 640))
    assert crop.cy < -3 * 40
    crop.check((40, 640))
    with pytest.raises(ValueError, match=r"cy = .* far outside an image of 40 pixels"):
        replace(crop, width=None, height=None).check((40, 640))
    reach = 3.75 * crop.fy  # 75 degrees
    replace(crop, cy=40 - 0.99 * reach).check((40, 640))
    for centre in (40 - 1.01 * reach, 1.01 * reach):
        with pytest.raises(ValueError, match=r"cy = .* far outside an image of 40 pixels"):
            replace(crop, cy=centre).check((40, 640))


def test_places_and_points_may_be_lists():
    camera = pw.PinholeCamera(fx=60, fy=60, cx=31, cy=23)
    assert camera.project([[0, 0, 2], [1, 0, 2]]).tolist() == [[31, 23], [61, 23]]
    assert camera.unproject([61, 23]).tolist() == [0.5, 0, 1]


PINHOLES = {
    name: camera
    for name, camera in pw.cameras.PRESETS.items()
    if isinstance(camera, pw.PinholeCamera)
}


@pytest.mark.parametrize("name", PINHOLES)
def test_presets_suit_their_own_image(name):
    camera = PINHOLES[name]
    camera.check((camera.height, camera.width))
    with pytest.raises(ValueError, match=f"camera is for images of {camera.width} x"):
        camera.check((100, 100))


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"fx": 0}, "fx must be a positive"),
        ({"fy": -500}, "fy must be a positive"),
        ({"fx": float("nan")}, "fx must be a positive"),
        ({"cx": float("inf")}, "numbers must be finite"),
        ({"fx": np.float64(-5)}, "fx must be a positive number of pixels, got -5.0"),
        ({"fx": "500"}, "fx must be a positive number of pixels, got '500'"),
        ({"cy": None}, "numbers must be finite"),
        ({"distortion": (1, 2)}, "got 2 numbers"),
        ({"distortion": "none"}, "distortion must be numbers, got 'none'"),
        ({"width": 640}, "width and height must be given together"),
        ({"width": "640", "height": "480"}, "width and height must be .* got '640' and '480'"),
        ({"width": 640.5, "height": 480}, "width and height must be .* whole numbers"),
        ({"width": 0, "height": 480}, "width and height must be .* at least 1"),
    ],
)
def test_bad_cameras_are_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        pw.PinholeCamera(**({"fx": 500, "fy": 500, "cx": 320, "cy": 240} | kwargs))


def test_distortion_may_be_a_row_as_opencv_gives_it():
    row = np.array([[0.1, -0.2, 0.001, 0.002, 0.05]])
    camera = pw.PinholeCamera(fx=500, fy=500, cx=320, cy=240, distortion=row)
    assert camera.distortion == tuple(row[0].tolist())
    assert pw.PinholeCamera(fx=500, fy=500, cx=320, cy=240, distortion=None).distortion == ()
    assert hash(camera) == hash(pw.PinholeCamera(fx=500, fy=500, cx=320, cy=240, distortion=row))


@pytest.mark.parametrize("factor", [0.01, 0.1, 10, 100])
def test_intrinsics_of_the_wrong_order_of_magnitude_are_refused(factor):
    depth = np.full((480, 640), 2.0)
    wrong = pw.PinholeCamera(fx=525 * factor, fy=525 * factor, cx=320, cy=240)
    with pytest.raises(ValueError, match="which no depth camera does"):
        pw.observe(depth, wrong, pw.Sensor())
    wrong = pw.PinholeCamera(fx=525, fy=525, cx=320 * 10, cy=240)
    with pytest.raises(ValueError, match="cx = 3200 px lies far outside"):
        pw.observe(depth, wrong, pw.Sensor())


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_camera_sees_8_to_150_degrees_from_within_an_image_of_its_own(axis):
    size = {"x": 640, "y": 480}[axis]
    usual = {"fx": 500, "fy": 500, "cx": 320, "cy": 240}

    def check(shape=(480, 640), **given):
        pw.PinholeCamera(**usual | given).check(shape)

    widest, narrowest = (size / 2 / np.tan(np.radians(angle / 2)) for angle in (150, 8))
    for focal in (1.01 * widest, 0.97 * narrowest):
        check(**{f"f{axis}": focal})
    for focal in (0.98 * widest, 1.01 * narrowest):
        with pytest.raises(ValueError, match=f"f{axis} = .* which no depth camera does"):
            check(**{f"f{axis}": focal})
    for centre in (-size, 2 * size):
        check(**{f"c{axis}": centre})
        with pytest.raises(ValueError, match=f"c{axis} = .* far outside an image of {size} pixels"):
            check(**{f"c{axis}": centre + np.sign(centre)})
    small = {"cx": 20, "cy": 20, "shape": (40, 40)}  # a crop of a long lens
    check(**small, **{f"f{axis}": 2500})
    with pytest.raises(ValueError, match="which no depth camera does"):
        check(**small, **{f"f{axis}": 2501})


@pytest.mark.parametrize(
    ("camera", "shape"),
    [
        (pw.PinholeCamera(fx=525, fy=525, cx=20, cy=20), (40, 40)),
        (pw.PinholeCamera(fx=1586, fy=2301, cx=255, cy=255), (512, 512)),
    ],
)
def test_small_crops_of_ordinary_cameras_are_accepted(camera, shape):
    assert pw.observe(np.ones(shape), camera, pw.Sensor()).count == shape[0] * shape[1]


def test_field_of_view():
    camera = pw.cameras.from_field_of_view(640, 480, 90)
    assert camera.fx == pytest.approx(320)
    assert_allclose(camera.unproject([[-0.5, 239.5], [639.5, 239.5]]), [[-1, 0, 1], [1, 0, 1]])
    with pytest.raises(ValueError, match="between 0 and 180"):
        pw.cameras.from_field_of_view(640, 480, 180)


@pytest.mark.parametrize("name", ["check", "rays", "ray_rows", "pixel_area", "sectors"])
@pytest.mark.parametrize("camera", [pw.cameras.NYU, pw.cameras.VELODYNE_VLP16])
def test_shapes_may_be_lists_but_have_two_sides(camera, name):
    ask = getattr(camera, name)
    ask([480, 640] if camera is pw.cameras.NYU else [16, 1800])
    for wrong in ((3,), (480, 640, 3), 480, (480.0, 640), None):
        with pytest.raises(ValueError, match=r"shape must be \(height, width\)"):
            ask(wrong)


def test_bins_may_be_of_any_whole_number():
    assert pw.cameras.NYU.binned(np.uint8(2), 2) == pw.cameras.NYU.binned(2, 2)


def test_rays_of_no_place_are_nan():
    camera = pw.PinholeCamera(fx=300, fy=300, cx=160, cy=120, distortion=(-0.1, 0.01, 0, 0))
    rays = camera.unproject([[10, 20], [np.nan, 20], [30, np.nan]])
    assert_allclose(rays[0], camera.unproject([10, 20]))
    assert np.isnan(rays[1:, :2]).all()
    folds = pw.PinholeCamera(fx=300, fy=300, cx=160, cy=120, distortion=(-0.6, 0, 0, 0))
    assert np.isnan(folds.unproject([[np.nan, 0], [0, 0]])[:, :2]).all()
