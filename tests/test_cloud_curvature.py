"""Curved surfaces in clouds are on no plane, planes stay planes; its loops against plain NumPy."""

import numpy as np
import pytest
from benchmarks import curved_clouds as shapes
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.clouds.cells import cells_of
from planewise.clouds.cloud import cloud_of
from planewise.clouds.segments import merged_cells
from planewise.kernels import cloud_curvature as kernels
from planewise.kernels import cloud_rows as of
from planewise.kernels.quadrics import GOES_ON, HEIGHTS, NO_EDGE, TOLD_U, TOLD_V, spread

SIGMA = 0.005


def planes_of(points, sigma=SIGMA, seed=0):
    noise = np.random.default_rng(seed).normal(0, sigma, points.shape)
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    return pw.detect_planes_in_points(points + noise, pw.Sensor(max_depth=extent, noise=sigma))


def matched(labels, truth):
    """True planes that a plane found covers by half of both together."""
    table = np.zeros((truth.max() + 1, labels.max() + 1))
    np.add.at(table, (truth, labels), 1)
    union = table.sum(axis=1, keepdims=True) + table.sum(axis=0) - table
    return int((table / np.maximum(union, 1) > 0.5)[1:, 1:].any(axis=1).sum())


@pytest.mark.parametrize("name", shapes.ALONE)
@pytest.mark.parametrize(("count", "sigma"), [(40_000, 0.005), (20_000, 0.002)])
def test_no_curved_surface_has_planes(name, count, sigma):
    model = planes_of(shapes.ALONE[name](count, np.random.default_rng(0)), sigma)
    # Of rolling ground, hundreds of facets without looking for it, hollows may be as flat as noise.
    assert len(model) <= (3 if name == "terrain" else 0)
    assert (model.labels > 0).mean() < 0.05


def test_an_empty_model_says_that_surfaces_are_curved():
    model = planes_of(shapes.sphere(40_000, 1.0, np.random.default_rng(0)))
    assert len(model) == 0
    assert model.note == model.curve.reason
    assert model.note.endswith("pieces of curved surfaces")


@settings(max_examples=12)
@given(
    radius=st.floats(0.3, 20.0),
    flat=st.floats(0.5, 1.0),
    seed=st.integers(0, 2**32 - 1),
)
def test_ellipsoids_of_any_size_have_no_planes(radius, flat, seed):
    points = shapes.ellipsoid(15_000, (radius, radius, flat * radius), np.random.default_rng(seed))
    assert len(planes_of(points, 0.002 * radius**0.5, seed)) == 0


@pytest.mark.parametrize("seed", [2058124, 4198205842])
def test_patches_side_by_side_that_tell_no_quadric_are_curved_with_those_about_them(seed):
    points = shapes.ellipsoid(15_000, (1.0, 1.0, 0.5), np.random.default_rng(seed))
    assert len(planes_of(points, 0.002, seed)) == 0


BESIDE = dict(shapes.beside_planes(40_000, np.random.default_rng(1)))


@pytest.mark.parametrize("name", BESIDE)
def test_planes_beside_curved_surfaces_are_planes(name):
    points, truth = BESIDE[name]
    model = planes_of(points)
    assert matched(model.labels, truth) == truth.max()
    assert len(model) <= truth.max() + (6 if "ground" in name else 0)


@pytest.mark.parametrize("degrees", [170.0, 173.0, 175.0, 177.0])
def test_walls_that_meet_at_a_small_angle_are_two(degrees):
    points, truth = shapes.walls(40_000, degrees, np.random.default_rng(0))
    model = planes_of(points)
    assert len(model) == matched(model.labels, truth) == 2


@pytest.mark.parametrize("sides", [6, 8, 12, 16])
def test_columns_keep_their_faces(sides):
    points, truth = shapes.column(40_000, sides, 1.0, 3.0, np.random.default_rng(0))
    model = planes_of(points)
    assert len(model) == matched(model.labels, truth) == sides


def test_a_column_of_so_many_faces_that_noise_hides_its_edges_is_round():
    points, _ = shapes.column(40_000, 100, 1.0, 3.0, np.random.default_rng(0))
    assert len(planes_of(points)) == 0


@pytest.mark.parametrize("shape", ["sphere", "saddle", "column"])
def test_few_points(shape):
    rng = np.random.default_rng(0)
    if shape == "column":
        points, truth = shapes.column(3_000, 8, 1.0, 3.0, rng)
        model = planes_of(points)
        assert len(model) == matched(model.labels, truth) == 8
    else:
        assert len(planes_of(shapes.ALONE[shape](3_000, rng))) == 0


@pytest.mark.parametrize(
    ("bulge", "told", "flat"), [(0.02, 1, True), (0.06, 1, False), (0.06, 6, True)]
)
def test_a_wall_that_bulges_hardly_more_than_its_noise_is_flat(bulge, told, flat):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 4, (2, 40_000))
    z = bulge * np.sin(np.pi * x / 4) + rng.normal(0, SIGMA, 40_000)
    sensor = pw.Sensor(max_depth=6.0, noise=told * SIGMA)
    model = pw.detect_planes_in_points(np.column_stack((x, y, z)), sensor)
    assert (model.labels > 0).mean() == (pytest.approx(1, abs=0.05) if flat else 0)


@pytest.fixture(scope="module")
def segments():
    """Cells, segments and their sums of a dome on four walls."""
    clouds = dict(shapes.beside_planes(30_000, np.random.default_rng(0)))
    points, _ = clouds["dome over four walls"]
    points = points + np.random.default_rng(1).normal(0, SIGMA, points.shape)
    cloud = cloud_of(points, pw.Sensor(max_depth=10.0, noise=SIGMA), None, 1)
    cells = cells_of(cloud)
    rows, of_cell, _ = merged_cells(cells, 27.6, 1, cloud.memory)
    sums = np.zeros((len(rows), HEIGHTS))
    kernels.add_heights(cells.rows, of_cell, rows, sums)
    quadrics = np.empty((len(rows), kernels.QUADRIC))
    kernels.quadrics_of(sums, rows, cells.error.drift, quadrics)
    return cells, rows, of_cell, quadrics


def matrix(quadric):
    xx, xy, xz, yy, yz, zz = quadric[:6]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_quadrics_are_least_squares(segments):
    cells, rows, of_cell, quadrics = segments
    told = np.flatnonzero(quadrics[:, kernels.BENT] >= 0)
    assert 20 < len(told) < len(rows)
    assert 0 < (quadrics[told, kernels.BENT] > 0).sum() < len(told)
    for s in told:
        mine, normal = cells.rows[of_cell == s], rows[s, of.NX : of.NZ + 1]
        e, f = np.linalg.svd(normal[None])[2][1:]
        at = mine[:, of.CX : of.CZ + 1] - rows[s, of.CX : of.CZ + 1]
        x, y, z, w = at @ e, at @ f, at @ normal, mine[:, of.WEIGHT]
        basis = np.column_stack((np.ones_like(x), x, y, x * x, x * y, y * y))
        root = np.sqrt(w)[:, None]
        fitted = np.linalg.lstsq(basis * root, z * root[:, 0], rcond=None)[0]
        k, tilt = matrix(quadrics[s]), quadrics[s, kernels.TILT : kernels.TILT + 3]
        flat = at - np.outer(z, normal)
        height = quadrics[s, kernels.OFFSET] + flat @ tilt
        height += 0.5 * np.einsum("ni,ij,nj->n", flat, k, flat)
        assert_allclose(height, basis @ fitted, atol=1e-7)
        assert_allclose(k @ normal, 0, atol=1e-9)
        assert_allclose(quadrics[s, kernels.SIZE], np.linalg.norm(k))

        def left(columns, basis=basis * root, z=z * root[:, 0]):
            part = basis[:, :columns]
            return float(((z - part @ np.linalg.lstsq(part, z, rcond=None)[0]) ** 2).sum())

        area, n = np.sqrt(rows[s, of.AREA]), len(mine)
        walk = min(cells.error.drift * area * w.sum() / 80, max(left(6) - (n - 6), 0) / 6)
        nats = 0.5 * (left(3) - left(6)) / (1 + walk)
        assert bool(quadrics[s, kernels.BENT]) == (nats > 1.5 * np.log(rows[s, of.COUNT]))


def test_a_random_walk_has_so_much_in_a_quadric():
    """1/80 D L in each mode of K, six times that about the quadric: see `_MODE` and `_REST`."""
    n = 24
    grid = (np.arange(n) + 0.5) / n
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    covariance = -0.5 * np.hypot(x[:, None] - x, y[:, None] - y)
    modes = np.linalg.qr(np.column_stack((np.ones_like(x), x, y, x * x, x * y, y * y)))[0]
    told = np.diag(modes.T @ covariance @ modes) / n**2
    assert told[3:].mean() == pytest.approx(1 / 80, rel=0.02)
    rest = np.eye(n * n) - modes @ modes.T
    about = np.trace(rest @ covariance @ rest) / n**2
    assert about / told[3:].mean() == pytest.approx(6, rel=0.03)


def borders_by_numpy(segments, edge):
    """Border of every segment, and of each pair of cells of two what there is to say."""
    cells, rows, of_cell, quadrics = segments
    border, out = np.zeros(len(rows)), []
    extent = np.sqrt(rows[:, of.AREA])
    for (i, j), side in zip(cells.ends, cells.sides, strict=True):
        pair = u, v = of_cell[i], of_cell[j]
        if u == v:
            continue
        bent = quadrics[list(pair), kernels.BENT]
        close = abs(rows[u, of.NX : of.NZ + 1] @ rows[v, of.NX : of.NZ + 1]) > 0.5
        if close and (bent < 0).all():
            continue
        border[[u, v]] += side
        middle = cells.rows[[i, j], of.CX : of.CZ + 1].mean(axis=0)
        flat, curved, height = [], [], []
        for s in pair:
            normal, d = rows[s, of.NX : of.NZ + 1], middle - rows[s, of.CX : of.CZ + 1]
            tilt, k = quadrics[s, kernels.TILT : kernels.TILT + 3], matrix(quadrics[s])
            flat.append(normal)
            curved.append(normal - tilt - k @ d)
            quadric = quadrics[s, kernels.OFFSET] + tilt @ d + 0.5 * d @ k @ d
            height.append(normal @ d - quadric)
        sign = 1.0 if flat[0] @ flat[1] > 0 else -1.0
        turn = np.linalg.norm(sign * flat[1] - flat[0])
        if not (bent > 0).any():
            continue
        told = quadrics[list(pair), kernels.SIZE] * (extent[u] + extent[v]) >= 0.5 * turn
        told |= (bent < 0) & close
        if not told.any():
            continue
        left = sign * curved[1] - curved[0]
        step = (sign * height[1] - height[0]) / (0.5 * (extent[u] + extent[v]))
        on = np.hypot(np.linalg.norm(left), step) <= 0.5 * turn
        out.append(
            (u, v, side, on, np.linalg.norm(left) <= edge[0] and abs(step) <= edge[1], *told)
        )
    return border, out


def test_borders_go_on_where_quadrics_meet(segments):
    cells, rows, of_cell, quadrics = segments
    n = len(cells.sides)
    pairs, points, states = (
        np.empty((n, 2), np.int32),
        np.empty(n, np.float32),
        np.empty(n, np.int8),
    )
    border, edge = np.zeros(len(rows)), (0.05, 0.01)
    found = kernels.borders_of(
        cells.ends, cells.sides, of_cell, cells.rows, rows, quadrics, edge, border, pairs, points,
        states,
    )  # fmt: skip
    expected_border, expected = borders_by_numpy(segments, edge)
    assert_allclose(border, expected_border)
    assert found == len(expected) > 100
    u, v, sides, on, no_edge, told_u, told_v = (
        np.array(column) for column in zip(*expected, strict=True)
    )
    assert_array_equal(pairs[:found], np.column_stack((u, v)))
    assert_allclose(points[:found], sides)
    assert_array_equal(states[:found] & GOES_ON > 0, on)
    assert_array_equal(states[:found] & NO_EDGE > 0, no_edge)
    assert 0.05 < no_edge.mean() < 0.95
    assert_array_equal(states[:found] & TOLD_U > 0, told_u)
    assert_array_equal(states[:found] & TOLD_V > 0, told_v)
    assert 0.2 < on.mean() < 1.0


def test_what_lies_among_curved_pieces_is_one_of_them():
    """In a row of four: the first two go on; the third is told by them, the last is a plane."""
    both = TOLD_U | TOLD_V
    pairs = np.array([[0, 1], [1, 2], [2, 3]], np.int32)
    points = np.array([5.0, 4.0, 3.0], np.float32)
    states = np.array([both | GOES_ON, both, TOLD_U], np.int8)
    border, curved = np.array([6.0, 9.0, 7.0, 4.0]), np.empty(4, np.bool_)
    spread(border, border, pairs, points, states, curved)
    assert curved.tolist() == [True, True, True, False]
    whole = 3 * border  # of which a quarter has to be
    spread(border, whole, pairs, points, states, curved)
    assert curved.tolist() == [True, True, False, False]
    border[2] = 9.0  # less than half of it is beside what is curved
    spread(border, border, pairs, points, states, curved)
    assert curved.tolist() == [True, True, False, False]
