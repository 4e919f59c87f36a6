"""Planes described from images in inverse depth, against the readings one by one."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.kernels.cells import UNIT
from planewise.paper.describe import describe
from planewise.spatial.describe import describe_image, describe_ranges
from planewise.spatial.frame import frame_of

PLANES = np.array([[0.4, 0.02, -0.05], [0.6, -0.03, 0.01], [0.5, 0.0, 0.0], [0.7, 0.1, 0.1]])
SENSOR = pw.Sensor(max_depth=10, noise=0.003)


def random_frame(rng, camera, shape):
    """Depth near labelled planes with holes, and labels in runs of all lengths, none on plane 3."""
    label = np.repeat(rng.integers(0, 4, shape), rng.integers(1, 40, shape[1]), axis=1)
    label = label[:, : shape[1]].copy()
    label[label == 3] = 4
    label[1:3] = label[1, 0]
    rays = camera.rays(shape)
    du, dv = 1 / camera.fx, 1 / camera.fy
    t = PLANES[np.maximum(label, 1) - 1]
    w = t[..., 0] + (t[..., 1] * rays[..., 0] / du + t[..., 2] * rays[..., 1] / dv) / UNIT
    depth = 1 / w + rng.normal(0, 0.004, shape)
    depth[rng.random(shape) < 0.1] = 0
    depth[:5, :7] = 0
    label[depth == 0] = 0
    return depth, label.astype(np.uint16)


@pytest.mark.parametrize("radial", [False, True])
@pytest.mark.parametrize("distortion", [(), (0.05, -0.02, 0.001, 0.0)])
@pytest.mark.parametrize("shape", [(40, 61), (20, 200), (200, 20)])
def test_planes_are_described_as_by_their_readings(shape, distortion, radial):
    camera = pw.PinholeCamera(fx=180, fy=170, cx=33, cy=18, distortion=distortion)
    depth, labels = random_frame(np.random.default_rng(shape[1]), camera, shape)
    if radial:
        depth *= np.linalg.norm(camera.rays(shape), axis=-1)
        camera = replace(camera, radial=True)
    observation = pw.observe(depth, camera, SENSOR)
    theta = PLANES[:, [1, 2, 0]] * [camera.fx / UNIT, camera.fy / UNIT, 1]
    length = np.linalg.norm(theta, axis=1, keepdims=True)
    rows = np.hstack((-theta / length, 1 / length))
    covariances = np.zeros((4, 4, 4))
    marks = labels.reshape(-1)[observation.index]
    planes = np.vstack((np.ones((1, 3)), theta))[marks]
    delta = observation.depth - 1 / np.einsum("ki,ik->k", planes, observation.rays)
    square = np.where(marks > 0, delta**2, 0.0)
    slow = describe(observation, rows, covariances, marks, np.zeros(marks.size), square)
    frame = frame_of(observation)
    place = np.array([0, 2, 0, 4, 1, 3], np.uint16)
    unranked = np.array([0, 4, 1, 5, 3], np.uint16)[labels]
    unranked[(labels == 0) & (depth > 0) & (np.arange(shape[1]) % 3 > 0)] = 2
    before = unranked.copy()
    area = camera.pixel_area(shape)
    fast, ranked = describe_image(frame, area, PLANES, rows, covariances, unranked, place)
    assert_array_equal(ranked, labels)
    assert_array_equal(unranked, before)
    assert fast[2].count == 0
    for a, b in zip(fast, slow, strict=True):
        assert a.count == b.count
        assert a.information == 0
        far = 10.0  # metres: no reading is farther
        assert_allclose(a.centroid, b.centroid, rtol=0, atol=1e-6 * far)
        assert_allclose(a.rms, b.rms, rtol=0, atol=1e-6 * far)
        assert_allclose(a.area, b.area, rtol=3e-6)
        assert a.bounding_box == b.bounding_box


def test_boxes_of_planes_in_one_half_of_an_image_that_stands_upright():
    shape = (90, 20)
    camera = pw.PinholeCamera(fx=180, fy=170, cx=10, cy=45)
    labels = np.zeros(shape, np.uint16)
    labels[3:20, 2:9], labels[70:88, 5:17] = 1, 2
    frame = frame_of(pw.observe(np.full(shape, 2.0), camera, SENSOR))
    rows, affine = np.tile((0.0, 0.0, -1.0, 2.0), (3, 1)), np.tile((0.5, 0.0, 0.0), (3, 1))
    place, area = np.arange(4, dtype=np.uint16), camera.pixel_area(shape)
    planes, _ = describe_image(frame, area, affine, rows, np.zeros((3, 4, 4)), labels, place)
    boxes = [plane.bounding_box for plane in planes]
    assert boxes == [(3, 2, 20, 9), (70, 5, 88, 17), (0, 0, 0, 0)]


@pytest.mark.parametrize("turn", [360, 200])
@pytest.mark.parametrize("rows", [2, 17])
def test_planes_of_ranges_are_described_as_by_their_readings(rows, turn):
    """In sectors, some across the end of the image, one without readings."""
    columns, rng = 90, np.random.default_rng(rows)
    camera = pw.SphericalCamera(
        elevation=np.linspace(40, -70, rows), azimuth=turn * (0.5 - np.arange(columns) / columns)
    )
    labels = np.repeat(rng.integers(0, 5, (rows, 9)), 10, axis=1).astype(np.uint16)
    labels = np.roll(labels, 5, axis=1)
    labels[labels == 2] = 0
    ranges = rng.uniform(1, 4, labels.shape)
    ranges[rng.random(labels.shape) < 0.2] = 0
    labels[ranges == 0] = 0
    observation = pw.observe(ranges, camera, SENSOR)
    normals = rng.normal(size=(4, 3))
    planes = np.column_stack(
        (normals / np.linalg.norm(normals, axis=1, keepdims=True), [1, 2, 3, 4])
    )
    marks, covariances = labels.reshape(-1)[observation.index], np.zeros((4, 4, 4))
    nothing = np.zeros(marks.size)
    slow = describe(observation, planes, covariances, marks, nothing, nothing)
    frame = frame_of(observation)
    place = np.zeros(4 * frame.sectors.count + 1, np.uint16)
    order = np.array([2, 0, 3, 1])
    place[1:] = np.repeat(1 + order, frame.sectors.count)
    unranked = np.append(0, 1 + np.argsort(order)).astype(np.uint16)[labels]
    sectors = frame.sectors.labels(unranked).astype(np.uint16)
    fast, ranked = describe_ranges(frame, camera, planes, covariances, sectors, place)
    assert_array_equal(ranked, labels)
    assert fast[1].count == 0
    for a, b in zip(fast, slow, strict=True):
        assert (a.count, a.bounding_box) == (b.count, b.bounding_box)
        if a.count:
            assert_allclose(a.centroid, b.centroid, rtol=0, atol=1e-5)
            assert_allclose((a.rms, a.area), (b.rms, b.area), rtol=1e-5)
    assert camera.wraps is (turn == 360)
    assert not camera.wraps or any(each.bounding_box[3] > columns for each in fast)
