"""Depth that was enlarged by repeating pixels: its planes and noise are those of its own size."""

from __future__ import annotations

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import planewise as pw
from planewise.enlarged.own_pixels import own_pixels
from planewise.results.planes_json import SCHEMA_FILE
from tests.command import run
from tests.enlarging import camera_of, interpolated, models_of, repeated

SIZE = 120, 160


@pytest.fixture(scope="module")
def room():
    return pw.scenes.room(0, size=SIZE)


SHAPES = {
    "twice": (240, 320),
    "three times": (360, 480),
    "once and twice by turns": (180, 240),
    "2.025 times": (243, 324),
    "not as high as wide": (240, 480),
    "15 times": (1800, 2400),
}


@pytest.mark.parametrize("centred", [False, True])
@pytest.mark.parametrize("name", SHAPES)
def test_planes_are_those_of_the_own_size(room, name, centred):
    shape = SHAPES[name]
    depth = repeated(room.depth, shape, centred=centred)
    camera = camera_of(room.camera, SIZE, shape)
    before = depth.copy()
    model = pw.detect_planes(depth, camera, room.sensor)
    own = pw.detect_planes(room.depth, room.camera, room.sensor)
    assert_array_equal(depth, before)
    assert model.settings["own_size"] == list(SIZE)
    assert len(model) == len(own) > 5
    wanted = repeated(own.labels, shape, centred=centred)
    assert (model.labels != wanted).mean() < 0.003  # some columns are a little wider than others
    assert model.labels.dtype == np.uint16
    assert model.readings == np.count_nonzero(depth)
    assert_allclose(model.information, own.information, rtol=1e-3)
    for label, (plane, small) in enumerate(zip(model.planes, own.planes, strict=True), start=1):
        mine = model.labels == label
        assert plane.count == mine.sum()
        rows, columns = mine.any(axis=1).nonzero()[0], mine.any(axis=0).nonzero()[0]
        assert plane.bounding_box == (rows[0], columns[0], rows[-1] + 1, columns[-1] + 1)
        assert_allclose(plane.coefficients, small.coefficients, atol=0.02)
        assert_allclose(plane.area, small.area, rtol=0.02)


KINDS = {
    "integers": lambda depth: depth,
    "metres": lambda depth: 0.001 * depth,
    "single precision, NaN": lambda depth: np.where(depth, 0.001 * depth, np.nan).astype("f4"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_bands_without_readings_and_crops_do_not_matter(room, kind):
    depth, shape = room.depth.copy(), (240, 320)
    depth[:9] = depth[-5:] = depth[:, :7] = depth[:, -11:] = 0
    depth, camera = KINDS[kind](repeated(depth, shape)), camera_of(room.camera, SIZE, shape)
    found = own_pixels(depth, camera)
    assert_allclose((found.camera.fx, found.camera.fy), (room.camera.fx, room.camera.fy))
    assert_array_equal(found.enlarge(found.depth)[18:-10, 14:-22], depth[18:-10, 14:-22])
    assert found.depth.shape == SIZE
    assert_array_equal(found.rows.count, 2)
    # One row less and three columns less, as of a crop.
    cut = own_pixels(depth[1:, 3:], camera.cropped(1, 3, (239, 317)))
    assert_allclose((cut.camera.fx, cut.camera.fy), (room.camera.fx, room.camera.fy))
    rays = cut.camera.rays(cut.depth.shape)
    column = 20  # an own column that is seen whole
    x = cut.columns.first[column]
    middle = camera.cropped(1, 3, (239, 317)).unproject([[x + 0.5, 100.0]])[0]
    assert_allclose(rays[50, column, 0], middle[0])


@pytest.mark.parametrize("name", SHAPES)
def test_gaps_and_rows_that_are_alike_do_not_matter(room, name):
    depth, shape = room.depth.copy(), SHAPES[name]
    depth[50:61] = depth[80:81] = depth[:, 33:90] = 0
    depth[100], depth[:, 20] = depth[101], depth[:, 21]  # nor do rows that are alike
    found = own_pixels(repeated(depth, shape), camera_of(room.camera, SIZE, shape))
    assert_array_equal(found.depth, depth)
    assert_allclose((found.camera.fx, found.camera.fy), room.camera.fx, rtol=2e-3)


STEPS = {  # every n-th row and column, and the first ones
    "every third row": ((3, 1), (0, 0)),
    "every fourth column": ((1, 4), (0, 3)),
    "every second row and column": ((2, 2), (1, 0)),
    "every third row, fifth column": ((3, 5), (2, 1)),
}


@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize("name", STEPS)
def test_rows_and_columns_that_have_readings_are_those_of_an_image(name, holes):
    (rows, columns), (top, left) = STEPS[name]
    room = pw.scenes.room(0, size=(240, 320))
    some = slice(top, None, rows), slice(left, None, columns)
    if holes:  # own rows and columns may lack readings, too
        room.depth[: rows * 20], room.depth[:, 100 : 100 + 3 * columns] = 0, 0
    depth = np.zeros_like(room.depth)
    depth[some] = room.depth[some]
    found = own_pixels(depth, room.camera)
    assert_array_equal(found.depth, room.depth[some])
    assert_allclose(found.camera.fy * rows, room.camera.fy)
    ray = found.camera.unproject([[5, 7]])[0]
    assert_allclose(ray, room.camera.rays((240, 320))[some][7, 5])
    model = pw.detect_planes(depth, room.camera, room.sensor)
    own = pw.detect_planes(found.depth, found.camera, room.sensor)
    assert model.settings["own_size"] == list(found.depth.shape)
    assert_array_equal(model.labels[some], own.labels)
    assert not model.labels[depth == 0].any()
    assert model.readings == own.readings
    for label, (plane, small) in enumerate(zip(model.planes, own.planes, strict=True), start=1):
        mine = model.labels == label
        assert plane.count == small.count == mine.sum()
        i, j = mine.any(axis=1).nonzero()[0], mine.any(axis=0).nonzero()[0]
        assert plane.bounding_box == (i[0], j[0], i[-1] + 1, j[-1] + 1)


def irregular(depth, rng):
    rows = np.sort(rng.integers(0, 120, 240))
    return depth[rows][:, np.repeat(np.arange(160), 2)]


OTHERS = {
    "as it was": lambda depth, rng: depth,
    "rows alone": lambda depth, rng: np.repeat(depth, 2, axis=0),
    "columns alone": lambda depth, rng: np.repeat(depth, 2, axis=1),
    "irregular": irregular,
    "one depth": lambda depth, rng: np.full(SIZE, 2000, np.uint16),
    "nothing": lambda depth, rng: np.zeros(SIZE, np.uint16),
    "NaN": lambda depth, rng: np.full(SIZE, np.nan),
    "the same rows": lambda depth, rng: np.tile(depth[50], (120, 1)),
    "few rows and columns": lambda depth, rng: np.kron(depth[50:60, :10], np.ones((4, 4))),
    "every second row has readings": lambda depth, rng: depth * (np.indices(SIZE)[0] % 2),
    "half of the pixels have readings": lambda depth, rng: depth * (np.indices(SIZE).sum(0) % 2),
    "few rows have readings": lambda depth, rng: depth * (np.indices(SIZE)[0] % 16 == 3),
    "any of the pixels have readings": lambda depth, rng: depth * (rng.random(SIZE) < 0.1),
    "a volume": lambda depth, rng: np.ones((4, 4, 4)),
    "a line": lambda depth, rng: np.ones(99),
    "words": lambda depth, rng: np.full((99, 99), "a"),
    "a list": lambda depth, rng: np.kron(depth, np.ones((2, 2))).tolist(),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_images_are_searched_as_they_are(room, name):
    given = OTHERS[name](room.depth, np.random.default_rng(0))
    assert own_pixels(given, room.camera) is None


def test_only_the_spatial_objective_without_a_partition_looks(room):
    depth, camera = (
        np.kron(room.depth, np.ones((2, 2), np.uint16)),
        camera_of(room.camera, SIZE, (240, 320)),
    )
    halves = np.repeat([[1, 2]], 240, axis=0).repeat(160, axis=1)
    for options, searched in (
        ({}, True),
        ({"instances": True}, True),
        ({"objective": "paper"}, False),
        ({"partition": halves}, False),
    ):
        model = pw.detect_planes(depth, camera, room.sensor, **options)
        assert ("own_size" in model.settings) == searched
        assert model.labels.shape == (240, 320)
    lidar = pw.SphericalCamera.spinning(np.linspace(15, -15, 64), 256)
    ranges = np.random.default_rng(0).uniform(4, 5, (32, 128)).repeat(2, 0).repeat(2, 1)
    assert own_pixels(ranges, lidar) is None


@pytest.mark.parametrize("marker", [65_535, 20_000, 3])
@pytest.mark.parametrize("how", [repeated, interpolated])
def test_readings_out_of_range_are_none_whatever_marks_them(room, how, marker):
    shape = (240, 320)
    depth = np.rint(how(room.depth.astype(np.float64), shape)).astype(np.uint16)
    sensor = replace(room.sensor, min_depth=0.01)
    models = []
    for mark in (0, marker):
        depth[:30] = mark
        camera = camera_of(room.camera, SIZE, shape)
        models.append(pw.detect_planes(depth, camera, sensor, depth_scale=0.001))
        metres = np.where(depth, 0.001 * depth, np.nan).astype(np.float32)
        models.append(pw.detect_planes(metres, camera, sensor))
    assert [model.settings.get("own_size") for model in models] == 4 * [list(SIZE)]
    for one, other in zip(models[:2], models[2:], strict=True):
        assert one.information == other.information
        assert_array_equal(one.labels, other.labels)
    auto = replace(sensor, noise="auto", parts=None)
    told = [
        pw.estimate_noise(each, camera, auto, depth_scale=0.001).noise([1.0, 3.0])
        for each in (np.where(depth == marker, 0, depth).astype(np.uint16), depth)
    ]
    assert_allclose(*told)


def test_any_array_is_looked_at(room):
    shape = (240, 320)
    depth, camera = repeated(room.depth, shape), camera_of(room.camera, SIZE, shape)
    wanted = pw.detect_planes(depth, camera, room.sensor)
    assert wanted.settings["own_size"] == list(SIZE)
    for given in (depth.tolist(), np.ma.masked_equal(depth, 0), depth.view(np.memmap)):
        assert pw.detect_planes(given, camera, room.sensor).information == wanted.information


@pytest.mark.parametrize(
    ("kind", "plain"),
    [(">u2", "u2"), (">i4", "i4"), (">f4", "f4"), (">f8", "f8"), ("g", "f8"), ("f2", "f8")],
)
def test_numbers_may_be_of_any_kind(room, kind, plain):
    shape = (240, 320)
    depth, camera = repeated(room.depth, shape), camera_of(room.camera, SIZE, shape)
    for image, its in ((depth, camera), (room.depth, room.camera)):
        given = (image if plain in ("u2", "i4") else 0.001 * image).astype(kind)
        found, wanted = (
            pw.detect_planes(each, its, room.sensor) for each in (given, given.astype(plain))
        )
        assert found.settings.get("own_size") == wanted.settings.get("own_size")
        assert_array_equal(found.labels, wanted.labels)
        assert found.information == wanted.information


@pytest.mark.parametrize("how", [repeated, interpolated])
def test_every_door_looks(room, how):
    shape = (240, 320)
    depth, camera = how(0.001 * room.depth, shape), camera_of(room.camera, SIZE, shape)
    wanted = pw.detect_planes(depth, camera, room.sensor)
    for model in models_of(depth, camera, room.sensor):
        assert_array_equal(model.labels, wanted.labels)
        assert model.information == wanted.information
    auto = pw.Sensor(noise="auto")
    told = pw.estimate_noise(depth, camera, auto)
    own = pw.estimate_noise(0.001 * room.depth, room.camera, auto)
    assert_allclose(told.noise([1.0, 3.0]), own.noise([1.0, 3.0]), rtol=1e-6)
    with pytest.raises(ValueError, match="camera is for images of 160 x 120 pixels"):
        pw.detect_planes(depth, replace(room.camera, width=160, height=120), room.sensor)
    with pytest.raises(ValueError, match="depth must not be negative"):
        pw.detect_planes(-1.0 * depth, camera, room.sensor)
    depth = np.where(depth == depth.max(), -1.0, depth)
    with pytest.raises(ValueError, match="depth must not be negative"):
        pw.detect_planes(depth, camera, replace(room.sensor, min_depth=0.5))


def test_the_command_line_says_so(tmp_path, room):
    shape = (240, 320)
    depth, camera = repeated(room.depth, shape), camera_of(room.camera, SIZE, shape)
    Image.fromarray(depth).save(tmp_path / "depth.png")
    numbers = ",".join(map(str, (camera.fx, camera.fy, camera.cx, camera.cy)))
    out = tmp_path / "out"
    given = ("--camera", numbers, "--sensor", "kinect-v1")
    code, text, _ = run("detect", tmp_path / "depth.png", *given, "-o", out)
    assert code == 0
    assert "depth was enlarged; its own 160 x 120 pixels were searched" in text
    record = json.loads((out / "planes.json").read_text())
    jsonschema.validate(record, json.loads(SCHEMA_FILE.read_text()))
    assert record["options"]["own_size"] == [120, 160]
    assert np.asarray(Image.open(out / "labels.png")).shape == shape
    store = tmp_path / "store"
    (tmp_path / "frames").mkdir()
    Image.fromarray(depth).save(tmp_path / "frames" / "1.png")
    code, _, errors = run("batch", tmp_path / "frames", *given, "-o", store)
    assert code == 0, errors
