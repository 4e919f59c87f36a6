"""Small loops written out, against NumPy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from planewise.kernels import frame_error, images, medians, planes
from planewise.kernels.elementary import exponent, exponential, logarithm, power_of_two
from planewise.kernels.jit import compiled, in_order
from planewise.paper.evaluate import covariance_of_plane
from planewise.spatial.frame import ErrorTable


@compiled
def logarithms(x, out):
    for k in range(x.size):
        out[k] = logarithm(x[k])


def test_logarithm():
    rng = np.random.default_rng(0)
    some = [1.0, 0.5, 2.0, np.sqrt(0.5), np.sqrt(2.0), 1 + 1e-15, 1 - 1e-16, 1e-300, 1e300]
    x = np.concatenate((some, np.exp(rng.uniform(-700, 700, 4000)), rng.uniform(0.5, 1.5, 4000)))
    out = np.empty(x.size)
    logarithms(x, out)
    exact = np.log(x)
    assert (np.abs(out - exact) <= 3 * np.spacing(np.abs(exact))).all()
    assert out[0] == 0


@in_order
def exponentials(x, out):
    for k in range(x.size):
        out[k] = exponential(x[k])


def test_exponential():
    rng = np.random.default_rng(0)
    some = [0.0, -1e-300, -1e-15, -0.5 * np.log(2), -np.log(2), -1.0, -700.0, -701.0, -np.inf]
    x = np.concatenate((some, -rng.uniform(0, 700, 4000), -rng.uniform(0, 1, 4000)))
    out = np.empty(x.size)
    exponentials(x, out)
    exact = np.exp(np.maximum(x, -700.0))
    assert (np.abs(out - exact) <= 2 * np.spacing(exact)).all()
    assert out[0] == 1


@compiled
def exponents(x, k, out):
    for i in range(x.size):
        k[i] = exponent(x[i])
        out[i] = power_of_two(k[i])


def test_powers_of_two():
    x = np.concatenate((np.exp(np.random.default_rng(1).uniform(-700, 700, 1000)), [1, 0.5, 1024]))
    k, out = np.empty(x.size, np.int64), np.empty(x.size)
    exponents(x, k, out)
    assert_array_equal(k, np.frexp(x)[1] - 1)
    assert_array_equal(out, np.exp2(k))


def test_affine_planes():
    rng = np.random.default_rng(1)
    root = rng.normal(0, 1, (50, 3, 3)) * [[[1e4], [1e2], [3e2]]]
    matrix = root @ root.transpose(0, 2, 1)
    exact = rng.normal(0, 1, (50, 3))
    rows = np.zeros((50, 13))
    rows[:, :6] = matrix.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]
    rows[:, 6:9] = np.einsum("nij,nj->ni", matrix, exact)
    out = np.empty((50, 3))
    planes.affine_planes(rows, out)
    assert_allclose(out, exact, rtol=1e-6)


def of_walk(t, information, drift, per_metre):
    """Covariance of a plane's t from an error that wanders, D |r| the variance of a difference."""
    mean = information[0] / information[0, 0]
    spread = (information / information[0, 0] - np.outer(mean, mean))[1:, 1:]
    side = max(np.sqrt(12 * np.sqrt(max(np.linalg.det(spread), 0))), 0.03)
    if mean @ t <= 0:
        return np.zeros((3, 3))
    d = np.interp(per_metre / (mean @ t), np.arange(drift.size - 1), drift[:-1])
    about_middle = np.diag([0.26 * d * 3.2, 0.89 * d / side, 0.89 * d / side])
    to_corner = np.array([[1, -mean[1], -mean[2]], [0, 1, 0], [0, 0, 1]])
    return to_corner @ about_middle @ to_corner.T


@pytest.mark.parametrize("walk", [0.0, 2.0])
def test_planes_in_space(walk):
    rng = np.random.default_rng(2)
    t, turn = rng.normal(0, 1, (20, 3)), rng.normal(0, 2, (3, 3))
    root = rng.normal(0, 1, (20, 3, 3)) * [[[1e4], [1e2], [3e2]]]
    information = root @ root.transpose(0, 2, 1)
    rows, covariances = np.empty((20, 4)), np.empty((20, 4, 4))
    drift = rng.uniform(1e-6, 1e-5, 60)
    planes.in_space(t, information, drift, 20.0, walk, 3.2, turn, rows, covariances)
    for k in range(20):
        theta, random = turn @ t[k], np.linalg.inv(information[k])
        random += walk * of_walk(t[k], information[k], drift, 20.0)
        size = np.linalg.norm(theta)
        assert_allclose(rows[k], [*(-theta / size), 1 / size], rtol=1e-12)
        of_theta = turn @ random @ turn.T
        exact = covariance_of_plane(theta, of_theta)
        assert_allclose(covariances[k], exact, rtol=0, atol=1e-9 * abs(exact).max())
    planes.in_space(t, np.ones((20, 3, 3)), drift, 20.0, walk, 3.2, turn, rows, covariances)
    assert not np.isfinite(covariances[:, 0, 0]).any()


@pytest.mark.parametrize("size", [1, 2, 3, 100, 1801])
@pytest.mark.parametrize("kind", ["spread", "alike", "tied", "edges"])
def test_the_middle_of_numbers(size, kind):
    rng = np.random.default_rng(size)
    values = rng.chisquare(3, size) * 10.0 ** rng.integers(-300, 300, size)
    if kind == "alike":
        values[:] = values[0]
    elif kind == "tied":
        values = rng.integers(0, 4, size) / 8
    elif kind == "edges":
        values[::3], values[::4], values[::5] = np.inf, 0.0, -0.0
    before = values.copy()
    for rank in {0, size // 3, size // 2, size - 1}:
        assert medians.smallest(values, rank, np.empty(size)) == np.sort(values)[rank]
    assert_array_equal(values, before)


def test_nearest_planes():
    rng = np.random.default_rng(2)
    root = rng.normal(0, 1, (20, 3, 3)) * [[[1e-2], [1e-1], [3e-2]]]
    information = root @ root.transpose(0, 2, 1)
    some = rng.normal(0, 1, (20, 3))
    nearest, far = np.empty(20, np.intp), np.empty(20)
    planes.nearest_planes(some, information, nearest, far)
    apart = some[:, None] - some
    half = 0.5 * np.einsum("nmi,nij,nmj->nm", apart, information, apart)
    np.fill_diagonal(half, np.inf)
    assert_array_equal(nearest, half.argmin(axis=1))
    assert_allclose(far, half.min(axis=1), rtol=1e-6)
    planes.nearest_planes(some[:1], information[:1], nearest[:1], far[:1])
    assert (nearest[0], far[0]) == (0, np.inf)


@pytest.mark.parametrize("size", [5, 6, 9, 30])
def test_running_medians(size):
    values = np.random.default_rng(size).integers(1, 9, size)
    out = np.empty(size)
    images.running_medians(values, 4, out)
    mirrored = np.pad(values, 4, mode="reflect")
    assert_array_equal(out, [np.median(mirrored[k : k + 9]) for k in range(size)])


def test_variances_and_bias_by_depth():
    rng = np.random.default_rng(2)
    white, shared, drift, step = rng.uniform(1, 2, (4, 900)) * np.arange(1, 901) ** -2.0
    variance = np.empty(900)
    frame_error.reading_variances(white, shared, drift, step, (1.5, 0.7, 0.2), variance)
    assert_allclose(variance, 1.5 * (white + step) + 0.7 * (shared + step) + 0.2 * drift)

    table = ErrorTable((100.0, 0.0, 0.0), 1.0, 40, white, shared, drift, step)
    w = rng.uniform(0.12, 2.2, 200)
    row = 100.0 / w
    near, far = (np.clip(factor * row, 40, 898) for factor in (0.95, 1.05))
    far = np.maximum(far, near + 1e-3)
    here, closer, farther = (np.interp(at, np.arange(900), white) for at in (row, near, far))
    fall = np.log(closer / farther) / np.log(far / near)
    assert_allclose(table.noise_bias(w), here / w**2 * (fall - 1), rtol=1e-9, atol=1e-15)
    assert table.noise_bias(w.reshape(20, 10)).shape == (20, 10)
