"""The closed forms of the spatial objective against dense normal densities, reading by reading."""

import math
from dataclasses import replace

import numpy as np
import pytest

import planewise as pw
from planewise.kernels.frame_error import TILT
from planewise.kernels.groups import BLOCK
from planewise.runtime.workspace import Workspace
from planewise.spatial.cells import cells_of
from planewise.spatial.frame import frame_of
from planewise.spatial.frame_error import FrameError
from planewise.spatial.information import ledger
from planewise.spatial.mask_code import spatial_mask_information

from .oracles import group_level, group_level_nats, undithered

PARTS = pw.noise.ErrorParts(
    white=pw.noise.constant(0.003),
    shared=pw.noise.constant(0.002),
    drift=pw.noise.constant(0.004),
)
SENSOR = pw.Sensor(max_depth=8, noise=0.003, parts=PARTS)


def normal_nats(values, covariance, least):
    """least: of chi^2."""
    sign, determinant = np.linalg.slogdet(2 * np.pi * covariance)
    assert sign > 0
    return 0.5 * (max(values @ np.linalg.solve(covariance, values), least) + determinant)


def oracle(frame, error, affine, labels, R, eps, pixel_size):
    L = math.log(R / eps)
    images = [image.astype(float) for image in (frame.w, frame.x, frame.y)]
    p = frame.p.astype(float) / error.white
    sectors = frame.sectors
    plane = (labels + sectors.count - 1) // sectors.count  # of every label
    total = len(affine) // sectors.count * 3 * L
    mask, there = sectors.image(plane), sectors.image(frame.p > 0)
    total += spatial_mask_information(mask, there, len(affine) // sectors.count)
    height, width = labels.shape
    slope = 100 * math.sqrt(pixel_size[0] * pixel_size[1])
    per_pixel = 100 * np.array(pixel_size) if sectors.ratio is not None else np.zeros(2)

    def stretched(x, y):
        """(range / z)^2 in a direction, where depth is range."""
        return 1 + np.square(per_pixel * (x, y)).sum()

    levels = 4 if error.drifting > 0.5 and sectors.count == 1 else 1
    taken = np.zeros((len(affine) + 1, levels))
    for top in range(0, height, BLOCK):
        for left in range(0, width, BLOCK):
            window = np.s_[top : top + BLOCK, left : left + BLOCK]
            if not p[window].any():
                continue
            of_block, *middle = (np.average(image[window], weights=p[window]) for image in images)
            for label in range(len(affine) + 1):
                mine = (labels[window] == label) & (p[window] > 0)
                if not mine.any():
                    continue
                w, x, y = (image[window][mine] for image in images)
                v = 1 / p[window][mine]
                cx, cy = np.average(x, weights=1 / v), np.average(y, weights=1 / v)
                J = np.column_stack((np.ones_like(x), x - cx, y - cy))
                # density of z, not of w: dz = z^2 dw, in steps of eps
                change = np.sum(-2 * np.log(w)) - w.size * math.log(eps)
                # density of the range, dz = c dr
                change += 0.5 * w.size * math.log(stretched(*middle))
                mean = np.average(w, weights=1 / v)
                of_range = of_block / math.sqrt(stretched(*middle))
                unbiased = 1 + error.seen * frame.table.noise_bias(of_range)
                w, mean = unbiased * w, unbiased * mean
                s = (slope * mean) ** 2
                slopes = J @ np.diag([0, s, s]) @ J.T
                misfit = (w - mean) @ np.linalg.solve(np.diag(v) + slopes, w - mean)
                level = group_level(misfit, w.size)
                change += group_level_nats(level)
                own = np.diag(v * 2.0**level)
                stretch = stretched(cx, cy)
                row = frame.table.ranging[0] * math.sqrt(stretch) / mean
                shared, drift, step = (
                    stretch * np.interp(row, np.arange(table.size), table)
                    for table in (frame.table.shared, frame.table.drift, frame.table.step)
                )
                least = undithered(step * np.sum(1 / v), w.size, level)
                smooth = L + normal_nats(w - mean, own + slopes, least) + change
                nats = math.log(2) + min(smooth, w.size * L)
                if label:
                    t = affine[label - 1]
                    drift = error.drift * drift
                    q = np.mean(1 / v) * (t[1] ** 2 + t[2] ** 2) / 100**2
                    steep = 1 + error.lateral * q
                    whole = plane == (label + sectors.count - 1) // sectors.count
                    count = np.sum(whole & (frame.p > 0))
                    extent = math.sqrt(count) / 100 * (1 + count / error.distorted)
                    offset = steep * (error.near * (shared + step) + 0.113 * extent * drift)
                    tilt = steep * (TILT**2 * error.bent * shared + 0.9 / 0.09 * drift)
                    leaning = (sectors.lean * mean) ** 2
                    flat = np.diag([0.113 * leaning * count / 100**2, leaning, leaning])
                    alone, off = nats, w - t[0] - t[1] * x - t[2] * y
                    nats = np.empty(levels)
                    for k in range(levels):
                        C = own + J @ (4**k * np.diag([offset, tilt, tilt]) + flat) @ J.T
                        fitted = normal_nats(off, C, least) + change
                        fitted = math.log(2) + min(fitted, w.size * L)
                        nats[k] = -np.logaddexp(math.log(0.95) - fitted, math.log(0.05) - alone)
                taken[label] += nats
    if levels > 1:  # what the groups of a plane share is its own, with probability 2^-(k + 1)
        taken[1:] += np.arange(1, levels + 1) * math.log(2)
    return total + taken.min(axis=1).sum()


@pytest.fixture
def scene(roof, camera):
    """A frame, the planes as w = t . (1, x, y), and labels: holes, a box on the table, a patch."""
    depth, planes, labels = roof
    depth, labels = depth.copy(), labels.astype(np.int32)
    depth[5:12, 8:20] = 0
    depth[30:36, 40:44] = 5.0
    labels[28:40, 36:50] = 0
    labels[14:25, 20:31] = 3
    labels[depth == 0] = 0
    observation = pw.observe(depth, camera, SENSOR)
    du, dv = observation.pixel_size
    planes = np.vstack((planes, planes[0]))
    theta = -planes[:, :3] / planes[:, 3:]
    affine = np.column_stack((theta[:, 2], theta[:, 0] * du * 100, theta[:, 1] * dv * 100))
    return observation, affine, labels


def cropped(frame, labels, shape):
    rows, columns = shape
    images = {name: np.ascontiguousarray(getattr(frame, name)[:rows, :columns]) for name in "wpxy"}
    return replace(frame, **images), labels[:rows, :columns]


@pytest.mark.parametrize(
    ("shape", "step", "off"),
    [
        ((48, 64), 0, 0),
        ((45, 61), 0, 0),
        ((7, 64), 0, 0),
        ((48, 64), 0.025, 0),
        ((48, 64), 0, 0.02),
    ],
)
def test_the_ledger_is_exact(scene, camera, shape, step, off):
    """off: of one plane, in inverse depth, where the error drifts."""
    observation, affine, labels = scene
    affine[1, 0] += off
    if step:  # so coarse that surfaces fit terraces better than quantisation can tell
        depth = np.round(observation.image.values / step).astype(np.uint16)
        observation = pw.observe(depth, camera, SENSOR, depth_scale=step)
    size = observation.pixel_size
    whole = cells_of(frame_of(observation), size).error
    frame, labels = cropped(frame_of(observation), labels, shape)
    cells = cells_of(frame, size)
    error = replace(whole, near=0.5, bent=0.7, lateral=0.4, drift=0.6, distorted=3e3)
    error = replace(error, drifting=1.0 if off else 0.0)
    book = ledger(frame, replace(cells, error=error), affine, labels, 8, 0.001, size)
    place = np.zeros(4, np.int32)
    place[book.order + 1] = [1, 2, 3]
    for n in range(4):
        kept = np.where(place[labels] <= n, place[labels], 0)
        best = affine[book.order[:n]]
        expected = oracle(frame, error, best, kept, 8, 0.001, size)
        assert book.curve[n] == pytest.approx(expected, rel=1e-9)
    assert (np.diff(book.worth) >= 0).all()
    if off:
        even = replace(error, drifting=0.0)
        assert expected < oracle(frame, even, best, kept, 8, 0.001, size) - 10


def test_what_pays_is_ranked_first(scene):
    observation, affine, labels = scene
    labels = np.where(labels == 3, 0, labels)
    frame = frame_of(observation)
    cells = cells_of(frame, observation.pixel_size)
    book = ledger(frame, cells, affine[:2], labels, 8, 0.001, observation.pixel_size)
    assert book.worth[0] <= book.worth[1] < 0
    assert book.curve[2] < book.curve[1] < book.curve[0]


def test_moments_are_had_where_no_cell_has_a_plane(scene):
    observation, affine, labels = scene
    frame, size = frame_of(observation), observation.pixel_size
    book = ledger(frame, None, affine, labels, 8, 0.001, size)
    ranked = np.argsort(np.append(-1, book.order))[labels]
    expected = oracle(frame, FrameError(), affine[book.order], ranked, 8, 0.001, size)
    assert book.curve[-1] == pytest.approx(expected, rel=1e-9)


def test_without_planes_all_is_on_none(scene):
    observation, affine, labels = scene
    frame, size = frame_of(observation), observation.pixel_size
    book = ledger(frame, None, affine[:0], 0 * labels, 8, 0.001, size)
    expected = oracle(frame, FrameError(), affine[:0], 0 * labels, 8, 0.001, size)
    assert book.curve == pytest.approx([expected], rel=1e-9)


def test_loud_readings_of_a_plane_stay_on_it(camera):
    """Stripes that err more than told make a plane no better without its worst readings."""
    rng, shape = np.random.default_rng(0), (48, 64)
    plane, sigma = np.array([0.5, 0.01, -0.02]), np.full(shape, 0.003)
    sigma[20:30] *= 4
    seen = pw.observe(np.full(shape, 2.0), camera, SENSOR)
    frame, size = frame_of(seen), seen.pixel_size
    depth = 1 / (plane[0] + plane[1] * frame.x + plane[2] * frame.y) + rng.normal(0, sigma)
    seen = pw.observe(depth, camera, SENSOR)
    frame = frame_of(seen)
    off = depth - 1 / (plane[0] + plane[1] * frame.x + plane[2] * frame.y)
    phi = [
        ledger(frame, None, plane[None], labels.astype(int), 8, 0.001, size).curve[-1]
        for labels in (off < np.inf, np.abs(off) < 0.012)
    ]
    assert (np.abs(off) > 0.012).sum() > 50
    assert phi[0] < phi[1]


def test_memory_may_be_reused(scene):
    observation, affine, labels = scene
    workspace, size = Workspace(), observation.pixel_size
    frame = frame_of(observation)
    cells = cells_of(frame, size)
    books = [
        ledger(frame, cells, affine, part.astype(dtype), 8, 0.001, size, workspace)
        for part in (labels, np.where(labels == 2, 1, labels), labels)
        for dtype in (np.int32, np.uint16)
    ]
    held = workspace._held
    assert (books[0].curve == books[1].curve).all()
    assert (books[0].curve == books[-1].curve).all()
    ledger(frame, cells, affine, labels, 8, 0.001, size, workspace)
    assert workspace._held == held


def test_the_ledger_is_exact_in_sectors():
    """A box around a LiDAR: the sum over sectors, planes across seams counted once."""
    camera = pw.SphericalCamera.spinning(
        np.linspace(20, -20, 24), 150, azimuth_offset=[0.3, -0.2] * 12
    )
    rays = camera.rays(camera.shape)
    faces = np.array([[-1, 0, 0, 3.0], [0, 1, 0, 2.0], [1, 0, 0, 2.5], [0, -1, 0, 3.5]])
    with np.errstate(divide="ignore"):
        ranges = -faces[:, 3] / (rays @ faces[:, :3].T)
    ranges[ranges <= 0] = np.inf
    labels = ranges.argmin(axis=-1) + 1
    rng = np.random.default_rng(3)
    ranges = ranges.min(axis=-1) + rng.normal(0, 0.003, camera.shape)
    ranges[8:11, 20:40] = 0
    labels[3:9, 55:70] = 0
    observation = pw.observe(ranges, camera, SENSOR)
    frame, size = frame_of(observation), observation.pixel_size
    sectors = frame.sectors
    assert sectors.count == 6
    assert sectors.wraps
    error = replace(FrameError(), near=0.5, bent=0.7, lateral=0.4, drift=0.6, distorted=3e3)
    cells = replace(cells_of(frame, size), error=error)
    affine = sectors.affine(-faces[:, :3] / faces[:, 3:])
    inside = sectors.column >= 0
    of_column = np.searchsorted(sectors.start, np.arange(inside.size), side="right") - 1
    spread = np.zeros(frame.w.shape, int)
    spread[:, inside] = labels
    spread = np.where(spread > 0, (spread - 1) * 6 + of_column + 1, 0) * (frame.p > 0)
    book = ledger(frame, cells, affine, spread, 8, 0.001, size)
    expected = oracle(frame, error, affine, spread, 8, 0.001, size)
    assert book.curve[-1] == pytest.approx(expected, rel=1e-8)
    assert len(book.order) == 4
    assert (book.worth < 0).all()
    kept = book.order[:3]
    of_plane = (spread + 5) // 6
    fewer = np.where(np.isin(of_plane, kept + 1), spread, 0)
    for rank, plane in enumerate(kept):
        fewer = np.where(of_plane == plane + 1, rank * 6 + 1 + (spread - 1) % 6, fewer)
    best = affine.reshape(4, 6, 3)[kept].reshape(-1, 3)
    expected = oracle(frame, error, best, fewer, 8, 0.001, size)
    assert book.curve[3] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e6])
def test_phi_of_the_least_noise_is_a_number(scale):
    """Rounding must not make determinants negative, whose logarithm is none."""
    depth = np.where(np.arange(34)[:, None] + np.arange(31) // 8 < 20, 2.5, 3.25) * scale
    camera = pw.PinholeCamera(fx=102, fy=30.6, cx=0, cy=0)
    for noise in (1e-12, 3e-12, 1e-11, 1e-10, 1e-8):
        sensor = pw.Sensor(
            max_depth=10 * scale, resolution=1e-9, noise=pw.noise.proportional(noise)
        )
        assert np.isfinite(pw.detect_planes(depth, camera, sensor).information)
