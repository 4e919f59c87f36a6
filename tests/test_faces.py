"""Planes that are two faces are parted; what is one plane, or round, is not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.kernels import faces
from planewise.kernels.labels import CHUNK, FIXED, NONE, WAITING
from planewise.kernels.splits import halve
from planewise.runtime.workspace import Workspace
from planewise.spatial.faces import LabelPixels, may_be_two, misfits_of, parted
from planewise.spatial.tame_frame import tame_frame

SIZE = 60, 80
SIGMA = 1e-3
CLEAR, WORSE, ROUGH, FEWEST, NARROWEST, MANY, MOST = 200.0, 1.15, 2.0, 64, 0.02, 300, 16.0


def images(rng, w, alike=True):
    """w with noise, p, x, y as the loops take them."""
    p = (rng.uniform(0.5, 2.0, SIZE) / SIGMA**2).astype(np.float32)
    noisy = (w + rng.standard_normal(SIZE) / np.sqrt(p)).astype(np.float32)
    x = ((np.arange(SIZE[1], dtype=np.float32) - 30) / 100)[None]
    y = ((np.arange(SIZE[0], dtype=np.float32) - 20) / 100)[:, None]
    return (noisy, p, x, y) if alike else (noisy, p, *map(np.ascontiguousarray, grid(x, y)))


def grid(x, y):
    return np.broadcast_to(x, SIZE), np.broadcast_to(y, SIZE)


def ridge(column, turn):
    """Inverse depth of two planes that meet in a column, by `turn` in slope."""
    _, _, x, y = images(np.random.default_rng(0), np.zeros(SIZE))
    return 0.5 + 0.1 * x - 0.2 * y + turn * np.maximum(x - x[0, column], 0.0)


TURN = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # from (t0, t1, t2) to space


def told(w, p, x, y, pixels, white=1.0, straight=1.0):
    by_face = np.empty_like(pixels)
    planes, information = np.empty((2, 3)), np.empty((2, 9))
    saved, larger = faces.two_faces(
        pixels,
        w,
        p,
        x,
        y,
        white,
        CLEAR,
        WORSE,
        ROUGH,
        FEWEST,
        NARROWEST,
        MANY,
        MOST,
        TURN,
        straight,
        by_face,
        planes,
        information,
    )
    if not saved:
        return 0.0, np.zeros(len(pixels), np.bool_), planes, information
    assert_array_equal(np.sort(by_face), pixels)
    for face in (by_face[:larger], by_face[larger:]):
        assert (np.diff(face) > 0).all()
    return saved, np.isin(pixels, by_face[larger:]), planes, information


def squares(images, pixels):
    """Squared residuals of readings about their best plane, in variances."""
    w, p, x, y = images
    x, y, w, p = (each.reshape(-1)[pixels].astype(float) for each in (*grid(x, y), w, p))
    root, terms = np.sqrt(p), np.stack((np.ones_like(x), x, y))
    plane = np.linalg.lstsq((terms * root).T, w * root, rcond=None)[0]
    return (w - plane @ terms) ** 2 * p


def chi2(images, pixels):
    return squares(images, pixels).sum()


def sides(images, pixels):
    """On which side of the best line each is, and which have a say: those near its plane there."""
    w, p, x, y = images
    x, y, w, p = (each.reshape(-1)[pixels].astype(float) for each in (*grid(x, y), w, p))
    side, left = np.empty(len(pixels), np.bool_), np.ones(len(pixels), np.bool_)
    points = np.column_stack((*(each - np.average(each, weights=p) for each in (x, y, w)), p))
    assert halve(points, FEWEST, MANY, side)
    square = np.empty(len(pixels))
    for _ in range(3):
        for here in (left & ~side, left & side):
            square[here] = squares(images, pixels[here])
        left &= square < 9.0 * max(1.0, square[left].mean())
    return side, left


@pytest.mark.parametrize("alike", [True, False])
@pytest.mark.parametrize(("column", "small"), [(70, np.s_[71:]), (8, np.s_[:8])])
def test_two_faces_are_told_apart(alike, column, small):
    rng = np.random.default_rng(column)
    seen = images(rng, ridge(column, -0.04), alike)
    pixels = np.flatnonzero(rng.random(SIZE[0] * SIZE[1]) < 0.7)  # the others are on other planes
    kept = [each.copy() for each in seen]
    saved, second, planes, information = told(*seen, pixels)
    for each, before in zip(seen, kept, strict=True):
        assert_array_equal(each, before)
    truth = np.zeros(SIZE, np.bool_)
    truth[:, small] = True
    assert (second == truth.reshape(-1)[pixels]).mean() > 0.97
    tame = squares(seen, pixels)
    tame = tame < MOST * max(tame.mean(), 1.0)
    pixels, second = pixels[tame], second[tame]
    side, left = sides(seen, pixels)
    assert 0.98 < left.mean() < 1.0
    pixels, second = pixels[left], second[left]
    assert_array_equal(second, side[left] == (side[left].mean() <= 0.5))
    one, first, other = (chi2(seen, each) for each in (pixels, pixels[~second], pixels[second]))
    assert_allclose(saved, one - first - other, rtol=1e-6)
    for mine, plane, matrix in zip((~second, second), planes, information, strict=True):
        w, p, x, y = seen
        at = pixels[mine]
        x, y = (each.reshape(-1)[at].astype(float) for each in grid(x, y))
        terms, weight = np.stack((np.ones_like(x), x, y)), p.reshape(-1)[at].astype(float)
        normal = (terms * weight) @ terms.T
        right = (terms * weight) @ w.reshape(-1)[at]
        assert_allclose(matrix[:6], normal[np.triu_indices(3)], rtol=1e-6, atol=1e-3 * matrix[0])
        assert_allclose(matrix[6:], right, rtol=1e-6, atol=1e-3 * matrix[6])
        assert_allclose(plane, np.linalg.solve(normal, right), rtol=1e-5)


def test_faces_that_do_not_meet_in_an_edge_are_no_two():
    pixels = np.arange(SIZE[0] * SIZE[1])
    seen = images(np.random.default_rng(2), ridge(60, 0.1))
    saved, _, planes, _ = told(*seen, pixels)
    assert saved > CLEAR
    one, other = planes @ TURN.T
    cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
    assert told(*seen, pixels, straight=cosine + 1e-9)[0] == saved
    assert told(*seen, pixels, straight=cosine - 1e-9)[0] == 0.0


def strip(w, seed):
    """Images of w, and the pixels of some columns: as good as a smooth surface once they err."""
    pixels = np.arange(w.size).reshape(SIZE)[:, 30:58].ravel()
    return images(np.random.default_rng(seed), w), pixels


def smooth(images, pixels):
    """chi^2 of the best polynomial of the third degree."""
    w, p, x, y = images
    x, y, w, p = (each.reshape(-1)[pixels].astype(float) for each in (*grid(x, y), w, p))
    return _misfit(np.column_stack((x - x.mean(), y - y.mean(), w - w.mean(), p)))


def test_what_is_on_neither_of_two_faces_has_no_say():
    w = ridge(44, -0.1)
    before = told(*strip(w, 9)[0], strip(w, 9)[1])
    w[-3:] += 8 * SIGMA
    seen, pixels = strip(w, 9)
    saved, second, planes, _ = told(*seen, pixels)
    assert saved > CLEAR
    assert_allclose(planes, before[2], atol=1e-3)
    inside = pixels < w.size - 3 * SIZE[1]
    assert (second == before[1])[inside].mean() > 0.99
    side = pixels % SIZE[1] > 44
    assert smooth(seen, pixels) < chi2(seen, pixels[side]) + chi2(seen, pixels[~side])


@pytest.mark.parametrize(("bend", "found"), [(0.0, True), (0.1, True), (4.0, False)])
def test_a_strip_that_bends_is_no_face(bend, found):
    """As of a cylinder beside a face: both together are not smooth, but neither is it flat."""
    _, _, x, _ = images(np.random.default_rng(0), np.zeros(SIZE))
    w = ridge(44, 0.4) - bend * np.square(np.maximum(x - x[0, 44], 0.0))
    seen, pixels = strip(w, 11)
    assert (told(*seen, pixels)[0] > CLEAR) == found


def test_of_three_faces_two_are_told_apart():
    _, _, _, y = images(np.random.default_rng(0), np.zeros(SIZE))
    seen, pixels = strip(ridge(44, -0.05) - 0.08 * np.maximum(y - y[52], 0.0), 10)
    saved, second, *_ = told(*seen, pixels)
    assert saved > CLEAR
    assert (second == (pixels % SIZE[1] > 44))[pixels < 52 * SIZE[1]].mean() > 0.95
    assert smooth(seen, pixels) < chi2(seen, pixels[second]) + chi2(seen, pixels[~second])


def test_the_size_of_the_noise_counts():
    seen = images(np.random.default_rng(1), ridge(70, -0.05))
    pixels = np.arange(SIZE[0] * SIZE[1])
    assert told(*seen, pixels)[0] > CLEAR
    assert told(*seen, pixels, white=9.0)[0] == 0.0


def flat(x, y):
    return 0.5 + 0.1 * x - 0.2 * y


def sphere(x, y):
    return flat(x, y) - 0.4 * x * x - 0.4 * y * y


def saddle(x, y):
    return flat(x, y) + 0.4 * x * x - 0.5 * y * y


@pytest.mark.parametrize("surface", [flat, sphere, saddle])
@pytest.mark.parametrize("seed", range(3))
def test_one_smooth_surface_is_no_two_faces(surface, seed):
    rng = np.random.default_rng(seed)
    _, _, x, y = images(rng, np.zeros(SIZE))
    assert told(*images(rng, surface(x, y)), np.arange(SIZE[0] * SIZE[1]))[0] == 0.0


def test_too_few_readings_are_no_face():
    seen = images(np.random.default_rng(2), ridge(40, -0.05))
    assert told(*seen, np.arange(2 * FEWEST - 1))[0] == 0.0
    assert told(*seen, np.arange(10 * SIZE[1]))[0] > CLEAR


@pytest.mark.parametrize(("wide", "found"), [(1, False), (2, False), (3, True), (4, True)])
def test_two_columns_may_be_mixed_and_are_no_face(wide, found):
    w = ridge(40, 0.0)
    w[:, -wide:] += 3 * SIGMA
    pixels = np.arange(SIZE[0] * SIZE[1]).reshape(SIZE)[:, 20:].ravel()
    assert (told(*images(np.random.default_rng(wide), w), pixels)[0] > CLEAR) == found


def test_what_is_no_plane_itself_is_no_face():
    rng = np.random.default_rng(8)
    w, p, x, y = images(rng, ridge(60, -0.08))
    pixels = np.arange(w.size)
    assert told(w, p, x, y, pixels)[0] > CLEAR
    w[:, 61:] += 1.5 * SIGMA * rng.standard_normal((SIZE[0], SIZE[1] - 61)).astype(np.float32)
    assert told(w, p, x, y, pixels)[0] == 0.0


def test_wild_readings_make_no_face():
    rng = np.random.default_rng(3)
    w, p, x, y = images(rng, ridge(70, 0.0))
    wild = rng.random(SIZE) < 0.05
    w[wild] += rng.uniform(-0.1, 0.1, wild.sum()).astype(np.float32)
    assert told(w, p, x, y, np.arange(w.size))[0] == 0.0


@pytest.mark.parametrize("degree", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_smooth_misfit(seed, degree):
    rng = np.random.default_rng(seed)
    x, y, p = rng.uniform(-2, 3, 300), rng.uniform(-1, 1, 300), rng.uniform(1, 3, 300)
    height = x**3 - y * x + 0.3 * rng.standard_normal(300)
    powers = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)])
    root = np.sqrt(p)
    left = np.linalg.lstsq((powers * root).T, height * root, rcond=None)[1]
    points = np.column_stack((x, y, height, p))
    assert_allclose(_misfit(points, degree), left[0], rtol=1e-6)
    points[:, 1] = 0.0  # in a line: as many terms as that has
    left = np.linalg.lstsq(np.vander(x, degree + 1) * root[:, None], height * root, rcond=None)[1]
    assert_allclose(_misfit(points, degree), left[0], rtol=1e-6)


def _misfit(points, degree=3):
    return faces.smooth_misfit.py_func(points, degree)  # no loop of its own: part of `two_faces`


@pytest.mark.parametrize("alike", [True, False])
def test_label_misfits(alike):
    rng = np.random.default_rng(4)
    w, p, x, y = images(rng, ridge(40, 0.1), alike)
    label = np.kron(rng.integers(0, 4, (6, 8)), np.ones((10, 10))).astype(np.uint16)
    p[label == 0] = 0
    planes = np.vstack((np.zeros(3), 0.5 + 0.01 * rng.standard_normal((3, 3))))
    out = np.full((4, 2), 9.0)
    faces.label_misfits(label, w, p, x, y, planes, 5, 1e4, out)
    rows = np.s_[2::5]
    a, b = grid(x, y)
    off = w - planes[label, 0] - planes[label, 1] * a - planes[label, 2] * b
    square = np.minimum(off**2 * p, 1e4)[rows]
    expected = [
        (square[label[rows] == j].sum(), (label[rows] == j).sum()) if j else (0, 0)
        for j in range(4)
    ]
    assert_allclose(out, expected, rtol=1e-5)
    assert (out[1:, 0] > 1e4).all()


@given(st.integers(2, 2**20), st.integers(0, 2**31 - 1), st.sampled_from((-1, 0, 1)))
def test_places_of_pixels(columns, about, beside):
    pixel = np.int32(min(max(about // columns * columns + beside, 0), 2**31 - 1))
    assert faces.place_of.py_func(pixel, columns) == divmod(int(pixel), columns)


def test_list_pixels():
    rng = np.random.default_rng(5)
    label = np.kron(rng.integers(0, 4, (6, 8)), np.ones((10, 10))).astype(np.uint16)
    slot = np.array([-1, 1, -1, 0])
    counts = np.array([(label == 3).sum(), (label == 1).sum()])
    room = counts + np.array([7, 0])
    stop, pixels = np.cumsum(room), np.full(room.sum(), -5, np.int32)
    first = stop - room
    assert faces.list_pixels(label, slot, first, stop, pixels)
    assert_array_equal(stop - first, counts)
    for j, a, b in zip((3, 1), first, stop, strict=True):
        assert_array_equal(pixels[a:b], np.flatnonzero(label == j))
    stop = np.cumsum(counts - np.array([0, 1]))
    assert not faces.list_pixels(label, slot, stop - counts + np.array([0, 1]), stop, pixels)


def test_wait_about():
    rng = np.random.default_rng(6)
    named = rng.integers(0, 5, SIZE).astype(np.uint16)
    label = np.full((SIZE[0] + 2, 6 * CHUNK), NONE)
    label[1:-1, 1 : SIZE[1] + 1] = np.where(rng.random(SIZE) < 0.1, NONE, rng.integers(0, 5, SIZE))
    state = np.where(label == NONE, FIXED, np.uint8(0))
    there = np.flatnonzero(label[1:-1, 1 : SIZE[1] + 1] != NONE)
    pixels = rng.choice(there, 40, replace=False)
    mine = np.array([True, False, True, False, True])
    busy, seen = np.zeros((2, len(label), 6), np.bool_)
    new = label.copy()
    new[pixels // SIZE[1] + 1, pixels % SIZE[1] + 1] = named.reshape(-1)[pixels]
    waits = np.zeros(label.shape, np.bool_)
    for i, j in zip(pixels // SIZE[1], pixels % SIZE[1], strict=True):
        waits[i : i + 3, j : j + 3] = True
    waits &= (new != NONE) & mine[new]
    faces.wait_about(pixels, named, mine, label, state, busy, seen)
    assert_array_equal(label, new)
    assert_array_equal(state == WAITING, waits)
    assert_array_equal(busy, waits.reshape(len(label), 6, CHUNK).any(axis=2))
    assert_array_equal(seen, busy)


@pytest.mark.parametrize("alike", [True, False])
def test_labels_of_what_lies_off_their_plane_are_given_back(alike):
    """Of four labels one takes in its own plane, one what bends away; one may not be taken back."""
    rng = np.random.default_rng(7)
    _, _, x, y = images(rng, np.zeros(SIZE))
    named = np.kron(np.arange(5), np.ones((SIZE[0], 16))).astype(np.uint16)
    label = np.full((SIZE[0] + 2, 6 * CHUNK), NONE)
    label[1:-1, 1 : SIZE[1] + 1] = named
    new = np.zeros(SIZE, np.bool_)
    new[10:30, 16:] = rng.random((20, 64)) < 0.8
    bent = flat(x, y) + new * np.float32([0, 0, 2, 2, 1.2])[named] * SIGMA * x * x / 0.02
    w, p, x, y = images(rng, bent, alike)
    named[new] = 0
    seen = np.ones((len(label), 6), np.bool_)
    mine = np.array([False, True, True, False, True])
    expected, most = label.copy(), 2.0
    for number in (1, 2, 4):
        of = label[1:-1, 1 : SIZE[1] + 1] == number
        kept, both = np.flatnonzero(of & ~new), np.flatnonzero(of)
        added = chi2((w, p, x, y), both) - chi2((w, p, x, y), kept)
        if added > most * (of & new).sum():
            expected[1:-1, 1 : SIZE[1] + 1][of & new] = 0
    assert {number for number in (1, 2, 4) if (expected != label)[label == number].any()} == {2, 4}
    untouched = label.copy()
    faces.give_back(named, untouched, ~seen, mine.copy(), w, p, x, y, most)
    assert_array_equal(untouched, label)
    faces.give_back(named, label, seen, mine, w, p, x, y, most)
    assert_array_equal(label, expected)
    assert_array_equal(np.flatnonzero(mine), [2, 4])


def box(width, sigma=0.004, size=(240, 320)):
    """A box before a wall, seen at its edge: a wide face, and one that is `width` columns wide."""
    camera = pw.PinholeCamera(fx=260, fy=260, cx=(size[1] - 1) / 2, cy=(size[0] - 1) / 2)
    x, y = np.moveaxis(camera.rays(size)[..., :2], -1, 0)
    depth, truth = np.full(size, 4.0), np.ones(size, np.uint16)
    inside = (np.abs(y) < 0.25) & (x > -0.3) & (x < width / 260)
    near = 2.0 / np.where(x < 0, 1 - 0.4 * x, 1 - 2.0 * x)  # they meet at x = 0, at right angles
    depth[inside], truth[inside & (x < 0)], truth[inside & (x >= 0)] = near[inside], 2, 3
    noise = sigma * np.random.default_rng(0).standard_normal(size)
    return depth + noise, truth, camera, pw.Sensor(noise=sigma)


@pytest.mark.parametrize(("room", "pair"), [(3, (15, 21)), (5, (13, 14)), (10, (12, 15))])
def test_narrow_faces_of_boxes_are_not_one(room, pair):
    scene = pw.scenes.room(room, every_face=True)
    model, again = (
        pw.detect_planes(scene.depth, scene.camera, scene.sensor, threads=threads)
        for threads in (1, 2)
    )
    assert_array_equal(model.labels, again.labels)
    assert model.information == again.information
    for face in pair:
        true = scene.labels == face
        mine = model.labels == np.bincount(model.labels[true]).argmax()
        assert (mine & true).sum() > 0.7 * (mine | true).sum()


def looked_at(frame, rows, labels):
    """Pixels of planes that may be two faces."""
    misfits = misfits_of(frame, 1.0, rows, labels)
    return LabelPixels.of(labels, may_be_two(1.0, misfits, 30.0, 0.0), misfits[:, 1], Workspace())


def test_parted_returns_what_it_was_given_where_nothing_is_two_faces():
    depth, truth, camera, sensor = box(8)
    observation = pw.observe(depth, camera, sensor)
    frame = tame_frame(observation)
    rows = np.zeros((3, 13))
    for j in range(3):
        w, p, x, y = (
            np.broadcast_to(each, truth.shape)[truth == j + 1].astype(float)
            for each in (frame.w, frame.p, *frame.sectors.coordinates)
        )
        terms = np.stack((np.ones_like(x), x, y))
        normal = (terms * p) @ terms.T
        rows[j, :6], rows[j, 6:9] = normal[np.triu_indices(3)], (terms * p) @ w
    labels = truth.copy()
    out, saved, pixels = parted(frame, 1.0, rows, labels, looked_at(frame, rows, labels), 30.0, 0.0)
    assert_array_equal(out, rows)
    assert_array_equal(labels, truth)
    assert not saved.size
    assert not pixels.size

    both = np.minimum(truth, 2)  # as if the faces of the box were one
    kept, two = both.copy(), np.array([rows[0], rows[1] + rows[2]])
    out, saved, pixels = parted(frame, 1.0, two, both, looked_at(frame, two, both), 30.0, 0.0)
    assert saved.shape == (1,)
    assert saved[0] > 4 * 30
    assert (both[truth == 3] == 3).mean() > 0.9
    assert (both[truth == 2] == 2).mean() > 0.97
    assert_array_equal(np.sort(pixels), np.flatnonzero(both != kept))
    narrow = rows[2, :9]
    plane = np.linalg.solve(narrow[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3), narrow[6:])
    found = np.linalg.solve(out[2, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3), out[2, 6:9])
    assert_allclose(found, plane, atol=0.02)
