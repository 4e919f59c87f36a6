"""Depth that was enlarged by linear interpolation: its planes are those of its own size."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.enlarged.interpolated import Knots
from planewise.enlarged.own_pixels import own_pixels
from planewise.kernels import knots
from tests.enlarging import along, camera_of, interpolated, places
from tests.test_frame_error import smooth

SIZE = 120, 160


@pytest.fixture(scope="module")
def room():
    return pw.scenes.room(0, size=SIZE)


SHAPES = {
    "4.5 times": (540, 720),
    "6 times": (720, 960),
    "1.5 times": (180, 240),
    "1.6 times": (192, 256),
    "twice": (240, 320),
    "2.25 times": (270, 360),
    "three times": (360, 480),
    "7.5 times": (900, 1200),
    "16 times": (1920, 2560),
    "not as high as wide": (240, 480),
}
KINDS = {
    "metres": lambda depth: 0.001 * depth,
    "single precision": lambda depth: (0.001 * depth).astype(np.float32),
    "NaN": lambda depth: np.where(depth, 0.001 * depth, np.nan),
}


@pytest.mark.parametrize("corners", [False, True])
@pytest.mark.parametrize("name", SHAPES)
def test_planes_are_those_of_the_own_size(room, name, corners):
    shape = SHAPES[name]
    depth = 0.001 * interpolated(room.depth, shape, corners=corners)
    camera = camera_of(room.camera, SIZE, shape, corners=corners)
    before = depth.copy()
    found = own_pixels(depth, camera)
    assert_allclose(found.depth, 0.001 * room.depth, atol=1e-9)
    for name in ("fx", "fy", "cx", "cy"):
        assert_allclose(getattr(found.camera, name), getattr(room.camera, name), rtol=1e-9)
    model = pw.detect_planes(depth, camera, room.sensor)
    assert_array_equal(depth, before)
    own = pw.detect_planes(0.001 * room.depth, room.camera, room.sensor)
    assert model.settings["own_size"] == list(SIZE)
    assert len(model) == len(own) > 5
    assert_allclose(model.coefficients, own.coefficients, atol=1e-6)
    assert_allclose(model.information, own.information)
    assert model.labels.dtype == np.uint16
    rows, columns = (
        np.floor(places(k, n, corners=corners) + 0.5 + 1e-9).astype(int)
        for k, n in zip(SIZE, shape, strict=True)
    )
    wanted = np.where(depth > 0, own.labels[np.ix_(rows, columns)], 0)
    assert (model.labels != wanted).mean() < 1e-4
    assert model.readings <= np.count_nonzero(depth)
    for label, plane in enumerate(model.planes, start=1):
        i, j = (model.labels == label).nonzero()
        assert plane.count == len(i) > 0
        assert plane.bounding_box == (i.min(), j.min(), i.max() + 1, j.max() + 1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["1.5 times", "twice", "2.25 times", "three times"])
def test_what_touches_a_hole_may_be_missing(room, name, kind):
    holey = room.depth.copy()
    holey[:9] = holey[-5:] = holey[40:52, 60:71] = holey[70, 100:140] = 0
    depth = KINDS[kind](interpolated(holey, SHAPES[name], holes=False))
    found = own_pixels(depth, camera_of(room.camera, SIZE, SHAPES[name]))
    own = np.nan_to_num(found.depth)
    off = np.abs(own - 0.001 * holey)
    assert off[own > 0].max() < 2e-5
    lost = (own == 0) & (holey > 0)
    assert lost.mean() < 0.03
    assert not own[holey == 0].any()
    model = pw.detect_planes(depth, camera_of(room.camera, SIZE, SHAPES[name]), room.sensor)
    assert not model.labels[~(depth > 0)].any()


def test_readings_that_are_too_near_are_missing(room):
    """As ROS writes them, REP 117."""
    shape = SHAPES["twice"]
    depth = 0.001 * interpolated(room.depth, shape)
    depth[100:140, 90:150] = -np.inf
    found = own_pixels(depth, camera_of(room.camera, SIZE, shape))
    assert found.depth.shape == SIZE
    assert not found.depth[51:69, 46:74].any()
    model = pw.detect_planes(depth, camera_of(room.camera, SIZE, shape), room.sensor)
    assert not model.labels[100:140, 90:150].any()


@pytest.mark.parametrize("name", ["1.5 times", "twice", "three times", "7.5 times"])
def test_rounding_to_integers_does_not_matter(room, name):
    shape = SHAPES[name]
    depth = np.rint(interpolated(room.depth, shape)).astype(np.uint16)
    found = own_pixels(depth, camera_of(room.camera, SIZE, shape))
    assert found.depth.dtype == np.uint16
    off = found.depth.astype(int) - room.depth
    assert np.abs(off).max() <= 2
    assert_array_equal(found.depth == 0, room.depth == 0)
    model = pw.detect_planes(depth, camera_of(room.camera, SIZE, shape), room.sensor)
    own = pw.detect_planes(room.depth, room.camera, room.sensor)
    assert abs(len(model) - len(own)) <= 2
    assert_allclose(model.coefficients[:4], own.coefficients[:4], atol=0.01)


@pytest.mark.parametrize("corners", [False, True])
@pytest.mark.parametrize("shape", [(576, 768), (600, 800), (672, 896)])
def test_little_larger_images_are_known_where_they_are_large(shape, corners):
    room = pw.scenes.room(0)
    depth = 0.001 * interpolated(room.depth, shape, corners=corners)
    found = own_pixels(depth, camera_of(room.camera, room.depth.shape, shape, corners=corners))
    off = np.abs(found.depth - 0.001 * room.depth) > 1e-6
    assert off.mean() < 1e-4  # beside holes


@settings(max_examples=40, deadline=None)
@given(st.integers(16, 60), st.floats(1.2, 12.0), st.booleans(), st.integers(0, 99))
def test_own_rows_give_back_what_was_interpolated(own, times, corners, seed):
    size = int(np.ceil(times * own))
    knots = Knots.of(size, own)[corners]
    rows = np.random.default_rng(seed).normal(2, 1, (own, 3))
    image = along(rows, places(own, size, corners=corners))
    assert_allclose(knots.enlarged(rows), image, atol=1e-9)
    assert_allclose(knots.own_rows(image), rows, atol=1e-9)
    lines = knots.lines
    assert_array_equal(np.cumsum(lines.count)[:-1], lines.first[1:])
    assert lines.count.min() >= 1
    assert lines.count.sum() == size


ROW, COLUMN = np.indices((240, 320))
OTHERS = {
    "white noise": lambda rng: 2 + rng.normal(0, 0.01, ROW.shape),
    "smooth noise": lambda rng: 2 + 0.01 * smooth(ROW.shape, 2.0, rng),
    "smooth noise that was enlarged": lambda rng: interpolated(
        2 + 0.01 * smooth(SIZE, 2.0, rng), ROW.shape
    ),
    "rows alone": lambda rng: along(
        2 + rng.normal(0, 0.01, (120, 320)), places(120, 240), holes=True
    ),
    "one depth": lambda rng: np.full(ROW.shape, 2.0),
    "a plane": lambda rng: 1 / (0.4 + 0.0005 * ROW + 0.0003 * COLUMN),
    "a plane in steps": lambda rng: np.round(1000 / (0.4 + 0.0005 * ROW + 0.0003 * COLUMN)),
    "even steps": lambda rng: np.round(1000 + 0.5 * ROW + 0.25 * COLUMN),
    "a plane in steps of disparity": lambda rng: 500 / np.round(100 + 0.25 * ROW + 0.125 * COLUMN),
    "few": lambda rng: interpolated(2 + rng.normal(0, 0.01, (15, 20)), ROW.shape),
    "few, and many times": lambda rng: interpolated(2 + rng.normal(0, 0.01, (30, 40)), ROW.shape),
    "little larger": lambda rng: interpolated(2 + rng.normal(0, 0.01, (220, 293)), ROW.shape),
    "negative": lambda rng: interpolated(rng.normal(0, 1, SIZE), ROW.shape),
    "no readings": lambda rng: np.zeros(ROW.shape),
    "not a number": lambda rng: np.full(ROW.shape, np.nan),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_images_are_searched_as_they_are(room, name):
    depth = OTHERS[name](np.random.default_rng(0))
    assert own_pixels(depth, room.camera) is None


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([np.uint16, np.float32, np.float64]),
    st.integers(1, 5),
)
def test_second_differences_show_how_they_go_on(seed, kind, step):
    rng = np.random.default_rng(seed)
    image = rng.integers(500, 4000, (40, 30)).astype(kind)
    image[rng.random(image.shape) < 0.1] = 0
    image[3] = 0
    if kind != np.uint16:
        image[rng.random(image.shape) < 0.1] = rng.choice([np.nan, np.inf, -np.inf])
    some = image[:, step // 2 :: step].astype(float)
    some[~(np.isfinite(some) & (some != 0))] = np.nan
    bend = np.diff(some, 2, axis=0)
    counts = np.isfinite(some).sum(), np.isfinite(bend).sum()
    bend = np.nan_to_num(bend)
    energy = (bend**2).sum(axis=1) + np.finfo(float).tiny
    two, product = energy[1:] + energy[:-1], (bend[1:] * bend[:-1]).sum(axis=1)
    signals = np.empty((2, 36))
    assert knots.bends_along(image, step // 2, step, signals) == counts
    assert_allclose(signals[0], (2 * product / two)[:-1], rtol=1e-12, atol=1e-12)
    assert_allclose(signals[1], energy[1:-1] / (two[:-1] + energy[2:]), rtol=1e-12)


@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([np.uint16, np.float32]))
def test_lines_that_are_alike_or_empty_are_seen(seed, down, kind):
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 2, (9, 12)).astype(kind)
    if kind != np.uint16:
        image[rng.random(image.shape) < 0.2] = np.nan
    line = rng.integers(9)
    image[line] = [image[line - 1], 0, image[line]][rng.integers(3)]
    lines = image[2:7]
    pixels, of_each = (image.T.ravel(), (12, 1, 9)) if down else (image.ravel(), (12, 12, 1))
    alike = [np.array_equal(a, b, equal_nan=kind != np.uint16) for a, b in pairwise(lines)]
    empty = [not (np.isfinite(each) & (each != 0)).any() for each in lines]
    assert knots.lines_tell(pixels, 2, 5, *of_each) == (any(alike), any(empty))
