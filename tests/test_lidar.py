"""Planes in range images of LiDAR: truth, seams that leave no trace, results, real scans."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import cameras, scenes
from planewise.metrics import evaluate
from tests.command import run

SENSOR = pw.Sensor(max_depth=60.0, resolution=0.002, noise=0.02)
CAMERA = pw.SphericalCamera.spinning(np.linspace(30, -30, 48), 512)
# Walls ahead, to the left, behind (across the end of the image) and to the right; floor; ceiling.
ROOM = np.array(
    [
        [-1.0, 0.0, 0.0, 4.0],
        [0.0, -1.0, 0.0, 3.0],
        [0.96, 0.28, 0.0, 5.0],
        [0.0, 1.0, 0.0, 3.5],
        [0.0, 0.0, 1.0, 1.6],
        [0.0, 0.0, -1.0, 1.4],
    ]
)


def room(camera, rng, sigma=0.02, planes=ROOM):
    """Ranges to the nearest of planes all around, and which it is."""
    rays = camera.rays(camera.shape)
    with np.errstate(divide="ignore"):
        ranges = -planes[:, 3] / (rays @ planes[:, :3].T)
    ranges[ranges <= 0] = np.inf
    noise = sigma * rng.standard_normal(camera.shape)
    return ranges.min(axis=-1) + noise, ranges.argmin(axis=-1) + 1


def nearest(model, plane):
    """The found plane that is most like a true one, and its label."""
    off = [np.linalg.norm(np.append(p.normal, p.distance) - plane) for p in model.planes]
    return model.planes[int(np.argmin(off))], int(np.argmin(off)) + 1


def voi(labels, truth):
    """Variation of information in bits, no plane a region of its own."""
    return evaluate(labels, truth).frame.variation_of_information


@pytest.mark.parametrize(
    "angles",
    [
        {},
        {"azimuth_offset": np.resize([0.4, -0.4], 48)},
        {"elevation": np.linspace(-30, 30, 48)},
        {"azimuth": np.arange(512) * 360 / 512 + 77},
    ],
    ids=["usual", "staggered", "lowest first", "counter-clockwise"],
)
def test_a_room_is_six_planes(angles):
    camera = replace(CAMERA, **angles)
    ranges, labels = room(camera, np.random.default_rng(0))
    model = pw.detect_planes(ranges, camera, SENSOR)
    assert len(model) == 6
    for j, plane in enumerate(ROOM, start=1):
        found, label = nearest(model, plane)
        assert np.degrees(np.arccos(found.normal @ plane[:3])) < 0.1
        assert abs(found.distance - plane[3]) < 0.005
        # Errors are of the size of their covariance: chi^2 of three degrees of freedom.
        off = np.append(found.normal, found.distance) - plane
        assert off @ np.linalg.pinv(found.covariance) @ off < 25
        mine = labels == j
        assert (model.labels[mine] == label).mean() > 0.97
        points = camera.points(ranges)[model.labels == label]
        assert_allclose(found.centroid, points.mean(axis=0), atol=1e-6)
        assert found.count == len(points)
        across = points @ found.normal + found.distance
        assert found.rms == pytest.approx(np.sqrt(np.mean(across**2)), rel=1e-6)
        assert 0.005 < found.rms < 0.03
    # Every plane makes the rest of the description shorter, by half a nat a reading in all.
    assert (np.diff([model.curve[n] for n in range(7)]) < 0).all()
    assert model.curve[0] - model.information > 0.5 * (model.labels > 0).sum()


def test_area_and_box_of_a_wall_across_the_end_of_the_image():
    ranges, _ = room(CAMERA, np.random.default_rng(0))
    model = pw.detect_planes(ranges, CAMERA, SENSOR)
    wall, label = nearest(model, ROOM[2])
    top, left, bottom, right = wall.bounding_box
    assert left < 512 < right
    columns = np.flatnonzero((model.labels == label).any(axis=0))
    assert set(columns) <= {column % 512 for column in range(left, right)}
    assert columns[columns > 256].min() == left
    assert columns[columns < 256].max() == right - 513
    rows = np.flatnonzero((model.labels == label).any(axis=1))
    assert (top, bottom) == (rows[0], rows[-1] + 1)
    ahead, _ = nearest(model, ROOM[0])
    assert ahead.bounding_box[3] <= 512
    # The wall ahead is 6.5 m wide and 3 m high.
    assert ahead.area == pytest.approx(6.5 * 3.0, rel=0.03)
    floor, _ = nearest(model, ROOM[4])
    assert 490 < floor.bounding_box[3] - floor.bounding_box[1] <= 512  # hidden in a far corner


@pytest.mark.parametrize("columns", [1, 37, 150, 256, 401])
def test_where_the_image_begins_does_not_matter(columns):
    """The panorama turned by some columns: the same planes, turned, and the same labels, moved."""
    scene = pw.scenes.street(2)
    plain = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    turned = pw.detect_planes(np.roll(scene.depth, columns, axis=1), scene.camera, scene.sensor)
    moved = np.roll(turned.labels, -columns, axis=1)
    # Cells lie elsewhere by one column as by many, which the smallest planes notice.
    assert voi(moved, plain.labels) < 0.25
    assert abs(turned.information - plain.information) < 0.015 * plain.information
    angle = -columns * 2 * np.pi / 1024
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    for rank, plane in enumerate(plain.planes[:5], start=1):
        there = np.bincount(moved[plain.labels == rank], minlength=len(turned) + 1)
        other = turned.planes[there[1:].argmax()]
        assert there[1:].max() > 0.9 * plane.count
        assert_allclose(other.normal, rotation @ plane.normal, atol=2e-3)
        assert other.distance == pytest.approx(plane.distance, abs=0.01)


@pytest.mark.parametrize("seam", [84, 0])
@pytest.mark.parametrize("sliver", [1, 2, -1, -2])
def test_a_sliver_beyond_a_seam(seam, sliver):
    """A board that ends a column or two beyond a seam: as found as its border elsewhere."""
    ranges, _ = room(CAMERA, np.random.default_rng(4))
    sectors = CAMERA.sectors(CAMERA.shape)
    assert seam in sectors.column[sectors.start]
    first = seam - sliver if sliver > 0 else seam - sliver - 40
    board = np.arange(first, first + 40) % 512
    away = -2.0 / (CAMERA.rays(CAMERA.shape)[:, board] @ -CAMERA.rays(CAMERA.shape)[24, board[20]])
    noise = 0.02 * np.random.default_rng(5).standard_normal(away.shape)
    ranges[10:40, board] = (away + noise)[10:40]
    labels = pw.detect_planes(ranges, CAMERA, SENSOR).labels
    label = np.bincount(labels[10:40, board].ravel()).argmax()
    assert (labels[10:40, board] == label).mean() > 0.995
    edges = (seam + np.array([-1, 0])) % 512
    on = np.isin(edges, board)
    assert (labels[10:40, edges] == label)[:, on].mean() > 0.98
    assert (labels[:, np.setdiff1d(np.arange(512), board)] == label).sum() <= 3


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("ouster-os1-128", 0.8, 0.35),
        ("ouster-os1-64", 0.85, 0.25),
        ("ouster-os1-32", 0.75, 0.3),
        ("velodyne-vls128", 0.85, 0.4),
        ("velodyne-vlp16", 0.75, 0.45),
    ],
)
def test_streets(name, least, most):
    """Planes found, of 16 beams and more."""
    hits, true, wrong = 0, 0, 0
    for seed in range(3):
        scene = pw.scenes.street(seed, camera=cameras.PRESETS[name])
        model = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
        found = scene.found(model.labels)
        hits, true = hits + found.sum(), true + len(found)
        wrong += len(model) - found.sum()
        assert voi(model.labels, scene.labels) < most
        large = np.bincount(scene.labels.ravel())[1:] > 0.04 * scene.labels.size
        assert found[large].all()
        ground, _ = nearest(model, scene.planes[0])
        assert np.degrees(np.arccos(ground.normal @ scene.planes[0][:3])) < 0.15
        assert abs(ground.distance - scene.planes[0][3]) < 0.02
    assert hits > least * true
    assert wrong <= 0.25 * hits


def test_part_of_a_turn():
    """Two sectors that are not beside each other at the ends, and one alone."""
    for span, columns in ((100, 160), (50, 80)):
        azimuth = np.linspace(span / 2, -span / 2, columns)
        camera = replace(CAMERA, azimuth=azimuth)
        ranges, labels = room(camera, np.random.default_rng(1))
        model = pw.detect_planes(ranges, camera, SENSOR)
        present = np.flatnonzero(np.bincount(labels.ravel()) > 600)
        assert len(present) <= len(model) <= len(np.unique(labels))
        for j in present:
            assert abs(nearest(model, ROOM[j - 1])[0].distance - ROOM[j - 1, 3]) < 0.01


@pytest.mark.parametrize(("rows", "columns"), [(2, 2), (3, 4), (30, 9), (5, 40), (40, 71), (9, 73)])
def test_images_of_few_rows_or_columns(rows, columns):
    """Sectors of a column or two, cells that are not filled: whatever is found is valid."""
    camera = pw.SphericalCamera.spinning(np.linspace(60, -70, rows), columns)
    ranges, _ = room(camera, np.random.default_rng(rows))
    for options in ({}, {"objective": "paper"}):
        model = pw.detect_planes(ranges, camera, SENSOR, **options)
        assert np.isfinite(model.information)
        assert [plane.count for plane in model.planes] == np.bincount(
            model.labels.ravel(), minlength=len(model) + 1
        )[1:].tolist()


def test_a_partition_needs_the_paper_s_objective():
    ranges, _ = room(CAMERA, np.random.default_rng(0))
    with pytest.raises(ValueError, match="partition with objective='spatial' needs a pinhole"):
        pw.detect_planes(ranges, CAMERA, SENSOR, partition="graph")
    model = pw.detect_planes(ranges, CAMERA, SENSOR, partition="graph", objective="paper")
    assert len(model) == 6


def test_drop_outs_are_no_readings():
    rng = np.random.default_rng(2)
    ranges, _ = room(CAMERA, rng)
    lost = rng.random(CAMERA.shape) < 0.1
    lost[:, 100:104] = lost[20] = True
    model = pw.detect_planes(np.where(lost, 0, ranges), CAMERA, SENSOR)
    again = pw.detect_planes(np.where(lost, np.nan, ranges), CAMERA, SENSOR)
    assert len(model) == 6
    assert not model.labels[lost].any()
    assert model.readings == np.count_nonzero(~lost)
    assert_array_equal(model.labels, again.labels)
    empty = pw.detect_planes(np.zeros(CAMERA.shape), CAMERA, SENSOR)
    assert not len(empty)
    assert "0 valid readings" in empty.note


def test_a_stream_and_integers_of_millimetres():
    detector = pw.Detector(CAMERA, replace(SENSOR, resolution=0.001))
    for seed in range(3):
        ranges, _ = room(CAMERA, np.random.default_rng(seed))
        millimetres = np.round(1000 * ranges).astype(np.uint16)
        once = pw.detect_planes(millimetres, CAMERA, detector.sensor)
        model = detector(millimetres)
        assert_array_equal(model.labels, once.labels)
        assert model.information == once.information
        assert len(model) == 6


@pytest.mark.parametrize("options", [{"objective": "paper"}, {"search": "sequential"}])
def test_the_paper_s_objective(options):
    ranges, labels = room(CAMERA, np.random.default_rng(3))
    model = pw.detect_planes(ranges, CAMERA, SENSOR, **options)
    assert len(model) == 6
    for plane in ROOM:
        found, _ = nearest(model, plane)
        assert np.degrees(np.arccos(found.normal @ plane[:3])) < 0.2
    # The oracle: k ln(N + 1) + 3 N ln(R / eps) + every reading on its best plane or none.
    rays = CAMERA.rays(CAMERA.shape)
    delta = np.array([ranges + p.distance / (rays @ p.normal) for p in model.planes])
    tau = np.log(60.0 / (0.02 * np.sqrt(2 * np.pi)))
    gain = np.minimum(0, delta**2 / (2 * 0.02**2) - tau)
    on = np.take_along_axis(gain, np.maximum(model.labels.astype(int) - 1, 0)[None], axis=0)[0]
    L = np.log(60.0 / 0.002)
    phi = ranges.size * (np.log(7) + L) + 18 * L + np.where(model.labels > 0, on, 0).sum()
    assert model.information == pytest.approx(phi, rel=1e-9)
    assert voi(model.labels, labels) < 0.25


@pytest.mark.parametrize("sigma", [0.01, 0.04])
def test_the_noise_of_ranges_is_estimated(sigma):
    scene = pw.scenes.street(1, sigma=sigma)
    unknown = replace(scene.sensor, noise="auto")
    found = pw.estimate_noise(scene.depth, scene.camera, unknown)
    assert_allclose(found.noise([5.0, 20.0]), sigma, rtol=0.1)
    model = pw.detect_planes(scene.depth, scene.camera, unknown)
    known = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    assert abs(len(model) - len(known)) <= 2


def test_streets_are_what_they_say():
    scene, again = pw.scenes.street(5), pw.scenes.street(5)
    assert_array_equal(scene.depth, again.depth)
    points = scene.camera.points(scene.depth * 0.001)
    for j, plane in enumerate(scene.planes, start=1):
        on = points[scene.labels == j]
        rays = on / np.linalg.norm(on, axis=1, keepdims=True)
        along = np.linalg.norm(on, axis=1) + plane[3] / (rays @ plane[:3])
        assert np.sqrt(np.mean(along**2)) == pytest.approx(0.02, rel=0.2)
    with pytest.raises(ValueError, match="sigma must be a positive"):
        pw.scenes.street(sigma=0)
    with pytest.raises(ValueError, match="lost must be a share"):
        pw.scenes.street(lost=1.0)


def test_outlines_lie_on_the_planes():
    from planewise.outlines.image import outline_image

    ranges, _ = room(CAMERA, np.random.default_rng(0))
    model = pw.detect_planes(ranges, CAMERA, SENSOR)
    surfaces = outline_image(model, CAMERA, max_depth=60.0)
    assert [surface.plane for surface in surfaces] == list(range(1, 7))
    for surface, plane in zip(surfaces, model.planes, strict=True):
        assert surface.area == pytest.approx(plane.area, rel=0.1)


def test_command_line(tmp_path):
    scene = pw.scenes.street(3)
    np.save(tmp_path / "range.npy", scene.depth)
    (tmp_path / "lidar.json").write_text(json.dumps(scene.camera.describe()))
    arguments = ["detect", str(tmp_path / "range.npy"), "--sensor", "ouster-os1"]
    arguments += ["--resolution", "0.001", "--max-depth", "65", "--noise", "0.02"]
    for camera in (str(tmp_path / "lidar.json"), "ouster-os1-64"):
        out = tmp_path / "out"
        code, _, errors = run(*arguments, "--camera", camera, "-o", out)
        assert code == 0, errors
        record = json.loads((out / "planes.json").read_text())
        assert record["frame"].startswith("x forward, y left, z up;")
        assert record["camera"]["columns"] == 1024
        assert len(record["planes"]) > 8
    code, _, errors = run(*arguments, "--camera", "velodyne-vlp16", "-o", out)
    assert code == 2
    assert "16 rows and 1800 columns" in errors


@pytest.mark.parametrize("name", ["kitti_000000", "kitti_000005"])
def test_a_sweep_of_a_real_street(real_points, name):
    """Points without order: much of the ground comes back, level, a car's height below.

    The height of its readings: a slope that begins far off would be lower where the car is.
    """
    points = real_points("lidar", name)
    camera = cameras.VELODYNE_HDL64E
    ranges = camera.from_points(points)
    assert (ranges > 0).sum() > 0.8 * len(points)
    model = pw.detect_planes(ranges, camera, pw.sensors.VELODYNE_HDL64E)
    up = np.array([plane.normal[2] for plane in model.planes])
    level = np.flatnonzero(up > np.cos(np.radians(8)))
    z = pw.observe(ranges, camera, pw.sensors.VELODYNE_HDL64E).positions()[:, 2]
    flat = model.labels[ranges > 0]
    assert all(1.5 < -z[flat == j + 1].mean() < 2.0 for j in level)
    assert np.isin(flat, level + 1).sum() > 0.25 * model.readings
    upright = [plane for plane in model.planes if abs(plane.normal[2]) < 0.3]
    assert len(level) + len(upright) == len(model) >= 5


@pytest.mark.parametrize(("unit", "said"), [((), True), (("--depth-scale", 0.001), False)])
def test_the_unit_of_whole_numbers_is_told_where_it_is_none_that_is_usual(tmp_path, unit, said):
    """An Ouster's are millimetres, though it is less fine: planes would be 12 times as far off."""
    np.save(tmp_path / "a.npy", scenes.street(0).depth)
    code, _, errors = run(
        "detect", tmp_path / "a.npy", "--camera", "ouster-os1-64", *unit, "-o", tmp_path / "out"
    )
    assert code == 0, errors
    assert ("units of 12 mm" in errors and "(--depth-scale 0.001)" in errors) == said
