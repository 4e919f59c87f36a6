"""Planes at flat angles, and what stands a little off, are several; smooth surfaces are not."""

import numpy as np
import pytest
from benchmarks import fine_rooms, flat_edges
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.kernels import splits
from planewise.metrics import evaluate

from . import spatial_oracles as oracles

SIZE = 480, 640
X, Y = flat_edges.wall(SIZE)


def valley(rng, size, angle, place, turn, sigma=0.1):
    """Points on two planes that meet in a line, and on which of them each is."""
    x, y = rng.uniform(-1.5, 1.5, (2, size))
    across = x * np.cos(angle) + y * np.sin(angle) - place
    p = rng.uniform(0.5, 2.0, size) / sigma**2
    height = 0.3 + 0.2 * x - 0.4 * y + turn * np.maximum(across, 0.0)
    height += rng.standard_normal(size) / np.sqrt(p)
    return np.column_stack((x, y, height, p)), across


def chi2(points):
    x, y, height, p = points.T
    return oracles.misfit(height, p, x, y)


def halved(points, fewest=12):
    side = np.empty(len(points), np.bool_)
    return side if splits.halve(points, fewest, 2000, side) else None


@given(
    st.integers(0, 2**32 - 1),
    st.integers(60, 5000),
    st.floats(0, np.pi),
    st.floats(-0.7, 0.7),
    st.sampled_from([-2.0, -0.5, 0.5, 2.0]),
)
def test_halve_finds_the_line_in_which_two_planes_meet(seed, size, angle, place, turn):
    points, across = valley(np.random.default_rng(seed), size, angle, place, turn)
    kept, truth = points.copy(), across > 0
    assume(12 <= np.count_nonzero(truth) <= size - 12)  # else that line is none it may choose
    side = halved(points)
    assert_array_equal(points, kept)
    found = chi2(points[side]) + chi2(points[~side])
    assert (
        found < chi2(points[truth]) + chi2(points[~truth]) + 12.0
    )  # about as good as the true one
    clear = abs(turn * across) > 0.5  # five standard deviations of a point
    wrong = side[clear] != truth[clear]
    assert size < 200 or min(np.count_nonzero(wrong), np.count_nonzero(~wrong)) == 0


def test_halve_tells_a_step_from_an_edge():
    x, y = np.random.default_rng(0).uniform(-1, 1, (2, 500))
    points = np.column_stack((x, y, 1.0 * (x > 0.2 * y + 0.3), np.full(500, 1e4)))
    side = halved(points)
    behind = x > 0.2 * y + 0.3
    assert min(np.count_nonzero(side != behind), np.count_nonzero(side == behind)) <= 5


def test_halve_leaves_enough_on_either_side_or_nothing():
    rng = np.random.default_rng(0)
    points, across = valley(rng, 200, 0.0, 1.45, 30.0)
    assert np.count_nonzero(across > 0) < 12
    side = halved(points)
    assert 12 <= np.count_nonzero(side) <= 188
    assert halved(points[:23]) is None
    assert halved(np.repeat(points[:1], 50, axis=0)) is None  # all in one place


@given(st.integers(0, 2**32 - 1))
def test_correlation_of_residuals_is_that_of_neighbours(seed):
    rng = np.random.default_rng(seed)
    points, _ = valley(rng, 80, 0.3, 0.0, 1.0)
    part = rng.integers(0, 3, 80).astype(np.intp)
    sides = rng.integers(0, 80, (150, 2)).astype(np.intp)
    sums, out, misfits = np.empty((3, splits.SUMS)), np.empty((3, 3)), np.empty(3)
    splits.correlate(points, part, sides, sums, out)
    splits.misfits(sums, misfits)
    for k in range(3):
        mine = points[part == k]
        x, y, height, p = mine.T
        root = np.sqrt(p)
        t = np.linalg.lstsq(root[:, None] * oracles.design(x, y), root * height, rcond=None)[0]
        off = np.sqrt(points[:, 3]) * (points[:, 2] - oracles.design(*points[:, :2].T) @ t)
        a, b = sides[(part[sides] == k).all(axis=1)].T
        expected = (off[a] * off[b]).sum(), 0.5 * (off[a] ** 2 + off[b] ** 2).sum(), len(a)
        assert_allclose(out[k], expected, rtol=1e-6, atol=1e-6)
        assert_allclose(sums[k], oracles.moments(height, p, x, y)[: splits.SUMS], rtol=1e-9)
        assert_allclose(misfits[k], chi2(mine), rtol=1e-6)


def test_residuals_are_those_of_mean_inverse_depth():
    rng = np.random.default_rng(0)
    rows, of_unit = np.zeros((50, 13)), rng.integers(0, 4, 50).astype(np.int32)
    p, x, y, w = rng.uniform(1, 2, 50), *rng.uniform(-1, 1, (3, 50))
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 6] = p, p * x, p * y, p * w
    planes, out = rng.uniform(-1, 1, (4, 3)), np.empty((4, 2))
    splits.residual_squares(rows, of_unit, planes, out)
    off = w - (oracles.design(x, y) * planes[of_unit]).sum(axis=1)
    assert_allclose(out[:, 0], np.bincount(of_unit, p * off**2, 4))
    assert_array_equal(out[:, 1], np.bincount(of_unit, minlength=4))


@pytest.mark.parametrize("sigma", [0.0005, 0.002])
@pytest.mark.parametrize("name", flat_edges.EDGES)
def test_planes_at_flat_angles_are_several(name, sigma):
    scene, degrees = flat_edges.EDGES[name]
    relief, truth = scene(X, Y, degrees)
    model = flat_edges.found(relief, sigma)
    assert len(model) == len(np.unique(truth))
    assert flat_edges.wrong(model.labels, truth) < 0.025


@pytest.mark.parametrize("sigma", [0.0001, 0.0003])
@pytest.mark.parametrize("name", flat_edges.STEPS)
def test_what_stands_a_little_off_a_wall_is_a_plane_of_its_own(name, sigma):
    scene, step = flat_edges.STEPS[name]
    relief, truth = scene(X, Y, step)
    with flat_edges.unsplit():
        assert len(flat_edges.found(relief, sigma)) == 1
    model = flat_edges.found(relief, sigma)
    assert len(model) == 2
    assert flat_edges.wrong(model.labels, truth) < 0.002
    assert max(plane.rms for plane in model.planes) < 1.05 * sigma


@pytest.mark.parametrize(
    ("boards", "seed"),
    [(4, 0), (4, 1), (1, 3)],  # of the last, cells along its edge stay bent
)
def test_boards_less_than_two_sigma_off_a_wall_are_planes_of_their_own(boards, seed):
    sigma, places = 0.002, np.array([(-0.75, -0.55), (0.65, -0.5), (-0.7, 0.4), (0.7, 0.45)])
    on = [(np.abs(X - x) < 0.25) & (np.abs(Y - y) < 0.28) for x, y in places[:boards]]
    relief, truth = flat_edges.off(np.any(on, axis=0), 1.7 * sigma)
    with flat_edges.unsplit():
        before = flat_edges.found(relief, sigma, seed)
    after = flat_edges.found(relief, sigma, seed)
    assert len(before) == 1
    assert len(after) == 2
    assert after.information < before.information - 1000
    assert flat_edges.wrong(after.labels, truth) < 0.05


@pytest.mark.parametrize("name", ["edge, 1 degree", "four planes about a point, 0.6 degrees"])
def test_phi_is_lower_once_they_are_split(name):
    scene, degrees = flat_edges.EDGES[name]
    relief, truth = scene(X, Y, degrees)
    with flat_edges.unsplit():
        before = flat_edges.found(relief, 0.0005)
    after = flat_edges.found(relief, 0.0005)
    assert len(before) < len(after) == len(np.unique(truth))
    assert after.information < before.information - 1000
    assert before.planes[0].residual_correlation > 0.9
    assert max(plane.residual_correlation for plane in after.planes) < 0.1
    assert min(plane.significance for plane in after.planes) > 1000


@pytest.mark.parametrize(
    ("at", "significance", "count"), [(0.0, 8e3, 2), (0.0, 12e3, 1), (0.4, 5e3, 2), (0.4, 8e3, 1)]
)
def test_a_segment_stays_whole_where_no_more_planes_are_significant(at, significance, count):
    """Of two walls at one degree, one or both are not, but what both are together is."""
    size = (240, 320)
    relief, _ = flat_edges.edge(flat_edges.wall(size)[0] - at, np.zeros(size), 1.0)
    model = flat_edges.found(relief, 0.002, significance=significance)
    assert len(model) == count
    assert (model.labels > 0).all()


@pytest.mark.parametrize("sigma", [0.0005, 0.001, 0.004])
@pytest.mark.parametrize("name", flat_edges.SMOOTH)
def test_smooth_surfaces_are_not_split(name, sigma):
    relief = flat_edges.SMOOTH[name](X, Y)
    with flat_edges.unsplit():
        before = flat_edges.found(relief, sigma)
    after = flat_edges.found(relief, sigma)
    assert_array_equal(after.labels, before.labels)
    assert after.information == before.information


def fine_room(seed):
    """A room of 1280 x 720 pixels, every flat face labelled, its planes without and with splits."""
    scene = pw.scenes.room(seed, size=(720, 1280), every_face=True)

    def planes():
        return pw.detect_planes(scene.depth, scene.camera, scene.sensor).labels

    with fine_rooms.unparted():  # planes that are two faces are no matter of segments
        with flat_edges.unsplit():
            before = planes()
        return scene.labels, before, planes()


def test_facets_of_round_things_are_no_planes():
    truth, before, after = fine_room(0)

    def on_round_things(labels):
        return sum(np.mean(truth[labels == k] == 0) > 0.7 for k in range(1, labels.max() + 1))

    assert on_round_things(before) == 2
    assert on_round_things(after) == 0
    scores = [evaluate(labels, truth).row() for labels in (before, after)]
    assert scores[0]["precision@0.5"] < 0.9
    assert scores[1]["precision@0.5"] == 1.0


def test_narrow_faces_that_were_one_segment_are_told_apart():
    truth, before, after = fine_room(20)
    scores = [evaluate(labels, truth).row() for labels in (before, after)]
    for score in ("precision@0.5", "recall@0.5", "recall@0.8"):
        assert scores[1][score] > scores[0][score] + 0.03, score


@pytest.mark.parametrize("radius", [0.1, 0.5])
@pytest.mark.parametrize("degrees", [3, 12])
def test_rounded_edges_have_no_planes_of_their_own(degrees, radius):
    slope = np.tan(np.radians(degrees))
    half = 0.5 * radius * slope  # of the piece of a parabola between the walls
    relief = slope * np.where(np.abs(X) < half, (X + half) ** 2 / (4 * half), np.maximum(X, 0.0))
    assert len(flat_edges.found(relief, 0.002)) == 2


def test_the_same_planes_for_any_number_of_threads():
    relief, _ = flat_edges.facets(X, Y, 1.5)
    depth = 1 / (0.5 + relief / 4) + np.random.default_rng(0).normal(0, 0.001, SIZE)
    sensor = pw.Sensor(max_depth=5.0, resolution=1e-4, noise=0.001)
    one, two = (
        pw.detect_planes(depth, flat_edges.camera(SIZE), sensor, threads=count) for count in (1, 2)
    )
    assert len(one) == 4
    assert_array_equal(one.labels, two.labels)
    assert one.information == two.information
