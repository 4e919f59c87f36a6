"""Clouds that are one depth image: found whatever their order and frame, searched as that image."""

from __future__ import annotations

import json
from dataclasses import replace

import jsonschema
import numpy as np
import plyfile
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.metrics import evaluate
from planewise.pixel_lattice import pixel_lattice
from planewise.results.planes_json import SCHEMA_FILE
from tests.command import run
from tests.test_organised import write_pcd

SIZE = 120, 160
SIN, COS = np.sin(np.radians(10)), np.cos(np.radians(10))
FRAMES = {  # axes of the camera, x right, y down, z forward, in the frame of a cloud, as rows
    "camera": np.eye(3),
    "graphics": np.diag((1.0, -1.0, -1.0)),
    "robot": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),
    "z up": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "10 degrees down": np.array([[1.0, 0, 0], [0, -SIN, -COS], [0, COS, -SIN]]),
}
MADE = {
    "in order": lambda points, rng: points,
    "shuffled": lambda points, rng: rng.permutation(points),
    "in single precision": lambda points, rng: points.astype(np.float32),
    "rounded to 0.1 mm": lambda points, rng: points.round(4),
    "two thirds of them": lambda points, rng: points[rng.random(len(points)) < 0.67],
    "a few strays": lambda points, rng: points + (rng.random((len(points), 1)) < 0.005) * 0.05,
}


@pytest.fixture(scope="module")
def room():
    return pw.scenes.room(0, size=SIZE)


def points_of(room, turn=FRAMES["camera"], origin=(0, 0, 0)):
    """Points of the readings in the frame of a cloud, and the true label of each."""
    there = room.depth > 0
    points = (room.camera.rays(room.depth.shape) * (0.001 * room.depth)[..., None])[there]
    return points @ turn + origin, room.labels[there]


def intrinsics(camera):
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def any_turn(rng):
    return np.linalg.qr(rng.normal(size=(3, 3)))[0]


@pytest.mark.parametrize("name", FRAMES)
def test_the_camera_is_found_in_the_frames_that_there_are(room, name):
    points, _ = points_of(room, FRAMES[name])
    image = pw.image_of_cloud(points)
    assert_allclose(intrinsics(image.camera), intrinsics(room.camera), atol=1e-6)
    assert_allclose(image.turn, FRAMES[name], atol=1e-9)  # the right way up
    assert_allclose(image.depth, 0.001 * room.depth, atol=1e-9)
    assert_array_equal(image.pixel, np.flatnonzero(room.depth))


@pytest.mark.parametrize("made", MADE)
def test_whatever_the_order_and_the_digits(room, made):
    rng = np.random.default_rng(1)
    turn, origin = any_turn(rng), np.array([3.0, -2.0, 1.0])
    points = MADE[made](points_of(room, turn, origin)[0], rng)
    image = pw.image_of_cloud(points, origin)
    exact = made in ("in order", "shuffled", "two thirds of them")
    focal = (image.camera.fx, image.camera.fy)
    assert_allclose(focal, room.camera.fx, atol=1e-6 if exact else 0.1)
    assert_allclose(np.linalg.det(image.turn), 1)
    on = image.pixel >= 0
    assert on.mean() > 0.99
    # The points are where the depth image and its camera say.
    rays = image.camera.rays(image.depth.shape).reshape(-1, 3)[image.pixel[on]]
    again = (rays * image.depth.ravel()[image.pixel[on], None]) @ image.turn + origin
    assert np.quantile(np.abs(again - points[on]), 0.999) < (1e-9 if exact else 2e-3)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    focal=st.floats(140, 1500),  # within what `PinholeCamera.check` takes, at any aspect
    aspect=st.floats(0.6, 1.6),
    centre=st.tuples(st.floats(-200, 300), st.floats(-200, 300)),
    scale=st.floats(1e-3, 1e3),
)
def test_any_camera_is_found(seed, focal, aspect, centre, scale):
    rng = np.random.default_rng(seed)
    camera = pw.PinholeCamera(fx=focal, fy=aspect * focal, cx=centre[0], cy=centre[1])
    turn = any_turn(rng)
    depth = scale * rng.uniform(1, 4, (40, 60))
    points = (camera.rays((40, 60)) * depth[..., None]).reshape(-1, 3) @ turn
    image = pw.image_of_cloud(points)
    assert (image.pixel >= 0).all()
    found, true = ((each.fx, each.fy) for each in (image.camera, camera))
    assert_allclose(sorted(found), sorted(true), rtol=0, atol=5e-4)  # rows may be columns
    assert image.depth.shape in ((40, 60), (60, 40))
    assert_allclose(np.sort(image.depth.ravel()), np.sort(depth.ravel()))
    assert_allclose(image.turn @ image.turn.T, np.eye(3), atol=1e-9)


def test_rows_and_columns_that_were_left_out_are_not_missed(room):
    there = room.depth[::2, ::2] > 0
    points = (room.camera.rays(SIZE) * (0.001 * room.depth)[..., None])[::2, ::2][there]
    image = pw.image_of_cloud(points)
    assert image.depth.shape == (60, 80)
    assert_allclose(image.camera.fx, room.camera.fx / 2, atol=1e-6)


def test_points_without_a_pixel_have_no_label(room):
    points, _ = points_of(room)
    odd = points[:60].copy()
    odd[:10] = np.nan
    odd[10:20] = 0
    odd[20:30] *= 1.2  # behind those in sight
    odd[30:40] += 0.013  # off the rays
    image = pw.image_of_cloud(np.vstack((points, odd)))
    assert (image.pixel[: len(points)] >= 0).all()
    assert (image.pixel[len(points) :] >= 0).tolist() == 40 * [False] + 20 * [True]  # copies
    model = image.in_cloud(pw.detect_planes(image.depth, image.camera, room.sensor))
    assert not model.labels[len(points) : len(points) + 40].any()
    assert_array_equal(model.labels[len(points) + 40 :], model.labels[40:60])
    assert sum(plane.count for plane in model.planes) == np.count_nonzero(model.labels)
    assert model.readings == len(points) + 20


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (3.0, -20.0, 1.0)])
def test_planes_come_back_in_the_frame_of_the_points(room, origin):
    rng = np.random.default_rng(2)
    points, _ = points_of(room, any_turn(rng), origin)
    points = rng.permutation(points)
    before = points.copy()
    image = pw.image_of_cloud(points, origin)
    seen = pw.detect_planes(image.depth, image.camera, room.sensor)
    model = image.in_cloud(seen)
    assert_array_equal(points, before)
    assert len(model) == len(seen) > 5
    assert model.labels.dtype == np.uint16
    assert_array_equal(model.labels, seen.labels.ravel()[image.pixel])
    for label, (plane, there) in enumerate(zip(model.planes, seen.planes, strict=True), start=1):
        mine = points[model.labels == label]
        off = mine @ plane.normal + plane.distance
        assert plane.distance >= 0
        assert_allclose(np.linalg.norm(plane.normal), 1)
        assert_allclose(plane.rms, np.sqrt(np.mean(off**2)), rtol=1e-9)
        assert_allclose(plane.centroid, mine.mean(axis=0), atol=0.02)
        assert plane.count == len(mine) == there.count
        assert plane.bounding_box == ()
        # How far a place off the plane is does not depend on the frame, nor what is known of it.
        place = rng.normal(size=3)
        inside = image.turn @ (place - np.array(origin))
        ours, theirs = np.append(place, 1), np.append(inside, 1)
        assert_allclose(abs(ours @ plane.coefficients), abs(theirs @ there.coefficients))
        assert_allclose(
            ours @ plane.covariance @ ours, theirs @ there.covariance @ theirs, rtol=1e-6
        )
    with pytest.raises(ValueError, match="model must be that of the image"):
        replace(image, depth=image.depth[:-1]).in_cloud(seen)


def test_labels_are_better_than_those_of_points():
    room = pw.scenes.room(0)
    points, truth = points_of(room, FRAMES["robot"])
    points = points.astype(np.float32)  # a little off the steps of depth
    sensor = pw.Sensor(max_depth=10.0, noise="auto")
    as_image = pw.detect_planes_in_points(points, sensor)
    as_points = pw.detect_planes_in_points(points, sensor, as_image=False)
    assert "image" in as_image.settings
    assert "image" not in as_points.settings
    image = pw.image_of_cloud(points)
    again = image.in_cloud(pw.detect_planes(image.depth, image.camera, sensor))
    assert_array_equal(as_image.labels, again.labels)
    voi = [
        evaluate(model.labels[None], truth[None]).row()["voi_labelled"]
        for model in (as_image, as_points)
    ]
    assert voi[0] < 0.04
    assert voi[1] > 0.2  # where no longer, neither need images be better, nor this be said


def test_points_of_a_crop_are_searched_as_its_image(room):
    auto = pw.Sensor(max_depth=10.0, noise="auto")
    below, shape = slice(96, None), (24, 160)
    pixels = room.camera.rays(SIZE) * (0.001 * room.depth)[..., None]
    found = pw.detect_planes_in_points(pixels[below][room.depth[below] > 0], auto)
    image = pw.detect_planes(room.depth[below], room.camera.cropped(96, 0, shape), auto)
    assert len(found) == len(image) > 0
    assert_array_equal(found.labels, image.labels[room.depth[below] > 0])


def test_points_of_a_camera_that_takes_no_depth_images_are_searched_as_points():
    long = pw.PinholeCamera(fx=4000, fy=4000, cx=20, cy=20)  # a degree
    points = long.rays((40, 40)).reshape(-1, 3) * 2.0
    with pytest.raises(ValueError, match=r"fx = 4000 px sees .* no depth camera does"):
        pw.image_of_cloud(points)
    found = pw.detect_planes_in_points(points, pw.Sensor(max_depth=10.0, noise="auto"))
    assert len(found) == 1
    assert "image" not in found.settings


def test_whether_points_are_searched_as_an_image_can_be_said(room):
    points, _ = points_of(room)
    auto = pw.Sensor(max_depth=10.0, noise="auto")
    for sensor, as_image, searched in (
        (auto, None, True),
        (auto, False, False),
        (room.sensor, None, False),
        (room.sensor, True, True),
    ):
        model = pw.detect_planes_in_points(points, sensor, as_image=as_image)
        assert ("image" in model.settings) == searched
    # A cloud's points are within any range.
    near = replace(auto, max_depth=1.0, min_depth=0.9)
    model = pw.detect_planes_in_points(points, near)
    assert model.readings == len(points)
    with pytest.raises(ValueError, match="points: no camera at"):
        pw.detect_planes_in_points(points + 1, auto, as_image=True)
    with pytest.raises(ValueError, match="as_image needs the noise of a sensor"):
        pw.detect_planes_in_points(points, auto, sigma=np.ones(len(points)), as_image=True)
    with pytest.raises(ValueError, match="as_image needs objective='spatial'"):
        pw.detect_planes_in_points(points, room.sensor, objective="paper", as_image=True)


def lidar(rng):
    camera = pw.SphericalCamera.spinning(np.linspace(15, -15, 32), 180)
    return (camera.rays((32, 180)) * rng.uniform(4, 5, (32, 180))[..., None]).reshape(-1, 3)


def two_views(room):
    points, _ = points_of(room)
    return np.vstack((points, points @ any_turn(np.random.default_rng(3)) + 0.1))


REFUSED = {
    "points at random": lambda rng, room: rng.uniform(1, 2, (5000, 3)),
    "a LiDAR's": lambda rng, room: lidar(rng),
    "moved": lambda rng, room: points_of(room)[0] + (0.2, 0, 0),
    "two views": lambda rng, room: two_views(room),
    "all behind each other": lambda rng, room: np.vstack([k * points_of(room)[0] for k in (1, 2)]),
    "one in four": lambda rng, room: rng.permutation(points_of(room)[0])[:4000],
    "noise across the rays": lambda rng, room: (
        points_of(room)[0] + rng.normal(0, 0.01, (np.count_nonzero(room.depth), 3))
    ),
    "in a line": lambda rng, room: np.outer(rng.uniform(1, 2, 2000), (1, 2, 3)),
    "copies": lambda rng, room: np.repeat(points_of(room)[0][::40], 40, axis=0),
    "in one place": lambda rng, room: np.ones((2000, 3)),
    "along one row": lambda rng, room: np.tile(room.camera.rays(SIZE)[5], (20, 1)),
    "any lengths": lambda rng, room: 10.0 ** rng.uniform(-308, 308, (2000, 3)),
    "a tilted grid": lambda rng, room: np.stack(
        (x := np.mgrid[1:2:0.02, 1:2:0.02][0], y := x.T, 0.5 + 0.3 * x + 0.2 * y), -1
    ).reshape(-1, 3),
    "a grid of heights": lambda rng, room: np.stack(
        (*np.mgrid[0:60, 0:60], rng.normal(5, 1, (60, 60))), -1
    ).reshape(-1, 3),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_depth_image_is_refused(room, name):
    points = REFUSED[name](np.random.default_rng(0), room)
    with pytest.raises(ValueError, match=r"^points: no camera at \[0.0, 0.0, 0.0\]"):
        pw.image_of_cloud(points)


def test_malformed_arguments_are_refused(room):
    points, _ = points_of(room)
    for wrong, reason in (
        (points[:999], "has pixels on which 1,000 or more lie"),
        (np.full((2000, 3), np.nan), "has pixels on which 1,000 or more lie"),
        (np.zeros((2000, 3)), "has pixels on which 1,000 or more lie"),
        (np.empty((0, 3)), "has pixels on which 1,000 or more lie"),
        (points[:, :2], "shape"),
        (points.astype(complex), "real numbers"),
    ):
        with pytest.raises(ValueError, match=reason):
            pw.image_of_cloud(wrong)
    for origin, reason in ((points, "that of one camera"), ((0, 0, np.nan), "finite")):
        with pytest.raises(ValueError, match=reason):
            pw.image_of_cloud(points, origin)


def test_few_directions_are_no_lattice():
    assert pixel_lattice(np.random.default_rng(0).normal(size=(149, 3))) is None


@pytest.mark.parametrize("origin", [(), ("--origin", "3,-2,1"), ("--origin", "file")])
def test_the_command_line_searches_the_image(tmp_path, room, origin):
    stood = np.array([3.0, -2.0, 1.0]) if origin else np.zeros(3)
    points, _ = points_of(room, FRAMES["robot"], stood)
    path, out = tmp_path / "cloud.npz", tmp_path / "out"
    np.savez(path, points=points, origins=stood[None])
    code, text, errors = run("points", path, *origin, "-o", out)
    assert (code, errors) == (0, "")
    assert text.strip().endswith(
        "these are points of one depth image, 160 x 120 pixels, and searched as that; "
        "'--as points' takes them as points"
    )
    record = json.loads((out / "planes.json").read_text())
    jsonschema.validate(record, json.loads(SCHEMA_FILE.read_text()))
    image = record["options"]["image"]
    assert (image["width"], image["height"]) == (160, 120)
    assert_allclose(image["turn"], FRAMES["robot"], atol=1e-9)
    assert_allclose(image["origin"], stood)
    assert_allclose(image["camera"]["fx"], room.camera.fx)
    vertex = plyfile.PlyData.read(str(out / "labelled.ply"))["vertex"]
    assert_array_equal(np.stack([vertex[name] for name in "xyz"], axis=1), points)
    extent = np.linalg.norm(np.ptp(points, axis=0))
    as_image = pw.detect_planes_in_points(
        points, pw.Sensor(max_depth=extent, noise="auto"), origin=stood
    )
    assert_array_equal(vertex["plane"], as_image.labels)
    assert_allclose(record["information"], as_image.information)
    for told in record["planes"]:
        mine = points[vertex["plane"] == told["label"]]
        off = mine @ told["normal"] + told["distance"]
        assert_allclose(told["rms"], np.sqrt(np.mean(off**2)), rtol=1e-6)


def test_how_points_are_taken_can_be_said(tmp_path, room):
    points, _ = points_of(room)
    for name, each in (("image", points), ("moved", points + 1)):
        np.save(tmp_path / f"{name}.npy", each)
    organised = write_pcd(
        tmp_path / "image.pcd", room.camera.rays(SIZE) * (0.001 * room.depth)[..., None]
    )
    code, text, _ = run("points", organised, "--sigma", 0.03, "-o", tmp_path / "of_pcd")
    assert code == 0
    assert text.strip().endswith("and '--as image' tells its planes better")
    out = tmp_path / "out"
    told = "and '--as image' tells its planes better"
    for name, options, said in (
        ("image", ("--sigma", 0.03), told),
        ("image", ("--sigma", 0.03, "--as", "image"), "and searched as that"),
        ("image", ("--as", "points"), ""),
        ("image", ("--tiles", 20_000), ""),
        ("moved", (), ""),
    ):
        code, text, _ = run("points", tmp_path / f"{name}.npy", *options, "-o", out)
        assert code == 0
        assert ("one depth image" in text) == bool(said)
        assert said in text
        record = json.loads((out / "planes.json").read_text())
        assert ("image" in record["options"]) == ("searched" in said)
        if "--sigma" in options:
            assert record["sensor"]["noise"].startswith("0.03")
    for name, options, reason in (
        (
            "moved",
            (),
            "as: points: no camera at [0.0, 0.0, 0.0] has pixels on which 1,000 or more lie",
        ),
        ("image", ("--tiles", 20_000), "as: an image is searched in one piece, without --tiles"),
    ):
        code, _, errors = run(
            "points", tmp_path / f"{name}.npy", "--as", "image", *options, "-o", out
        )
        assert code == 2
        assert reason in errors


REAL = {  # focal length, width and height
    "caixa_1": (525.0, 274, 243),
    "caixa_3": (525.0, 125, 154),
    "mhz_scene1_12": (380.61, 599, 389),
    "mhz_scene8_4": (380.61, 600, 262),
}


@pytest.mark.parametrize("name", REAL)
def test_real_clouds_of_depth_cameras_are_their_images(real_points, name):
    image = pw.image_of_cloud(real_points("clouds_indoor", name))
    focal, width, height = REAL[name]
    assert_allclose(image.camera.fx, focal, atol=0.01)
    assert image.depth.shape == (height, width)
    assert (image.pixel >= 0).all()
    model = pw.detect_planes(image.depth, image.camera, pw.Sensor(max_depth=10.0, noise="auto"))
    assert 1 <= len(model) <= 12  # pieces of their steps were 63, 12, 130 and 5
