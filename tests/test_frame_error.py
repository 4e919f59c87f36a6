"""What a frame tells of its own error, and the numbers that a random walk gives."""

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks import curved_frames
from benchmarks.covariance import scatter
from benchmarks.simulated import random_walk
from numpy.testing import assert_allclose

import planewise as pw
from planewise import scenes
from planewise.kernels import frame_error as kernels
from planewise.kernels.cells import COUNT, MISFIT, SEGMENT, SIDE, UNIT
from planewise.kernels.medians import OF_CHI2
from planewise.kernels.segments import tempered
from planewise.kernels.walk import (
    FIELD,
    PLANE_BEND,
    PLANE_OFFSET,
    PLANE_RESIDUAL,
    PLANE_SLOPE,
    SATURATION,
)
from planewise.spatial import cells, frame_error, merging, neighbouring, search
from planewise.spatial.frame import ErrorTable, frame_of
from planewise.spatial.frame_error import FrameError

POINTS = 12  # to a side of a square
NEARER = 0.45  # of the smaller side: from its centre to where two planes are compared


def square(side, left):
    """Points of a square whose left side lies at `left`."""
    steps = (np.arange(POINTS) + 0.5) / POINTS * side
    x, y = np.meshgrid(left + steps, steps - side / 2)
    return np.column_stack((x.ravel(), y.ravel()))


def plane_at(points, origin):
    """Functionals of readings at points: offset at an origin and two slopes of their plane."""
    return np.linalg.pinv(np.column_stack((np.ones(len(points)), points - origin)))


def walk_covariance(points, contrasts):
    """Covariance of contrasts, whose weights sum to zero, of a random walk of D = 1."""
    assert_allclose(contrasts.sum(axis=1), 0, atol=1e-9)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    return contrasts @ (-distance / 2) @ contrasts.T


@pytest.mark.parametrize("seed", [0, 1])
def test_drift_that_white_noise_shows_by_chance_is_not_told(seed):
    """Else planes that it hides come and go from one frame of a wall to the next."""
    depth = np.full((240, 320), 3.0)
    depth[60:150, 90:200] -= 0.006
    depth += np.random.default_rng(seed).normal(0, 0.003, depth.shape)
    camera = pw.PinholeCamera(fx=260, fy=260, cx=159.5, cy=119.5)
    seen = pw.observe(depth, camera, pw.Sensor(noise=0.003, resolution=1e-4))
    found = cells.cells_of(frame_of(seen), seen.pixel_size)
    assert (found.error.drifting > 0.005) == (seed == 0)
    assert found.error.walk == 0.0
    resolved = 1e-8 / 12 / 3**4  # variance of w
    assert_allclose(found.told_drift, SATURATION * resolved, rtol=0.1)


@pytest.mark.parametrize("side", [1.0, 0.5, 0.25, 0.125])
def test_planes_of_two_squares_of_a_random_walk(side):
    small, large = square(side, -side), square(1.0, 0.0)
    meeting = np.array([-side / 2 + NEARER * side, 0.0])
    gap = np.hstack((plane_at(small, meeting), -plane_at(large, meeting)))
    offset, across, along = np.diag(walk_covariance(np.vstack((small, large)), gap))
    assert_allclose(offset, PLANE_OFFSET * 1.0, rtol=0.25)
    bend = PLANE_BEND[0] / side + PLANE_BEND[1] / 1.0
    assert_allclose((across + along) / 2, bend, rtol=0.25)
    # One number for both directions: of equal squares each is off by a third.
    assert_allclose([across, along], bend, rtol=0.4)


def test_readings_of_a_random_walk_about_their_own_plane():
    points = square(1.0, 0.0)
    design = np.column_stack((np.ones(len(points)), points))
    residuals = np.eye(len(points)) - design @ np.linalg.pinv(design)
    mean = np.trace(walk_covariance(points, residuals)) / len(points)
    assert_allclose(mean, PLANE_RESIDUAL, rtol=0.05)


def test_a_result_says_how_large_the_error_was():
    wall = 2.0 + np.random.default_rng(0).normal(0, 0.006, (120, 160))
    camera = pw.PinholeCamera(fx=150, fy=150, cx=79.5, cy=59.5)
    for told, white in ((0.006, 1), (0.003, 4), (0.002, 9)):
        model = pw.detect_planes(wall, camera, pw.Sensor(noise=told))
        found = model.settings["frame_error"]
        assert_allclose(found["white"], white, rtol=0.1)
        assert found.keys() == vars(FrameError()).keys()
        assert found["distorted"] is None  # infinite


def test_a_random_walk_about_its_mean():
    points = square(1.0, 0.0)
    about_mean = np.eye(len(points)) - 1 / len(points)
    assert_allclose(np.trace(walk_covariance(points, about_mean)) / len(points), FIELD, rtol=0.05)


def test_slopes_of_a_plane_on_a_random_walk():
    points = square(1.0, 0.0)
    slopes = np.linalg.pinv(np.column_stack((np.ones(len(points)), points)))[1:]
    assert_allclose(np.diag(walk_covariance(points, slopes)), PLANE_SLOPE, rtol=0.05)


@pytest.mark.parametrize(("drift", "least", "most"), [(0.0, 0.9, 1.3), (0.0035, 0.7, 1.3)])
def test_planes_scatter_as_much_as_their_covariance_says(drift, least, most):
    """Where the error drifts, too: a plane is off as a whole, however many readings it has."""
    walls = np.array([(0.6, 0.1, -1, 2.4), (-0.7, -0.2, -1, 2.4)])
    for found, told in scatter(walls, drift, draws=40):
        assert least < told / found < most


@pytest.mark.parametrize("bent", [(-0.1, 0, 0, 0), (-0.2, 0.05, 0.001, 0)])
def test_the_lens_of_a_camera_is_no_drift(bent):
    """Three cells in a row of a bent image are not in a row of rays."""
    walls = np.array([(0.6, 0.1, -1, 2.4), (-0.7, -0.2, -1, 2.4)])
    camera = pw.PinholeCamera(fx=260, fy=260, cx=159.5, cy=119.5, distortion=bent)
    w = (camera.rays((240, 320)) @ walls[:, :3].T / -walls[:, 3]).max(axis=-1)
    depth = 1 / (w + 0.0015 * np.random.default_rng(0).standard_normal(w.shape))
    sensor = pw.Sensor(noise=pw.noise.quadratic(0, 0.0015))
    found = pw.detect_planes(depth, camera, sensor).settings["frame_error"]
    assert found["drifting"] < 0.01  # it was 0.08 and 0.2
    assert found["walk"] == 0


@pytest.mark.parametrize("lag", [1, 2, 4])
def test_cells_in_a_row_on_a_random_walk(lag):
    side, weights = 2 * SIDE / UNIT, np.array([-0.5, 1.0, -0.5])
    squares = [square(side, k * lag * side) for k in range(3)]
    contrast = np.repeat(weights / POINTS**2, POINTS**2)[None]
    planes, rows, ends = np.zeros((10, 3)), np.empty((3, 8)), np.empty(8, np.int64)
    planes[0] = [points[:, 0].mean() for points in squares]
    planes[2] = np.random.default_rng(lag).normal(size=3)
    planes[6] = 1.0
    grid = np.full((1, 2 * lag + 1), -1, np.int32)
    grid[0, ::lag] = range(3)
    one = np.ones(3)
    assert kernels.cells_in_a_row(grid, planes, one, one, lag, *rows, ends) == (1, 1)
    assert_allclose(rows[0, 0], weights @ planes[2])
    assert_allclose(rows[1, 0], np.square(weights).sum())
    expected = walk_covariance(np.vstack(squares), contrast)[0, 0]
    assert_allclose(rows[2, 0], expected, rtol=0.02 if lag > 1 else 0.07)
    assert ends[0] == 1


@pytest.mark.parametrize("shape", [(80, 107), (7, 50), (5, 5), (3, 1), (30, 53)])
def test_cells_in_a_row_square_by_square(shape):
    """As often as there are three, each once, and as many squares as were told."""
    rng, lag = np.random.default_rng(0), 2
    grid = np.arange(math.prod(shape), dtype=np.int32).reshape(shape)
    grid[rng.random(shape) < 0.1] = -1
    planes = rng.normal(size=(10, grid.size)) ** 2 + 0.1
    row, column = np.indices(shape).reshape(2, -1)
    planes[0], planes[1] = column * 2 * SIDE / UNIT, row * 2 * SIDE / UNIT
    one, rows = np.ones(grid.size), np.empty((3, 2 * grid.size))
    ends = np.empty(kernels.most_squares(shape), np.int64)
    n, squares = kernels.cells_in_a_row(grid, planes, one, one, lag, *rows, ends)
    off = []
    for three in (grid, grid.T):
        a, b, c = three[:, : -2 * lag], three[:, lag:-lag], three[:, 2 * lag :]
        there = (a >= 0) & (b >= 0) & (c >= 0)
        w = planes[2]
        off += (w[b] - 0.5 * w[a] - 0.5 * w[c])[there].tolist()
    assert squares <= len(ends)
    assert n == len(off) == (ends[squares - 1] if squares else 0)
    assert (np.diff(ends[:squares], prepend=0) >= 0).all()
    assert_allclose(np.sort(rows[0, :n]), np.sort(off), atol=1e-12)


def test_what_bends_alike_all_over_a_square():
    rng, factor, widest = np.random.default_rng(0), 0.7, 9.0
    ends = np.array([0, 40, 40, 41, 100])
    off, own, slow = rng.normal(0, 2, 100), rng.uniform(0.5, 2, 100), rng.uniform(0, 1, 100)
    alike = excess = 0.0
    for square in np.split(np.arange(100), ends):
        square = square[off[square] ** 2 <= widest * (own + factor * slow)[square]]
        if len(square):
            alike += len(square) * off[square].mean() ** 2 - own[square].mean()
            excess += (off[square] ** 2 - own[square]).sum()
    assert len(off[off**2 > widest * (own + factor * slow)]) > 2
    found = kernels.bent_alike(off, own, slow, ends, factor, widest)
    assert_allclose(found, (alike, excess))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("radius", "nearest", "sigma"), [(0.15, 0.5, 0.004), (1.0, 2.0, 0.008)])
def test_a_ball_alone_is_no_plane(radius, nearest, sigma, seed):
    """Cells in a row take its bend for drift, and by that it was two or three planes."""
    rays = curved_frames.rays()
    depth = curved_frames.sphere((0, 0, nearest + radius), radius, rays)
    there = np.isfinite(depth)
    depth[there] += np.random.default_rng(seed).normal(0, sigma, there.sum())
    sensor = pw.Sensor(noise=sigma, max_depth=10, resolution=1e-3)
    model = pw.detect_planes(np.where(there, depth, 0), curved_frames.CAMERA, sensor)
    assert len(model) == 0


def test_what_lies_across_edges_is_not_taken_for_drift():
    """A third of all disagreements are due to edges, the others to noise, or to a drift of 4."""
    rng = np.random.default_rng(0)
    n = 30_000
    own, added = np.full(n, 1.0), np.full(n, 0.5)
    edge = rng.random(n) < 1 / 3
    for drift in (0.0, 4.0):
        off = rng.normal(0, np.sqrt(1 + 0.5 * drift), n) + edge * rng.normal(0, 40, n)
        found = neighbouring._bisect(
            off**2,
            own,
            added,
            0.5 / neighbouring._WITHIN,
            neighbouring._WIDEST,
        )
        assert_allclose(found, drift, rtol=0.25, atol=0.25)


@pytest.mark.parametrize("quiet", [0, 5])
def test_a_few_triples_that_happen_to_lie_in_line_are_no_sign_of_no_drift(quiet):
    """Where all others err by a thousand times what cells do by themselves, or cross an edge."""
    rng, n, drift = np.random.default_rng(1), 400, 1e6
    own, added = np.full(n, 1.0), np.full(n, 1.0)
    off = rng.normal(0, np.sqrt(1 + drift), n)
    off[n // 2 :] *= 1e3
    off[:quiet] = 0.0
    limits = 1e-3, 1e9, 24
    args = 0.5 / neighbouring._WITHIN, OF_CHI2, neighbouring._WIDEST
    factor = kernels.bisect(off**2, own, added, *args, neighbouring._TELLING, *limits)
    assert_allclose(factor, drift, rtol=0.3)
    if quiet:  # they are all that is left at small factors
        assert kernels.bisect(off**2, own, added, *args, 0.0, *limits) == 0.0


def framed(z, sensor):
    """Frame and cells of a depth image in metres."""
    camera = pw.PinholeCamera(fx=525, fy=525, cx=z.shape[1] / 2, cy=z.shape[0] / 2)
    seen = pw.observe(z, camera, sensor)
    image = frame_of(seen)
    found = cells.cells_of(image, seen.pixel_size)
    assert found is not None
    return image, found


def told(z, sensor):
    """Error of a depth image in metres against a sensor's description, and the drift of that."""
    image, found = framed(z, sensor)
    drift = image.table.at(float(np.median(image.w[image.p > 0])))[2]
    return found.error, drift / SATURATION


@pytest.mark.parametrize("height", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("told", [0.008, "auto"])
def test_relief_is_not_taken_for_drift(height, told):
    """It is farther from a plane at 12 px than a camera's error, and at 24 px farther still."""
    rng = np.random.default_rng(0)
    relief = smooth((240, 320), 13, rng)
    depth = 2.5 + height * relief + rng.normal(0, 0.008, relief.shape)
    camera = pw.PinholeCamera(fx=262.5, fy=262.5, cx=159.5, cy=119.5)
    sensor = pw.Sensor(max_depth=8, resolution=1e-4, noise=told)
    assert not len(pw.detect_planes(depth, camera, sensor))


@pytest.mark.parametrize(("width", "seed"), [(10, 0), (10, 2), (12, 0), (12, 1)])
def test_error_as_large_as_it_is_described_is_no_relief(width, seed):
    """That of stereo, 1.5 % of the depth and smooth over so many pixels, of a floor and a wall."""
    rng, down = np.random.default_rng(seed), (np.arange(480)[:, None] - 239.5) / 525
    z = np.broadcast_to(np.minimum(3.0, 1 / np.maximum(down, 1e-9)), (480, 640))
    depth = z + 0.0055 * z**2 * smooth(z.shape, width, rng)
    camera = pw.PinholeCamera(fx=525, fy=525, cx=319.5, cy=239.5)
    model = pw.detect_planes(
        np.round(1000 * depth).astype(np.uint16), camera, pw.sensors.REALSENSE_D435
    )
    assert len(model) == 2
    assert np.count_nonzero(model.labels) > 0.99 * model.labels.size


def smooth(shape, width, rng):
    """White noise smoothed by a Gaussian of so many pixels, with a standard deviation of 1."""
    squared = sum(np.square(np.fft.fftfreq(n)).reshape(at) for n, at in
                  zip(shape, ((-1, 1), (1, -1)), strict=True))  # fmt: skip
    kernel = np.exp(-2 * (np.pi * width) ** 2 * squared)
    field = np.fft.ifft2(np.fft.fft2(rng.normal(size=shape)) * kernel).real
    return field / field.std()


SIGMA = 0.0015  # of inverse depth
FINE = pw.Sensor(max_depth=10, resolution=1e-5, noise=pw.noise.quadratic(0, SIGMA))


@pytest.mark.parametrize("drift", [0.0035, 0.007, 0.014])
def test_drift_of_a_simulated_random_walk_is_told(drift):
    ratios = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        w = 0.5 + random_walk((240, 320), drift, rng) + rng.normal(0, SIGMA, (240, 320))
        error, described = told(1 / w, FINE)
        ratios.append(np.sqrt(error.drift * described) / drift)
    assert_allclose(ratios, 1, atol=0.1)


def smooth_and_walk(width, seed):
    """Inverse depth of walls, of an error that is smooth over pixels, and of one that drifts."""
    rng, shape = np.random.default_rng(seed), (240, 320)
    field = 0.5 + 0.003 * smooth(shape, width, rng) + rng.normal(0, 0.0005, shape)
    return field, 0.5 + random_walk(shape, 0.007, rng) + rng.normal(0, SIGMA, shape)


@pytest.mark.parametrize("width", [3.0, 6.0])
def test_planes_are_priced_as_in_white_noise_where_error_is_smooth_over_a_few_pixels(width):
    for seed in range(2):
        field, walk = smooth_and_walk(width, seed)
        error, _ = told(1 / field, FINE)
        assert error.priced < 0.25 < 0.5 < error.drifting
        error, _ = told(1 / walk, FINE)
        assert error.priced == error.drifting > 0.5


@pytest.mark.parametrize("width", [3.0, 6.0])
def test_a_smooth_error_may_hardly_drift_and_is_new_in_a_reading_by_what_cells_show(width):
    for seed in range(2):
        field, walk = smooth_and_walk(width, seed)
        _, found = framed(1 / field, FINE)
        other = found.other
        assert other.other is None
        assert_allclose(other.error.drift, 0.1 * found.error.drift)
        assert other.error.priced == found.error.priced
        assert other.error.smooth
        assert other.error.near > found.error.near
        assert (other.drift < found.drift).all()
        assert not other.bends_more_than_told
        assert other.grid is found.grid
        assert_allclose(found.error.white, (0.0005 / SIGMA) ** 2, rtol=0.5)
        assert framed(1 / walk, FINE)[1].other is None


def test_independent_noise_has_no_drift_and_shares_nothing():
    for seed in range(3):
        w = 0.5 + np.random.default_rng(seed).normal(0, SIGMA, (240, 320))
        error, described = told(1 / w, FINE)
        drift = np.sqrt(error.drift * described)
        assert drift < 0.3 * SIGMA
        assert error.white < 1.05
        assert error.lateral < 0.1
        assert error.near < 0.05
        assert error.bent < 0.05


@pytest.mark.parametrize("side", [36, 54])
def test_small_images_tell_that_there_is_no_drift(side):
    """And planes scatter as their covariance says."""
    camera = pw.PinholeCamera(fx=0.8 * side, fy=0.8 * side, cx=side / 2 - 0.5, cy=side / 2 - 0.5)
    normal = np.array([0.3, 0.2, -1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    sensor, squares = pw.Sensor(noise=0.005), []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0, 0.005, (side, side))
        depth = noise - 2 / (camera.rays((side, side)) @ normal)
        (plane,) = pw.detect_planes(depth, camera, sensor).planes
        off = plane.coefficients - np.append(normal, 2.0)
        squares.append(off @ np.linalg.pinv(plane.covariance, rcond=1e-9) @ off / 3)
    assert 0.5 < np.mean(squares) < 1.4


@pytest.mark.parametrize("seed", range(3))
def test_a_synthetic_room_has_hardly_any_drift(seed):
    scene = scenes.room(seed)
    seen = pw.observe(scene.depth, scene.camera, scene.sensor)
    found = cells.cells_of(frame_of(seen), seen.pixel_size)
    assert found is not None
    assert found.error.drift < 0.05 * SATURATION  # of a real Kinect's
    assert found.error.near < 0.1
    assert found.error.bent < 0.2


@pytest.mark.parametrize("lateral", [0.0, 0.2, 0.5, 1.0])
def test_error_across_the_image_is_told_by_steep_surfaces(lateral):
    """Bands of growing slope, read at places that err by sqrt(lateral) pixels along it."""
    rng = np.random.default_rng(0)
    shape = (240, 320)
    slope = SIGMA * np.repeat(np.append(np.zeros(9), np.linspace(0.5, 2.2, 7)), 20)
    across = np.cumsum(slope) - slope.sum() / 2
    across_error = slope * np.sqrt(lateral) * rng.standard_normal(shape)
    w = 0.6 + across + across_error + rng.normal(0, SIGMA, shape)
    error, _ = told(1 / w, FINE)
    assert_allclose(error.lateral, lateral, rtol=0.3, atol=0.05)


@pytest.mark.parametrize("rough", [0.0, 0.4, 0.6])
def test_planes_are_taken_for_as_rough_as_four_cells_of_five(rough):
    """A share of a wall errs by 1.5 sigma: quantiles of such a mixture of chi^2."""
    rng = np.random.default_rng(0)
    sigma = np.where(np.arange(240)[:, None] < rough * 240, 1.5 * SIGMA, SIGMA)
    error, _ = told(1 / (0.6 + sigma * rng.standard_normal((240, 320))), FINE)
    alike = rng.chisquare(SIDE**2 - 3, 100_000)
    mixed = alike * np.where(np.arange(alike.size) < rough * alike.size, 1.5**2, 1.0)
    half, most = np.quantile(mixed, (0.5, 0.8)) / np.quantile(alike, (0.5, 0.8))
    assert_allclose((error.seen, error.white), (half, most), rtol=0.05)


@pytest.mark.parametrize("seed", [200, 202, 204])
@pytest.mark.parametrize("sensor", [pw.sensors.REALSENSE_D435, pw.sensors.STRUCTURE])
def test_a_description_that_is_too_large_by_more_near_than_far_is_met_as_well(sensor, seed):
    """The noise does not depend on depth, the described one grows with its square.

    Blocks cross edges more often than their cells do. Where by how much a frame is quieter than
    described is spread over a decade, that moved the median of blocks as smooth error would.
    """
    room = scenes.room(seed, sigma=0.001)
    error, _ = told(room.depth, sensor)
    assert error.white < 0.1
    quiet = 0.001 * room.depth
    smooth = random_walk(quiet.shape, 0.004, seed)  # of which larger cells show more
    error, _ = told(quiet * (1 - quiet * smooth), sensor)
    assert error.white == 1.0


@pytest.mark.parametrize(("step", "most"), [(0.015, 2.0), (0.1, 1.0)])
def test_edges_are_not_taken_for_noise(step, most):
    """Steps across two cells of five: at most twice what half of the cells show, if not clear."""
    rng = np.random.default_rng(0)
    steps = step * (np.arange(320) // 5 % 2)
    error, _ = told(1 / (0.6 + steps + SIGMA * rng.standard_normal((240, 320))), FINE)
    assert 1.0 <= error.white <= 2.0 * error.seen
    assert_allclose(error.white, most * error.seen)


@pytest.mark.parametrize("power", [0, 1, 2])
def test_weighted_means_are_too_small_by_what_the_table_says(power):
    """Readings of a wall at 2 m, a million of them, with sigma = 2 % of 2 m there."""
    z = np.random.default_rng(0).normal(2.0, 0.04, (1000, 1000))
    camera = pw.PinholeCamera(fx=1000, fy=1000, cx=500, cy=500)
    image = frame_of(
        pw.observe(z, camera, pw.Sensor(max_depth=8, noise=lambda z: 0.04 * (z / 2) ** power))
    )
    mean = np.average(image.w, weights=image.p)
    assert_allclose(1 - 2 * mean, image.table.noise_bias(np.array([mean]))[0], rtol=0.1, atol=2e-5)


def test_distortion_is_that_of_cameras_whose_error_drifts():
    """Half as much drift, twice the readings; as many steradians for any focal length."""
    camera = pw.PinholeCamera(fx=500, fy=400, cx=20, cy=15)
    sweep = pw.SphericalCamera.spinning(elevation=np.linspace(15, -15, 16), columns=360)

    def told(drift, sigma=0.01, camera=camera, shape=(30, 40)):
        """Of a drift of so many times the white part."""
        seen = pw.observe(np.full(shape, 2.0), camera, pw.Sensor(max_depth=10, noise=sigma))
        table, sectors = frame_of(seen).table, frame_of(seen).sectors
        white, _, described, _ = table.at(0.5)
        factor = drift * white / described
        drifting, distorted, _ = frame_error.drift_and_distortion(1.0, factor, 0.5, table, sectors)
        return drifting, distorted

    assert told(0.5)[0] == pytest.approx(0.5)
    assert told(1.0)[0] == told(7.0)[0] == 1.0
    readings = told(2.0)[1]
    assert told(0.5)[1] == pytest.approx(2 * readings)
    assert told(2.0, camera=camera.scaled(2))[1] == pytest.approx(4 * readings)
    assert told(0.0) == (0, np.inf)
    assert told(2.0, sigma=0.2)[1] == np.inf  # a seventh of the depth: leaves
    assert told(2.0, camera=sweep, shape=(16, 360))[1] == np.inf


@pytest.mark.parametrize("z", [0.7, 3.0])
def test_turning_is_the_discord_of_cells_on_a_surface_that_turns(z):
    """Of planes of two cells' readings, one upright, one turned; its error white."""
    camera = pw.PinholeCamera(fx=500, fy=400, cx=20, cy=15)
    sensor = pw.Sensor(max_depth=10, resolution=1e-5, noise=0.004)
    seen = pw.observe(np.full((30, 40), z), camera, sensor)
    table, sectors = frame_of(seen).table, frame_of(seen).sectors
    turning = frame_error.drift_and_distortion(1.5, 1.0, 1 / z, table, sectors)[2]
    n = 2 * SIDE
    y, x = np.mgrid[:n, :n].reshape(2, -1)
    design = np.stack((np.ones(n * n), x, y), axis=1)
    slope = np.linalg.inv(design.T @ design)[1, 1] * 1.5 * (0.004 / z**2) ** 2
    turned = frame_error._TURN / z / math.sqrt(500 * 400)  # dw / dx in pixels
    assert turning == pytest.approx(turned**2 / (2 * slope), rel=1e-3)
    sweep = pw.SphericalCamera.spinning(elevation=np.linspace(15, -15, 16), columns=360)
    ranges = frame_of(pw.observe(np.full((16, 360), z), sweep, sensor))
    alike = frame_error.drift_and_distortion(1.0, 1.0, 1 / z, ranges.table, ranges.sectors)
    assert alike[2] == 0.0


def test_borders_cost_more_the_more_error_drifts():
    white, drifting = (1.0, 2.0, 3.0), (3.0, 2.0, 5.0)
    assert merging.between((white, drifting), 0.0) == white
    assert merging.between((white, drifting), 1.0) == drifting
    assert merging.between((white, drifting), 0.25) == (1.5, 2.0, 3.5)


def test_distortion_forgives_misfit_of_wide_planes():
    rows = np.zeros((2, SEGMENT))
    rows[:, COUNT], rows[:, MISFIT] = [1000, 3000], 80.0
    charges = search.Charges(plane=0.0, border=(0.0, 0.0, 1.0), distorted=1000.0)
    assert_allclose(charges.misfit(rows), [20, 10])
    assert_allclose(replace(charges, distorted=np.inf).misfit(rows), 40)


def test_steps_that_noise_dithers_are_random():
    """Against them drift counts for less; steps that are wider than noise repeat themselves."""
    camera = pw.PinholeCamera(fx=500, fy=400, cx=20, cy=15)
    sectors = camera.sectors((30, 40))

    def drifting(white, step, drift=1e-4, factor=1.0):
        table = ErrorTable(
            (1000.0, 0.0, 0.0), 1.0, 1, *(np.full(4000, v) for v in (white, 0.0, drift, step))
        )
        return frame_error.drift_and_distortion(factor, 1.0, 0.5, table, sectors)[0]

    assert_allclose(drifting(1e-3, 0.0), 0.1)
    assert_allclose(drifting(1e-3, 1e-3), 0.05, rtol=0.05)  # all of it but a thirtieth
    assert_allclose(drifting(1e-3, 0.1), 0.1 / 4.27, rtol=0.01)  # x 1 + 100 (1 - exp(-pi^2 / 300))
    assert_allclose(drifting(0.0, 0.1), 1.0)
    # A frame that errs by more than described errs by noise.
    assert_allclose(drifting(1e-3, 1e-3, factor=2.0), 0.1 / 4, rtol=0.01)
    assert_allclose(drifting(1e-3, 1e-3, factor=0.4), 0.1 / 1.13, rtol=0.02)


def test_cells_err_by_more_where_readings_err_across_the_image():
    """Those near edges: the tails of their error are heavier, up to a limit."""
    tails = [merging._tails(FrameError(lateral=lateral)) for lateral in (0.0, 0.2, 0.4, 1.5)]
    assert_allclose(tails, [4.0, 3.25, 2.5, 2.5])
    discord = tempered.py_func
    assert np.all(np.diff([discord(100.0, 36.0, each) for each in tails[:3]]) < 0)
    # Of an average over many cells little is left of them.
    assert_allclose(discord(10.0, 3.6e6, 2.5), discord(10.0, 3.6e6, 4.0), rtol=1e-3)


def test_cells_without_planes_are_those_across_edges(monkeypatch):
    """The limit of chi^2 falls with the pixels of an image, and is low in range images."""

    def limit(camera, shape):
        frame = frame_of(pw.observe(np.full(shape, 2.0), camera, pw.Sensor(noise=0.01)))
        return cells._hopeless(frame.sectors)

    camera = pw.PinholeCamera(fx=500, fy=500, cx=320, cy=240)
    assert_allclose(limit(camera, (480, 640)), 60)
    assert_allclose(limit(camera, (256, 256)), 42.5)
    sweep = pw.SphericalCamera.spinning(elevation=np.linspace(15, -15, 16), columns=360)
    assert_allclose(limit(sweep, (16, 360)), 25)

    room = scenes.room(3)
    frame = frame_of(pw.observe(room.depth, room.camera, room.sensor))
    counts = []
    for high in (25.0, 60.0):
        monkeypatch.setattr(cells, "_HOPELESS", (25.0, high))
        found = cells.cells_of(frame, room.camera.pixel_size)
        counts.append(int((found.grid >= 0).sum()))
    assert counts[0] < counts[1] < 1.1 * counts[0]
