"""Compiled loops over clouds against plain NumPy."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.clouds.cells import CloudError, cells_of, residual_correlation
from planewise.clouds.cloud import cloud_of, side_for
from planewise.clouds.groups import groups_of
from planewise.clouds.information import alone_of, data_of
from planewise.clouds.memory import Memory
from planewise.clouds.order import Grid, held_by, order_of, positions, radix_sort
from planewise.clouds.rows import covariances
from planewise.kernels import cloud_information as nats
from planewise.kernels import cloud_keys, cloud_masks, cubes
from planewise.kernels import cloud_labels as label_loops
from planewise.kernels import cloud_rows as rows_of
from planewise.kernels import cloud_segments as segments
from planewise.kernels import pairs as loops_of_pairs
from planewise.kernels.masks import CODES, CONTEXTS, NONE, PRIOR, SYMBOLS, _code

SIGMA = 0.01
SENSOR = pw.Sensor(max_depth=10.0, resolution=0.001, noise=SIGMA)


def row_of(points, weight=1.0):
    """Row of points without a plane."""
    row = np.zeros(rows_of.ROW)
    centre = points.mean(axis=0)
    scatter = weight * (points - centre).T @ (points - centre)
    row[rows_of.WEIGHT], row[rows_of.COUNT] = weight * len(points), len(points)
    row[rows_of.CX : rows_of.CZ + 1] = centre
    row[rows_of.XX : rows_of.ZZ + 1] = scatter[np.triu_indices(3)]
    return row


def patch(rng, centre, normal, side, count=40, noise=SIGMA):
    """Points on a square about a centre."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    e, f = np.linalg.svd(normal[None])[2][1:]
    u, v = rng.uniform(-side / 2, side / 2, (2, count))
    off = rng.normal(0, noise, count)
    return centre + np.outer(u, e) + np.outer(v, f) + np.outer(off, normal)


def matrix(row):
    xx, xy, xz, yy, yz, zz = row[rows_of.XX : rows_of.ZZ + 1]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def plane_row(rng, centre, normal, side, count=40):
    """Row of a patch that has a plane: its scatter across is taken out."""
    row = row_of(patch(rng, centre, normal, side, count), 1 / SIGMA**2)
    values, axes = np.linalg.eigh(matrix(row))
    flat = matrix(row) - values[0] * np.outer(axes[:, 0], axes[:, 0])
    row[rows_of.XX : rows_of.ZZ + 1] = flat[np.triu_indices(3)]
    row[rows_of.NX : rows_of.NZ + 1] = axes[:, 0]
    row[rows_of.AREA], row[rows_of.CELLS], row[rows_of.FREE] = side * side, 1.0, 9.0
    return row


def scattered(count=3000, seed=0):
    """Two walls and a floor with stray points, and the plane of each point."""
    rng = np.random.default_rng(seed)
    parts = [
        patch(rng, (1, 1, 0), (0, 0, 1), 2, count),
        patch(rng, (0, 1, 1), (1, 0, 0), 2, count),
        patch(rng, (1, 0, 1), (0, 1, 0), 2, count),
        rng.uniform(0, 2, (count // 20, 3)),
    ]
    return np.vstack(parts), np.repeat([1, 2, 3, 0], [len(part) for part in parts])


@pytest.fixture(scope="module")
def cloud():
    return cloud_of(scattered()[0], SENSOR, None, 2)


def test_bits_are_spread_and_gathered():
    for x in (0, 1, 5, 12345, (1 << 21) - 1):
        assert cloud_keys.gather(cloud_keys.spread(x)) == x
        bits = sum(((x >> b) & 1) << 3 * b for b in range(21))
        assert cloud_keys.spread(x) == bits


@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize("bits", [4, 30, 63])
def test_radix_sort_is_a_stable_sort(workers, bits):
    keys = np.random.default_rng(bits).integers(0, 1 << bits, 160_000, np.uint64)
    ordered, rows = radix_sort(keys.copy(), bits, workers)
    expected = np.argsort(keys, kind="stable")
    assert_array_equal(rows, expected)
    assert_array_equal(ordered, keys[expected])


def test_keys_are_those_of_a_turned_grid_and_bad_points_have_none():
    points = np.random.default_rng(0).uniform(-3, 3, (500, 3))
    points[7], points[9] = np.nan, [0, 0, 1e9]
    order = order_of(points, Grid.reaching(np.zeros(3), 6.0, 0.1), 1)
    assert order.grid.levels == 7
    assert 7 not in order.rows
    assert 9 not in order.rows
    assert len(order.keys) == 498
    grid = np.column_stack([positions(order.keys, axis) for axis in range(3)])
    expected = np.floor(points[order.rows] @ cloud_keys.TURN.T / order.grid.side) + 64
    assert_array_equal(grid, expected)
    assert_allclose(cloud_keys.TURN @ cloud_keys.TURN.T, np.eye(3), atol=1e-15)


def test_which_points_are_in_a_grid_does_not_depend_on_its_cubes():
    points = np.random.default_rng(0).uniform(-9, 9, (5000, 3))
    inside = (np.abs(points @ cloud_keys.TURN.T) <= 6.0).all(axis=1)
    for side in (0.05, 0.7, 0.9, 5.0, 20.0):
        order = order_of(points, Grid.reaching(np.zeros(3), 6.0, side), 1)
        assert_array_equal(np.sort(order.rows), np.flatnonzero(inside))


@pytest.mark.parametrize("count", [300, 100_000])
def test_cubes_are_counted_without_sorting(count):
    points = np.random.default_rng(0).uniform(-3, 3, (count, 3))
    points[5] = np.nan
    for side in (0.05, 0.2, 1.0, 7.0):
        grid = Grid.reaching(np.zeros(3), 6.0, side)
        places = np.floor(points[np.arange(count) != 5] @ cloud_keys.TURN.T / side)
        held = np.unique(places, axis=0, return_counts=True)[1]
        several = np.count_nonzero(held > 1)
        lonely = max(np.count_nonzero(held == 1) - 0.22 * several, 0.0)
        sure = several > 10  # of 300 points in tiny cubes hardly two are in one
        expected = (held.sum() - lonely) / (len(held) - lonely) if sure else held.mean()
        for workers in (1, 2):
            mean, without_lonely = held_by(points, grid, workers, Memory())
            assert mean == pytest.approx(held.mean(), rel=0.005)
            assert without_lonely == pytest.approx(expected, rel=0.02)


def test_cubes_hold_as_many_points_as_asked_for():
    points = scattered(20_000)[0]
    for wanted in (3.0, 7.0, 50.0):
        side = side_for(points, np.ones(3), 4.0, 1e-3, wanted, 1)
        grid = Grid.reaching(np.ones(3), 4.0, side)
        assert len(points) / len(np.unique(grid.keys(points, 1))) == pytest.approx(wanted, rel=0.1)
    assert side_for(points, np.ones(3), 4.0, 0.5, 7.0, 1) == 0.5
    assert side_for(points[:5], np.ones(3), 4.0, 0.5, 7.0, 1) >= 8.0


@pytest.mark.parametrize("share", [0.05, 0.2, 1.0])
def test_lonely_points_do_not_make_cubes_wider(share):
    points = scattered(20_000)[0]
    lonely = np.random.default_rng(1).uniform(-60, 60, (int(share * len(points)), 3))
    both = np.vstack((points, lonely))
    alone, together = (side_for(each, np.ones(3), 105.0, 1e-3, 7.0, 1) for each in (points, both))
    assert together == pytest.approx(alone, rel=0.1)


def test_cubes_hold_their_points_and_moments(cloud):
    points = scattered()[0]
    assert_allclose(cloud.positions() + cloud.centre, points[cloud.rows], atol=1e-6)
    for cube in range(0, len(cloud.cubes), 7):
        mine = cloud.rows[cloud.starts[cube] : cloud.starts[cube + 1]]
        expected = row_of(points[mine] - cloud.centre, 1 / SIGMA**2)
        assert_allclose(cloud.nodes[cube], expected, rtol=1e-6, atol=1e-6)


def test_normals_are_eigenvectors():
    rng = np.random.default_rng(0)
    rows = np.array([row_of(rng.normal(size=(9, 3)) @ rng.normal(size=(3, 3))) for _ in range(50)])
    rows_of.write_normals(rows)
    for row in rows:
        axis = np.linalg.eigh(matrix(row))[1][:, 0]
        assert abs(axis @ row[rows_of.NX : rows_of.NZ + 1]) == pytest.approx(1, abs=1e-9)


def test_normals_of_flat_collinear_and_equal_points_are_unit_vectors():
    flat = np.random.default_rng(0).uniform(size=(9, 3)) * [1, 1, 0]
    line = np.outer(np.arange(5.0), [1, 2, 3])
    rows = np.array([row_of(flat), row_of(line), row_of(np.ones((4, 3)))])
    rows_of.write_normals(rows)
    assert_allclose(np.linalg.norm(rows[:, rows_of.NX : rows_of.NZ + 1], axis=1), 1)
    assert_allclose(np.abs(rows[0, rows_of.NX : rows_of.NZ + 1]), [0, 0, 1], atol=1e-7)


def compared(a, b, wander, offset_prior, slope_prior):
    """Oracle of `compare`: offset and slopes of two planes in the frame of the larger."""
    if a[rows_of.AREA] > b[rows_of.AREA]:
        a, b = b, a
    n = b[rows_of.NX : rows_of.NZ + 1]
    m = a[rows_of.NX : rows_of.NZ + 1] * np.sign(a[rows_of.NX : rows_of.NZ + 1] @ n)
    if m @ n < 0.5:
        return rows_of.APART, 0.0
    inside = np.linalg.svd(n[None])[2][1:]
    ca, cb = a[rows_of.CX : rows_of.CZ + 1], b[rows_of.CX : rows_of.CZ + 1]
    apart = inside @ (ca - cb)
    small, large = np.sqrt(a[rows_of.AREA]), np.sqrt(b[rows_of.AREA])
    far = np.linalg.norm(apart)
    step = 0.5 * min(small, far) / (far + 1e-12)
    meet = cb + (1 - step) * apart @ inside

    def height(row, normal):
        """Of a plane over the meeting point along n, its gradient, and covariance of both."""
        centre = row[rows_of.CX : rows_of.CZ + 1]
        slope = -(inside @ normal) / (normal @ n)
        centroid = n @ (centre - meet)
        x = inside @ (meet - centre)
        jacobian = np.vstack(([1, *x], [0, 1, 0], [0, 0, 1]))
        own = np.zeros((3, 3))
        own[0, 0] = 1 / row[rows_of.WEIGHT]
        own[1:, 1:] = np.linalg.inv(inside @ matrix(row) @ inside.T)
        return np.array([centroid + slope @ x, *slope]), jacobian @ own @ jacobian.T

    (ta, va), (tb, vb) = height(a, m), height(b, n)
    gap = max(far - 0.75 * (small + large), 0)
    drift, lean = wander
    bend = lean + drift * (0.9 / small + 0.3 / large)
    offset = drift * (0.13 * large + gap) + lean * (large / 12) ** 2
    c = va + vb + np.diag([offset, bend, bend])
    delta = ta - tb
    prior = np.diag([offset_prior, slope_prior, slope_prior])
    evidence = 0.5 * math.log(np.linalg.det(c + prior) / np.linalg.det(c))
    return delta @ np.linalg.solve(c, delta), evidence


def test_comparing_is_a_difference_of_planes_over_its_covariance():
    rng = np.random.default_rng(0)
    for _ in range(30):
        a = plane_row(rng, rng.uniform(-1, 1, 3), rng.normal(size=3), 0.3)
        normal = a[rows_of.NX : rows_of.NZ + 1] + rng.normal(0, 0.2, 3)
        b = plane_row(rng, rng.uniform(-1, 1, 3), normal, rng.uniform(0.2, 0.8))
        for wander in ((0.0, 0.0), (1e-5, 0.0), (1e-5, 1e-5)):
            found = rows_of.compare(np.array([a, b]), 0, 1, wander, 0.04, 1.0)
            assert_allclose(found, compared(a, b, wander, 0.04, 1.0), rtol=1e-6)
    across = [plane_row(rng, (0, 0, 0), axis, 0.3) for axis in ((1, 0, 0), (0, 1, 0))]
    assert rows_of.compare(np.array(across), 0, 1, (0.0, 0.0), 1.0, 1.0) == (rows_of.APART, 0.0)


def test_discord_of_patches_of_one_plane_is_chi_square_of_three():
    rng = np.random.default_rng(1)
    found = []
    for _ in range(400):
        a = plane_row(rng, (0, 0, 0), (0, 0, 1), 0.5)
        b = plane_row(rng, (0.5, 0.1, 0), (0, 0, 1), 0.4)
        found.append(rows_of.compare(np.array([a, b]), 0, 1, (0.0, 0.0), 1.0, 1.0)[0])
    assert np.mean(found) == pytest.approx(3, abs=0.4)
    assert np.var(found) == pytest.approx(6, rel=0.4)


def test_cells_are_cubes_that_tell_a_plane(cloud):
    cells = cells_of(cloud)
    assert 1.0 <= cells.error.white < 1.3
    tilts = []
    for cell in range(len(cells.rows)):
        row = cells.rows[cell]
        assert row[rows_of.COUNT] >= 6
        values = np.linalg.eigvalsh(matrix(row))
        # The scatter across is gone, what is left tells slopes to a quarter of a radian, but for
        # what the cube cuts.
        assert values[0] == pytest.approx(0, abs=1e-6 * values[2])
        cut = rows_of.CUT * (cells.error.white * SIGMA**2 / row[rows_of.AREA]) ** 2
        assert 1 / values[1] < 0.07 + 1.2 * cut
        tilts.append(np.abs(row[rows_of.NX : rows_of.NZ + 1]).max())
    assert np.median(tilts) > 0.99
    held = np.diff(cloud.starts)[cells.owner >= 0].sum()
    assert held == cells.rows[:, rows_of.COUNT].sum()
    assert held > 0.9 * len(cloud.local)


def test_neighbours_are_cells_side_by_side_on_a_surface(cloud):
    cells = cells_of(cloud)
    u, v = cells.ends.T
    assert (u != v).all()
    assert len(u) > 2 * len(cells.rows)
    centroids = cells.rows[:, rows_of.CX : rows_of.CZ + 1]
    d = centroids[u] - centroids[v]
    over = np.abs((d * cells.rows[u, rows_of.NX : rows_of.NZ + 1]).sum(axis=1))
    assert (over**2 <= 0.5 * (d * d).sum(axis=1) + 1e-12).all()
    # What the octree says is what a search through all cubes says.
    place = {int(key): k for k, key in enumerate(cloud.cubes)}
    near = np.empty(27, np.int64)
    for cube in range(0, len(cloud.cubes), 11):
        cubes.beside(cloud.cubes, cloud.cubes[cube], 0, (7 * cube) % len(cloud.cubes), near)
        u, v, w = (int(positions(cloud.cubes[cube : cube + 1], axis)[0]) for axis in range(3))
        for direction in range(27):
            i, j, k = direction // 9 - 1, direction // 3 % 3 - 1, direction % 3 - 1
            key = sum(
                int(cloud_keys.spread(x)) << axis for axis, x in enumerate((u + i, v + j, w + k))
            )
            assert near[direction] == cloud.about[cube, direction] == place.get(key, -1)


def test_agglomeration_merges_what_saves_most_first():
    rng = np.random.default_rng(2)
    centres = [(x, y, z) for x in range(4) for y in range(3) for z in (0,)]
    rows = [plane_row(rng, c, (0, 0, 1), 0.9) for c in centres]
    rows += [plane_row(rng, (4, y, 0.5), (1, 0, 1), 0.9) for y in range(3)]
    rows = np.array(rows)
    places = rows[:, rows_of.CX : rows_of.CZ + 1]
    ends = np.array(
        [
            (i, j)
            for i in range(len(rows))
            for j in range(i + 1, len(rows))
            if np.linalg.norm(places[i] - places[j]) < 1.4
        ],
        np.int32,
    )
    wander, prior, most = (1e-6, 1e-6), (4.0, 1.0, 0.0), 25.0
    discords, evidence = np.empty((2, len(ends)))
    segments.value_pairs(rows, ends, wander, prior, 0, len(ends), discords, evidence)
    root = np.empty(len(rows), np.int64)

    def merge(waits):
        merged, boundary = rows.copy(), np.full(len(ends), 0.5)
        values = discords.copy(), evidence.copy(), boundary
        segments.agglomerate(ends.copy(), *values, merged, wander, prior, most, waits, root)
        return merged, {tuple(np.flatnonzero(root == r)) for r in np.unique(root)}

    waits = np.zeros(len(rows), np.bool_)
    waits[13] = True
    _, groups = merge(waits)
    assert groups == {tuple(range(12)), (12,), (13,), (14,)}  # both would merge with it first
    assert np.flatnonzero(waits).tolist() == [12, 13, 14]
    merged, groups = merge(np.zeros(len(rows), np.bool_))
    assert groups == {tuple(range(12)), (12, 13, 14)}
    whole = merged[root[0]]
    assert whole[rows_of.COUNT] == rows[:12, rows_of.COUNT].sum()
    weight = rows[:12, rows_of.WEIGHT]
    assert_allclose(
        whole[rows_of.CX : rows_of.CZ + 1], weight @ places[:12] / weight.sum(), atol=1e-9
    )


def test_cells_of_one_cube_that_are_clearly_one_plane_are_joined():
    rng = np.random.default_rng(4)
    rows = [plane_row(rng, (x, y, 0), (0, 0, 1), 0.9) for y in range(2) for x in range(2)]
    rows += [
        plane_row(rng, (0.0, 0, 5), (0, 0, 1), 0.9),
        plane_row(rng, (1.0, 0, 5), (0, 1, 1), 0.9),
    ]
    rows += [
        plane_row(rng, (0.0, 0, 9), (0, 0, 1), 0.9),
        plane_row(rng, (0, 0, 9.3), (0, 0, 1), 0.9),
    ]
    rows, keys = np.array(rows), np.array([0, 1, 2, 3, 8, 9, 16, 20], np.uint64)
    for bounds in ((0, 8), (0, 2, 8), (0, 5, 6, 8)):  # whatever the parts
        joined, root = rows.copy(), np.full(8, -1)
        for first, last in pairwise(bounds):
            segments.join_siblings(keys, joined, (1e-6, 0.0), 12.0, first, last, root)
        # Another slope and what lies over another are no part of it.
        assert_array_equal(root, [0, 0, 0, 0, 4, 5, 6, 7])
        assert joined[0, rows_of.COUNT] == rows[:4, rows_of.COUNT].sum()
        assert joined[0, rows_of.MISFIT] > 0
        weight = rows[:4, rows_of.WEIGHT]
        centre = weight @ rows[:4, rows_of.CX : rows_of.CZ + 1] / weight.sum()
        assert_allclose(joined[0, rows_of.CX : rows_of.CZ + 1], centre, atol=1e-12)
        assert_array_equal(joined[4:], rows[4:])


def test_parts_of_a_surface_are_added_to_the_first_of_them():
    rng = np.random.default_rng(6)
    rows = np.array([plane_row(rng, (x, 0.3 * x, 0), (0.1 * x, 0, 1), 0.9) for x in range(6)])
    joined, part = rows.copy(), np.array([0, 1, 0, 3, 1, 0])
    segments.join_parts(joined, part)
    for first in (0, 1, 3):
        mine = rows[part == first]
        weight, at = mine[:, rows_of.WEIGHT], mine[:, rows_of.CX : rows_of.CZ + 1]
        centre = weight @ at / weight.sum()
        off = at - centre
        i, j = np.triu_indices(3)
        scatter = mine[:, rows_of.XX : rows_of.ZZ + 1].sum(axis=0) + weight @ (
            off[:, i] * off[:, j]
        )
        out = joined[first]
        assert_allclose(out[rows_of.CX : rows_of.CZ + 1], centre, atol=1e-12)
        assert_allclose(out[rows_of.XX : rows_of.ZZ + 1], scatter, rtol=1e-9)
        for entry in (rows_of.COUNT, rows_of.AREA, rows_of.FREE, rows_of.MISFIT, rows_of.CELLS):
            assert out[entry] == pytest.approx(mine[:, entry].sum())
        matrix = np.empty((3, 3))
        matrix[i, j] = matrix[j, i] = scatter
        normal = np.linalg.eigh(matrix)[1][:, 0]
        assert abs(normal @ out[rows_of.NX : rows_of.NZ + 1]) == pytest.approx(1.0)


def test_pairs_are_kept_once_where_they_come_first():
    rng = np.random.default_rng(5)
    ends = rng.integers(0, 12, (200, 2)).astype(np.int32)
    ends = ends[ends[:, 0] != ends[:, 1]]
    values = rng.uniform(1, 2, len(ends))
    expected = {}
    for pair, value in zip(np.sort(ends, axis=1).tolist(), values, strict=True):
        expected[tuple(pair)] = expected.get(tuple(pair), 0.0) + value
    kept, sums = ends.copy(), values.copy()
    found = loops_of_pairs.pairs_once(kept, sums, 12)
    assert [tuple(sorted(pair)) for pair in kept[:found].tolist()] == list(expected)
    assert_allclose(sums[:found], list(expected.values()), rtol=1e-12)

    part_of = rng.integers(0, 4, 12)
    out, left = np.empty_like(ends), np.empty(len(ends))
    found = loops_of_pairs.pairs_between(ends, values, part_of, out, left)
    apart = part_of[ends[:, 0]] != part_of[ends[:, 1]]
    assert_array_equal(out[:found], part_of[ends[apart]])
    assert_array_equal(left[:found], values[apart])


def test_correlation_of_neighbours_is_that_of_the_pairs_on_each_plane(cloud):
    cells = cells_of(cloud)
    rng = np.random.default_rng(6)
    plane_of = rng.integers(-1, 3, len(cells.rows))
    planes = np.column_stack((np.eye(3), rng.normal(0, 1, 3)))
    off = np.array([planes[j, :3] @ row[rows_of.CX : rows_of.CZ + 1] + planes[j, 3]
                    for j, row in zip(plane_of, cells.rows, strict=True)])  # fmt: skip
    off *= np.sqrt(cells.rows[:, rows_of.WEIGHT])
    found = residual_correlation(cells, plane_of, planes)
    for j in range(3):
        u, v = cells.ends[(plane_of[cells.ends] == j).all(axis=1)].T
        side = cells.sides[(plane_of[cells.ends] == j).all(axis=1)]
        mean = 0.5 * (off[u] ** 2 + off[v] ** 2)
        assert found[j] == pytest.approx(side @ (off[u] * off[v]) / (side @ mean), rel=1e-5)


def test_residuals_of_groups_are_those_of_their_points(cloud):
    labels = scattered()[1][cloud.rows].astype(np.uint16)
    planes = np.column_stack((np.eye(3)[[2, 0, 1]], np.eye(3)[[2, 0, 1]] @ cloud.centre))
    groups, sums = groups_of(cloud, labels, CloudError(1.0, 0.0)), np.zeros((3, 5))
    nats.add_residuals(groups.rows, groups.label, planes, sums)
    points = cloud.positions()
    for j in range(3):
        mine = points[labels == j + 1]
        off = mine @ planes[j, :3] + planes[j, 3]
        # Squares are over the variance that groups are weighed with.
        expected = [len(mine), off @ off, *mine.sum(axis=0)]
        assert_allclose(sums[j], expected, rtol=1e-4, atol=1e-3)


def test_covariance_of_planes_is_that_of_their_offset_and_slopes():
    rng = np.random.default_rng(7)
    rows = np.array(
        [plane_row(rng, rng.uniform(-1, 1, 3), rng.normal(size=3), 0.5) for _ in range(5)]
    )
    centre = np.array([1.0, -2.0, 3.0])
    for row, found in zip(rows, covariances(rows, centre), strict=True):
        values, axes = np.linalg.eigh(matrix(row))
        at, inside = row[rows_of.CX : rows_of.CZ + 1] + centre, axes[:, 1:]
        # n = n0 - e s - f t; d = -n . c - offset
        jacobian = np.zeros((4, 3))
        jacobian[:3, 1:], jacobian[3] = -inside, [-1, *(at @ inside)]
        variances = np.diag([1 / row[rows_of.WEIGHT], *(1 / values[1:])])
        assert_allclose(found, jacobian @ variances @ jacobian.T, rtol=1e-9, atol=1e-18)


def test_points_in_a_line_leave_the_covariance_open():
    row = plane_row(np.random.default_rng(7), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.5)
    row[rows_of.XX : rows_of.ZZ + 1] = [9.0, 12.0, 0.0, 16.0, 0.0, 1e-30]
    assert np.isnan(covariances(row[None], np.full(3, 1e5))).all()


def test_border_prices_fall_with_discord():
    rng = np.random.default_rng(0)
    rows = np.array([plane_row(rng, (x, 0, 0.01 * x), (0, 0, 1), 0.9) for x in range(4)])
    rows = np.vstack((rows, plane_row(rng, (4, 0, 0), (1, 0, 0), 0.9)))
    ends = np.array([(0, 1), (1, 0), (0, 2), (2, 3), (3, 4)], np.int32)
    sides = np.array([2.0, 1.0, 2.0, 3.0, 1.0], np.float32)
    saved, price = np.empty((2, 5))
    merge, plane = (0.7, 2.0, 8.0), (0.01, 1.25, 20.0)
    segments.border_prices(rows, ends, sides, (1e-6, 0.0), merge, plane, 0, 5, saved, price)
    discords = np.array([compared(rows[u], rows[v], (1e-6, 0.0), 1.0, 1.0)[0] for u, v in ends])
    for (low, high, knee), found in ((merge, saved), (plane, price)):
        expected = sides * (low + (high - low) / (1 + (discords / knee) ** 2))
        assert_allclose(found, expected, rtol=1e-6)
    assert discords[-1] == rows_of.APART


def labelled(cloud, label_of, planes, null, resolution, following=None, rounds=2):
    """Oracle of `label_points`; following: its cells, owner and follow."""
    points = cloud.positions()
    grid = np.column_stack([positions(cloud.cubes, axis) for axis in range(3)])
    held, middle = np.diff(cloud.starts), (points - cloud.local)[cloud.starts[:-1]]
    out = np.zeros(len(points), int)
    for cube in range(len(grid)):
        for level in range(3):
            coarse = np.floor(grid / 2**level)
            near = np.flatnonzero(np.abs(coarse - coarse[cube]).max(axis=1) <= 1)
            if level:  # of each cube of this level, the first one stands for it
                _, first = np.unique(coarse[near], axis=0, return_index=True)
                itself = (coarse[near[first]] == coarse[cube]).all(axis=1)
                near = np.append(near[first][~itself], cube)
            if label_of[near].any():
                break
        shares = np.bincount(label_of[near], held[near], len(planes) + 1)
        labels = np.flatnonzero(shares[1:]) + 1
        if not len(labels):
            continue
        shares += 0.5
        total = shares[0] + shares[labels].sum()
        mine = slice(cloud.starts[cube], cloud.starts[cube + 1])
        variance = cloud.variance[cube]
        cost = [np.full(held[cube], null)]
        for label in labels:
            normal, distance = planes[label - 1, :3], planes[label - 1, 3]
            delta = points[mine] @ normal + distance
            if following is not None and following[2][label]:
                cells, owner, follow = following
                there = near[label_of[near] == label]
                at, row, normals = (
                    middle[cube],
                    cells[owner[there]],
                    slice(rows_of.NX, rows_of.NZ + 1),
                )
                over = ((at - row[:, rows_of.CX : rows_of.CZ + 1]) * row[:, normals]).sum(axis=1)
                heights = at @ normal + distance - over * np.sign(row[:, normals] @ normal)
                delta -= follow[label] * np.average(heights, weights=held[there])
            rest = 0.5 * math.log(2 * math.pi * variance / resolution**2)
            cost.append(delta**2 / (2 * variance) + rest)
        states, cost = np.array([0, *labels]), np.transpose(cost)
        share = shares[states] / total
        chosen = np.argmin(cost - np.log(share), axis=1)
        if len(set(chosen)) > 1:
            eighth = (cloud.local[mine] @ cloud_keys.TURN.T > 0) @ [4, 2, 1]
            beside = (eighth[:, None] == eighth) & ~np.eye(held[cube], dtype=bool)
            for _ in range(rounds):
                others = beside @ np.eye(len(states))[chosen] + share
                others[:, 0] = 0.0
                near = (1.0 - share[0]) * others / others.sum(axis=1, keepdims=True)
                near[:, 0] = share[0]
                chosen = np.argmin(cost - np.log(near), axis=1)
        out[mine] = states[chosen]
    return out


@pytest.mark.parametrize("lonely", [0.0, 0.98])
@pytest.mark.parametrize("follow", [(0, 0, 0, 0), (0, 0.5, 0.9, 0)])
def test_labels_follow_residual_and_surroundings(cloud, follow, lonely):
    truth = scattered()[1][cloud.rows]
    runs = zip(cloud.starts[:-1], cloud.starts[1:], strict=True)
    majority = np.array([np.bincount(truth[a:b]).argmax() for a, b in runs])
    planes = np.column_stack((np.eye(3)[[2, 0, 1]], np.eye(3)[[2, 0, 1]] @ cloud.centre))
    follow, rng = np.array(follow, float), np.random.default_rng(0)
    owner = rng.permutation(len(majority))  # a cell for every cube, through one of its points
    cells = np.zeros((len(owner), rows_of.ROW))
    sign = rng.choice((-1.0, 1.0), len(owner))[:, None]
    normal = planes[majority - 1, :3] + rng.normal(0, 0.05, (len(owner), 3))
    cells[owner, rows_of.NX : rows_of.NZ + 1] = sign * normal
    at = cloud.positions()[cloud.starts[:-1]] + 4.0 * SIGMA * normal
    cells[owner, rows_of.CX : rows_of.CZ + 1] = at
    label_of = np.where(rng.random(len(majority)) < lonely, 0, majority)
    labels = np.empty(len(truth), np.uint16)
    null = math.log(1e4)
    label_loops.label_points(
        cloud.local, cloud.starts, cloud.cubes, cloud.side, cloud.grid.middle,
        cloud_keys.TURN, cloud.about, label_of, cells, owner, follow, cloud.variance, np.zeros(4),
        planes, null, 0.001, 0.0, 0, len(cloud.cubes), labels,
    )  # fmt: skip
    told, following = (cloud, label_of, planes, null, 0.001), (cells, owner, follow)
    assert (labels != labelled(*told, following)).mean() < 1e-3  # float32 and 64, at equal costs
    if lonely:  # cubes that are not, where points are told apart once more, are few
        return
    assert (labels != labelled(*told, following, rounds=0)).mean() > 3e-3
    if follow.any():
        assert (labels != labelled(*told)).mean() > 0.01
    else:
        assert (labels == truth).mean() > 0.95


def test_points_of_cells_that_are_on_other_planes_are_counted(cloud):
    rng = np.random.default_rng(5)
    label_of, labels = rng.integers(0, 4, len(cloud.cubes)), rng.integers(0, 4, len(cloud.rows))
    points, half = np.zeros((4, 2), np.int64), len(cloud.cubes) // 2
    for first, last in ((0, half), (half, len(cloud.cubes))):
        label_loops.count_lost(
            labels.astype(np.uint16), cloud.starts, label_of, first, last, points
        )
    mine = np.repeat(label_of, np.diff(cloud.starts))
    for label in (1, 2, 3):
        there = labels[mine == label]
        assert_array_equal(points[label], (len(there), ((there != 0) & (there != label)).sum()))
    assert not points[0].any()


def test_groups_are_the_points_of_one_label_in_a_cube(cloud):
    labels = scattered()[1][cloud.rows].astype(np.uint16)
    groups = groups_of(cloud, labels, CloudError(1.5, 0.0))
    points = cloud.positions()
    g = 0
    for cube in range(len(cloud.cubes)):
        mine = np.arange(cloud.starts[cube], cloud.starts[cube + 1])
        for label in dict.fromkeys(labels[mine]):
            chosen = points[mine[labels[mine] == label]]
            assert groups.label[g] == label
            expected = row_of(chosen, 1 / (1.5 * SIGMA**2))
            assert_allclose(groups.rows[g], expected, rtol=1e-5, atol=1e-4)
            g += 1
    assert g == len(groups.label)


def test_nats_of_groups_are_those_of_normal_densities():
    rng = np.random.default_rng(3)
    points = patch(rng, (0.3, 0.2, 0.1), (0.2, -0.1, 1.0), 0.3, 12)
    row = row_of(points, 1 / SIGMA**2)
    plane = np.array([0.0, 0.0, 1.0, -0.1])
    shared, drift, lean, side, eps, wide = 0.09, 1e-5, 2e-6, 0.25, 0.001, 4e-6
    offset, tilt = shared * SIGMA**2 + wide, 0.9 * drift / side + lean
    tilt += rows_of.CUT * (SIGMA / side) ** 4
    prior = (1.0, 9.2, 9.2)
    alone, data = np.empty((2, 1))
    nats.groups_alone(row[None], eps, prior, 0, 1, alone)
    nats.group_data(
        row[None], np.ones(1, np.int64), alone, np.array([[*plane, wide]]),
        (shared, drift, lean), side, eps, 9.2, 0, 1, data,
    )  # fmt: skip

    def code(residual, design, variances):
        """-ln of the density of residuals, times eps a point."""
        c = SIGMA**2 * np.eye(12) + design @ np.diag(variances) @ design.T
        quadratic = residual @ np.linalg.solve(c, residual)
        return 0.5 * (quadratic + np.linalg.slogdet(2 * np.pi * c / eps**2)[1])

    inside = points - points.mean(axis=0)
    design = np.column_stack((np.ones(12), inside[:, 0], inside[:, 1]))
    residual = points @ plane[:3] + plane[3]
    on = math.log(2) + code(residual, design, [offset, tilt, tilt])
    # Residuals count across the tilted plane.
    c = SIGMA**2 * np.eye(12) + tilt * inside[:, :2] @ inside[:, :2].T
    within = np.linalg.solve(c, residual - residual.mean())
    slopes = tilt * inside[:, :2].T @ within
    turned = (residual - residual.mean()) @ within
    on += 0.5 * turned * (1 / (1 + slopes @ slopes) - 1)
    values = np.linalg.eigvalsh(matrix(row))
    # On none: about its own plane, whose slopes a broad prior has paid for.
    white = 12 * 0.5 * math.log(2 * math.pi * SIGMA**2 / eps**2)
    broad = 0.5 * (values[0] + np.log1p(values[1:]).sum())
    none = math.log(2) + min(9.2 + white + broad, 12 * 9.2)
    assert alone[0] == pytest.approx(none, rel=1e-9)
    assert data[0] == pytest.approx(
        -np.logaddexp(math.log(0.95) - on, math.log(0.05) - none), rel=1e-9
    )


def coded(cloud, labels, planes):
    """Oracle of `mask_lengths`: labels coded one after the other, counts learned on the way."""
    grid = np.column_stack([positions(cloud.cubes, axis) for axis in range(3)]).astype(int)
    place = {tuple(g): k for k, g in enumerate(grid)}
    seen = np.zeros((CONTEXTS, SYMBOLS))
    total, previous = 0.0, 0
    for cube, (u, v, w) in enumerate(grid):
        beside = [place.get(g) for g in ((u - 1, v, w), (u, v - 1, w), (u, v, w - 1))]
        beside = [None if b is None else labels[cloud.starts[b + 1] - 1] for b in beside]
        for label in labels[cloud.starts[cube] : cloud.starts[cube + 1]]:
            near = [previous, *(previous if b is None else b for b in beside)]
            context, symbol = divmod(_code(*map(int, near), int(label)), SYMBOLS)
            distinct = len(set(near))
            symbols = distinct + (planes >= distinct)
            share = (seen[context, symbol] + PRIOR) / (seen[context].sum() + PRIOR * symbols)
            total -= math.log(share)
            if symbol == NONE:
                total += math.log(planes + 1 - distinct)
            seen[context, symbol] += 1
            previous = label
    return total


def test_the_mask_is_coded_in_order_for_every_number_of_planes(cloud):
    labels = scattered()[1][cloud.rows].astype(np.uint16)
    place = np.array([0, 2, 3, 1])
    lengths = np.empty(4)
    changes = np.zeros((4, CODES), np.int64)
    alike, previous, middle = np.zeros(4, np.int64), 0, len(cloud.cubes) // 2
    edges = [np.empty((len(labels), 6), np.int32) for _ in range(2)]
    for k, part in enumerate(((0, middle), (middle, len(cloud.cubes)))):
        found, previous = cloud_masks.mask_edges(
            labels, cloud.starts, cloud.about, *part, previous, alike, edges[k]
        )
        edges[k] = edges[k][:found]
    cloud_masks.mask_lengths(np.concatenate(edges), alike, place, changes, lengths)
    ranked = place[labels]
    for n in range(4):
        expected = coded(cloud, np.where(ranked <= n, ranked, 0), n)
        assert lengths[n] == pytest.approx(expected, rel=1e-9)


def test_what_groups_have_more_without_a_plane(cloud):
    labels = scattered()[1][cloud.rows].astype(np.uint16)
    error = CloudError(1.0, 1e-6)
    planes = np.column_stack((np.eye(3)[[2, 0, 1]], np.eye(3)[[2, 0, 1]] @ cloud.centre))
    place, limits = np.array([0, 2, 3, 1]), (10.0, 0.001)

    def total(kept):
        left = np.where(place[labels] <= kept, labels, 0).astype(np.uint16)
        groups = groups_of(cloud, left, error)
        alone = alone_of(cloud, groups, *limits)
        return data_of(cloud, groups, alone, planes, np.ones(3), error, *limits)

    groups = groups_of(cloud, labels, error)
    alone = alone_of(cloud, groups, *limits)
    data = data_of(cloud, groups, alone, planes, np.ones(3), error, *limits)
    left = np.empty(len(data))
    prior = (1.0, math.log(1e4), math.log(1e4))
    nats.groups_left(
        groups.rows, groups.label, groups.places, place, 0.001, prior, alone, data, 0,
        len(cloud.cubes), left,
    )  # fmt: skip
    behind = np.bincount(groups.label, left)[[3, 1, 2]]  # in the order of their places
    for kept in range(4):
        assert data.sum() + behind[kept:].sum() == pytest.approx(total(kept).sum(), rel=1e-6)
