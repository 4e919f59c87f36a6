import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import planewise as pw
from planewise import information as module_function
from planewise.information import (
    gain,
    inlier_information,
    mask_information,
    outlier_information,
    outlier_model,
    plane_information,
    planes_model,
    threshold,
)

from . import oracles

positive = st.floats(1e-3, 1e3)


def test_outlier_model_is_equation_1():
    assert outlier_model(7, 3, 10.0, 0.01) == pytest.approx(7 * 3 * math.log(1000), rel=1e-12)


def test_a_model_of_one_plane_is_equation_5_term_by_term():
    residual, sigma = np.array([0.01, -0.02]), np.array([0.01, 0.02])
    n, R, eps = 3, 5.0, 0.001
    phi = planes_model(
        [(residual, sigma)], outliers=4, dimension=n, freedom=n, range=R, resolution=eps
    )
    by_hand = 6 * math.log(2) + 4 * n * math.log(R / eps) + n * math.log(R / eps)
    by_hand += 2 * (n - 1) * math.log(R / eps)
    by_hand += sum(
        0.5 * d * d / s / s + 0.5 * math.log(2 * math.pi * s * s / eps / eps)
        for d, s in zip(residual, sigma, strict=True)
    )
    assert phi == pytest.approx(by_hand, rel=1e-12)


@given(residual=st.floats(-1, 1), sigma=st.floats(1e-3, 1), eps=st.floats(1e-6, 1e-3), R=positive)
def test_gain_is_inlier_minus_outlier_and_free_of_the_resolution(residual, sigma, eps, R):
    for freedom in (1, 3):
        difference = inlier_information(residual, sigma, freedom, R, eps) - outlier_information(
            freedom, R, eps
        )
        assert_allclose(gain(residual, sigma, R), difference, atol=1e-6, rtol=1e-9)


@given(sigma=st.floats(1e-4, 1), R=st.floats(1, 100))
def test_a_reading_at_the_threshold_gains_nothing(sigma, R):
    tau = float(threshold(sigma, R))
    if tau > 0:
        assert gain(sigma * math.sqrt(2 * tau), sigma, R) == pytest.approx(0, abs=1e-9)


@given(k=st.integers(1, 10**6), n=st.integers(0, 60))
def test_mask_information_grows_with_planes(k, n):
    assert mask_information(k, n + 1) > mask_information(k, n)
    assert mask_information(k, 0) == 0


def test_models_agree_where_they_meet():
    kwargs = {"dimension": 4, "freedom": 4, "range": 2.0, "resolution": 0.01}
    assert planes_model([], 9, **kwargs) == pytest.approx(outlier_model(9, 4, 2.0, 0.01))
    extra = planes_model([([], [])], 9, **kwargs) - planes_model([], 9, **kwargs)
    assert extra == pytest.approx(9 * math.log(2) + plane_information(4, 2.0, 0.01))


def test_information_of_an_image_equals_the_oracle(roof, camera):
    depth, planes, labels = roof
    depth, labels = depth.copy(), labels.copy()
    depth[:5, :7] = 0
    labels[20:25] = 0
    sensor = pw.Sensor(max_depth=8, noise=pw.noise.quadratic(0.002, 0.001))
    expected = oracles.phi(
        depth, camera.rays(depth.shape), labels, planes, sensor.sigma(depth), 8, 0.001
    )
    observation = pw.observe(depth, camera, sensor)
    assert pw.information(observation, planes, labels) == pytest.approx(expected, rel=1e-12)
    flat = labels.reshape(-1)[observation.index]
    assert pw.information(observation, planes, flat) == pytest.approx(expected, rel=1e-12)


def test_information_of_free_points():
    points = np.array([[0.0, 0.0], [1.0, 0.1], [2.0, 3.0]])
    observation = pw.observe_points(points, pw.Sensor(max_depth=4, resolution=0.01, noise=0.1))
    L = math.log(400)
    phi = 3 * math.log(2) + 2 * L + 2 * L
    phi += 2 * L + 0.5 * (0.1 / 0.1) ** 2 + 2 * 0.5 * math.log(2 * math.pi * 100)
    assert pw.information(observation, [[0.0, 1.0, 0.0]], [1, 1, 0]) == pytest.approx(
        phi, rel=1e-12
    )


def test_information_refuses_what_does_not_fit(roof, camera):
    depth, planes, labels = roof
    observation = pw.observe(depth, camera, pw.Sensor(noise=0.01))
    with pytest.raises(ValueError, match=r"labels: expected shape \(48, 64\) or \(3072,\)"):
        pw.information(observation, planes, labels[:-1])
    with pytest.raises(ValueError, match="between 0 and 1, the number of planes"):
        pw.information(observation, planes[:1], labels)
    with pytest.raises(ValueError, match="must be integers"):
        pw.information(observation, planes, labels.astype(float))
    with pytest.raises(ValueError, match="planes cannot be made an array"):
        pw.information(observation, [planes[0], planes[0][:2]], labels)
    with pytest.raises(ValueError, match=r"planes: expected numbers of shape \(N, 4\)"):
        pw.information(observation, planes[:, :3], labels)


@pytest.mark.parametrize("scene", [pw.scenes.room, pw.scenes.street])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_judge_of_the_spatial_objective_agrees_with_the_search(scene, seed):
    seen = scene(seed)
    model = pw.detect_planes(seen.depth, seen.camera, seen.sensor)
    observation = pw.observe(seen.depth, seen.camera, seen.sensor)

    def phi(planes, labels):
        return pw.information(observation, planes, labels, objective="spatial")

    assert phi(model.planes, model.labels) == pytest.approx(model.information, rel=1e-9)
    readings = model.labels.reshape(-1)[observation.index]
    assert phi(model.coefficients, readings) == pytest.approx(model.information, rel=1e-9)
    none = np.zeros_like(model.labels)
    assert phi([], none) == pytest.approx(model.curve[0], rel=1e-9)
    best = np.where(model.labels == 1, model.labels, 0)
    assert phi(model.planes[:1], best) == pytest.approx(model.curve[1], rel=1e-9)
    # An edit: a plane without its labels still costs its parameters, and more.
    assert phi(model.planes, np.where(model.labels == 1, 0, model.labels)) > model.information
    swapped = np.where(model.labels > 0, 1 + len(model) - model.labels.astype(int), 0)
    assert phi(model.planes[::-1], swapped) == pytest.approx(model.information, rel=1e-9)


def test_the_judge_of_the_spatial_objective_refuses_what_it_cannot_judge(roof, camera):
    depth, planes, labels = roof
    observation = pw.observe(depth, camera, pw.Sensor(noise=0.01))
    with pytest.raises(ValueError, match="passes through the sensor"):
        pw.information(observation, [[0, 1.0, 0, 0]], labels * 0, objective="spatial")
    with pytest.raises(ValueError, match="at most 65534"):
        pw.information(observation, np.tile(planes[:1], (65535, 1)), labels, objective="spatial")
    with pytest.raises(ValueError, match="objective must be 'paper' or 'spatial', got 'best'"):
        pw.information(observation, planes, labels, objective="best")
    points = pw.observe_points(np.eye(3), pw.Sensor())
    with pytest.raises(ValueError, match="needs the observation of a depth image"):
        pw.information(points, [], [0, 0, 0], objective="spatial")


@pytest.mark.parametrize(
    "plane", [[0, 0, -2.0, 6.0], [0, 0, 0, 3.0], [np.nan, 0, -1.0, 3.0], [0, 0, -1.0, np.inf]]
)
def test_what_is_no_plane_has_no_information(camera, plane):
    observation = pw.observe(np.full((48, 64), 3.0), camera, pw.Sensor())
    with pytest.raises(ValueError, match="planes: expected unit normals and finite distances, got"):
        pw.information(observation, [plane], np.ones((48, 64), int))


def test_a_plane_that_rays_lie_in_has_no_information():
    camera = pw.PinholeCamera(fx=3, fy=3, cx=1, cy=0)
    observation = pw.observe(np.full((2, 3), 2.0), camera, pw.Sensor(noise=0.01))
    labels = np.ones((2, 3), int)
    with pytest.raises(ValueError, match="passes through the sensor, and rays of its readings lie"):
        pw.information(observation, [[1, 0, 0, 0]], labels)
    labels[:, 1] = 0  # the other rays meet it at the sensor
    assert np.isfinite(pw.information(observation, [[1, 0, 0, 0]], labels))
    # Rays that run beside a plane never meet it.
    assert pw.information(observation, [[1, 0, 0, 0.5]], np.ones((2, 3), int)) == math.inf


def test_the_judge_is_public():
    assert pw.information is module_function


@pytest.mark.parametrize("readings", [0, 1, 2])
def test_too_few_readings_for_a_plane_are_outliers_for_judge_and_search(readings):
    depth = np.zeros((12, 16))
    depth.reshape(-1)[:readings] = 2.0
    camera, sensor = pw.PinholeCamera(fx=50, fy=50, cx=8, cy=6), pw.Sensor(noise=0.005)
    model = pw.detect_planes(depth, camera, sensor)
    seen = pw.observe(depth, camera, sensor)
    phi = pw.information(seen, [], model.labels, objective="spatial")
    assert phi == model.information == readings * math.log(seen.range / seen.resolution)
    more = pw.information(seen, [[0, 0, -1.0, 2.0]], model.labels, objective="spatial")
    assert more - phi == pytest.approx(3 * np.log(seen.range / seen.resolution))


def test_masked_labels_are_of_no_plane(roof, camera):
    depth, planes, labels = roof
    observation = pw.observe(depth, camera, pw.Sensor(noise=0.01))
    masked = np.ma.masked_equal(labels, 1)
    expected = pw.information(observation, planes, np.where(labels == 1, 0, labels))
    assert pw.information(observation, planes, masked) == expected
