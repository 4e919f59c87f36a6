"""Surfaces of one plane of a depth image that do not touch: ``instances=True``."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse.csgraph import connected_components

import planewise as pw
from planewise import scenes
from planewise.kernels.pieces import label_pieces
from planewise.spatial import instances as told
from tests.test_lidar import CAMERA as LIDAR
from tests.test_lidar import SENSOR as LIDAR_SENSOR

CAMERA = pw.PinholeCamera(fx=260, fy=260, cx=159.5, cy=119.5)
SENSOR = pw.Sensor(max_depth=5, noise=0.004)


def walls(*edges: int, missing: float = 0.0) -> np.ndarray:
    """A slanted wall, seen past boards from one column to the next: edges by pairs."""
    rng = np.random.default_rng(0)
    depth = 1 / np.linspace(1 / 2.2, 1 / 1.8, 320)[None].repeat(240, axis=0)
    for left, right in zip(edges[::2], edges[1::2], strict=True):
        depth[:, left:right] = 1.2
    depth += rng.normal(0, 0.004, depth.shape)
    depth[rng.random(depth.shape) < missing] = 0.0
    return depth


def pieces(labels, reach, wraps=False, most=1000):
    out, label = np.empty(labels.shape, np.uint16), np.zeros(most, np.uint16)
    count = label_pieces(labels, reach, wraps, np.empty(labels.size, np.int32), label, out)
    return count, label[: min(count, most)], out


def pieces_by_distance(labels, reach, wraps):
    """The same from the distances of all pixels of one label."""
    out, found = np.zeros(labels.shape, np.uint16), []
    flat = out.reshape(-1)
    for label in np.unique(labels[labels > 0]):
        y, x = np.nonzero(labels == label)
        across = np.abs(x[:, None] - x)
        if wraps:
            across = np.minimum(across, labels.shape[1] - across)
        near = np.maximum(np.abs(y[:, None] - y), across) <= reach
        parts, part_of = connected_components(near)
        pixels = y * labels.shape[1] + x
        found.extend((label, pixels[part_of == part]) for part in range(parts))
    found.sort(key=lambda each: each[1][0])
    for number, (_, pixels) in enumerate(found, 1):
        flat[pixels] = number
    return len(found), [label for label, _ in found], out


@given(
    seed=st.integers(0, 2**31),
    shape=st.tuples(st.integers(1, 14), st.integers(8, 20)),
    reach=st.integers(1, 3),
    wraps=st.booleans(),
    share=st.floats(0.05, 0.95),
)
def test_pieces_are_those_of_all_distances(seed, shape, reach, wraps, share):
    rng = np.random.default_rng(seed)
    labels = np.where(rng.random(shape) < share, rng.integers(1, 4, shape), 0).astype(np.uint16)
    count, label, out = pieces(labels, reach, wraps)
    expected, of_which, image = pieces_by_distance(labels, reach, wraps)
    assert count == expected
    assert_array_equal(label, of_which)
    assert_array_equal(out, image)


def test_pieces_beyond_the_most_are_left_out():
    labels = np.array([[1, 0, 0, 2, 0, 0, 1]], np.uint16)
    count, label, out = pieces(labels, 2, most=2)
    assert count == 3
    assert_array_equal(label, [1, 2])
    assert_array_equal(out, [[1, 0, 0, 2, 0, 0, 0]])


def test_surfaces_share_the_parameters_of_their_plane():
    depth = walls(140, 180)
    together = pw.detect_planes(depth, CAMERA, SENSOR)
    apart = pw.detect_planes(depth, CAMERA, SENSOR, instances=True)
    assert (len(together), len(apart)) == (2, 3)
    wall = together.planes[0]
    left, right = (p for p in apart.planes if abs(p.distance - wall.distance) < 1e-3)
    for each in (left, right):
        assert_allclose(each.coefficients, wall.coefficients, rtol=0, atol=1e-12)
        assert_allclose(each.covariance, wall.covariance)
    assert left.count + right.count == wall.count
    assert left.significance + right.significance == pytest.approx(wall.significance)
    assert_array_equal(apart.labels > 0, together.labels > 0)
    assert {m.kind for m in apart.curve.moves} >= {"agglomerate", "instances"}


def test_phi_is_that_of_the_surfaces_as_planes():
    depth = walls(140, 180)
    model = pw.detect_planes(depth, CAMERA, SENSOR, instances=True)
    frame = pw.observe(depth, CAMERA, SENSOR)
    phi = pw.information(frame, model.coefficients, model.labels, objective="spatial")
    assert phi == pytest.approx(model.information, rel=1e-6)


def windowed(depth: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """The same with a window in a board, through which the wall is seen."""
    window = np.s_[100 : 100 + rows, 250 : 250 + columns]
    depth[window] = walls()[window]
    return depth


def test_what_does_not_pay_is_no_surface():
    """What a window in a board shows of a wall is part of the wall, but no surface."""
    depth = windowed(walls(140, 320), 8, 8)
    together = pw.detect_planes(depth, CAMERA, SENSOR)
    apart = pw.detect_planes(depth, CAMERA, SENSOR, instances=True)
    middle = np.s_[102:106, 252:256]
    wall, board = together.labels[120, 70], together.labels[50, 250]
    assert (together.labels[middle] == wall).all()
    assert wall != board
    assert not apart.labels[middle].any()
    assert len(together) == len(apart) == 2


@pytest.mark.parametrize("size", [(9, 9), (6, 16)])
def test_a_surface_need_not_pay_for_the_parameters_of_its_plane(size):
    apart = pw.detect_planes(windowed(walls(140, 320), *size), CAMERA, SENSOR, instances=True)
    assert len(apart) == 3
    board_alone = windowed(walls(0, 320), *size)
    assert len(pw.detect_planes(board_alone, CAMERA, SENSOR, instances=True)) == 1


@pytest.mark.parametrize("missing", [0.3, 0.6, 0.8, 0.93])
def test_missing_readings_cut_no_surface(missing):
    apart = pw.detect_planes(walls(140, 180, missing=missing), CAMERA, SENSOR, instances=True)
    assert len(apart) == 3


def test_readings_too_far_apart_for_cells_tell_surfaces_apart():
    depth = walls(100, 130, 250, 280, missing=0.98)
    planes = pw.detect_planes(depth, CAMERA, SENSOR)
    apart = pw.detect_planes(depth, CAMERA, SENSOR, instances=True)
    assert "frame_error" not in apart.settings  # that cells would tell
    assert (len(planes), len(apart)) == (2, 5)
    assert all(np.isnan(plane.residual_correlation) for plane in apart.planes)


def test_the_best_surfaces_that_are_asked_for():
    depth = walls(100, 130, 250, 280)
    every = pw.detect_planes(depth, CAMERA, SENSOR, instances=True)
    assert len(every) == 5  # the boards are in one plane, too, but do not touch
    some = pw.detect_planes(depth, CAMERA, SENSOR, instances=True, max_planes=2)
    assert [p.count for p in some.planes] == [p.count for p in every.planes[:2]]
    assert "max_planes = 2" in some.curve.reason
    least = every.planes[1].significance
    more = pw.detect_planes(depth, CAMERA, SENSOR, instances=True, significance=least)
    assert all(p.significance > least for p in more.planes)
    assert 0 < len(more) < len(every)


def test_threads_and_detectors_tell_the_same_apart():
    scene = scenes.room(3)
    one = pw.detect_planes(scene.depth, scene.camera, scene.sensor, instances=True, threads=1)
    detector = pw.Detector(scene.camera, scene.sensor, instances=True, threads=2)
    for _ in range(2):
        assert_array_equal(detector(scene.depth).labels, one.labels)


def test_a_wall_about_the_end_of_a_panorama_is_one_surface():
    """It lies behind the scanner: in the first columns of the image, and in the last."""
    ranges = np.zeros(LIDAR.shape)
    rays = LIDAR.rays(LIDAR.shape)
    behind = rays[..., 0] < -0.5
    ranges[behind] = -6.0 / rays[behind][:, 0]
    ranges[ranges > 12] = 0
    ranges[ranges > 0] += np.random.default_rng(0).normal(0, 0.01, np.count_nonzero(ranges))
    model = pw.detect_planes(ranges, LIDAR, LIDAR_SENSOR, instances=True)
    assert len(model) == 1
    assert (model.labels[:, 0] > 0).any()
    assert (model.labels[:, -1] > 0).any()


def test_too_many_pieces_leave_planes_whole(monkeypatch):
    monkeypatch.setattr(told, "MOST_LABELS", 2)
    depth = walls(140, 180)
    assert len(pw.detect_planes(depth, CAMERA, SENSOR, instances=True)) == 2


@pytest.mark.parametrize("value", [0.0, 2.0])
def test_frames_without_surfaces_say_so(value):
    """No readings, and a few of a wall."""
    depth = np.zeros((240, 320))
    depth[:8, :8] = value
    model = pw.detect_planes(depth, CAMERA, SENSOR, instances=True)
    assert (len(model), model.labels.max()) == (0, 0)
    assert model.note
