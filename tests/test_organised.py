"""Depth images made of organised points, as arrays and in files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from pypcd4 import Encoding
from pypcd4 import PointCloud as OtherCloud

import planewise as pw
from planewise.errors import PlanewiseError
from planewise.files.cloud import open_cloud
from planewise.files.depth import list_depth_files, read_depth
from tests.command import run

SIZE = 240, 320
ENCODINGS = Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED


@pytest.fixture(scope="module")
def room():
    return pw.scenes.room(0, size=SIZE)


@pytest.fixture(scope="module")
def points(room):
    return room.camera.rays(SIZE) * (0.001 * room.depth)[..., None]


def parameters(camera):
    return camera.fx, camera.fy, camera.cx, camera.cy


def write_pcd(path, points, encoding=Encoding.BINARY, colour=None, shape=None):
    """Points of shape (H, W, 3) by another writer, HEIGHT and WIDTH those of `shape`."""
    height, width = shape or points.shape[:2]
    columns, names = list(points.reshape(-1, 3).T.astype(np.float32)), ["x", "y", "z"]
    if colour is not None:
        red, green, blue = colour.reshape(-1, 3).T.astype(np.uint32)
        columns.append(red << 16 | green << 8 | blue)
        names.append("rgba")
    cloud = OtherCloud.from_points(columns, names, [column.dtype.type for column in columns])
    cloud.metadata = cloud.metadata.derive(height=height, width=width)
    cloud.save(path, encoding)
    return path


def turned(points, degrees, axis):
    angle = np.radians(degrees)
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.roll([[1, 0, 0], [0, cos, -sin], [0, sin, cos]], axis, axis=(0, 1)).T


def lidar_points():
    camera = pw.SphericalCamera.spinning(np.linspace(15, -15, 32), 180)
    ranges = np.random.default_rng(0).uniform(4, 5, (32, 180))
    return camera.rays(ranges.shape) * ranges[..., None]


# Rounded points lie some tenths of a pixel off their rays, which thousands of them even out.
@pytest.mark.parametrize(
    ("form", "tolerance"),
    [
        ("zeros", 1e-9),
        ("missing", 1e-9),
        ("masked", 1e-9),
        ("single", 1e-4),
        ("list", 1e-9),
        ("rounded", 0.01),
        ("a crop", 1e-9),
        ("a corner", 1e-9),
    ],
)
def test_points_tell_their_depth_image_and_camera(room, points, form, tolerance):
    there = points[..., 2:] > 0
    made = {
        "zeros": points,
        "missing": np.where(there, points, np.nan),
        "masked": np.ma.masked_array(points, np.broadcast_to(~there, points.shape)),
        "single": points.astype(np.float32),
        "list": points.tolist(),
        "rounded": points.round(3),
        "a crop": points[100:180, 40:],
        "a corner": points[200:, 280:],
    }[form]
    image = pw.image_of_points(made)
    camera, depth = room.camera, points[..., 2]
    if form == "a crop":
        camera, depth = room.camera.cropped(100, 40, (80, 280)), depth[100:180, 40:]
    if form == "a corner":
        camera, depth = room.camera.cropped(200, 280, (40, 40)), depth[200:, 280:]
    image.camera.check(image.depth.shape)
    assert_allclose(parameters(image.camera), parameters(camera), rtol=0, atol=tolerance)
    assert (image.camera.height, image.camera.width) == depth.shape
    kind = np.float32 if form == "single" else np.float64
    assert image.depth.dtype == kind
    assert_array_equal(image.depth, (depth.round(3) if form == "rounded" else depth).astype(kind))


@pytest.mark.parametrize("name", ["a few strays", "millimetres"])
def test_what_is_passed_on(points, name):
    if name == "millimetres":  # beyond the range of any sensor
        assert pw.image_of_points(1000 * points).depth.max() > 1000
        return
    strays = points.copy()
    strays[50, ::5] += 0.5  # 64 points
    assert_allclose(pw.image_of_points(strays).camera.fx, 262.5, atol=0.5)


STAGGER = 4 * (np.arange(32)[:, None] % 2)
UNSORTED = [*range(16, 32), *range(16)]
REFUSED = {
    "moved": (lambda points: points + (0.05, 0, 0) * (points[..., 2:] > 0), "pixels off the rays"),
    "turned about x": (lambda points: turned(points, 2, 0), "pixels off the rays"),
    "turned about y": (lambda points: turned(points, 2, 1), "pixels off the rays"),
    "turned about z": (lambda points: turned(points, 2, 2), "pixels off the rays"),
    "rows and columns": (lambda points: points.swapaxes(0, 1), "pixels off the rays"),
    "in one place": (lambda points: points * 0 + 1, "pixels off the rays"),
    "y up": (lambda points: points * (1, -1, 1), "mirrored, y is not down"),
    "x left": (lambda points: points * (-1, 1, 1), "mirrored, x is not right"),
    "z backward": (lambda points: points * (1, -1, -1), "are behind the camera"),
    "x forward": (lambda points: points[..., [2, 0, 1]] * (1, -1, -1), "are behind the camera"),
    "a moved LiDAR's": (lambda _: lidar_points() + np.array([0, 0, 1]), "off the rows and columns"),
    "a LiDAR's out of step": (
        lambda _: lidar_points()[np.arange(32)[:, None], (np.arange(180) + STAGGER) % 180],
        "destagger the image",
    ),
    "a LiDAR's upside down": (lambda _: lidar_points()[UNSORTED], "sort the beams"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_points_on_the_rays_of_no_such_camera_are_refused(points, name):
    make, reason = REFUSED[name]
    with pytest.raises(ValueError, match=reason) as error:
        pw.image_of_points(make(points))
    assert "x right, y down, z forward" in str(error.value)
    assert "detect_planes_in_points" in str(error.value)


@pytest.mark.parametrize(
    "camera",
    [
        pw.cameras.OUSTER_OS1_64,
        pw.cameras.OUSTER_OS0_128,
        pw.cameras.VELODYNE_HDL32E,
        pw.SphericalCamera.panorama(64),
        pw.SphericalCamera.spinning(np.linspace(-60, 90, 76), 90, clockwise=False, start=17),
        pw.SphericalCamera(elevation=np.linspace(20, -20, 60), azimuth=np.linspace(50, -40, 120)),
        pw.SphericalCamera.spinning(
            np.linspace(15, -15, 32), 360, azimuth_offset=np.resize([0.7, -0.7, 0.1], 32)
        ),
    ],
    ids=["OS1", "OS0", "HDL-32E", "panorama", "counter-clockwise", "part", "rows off"],
)
@pytest.mark.parametrize("form", ["exact", "millimetres rounded", "missing"])
def test_points_of_a_scan_tell_its_angles(camera, form):
    rng = np.random.default_rng(0)
    ranges = rng.uniform(4, 5, camera.shape)
    height, width = camera.shape
    if form == "missing":
        ranges[: height // 4] = ranges[:, 3 * width // 5 : 4 * width // 5] = 0
        ranges[rng.random(ranges.shape) < 0.3] = 0
    points = camera.points(ranges)
    if form == "millimetres rounded":
        points = points.round(3).astype(np.float32)
    image = pw.image_of_points(points)
    close = 2e-2 if form == "millimetres rounded" else 1e-9
    off = np.resize(camera.azimuth_offset or 0.0, height)
    found = np.resize(image.camera.azimuth_offset or 0.0, height)
    seen = ranges.any(axis=1)
    assert_allclose(
        np.array(image.camera.elevation)[seen], np.array(camera.elevation)[seen], atol=close
    )
    assert_allclose(
        image.camera.rays(camera.shape)[seen], camera.rays(camera.shape)[seen], atol=close
    )
    assert (np.abs(found - off - np.median(found - off))[seen] < close).all()
    assert_allclose(image.depth, ranges, atol=2e-3 if points.dtype == np.float32 else 1e-9)
    assert image.depth.dtype == points.dtype
    assert np.abs(image.camera.azimuth).min() < 90
    assert np.abs(np.mean(image.camera.azimuth)) <= 180


@pytest.mark.parametrize("part", [slice(None), slice(60, 120)], ids=["all", "part of a turn"])
@pytest.mark.parametrize("degrees", [0.05, 0.3, 3, 40, 90, 170])
@pytest.mark.parametrize("axis", [0, 1])
def test_points_of_a_tilted_scan_tell_its_axes(axis, degrees, part):
    points = turned(lidar_points()[:, part], degrees, axis)
    image = pw.image_of_points(points)
    assert image.camera.turn or degrees < 0.1  # there columns are 2 degrees apart
    off = 1e-9 if image.camera.turn else np.radians(0.1)
    assert_allclose(image.camera.rays(image.depth.shape) * image.depth[..., None], points,
                    atol=5 * off)  # fmt: skip
    assert_allclose(image.camera.axes @ image.camera.axes.T, np.eye(3), atol=1e-12)
    rounded = pw.image_of_points(points.round(3).astype(np.float32)).camera
    assert_allclose(rounded.rays(rounded.shape), image.camera.rays(rounded.shape), atol=2e-3)


def test_planes_of_a_scan_are_those_of_its_ranges():
    scene = pw.scenes.panorama(1, camera=pw.SphericalCamera.panorama(128))
    image = pw.image_of_points(scene.camera.points(0.001 * scene.depth))
    ours = pw.detect_planes(image.depth, image.camera, scene.sensor)
    theirs = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    assert len(ours) == len(theirs) > 6
    assert (ours.labels == theirs.labels).mean() > 0.999
    assert_allclose(ours.coefficients, theirs.coefficients, atol=1e-4)


def test_points_of_a_lens_with_distortion_are_refused():
    lens = pw.PinholeCamera(fx=365, fy=365, cx=255, cy=211, distortion=(0.09, -0.27, 0, 0))
    with pytest.raises(ValueError, match="without distortion"):
        pw.image_of_points(2 * lens.rays((424, 512)))


@pytest.mark.parametrize("shape", [(12, 3), (3, 4, 2), (), (2, 3, 4, 3)])
def test_shapes_of_no_image_are_refused(shape):
    with pytest.raises(ValueError, match=r"points must have shape \(H, W, 3\)"):
        pw.image_of_points(np.ones(shape))


def test_too_few_points_and_other_things_are_refused(points):
    few = np.full((9, 9, 3), np.nan)
    few[2:5, 2:5] = points[2:5, 2:5]
    for each in (few, points[:1], points[:, 7:8], np.zeros((4, 4, 3)), np.empty((0, 5, 3))):
        with pytest.raises(ValueError, match="more than one row and column"):
            pw.image_of_points(each)
    with pytest.raises(ValueError, match="real numbers"):
        pw.image_of_points(points.astype(complex))


def test_numbers_without_bounds_are_no_warnings(points):
    for scale in (1e-300, 1e300):
        assert_allclose(pw.image_of_points(scale * points).camera.fx, 262.5)
    wild = 10.0 ** np.random.default_rng(0).uniform(-308, 308, (9, 9, 3))
    with pytest.raises(ValueError, match="off the rays"):
        pw.image_of_points(wild)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_file_is_read_as_the_image(tmp_path, room, points, encoding):
    missing = np.where(points[..., 2:] > 0, points, np.nan)
    path = write_pcd(tmp_path / "scene.pcd", missing, encoding, room.rgb)
    assert open_cloud(path).shape == SIZE
    frame = read_depth(path)
    assert_allclose(frame.depth, points[..., 2], rtol=1e-6)
    assert_array_equal(frame.depth == 0, room.depth == 0)
    assert_allclose(parameters(frame.camera), parameters(room.camera), atol=1e-3)
    assert_array_equal(frame.rgb, room.rgb)
    assert frame.depth_scale is None
    assert read_depth(write_pcd(tmp_path / "b.pcd", points, encoding)).rgb is None


def test_files_of_no_image_are_refused(tmp_path, points, monkeypatch):
    loose = write_pcd(tmp_path / "loose.pcd", points[:4, :9], shape=(1, 36))
    column = write_pcd(tmp_path / "column.pcd", points[:4, :9], shape=(36, 1))
    for path in (loose, column):
        assert open_cloud(path).shape is None
        with pytest.raises(PlanewiseError, match=r"^depth: .*\.pcd holds.*'planewise points'"):
            read_depth(path)
    moved = write_pcd(tmp_path / "moved.pcd", turned(points, 5, 1))
    with pytest.raises(PlanewiseError, match=r"^depth: moved.pcd is no depth image; points: 9"):
        read_depth(moved)
    cut = tmp_path / "cut.pcd"
    cut.write_bytes(moved.read_bytes()[:-999])
    with pytest.raises(PlanewiseError, match=r"^depth: cut.pcd is cut short"):
        read_depth(cut)
    monkeypatch.setattr("planewise.files.depth.MAX_PIXELS", 1000)
    with pytest.raises(PlanewiseError, match=r"^depth: moved.pcd claims 76,800 values"):
        read_depth(moved)


def test_a_scan_in_a_file_is_searched_as_its_image(tmp_path):
    scene = pw.scenes.street(0)
    points = scene.camera.points(0.001 * scene.depth)
    path = write_pcd(tmp_path / "sweep.pcd", points, colour=scene.rgb)
    code, _, errors = run("detect", path, "--sensor", "ouster-os1", "-o", tmp_path / "out")
    assert (code, errors) == (0, "")
    told = json.loads((tmp_path / "out" / "planes.json").read_text())
    assert told["camera"]["model"] == "spherical"
    assert_allclose(told["planes"][0]["normal"], [0, 0, 1], atol=0.01)
    assert len(told["planes"]) > 10
    with Image.open(tmp_path / "out" / "labels.png") as labels:
        assert labels.size == scene.depth.shape[::-1]


def test_clouds_beside_depth_images_are_no_frames(tmp_path, points):
    write_pcd(tmp_path / "1.pcd", points)
    with pytest.raises(PlanewiseError, match="holds no depth files"):
        list_depth_files(tmp_path)
    Image.fromarray(np.ones((9, 9), np.uint16)).save(tmp_path / "1.png")
    assert [path.name for path in list_depth_files(tmp_path)] == ["1.png"]


def test_the_command_line_finds_the_planes_of_the_image(tmp_path, room, points):
    path = write_pcd(tmp_path / "scene.pcd", points, colour=room.rgb)
    metres = points[..., 2].astype(np.float32)
    np.savez(tmp_path / "scene.npz", depth=metres, K=parameters(room.camera))
    labels, records = [], []
    for source, given in (
        (path, ()),
        (tmp_path / "scene.npz", ()),
        (path, ("--camera", "300,300,159.5,119.5")),
    ):
        out = tmp_path / "out"
        code, _, errors = run("detect", source, "--sensor", "kinect-v1", *given, "-o", out)
        assert (code, errors) == (0, "")
        labels.append(np.asarray(Image.open(out / "labels.png")))
        records.append(json.loads((out / "planes.json").read_text()))
    assert (labels[0] == labels[1]).mean() > 0.999
    of_points, of_image, of_given = records
    assert len(of_points["planes"]) == len(of_image["planes"]) > 5
    for ours, theirs in zip(of_points["planes"], of_image["planes"], strict=True):
        assert_allclose(ours["normal"], theirs["normal"], atol=1e-4)
    assert_allclose(of_points["camera"]["fx"], room.camera.fx, atol=1e-3)
    assert of_given["camera"]["fx"] == 300
