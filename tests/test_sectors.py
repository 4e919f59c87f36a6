"""Sectors of a panorama against the geometry and sums that they stand for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.sectors import BLOCK, GAP, SQUARE
from planewise.spatial.frame import frame_of

OFFSETS = tuple(np.linspace(-0.4, 0.4, 20))
CAMERAS = {
    "a turn": pw.SphericalCamera.spinning(np.linspace(40, -30, 20), 187, azimuth_offset=OFFSETS),
    "the other way round": pw.SphericalCamera.spinning(
        np.linspace(-30, 40, 20), 300, start=33, clockwise=False
    ),
    "a hundred degrees": pw.SphericalCamera(
        elevation=np.linspace(10, -10, 20), azimuth=np.linspace(-20, 80, 101)
    ),
    "forty degrees": pw.SphericalCamera(
        elevation=np.linspace(10, -10, 20), azimuth=np.linspace(20, -20, 81)
    ),
}
PLANES = {"a turn": 6, "the other way round": 6, "a hundred degrees": 2, "forty degrees": 1}


@pytest.fixture(params=CAMERAS)
def camera(request):
    return CAMERAS[request.param]


def test_sectors_lie_side_by_side(camera):
    sectors = camera.sectors(camera.shape)
    name = next(name for name, each in CAMERAS.items() if each is camera)
    assert sectors.count == PLANES[name]
    assert_array_equal(sectors.column[sectors.column >= 0], np.arange(camera.shape[1]))
    assert (sectors.start % BLOCK == 0).all()
    assert (sectors.start[1:] - sectors.stop[:-1] >= GAP).all()
    assert ((sectors.stop - sectors.start)[:-1] % SQUARE == 0).all()
    assert sectors.wraps == camera.wraps
    image = np.arange(np.prod(camera.shape)).reshape(camera.shape)
    padded = np.where(sectors.column >= 0, image[:, sectors.column], -1)
    assert_array_equal(sectors.image(padded), image)


def test_inverse_depth_is_affine_in_every_sector(camera):
    """w = theta . (u, v, 1) turned: for any plane, in all pixels that see it."""
    sectors, rng = camera.sectors(camera.shape), np.random.default_rng(0)
    shown = sectors.column.copy()
    shown[sectors.margin] = sectors.column[sectors.beyond]
    inside = np.flatnonzero(shown >= 0)
    rays = camera.rays(camera.shape)[:, shown[inside]]
    for theta in rng.normal(size=(5, 3)):
        affine = sectors.affine(theta[None])[sectors.of_columns(inside)]
        x, y, c = (a[:, inside].astype(float) for a in (sectors.x, sectors.y, sectors.ratio))
        w = affine[:, 0] + affine[:, 1] * x + affine[:, 2] * y
        assert_allclose(w * c, rays @ theta, atol=1e-5)
        assert_allclose(sectors.turn[0] @ sectors.affine(theta[None])[0], theta, rtol=1e-9)


def test_margins_show_what_lies_beyond_a_seam(camera):
    """Some columns on either side of each seam, in order, as if there were no seam."""
    sectors, width = camera.sectors(camera.shape), camera.shape[1]
    seams = sectors.count if sectors.wraps else sectors.count - 1
    assert sectors.margin.size == sectors.beyond.size
    assert sectors.margin.size % (2 * max(seams, 1)) == 0
    assert (sectors.margin.size > 0) == (seams > 0)
    assert (sectors.column[sectors.margin] == -1).all()
    shown = sectors.column.copy()
    shown[sectors.margin] = sectors.column[sectors.beyond]
    for k in range(sectors.count):
        beside = np.flatnonzero((shown >= 0) & (sectors.of_columns(np.arange(shown.size)) == k))
        assert (np.diff(beside) == 1).all()
        assert set(np.diff(shown[beside]) % width) == {1}
    few = pw.SphericalCamera.spinning([10, 0, -10], columns=9)
    assert not few.sectors(few.shape).margin.size


def test_planes_cost_less_in_coarse_images():
    """In proportion to the pixels, and their parameters at least."""
    for rows, columns, fineness in ((128, 2048, 1.0), (128, 1024, 1.0), (64, 1024, 0.5)):
        camera = pw.SphericalCamera.spinning(np.linspace(30, -30, rows), columns)
        sectors = camera.sectors(camera.shape)
        assert sectors.fineness == fineness
        assert sectors.price(5.0, 30.0) == 150.0 * fineness
        assert sectors.price(1.5, 30.0) == max(45.0 * fineness, 30.0)
    for shape, price in (
        ((480, 640), 90.0),
        ((256, 512), 90.0),
        ((256, 256), 45.0),
        ((30, 40), 30.0),
    ):
        pinhole = pw.PinholeCamera(fx=300, fy=300, cx=shape[1] / 2, cy=shape[0] / 2)
        assert pinhole.sectors(shape).price(3.0, 30.0) == price


def test_the_frame_has_depth_along_the_axis_of_each_sector(camera):
    rng = np.random.default_rng(1)
    ranges = rng.uniform(2, 9, camera.shape) * (rng.random(camera.shape) < 0.9)
    seen = pw.observe(ranges, camera, pw.Sensor(max_depth=10, noise=0.02, resolution=1e-4))
    frame, sectors = frame_of(seen), camera.sectors(camera.shape)
    there = sectors.image(frame.p) > 0
    assert_array_equal(there, ranges > 0)
    assert not frame.p[:, sectors.column < 0].any()
    gap = np.setdiff1d(np.flatnonzero(sectors.column < 0), sectors.margin)
    assert not frame.w[:, gap].any()
    inverse_range = frame.w * sectors.ratio
    beyond = inverse_range[:, sectors.beyond]
    assert_allclose(inverse_range[:, sectors.margin], beyond, rtol=1e-6)
    c = sectors.image(sectors.ratio)[there]
    assert_allclose(1 / sectors.image(frame.w)[there], c * ranges[there], rtol=1e-5)
    # sigma_z = c sigma_range; w = 1 / z
    z = c * ranges[there]
    variance = (0.02 * c / z**2) ** 2
    told = 1 / sectors.image(frame.p)[there] / variance  # steps of the readings add a little
    assert_allclose(np.quantile(told, (0.02, 0.98)), 1, rtol=0.02)
    white = np.array([frame.table.at(each)[0] for each in 1 / z])
    assert_allclose(np.median(white * sectors.image(frame.p)[there]), 1, rtol=0.15)


def row_of(rays, inverse_range, precision, axes):
    """Row of moments of readings in the coordinates of axes: w = inverse_range / c."""
    coordinates = rays @ np.linalg.inv(axes).T
    matrix = np.einsum("k,ki,kj->ij", precision, coordinates, coordinates)
    vector = np.einsum("k,k,ki->i", precision, inverse_range, coordinates)
    square = np.sum(precision * inverse_range**2)
    upper = matrix[np.triu_indices(3)]
    return np.array([*upper, *vector, square, len(rays), 3.0, 4.0])


@given(seed=st.integers(0, 2**32 - 1))
def test_rows_are_carried_between_sectors_exactly(seed):
    """What is known of a plane from readings anywhere, in the coordinates of any sector."""
    rng = np.random.default_rng(seed)
    sectors = CAMERAS["a turn"].sectors((20, 187))
    groups = []
    for _ in range(2):
        rays = rng.normal(size=3) + 0.3 * rng.normal(size=(30, 3))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        groups.append((rays, rng.uniform(0.1, 1, 30), rng.uniform(1, 9, 30)))

    def rows(turns):
        # t' = M t is dual to rays: r' = M^-T r
        return np.array(
            [row_of(*g, np.linalg.inv(turn).T) for g, turn in zip(groups, turns, strict=True)]
        )

    home = rng.integers(0, 6, 2)
    mine = rows(sectors.turn[home])
    for k, found in enumerate(sectors.everywhere(mine, home)):
        expected = rows([sectors.turn[k]] * 2)
        assert_allclose(found, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())
    by_sector = np.zeros((6, mine.shape[1]))
    for n in range(2):
        by_sector[home[n]] += mine[n]
    total = sectors.together(by_sector)
    for k in range(6):
        expected = rows([sectors.turn[k]] * 2).sum(axis=0)
        assert_allclose(total[k], expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())


def test_a_seam_lies_half_way(camera):
    sectors = camera.sectors(camera.shape)
    for k in range(sectors.count if sectors.wraps else sectors.count - 1):
        turn, beside = sectors.seams[k], sectors.turn[[k, (k + 1) % sectors.count]]
        assert abs(np.linalg.det(turn)) == pytest.approx(abs(np.linalg.det(beside[0])))
        apart = [turn[:, 0] @ other[:, 0] for other in beside]
        assert apart[0] == pytest.approx(apart[1])
        assert apart[0] > 0.85


def test_what_is_known_by_plane_and_sector():
    sectors = CAMERAS["a turn"].sectors((20, 187))
    values = np.arange(18)
    assert_array_equal(sectors.summed(values), [15, 51, 87])
    assert_array_equal(sectors.repeated(np.array([4, 5])), [4] * 6 + [5] * 6)
    assert_array_equal(sectors.places(np.array([2, 0]), 3), [0] + [2] * 6 + [0] * 6 + [1] * 6)
