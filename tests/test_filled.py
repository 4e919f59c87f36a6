"""Depth registered to a larger picture, readings as blocks: it is searched in coarser pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.other_sensors import camera_of, frame, frame_in_metres, named
from benchmarks.registered import registered
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.enlarged.filled import filled
from planewise.enlarged.own_pixels import own_pixels
from planewise.enlarged.scattered import Scattered
from planewise.metrics import evaluate
from tests.enlarging import models_of, repeated

STEREO = named("stereo, smooth over 20 px")
SIZE = STEREO.size


def painted(times, seed=0, reading=STEREO):
    """Depth in millimetres, true labels and camera of a picture so many times as large."""
    z, labels, _ = frame_in_metres(reading, seed)
    shape = round(times * reading.size[0]), round(times * reading.size[1])
    larger, own = camera_of(shape), camera_of(reading.size)
    z, (marks,) = registered(z, own, larger, shape, labels, blocks=True)
    return np.rint(1000 * z).astype(np.uint16), marks, larger


def score(model, labels):
    return evaluate(model.labels, labels, minimum_pixels=labels.size // 400).row()


@pytest.mark.parametrize("times", [2.16, 3])
def test_planes_are_those_of_the_sensor(times):
    depth, true, camera = painted(times)
    before = depth.copy()
    model = pw.detect_planes(depth, camera, STEREO.sensor, depth_scale=0.001)
    assert_array_equal(depth, before)
    found = own_pixels(depth, camera)
    assert isinstance(found, Scattered)
    assert abs(found.camera.times / times - 1) < 0.15
    assert model.settings["own_size"] == list(found.depth.shape)
    own, labels, _ = frame(STEREO, 0)
    best = score(pw.detect_planes(own, camera_of(SIZE), STEREO.sensor), labels)
    row = score(model, true)
    assert row["voi_labelled"] < best["voi_labelled"] + 0.15
    assert row["recall@0.5"] > best["recall@0.5"] - 0.2  # borders are a pixel off, or two
    assert not model.labels[depth == 0].any()
    for label, plane in enumerate(model.planes, start=1):
        i, j = (model.labels == label).nonzero()
        assert plane.count == len(i)
        assert plane.bounding_box == (i.min(), j.min(), i.max() + 1, j.max() + 1)


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_coarse_pixels_have_the_ray_of_the_middle_of_a_block(kind):
    own = np.random.default_rng(0).uniform(1000, 2000, (100, 120)).round().astype(kind)
    shape = 250, 300  # blocks of 2 and 3 pixels, by turns; no two side by side say the same
    depth, camera = repeated(own, shape), camera_of(shape)
    depth[100:140, 200:240] = 0 if kind is np.uint16 else np.nan
    found = filled(depth, camera)
    assert abs(found.camera.times / 2.5 - 1) < 0.05
    assert_array_equal(found.there, np.nan_to_num(depth) > 0)
    there = found.depth > 0
    column, row = camera.project(found.camera.rays(there.shape)[there]).T
    # Middles lie at whole pixels, of blocks of three, or between two.
    assert_allclose(2 * column, np.rint(2 * column), atol=1e-6)
    first = np.ceil(2.5 * np.arange(121))
    middles = 0.5 * (first[1:] + first[:-1] - 1)
    assert np.isin(np.rint(2 * column) / 2, middles).mean() > 0.9
    at = np.rint(row).astype(int), np.rint(column).astype(int)
    assert np.mean(found.depth[there] == depth[at]) > 0.99
    assert found.of_reading.size == np.count_nonzero(found.there)
    # Even pixels are now and then those of the block beside.
    again = found.enlarge(found.depth)
    assert np.mean(again[found.there] == depth[found.there]) > 0.5


def test_precise_readings_stay_as_they_are():
    precise = named("2 mm")
    depth, _, camera = painted(2.5, reading=precise)
    assert filled(depth, camera) is not None
    model = pw.detect_planes(depth, camera, precise.sensor, depth_scale=0.001)
    assert "own_size" not in model.settings


def test_noise_is_that_of_the_pixels_that_are_searched():
    depth, _, camera = painted(2.5, reading=named("2 mm"))
    sensor = pw.Sensor(noise="auto", resolution=0.001)
    model = pw.detect_planes(depth, camera, sensor)
    assert "own_size" not in model.settings
    for found in (pw.estimate_noise(depth, camera, sensor), pw.calibrate([depth], camera, sensor)):
        assert str(found.noise) == model.settings["noise"]["noise"]


def test_repeated_pixels_in_a_frame_are_blocks():
    room = pw.scenes.room(0, size=(120, 160))
    depth = np.pad(np.kron(room.depth, np.ones((2, 2), np.uint16)), 9, constant_values=1500)
    assert filled(depth, camera_of(depth.shape)).camera.times == 2.0


OTHERS = {
    "as it was": lambda: painted(1),
    "blocks of one and two": lambda: painted(1.6),
    "a room": lambda: (pw.scenes.room(0).depth, None, pw.scenes.room(0).camera),
    "steps of 2 cm": lambda: (
        pw.scenes.room(1, sigma=1e-4).depth // 20 * 20,
        None,
        camera_of(SIZE),
    ),
    "a wall": lambda: (np.full(SIZE, 2000, np.uint16), None, camera_of(SIZE)),
    "nothing": lambda: (np.zeros(SIZE, np.uint16), None, camera_of(SIZE)),
    "small": lambda: (painted(3)[0][:50, :60], None, camera_of((50, 60))),
    "stripes": lambda: (
        np.repeat(painted(1)[0][:, :160], 4, axis=1),
        None,
        camera_of(SIZE),
    ),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_readings_are_no_blocks(name):
    depth, _, camera = OTHERS[name]()
    assert filled(depth, camera) is None


def test_real_frames_are_no_blocks(every_real_frame):
    assert not [each.name for each in every_real_frame if filled(each.depth, each.camera)]


def test_a_lens_may_bend_the_picture():
    depth, _, camera = painted(3)
    bent = replace(camera, distortion=(0.02, 0.0, 0.0, 0.0))
    rays = filled(depth, bent).camera.rays(filled(depth, bent).depth.shape)
    straight = filled(depth, camera).camera.rays(rays.shape[:2])
    assert_allclose(bent.project(rays), camera.project(straight), atol=1e-5)
    folded = replace(camera, distortion=(-0.29, 0.0, 0.0, 0.0))
    assert np.isnan(folded.rays(depth.shape)).any()
    assert filled(depth, folded) is None


def test_every_door_looks():
    depth, _, camera = painted(2.5)
    sensor = replace(STEREO.sensor, resolution=0.001)
    wanted = pw.detect_planes(depth, camera, sensor)
    assert "own_size" in wanted.settings
    for model in models_of(depth, camera, sensor):
        assert_array_equal(model.labels, wanted.labels)
        assert model.information == wanted.information
    auto = replace(sensor, noise="auto", parts=None)
    assert "own_size" in pw.detect_planes(depth, camera, auto).settings
    with pytest.raises(ValueError, match="camera is for images of 160 x 120 pixels"):
        pw.detect_planes(depth, replace(camera, width=160, height=120), sensor)
