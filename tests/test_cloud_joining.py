"""Planes of a cloud that turn out to be one, and rings of a LiDAR that pay only together."""

from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks import scanned_clouds
from benchmarks.scanned_clouds import turning
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import prices
from planewise.clouds import gaps, joining, model, weighing
from planewise.detect_in_cloud import detect_planes_in_cloud
from planewise.information import plane_information
from planewise.kernels import cloud_planes
from planewise.kernels.cloud_rows import (
    AREA,
    CELLS,
    COUNT,
    CX,
    CZ,
    MISFIT,
    NX,
    NZ,
    ROW,
    WEIGHT,
    XX,
    YY,
    ZZ,
)

from .conftest import SHARED

SENSOR = pw.Sensor(max_depth=100.0, resolution=0.001, noise=0.005)
SCAN = SHARED / "lidar" / "balm_realworld_000.npz"
LEAN = np.deg2rad(2.5)
LIMITS = 10.0, 0.001  # range and resolution


RINGS = pw.cameras.VELODYNE_VLP16.rays(pw.cameras.VELODYNE_VLP16.shape).reshape(-1, 3)


def ground(seed=0, lean=0.0, rows=160, columns=800):
    """Ground two metres below a scanner that turns, 5 mm off; behind x = 0 it may lean."""
    rng = np.random.default_rng(seed)
    grid = np.meshgrid(np.linspace(0, 360, columns), np.linspace(-60, -3, rows), indexing="ij")
    around, down = (np.deg2rad(angles + rng.normal(0, 0.02, angles.shape)) for angles in grid)
    out = 2.0 / np.tan(-down)
    x, y = (out * np.cos(around)).ravel(), (out * np.sin(around)).ravel()
    z = np.tan(lean) * np.maximum(x, 0.0) - 2.0 + rng.normal(0, 0.005, x.size)
    return np.column_stack((x, y, z))


def ring_by_ring(sigma, seed):
    """The same seen by 16 beams 1.8 m above it, which err along the ray."""
    return scanned_clouds.ground(RINGS, 1.8, sigma, np.random.default_rng(seed))


@pytest.mark.parametrize("noise", [0.005, "auto"])
@pytest.mark.parametrize("seed", [0, 1])
def test_ground_that_a_scanner_sees_is_one_plane(monkeypatch, noise, seed):
    points = ground(seed=seed)
    sensor = pw.Sensor(max_depth=100.0, resolution=0.001, noise=noise)
    found = pw.detect_planes_in_points(points, sensor)
    assert len(found) == 1
    assert (found.labels == 1).mean() > 0.99
    assert_allclose(np.abs(found.planes[0].normal), (0, 0, 1), atol=1e-4)
    assert found.planes[0].significance > 0
    monkeypatch.setattr(model, "joined", scanned_clouds.apart)
    pieces = pw.detect_planes_in_points(points, sensor)
    assert len(pieces) > 1
    assert found.information < pieces.information


def test_ground_that_bends_stays_two_planes():
    points = ground(seed=2, lean=LEAN)
    found = pw.detect_planes_in_points(points, SENSOR)
    assert len(found) == 2
    clear = np.abs(points[:, 0]) > 1.0
    for side in (points[clear, 0] > 0, points[clear, 0] < 0):
        share = np.bincount(found.labels[clear][side], minlength=3)[1:].max() / side.sum()
        assert share > 0.97


@pytest.mark.parametrize("most", [1, 2, 6])
def test_as_many_planes_as_asked_for_are_counted_once_they_are_joined(most):
    points = ground()
    few = pw.detect_planes_in_points(points, SENSOR, max_planes=most)
    every = pw.detect_planes_in_points(points, SENSOR)
    assert_array_equal(few.labels, every.labels)
    assert "max_planes" not in few.curve.reason
    hall = scanned_clouds.hall(turning(300, 120, -60, 88), 0.005, np.random.default_rng(0))
    first = pw.detect_planes_in_points(hall, SENSOR, max_planes=most)
    assert len(first) == most
    assert (first.curve.reason == f"reached max_planes = {most}") == (most < 6)


def test_ground_in_thick_sheets_is_one_plane():
    """So many points that cubes cut the sheet; names of points are those of their place then."""
    points = ground(seed=1, rows=480, columns=4000)
    found = pw.detect_planes_in_points(points, SENSOR)
    assert len(found) == 1


def test_tiles_join_the_same_planes(tmp_path):
    points = ground().astype(np.float32)
    np.save(tmp_path / "ground.npy", points)
    found = detect_planes_in_cloud(tmp_path / "ground.npy", SENSOR, tile_points=20_000)
    assert_array_equal(found.labels, pw.detect_planes_in_points(points, SENSOR).labels)


def test_walls_in_one_plane_stay_apart_if_wanted():
    rng = np.random.default_rng(0)
    walls = [rng.uniform((x, 0), (x + 3, 2), (4000, 2)) for x in (0, 5)]
    points = np.column_stack((np.vstack(walls), rng.normal(0, 0.005, 8000)))
    assert len(pw.detect_planes_in_points(points, SENSOR)) == 1
    assert len(pw.detect_planes_in_points(points, SENSOR, instances=True)) == 2


@pytest.mark.parametrize("sigma", [0.005, 0.02])
@pytest.mark.parametrize("seed", [0, 2, 3, 6])
def test_rings_none_of_which_pays_are_one_plane(sigma, seed):
    sensor = pw.Sensor(max_depth=100.0, resolution=0.002, noise=sigma)
    found = pw.detect_planes_in_points(ring_by_ring(sigma, seed), sensor)
    assert len(found) == 1
    assert (found.labels == 1).mean() > 0.95
    assert found.planes[0].significance > 0


def _gathered(*groups):
    """Rows of points, as if each had the weight 1, and their planes."""
    rows = np.zeros((len(groups), ROW))
    for row, points in zip(rows, groups, strict=True):
        centred = points - points.mean(axis=0)
        row[[WEIGHT, COUNT]], row[CX : CZ + 1] = len(points), points.mean(axis=0)
        row[XX : ZZ + 1] = (centred.T @ centred)[np.triu_indices(3)]
        row[NX : NZ + 1] = np.linalg.svd(centred)[2][2]
    return rows


def test_the_nearest_of_the_larger_planes():
    """Half of what the points of one take more on the other than on their own."""
    rng = np.random.default_rng(0)
    sheets = [rng.normal((0, 0, z), (1, 1, 0.01), (n, 3)) for n, z in ((9, 0), (30, 0.5), (20, 2))]
    sheets.append(rng.normal(0, (1, 0.01, 1), (5, 3)))  # no other is parallel to it
    rows = _gathered(*sheets)
    nearest, far = np.empty(4, np.intp), np.empty(4)
    cloud_planes.nearest_larger(rows, 0, 4, nearest, far)
    assert_array_equal(nearest, [1, 1, 1, 3])

    def squares(points, row):
        return np.square((points - row[CX : CZ + 1]) @ row[NX : NZ + 1]).sum()

    for k in (0, 2):
        more = squares(sheets[k], rows[1]) - squares(sheets[k], rows[k])
        assert_allclose(far[k], 0.5 * more, rtol=1e-9)
    assert np.isinf(far[[1, 3]]).all()


def larger(monkeypatch, nearest, more, *, far=0.0, fresh=True, named=()):
    """What each plane is part of, by what it takes more on its nearest one, in parameters.

    named: planes whose names would cost more than that.
    """
    n, price = len(nearest), plane_information(3, *LIMITS)

    def nearest_larger(rows, first, last, out, distance):
        out[:], distance[:] = (
            nearest,
            np.where(np.equal(nearest, np.arange(n)), np.inf, far * price),
        )

    def more_of(cloud, groups, rows, small, *_):
        return np.array(more)[small] * price, np.zeros(0, bool)

    left_out = []
    loops = SimpleNamespace(nearest_larger=nearest_larger, leave_out=None)
    names = SimpleNamespace(save=lambda nats, into, small: small in named)
    for name, value in {
        "kernels": loops,
        "groups_of": lambda *_: None,
        "_more": more_of,
        "_Names": lambda *_: names,
    }.items():
        monkeypatch.setattr(joining, name, value)
    cloud = SimpleNamespace(workers=1, over_cubes=left_out.append)
    into = joining._larger(cloud, None, np.zeros((n, 1)), np.full(n, fresh), None, LIMITS)
    assert bool(left_out) == (into != np.arange(n)).any()
    return into.tolist()


def test_a_plane_that_does_not_save_its_parameters_is_part_of_its_nearest(monkeypatch):
    assert larger(monkeypatch, [2, 2, 2], [0.9, 1.1, 0]) == [2, 1, 2]
    assert larger(monkeypatch, [2, 2, 2], [0.9, 1.1, 0], named=[1]) == [2, 2, 2]
    assert larger(monkeypatch, [2, 2, 2], [0.9, 0.9, 0], far=1.01 * prices.FAR) == [0, 1, 2]
    assert larger(monkeypatch, [2, 2, 2], [0.9, 0.9, 0], fresh=False) == [0, 1, 2]


def test_what_planes_become_part_of_becomes_part_of_none_at_once(monkeypatch):
    """The one that takes least is first; the plane of both together is looked at again."""
    assert larger(monkeypatch, [1, 2, 2], [0.1, 0.2, 0]) == [1, 1, 2]
    assert larger(monkeypatch, [1, 2, 2], [0.2, 0.1, 0]) == [0, 2, 2]


def test_rows_together_are_those_of_all_points():
    rng = np.random.default_rng(1)
    sheets = [rng.normal(0, (1, 1, 0.01), (n, 3)) for n in (7, 30, 20)]
    out = np.zeros((2, ROW))
    cloud_planes.add_rows(_gathered(*sheets), np.array([1, 0, 1]), out)
    expected = _gathered(sheets[1], np.vstack((sheets[0], sheets[2])))
    assert_allclose(out[:, :NX], expected[:, :NX], rtol=1e-9, atol=1e-12)
    cosines = (out[:, NX : NZ + 1] * expected[:, NX : NZ + 1]).sum(axis=1)
    assert_allclose(np.abs(cosines), 1.0, rtol=1e-9)


def test_points_beside_those_of_the_nearest_plane_are_mixed():
    edges = np.array(
        [[1, 1, 1, 2, 1, 5], [2, 3, 3, 3, 3, 7], [0, 0, 0, 1, 2, 11], [1, 1, 3, 3, 0, 13]]
    )
    mixed = np.zeros(3)
    cloud_planes.mixed_points(edges.astype(np.int32), np.array([1, 1, 1]), mixed)
    assert_array_equal(mixed, [5 + 11, 0, 7])


def test_points_in_cubes_of_the_nearest_plane_are_together():
    groups = np.zeros((5, ROW))
    groups[:, COUNT] = 3, 5, 7, 2, 4
    label, places = np.array([1, 2, 3, 1, 3]), np.array([0, 3, 5])
    mixed = np.zeros(3)
    cloud_planes.points_together(groups, label, places, np.array([1, 1, 0]), mixed)
    assert_array_equal(mixed, [3, 0, 3 + 2])


def test_planes_of_small_clouds_and_images_cost_less():
    """Than those of 131,072 readings, in proportion; above, all cost the same."""
    assert [prices.fineness(n) for n in (1 << 16, 1 << 17, 307_200)] == [0.5, 1.0, 1.0]
    assert prices.price(prices.LEAST, 28.0, 1.0) == 5 * 28.0


def test_what_pays_together_saves_its_parameters_once(monkeypatch):
    """A few pieces that lie on one plane by chance are none."""
    few = ring_by_ring(0.01, 2)
    pays = []

    def joined(*given):
        pays.append(given)
        return gaps.joined_through_gaps(*given)

    monkeypatch.setattr("planewise.clouds.segments.joined_through_gaps", joined)
    pw.detect_planes_in_points(few, pw.Sensor(max_depth=100.0, resolution=0.002, noise=0.005))
    rows, worth, accepted, parameters, *rest = pays[0]
    assert not accepted.any()
    planes, owner, saved = gaps.joined_through_gaps(*pays[0])
    assert len(planes) > 0
    assert (saved > 0).all()
    assert saved[0] < worth[owner == 0].sum() - parameters
    two = np.argsort(-worth)[:2]
    planes, owner, _ = gaps.joined_through_gaps(
        rows[two], worth[two], accepted[two], parameters, *rest
    )
    assert len(planes) == 0
    assert (owner == -1).all()


def patches(*places, sigma=1e-4):
    """Rows of level squares of one metre at (x, z), whose height is known to sigma."""
    rows = np.zeros((len(places), ROW))
    for row, (x, z) in zip(rows, places, strict=True):
        row[[WEIGHT, COUNT, AREA, CELLS]] = sigma**-2, 100, 1.0, 1
        row[CX], row[CZ], row[NZ] = x, z, 1.0
        row[[XX, YY]] = sigma**-2 / 12
    return rows


def through_gaps(rows, worth, accepted=(), least=0.0):
    mask = np.isin(np.arange(len(rows)), accepted)
    return gaps.joined_through_gaps(rows, np.array(worth), mask, 30.0, least, (0.0, 0.0), 10.0)


def test_what_lies_on_an_accepted_plane_becomes_part_of_it():
    """Not what lies off it, nor what is worth nothing."""
    rows = patches((0, 0), (3, 0), (6, 0.5), (9, 0))
    planes, owner, saved = through_gaps(rows, [900.0, 50, 40, -5], [0])
    assert_array_equal(owner, [0, 0, -1, -1])
    assert_array_equal(saved, [950])
    assert_array_equal(planes, rows[:1])


def test_a_piece_that_may_lie_on_two_planes_is_on_the_nearer_one():
    rows = np.vstack((patches((0, 0), (3, 0.05)), patches((6, 0.015), (9, 0.035), sigma=0.03)))
    _, owner, saved = through_gaps(rows, [900.0, 800, 9, 8], [0, 1])
    assert_array_equal(owner, [0, 1, 0, 1])
    assert_array_equal(saved, [909, 808])


@pytest.mark.parametrize(("others", "joins"), [(0, True), (10, True), (300, False)])
def test_the_more_segments_there_are_the_longer_it_takes_to_say_which_one(others, joins):
    """Here a piece tells 4 nats: enough to say which of fifty."""
    rows = np.vstack((patches((0, 0)), patches((1.5, 0), sigma=0.1), patches(*[(9, 9)] * others)))
    rows[2:, [NX, NZ]] = 1.0, 0.0
    _, owner, _ = through_gaps(rows, [900.0, 9] + [-1.0] * others, [0])
    assert owner[1] == (0 if joins else -1)


@pytest.mark.parametrize(
    ("worth", "least", "pays"),
    [((40, 30), 0, True), ((32, 25), 0, False), ((40, 30), 15, False), ((900,), 0, False)],
)
def test_pieces_pay_together_if_clearly(worth, least, pays):
    """Their parameters, 30 nats, once, and as much again; one by itself is none."""
    rows = patches(*[(3 * k, 0) for k in range(len(worth))])
    planes, owner, saved = through_gaps(rows, worth, least=least)
    assert len(planes) == len(saved) == pays
    assert (owner == (0 if pays else -1)).all()
    assert saved.sum() == pays * (sum(worth) - 30)


def test_pieces_that_disagree_pay_for_that(monkeypatch):
    rows = patches((0, 0), (3, 5e-4), (6, 0.5), (9, 0))
    planes, owner, saved = through_gaps(rows, [60.0, 50, 40, 5])
    assert_array_equal(owner, [0, 0, -1, 0])
    assert planes[0, MISFIT] > 1
    assert_allclose(saved, 60 + 50 + 5 - 30 - 0.5 * planes[0, MISFIT])
    for height, pays in ((0.0, True), (5e-4, False)):  # 30.2 nats less what they disagree
        assert len(through_gaps(patches((0, 0), (3, height)), [40.0, 20.2])[0]) == pays
    monkeypatch.setattr(gaps, "_MOST_TOGETHER", 2)  # of which the last is none, then
    planes, owner, saved = through_gaps(rows, [60.0, 50, 40, 5])
    assert_array_equal(owner, [0, 0, -1, 0])
    assert_allclose(saved, 60 + 50 + 5 - 30 - 0.5 * planes[0, MISFIT])


def test_all_pairs_are_looked_at_however_many():
    rows = patches(*[(k, 0) for k in range(12)], (0, 2), (1, 2))
    every = gaps._Gaps((0.0, 0.0), (0.0, 0.1, 0.25), 1.0)
    ends, _ = every._pairs(rows, len(rows))
    of_one = [(i, j) for j in range(12) for i in range(j)] + [(12, 13)]
    assert sorted(map(tuple, ends.tolist())) == sorted(of_one)


def test_points_of_groups_that_are_off_are_on_none():
    labels = np.array([1, 2, 1, 0, 2, 2, 1], np.uint16)
    starts, places = np.array([0, 4, 7]), np.array([0, 3, 5])
    label, off = np.array([0, 1, 2, 1, 2]), np.array([False, False, True, True, False])
    cloud_planes.leave_out(label, places, off, np.array([False, True, True]), starts, 0, 2, labels)
    assert_array_equal(labels, [1, 0, 1, 0, 2, 2, 0])
    cloud_planes.leave_out(label, places, ~off, np.array([True, False, True]), starts, 0, 2, labels)
    assert_array_equal(labels, [1, 0, 1, 0, 0, 0, 0])


def ranked(monkeypatch, points, worth, saved, curves):
    """Order and curve of planes of such worth; what Phi is for each list of them is told."""

    def ledger(*given):
        order = given[8] if len(given) > 8 else np.argsort(worth)
        curve = np.array(curves[tuple(order.tolist())], float)
        return SimpleNamespace(order=order, worth=worth, saved=saved, curve=curve)

    monkeypatch.setattr(weighing, "ledger", ledger)
    cloud = SimpleNamespace(local=np.empty((points, 3)))
    found, curve = weighing._ranked(cloud, None, None, None, None, len(worth), LIMITS)
    return found.order.tolist(), curve.tolist()


WORTH = np.array([-300.0, -100, -500, -200])  # parameters take 28 nats
SAVED = np.array([-900.0, -100, -800, -50])


@pytest.mark.parametrize(("points", "third"), [(1 << 17, []), (1 << 13, [-790])])
def test_planes_pay_clearly_and_with_those_that_are_worth_more(monkeypatch, points, third):
    """Five times their parameters, in small clouds once: the last as worth has them, but there.

    The third raises Phi and is cut. Those that pay are in the order of what they save.
    """
    curves = {(2, 0, 3, 1): [0, -480, -770, -760, -790]}
    curves |= {(0, 2, 1, 3): [0, -500, -770, -790, -700]}
    order, curve = ranked(monkeypatch, points, WORTH, SAVED, curves)
    assert order == [0, 2, 1, 3]
    assert curve == [0, -500, -770, *third]


def test_planes_that_pay_only_together_with_those_that_are_cut_are_kept(monkeypatch):
    curves = {(2, 0, 3, 1): [0, -480, -470, -770, -700]}
    curves |= {(2, 3, 0, 1): [0, -400, -600, -700, -650]}  # without what raises Phi
    curves |= {(0, 2, 3, 1): [0, -490, -500, -770, -700]}
    order, curve = ranked(monkeypatch, 1 << 17, WORTH, SAVED, curves)
    assert order == [0, 2, 3, 1]
    assert curve == [0, -490, -500, -770]


@pytest.mark.skipif(not SCAN.exists(), reason="real scans are not part of the project")
def test_points_far_off_what_a_plane_becomes_part_of_are_left_out():
    """A small plane that leans reaches far off the ground it becomes part of."""
    points = pw.read_cloud(SCAN).points
    sensor = pw.Sensor(max_depth=100.0, resolution=0.01, noise=0.0058)
    found = pw.detect_planes_in_points(points, sensor)
    largest = found.planes[0]
    assert largest.count > 25_000  # of 15,159, 8,120 and 6,123 points in two centimetres
    off = points[found.labels == 1] @ largest.normal + largest.distance
    assert np.abs(off).max() < 0.1
