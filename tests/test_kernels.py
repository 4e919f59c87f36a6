"""Every compiled loop against its plain NumPy version."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from planewise.kernels import readings as kernels
from planewise.kernels.samples import planes_through_rays

from . import oracles

SIZES = (1, 3, 511, 512, 513, kernels.PART + 700)


def rays(rng, k, dtype=np.float64):
    direction = np.vstack((rng.uniform(-0.6, 0.6, (2, k)), np.ones(k)))
    sigma = rng.uniform(0.005, 0.02, k) * np.sqrt(2)
    z = rng.uniform(0.5, 4, k)
    tau = rng.uniform(3, 7, k)
    theta = np.array([[0.1, 0.2, 0.6], [-0.2, 0.0, 0.5], [0.0, 0.05, 0.9]])
    z[: k // 2] = (1 / (theta[0] @ direction))[: k // 2] + rng.normal(0, 0.01, k // 2)
    return (
        theta.astype(dtype),
        np.ascontiguousarray((direction * sigma).astype(dtype)),
        (z / sigma).astype(dtype),
        tau.astype(dtype),
    )


@pytest.mark.parametrize("k", SIZES)
def test_score_rays(k):
    theta, a, s, tau = rays(np.random.default_rng(k), k, np.float32)
    total = np.full(3, 99.0)
    kernels.score_rays(theta, a, s, tau, 0, 3, total)
    exact = oracles.score_rays(*(x.astype(np.float64) for x in (theta, a, s, tau)))
    assert_allclose(total, exact, rtol=2e-4, atol=2e-2)


def test_scores_of_a_part_are_those_of_the_whole():
    theta, a, s, tau = rays(np.random.default_rng(0), 3000, np.float32)
    whole, parts = np.empty(3), np.empty(3)
    kernels.score_rays(theta, a, s, tau, 0, 3, whole)
    for h in range(3):
        kernels.score_rays(theta, a, s, tau, h, h + 1, parts)
    assert_array_equal(whole, parts)


def test_a_degenerate_plane_gains_nothing():
    theta, a, s, tau = rays(np.random.default_rng(0), 600, np.float32)
    theta[1] = np.nan
    total = np.empty(3)
    kernels.score_rays(theta, a, s, tau, 0, 3, total)
    assert total[1] == 0
    assert total[0] < 0


@pytest.mark.parametrize("k", SIZES)
@pytest.mark.parametrize("n", [2, 3, 5])
def test_score_points(k, n):
    rng = np.random.default_rng(k)
    x = rng.normal(0, 3, (n + 1, k)).astype(np.float32)
    h = rng.normal(0, 1, (4, n + 1)).astype(np.float32)
    tau = rng.uniform(3, 7, k).astype(np.float32)
    total = np.empty(4)
    kernels.score_points(h, x, tau, 0, 4, total)
    exact = oracles.score_points(*(y.astype(np.float64) for y in (h, x, tau)))
    assert_allclose(total, exact, rtol=1e-4, atol=1e-3)


def check_assignment(out, square, tau):
    best, second, label, sums = out
    cumulative = sums.sum(axis=0)
    exact = oracles.assign(square, tau)
    assert_allclose(best, exact[0], rtol=1e-9, atol=1e-9)
    assert_allclose(second, exact[1], rtol=1e-9, atol=1e-9)
    assert_array_equal(label, exact[2])
    assert_allclose(cumulative, exact[3], rtol=1e-9, atol=1e-9)


def parts(k):
    return -(-k // kernels.PART)


def buffers(k, planes):
    sums = np.empty((parts(k), planes + 1))
    return np.empty(k), np.empty(k), np.empty(k, np.uint16), sums


@pytest.mark.parametrize("k", SIZES)
@pytest.mark.parametrize("planes", [0, 1, 3])
def test_assign_rays(k, planes):
    theta, a, s, tau = rays(np.random.default_rng(k), k)
    out = buffers(k, planes)
    kernels.assign_rays(theta[:planes], a, s, tau, 0, parts(k), *out)
    check_assignment(out, (s - 1 / (theta[:planes] @ a)) ** 2, tau)


@pytest.mark.parametrize("k", SIZES)
@pytest.mark.parametrize("n", [2, 4])
def test_assign_points(k, n):
    rng = np.random.default_rng(k)
    x, h = rng.normal(0, 2, (n + 1, k)), rng.normal(0, 1, (3, n + 1))
    tau = rng.uniform(1, 5, k)
    out = buffers(k, 3)
    kernels.assign_points(h, x, tau, 0, parts(k), *out)
    check_assignment(out, (h @ x) ** 2, tau)


def step(theta, a, s, labels):
    sums = np.empty((parts(s.size), len(theta), 9))
    kernels.normal_sums(theta, a, s, labels, 0, len(sums), sums)
    matrix, moved = np.empty((len(theta), 3, 3)), np.empty((len(theta), 3))
    kernels.gauss_newton(theta, sums, matrix, moved)
    return matrix, moved


@pytest.mark.parametrize("k", [2000, kernels.PART + 700])
def test_gauss_newton(k):
    theta, a, s, tau = rays(np.random.default_rng(5), k)
    labels = oracles.assign((s - 1 / (theta @ a)) ** 2, tau)[2].astype(np.uint16)
    matrix, moved = step(theta, a, s, labels)
    exact = oracles.gauss_newton(theta, a, s, labels)
    assert_allclose(matrix, exact[0], rtol=1e-9)
    assert_allclose(moved, exact[1], rtol=1e-7)


def test_gauss_newton_without_enough_readings_is_nan():
    theta, a, s, _ = rays(np.random.default_rng(5), 100)
    labels = np.zeros(100, np.uint16)
    labels[:2] = 1
    assert np.isnan(step(theta, a, s, labels)[1]).all()


@pytest.mark.parametrize("k", [2000, kernels.PART + 700])
def test_offer_sums(k):
    theta, a, s, ceiling = rays(np.random.default_rng(5), k)
    s[:3], ceiling[3:6] = 0.0, -1.0
    sums, saved = np.empty((parts(k), 1, 9)), np.empty(parts(k))
    kernels.offer_sums(theta[:1], a, s, ceiling, 0, parts(k), sums, saved)
    gain = (s - 1 / (theta[0] @ a)) ** 2 - ceiling
    exact = np.empty((parts(k), 1, 9))
    kernels.normal_sums(theta[:1], a, s, (gain < 0).astype(np.uint16), 0, parts(k), exact)
    assert_allclose(sums, exact, rtol=1e-9)
    assert_allclose(saved.sum(), np.minimum(gain, 0).sum())


def test_offer_sums_of_a_degenerate_plane_are_zero():
    _, a, s, ceiling = rays(np.random.default_rng(5), 600)
    for theta in (np.full((1, 3), np.nan), np.zeros((1, 3))):
        sums, saved = np.empty((1, 1, 9)), np.empty(1)
        kernels.offer_sums(theta, a, s, ceiling, 0, 1, sums, saved)
        assert saved[0] == 0
        assert not sums[..., :6].any()


@pytest.mark.parametrize("n", [2, 3, 6])
def test_scatter(n):
    rng = np.random.default_rng(n)
    x, labels = rng.normal(size=(n + 1, 700)), rng.integers(0, 4, 700).astype(np.uint16)
    matrix = np.empty((3, n + 1, n + 1))
    kernels.scatter(x, labels, matrix)
    assert_allclose(matrix, oracles.scatter(x, labels, 3), rtol=1e-10, atol=1e-10)


def test_cell_moments_solve_the_linear_least_squares_of_each_cell():
    rng = np.random.default_rng(3)
    height, width, side = 12, 20, 8
    index = np.sort(rng.choice(height * width, 150, replace=False))
    _, a, s, _ = rays(rng, 150)
    moments = np.empty((2 * 3, 11))
    kernels.cell_moments(a, s, index, width, side, 3, moments)
    for cell in range(6):
        row, column = divmod(cell, 3)
        mine = ((index // width) // side == row) & ((index % width) // side == column)
        b, target = (a * s**2)[:, mine], s[mine]
        assert moments[cell, 10] == mine.sum()
        assert_allclose(moments[cell, [0, 1, 2, 3, 4, 5]], (b @ b.T)[np.triu_indices(3)])
        assert_allclose(moments[cell, 6:9], b @ target)
        assert_allclose(moments[cell, 9], target @ target)


@pytest.mark.parametrize("run", [1, 60])
@pytest.mark.parametrize("k", [400, kernels.PART + 400])
def test_summarise(k, run):
    rng = np.random.default_rng(1)
    width = 25
    index = np.sort(rng.choice(2 * k, k, replace=False))
    labels = rng.integers(0, 4, k).astype(np.uint16).repeat(run)[:k]
    gain, square, depth, solid = rng.uniform(1, 2, size=(4, k))
    direction = rng.normal(size=(3, k))
    sums, box = np.empty((parts(k), 3, 7)), np.empty((parts(k), 3, 4), np.int64)
    where = index, width, 0, parts(k)
    kernels.summarise(labels, gain, square, direction, depth, solid, *where, sums, box)
    sums, box = sums.sum(axis=0), np.hstack((box[..., :2].min(axis=0), box[..., 2:].max(axis=0)))
    area, position = depth**3 * solid, direction * depth
    for j in range(3):
        mine = labels == j + 1
        expected = [mine.sum(), gain[mine].sum(), square[mine].sum(), area[mine].sum()]
        assert_allclose(sums[j], [*expected, *position[:, mine].sum(axis=1)], atol=1e-9)
        rows, columns = index[mine] // width, index[mine] % width
        assert_array_equal(box[j], [rows.min(), columns.min(), rows.max() + 1, columns.max() + 1])


def test_readings_that_a_plane_explains_are_claimed():
    rng = np.random.default_rng(3)
    free = np.sort(rng.choice(500, 300, replace=False))
    label, best = (rng.random(300) < 0.4).astype(np.uint16), -rng.random(300)
    exact, mine = np.zeros((2, 500)), label > 0
    exact[0, free[mine]], exact[1, free[mine]] = 7, best[mine]
    labels, gains = np.zeros(500, np.uint16), np.zeros(500)
    left, still = np.empty((2, np.count_nonzero(~mine)), np.int64)
    for first, last in ((120, 300), (0, 120)):
        at = first - np.count_nonzero(mine[:first])
        kernels.claim(label, best, 7, free, first, last, at, labels, gains, left, still)
    assert_array_equal(left, np.flatnonzero(~mine))
    assert_array_equal(still, free[~mine])
    assert_array_equal([labels, gains], exact)


def test_planes_through_three_readings():
    _, a, s, _ = rays(np.random.default_rng(7), 60)
    chosen = np.random.default_rng(8).permuted(np.tile(np.arange(60), (200, 1)), axis=1)[:, :3]
    chosen[0], chosen[1] = (50, 51, 52), (53, 54, 55)
    s[50:56] = 1.0
    a[:, 50:53] = np.array([[1, 2, 3], [0, 1, 2], [1, 1, 1]])  # in a line
    a[:, 53:56] = np.array([[1, 2, 4], [1, 2, 3], [1, 2, 4]])  # in a plane with the sensor
    theta = np.full((202, 3), 9.0)
    planes_through_rays(a, s, chosen, 0, 120, theta)
    planes_through_rays(a, s, chosen, 120, 200, theta)
    for three, plane in zip(chosen[2:], theta[2:200], strict=True):
        if {50, 51, 52, 53, 54, 55} & {*three}:
            continue
        assert_allclose(plane @ (a[:, three] * s[three]), 1, rtol=1e-9)
    assert np.isnan(theta[:2]).all()
    assert (theta[200:] == 9).all()


def test_three_readings_of_a_row_or_column_span_no_plane():
    """That is one through the sensor, but for rounding; pixels beside each other do span one."""
    rng = np.random.default_rng(0)
    chosen = np.argsort(rng.random((500, 60)), axis=1)[:, :3]
    for fixed in (0, 1):
        a = np.stack((np.arange(60), np.full(60, 33), np.full(60, 1)))[[fixed, 1 - fixed, 2]]
        a = (a - [[320.2], [240.7], [0]]) / [[1e4], [1e4], [1]] * rng.uniform(0.001, 0.02, 60)
        s, theta = rng.uniform(0.5, 10, 60) / a[2], np.empty((500, 3))
        planes_through_rays(a, s, chosen, 0, 500, theta)
        assert np.isnan(theta).all()
        a[1 - fixed] += 1e-4 * a[2] * (np.arange(60) % 2)
        planes_through_rays(a, s, chosen, 0, 500, theta)
        assert_array_equal(np.isfinite(theta).all(axis=1), np.ptp(chosen % 2, axis=1) > 0)
