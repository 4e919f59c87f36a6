"""Strips of cloth in folds are no planes; narrow faces that meet in edges are."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.components import components
from planewise.kernels.folds import profiles
from planewise.spatial import labels as spatial_labels
from planewise.spatial.folds import _borders

CAMERA = pw.PinholeCamera(fx=525, fy=525, cx=159.5, cy=119.5)
SHAPE = 240, 320
PIXEL = 2.5 / 525  # metres at 2.5 m
V, U = np.indices(SHAPE)


def seen(height, sigma, seed=0, **options):
    """A sheet at 2.5 m, with some noise."""
    depth = 2.5 + height + np.random.default_rng(seed).normal(0, sigma, SHAPE)
    sensor = pw.Sensor(max_depth=10, resolution=1e-5, noise=sigma)
    return pw.detect_planes(depth, CAMERA, sensor, **options)


def zigzag(width, degrees=22.5):
    return np.tan(np.radians(degrees)) * np.abs((U / width) % 2 - 1) * width * PIXEL


def folds(width, depth=0.04):
    return depth * np.sin(np.pi * U / width)


@pytest.mark.parametrize("sigma", [0.001, 0.002])
def test_folds_of_cloth_before_a_wall_are_no_planes(sigma):
    wall, cloth = np.full(SHAPE, 0.5), (U > 40) & (U < 260) & (V > 30) & (V < 200)
    height = np.where(cloth, folds(18), wall)
    model = seen(height, sigma)
    assert len(model) == 1
    assert model.planes[0].centroid[2] == pytest.approx(3.0, abs=0.01)
    assert (model.labels[~cloth] == 1).mean() > 0.95
    assert not model.labels[cloth].any()


def test_it_is_the_readings_of_strips_that_tell(monkeypatch):
    height = folds(18)
    assert not seen(height, 0.002).labels.any()
    monkeypatch.setattr(
        spatial_labels, "are_folds", lambda frame, white, rows, *_: np.zeros(len(rows), np.bool_)
    )
    assert len(seen(height, 0.002)) > 15


@pytest.mark.parametrize("width", [12, 18, 24])
@pytest.mark.parametrize("sigma", [0.001, 0.002])
def test_faces_of_a_sheet_in_zigzag_are_planes(width, sigma):
    model = seen(zigzag(width), sigma)
    assert len(model) >= 320 // width
    assert (model.labels > 0).mean() > 0.95


def test_stairs_whose_edges_a_sensor_blurs_are_planes():
    row = V[::-1, 0]
    profile_of_steps = 0.12 * (row // 24) + 0.01 * np.maximum(row % 24 - 12, 0)
    padded = np.pad(profile_of_steps, 1, "edge")
    for steps in (profile_of_steps, np.convolve(padded, (0.25, 0.5, 0.25), "valid")):
        model = seen(np.broadcast_to(steps[:, None], SHAPE), 0.002)
        assert len(model) >= 18
        assert (model.labels > 0).mean() > 0.9


def test_threads_and_streams_find_the_same_folds():
    rng = np.random.default_rng(0)
    depth = 2.5 + np.where(U < 200, folds(18), 0.5) + rng.normal(0, 0.002, SHAPE)
    sensor = pw.Sensor(max_depth=10, resolution=1e-5, noise=0.002)
    one, two = (pw.detect_planes(depth, CAMERA, sensor, threads=n) for n in (1, 2))
    assert len(one) == 1
    assert_array_equal(one.labels, two.labels)
    assert one.information == two.information


@given(st.integers(0, 1000), st.booleans(), st.integers(3, 40))
def test_profile_is_the_least_squares_fit_across(seed, alike, width):
    rng = np.random.default_rng(seed)
    x, y = np.arange(50.0) / 100, np.arange(60.0)[:, None] / 100
    w = (0.5 + rng.normal(0, 1e-3, (60, 50))).astype(np.float32)
    p = rng.uniform(0.5e6, 1.5e6, w.shape).astype(np.float32)
    plane = np.array([0.5, 0.1 * rng.normal(), 0.1 * rng.normal()])
    mine = np.zeros(w.shape, np.bool_)
    mine[5:55, 4 : 4 + width] = True
    pixels, white, beside = np.flatnonzero(mine).astype(np.int32), 1.3, 0.01
    pixels = np.append(pixels[::-2], pixels)  # another strip first
    first = np.array([0, pixels.size - mine.sum()])
    stop, out, sides_of = np.append(first[1], pixels.size), np.empty((2, 2, 3)), np.empty((2, 2))
    coordinates = [each.astype(np.float32) for each in (x[None], y)]
    if not alike:
        coordinates = [np.ascontiguousarray(np.broadcast_to(c, w.shape)) for c in coordinates]
    planes = np.stack((plane, plane))
    given = pixels, first, stop, w, p, *coordinates, white, planes, pixels.size, beside
    profiles(*given, np.inf, 0.0, out, sides_of)
    across, along = sides_of[1]
    sides = sorted((width / 100, 0.5))
    assert_allclose((across, along), np.sqrt(np.square(sides) - 1e-4), rtol=1e-4)
    u = np.broadcast_to(x if width < 50 else y, w.shape)[mine].astype(np.float32).astype(float)
    u -= u.mean()
    off = w[mine] - plane[0] - plane[1] * np.broadcast_to(x, w.shape)[mine]
    off = off - plane[2] * np.broadcast_to(y, w.shape)[mine]
    for row, reach in zip(out[1], (np.inf, 0.5 * across - beside), strict=True):
        inside = np.abs(u) < reach
        root = np.sqrt(p[mine][inside].astype(float) / white)
        for chi2, degree in zip(row, (1, 3), strict=False):
            columns = root[:, None] * np.vander(10 * u[inside], degree + 1)
            rest = root * off[inside]
            rest = rest - columns @ np.linalg.lstsq(columns, rest, rcond=None)[0]
            assert_allclose(chi2, rest @ rest, rtol=1e-3, atol=1e-6)
        assert row[2] == inside.sum()
    # As wide, or not as long: no strip.
    for wide, longer in ((across, 0.0), (np.inf, 1.01 * along / across)):
        profiles(*given, wide, longer, out, sides_of)
        assert_array_equal(out[1], 0.0)
        assert_allclose(sides_of[1], (across, along))


@given(st.integers(0, 1000), st.integers(1, 6))
def test_borders_are_those_of_neighbours_in_rows_and_columns(seed, reach):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, 4, (9, 11)).astype(np.uint16)
    labels[rng.random(labels.shape) < 0.4] = 0
    expected = np.zeros((4, 4), int)
    for image in (labels, labels.T):
        for line in image:
            (place,) = np.nonzero(line)
            for a, b in pairwise(place):
                if b - a <= reach and line[a] != line[b]:
                    expected[line[a], line[b]] += 1
                    expected[line[b], line[a]] += 1
    assert_array_equal(_borders(labels, np.flatnonzero(labels), 3, reach), expected)


def test_components_hang_together():
    pairs = np.array([(0, 4), (4, 2), (3, 5)])
    assert_array_equal(components(6, np.concatenate((pairs, pairs[:, ::-1]))), [0, 1, 0, 3, 0, 3])
