"""Every compiled loop of the spatial search against its plain NumPy version."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from planewise.kernels import cells, segments

from . import spatial_oracles as oracles

MERGING = {"white": 1.0, "split": 40.0, "hopeless": 25.0, "filled": 0.5}
SIGMA = 1e-3
DRIFT = SIGMA**2


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


def merge(images, side=3):
    rows, columns = (-(-n // side) for n in images[0].shape)
    moments = np.empty((rows * columns, 11))
    cells.cell_moments(*images, side, moments)
    unit, units = np.empty(rows * columns, np.int32), np.empty((rows * columns, 11))
    size = np.empty(rows * columns)
    found = cells.merge_quarters(moments, rows, columns, side, *MERGING.values(), unit, units, size)
    return unit.reshape(rows, columns), units[:found], size[:found]


def segment_rows(units, offset, tilt):
    out = np.empty((len(units), 13))
    cells.marginalise(units, offset, tilt, out)
    return out


PLANES = np.array([[0.50, 0.03, -0.02], [0.53, -0.05, 0.04], [0.47, 0.08, 0.06]])


def quilt(rng, shape, planes, pieces=5):
    """Labels 0 ... planes - 1 of some random convex pieces of an image."""
    seeds = rng.uniform(0, shape, (pieces, 2))
    place = np.indices(shape).reshape(2, 1, -1)
    nearest = np.linalg.norm(place - seeds.T[:, :, None], axis=0).argmin(axis=0)
    return (nearest % planes).reshape(shape)


# Cells


@pytest.mark.parametrize("shape", [(12, 18), (13, 20), (2, 4)])
def test_cell_moments_and_their_misfits(shape):
    rng = np.random.default_rng(0)
    images = readings(rng, PLANES, quilt(rng, shape, 3), holes=0.2)
    exact = oracles.cell_moments(*images, 3)
    moments, misfits = np.full(exact.shape, 9.0), np.empty(len(exact))
    cells.cell_moments(*images, 3, moments)
    assert_allclose(moments, exact, rtol=1e-12)
    cells.own_misfits(moments, misfits)
    columns = -(-shape[1] // 3)
    for c, row in enumerate(exact):
        if row[10] > 5:
            part = oracles.block(images, c // columns * 3, c % columns * 3, 3)
            assert misfits[c] == pytest.approx(oracles.misfit(*part), rel=1e-5)


def test_a_cell_without_readings_has_no_misfit():
    misfits = np.full(2, 9.0)
    cells.own_misfits(np.zeros((2, 11)), misfits)
    assert_array_equal(misfits, 0)


def test_four_quarters_of_a_plane_are_one_unit():
    rng = np.random.default_rng(1)
    unit, units, size = merge(readings(rng, PLANES, np.zeros((12, 18), int)))
    assert_array_equal(unit, np.arange(6).reshape(2, 3).repeat(2, 0).repeat(2, 1))
    assert_array_equal(size, 2)
    assert_array_equal(units[:, 10], 36)


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
    assert_allclose(units, exact[1], rtol=1e-12)
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
    out = segment_rows(np.array([oracles.moments(*part) for part in parts]), offset, tilt)
    exact = [oracles.marginalise(*part, *s) for part, *s in zip(parts, offset, tilt, strict=True)]
    for row, part, (P, Pt, square) in zip(out, parts, exact, strict=True):
        assert_allclose(oracles.information(row), P, rtol=1e-6)
        assert_allclose(row[6:9], Pt, rtol=1e-6)
        assert row[9] == pytest.approx(square, rel=1e-6)
        assert_array_equal(row[10:], [len(part[0]), 0, 0])


def test_groups_are_the_readings_of_one_cell_and_label():
    rng = np.random.default_rng(5)
    label = quilt(rng, (19, 21), 3).astype(np.int32)
    images = readings(rng, PLANES, label, holes=0.3)
    p = images[1]
    p[:8, :8] = 0
    extra = rng.normal(size=(4, *label.shape))
    place = np.empty((9, 4), np.int32)
    found = cells.label_groups(label, p, 8, 3, 3, place)
    moments = np.full((found, 15), 9.0)
    cells.group_moments(label, *images, extra, 8, 3, place, moments)
    number = 0
    for cell in range(9):
        for n in range(4):
            at = np.zeros(label.shape, bool)
            at[cell // 3 * 8 :, cell % 3 * 8 :][:8, :8] = True
            at &= (p > 0) & (label == n)
            if not at.any():
                assert place[cell, n] == -1
                continue
            assert place[cell, n] == number
            expected = [*oracles.moments(*(image[at] for image in images)), *extra[:, at].sum(1)]
            assert_allclose(moments[number], expected, rtol=1e-9)
            number += 1
    assert number == found


# Segments


def random_segments(seed, shape=(36, 42), planes=3):
    """Units of a random frame: grid, rows, and their drift and priors.

    No two have the same size: which of two is the smaller is then not a matter of order.
    """
    rng = np.random.default_rng(seed)
    grid, units, _ = merge(readings(rng, PLANES, quilt(rng, shape, planes), holes=0.05))
    n = len(units)
    rows = segment_rows(units, np.full(n, 0.5 * DRIFT), np.full(n, 20 * DRIFT))
    rows[:, 10] += rng.permutation(n) * 1e-3 / n
    drift, offset_prior = DRIFT * rng.uniform(0.5, 2, n), rng.uniform(1e-4, 1e-3, n)
    return grid, rows, drift, offset_prior, offset_prior * rng.uniform(100, 300, n)


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
        assert_allclose(segments.compare(a, b, *arguments), exact, rtol=1e-5, atol=1e-7)
        assert_allclose(segments.compare(b, a, *arguments), exact, rtol=1e-5, atol=1e-7)


def test_compare_finds_no_discord_in_one_plane():
    _, rows, drift, *_ = random_segments(1)
    for row in rows:
        row[6:9] = oracles.information(row) @ PLANES[1]
    for a, b in zip(rows[1:], rows[:-1], strict=True):
        discord, evidence = segments.compare(a, b, drift[0], 1e-4, 1e-2)
        assert abs(discord) < 1e-6
        assert evidence > 0
        assert segments.compare(a, b, drift[0], 0.0, 0.0)[1] == pytest.approx(0, abs=1e-9)


def test_free_prices():
    _, rows, drift, offset_prior, slope_prior = random_segments(2)
    out = np.empty(len(rows))
    segments.free_prices(rows, drift, offset_prior, slope_prior, out)
    every = zip(rows, drift, offset_prior, slope_prior, strict=True)
    assert_allclose(out, [oracles.free_price(*unit) for unit in every], rtol=1e-6)


def test_border_discords():
    grid, rows, drift, *_ = random_segments(3)
    out = np.full((2, *grid.shape), 9.0)
    segments.border_discords(grid.ravel(), *grid.shape, rows, drift, out)
    exact = oracles.border_discords(grid, rows, drift)
    assert_allclose(out, exact, rtol=1e-5, atol=1e-7)
    assert 0 < (out >= 0).sum() < out.size


def agglomerated(frame, border, most):
    grid, rows, drift, *priors = frame
    rows, drift = rows.copy(), drift.copy()
    root = segments.agglomerate(grid.ravel(), *grid.shape, border, rows, drift, *priors, most)
    return root, rows


@pytest.mark.parametrize("seed", range(8))
def test_agglomerate(seed):
    frame = random_segments(10 + seed, planes=2 + seed % 2)
    grid = frame[0]
    border = np.random.default_rng(seed).uniform(0, 3, (2, *grid.shape))
    root, rows = agglomerated(frame, border, 25.0)
    exact_root, exact_rows = oracles.agglomerate(grid, border, *frame[1:], 25.0, lazy=True)
    assert_array_equal(root, exact_root)
    ids = np.unique(root)
    assert_allclose(rows[ids], exact_rows[ids], rtol=1e-5, atol=1e-9)
    assert 1 < len(ids) < len(root)


@pytest.mark.parametrize("seed", range(8))
def test_lazy_values_end_at_the_segments_of_current_ones(seed):
    """Merging always the best pair, every gain up to date, differs by the misfit of the order."""
    frame = random_segments(10 + seed, planes=2 + seed % 2)
    grid = frame[0]
    border = np.random.default_rng(seed).uniform(0, 3, (2, *grid.shape))
    root, rows = agglomerated(frame, border, 25.0)
    exact_root, exact_rows = oracles.agglomerate(grid, border, *frame[1:], 25.0)
    pairs = np.unique(np.column_stack((root, exact_root)), axis=0)
    assert len(pairs) == len(np.unique(root)) == len(np.unique(exact_root))
    found, exact = rows[pairs[:, 0]], exact_rows[pairs[:, 1]]
    assert_allclose(found[:, :11], exact[:, :11], rtol=1e-9)
    assert_allclose(found[:, 11], exact[:, 11], rtol=0.05, atol=1)


def test_segments_that_nothing_joins_stay_apart():
    frame = random_segments(20)
    border = np.full((2, *frame[0].shape), -100.0)
    root, rows = agglomerated(frame, border, 25.0)
    assert_array_equal(root, np.arange(len(root)))
    assert_array_equal(rows, frame[1])
