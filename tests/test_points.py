"""Hyperplanes of free points in n dimensions, under the paper's objective."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.paper.sequential import trial_count

SIGMA = 0.01
SENSOR = pw.Sensor(max_depth=4.0, resolution=0.001, noise=SIGMA)


def hyperplanes(n, count, rng, points=400):
    """Noisy points on random hyperplanes, as many outliers in a cube, and the truth."""
    truth, parts = [], []
    for _ in range(count):
        normal = rng.normal(size=n)
        normal /= np.linalg.norm(normal)
        distance = rng.uniform(0.2, 1.0)
        x = rng.uniform(-2, 2, (points, n))
        x -= np.outer(x @ normal + distance + rng.normal(0, SIGMA, points), normal)
        truth.append([*normal, distance])
        parts.append(x)
    parts.append(rng.uniform(-2, 2, (count * points, n)))
    return np.vstack(parts), np.array(truth)


@pytest.mark.parametrize("search", ["joint", "sequential"])
@pytest.mark.parametrize(("n", "count"), [(2, 3), (3, 3), (4, 2), (5, 1)])
def test_hyperplanes_among_as_many_outliers(n, count, search):
    for seed in range(3):
        points, truth = hyperplanes(n, count, np.random.default_rng(seed))
        model = pw.detect_planes_in_points(
            points, SENSOR, search=search, objective="paper", inlier_ratio=0.2
        )
        assert len(model) == count
        assert model.labels.shape == (len(points),)
        rows = model.coefficients
        for row in truth:
            near = rows[np.argmin(np.linalg.norm(rows - row, axis=1))]
            assert_allclose(near, row, atol=5 * SIGMA / 20 * n)


@pytest.mark.parametrize("n", [7, 9])
def test_samples_in_many_dimensions_are_not_waited_for_until_tomorrow(n):
    points, _ = hyperplanes(n, 1, np.random.default_rng(0))
    with pytest.raises(ValueError, match=f"got 0.1: a plane in {n} dimensions would") as refused:
        pw.detect_planes_in_points(points, SENSOR, search="sequential")
    least = float(re.search(r"give at least ([\d.]+),", str(refused.value)).group(1))
    assert 5e6 < trial_count(0.99, least, n) <= 1e7
    assert trial_count(0.99, 0.1, 6) < 1e7


@pytest.mark.parametrize("search", ["joint", "sequential"])
def test_phi_equals_the_judge(search):
    points, _ = hyperplanes(3, 2, np.random.default_rng(0))
    model = pw.detect_planes_in_points(points, SENSOR, search=search, objective="paper")
    judge = pw.information(pw.observe_points(points, SENSOR), model.planes, model.labels)
    assert model.information == pytest.approx(judge, rel=1e-9)


def test_labels_of_another_number_of_points_are_refused():
    points, _ = hyperplanes(3, 1, np.random.default_rng(0))
    n = len(points)
    for seen, shapes in (
        (points, rf"\({n},\)"),
        (np.vstack((points, [[np.nan, 0, 0]])), rf"\({n + 1},\) or \({n},\)"),
    ):
        with pytest.raises(ValueError, match=rf"^labels: expected shape {shapes}, got \(5,\)$"):
            pw.information(pw.observe_points(seen, SENSOR), [], np.zeros(5, int))


@settings(max_examples=10)
@given(seed=st.integers(0, 1000), shift=st.floats(-1e6, 1e6))
def test_moving_and_turning_the_points_moves_and_turns_the_planes(seed, shift):
    rng = np.random.default_rng(seed)
    points, _ = hyperplanes(3, 2, np.random.default_rng(1))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    plain = pw.detect_planes_in_points(points, SENSOR, objective="paper")
    moved = pw.detect_planes_in_points(points @ turn.T + shift, SENSOR, objective="paper")
    assert moved.information == pytest.approx(plain.information, rel=1e-3)
    assert len(moved) == len(plain) == 2
    for plane in plain.planes:
        normals = [abs(other.normal @ (turn @ plane.normal)) for other in moved.planes]
        assert max(normals) > 1 - 1e-4


def test_rows_that_are_not_finite_are_no_reading():
    points, _ = hyperplanes(3, 1, np.random.default_rng(0))
    points[::5, 1] = np.nan
    model = pw.detect_planes_in_points(points, SENSOR)
    assert not model.labels[::5].any()
    assert model.readings == np.isfinite(points).all(axis=1).sum()


@pytest.mark.parametrize("points", [np.empty((0, 3)), np.zeros((2, 3)), np.full((9, 3), np.nan)])
def test_too_few_points_give_an_empty_model(points):
    model = pw.detect_planes_in_points(points, SENSOR)
    assert len(model) == 0
    assert "needed for a plane" in model.note


@pytest.mark.parametrize("search", ["joint", "sequential"])
def test_equal_or_collinear_points_are_no_error(search):
    for points in (np.ones((50, 3)), np.outer(np.linspace(0, 1, 50), [1.0, 2.0, 3.0])):
        model = pw.detect_planes_in_points(points, SENSOR, search=search)
        assert np.isfinite(model.information)
        assert np.isfinite(model.coefficients).all()


def test_covariance_of_free_points_is_the_scatter_of_the_estimates():
    rng = np.random.default_rng(0)
    normal, found, claimed = np.array([0.0, 0.6, 0.8]), [], []
    base = rng.uniform(-1, 1, (300, 3))
    base -= np.outer(base @ normal + 1.5, normal)
    for _ in range(60):
        noisy = base + np.outer(rng.normal(0, SIGMA, 300), normal)
        model = pw.detect_planes_in_points(noisy, SENSOR, objective="paper")
        found.append(model.coefficients[0])
        claimed.append(model.planes[0].covariance)
    expected = np.mean(claimed, axis=0)
    assert_allclose(np.cov(np.array(found).T), expected, atol=0.4 * np.abs(expected).max())


def strip(width, seed, count=400):
    """Noisy points along five metres."""
    rng = np.random.default_rng(seed)
    sides = rng.uniform(-0.5, 0.5, (count, 3)) * (5.0, width, 0.0)
    return sides + rng.normal(0, SIGMA, (count, 3)) + (1, 0, -3)


@pytest.mark.parametrize("objective", ["paper", "spatial"])
@pytest.mark.parametrize("width", [3, 10])
def test_covariance_of_a_strip_knows_of_the_noise_in_its_width(width, objective):
    """About its long axis; spatial: points of a cell share some of their error."""
    found, claimed = [], []
    for seed in range(25):
        model = pw.detect_planes_in_points(strip(width * SIGMA, seed), SENSOR, objective=objective)
        (plane,) = model.planes
        angle = np.arctan2(plane.normal[1], plane.normal[2])
        found.append(angle - np.pi * np.round(angle / np.pi))
        claimed.append(plane.covariance[1, 1])
    ratio = np.sqrt(np.nanmean(claimed) / np.mean(np.square(found)))
    assert np.isfinite(claimed).mean() > 0.9
    assert 0.8 < ratio < 1.35


@pytest.mark.parametrize("objective", ["paper", "spatial"])
@pytest.mark.parametrize("count", [60, 400])
@pytest.mark.parametrize("width", [0, 1])
def test_a_strip_as_narrow_as_its_noise_has_no_covariance(width, count, objective):
    for seed in range(3):
        points = strip(width * SIGMA, seed, count)
        model = pw.detect_planes_in_points(points, SENSOR, objective=objective)
        assert np.isnan([plane.covariance for plane in model.planes]).all()


@pytest.mark.parametrize("search", ["joint", "sequential"])
@pytest.mark.parametrize("noise", [0.01, 1e-9, pw.noise.proportional(0.01), "auto"])
def test_points_of_any_size_give_no_warnings(noise, search):
    rng = np.random.default_rng(0)
    points = np.column_stack((rng.uniform(2, 6, (300, 2)), rng.normal(-1.5, 0.01, 300)))
    sensor = pw.Sensor(noise=noise)
    for far in (1e39, 1e300, 1.7e308) if noise in (0.01, 1e-9, "auto") else (1e300,):
        strays = [[far, 0, 0], [-far, far, 0]]
        found = pw.detect_planes_in_points(
            np.vstack((points, strays)), sensor, search=search, objective="paper"
        )
        assert found.readings == len(points) + (2 if far < 1e150 else 0)
        assert not found.labels[-2:].any()
        assert np.isfinite(found.information)


@pytest.mark.parametrize("dimension", [2, 3, 4])
def test_a_stray_point_takes_no_digits_from_the_others(dimension):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 3, (800, dimension))
    points[:, -1] = rng.normal(0, 0.01, 800)
    stray = np.zeros((1, dimension))
    stray[0] = 1e12
    sensor = pw.Sensor(max_depth=10.0, noise=0.01)
    alone = pw.detect_planes_in_points(points, sensor, objective="paper")
    found = pw.detect_planes_in_points(np.vstack((points, stray)), sensor, objective="paper")
    assert len(alone) == len(found) == 1
    assert_array_equal(found.labels[:-1], alone.labels)
    assert_allclose(found.planes[0].covariance, alone.planes[0].covariance, rtol=1e-6, atol=1e-12)
