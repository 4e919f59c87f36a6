"""Wild readings, and readings that are missing all over."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import scenes
from planewise.kernels.wild import AGREEING, REACH, mark_wild
from planewise.metrics import evaluate
from planewise.spatial.frame import frame_of
from planewise.spatial.tame_frame import tame_frame, wild_information
from planewise.wild import wild_readings

SHAPE = (240, 320)
LIMITS = 1, 10_000
LEVEL = 1.0


def oracle(z, low, high, share, widths):
    """Readings with which fewer than a sixth of those about agree."""
    out = np.zeros(z.shape, bool)
    for i, j in np.ndindex(*z.shape):
        rows, columns = (slice(max(k - REACH, 0), k + REACH + 1) for k in (i, j))
        value, others = float(z[i, j]), z[rows, columns].astype(float).ravel().tolist()
        if not low <= value <= high:
            continue
        others.remove(value)
        about = np.sort([other for other in others if low <= other <= high])
        if about.size < AGREEING:
            continue
        half = about.size // 2
        width = (about[half:] - about[: about.size - half]).min()
        within = max(share * value, widths * width)
        out[i, j] = AGREEING * (np.abs(about - value) <= within).sum() < about.size
    return out


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([np.uint16, np.float32, np.float64]))
def test_wild_readings_are_those_of_the_oracle(seed, kind):
    rng = np.random.default_rng(seed)
    i, j = np.indices((19, 26))
    z = 2000 + 15 * i - 4 * j + 700 * (j > 12) + rng.normal(0, 8, i.shape)
    z = np.where(rng.random(z.shape) < 0.2, rng.uniform(300, 12_000, z.shape), z)
    z = np.where(rng.random(z.shape) < 0.3, 0, np.round(z)).astype(kind)
    within = 2.0**-6, 5.0  # a power of two: products in either precision are the same
    found = np.zeros(z.shape, bool)
    seen, few = mark_wild(z, *LIMITS, *within, 1, found)
    valid = (z >= LIMITS[0]) & (z <= LIMITS[1])
    assert seen == valid.sum()
    assert few == found.sum() > 0
    # The loop looks no further where four of the eight nearest agree.
    expected = oracle(z, *LIMITS, *within)
    assert not (found & ~expected).any()
    for a, b in np.argwhere(expected & ~found):
        near = z[max(a - 1, 0) : a + 2, max(b - 1, 0) : b + 2].astype(float)
        close = np.abs(near - z[a, b]) <= within[0] * z[a, b]
        assert (close & (near >= LIMITS[0])).sum() - 1 >= 4

    some = np.zeros((4, z.shape[1]), bool)
    mark_wild(z, *LIMITS, *within, 5, some)
    assert_array_equal(some, found[::5])


def spoiled(scene, share, seed=0):
    """Depth with so many readings that may be anything, and which."""
    rng = np.random.default_rng(seed)
    wild = rng.random(scene.depth.shape) < share
    return np.where(wild, rng.integers(300, 10_000, wild.shape), scene.depth).astype(
        np.uint16
    ), wild


@pytest.fixture(scope="module")
def room():
    return scenes.room(1, size=SHAPE, sigma=0.005)


@pytest.mark.parametrize("share", [0.02, 0.08, 0.15])
def test_wild_readings_are_found_and_hardly_any_other(room, share):
    depth, wild = spoiled(room, share)
    before = depth.copy()
    found = wild_readings(depth, *LIMITS, LEVEL)
    assert_array_equal(depth, before)
    off = np.abs(depth.astype(float) - room.depth) > 0.1 * room.depth
    assert found[wild & off].mean() > 0.95
    assert found[~wild].mean() < 1e-3
    metres = wild_readings(depth / np.float64(1000), 0.001, 10.0, 1e-4)
    assert (metres != found).mean() < 1e-3


def test_readings_of_frames_without_are_left_alone(room):
    assert wild_readings(room.depth, *LIMITS, LEVEL) is None
    seen = pw.observe(room.depth, room.camera, room.sensor)
    assert seen.tame is seen
    assert wild_information(seen) == 0
    thin = room.depth.copy()
    thin[100, 40:200] = thin[50:200, 70] = 900  # a wire is one pixel wide
    assert wild_readings(thin, *LIMITS, LEVEL) is None
    rough = np.random.default_rng(0).integers(300, 10_000, SHAPE).astype(np.uint16)
    assert wild_readings(rough, *LIMITS, LEVEL) is None
    assert wild_readings(np.full(SHAPE, 2000, np.uint16), *LIMITS, LEVEL) is None
    assert wild_readings(np.zeros(SHAPE, np.uint16), *LIMITS, LEVEL) is None


@pytest.mark.parametrize("noise", [0.0, 2e-7, 5e-5])
def test_depth_in_steps_that_is_not_exact_has_no_wild_readings(noise):
    """Of points that were turned, or told in text: what was one step differs by next to nothing."""
    room = scenes.room(0)
    off = noise * np.random.default_rng(0).uniform(-1, 1, room.depth.shape)
    depth = np.where(room.depth > 0, 0.001 * room.depth + off, 0)
    seen = pw.observe(depth, room.camera, room.sensor)
    assert seen.tame is seen
    model = pw.detect_planes(depth, room.camera, replace(room.sensor, noise="auto"))
    exact = pw.detect_planes(room.depth, room.camera, replace(room.sensor, noise="auto"))
    assert_allclose(model.information, exact.information, rtol=2e-4)
    assert (model.labels != exact.labels).mean() < 0.002


@pytest.mark.parametrize("noise", [1e-3, 2e-3])
@pytest.mark.parametrize("seed", [1, 5])
def test_steps_that_are_dithered_are_no_wild_readings(seed, noise):
    """Of an image that was resampled, or rounded twice: differences are less than a step."""
    room = scenes.room(seed)
    off = noise * np.random.default_rng(0).uniform(-1, 1, room.depth.shape)
    depth = np.where(room.depth > 0, 0.001 * room.depth + off, 0)
    seen = pw.observe(depth, room.camera, room.sensor)
    assert seen.tame is seen


def score(model, scene, valid):
    found, true = (np.where(valid, each, 0) for each in (model.labels, scene.labels))
    row = evaluate(found, true, valid=valid).row()
    return row["recall@0.5"], row["sc_labelled"]


@pytest.mark.parametrize("noise", ["told", "auto"])
def test_planes_are_those_without_wild_readings(room, noise):
    sensor = room.sensor if noise == "told" else replace(room.sensor, noise="auto")
    clean = pw.detect_planes(room.depth, room.camera, sensor)
    depth, wild = spoiled(room, 0.08)
    model = pw.detect_planes(depth, room.camera, sensor)
    valid = (room.depth > 0) & ~wild
    recall, covering = score(model, room, valid)
    best, most = score(clean, room, valid)
    assert recall > best - 0.1
    assert covering > most - 0.02
    assert model.readings == (depth > 0).sum()
    assert_array_equal(pw.detect_planes(depth, room.camera, sensor, threads=2).labels, model.labels)


def test_the_noise_is_told_beside_wild_readings(room):
    told = pw.estimate_noise(room.depth, room.camera, room.sensor)
    found = pw.estimate_noise(spoiled(room, 0.15)[0], room.camera, room.sensor)
    z = np.linspace(told.bins.depth[0], told.bins.depth[-1], 5)
    assert_allclose(found.noise(z), told.noise(z), rtol=0.15)


def test_phi_has_the_wild_readings(room):
    depth, _ = spoiled(room, 0.05)
    model = pw.detect_planes(depth, room.camera, room.sensor)
    seen = pw.observe(depth, room.camera, room.sensor)
    again = pw.information(seen, model.planes, model.labels, objective="spatial")
    assert again == pytest.approx(model.information, rel=1e-6)
    wild = seen.count - seen.tame.count
    each = np.log(seen.range / seen.resolution)
    chosen = -np.log(wild / seen.count) * wild  # which they are: nearly the entropy
    chosen -= np.log(1 - wild / seen.count) * (seen.count - wild)
    assert wild_information(seen) == pytest.approx(wild * each + chosen, rel=1e-3)
    assert tame_frame(seen).wild == wild_information(seen)
    assert frame_of(seen).wild == 0


@pytest.mark.parametrize("noise", ["told", "auto"])
@pytest.mark.parametrize(("missing", "least"), [(0.5, 0.8), (0.75, 0.7), (0.9, 0.5)])
def test_planes_of_readings_that_are_missing_all_over(missing, least, noise):
    scene = scenes.room(1, sigma=0.005)
    rng = np.random.default_rng(0)
    depth = np.where(rng.random(scene.depth.shape) < missing, 0, scene.depth)
    sensor = scene.sensor if noise == "told" else replace(scene.sensor, noise="auto")
    model = pw.detect_planes(depth, scene.camera, sensor)
    recall, covering = score(model, scene, depth > 0)
    assert recall > least
    assert covering > 0.9
    assert not model.labels[depth == 0].any()
    seen = pw.observe(depth, scene.camera, sensor)
    again = pw.information(seen, model.planes, model.labels, objective="spatial")
    assert again == pytest.approx(model.information, rel=1e-5)


def test_of_sparse_readings_the_planes_asked_for():
    scene = scenes.corner()
    rng = np.random.default_rng(0)
    depth = np.where(rng.random(scene.depth.shape) < 0.9, 0, scene.depth)
    model = pw.detect_planes(depth, scene.camera, scene.sensor)
    assert len(model) == 4
    assert np.isfinite([plane.covariance for plane in model.planes]).all()
    few = pw.detect_planes(depth, scene.camera, scene.sensor, max_planes=2)
    assert len(few) == 2
    assert few.curve.reason == "reached max_planes = 2"


def test_readings_in_lines_are_no_cells():
    """Of six rows one: all readings of a cell lie in a line, and tell no slope across."""
    scene = scenes.staircase()
    depth = np.zeros_like(scene.depth)
    depth[::6] = scene.depth[::6]
    model = pw.detect_planes(depth, scene.camera, scene.sensor)
    assert len(model) == 4
    assert (model.labels == 0)[depth > 0].mean() < 0.05
