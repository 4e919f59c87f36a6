"""Planes at flat angles, and what stands a little off, are several; smooth surfaces are not."""

import numpy as np
import pytest
from benchmarks import fine_rooms, flat_edges
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import levels
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


@pytest.mark.parametrize(("off", "wrong"), [(1.7, 0.02), (3.0, 0.005), (6.0, 0.005), (12.0, 0.005)])
@pytest.mark.parametrize("name", flat_edges.BOARDS)
def test_boards_before_a_wall_are_told_from_it(name, off, wrong):
    relief, truth = flat_edges.off(flat_edges.boards(X, Y, *flat_edges.BOARDS[name]), off * 0.002)
    model = flat_edges.found(relief, 0.002)
    assert len(model) == 2
    assert flat_edges.wrong(model.labels, truth) < wrong


def test_a_wall_is_found_that_looks_curved_with_the_boards_before_it():
    """Of five boards, 3 to 9 standard deviations off, three were in one segment with it."""
    relief = np.zeros(SIZE)
    for number in range(5):
        top, left = 40 + 200 * (number // 3), 40 + 186 * (number % 3)
        relief[top : top + 60, left : left + 60] = 0.0015 * (1 + number / 2)
    with flat_edges.unsplit():
        assert len(flat_edges.found(relief, 0.0005)) == 0
    model = flat_edges.found(relief, 0.0005)
    wall = (model.labels == 1) == (relief == 0)
    assert len(model) >= 4
    assert wall.mean() > 0.999


def on_a_grid(height, sigma=0.05, seed=0):
    """Points (n, 4) of a grid of units of these heights (rows, columns), and pairs side by side."""
    rows, columns = height.shape
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    height = height + sigma * np.random.default_rng(seed).standard_normal(height.shape)
    number = np.arange(height.size).reshape(height.shape)
    across, down = (number[:, :-1], number[:, 1:]), (number[:-1], number[1:])
    sides = np.concatenate([np.stack(pair, axis=2).reshape(-1, 2) for pair in (across, down)])
    p = np.full(height.size, sigma**-2)
    return np.column_stack((x.ravel(), y.ravel(), height.ravel(), p)), sides


def test_levels_are_those_about_a_smooth_surface_of_most_units():
    y, x = np.mgrid[-1:1:40j, -1:1:60j]
    up, down = (np.abs(x) < 0.5) & (np.abs(y) < 0.4), np.hypot(x - 0.75, y) < 0.2
    points, _ = on_a_grid(x * y + x**3 + 0.5 * up - 0.5 * down)
    level = levels._level(points).reshape(x.shape)
    assert np.mean(level == 1.0 * up - 1.0 * down) > 0.995


def test_no_level_is_off_what_bends_all_over():
    """As terraces do, into which readings of a wall fall where steps are coarser than noise."""
    y, x = np.mgrid[-1:1:40j, -1:1:60j]
    points, _ = on_a_grid(np.round(2.3 * x + 3.1 * y) - 2.3 * x - 3.1 * y)
    assert not levels._level(points).any()


@pytest.mark.parametrize(("discord", "pieces"), [(3.0, 1), (4.9, 1), (5.1, 2), (9.0, 2)])
def test_a_level_ends_where_its_border_is_in_discord(discord, pieces):
    """A chain of units, of which the last six are higher; 11.34 is broken on any level."""
    level, sides = np.repeat([0, 1], 6), np.stack((np.arange(11), np.arange(1, 12)), axis=1)
    of_sides = np.full(11, 3.0)
    of_sides[5] = discord
    assert levels._pieces(level, of_sides, sides).max() + 1 == pieces


def test_units_of_clear_discord_hang_together_no_more():
    level, sides = np.zeros(4, np.intp), np.array([[0, 1], [1, 2], [2, 3], [0, 3]])
    assert_array_equal(levels._pieces(level, np.array([3.0, 12.0, 3.0, 12.0]), sides), [0, 0, 1, 1])


@pytest.mark.parametrize("between", [0.0, 0.03])  # half as wide as units across the step
def test_what_is_smooth_with_the_part_it_touches_is_no_part(between):
    """A bulge before a wall, the middle of which is another level."""
    y, x = np.mgrid[-1:1:40j, -1:1:60j]
    on, middle = np.hypot(x, y) < 0.8, np.hypot(x, y) < 0.5
    piece = np.where(middle, 2, on).astype(np.intp)
    piece[np.abs(np.hypot(x, y) - 0.5) < between] = 3
    points, sides = on_a_grid(np.where(on, 5 - x**2 - y**2, 0.0))
    assert levels._parts(points, piece.ravel(), sides, 30.0) is None
    points, sides = on_a_grid(np.where(middle, 5.0, 3.0 * on))
    part, none = levels._parts(points, piece.ravel(), sides, 30.0)
    assert_array_equal(part, piece.ravel())
    assert none.tolist() == [False] * 3 + [True] * (between > 0)


def test_of_many_pieces_the_largest_are_looked_at():
    """A hundred boards on one plane, ten of them larger, and sixty-three besides the wall count."""
    row, column = np.mgrid[:61, :91]
    board = (row % 6 > 1) & (column % 9 > 4) & (row < 60) & (column < 90)
    larger = (row < 6) & (column % 9 > 3) & (row % 6 > 1) & (column < 90)
    piece = np.where(board | larger, 1 + row // 6 * 10 + column // 9, 0)
    points, sides = on_a_grid(10.0 * (piece > 0))
    part, none = levels._parts(points, piece.astype(np.intp).ravel(), sides, 30.0)
    assert none.tolist() == [False, False, True]
    assert_array_equal(part[piece.ravel() == 0], 0)
    assert_array_equal(part[larger.ravel()], 1)
    assert np.count_nonzero(part == 2) == 37 * 16


@pytest.mark.parametrize(
    ("rows", "columns", "told"),
    [(4, 3, True), (12, 2, False), (3, 3, False)],  # the last two: none inside; fewer than twelve
)
def test_a_part_has_units_inside_it_and_not_only_along_a_step(rows, columns, told):
    on = np.zeros((30, 40), np.bool_)
    on[10 : 10 + rows, 10 : 10 + columns] = True
    points, sides = on_a_grid(10.0 * on)
    found = levels._parts(points, on.ravel().astype(np.intp), sides, 30.0)
    assert (found is not None) == told
    if found is not None:
        assert_array_equal(found[0], on.ravel())
        assert not found[1][:2].any()


def test_a_smooth_surface_is_not_divided_into_levels():
    x = np.tile(np.linspace(-1, 1, 40), (30, 1))
    points, sides = on_a_grid(2.0 * x**2)
    assert levels._parts(points, (np.abs(x) > 0.6).astype(np.intp).ravel(), sides, 30.0) is None


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
    ("at", "significance", "count"), [(0.0, 8e3, 2), (0.0, 14e3, 1), (0.4, 5e3, 2), (0.4, 8e3, 1)]
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
