"""Sheets that least cubes have cut into slices are put together again."""

import numpy as np
import pytest

import planewise as pw
from planewise.clouds import cells as stage
from planewise.clouds import model
from planewise.clouds.cells import cells_of
from planewise.clouds.cloud import cloud_of
from planewise.kernels.cloud_keys import TURN
from planewise.kernels.cloud_rows import AREA, COUNT

SIGMA = 0.03


def cloud(points):
    return cloud_of(points, pw.Sensor(max_depth=8.0, noise=SIGMA), None, 1)


def wall(count, rng, width=3.0, height=2.0):
    return np.column_stack(
        (rng.uniform(0, width, count), rng.uniform(0, height, count), rng.normal(0, SIGMA, count))
    )


def turned(points, seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return points @ (q * np.sign(np.diag(r))).T


@pytest.mark.parametrize("seed", range(3))
def test_slices_of_one_sheet_are_one_cell(seed, monkeypatch):
    made = cloud(turned(wall(300_000, np.random.default_rng(seed)), seed))
    assert made.cuts_sheets(1.0)
    whole = cells_of(made)
    monkeypatch.setattr(stage, "_whole_sheets", lambda cloud, cells, error: cells)
    sliced = cells_of(made)
    assert len(whole.rows) < 0.8 * len(sliced.rows)
    assert whole.rows[:, COUNT].sum() == sliced.rows[:, COUNT].sum()
    assert 6.0 < whole.rows[:, AREA].sum() < 0.95 * sliced.rows[:, AREA].sum()
    # The same cubes, each in the cell that its own has become part of.
    assert np.array_equal(whole.owner >= 0, sliced.owner >= 0)
    pairs = np.unique(np.column_stack((sliced.owner, whole.owner)), axis=0)
    assert len(pairs) == len(np.unique(sliced.owner))


def test_sheets_a_cube_apart_stay_two():
    rng = np.random.default_rng(0)
    low, high = wall(150_000, rng), wall(150_000, rng)
    high[:, 2] += 8.0 * SIGMA
    made = cloud(turned(np.vstack((low, high)), 1))
    cells = cells_of(made)
    assert cells.rows[:, COUNT].max() < 0.1 * len(low)
    found = pw.detect_planes_in_points(
        turned(np.vstack((low, high)), 1), pw.Sensor(max_depth=8.0, noise=SIGMA)
    )
    assert len(found) == 2
    assert [(plane.count / len(low)) for plane in found.planes] == pytest.approx([1, 1], abs=0.02)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("count", "apart"), [(5_000, 15.0), (20_000, 12.0), (20_000, 10.0)])
def test_sheets_side_by_side_along_an_axis_are_two(axis, count, apart):
    """Floors are level and walls upright: there the grid must not be worse than elsewhere."""
    rng, sigma = np.random.default_rng(axis), 0.01
    sheet = np.repeat([0.0, 1.0], count)
    height = sigma * (apart * sheet + rng.normal(size=2 * count))
    points = np.roll(np.column_stack((rng.uniform(0, 3, (2 * count, 2)), height)), axis, axis=1)
    found = pw.detect_planes_in_points(points, pw.Sensor(max_depth=10.0, noise=sigma))
    assert len(found) == 2
    assert (found.labels == 2 - (sheet == sheet[found.labels == 1][0])).mean() > 0.99


def test_cubes_lie_at_all_heights_against_the_axes():
    places = np.stack(np.meshgrid(*[np.arange(-9, 10)] * 3), axis=-1).reshape(-1, 3)
    for normal in TURN.T:
        heights = np.sort((places @ normal)[np.abs(places @ normal) < 0.9])
        share = np.arange(1, heights.size + 1) / heights.size
        assert np.abs(share - (heights + 0.9) / 1.8).max() < 0.02  # 0.185 at (2, 2, -1) / 3


def test_thin_sheets_are_left_alone(monkeypatch):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr(stage, "_whole_sheets", never)
    assert cells_of(cloud(turned(wall(200, np.random.default_rng(0)), 0))) is not None


@pytest.mark.parametrize(("count", "sigma"), [(100_000, 0.03), (300_000, 0.03), (1_000_000, 0.02)])
def test_all_faces_of_a_dense_cube_are_found(count, sigma):
    rng = np.random.default_rng(101)
    face, points = rng.integers(0, 6, count), rng.uniform(-0.5, 0.5, (count, 3))
    points[np.arange(count), face // 2] = np.where(face % 2, 0.5, -0.5)
    points += rng.normal(0, sigma, points.shape)
    found = pw.detect_planes_in_points(turned(points, 2), pw.Sensor(max_depth=2.0, noise=sigma))
    assert len(found) == 6
    table = np.zeros((6, 7))
    np.add.at(table, (face, found.labels), 1)
    assert (table[:, 1:].max(axis=1) > 0.85 * table.sum(axis=1)).all()
    assert found.information == min(found.curve)


@pytest.mark.parametrize("tile", [None, 50_000])
def test_corners_that_cubes_cut_off_two_sheets_are_no_plane(tile, tmp_path, monkeypatch):
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 1, (400_000, 3)) * (1.5, 1.0, 0.0)
    sheet = rng.integers(0, 2, len(points))
    points[:, 2] = 0.02 * sheet + rng.normal(0, 0.002, len(points))
    points = turned(points, 4)
    sensor = pw.Sensor(max_depth=30.0, noise=0.002)
    found = detected(points, sensor, tile, tmp_path)
    assert len(found) == 2
    assert (found.labels > 0).mean() > 0.9999
    here = found.labels == found.labels[0]
    assert (here == (sheet == sheet[0])).all()
    # Nor do they make Phi smaller.
    monkeypatch.setattr(model, "lost_most", lambda *_: np.zeros(_[-1], np.bool_))
    across = detected(points, sensor, tile, tmp_path)
    assert len(across) > 2
    assert found.information < across.information - 1000


def test_planes_that_lost_their_points_stay_where_phi_is_larger_without(monkeypatch):
    rng = np.random.default_rng(0)
    low, high = wall(20_000, rng), wall(20_000, rng)
    high[:, 2] += 2.0
    points = turned(np.vstack((low, high)), 0)
    sensor = pw.Sensor(max_depth=8.0, noise=SIGMA)
    as_it_is = pw.detect_planes_in_points(points, sensor)
    assert len(as_it_is) == 2
    monkeypatch.setattr(model, "lost_most", lambda *given: np.arange(given[-1]) == 0)
    found = pw.detect_planes_in_points(points, sensor)
    assert np.array_equal(found.labels, as_it_is.labels)


def detected(points, sensor, tile, folder):
    if tile is None:
        return pw.detect_planes_in_points(points, sensor)
    np.save(folder / "points.npy", points)
    return pw.detect_planes_in_cloud(folder / "points.npy", sensor, tile_points=tile)
