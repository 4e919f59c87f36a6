"""Depth registered to a larger picture without filling: it is searched in coarser pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.registered import registered
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.enlarged.own_pixels import own_pixels
from planewise.enlarged.scattered import Scattered
from planewise.metrics import evaluate
from planewise.own_camera import checked_camera
from tests.enlarging import camera_of, models_of


@pytest.fixture(scope="module")
def room():
    return pw.scenes.room(0)


def in_a_picture(room, times):
    """Depth, true labels and camera of a picture so many times as large, beside the camera's."""
    own = room.depth.shape
    shape = round(times * own[0]), round(times * own[1])
    camera = camera_of(room.camera, own, shape)
    z, (labels,) = registered(0.001 * room.depth, room.camera, camera, shape, room.labels)
    return np.rint(1000 * z).astype(np.uint16), labels, camera


@pytest.mark.parametrize("times", [1.6, 1.83, 2, 2.5, 3, 4])
def test_planes_are_those_of_coarser_pixels(room, times):
    depth, true, camera = in_a_picture(room, times)
    before = depth.copy()
    model = pw.detect_planes(depth, camera, room.sensor)
    assert_array_equal(depth, before)
    found = own_pixels(depth, camera)
    assert isinstance(found, Scattered)
    assert model.settings["own_size"] == list(found.depth.shape)
    own = pw.detect_planes(room.depth, room.camera, room.sensor)
    best = evaluate(own.labels, room.labels).row()
    row = evaluate(model.labels, true, minimum_pixels=400).row()
    assert row["recall@0.5"] > best["recall@0.5"] - 0.08
    assert row["voi_labelled"] < best["voi_labelled"] + 0.1
    assert_allclose(np.abs(model.coefficients[:3, 3]), np.abs(own.coefficients[:3, 3]), atol=0.06)
    assert not model.labels[depth == 0].any()
    assert model.readings == np.count_nonzero(depth)
    for label, plane in enumerate(model.planes, start=1):
        i, j = (model.labels == label).nonzero()
        assert plane.count == len(i)
        assert plane.bounding_box == (i.min(), j.min(), i.max() + 1, j.max() + 1)


@pytest.mark.parametrize("kind", [np.uint16, np.float32])
def test_coarse_pixels_have_a_reading_and_its_ray(room, kind):
    depth, _, camera = in_a_picture(room, 2.5)
    depth = depth.astype(kind)
    depth[100:140, 200:300] = 0 if kind is np.uint16 else np.nan
    found = own_pixels(depth, camera)
    rays, shape = found.camera.rays(found.depth.shape), found.depth.shape
    assert_array_equal(found.there, np.nan_to_num(depth) > 0)
    there = found.depth > 0
    column, row = np.rint(camera.project(rays[there])).astype(int).T
    assert_array_equal(found.depth[there], depth[row, column])
    assert_allclose(rays[there], camera.rays(depth.shape)[row, column], atol=1e-12)
    assert len(np.unique(row * depth.shape[1] + column)) == there.sum()
    assert np.bincount(found.of_reading).astype(bool).sum() == there.sum()
    # What goes with other cameras, goes with this one.
    checked_camera(found.camera)
    assert_allclose(found.camera.ray_rows(shape).T.reshape(rays.shape), rays)
    middle = found.camera.unproject(np.stack(np.meshgrid(*map(np.arange, shape[::-1])), -1))
    assert np.abs(middle - rays)[..., :2].max() < 1.01 * max(found.camera.pixel_size)
    assert_allclose(found.camera.pixel_area(shape), np.prod(found.camera.pixel_size))
    assert found.camera.describe()["parent"] == camera.describe()
    assert not found.camera.bends
    assert not found.camera.wraps
    with pytest.raises(ValueError, match="shape must be"):
        found.camera.check((3, 3))


OTHERS = {
    "dense": lambda depth, rng: depth,
    "a third missing": lambda depth, rng: depth * (rng.random(depth.shape) < 0.67),
    "half missing": lambda depth, rng: depth * (rng.random(depth.shape) < 0.5),
    "three quarters missing": lambda depth, rng: depth * (rng.random(depth.shape) < 0.25),
    "nine tenths missing": lambda depth, rng: depth * (rng.random(depth.shape) < 0.1),
    "next to nothing": lambda depth, rng: depth * (rng.random(depth.shape) < 0.001),
    "nothing": lambda depth, rng: 0 * depth,
    "beams": lambda depth, rng: depth * (np.indices(depth.shape)[0] % 7 == 0),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_readings_are_not_scattered_evenly(room, name):
    depth = OTHERS[name](room.depth, np.random.default_rng(0))
    found = own_pixels(depth, room.camera)
    assert not isinstance(found, Scattered)


def test_readings_that_say_more_than_their_pixels_stay_as_they_are():
    room = pw.scenes.room(0, sigma=0.001)
    depth, _, camera = in_a_picture(room, 2)
    assert "own_size" not in pw.detect_planes(depth, camera, room.sensor).settings
    rough = replace(room.sensor, noise=0.02)
    assert "own_size" in pw.detect_planes(depth, camera, rough).settings


def test_a_lens_may_bend_the_picture(room):
    depth, _, camera = in_a_picture(room, 2)
    bent = replace(camera, distortion=(0.02, 0.0, 0.0, 0.0))
    found = own_pixels(depth, bent)
    there = found.depth > 0
    column, row = np.rint(bent.project(found.camera.rays(there.shape)[there])).astype(int).T
    assert_array_equal(found.depth[there], depth[row, column])
    folded = replace(camera, distortion=(-0.29, 0.0, 0.0, 0.0))
    assert np.isnan(folded.rays(depth.shape)).any()
    assert own_pixels(depth, folded) is None


def test_every_door_looks(room):
    depth, _, camera = in_a_picture(room, 2)
    wanted = pw.detect_planes(depth, camera, room.sensor)
    for model in models_of(depth, camera, room.sensor):
        assert_array_equal(model.labels, wanted.labels)
        assert model.information == wanted.information
    auto = replace(room.sensor, noise="auto")
    assert "own_size" in pw.detect_planes(depth, camera, auto).settings
    far = replace(room.sensor, max_depth=0.1)
    assert not pw.detect_planes(depth, camera, far).planes
    with pytest.raises(ValueError, match="camera is for images of 160 x 120 pixels"):
        pw.detect_planes(depth, replace(room.camera, width=160, height=120), room.sensor)
