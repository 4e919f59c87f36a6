"""Every compiled loop of the spatial search against its plain NumPy version."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from planewise.kernels import cells, labels, segments

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


# Labels


def roof(ridge, convex=True, shape=(30, 40), slope=4e-4, tilt=2e-4):
    """Two planes that meet in a line: readings without noise, planes, labels.

    slope, tilt: of w per pixel. The line leans by a pixel in 2 slope / tilt rows.
    """
    x, y = coordinates(shape)
    middle = x[0, 0] + ridge / 100
    s, t = 100 * slope, 100 * tilt
    planes = np.array([[0, 0, 0], [0.5 - s * middle, s, t], [0.5 + s * middle, -s, 0]])
    sides = planes[1:, :1, None] + planes[1:, 1:2, None] * x + planes[1:, 2:, None] * y
    nearest = sides.argmax(axis=0) + 1 if convex else sides.argmin(axis=0) + 1
    w = np.take_along_axis(sides, nearest[None] - 1, 0)[0]
    return (w, np.full(shape, 1 / SIGMA**2), x, y), planes, nearest.astype(np.int32)


def wavy(rng, shape=(26, 31), planes=4, pieces=14):
    """Labels of random pieces with ragged borders, 0 among them, and readings with holes."""
    label = quilt(rng, shape, planes, pieces)
    stray = rng.random(shape) < 0.1
    label[stray] = rng.integers(0, planes, shape)[stray]
    table = np.array([[0.5, 0, 0], *PLANES])[:planes]
    images = readings(rng, table, quilt(rng, shape, planes, pieces), holes=0.08)
    label[images[1] == 0] = 0
    slow = SIGMA**2 * rng.uniform(0, 1, shape)
    return label.astype(np.int32), images, slow, np.vstack((np.zeros((1, 3)), table[1:]))


NULL, DIFFERING = 9.0, 1.0


def labelling(seed):
    rng = np.random.default_rng(seed)
    label, images, slow, planes = wavy(rng)
    settled = rng.random((9, 11)) < 0.3
    lateral = SIGMA**2 * rng.uniform(0, 1, len(planes))
    arguments = (settled, 3, *images, slow, planes, lateral, NULL, DIFFERING)
    there = images[1] > 0
    free = ~settled.repeat(3, 0).repeat(3, 1)[: label.shape[0], : label.shape[1]]
    return label, arguments, free, oracles.costs(*images, slow, planes, lateral, NULL), there


@pytest.mark.parametrize("seed", range(4))
def test_one_sweep_of_labels(seed):
    label, arguments, free, cost, there = labelling(seed)
    out = label.copy()
    changed = labels.label_pixels(out, *arguments, 1)
    assert_array_equal(out, oracles.sweep_labels(label, free, cost, there, DIFFERING))
    assert 0 < (out != label).sum() == changed


@pytest.mark.parametrize("seed", range(4))
def test_sweeps_of_labels_never_cost_more_and_settle(seed):
    label, arguments, free, cost, there = labelling(seed)
    paid = [oracles.energy(label, cost, there, DIFFERING)]
    for sweeps in range(1, 8):
        out = label.copy()
        labels.label_pixels(out, *arguments, sweeps)
        paid.append(oracles.energy(out, cost, there, DIFFERING))
        assert_array_equal(out[~free | ~there], label[~free | ~there])
    assert paid[1] < paid[0]
    assert (np.diff(paid) <= 1e-9).all()
    assert labels.label_pixels(out, *arguments, 50) == 0
    again = out.copy()
    assert labels.label_pixels(again, *arguments, 1) == 0
    assert_array_equal(again, out)


def kinds_of(label, planes, x, y, reach=5, p=None):
    p = np.ones(label.shape) if p is None else p
    out = np.full((len(planes), len(planes)), 9, np.int8)
    labels.crease_kinds(label, planes, p, x, y, reach, out)
    return out


@pytest.mark.parametrize(("convex", "kind"), [(True, 1), (False, -1)])
def test_a_roof_is_convex_and_a_valley_concave(convex, kind):
    (_, _, x, y), planes, label = roof(20, convex)
    assert set(np.unique(label)) == {1, 2}
    kinds = np.zeros((3, 3))
    kinds[1, 2] = kinds[2, 1] = kind
    assert_array_equal(kinds_of(label, planes, x, y), kinds)
    across = (np.ascontiguousarray(image.T) for image in (x, y))
    assert_array_equal(kinds_of(np.ascontiguousarray(label.T), planes, *across), kinds)


def test_a_surface_in_front_of_another_does_not_meet_it():
    (_, _, x, y), planes, label = roof(20)
    planes[1, 0] += 0.1
    assert_array_equal(kinds_of(label, planes, x, y), 0)


@pytest.mark.parametrize("seed", range(4))
def test_crease_kinds(seed):
    rng = np.random.default_rng(seed)
    x, y = coordinates((40, 50))
    planes = np.vstack((np.zeros((1, 3)), rng.normal((0.5, 0, 0), (0.005, 0.05, 0.05), (5, 3))))
    values = planes[1:, :1, None] + planes[1:, 1:2, None] * x + planes[1:, 2:, None] * y
    label = (values.argmax(0) if seed % 2 else np.argsort(values, 0)[1]) + 1
    label[rng.random(label.shape) < 0.02] = 0
    label = label.astype(np.int32)
    p = ((label > 0) & (rng.random(label.shape) < 0.9)).astype(float)
    label = np.where(p > 0, label, 0).astype(np.int32)
    kinds = kinds_of(label, planes, x, y, 3, p)
    assert_array_equal(kinds, oracles.crease_kinds(label, planes, p, x, y, 3))
    assert kinds.any()


def test_a_crease_beside_missing_readings_is_one():
    (_, _, x, y), planes, label = roof(20)
    ridge = np.flatnonzero(np.diff(label[0]))[0]
    hole = np.zeros(label.shape, bool)
    hole[:, ridge - 6 : ridge - 3] = True
    p = np.where(hole, 0.0, 1.0)
    x, y, holed = (np.where(hole, 0, image) for image in (x, y, label))
    kinds = kinds_of(holed.astype(np.int32), planes, x, y, 5, p)
    assert kinds[1, 2] == 1


@pytest.mark.parametrize("radius", [1, 4])
def test_crease_band(radius):
    rng = np.random.default_rng(6)
    label = quilt(rng, (40, 50), 4).astype(np.int32)
    kinds = np.zeros((4, 4), np.int8)
    kinds[1, 2] = kinds[2, 1] = 1
    band = np.ones(label.shape, np.bool_)
    labels.crease_band(label, kinds, radius, band)
    assert_array_equal(band, oracles.crease_band(label, kinds, radius))
    assert 0 < band.sum() < band.size


@pytest.mark.parametrize("seed", range(6))
def test_crease_offsets(seed):
    rng = np.random.default_rng(seed)
    (w, p, x, y), planes, label = roof(20.0, convex=seed % 2 == 0, slope=2e-3, tilt=5e-4)
    kinds = kinds_of(label, planes, x, y)
    # The border lies up to as far from the line as is looked across it.
    away = seed - 6
    label[:, :away] = label[:, -away:].copy()
    # One plane is a little off, so that the readings tell another line than that of intersection.
    wrong = planes.copy()
    wrong[1, 0] += rng.uniform(-3, 3) * SIGMA
    w = w + rng.normal(0, SIGMA, w.shape)
    p[rng.random(p.shape) < 0.05] = 0
    label[p == 0] = 0
    slow, lateral = np.full(w.shape, 0.1 * SIGMA**2), SIGMA**2 * np.array([0, 0.1, 0.2])
    reach, sigma = 4, (0.5, 5.0)[seed % 2]
    offset = np.empty((3, 3))
    labels.crease_offsets(
        label, wrong, kinds, w, p, x, y, slow, lateral, cells.UNIT, reach, sigma, offset
    )
    places, cost = oracles.crease_costs(
        label, wrong, kinds, w, p, x, y, slow, lateral, reach, sigma, (1, 2)
    )
    at = np.argmin(abs(places - offset[1, 2]))
    assert offset[1, 2] == pytest.approx(places[at])
    assert cost[at] == pytest.approx(cost.min())
    assert np.count_nonzero(offset) == 1


def snapped(label, band, planes, kinds, offset, images, slow, sweeps, far=8.0, reach=4.0):
    out = label.copy()
    labels.snap_creases(
        out, band, planes, kinds, offset, *images[1:], slow, cells.UNIT, reach, far, sweeps
    )
    return out


@pytest.mark.parametrize("convex", [True, False])
def test_a_ragged_border_becomes_the_line_of_intersection(convex):
    images, planes, label = roof(20.3, convex)
    x, y = images[2:]
    kinds = kinds_of(label, planes, x, y)
    rng = np.random.default_rng(8)
    ragged = label.copy()
    for row, moved in zip(ragged, rng.integers(-3, 4, len(ragged)), strict=True):
        row[:] = np.roll(row, moved)
        row[:5], row[-5:] = row[6], row[-6]
    assert (ragged != label).sum() > 20
    band, slow = np.ones(label.shape, np.bool_), np.zeros(label.shape)
    none = np.zeros((3, 3))
    assert_array_equal(snapped(ragged, band, planes, kinds, none, images, slow, 8), label)
    # A line that lies two pixels further on the side of plane 1 leaves it less.
    moved = snapped(ragged, band, planes, kinds, none + 2, images, slow, 8)
    distance = oracles.crease_distance(planes, kinds, 1, 2, x, y)[0]
    assert_array_equal(moved, np.where(distance > 2, 1, 2))


def test_a_border_stays_where_the_line_may_not_be():
    images, planes, label = roof(20.3, tilt=0.0)
    kinds = kinds_of(label, planes, *images[2:])
    band, slow, none = np.ones(label.shape, np.bool_), np.zeros(label.shape), np.zeros((3, 3))
    shifted = np.roll(label, 12, axis=1)
    shifted[:, :12] = label[:, :1]
    assert_array_equal(snapped(shifted, band, planes, kinds, none, images, slow, 8), shifted)
    near = np.roll(label, 3, axis=1)
    near[:, :3] = label[:, :1]
    whole = (near, band, planes, kinds, none, images)
    assert_array_equal(snapped(*whole, slow, 8), label)
    # Unlike planes, a line that the slow error moves by pixels, no crease, outside the band.
    assert_array_equal(snapped(*whole, slow, 8, reach=0.1), near)
    assert_array_equal(snapped(*whole, slow + 1e-6, 8), near)
    assert_array_equal(snapped(near, band, planes, 0 * kinds, none, images, slow, 8), near)
    assert_array_equal(snapped(near, ~band, planes, kinds, none, images, slow, 8), near)


@pytest.mark.parametrize("seed", range(4))
def test_one_sweep_of_snapping(seed):
    rng = np.random.default_rng(seed)
    label, images, slow, planes = wavy(rng)
    band = rng.random(label.shape) < 0.8
    kinds = np.zeros((4, 4), np.int8)
    kinds[1, 2] = kinds[2, 1] = 1
    kinds[1, 3] = kinds[3, 1] = -1
    offset = rng.uniform(-1, 1, (4, 4))
    out = snapped(label, band, planes, kinds, offset, images, slow, 1, 20.0, 40.0)
    exact = oracles.snap_sweep(
        label, band, planes, kinds, offset, *images[1:], slow, reach=40.0, far=20.0
    )
    assert_array_equal(out, exact)
    assert (out != label).any()
