"""Every compiled loop of the spatial search against its plain NumPy version."""

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from planewise.kernels import borders, cells, forms, gaps, segments, squares
from planewise.spatial.segments import Segments

from . import spatial_oracles as oracles
from .conftest import quilt

MERGING = {"white": 1.0, "split": 40.0, "hopeless": 25.0, "filled": 0.5}
SIGMA = 1e-3
DRIFT = SIGMA**2
LEAN = 3 * SIGMA
PRICE = (0.1, 0.8, 4.0)


def coordinates(shape):
    """x and y of pixels, the principal point off the middle."""
    i, j = np.indices(shape, dtype=float)
    return (j - 0.4 * shape[1]) / 100, (i - 0.7 * shape[0]) / 100


def readings(rng, planes, label, holes=0.0):
    """w, p, x, y of labelled planes with white noise; no reading at some pixels."""
    x, y = coordinates(label.shape)
    t = np.asarray(planes)[label]
    p = rng.uniform(0.7, 1.4, label.shape) / SIGMA**2
    p[rng.random(label.shape) < holes] = 0
    w = t[..., 0] + t[..., 1] * x + t[..., 2] * y + rng.normal(0, SIGMA, label.shape)
    return np.where(p > 0, w, 0), p, x, y


def cells_of(images, straight=False):
    """Counts and misfits of cells, moments and misfits of 2 x 2 of them, moments of 3 x 3."""
    rows, columns = (-(-n // cells.SIDE) for n in images[0].shape)
    halved, third = (-(-rows // 2), -(-columns // 2)), (-(-rows // 3), -(-columns // 3))
    shapes = (rows, columns), (halved[0], 11, halved[1]), halved, (third[0], 12, third[1])
    count = np.full((rows, columns), 9, np.uint8)
    out = [count, *(np.full(shape, 9.0) for shape in shapes)]
    cells.cell_moments(*images, straight, 0, -(-rows // cells.STRIP), *out)
    return out


def merge(images):
    *statistics, _ = cells_of(images)
    misfits = statistics[1]
    unit, planes = np.empty(misfits.shape, np.int32), np.empty((cells.PLANE, misfits.size))
    counts, size = np.empty((2, misfits.size))
    squares = np.empty(statistics[3].shape, np.int32)
    out = unit, squares, planes, counts, size
    found = cells.merge_quarters(*images, *statistics, *MERGING.values(), *out)
    whole = np.append(size[:found] == 2, False)[unit[::2, ::2]]
    assert_array_equal(squares[whole], unit[::2, ::2][whole])
    assert np.count_nonzero(squares >= 0) == np.count_nonzero(size[:found] == 2)
    return unit, np.vstack((planes[:, :found], counts[:found])), size[:found]


def segment_rows(units, offset, tilt):
    *planes, count = units
    out = np.empty((count.size, 13))
    inflation = np.maximum(1, planes[5] / (count - 3))
    cells.marginalise(np.array(planes), count, inflation, offset, tilt, out)
    return out


PLANES = np.array([[0.50, 0.03, -0.02], [0.53, -0.05, 0.04], [0.47, 0.08, 0.06]])


# Cells


@pytest.mark.parametrize("shape", [(12, 18), (13, 20), (2, 4)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_counts_of_cells_and_their_misfits(shape, dtype):
    rng = np.random.default_rng(0)
    images = [i.astype(dtype) for i in readings(rng, PLANES, quilt(rng, shape, 3), holes=0.2)]
    count, misfits, _, _, _ = cells_of(images)
    exact = oracles.cell_moments(*(image.astype(float) for image in images), 3)
    assert_array_equal(count.reshape(-1), exact[:, 10])
    for c, row in enumerate(exact):
        part = oracles.block(images, c // misfits.shape[1] * 3, c % misfits.shape[1] * 3, 3)
        if row[10] > 5:
            part = (v.astype(float) for v in part)
            assert misfits.flat[c] == pytest.approx(oracles.misfit(*part), rel=1e-5)


@pytest.mark.parametrize("shape", [(27, 36), (31, 41), (2, 4), (22, 31)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_moments_of_tiles(shape, dtype):
    rng = np.random.default_rng(2)
    images = [i.astype(dtype) for i in readings(rng, PLANES, quilt(rng, shape, 3), holes=0.2)]
    tiles = cells_of(images)[4].transpose(1, 0, 2)
    exact = oracles.cell_moments(*(image.astype(float) for image in images), 9)
    assert_allclose(tiles[:11].reshape(11, -1).T, exact, rtol=1e-12)
    for c, logarithm in enumerate(tiles[11].flat):
        part = oracles.block(images, c // tiles.shape[2] * 9, c % tiles.shape[2] * 9, 9)
        w, p, _, _ = (v.astype(float) for v in part)
        assert logarithm == pytest.approx(np.log(p * w**4).sum(), rel=1e-9)


@pytest.mark.parametrize("shape", [(12, 18), (13, 20), (5, 7)])
def test_block_moments(shape):
    rng = np.random.default_rng(1)
    images = readings(rng, PLANES, quilt(rng, shape, 3), holes=0.2)
    _, _, blocks, together, _ = cells_of(images)
    exact = oracles.cell_moments(*images, 6)
    assert_allclose(blocks.transpose(1, 0, 2).reshape(11, -1).T, exact, rtol=1e-12)
    for c, (row, misfit) in enumerate(zip(exact, together.flat, strict=True)):
        if row[10] > 10:
            columns = together.shape[1]
            part = oracles.block(images, c // columns * 6, c % columns * 6, 6)
            assert misfit == pytest.approx(oracles.misfit(*part), rel=1e-5)


def test_only_one_row_of_coordinates_is_read_where_all_are_alike():
    rng = np.random.default_rng(1)
    w, p, x, y = readings(rng, PLANES, quilt(rng, (23, 20), 3), holes=0.2)
    whole = cells_of((w, p, x, y))
    x[1:], y[:, 1:] = np.nan, np.nan
    for a, b in zip(whole, cells_of((w, p, x, y), straight=True), strict=True):
        assert_allclose(a, b, rtol=1e-12, atol=1e-6)
    out = [np.full_like(a, 9) for a in whole]
    cells.straight_moments(w, p, x, y, 0, 1, *out)  # the last row of cells is cut off
    for a, b, n in zip(whole, out, (6, 6, 3, 3, 2), strict=True):
        assert_allclose(a[:n], b[:n], rtol=1e-12, atol=1e-6)
        assert_array_equal(b[n:], 9)


def test_cells_without_readings_have_no_misfit():
    images = np.zeros((4, 9, 12))
    for out in cells_of(images):
        assert_array_equal(out, 0)


def test_four_quarters_of_a_plane_are_one_unit():
    rng = np.random.default_rng(1)
    unit, units, size = merge(readings(rng, PLANES, np.zeros((12, 18), int)))
    assert_array_equal(unit, np.arange(6).reshape(2, 3).repeat(2, 0).repeat(2, 1))
    assert_array_equal(size, 2)
    assert_array_equal(units[10], 36)


def test_a_crease_keeps_quarters_apart():
    rng = np.random.default_rng(2)
    x, y = coordinates((6, 6))
    p = np.full((6, 6), 1 / SIGMA**2)
    w = 0.5 + 1.5 * abs(x - x[0, 2:4].mean()) + rng.normal(0, SIGMA, (6, 6))
    unit, _, size = merge((w, p, x, y))
    assert_array_equal(unit, [[0, 1], [2, 3]])
    assert_array_equal(size, 1)


def test_empty_and_noisy_cells_have_no_unit():
    rng = np.random.default_rng(3)
    w, p, x, y = readings(rng, PLANES, np.zeros((6, 12), int))
    w[:3, :3] += rng.normal(0, 20 * SIGMA, (3, 3))
    p[:, 6:] = 0
    assert_array_equal(merge((w, p, x, y))[0], [[-1, 0, -1, -1], [1, 2, -1, -1]])


@pytest.mark.parametrize("seed", range(6))
def test_merge_quarters(seed):
    rng = np.random.default_rng(seed)
    shape = (24 + seed, 36 - seed)
    w, p, x, y = readings(rng, PLANES, quilt(rng, shape, 3), holes=0.12 * (seed % 3))
    # Some of the noise is not white, so that F decides rather than chi^2 alone.
    w = w + (p > 0) * rng.uniform(0, 4 * SIGMA) * np.sin(90 * x + rng.uniform(0, 6)) * (y < 0)
    unit, units, size = merge((w, p, x, y))
    exact = oracles.merge_quarters((w, p, x, y), 3, **MERGING)
    assert_array_equal(unit, exact[0])
    assert_allclose(units, exact[1], rtol=1e-6)
    assert_array_equal(size, exact[2])
    assert set(size) == {1, 2}


def test_cells_are_divided_where_f_says_so():
    """Folds of every strength, so that many a block lies close to the bound."""
    rng = np.random.default_rng(7)
    w, p, x, y = readings(rng, PLANES, np.zeros((120, 120), int))
    strength = rng.uniform(0, 8 * SIGMA, (20, 20)).repeat(6, 0).repeat(6, 1)
    w = w + strength * abs(np.arange(120) % 6 - 2.5)
    unit, _, size = merge((w, p, x, y))
    exact = oracles.merge_quarters((w, p, x, y), 3, **MERGING)
    assert_array_equal(unit, exact[0])
    assert 100 < (size == 2).sum() < 300


@pytest.mark.parametrize("noise", [0.5, 1.0, 4.0])
def test_marginalise(noise):
    rng = np.random.default_rng(4)
    parts, exact = [], []
    for _ in range(20):
        keep = rng.choice(36, rng.integers(9, 37), replace=False)
        w, p, x, y = (image.ravel()[keep] for image in readings(rng, PLANES, np.zeros((6, 6), int)))
        x = x + rng.uniform(-3, 3)
        w = PLANES[0, 0] + noise * (w - PLANES[0, 0])
        parts.append((w, p, x, y))
    offset, tilt = SIGMA**2 * rng.uniform(0, 2, 20), SIGMA**2 * rng.uniform(0, 200, 20)
    tilt[0] = offset[0] = 0
    out = segment_rows(np.array([oracles.unit(*part) for part in parts]).T, offset, tilt)
    exact = [oracles.marginalise(*part, *s) for part, *s in zip(parts, offset, tilt, strict=True)]
    for row, part, (P, Pt, square) in zip(out, parts, exact, strict=True):
        assert_allclose(oracles.information(row), P, rtol=1e-6)
        assert_allclose(row[6:9], Pt, rtol=1e-6)
        assert row[9] == pytest.approx(square, rel=1e-6)
        assert_array_equal(row[10:], [len(part[0]), 0, 0])


# Segments


def random_segments(seed, shape=(36, 42), planes=3):
    """Units of a random frame: grid, rows, and their drift and priors.

    No two have the same size: which of two is the smaller is then not a matter of order.
    """
    rng = np.random.default_rng(seed)
    grid, units, _ = merge(readings(rng, PLANES, quilt(rng, shape, planes), holes=0.05))
    n = units.shape[1]
    rows = segment_rows(units, np.full(n, 0.5 * DRIFT), np.full(n, 20 * DRIFT))
    rows[:, 10] += rng.permutation(n) * 1e-3 / n
    drift, offset_prior = DRIFT * rng.uniform(0.5, 2, n), rng.uniform(1e-4, 1e-3, n)
    return grid, rows, drift, offset_prior, offset_prior * rng.uniform(100, 300, n)


def forms_of(rows, drift, lean=LEAN):
    out = np.empty((len(rows), forms.FORM))
    forms.write_forms(rows, drift, lean, out)
    return out


def compare(a, b, drift, offset_prior, slope_prior):
    of = forms_of(np.array([a, b]), np.full(2, drift), 0.0)
    return forms.compare_forms(*of, offset_prior, slope_prior)


def test_compare():
    _, rows, drift, offset_prior, slope_prior = random_segments(0)
    rng = np.random.default_rng(0)
    for _ in range(100):
        u, v = rng.choice(len(rows), 2, replace=False)
        a, b = rows[u].copy(), rows[v]
        for n in rng.choice(len(rows), rng.integers(0, 4)):
            a += rows[n]  # segments of several units, also far apart
        arguments = (drift[u], offset_prior[u], slope_prior[u])
        exact = oracles.compare(a, b, *arguments)
        assert_allclose(compare(a, b, *arguments), exact, rtol=1e-5, atol=1e-7)
        assert_allclose(compare(b, a, *arguments), exact, rtol=1e-5, atol=1e-7)


def test_compare_finds_no_discord_in_one_plane():
    _, rows, drift, *_ = random_segments(1)
    for row in rows:
        row[6:9] = oracles.information(row) @ PLANES[1]
    for a, b in zip(rows[1:], rows[:-1], strict=True):
        discord, evidence = compare(a, b, drift[0], 1e-4, 1e-2)
        assert abs(discord) < 1e-6
        assert evidence > 0
        assert compare(a, b, drift[0], 0.0, 0.0)[1] == pytest.approx(0, abs=1e-9)


def test_pairs_are_compared_as_one_by_one():
    _, rows, drift, offset_prior, slope_prior = random_segments(3)
    of = forms_of(rows, drift)
    pairs = np.random.default_rng(0).integers(len(rows), size=(77, 2)).astype(np.int32)
    discord, evidence = np.empty((2, 77))
    offset, slope = offset_prior[pairs[:, 0]], slope_prior[pairs[:, 0]]
    forms.compare_pairs(of, pairs, offset, slope, discord, evidence)
    for n, (a, b) in enumerate(pairs):
        exact = forms.compare_forms(of[a], of[b], offset[n], slope[n])
        assert_allclose((discord[n], evidence[n]), exact, rtol=1e-7, atol=1e-9)


def test_free_prices():
    _, rows, drift, offset_prior, slope_prior = random_segments(2)
    out, readings = np.empty(len(rows)), np.arange(len(rows)) % 3.0
    share = np.array([0.5, 1.0, 2.0])
    forms.free_prices(
        forms_of(rows, drift, 0.0), offset_prior, slope_prior, readings, 1.5, share, out
    )
    every = zip(rows, drift, offset_prior, slope_prior, strict=True)
    nats = np.array([oracles.free_price(*unit) for unit in every]) + 1.5
    assert_allclose(out, nats * share[np.arange(len(rows)) % 3], rtol=1e-6)


def square_discords(grid, whole, of):
    even = np.pad(grid, [(0, n % 2) for n in grid.shape], constant_values=-1)
    unit = even.reshape(len(even) // 2, 2, -1, 2).max(axis=(1, 3))
    squares = np.where((unit >= 0) & whole[unit], unit, -1).astype(np.int32)
    right, below = np.full((2, *squares.shape), np.nan)
    forms.square_discords(squares, of, right, below)
    return right, below


def border_discords(frame, segment):
    grid, rows, drift, *_ = frame
    of, out = forms_of(rows, drift), np.full((2, *grid.shape), 9.0)
    whole = np.bincount(grid[grid >= 0], minlength=len(rows)) > 1
    found = borders.border_discords(
        grid, whole, segment, of, *square_discords(grid, whole, of), out
    )
    assert found == (out >= 0).sum()
    return out


@pytest.mark.parametrize("shape", [(36, 42), (38, 40), (33, 45)])
def test_border_discords(shape):
    frame = random_segments(3, shape)
    out = border_discords(frame, np.arange(len(frame[1])))
    exact = oracles.border_discords(*frame[:3], LEAN)
    assert_allclose(out, exact, rtol=1e-5, atol=1e-7)
    assert 0 < (out >= 0).sum() < out.size


def test_there_is_no_discord_within_a_segment():
    frame = random_segments(3)
    segment = np.arange(len(frame[1])) // 3
    out, every = border_discords(frame, segment), border_discords(frame, np.arange(len(segment)))
    for axis, i, j, u, v in oracles.sides(frame[0]):
        assert out[axis, i, j] == (-1 if segment[u] == segment[v] else every[axis, i, j])


def discords_of(rng, grid):
    """Discords and the nats that they are worth as borders."""
    discords = np.where(
        rng.random((2, *grid.shape)) < 0.1, -1, rng.exponential(5, (2, *grid.shape))
    )
    low, high, knee = PRICE
    over = np.where(discords < 0, 0, (high - low) / (1 + (discords / knee) ** 2))
    return discords, 3 * (low + over)


def agglomerated(
    frame, discords, price, most, home=None, turns=None, wraps=False, longest=np.inf, tails=4.0
):
    grid, rows, drift, *priors = frame
    rows, drift = rows.copy(), drift.copy()
    home = np.zeros(len(rows), np.int32) if home is None else home
    turns = np.eye(3)[None, None] if turns is None else turns
    of, (roots, segment) = forms_of(rows, drift), np.empty((2, len(rows)), np.int32)
    sides = sum(1 for _ in oracles.sides(grid)) + wraps * len(grid)
    ints, floats = segments.room(sides, len(rows))
    work = np.full(ints, 7, np.int32), np.full(floats, 7.0)
    sectors = home, turns, wraps
    found = segments.agglomerate(
        grid, discords, price, rows, of, drift, LEAN, *priors, *sectors, most, longest, tails,
        roots, segment, *work,
    )  # fmt: skip
    root = roots[segment]
    assert_array_equal(roots[:found], np.unique(root))
    assert_allclose(of[root], forms_of(rows, drift)[root], rtol=1e-12)
    return root, rows


@pytest.mark.parametrize("limit", [3.0, 11.3])
@pytest.mark.parametrize("seed", range(3))
def test_join_blocks(seed, limit):
    """Squares of whole units, of squares, and so on; what is joined is what the oracle joins."""
    rng = np.random.default_rng(40 + seed)
    images = readings(rng, PLANES, quilt(rng, (61, 73), 2, pieces=3), holes=0.03)
    grid, units, size = merge(images)
    count = units.shape[1]
    rows = segment_rows(units, np.full(count, 0.1 * DRIFT), np.full(count, 4 * DRIFT))
    rows[:, 12] = rng.uniform(1, 3, count)
    drift = DRIFT * rng.uniform(0.5, 2, count)
    exact_root, exact_rows = oracles.join_blocks(grid, size == 2, rows, drift, LEAN, limit, 3, 2.5)
    count, of = len(rows), forms_of(rows, drift)
    root, square = np.empty(count, np.int32), np.empty(count, np.int32)
    joined = np.empty((count // 4, 13)), np.empty((count // 4, forms.FORM))
    right, _ = square_discords(grid, size == 2, of)
    free, rows[:, 12] = rows[:, 12].copy(), 0
    told, known = drift.copy(), (rows.copy(), of.copy())
    left = squares.join_blocks(
        grid, size == 2, right, rows, of, free, drift, LEAN, limit, 3, 2.5, root, square, *joined
    )
    assert_array_equal(root, exact_root)
    ids = np.unique(root)
    assert left == len(ids)
    assert_array_equal(square[ids] >= 0, np.bincount(root)[ids] > 1)
    assert left < 0.9 * count
    assert max(np.bincount(root)) > (4 if limit > 10 else 3)
    for array, before in zip((rows, of), known, strict=True):
        assert_array_equal(array, before)

    priors, numbers = rng.random((2, count)), np.empty((3, left))
    kept = np.empty((left, 13)), np.empty((left, forms.FORM))
    arrays = (rows, of, free, *joined, drift, *priors, np.empty(count, np.int32), *kept, numbers)
    squares.keep_roots(root, square, *arrays)
    assert_array_equal(ids[root], exact_root)
    assert_allclose(kept[0], exact_rows[ids], rtol=1e-6, atol=1e-9)
    assert_allclose(kept[1], forms_of(kept[0], drift[ids]), rtol=1e-12)
    assert_array_equal(numbers, [drift[ids], *priors[:, ids]])
    assert (drift[ids] != told[ids]).any()


def test_only_roots_are_kept():
    _, rows, drift, offset_prior, slope_prior = random_segments(4)
    n, rng = len(rows), np.random.default_rng(4)
    root = np.where(rng.random(n) < 0.4, np.arange(n), -1)
    ids = np.flatnonzero(root >= 0)
    root[root < 0] = rng.choice(ids, (root < 0).sum())
    arrays = rows, drift, offset_prior, slope_prior, np.arange(n, dtype=np.int32)
    of_unit = rng.integers(n, size=3 * n).astype(np.int32)
    segment = np.searchsorted(ids, root).astype(np.int32)
    kept = Segments(*arrays, of_unit).kept(ids.astype(np.int32), segment)
    assert_array_equal(ids[kept.of_unit], root[of_unit])
    names = ("rows", "drift", "offset_prior", "slope_prior", "home")
    for name, old in zip(names, arrays, strict=True):
        assert_array_equal(getattr(kept, name), old[ids])


def test_segments_of_cells():
    unit, segment = np.array([[0, -1, 2], [1, 1, -1]], np.int32), np.array([4, 0, 3], np.int32)
    out = np.full((2, 3), 9, np.int32)
    borders.segments_of_cells(unit, segment, out)
    assert_array_equal(out, [[4, -1, 3], [0, 0, -1]])


def test_borders_of_segments_are_paid_for_once():
    rng = np.random.default_rng(5)
    of_cell = quilt(rng, (20, 30), 6, pieces=9).astype(np.int32) - 1
    discords = np.where(rng.random((2, 20, 30)) < 0.2, -1, rng.exponential(20, (2, 20, 30)))
    border, found, (ends, price) = np.empty((2, 5)), 0, (np.empty((1200, 2), int), np.empty(1200))
    unit, units = np.arange(600).reshape(20, 30), np.empty((1200, 2), int)
    at = np.empty(1200, int)
    low, high, knee = bounds = 0.01, 1.5, 20.0
    found = borders.segment_borders(
        unit, of_cell, discords, bounds, False, border, ends, units, at, price
    )
    assert_array_equal(of_cell.reshape(-1)[units[:found]], ends[:found])
    assert_array_equal(np.unique(np.ptp(units[:found], axis=1)), [1, 30])
    assert_array_equal(at[:found] >> 1, units[:found, 0])
    assert_array_equal(at[:found] & 1, np.ptp(units[:found], axis=1) == 30)
    exact, pairs = np.zeros((2, 5)), []
    for axis, i, j, u, v in oracles.sides(of_cell, outside=True):
        discord = discords[axis, i, j]
        nats = 3 * (low if discord < 0 else low + (high - low) / (1 + (discord / knee) ** 2))
        for n in {u, v} - {-1}:
            exact[:, n] += nats, 1
        if min(u, v) >= 0:
            pairs.append((u, v, nats))
    assert_allclose(border, exact, rtol=1e-12)
    told = np.column_stack((ends[:found], price[:found]))
    assert_allclose(sorted(map(tuple, told)), sorted(pairs), rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_accepted_segments_pay(seed):
    """The most that pay together, whatever the order: others would not pay even beside them."""
    rng = np.random.default_rng(seed)
    n = 30
    ends, price = rng.integers(0, n, (80, 2)), rng.exponential(3, 80)
    ends = ends[ends[:, 0] != ends[:, 1]]
    price, alone = price[: len(ends)], rng.normal(-5, 8, n)
    worth, accepted = alone.copy(), np.empty(n, bool)
    borders.accept(worth, ends, price, 2.0, accepted)
    expected = set(np.flatnonzero(alone > 2))
    while True:
        paid = alone.copy()
        for (u, v), nats in zip(ends, price, strict=True):
            paid[u] += nats * (v in expected)
            paid[v] += nats * (u in expected)
        more = set(np.flatnonzero(paid > 2)) | expected
        if more == expected:
            break
        expected = more
    assert_array_equal(np.flatnonzero(accepted), sorted(expected))
    assert_allclose(worth, paid)
    assert set(np.flatnonzero(alone > 2)) < expected


def pieces_of_planes(seed):
    """Rows and drift of 12 squares of few planes, anywhere in the image, and the plane of each."""
    rng = np.random.default_rng(seed)
    rows, of = [], rng.integers(0, 3, 12)
    for n in of:
        label = np.full((12, 12), n)
        w, p, x, y = readings(rng, PLANES, label)
        shift = rng.uniform(-2, 2, 2)
        slopes = PLANES[n, 1:]
        w, x, y = w + slopes @ shift, x + shift[0], y + shift[1]
        rows.append(oracles.unit(*(v.ravel() for v in (w, p, x, y))))
    units = np.array(rows).T
    rows, drift = segment_rows(units, np.zeros(12), np.zeros(12)), np.full(12, 0.1 * DRIFT)
    rows[:, 10] += np.arange(12) * 1e-3
    return rows, drift, of


@pytest.mark.parametrize("seed", range(4))
def test_join_through_gaps(seed):
    """Pieces of few planes, anywhere in the image, become few planes again."""
    rows, drift, of = pieces_of_planes(seed)
    slope_prior, owner = np.full(12, 0.25), np.empty(12, int)
    exact_owner, exact_rows = oracles.join_through_gaps(rows, drift, slope_prior, 0.3)
    in_sectors, of_rows = np.stack((rows, rows)), np.stack((forms_of(rows, drift, 0.0),) * 2)
    gaps.join_through_gaps(in_sectors, of_rows, drift, slope_prior, 0.3, owner)
    rows = in_sectors[0]
    assert_array_equal(rows[np.unique(owner)], in_sectors[1][np.unique(owner)])
    assert_array_equal(owner, exact_owner)
    ids = np.unique(owner)
    assert_allclose(rows[ids], exact_rows[ids], rtol=1e-5, atol=1e-9)
    assert len(ids) == len(np.unique(np.column_stack((owner, of)), axis=0)) <= 5


def test_pairs_are_compared_as_often_as_segments_change():
    """Joining many takes as long as a few looks at all pairs, not as one at every join."""
    sets = [pieces_of_planes(seed)[:2] for seed in range(150)]
    all_rows, all_drift = (np.concatenate(of) for of in zip(*sets, strict=True))
    for count in (24, len(all_rows)):  # the first time they may have to be compiled
        rows, drift, half = all_rows[None, :count].copy(), all_drift[:count], count // 2
        of_rows, owner = forms_of(rows[0], drift, 0.0)[None], np.empty(count, int)
        segments = rows, of_rows
        priors = np.full(count, 0.25), 0.3
        start = time.thread_time()
        gaps.find_planes(*segments, *priors, np.arange(half), *np.empty((2, half), int))
        looked = time.thread_time()
        gaps.join_through_gaps(*segments, drift, *priors, owner)
        end = time.thread_time()
    assert len(np.unique(owner)) < 10
    assert end - looked < 30 * (looked - start)


@pytest.mark.parametrize("seed", range(4))
def test_find_planes(seed):
    """Pieces are given the plane that they lie on, if it is there."""
    rows, drift, of = pieces_of_planes(seed)
    slope_prior, plane = np.full(12, 0.25), np.empty(9, int)
    segments = rows[None], forms_of(rows, drift, 0.0)[None], slope_prior, 0.3
    owner, first = np.array([0, 0, 2]), np.empty(3, int)  # the second is part of the first
    assert gaps.find_planes(*segments, owner, plane, first) == 2
    assert_array_equal((*owner, *first[:2]), (0, 0, 1, 0, 2))
    expected = oracles.find_planes(rows[[0, *range(2, 12)]], drift[1:], slope_prior, 0.3, 2)
    assert_array_equal(plane, expected)
    assert gaps.find_planes(*segments, np.arange(3), plane, first) == 3
    assert_array_equal(plane, oracles.find_planes(rows, drift, slope_prior, 0.3, 3))
    there = np.isin(of[3:], of[:3])
    assert (plane[~there] == -1).all()
    assert (plane >= 0).sum() >= 0.7 * there.sum() > 0
    assert_array_equal(of[plane[plane >= 0]], of[3:][plane >= 0])


@pytest.mark.parametrize("tails", [4.0, 2.5])
@pytest.mark.parametrize("longest", [np.inf, 4.0])
@pytest.mark.parametrize("seed", range(8))
def test_agglomerate(seed, longest, tails):
    frame = random_segments(10 + seed, planes=2 + seed % 2)
    grid = frame[0]
    discords, border = discords_of(np.random.default_rng(seed), grid)
    root, rows = agglomerated(frame, discords, PRICE, 25.0, longest=longest, tails=tails)
    exact_root, exact_rows = oracles.agglomerate(
        grid, border, *frame[1:], LEAN, 25.0, longest, tails, lazy=True
    )
    assert_array_equal(root, exact_root)
    ids = np.unique(root)
    assert_allclose(rows[ids], exact_rows[ids], rtol=1e-5, atol=1e-9)
    assert 1 < len(ids) < len(root)


def test_units_far_off_the_plane_of_their_segment():
    _, rows, _, *_ = random_segments(5, planes=1)
    rng, count = np.random.default_rng(5), len(rows)
    segment = rng.integers(0, 6, count).astype(np.int32)
    place = np.array([0, -1, 1, 2, -1, 3], np.int32)
    own = np.array([np.linalg.solve(information_of(row), row[6:9]) for row in rows])
    x, y = rows[:, 1] / rows[:, 0], rows[:, 2] / rows[:, 0]
    drift = rng.uniform(0.5, 2, count) / rows[:, 0]
    scale = np.sqrt(1 / rows[:, 0] + drift)
    shift = np.where(rng.random(count) < 0.3, rng.uniform(4, 16, count), rng.uniform(0, 3, count))
    planes = np.tile(own.mean(axis=0), (4, 1))
    planes[3, 0] += 50 * scale.max()  # whose units are all off it
    here = own[:, 0] + own[:, 1] * x + own[:, 2] * y
    wanted = planes[0, 0] + planes[0, 1] * x + planes[0, 2] * y + shift * scale
    rows[:, 6] += rows[:, 0] * (wanted - here)
    off = np.empty(count, np.bool_)
    found = segments.far_off(rows, drift, segment, place, planes, 64.0, off)
    expected = (shift > 8) & np.isin(place[segment], [0, 1, 2])
    assert_array_equal(off, expected)
    assert found == expected.sum() > 3


@pytest.mark.parametrize("seed", range(4))
def test_marked_units_that_are_connected(seed):
    """As many as there are of a size, with all their cells inside their boxes."""
    rng = np.random.default_rng(seed)
    grid = random_segments(seed, planes=2)[0].astype(np.int32)
    off = rng.random(grid.max() + 1) < 0.5
    marked = np.append(off, False)[grid]
    numbers, count = ndimage.label(marked)
    members = [np.unique(grid[numbers == k + 1]) for k in range(count)]
    members = [each for each in members if len(each) >= 5]
    queue, piece = np.empty(4 * off.sum(), int), np.empty(len(off), np.int32)
    boxes = np.empty((off.sum() // 5, 4), np.int64)
    found = segments.connected(grid, off, 5, queue, piece, boxes)
    assert found == len(members) > 0
    for k, each in enumerate(members):
        assert_array_equal(np.flatnonzero(piece == k), each)
        rows, columns = np.nonzero(np.isin(grid, each))
        assert_array_equal(boxes[k], [rows.min(), columns.min(), rows.max(), columns.max()])
    assert (piece >= 0).sum() == sum(map(len, members))


@pytest.mark.parametrize("seed", range(4))
def test_sectors_with_coordinates_of_their_own_change_nothing(seed):
    """Coordinates that begin elsewhere in every sector: the same merges, planes in the root's."""
    frame = random_segments(10 + seed, planes=2 + seed % 2)
    grid, rows, drift, *priors = frame
    discords, _ = discords_of(np.random.default_rng(seed), grid)
    expected, exact_rows = agglomerated(frame, discords, PRICE, 25.0)
    begin = np.random.default_rng(seed).uniform(-3, 3, (3, 2))
    turns = np.tile(np.eye(3), (3, 3, 1, 1))
    turns[:, :, 1:, 0] = begin[:, None] - begin[None]
    home = np.zeros(len(rows), np.int32)
    for column in range(grid.shape[1]):
        home[grid[grid[:, column] >= 0, column]] = 3 * column // grid.shape[1]
    moved, back = np.empty_like(rows), np.empty_like(rows)
    for row, k, out in zip(rows, home, moved, strict=True):
        shift = np.eye(3)
        shift[1:, 0] = -begin[k]
        segments.turn_row(row, shift, out)
        matrix = shift @ information_of(row) @ shift.T
        assert_allclose(information_of(out), matrix, rtol=1e-9, atol=1e-9 * abs(matrix).max())
        assert_allclose(out[6:9], shift @ row[6:9], rtol=1e-9)
        assert_array_equal(out[9:], row[9:])
    root, found = agglomerated((grid, moved, drift, *priors), discords, PRICE, 25.0, home, turns)
    assert_array_equal(root, expected)
    for row, k, out in zip(found, home, back, strict=True):
        shift = np.eye(3)
        shift[1:, 0] = begin[k]
        segments.turn_row(row, shift, out)
    ids = np.unique(root)
    back, exact_rows = back[ids], exact_rows[ids]
    # In sectors, the larger of two leans by what the smaller one does.
    misfit = cells.MISFIT
    assert_allclose(back[:, misfit], exact_rows[:, misfit], rtol=1e-3)
    back[:, misfit] = exact_rows[:, misfit]
    assert_allclose(back, exact_rows, rtol=1e-5, atol=1e-5)


def information_of(row):
    a, b, c, d, e, f = row[:6]
    return np.array([[a, b, c], [b, d, e], [c, e, f]])


def test_the_last_column_may_be_beside_the_first():
    """An image that begins elsewhere has the same segments, only around its end."""
    frame = random_segments(10, planes=2)
    grid = frame[0]
    discords, _ = discords_of(np.random.default_rng(0), grid)
    home, turns = np.zeros(len(frame[1]), np.int32), np.eye(3)[None, None]
    apart, _ = agglomerated(frame, discords, PRICE, 25.0)
    discords[0, :, -1] = -1
    plain, _ = agglomerated(frame, discords, PRICE, 25.0, home, turns, True)
    assert (plain != apart).any()
    rolled = (np.roll(grid, 3, axis=1), *frame[1:])
    around, _ = agglomerated(rolled, np.roll(discords, 3, axis=2), PRICE, 25.0, home, turns, True)
    assert_array_equal(around, plain)
    of_cell, border = np.append(plain, -1)[grid].astype(np.int32), np.empty((2, 2, len(plain)))
    ends = np.empty((2, 2 * grid.size, 2), np.int32)
    room = *ends, np.empty(2 * grid.size, np.int32), np.empty(2 * grid.size)
    for out, shift in zip(border, (0, 3), strict=True):
        cells, sides = np.roll(of_cell, shift, axis=1), np.roll(discords, shift, axis=2)
        borders.segment_borders(cells, cells, sides, PRICE, True, out, *room)
    assert_allclose(border[0], border[1], rtol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_lazy_values_are_as_good_as_current_ones(seed):
    """Merging always the best pair, every value up to date, differs by the order."""
    frame = random_segments(10 + seed, planes=2 + seed % 2)
    grid = frame[0]
    discords, border = discords_of(np.random.default_rng(seed), grid)
    root, rows = agglomerated(frame, discords, PRICE, 25.0)
    exact_root, exact_rows = oracles.agglomerate(grid, border, *frame[1:], LEAN, 25.0)
    assert len(np.unique(root)) == len(np.unique(exact_root))
    assert nats(grid, border, root, rows) < 1.01 * nats(grid, border, exact_root, exact_rows)


def nats(grid, border, root, rows):
    """Misfit, borders and planes of segments."""
    ids = np.unique(root)
    between = (
        border[axis, i, j] * (root[u] != root[v]) for axis, i, j, u, v in oracles.sides(grid)
    )
    return 0.5 * rows[ids, 11].sum() + sum(between) + 25.0 * len(ids)


def test_segments_that_nothing_joins_stay_apart():
    frame = random_segments(20)
    discords = np.zeros((2, *frame[0].shape))
    root, rows = agglomerated(frame, discords, (-100.0, -100.0, 1.0), 25.0)
    assert_array_equal(root, np.arange(len(root)))
    assert_array_equal(rows, frame[1])
