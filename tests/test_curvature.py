"""Pieces of curved surfaces in depth images are no planes; what meets in edges is."""

import numpy as np
import pytest
from benchmarks import curved_frames
from numpy.testing import assert_allclose

import planewise as pw
from planewise.kernels.cells import COUNT, SEGMENT, UNIT
from planewise.kernels.curvature import BENT, CENTRE, EXTENT, QUADRIC, SIZE, C, quadrics_of
from planewise.kernels.quadrics import FLAT, PARTLY

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


@pytest.mark.parametrize("sigma", [0.001, 0.005])
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
    ],
)
def test_what_bends_all_over_the_image_is_no_drift(surface, millimetres):
    assert curved_frames.found(surface, millimetres) == (0, 0)


@pytest.mark.parametrize("surface", ["LiDAR in a tunnel", "LiDAR in a dome"])
@pytest.mark.parametrize("millimetres", [5, 10])
def test_a_lidar_sees_no_planes_in_a_tunnel_or_under_a_dome(surface, millimetres):
    """In each of several sectors what lies of a segment there has a quadric of its own."""
    assert curved_frames.found(surface, millimetres) == (0, 0)


@pytest.mark.parametrize("millimetres", [1, 2, 5])
def test_rims_are_no_fans_of_strips(millimetres):
    """Near the rim of a round thing strips of one or two cells are flat enough to pay."""
    assert curved_frames.found("silo", millimetres)[1] < 0.11


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
    assert quadrics_of(units, np.zeros(40, np.int32), row, np.zeros(1), np.ones(1, bool), quadrics)
    q = quadrics[0]
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
    assert not quadrics_of(
        units, np.zeros(40, np.int32), row, np.zeros(1), np.ones(1, bool), quadrics
    )


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
