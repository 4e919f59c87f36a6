"""Pieces of curved surfaces in depth images are no planes; what meets in edges is."""

import math

import numpy as np
import pytest
from benchmarks import curved_frames
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.kernels.cells import COUNT, SEGMENT, SIDE, UNIT
from planewise.kernels.curvature import (
    APART,
    BENT,
    CENTRE,
    EXTENT,
    INWARD,
    MEET,
    NEAR,
    OUTWARD,
    QUADRIC,
    ROUND,
    SIZE,
    C,
    find_round,
    inner_units,
    leave_out,
    meet,
    quadrics_of,
    surface_borders,
)
from planewise.kernels.quadrics import (
    BENDS,
    FLAT,
    GOES_ON,
    LEFT,
    OWN,
    PARTLY,
    SURE,
    TOLD_U,
    TOLD_V,
    UNTOLD,
)

from . import spatial_oracles as oracles

CAMERA = curved_frames.CAMERA
U, V, _ = np.moveaxis(curved_frames.rays(), -1, 0)


def found(z, sigma, seed=0, **options):
    depth = z + np.random.default_rng(seed).normal(0, sigma, z.shape)
    sensor = pw.Sensor(max_depth=10, resolution=1e-5, noise=sigma)
    return pw.detect_planes(depth, CAMERA, sensor, **options)


def round_room(radius=3.0, floor=1.2):
    """Inside a round tower: wall, and floor below."""
    wall = radius / np.hypot(U, 1)
    with np.errstate(divide="ignore"):
        ground = np.where(V > 0, floor / V, np.inf)
    return np.minimum(wall, ground), ground < wall


def facing(normals, distances):
    """The nearest of planes n . x = d along every ray, and which."""
    with np.errstate(divide="ignore"):
        z = np.stack(
            [d / (n[0] * U + n[1] * V + n[2]) for n, d in zip(normals, distances, strict=True)]
        )
    z = np.where(z > 0, z, np.inf)
    return z.min(axis=0), z.argmin(axis=0)


def polygon(sides, radius=3.0):
    """Inside a tower of so many equal walls, one of them straight ahead."""
    angles = 2 * np.pi * np.arange(sides) / sides
    normals = np.column_stack((np.sin(angles), np.zeros(sides), np.cos(angles)))
    return facing(normals, np.full(sides, radius))


@pytest.mark.parametrize("sigma", [0.0001, 0.001, 0.005])
def test_a_round_wall_is_no_fan_of_planes(sigma):
    z, floor = round_room()
    model = found(z, sigma)
    assert len(model.planes) == 1
    assert (model.labels[floor] == 1).mean() > 0.99
    assert (model.labels[~floor] == 0).mean() > 0.98


@pytest.mark.parametrize("sides", [8, 12, 16])
def test_walls_of_a_tower_with_edges_are_planes(sides):
    z, walls = polygon(sides)
    model = found(z, 0.001)
    assert len(model.planes) == len(np.unique(walls))
    for rank in range(1, len(model.planes) + 1):
        assert np.bincount(walls[model.labels == rank]).max() > 0.97 * (model.labels == rank).sum()


def facets(count, degrees):
    """Flat walls side by side, each turned by so much from the next."""
    turns = np.radians(degrees) * (np.arange(count) - (count - 1) / 2)
    across = np.cos(turns) + np.sin(turns) * U[..., None]
    return 2.5 / across.max(axis=-1), across.argmax(axis=-1)


@pytest.mark.parametrize(("count", "degrees", "seed"), [(4, 4, 1), (6, 6, 5), (8, 6, 0), (8, 6, 8)])
def test_wide_flat_walls_whose_edges_noise_moves_are_not_round(count, degrees, seed):
    z, walls = facets(count, degrees)
    model = found(z, 0.002, seed)
    assert len(model.planes) == count
    assert_array_equal(np.unique(walls[model.labels > 0]), np.arange(count))


@pytest.mark.parametrize("seed", [0, 1, 6])
def test_walls_are_no_curved_surface_for_some_of_them_being_joined(seed):
    """They are where planes may bend more than readings tell, for the sake of mixed pixels."""
    z, walls = facets(8, 6)
    rng, focal_baseline = np.random.default_rng(seed), 525 * 0.075
    disparity = focal_baseline * (1 / z + rng.normal(0, 0.0015, z.shape))
    depth = focal_baseline / (np.round(8 * disparity) / 8)
    model = pw.detect_planes(np.round(1000 * depth).astype(np.uint16), CAMERA, pw.sensors.KINECT_V1)
    assert len(model.planes) == 8
    assert_array_equal(np.unique(walls[model.labels > 0]), np.arange(8))


def test_a_ball_is_no_plane_and_the_wall_behind_it_is():
    ball = curved_frames.sphere((0, 0, 2.5), 1.0, curved_frames.rays())
    model = found(np.minimum(ball, 4.0), 0.005)
    assert len(model.planes) == 1
    assert (model.labels[np.isfinite(ball)] == 0).mean() > 0.98


@pytest.mark.parametrize(
    ("surface", "millimetres"),
    [
        ("ball of 1.5 m", 10),
        ("ball of 1.5 m", 20),
        ("dome, inside", 2),
        ("dome, inside", 10),
        ("bowl", 5),
        ("waves", 1),
        ("waves", 5),
        ("waves", 10),
        ("silo", 1),
        ("silo", 2),
        ("silo", 5),
        ("tank", 2),
    ],
)
def test_what_bends_all_over_the_image_is_no_drift(surface, millimetres):
    assert curved_frames.found(surface, millimetres) == (0, 0)


@pytest.mark.parametrize("surface", ["LiDAR in a tunnel", "LiDAR in a dome"])
@pytest.mark.parametrize("millimetres", [5, 10])
def test_a_lidar_sees_no_planes_in_a_tunnel_or_under_a_dome(surface, millimetres):
    """In each of several sectors what lies of a segment there has a quadric of its own."""
    assert curved_frames.found(surface, millimetres) == (0, 0)


@pytest.mark.parametrize(
    ("surface", "millimetres", "most", "of_it"),
    [("curtain, folds of 20 cm", 1, 3, 0.05), ("curtain, folds of 40 cm", 10, 2, 0.2)],
)
def test_few_folds_of_a_curtain_are_planes(surface, millimetres, most, of_it):
    """There were 121 and fifteen, which held all of it."""
    count, share = curved_frames.found(surface, millimetres)
    assert count <= most
    assert share < of_it


def zigzag(width, degrees):
    """A folded sheet 2 m away, its faces so many pixels wide and at such angles; which they are."""
    width, slope, z = 2 * width / CAMERA.fx, np.tan(np.radians(degrees / 2)), np.full(U.shape, 2.0)
    for _ in range(60):
        place = np.mod(U * z / width, 2)
        z = 2 + slope * width * np.minimum(place, 2 - place)
    return z, np.floor(U * z / width).astype(int)


@pytest.mark.parametrize(("width", "degrees"), [(12, 20), (12, 45), (8, 30), (20, 55)])
def test_faces_of_a_folded_sheet_are_planes(width, degrees):
    """Narrow ones tell no bend, and go on into each other as far as they tell."""
    z, faces = zigzag(width, degrees)
    labels = found(z, 0.001).labels
    of_face = [labels[faces == face] for face in np.unique(faces)]
    right = [np.bincount(each).argmax() > 0 and (each > 0).mean() > 0.9 for each in of_face]
    assert np.mean(right) > 0.95
    assert len({np.bincount(each).argmax() for each in of_face}) > 0.95 * len(of_face)


def rounded_polygon(sides, fillet, radius=3.0):
    """Depth inside such a tower whose edges are rounded, found by steps of the distance left."""
    angles = 2 * np.pi * np.arange(sides) / sides
    normals = np.column_stack((np.sin(angles), np.cos(angles)))
    across = np.column_stack((normals[:, 1], -normals[:, 0]))
    half, u, z = (radius - fillet) * np.tan(np.pi / sides), U[0], np.zeros(U.shape[1])
    for _ in range(200):
        at = np.column_stack((u * z, z))
        off = at @ normals.T - (radius - fillet)
        side = off.argmax(axis=1)
        beyond = np.maximum(np.abs(np.einsum("ij,ij->i", at, across[side])) - half, 0)
        outside = np.where(off.max(axis=1) > 0, np.hypot(off.max(axis=1), beyond), off.max(axis=1))
        z -= (outside - fillet) / np.hypot(u, 1)
    return np.broadcast_to(z, U.shape)


@pytest.mark.parametrize("fillet", [0.1, 0.2])
@pytest.mark.parametrize("sides", [8, 12])
def test_walls_between_rounded_edges_are_planes(sides, fillet):
    _, walls = polygon(sides)
    model = found(rounded_polygon(sides, fillet), 0.01)
    assert len(model) == len(np.unique(walls))
    for wall in np.unique(walls):
        assert (np.bincount(model.labels[walls == wall]).max() / (walls == wall).sum()) > 0.9


def test_two_walls_with_a_rounded_edge_are_planes():
    """A quarter of a cylinder of 20 cm between walls at right angles."""
    lean = (np.abs(U) + 1) / 3  # w of two walls that meet at 3 m, at 45 degrees
    z, radius = 1 / lean, 0.2
    centre = 3.0 - radius * np.sqrt(2)
    a, b, c = U**2 + 1, -2 * centre, centre**2 - radius**2
    with np.errstate(invalid="ignore"):
        arc = (-b + np.sqrt(b**2 - 4 * a * c)) / (2 * a)
    x = arc * U
    round_part = np.isfinite(arc) & (np.abs(x) < radius / np.sqrt(2))
    model = found(np.where(round_part, arc, z), 0.003)
    for side in (U < -0.15, U > 0.15):
        labels = np.bincount(model.labels[side])
        assert labels.argmax() > 0
        assert labels.max() > 0.97 * side.sum()


def test_a_region_does_not_bring_a_fan_back():
    z, floor = round_room()
    model = found(z, 0.001, partition=(~floor).astype(np.uint16))
    assert (model.labels[~floor] == 0).mean() > 0.98


def units_at(x, y, w, weight):
    """Rows of units that are readings of one weight each."""
    units = np.zeros((x.size, SEGMENT))
    units[:, 0], units[:, 1], units[:, 2], units[:, 6] = weight, weight * x, weight * y, weight * w
    units[:, 3], units[:, 4], units[:, 5] = weight * x**2, weight * x * y, weight * y**2
    units[:, 7], units[:, 8], units[:, COUNT] = weight * x * w, weight * y * w, 36
    return units


def test_quadrics_are_those_of_least_squares():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-1, 1, (2, 40))
    weight = rng.uniform(1e5, 1e6, 40)
    w = 0.5 + 0.02 * x - 0.01 * y + 0.03 * x**2 - 0.02 * x * y + 0.01 * y**2
    w += rng.normal(0, 1e-4, 40)
    units = units_at(x, y, w, weight)
    row, quadrics = units.sum(axis=0)[None], np.empty((1, QUADRIC))
    quadrics_of(units, np.zeros(40, np.int32), row, np.zeros(1), np.ones(1, bool), quadrics)
    q = quadrics[0].copy()
    dx, dy = x - q[CENTRE], y - q[CENTRE + 1]
    terms = np.column_stack((np.ones(40), dx, dy, dx**2, dx * dy, dy**2)) * np.sqrt(weight)[:, None]
    height = w - q[0] - q[1] * x - q[2] * y
    exact = np.linalg.lstsq(terms, height * np.sqrt(weight), rcond=None)[0]
    assert_allclose(q[C : C + 6], exact, rtol=1e-6, atol=1e-9)
    assert_allclose(q[EXTENT], np.sqrt(40 * 36) / UNIT)
    second = np.array([[2 * exact[3], exact[4]], [exact[4], 2 * exact[5]]])
    assert_allclose(q[SIZE], np.linalg.norm(second))
    assert q[BENT] == 1
    units[:, 6] = weight * (0.5 + 0.02 * x - 0.01 * y + rng.normal(0, 1, 40) / np.sqrt(weight))
    row[0, 6:9] = (units[:, 6:7] * np.column_stack((np.ones(40), x, y))).sum(axis=0)
    quadrics_of(units, np.zeros(40, np.int32), row, np.zeros(1), np.ones(1, bool), quadrics)
    assert quadrics[0, BENT] == FLAT


@pytest.mark.parametrize(("columns", "told"), [(1, PARTLY), (2, PARTLY), (3, FLAT)])
def test_cells_side_by_side_do_not_tell_a_bend(columns, told):
    """Centroids of cells lie a little off the middle, for their readings have different weights."""
    rng, rows = np.random.default_rng(columns), 30
    y, x = (0.06 * place.ravel() for place in np.indices((rows, columns)))
    x, y = (place + rng.normal(0, 1e-4, place.size) for place in (x, y))
    weight, w = np.full(x.size, 1e6), 0.5 + 0.1 * x + rng.normal(0, 1e-3, x.size)
    units = units_at(x, y, w, weight)
    row, quadrics = units.sum(axis=0)[None], np.empty((1, QUADRIC))
    quadrics_of(units, np.zeros(x.size, np.int32), row, np.zeros(1), np.ones(1, bool), quadrics)
    assert quadrics[0, BENT] == told
    if told != FLAT:
        assert quadrics[0, C + 3] == 0
    assert quadrics[0, SIZE] < 2


def surfaces(rng, tilted):
    """A grid of units on five planes that may bend at their borders, their segments and sides."""
    rows, columns = np.indices((20, 30)).reshape(2, -1)
    x, y = (SIDE * (axis - 10) / UNIT for axis in (columns, rows))
    seeds = rng.uniform((-0.4, -0.3), (0.6, 0.3), (5, 2))
    of_unit = np.hypot(*(np.stack((x, y), 1)[:, None] - seeds).T).argmin(axis=0).astype(np.int32)
    planes = np.column_stack((np.ones(5), rng.uniform(-0.9, 0.9, (5, 2))))
    slopes = planes[of_unit, 1:] + tilted * rng.normal(0, 1, (600, 2))
    units = np.zeros((600, SEGMENT))
    spread = rng.uniform(0.5, 2, 600) * 1e-4
    centre = planes[of_unit, 0] + planes[of_unit, 1] * x + planes[of_unit, 2] * y
    units[:, 0], units[:, 1], units[:, 2], units[:, COUNT] = 1e6, 1e6 * x, 1e6 * y, 9
    units[:, 3], units[:, 4], units[:, 5] = (
        1e6 * x**2 + 1e6 * spread,
        1e6 * x * y,
        1e6 * y**2 + 2e6 * spread,
    )
    units[:, 6] = 1e6 * centre
    units[:, 7] = 1e6 * (x * centre + spread * slopes[:, 0])
    units[:, 8] = 1e6 * (y * centre + 2 * spread * slopes[:, 1])
    quadrics = np.zeros((5, QUADRIC))
    quadrics[:, :3] = planes
    quadrics[:, EXTENT] = np.sqrt(9 * np.bincount(of_unit, minlength=5)) / UNIT
    grid = np.arange(600, dtype=np.int32).reshape(20, 30)
    sides = [
        (grid[i, j], grid[i + down, j + 1 - down], 2 * grid[i, j] + down)
        for down, i, j, _, _ in oracles.sides(of_unit[grid])
    ]
    *pairs, at = np.array(sides, np.int32).T
    return grid, units, of_unit, quadrics, np.stack(pairs, axis=1), at, slopes, spread


@pytest.mark.parametrize("seed", range(4))
def test_units_with_a_cell_beside_another_segment_or_none_are_not_inner(seed):
    rng = np.random.default_rng(seed)
    blocks = np.arange(80, dtype=np.int32).reshape(8, 10)
    grid = np.kron(blocks, np.ones((2, 2), np.int32))
    alone = rng.permutation(80)[:20]  # cells of these are units of their own
    grid[::2, ::2][np.isin(blocks, alone)] = 80 + np.arange(20)
    grid[rng.random(grid.shape) < 0.02] = -1
    x, y = rng.integers(2, 8, 2)
    of_unit = (2 * (np.arange(100) % 10 >= x) + (np.arange(100) // 10 >= y)).astype(np.int32)
    out = np.empty_like(of_unit)
    inner_units(grid, of_unit, out)
    segments = np.pad(np.where(grid < 0, -1, of_unit[grid]), 1, constant_values=-2)
    for unit, found in enumerate(out):
        near = {
            segments[i + 1 + down, j + 1 + right]
            for i, j in np.argwhere(grid == unit)
            for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0))
        }
        inner = near <= {-2, of_unit[unit]}
        assert found == (of_unit[unit] if inner else -1)
    assert 5 < np.count_nonzero(out < 0) < 95


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("slope", [0.02, 0.2, 2.0])
def test_how_planes_meet(seed, slope):
    _, units, of_unit, quadrics, pairs, *_ = surfaces(np.random.default_rng(seed), 0.0)
    how, turns = np.full((2, len(pairs)), -1, np.int8)
    meet(of_unit[pairs], pairs, units, quadrics, slope, how, turns)
    for (i, j), found, way in zip(pairs, how, turns, strict=True):
        a, b = quadrics[of_unit[[i, j]], :3]
        one, other = units[i, :3] / units[i, 0], units[j, :3] / units[j, 0]
        middle = (one + other) / 2
        apart = abs((a - b) @ middle) > slope * (a @ middle) * np.linalg.norm(one - other)
        normals = [np.array([t[1], t[2], slope * t[0]]) for t in (a, b)]
        cosine = normals[0] @ normals[1] / np.prod(np.linalg.norm(normals, axis=1))
        assert found == (APART if apart else NEAR if cosine > 0.5 else MEET)
        inward = (b - a)[1:] @ (other - one)[1:] > 0
        clear = found == NEAR and cosine < math.cos(math.radians(4))
        assert way == (clear and (INWARD if inward else OUTWARD))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("wraps", [False, True])
def test_where_cells_turn_less_than_their_planes_there_is_no_edge(seed, wraps):
    rng = np.random.default_rng(seed)
    grid, units, of_unit, quadrics, pairs, at, slopes, spread = surfaces(rng, 0.5)
    planes, ends = quadrics[:, 1:3], of_unit[pairs]
    # Half of the borders have an edge that is rounded all over: cells lie half-way.
    smooth = rng.random((5, 5)) < 0.5
    for i, j in pairs[smooth[tuple(np.sort(ends, axis=1).T)]]:
        slopes[[i, j]] = planes[of_unit[[i, j]]].mean(axis=0)
    x, y = (units[:, e] / units[:, 0] for e in (1, 2))
    centre = units[:, 6] / units[:, 0]
    units[:, 7] = 1e6 * (x * centre + spread * slopes[:, 0])
    units[:, 8] = 1e6 * (y * centre + 2 * spread * slopes[:, 1])
    how = np.where(rng.random(len(pairs)) < 0.9, NEAR, MEET).astype(np.int8)
    chosen, before = np.array([True, True, True, True, False]), how.copy()
    find_round(ends, at, grid, of_unit, units, quadrics, chosen, wraps, how)

    width = 2 * 9 * np.bincount(of_unit) / (SIDE * np.bincount(ends.ravel()))
    into = (0.1 * width / SIDE).astype(int)
    turns = {}
    for (u, v), place, usable in zip(ends, at, before == NEAR, strict=True):
        step = np.array([1, 0] if place & 1 else [0, 1])
        cell = np.array(np.divmod(place >> 1, 30))
        both = cell - into[u] * step, cell + (1 + into[v]) * step
        if wraps:
            both = [(i, j % 30) for i, j in both]
        if not usable or not chosen[[u, v]].all():
            continue
        of_pair = turns.setdefault((min(u, v), max(u, v)), [])
        if all(0 <= i < 20 and 0 <= j < 30 for i, j in both):
            i, j = (grid[tuple(each)] for each in both)
            if of_unit[i] == u and of_unit[j] == v:
                turn = planes[u] - planes[v]
                precision = 1e6 * spread[[i, j]] * np.array([[1.0], [2.0]])
                variance = (turn**2 @ (1 / precision)).sum() / (turn @ turn) ** 2
                of_pair.append(((slopes[i] - slopes[j]) @ turn / (turn @ turn), variance))
    round_ones = set()
    for pair, of_pair in turns.items():
        if of_pair:
            ratio, weight = np.array(of_pair).T[0], 1 / np.array(of_pair).T[1]
            mean = (weight * ratio).sum() / weight.sum()
            if mean + 2 * np.sqrt(2 / weight.sum()) < 0.5:
                round_ones.add(pair)
    expected = [
        ROUND if (min(e), max(e)) in round_ones and b == NEAR else b
        for e, b in zip(ends, before, strict=True)
    ]
    assert_array_equal(how, expected)
    if seed == 0:
        assert 0 < len(round_ones) < len(turns)


@pytest.mark.parametrize("seed", range(6))
def test_where_surfaces_go_on(seed):
    rng = np.random.default_rng(seed)
    _, units, _, quadrics, _, _, _, _ = surfaces(rng, 0.0)
    quadrics[:, CENTRE : CENTRE + 2] = rng.uniform(-0.3, 0.3, (5, 2))
    quadrics[:, 1:3] *= 0.3
    quadrics[:, C : C + 3] = rng.uniform(-0.02, 0.02, (5, 3))
    quadrics[:, C + 3 : C + 6] = rng.uniform(-0.1, 0.1, (5, 3))
    quadrics[:, SIZE] = rng.uniform(0, 0.4, 5)
    quadrics[:, BENT] = rng.choice([BENDS, FLAT, PARTLY, UNTOLD], 5)
    segment = np.array([0, 1, 2, 3, 3])
    ends = np.array([rng.permutation(5)[:2] for _ in range(200)], np.int32)
    sides, how = rng.integers(0, 600, (200, 2)).astype(np.int32), rng.integers(0, 4, 200)
    turns = rng.choice(np.array([0, OUTWARD, INWARD], np.int8), 200)
    told, of_segment = [], np.zeros(4)
    for (u, v), (i, j), beside, way in zip(ends, sides, how, turns, strict=True):
        if beside == APART:
            continue
        np.add.at(of_segment, segment[[u, v]], 1)
        a, b = quadrics[u], quadrics[v]
        x, y = (units[[i, j], 1:3] / units[[i, j], :1]).mean(axis=0)
        turn, extents = np.hypot(*(a - b)[1:3]), a[EXTENT] + b[EXTENT]
        states = GOES_ON | SURE
        if beside == ROUND:
            for q, flag in ((a, TOLD_U), (b, TOLD_V)):
                states |= flag * int(q[BENT] != FLAT or q[SIZE] * extents >= OWN * turn)
        else:
            more = max(a[BENT], b[BENT])
            if more in (FLAT, UNTOLD):
                continue
            states = 0
            for q, flag in ((a, TOLD_U), (b, TOLD_V)):
                enough = q[SIZE] * extents >= OWN * turn
                states |= flag * int(beside == NEAR if q[BENT] < 0 else enough)
            if not states:
                continue
            (over, *one), (under, *other) = surface(a, x, y), surface(b, x, y)
            step = 2 * (over - under) / extents
            if more == PARTLY:
                states |= GOES_ON
            elif np.hypot(np.hypot(*np.subtract(one, other)), step) <= LEFT * turn:
                states |= GOES_ON | SURE
        told.append((*segment[[u, v]], states | way))
    border, pairs = np.full(4, np.nan), np.empty((200, 2), np.int32)
    points, states = np.zeros(200, np.float32), np.empty(200, np.int8)
    found = surface_borders(
        ends, sides, units, quadrics, segment, how.astype(np.int8), turns, border, pairs, points,
        states,
    )  # fmt: skip
    assert_array_equal(np.column_stack((pairs, states))[:found], told)
    assert (points[:found] == 1).all()
    assert_array_equal(border, of_segment)


def surface(q, x, y):
    """w of a quadric at a point, and its slopes."""
    (dx, dy), c = (x, y) - q[CENTRE : CENTRE + 2], q[C : C + 6]
    w = q[:3] @ (1, x, y) + c @ (1, dx, dy, dx**2, dx * dy, dy**2)
    return w, q[1] + c[1] + 2 * c[3] * dx + c[4] * dy, q[2] + c[2] + c[4] * dx + 2 * c[5] * dy


def pillar(radius, distance, noise, wall):
    """Planes of a pillar before a wall, if any, and labels of its pixels."""
    camera = pw.cameras.KINECT_V1
    across = camera.rays((480, 640))[..., 0]
    square = across**2 + 1
    root = distance**2 - square * (distance**2 - radius**2)
    round_one = (distance - np.sqrt(np.maximum(root, 0))) / square
    depth = np.where(root > 0, round_one, wall or np.nan)
    depth += np.random.default_rng(0).normal(0, noise, depth.shape)
    model = pw.detect_planes(depth, camera, pw.Sensor(noise=noise))
    return len(model), model.labels[root > 0]


@pytest.mark.parametrize("radius", [0.2, 0.3])
def test_the_rims_of_a_pillar_before_a_wall_are_no_planes(radius):
    """Between them are pieces that would pay but for their border, which tell that it is round."""
    planes, labels = pillar(radius, 2.0, 0.003, 3.5)
    assert planes == 1
    assert not labels.any()


@pytest.mark.parametrize("wall", [None, 3.5])
@pytest.mark.parametrize(("radius", "distance"), [(0.1, 1.5), (0.2, 2.0)])
def test_a_pillar_is_no_fan_of_strips(radius, distance, wall):
    """All of them are so narrow that none tells how it bends, but they turn one way."""
    planes, labels = pillar(radius, distance, 0.0005, wall)
    assert planes == (wall is not None)
    assert not labels.any()


@given(
    st.lists(
        st.tuples(
            st.integers(0, 7), st.integers(0, 7), st.sampled_from([0, SURE, OUTWARD, INWARD])
        ),
        max_size=12,
    ),
    st.lists(st.integers(0, 2), min_size=8, max_size=8),
)
def test_pairs_and_narrow_ones_alone_are_left_out(sides, kinds):
    """But for narrow ones that all turn one way."""
    together, curved = np.array(kinds) > 0, np.array(kinds) > 1
    groups, within = [{s} for s in range(8)], [s for s in sides if together[list(s[:2])].all()]
    for u, v, _ in within * 8:
        groups[u] |= groups[v]
        groups[v] |= groups[u]
    expected = []
    for s in range(8):
        told = [state for u, _, state in within if u in groups[s]]
        size = together[list(groups[s])].sum()
        one_way = max(map(told.count, (OUTWARD, INWARD))) > 0.9 * len(told)
        expected.append(bool(curved[s] and ((SURE in told and size > 2) or (one_way and size > 3))))
    pairs = np.array([side[:2] for side in sides], np.int32).reshape(-1, 2)
    states = np.array([GOES_ON | side[2] for side in sides], np.int8)
    leave_out(pairs, states, together, curved)
    assert curved.tolist() == expected
    leave_out(pairs, states, together, alone := together.copy())
    leave_out(pairs, states, together, together)  # may be the same array
    assert_array_equal(together, alone)
