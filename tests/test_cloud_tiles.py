"""Clouds in tiles on a disk: the result of one piece, whatever the tiles; nothing is left."""

import errno
import json
import os
import tracemalloc
from itertools import pairwise

import laspy
import numpy as np
import plyfile
import pytest
from benchmarks.building import building
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.clouds import segments as cloud_segments
from planewise.clouds.cells import cells_of
from planewise.clouds.cloud import cloud_of
from planewise.clouds.memory import Disk, Memory
from planewise.clouds.tiles import tile_bounds, tiled_cloud
from planewise.detect_in_cloud import detect_planes_in_cloud, points_on_disk
from planewise.errors import PlanewiseError
from planewise.point_cloud import extent_of_most
from tests.command import run

SENSOR = pw.Sensor(max_depth=20.0, resolution=0.001, noise=0.01)
POINTS = building(300_000).points


@pytest.fixture(scope="module")
def one_piece():
    return pw.detect_planes_in_points(POINTS, SENSOR, max_planes=200)


def same(model, other):
    """Whether two models are one and the same, sums in another order aside."""
    assert_array_equal(model.labels, other.labels)
    assert_allclose(model.coefficients, other.coefficients, rtol=0, atol=1e-12)
    assert_allclose(list(model.curve), list(other.curve), rtol=1e-12)
    for mine, its in zip(model.planes, other.planes, strict=True):
        assert_allclose(mine.covariance, its.covariance, rtol=1e-9)
        assert (mine.count, mine.area) == pytest.approx((its.count, its.area))
        # Eigenvalues of cells are told to the root of the rounding.
        white = pytest.approx(its.residual_correlation, rel=1e-6, abs=1e-7, nan_ok=True)
        assert mine.residual_correlation == white


@pytest.mark.parametrize("tile_points", [20_000, 100_000])
def test_tiles_give_what_one_piece_gives(one_piece, tile_points, tmp_path):
    path = tmp_path / "building.npy"
    np.save(path, POINTS)
    model = pw.detect_planes_in_cloud(path, SENSOR, tile_points=tile_points, max_planes=200)
    assert len(model) > 90
    same(model, one_piece)
    assert [each.name for each in tmp_path.iterdir()] == ["building.npy"]


def test_thick_sheets_are_the_same_in_tiles_and_for_any_threads(tmp_path):
    points, sensor = building(150_000, sigma=0.03).points, pw.Sensor(max_depth=20.0, noise=0.03)
    model = pw.detect_planes_in_points(points, sensor)
    assert len(model) > 40
    assert cloud_of(points, sensor, None, 1).cuts_sheets(1.0)
    np.save(tmp_path / "building.npy", points)
    tiled = pw.detect_planes_in_cloud(tmp_path / "building.npy", sensor, tile_points=20_000)
    same(tiled, model)
    alone = pw.detect_planes_in_points(points, sensor, threads=1)
    assert_array_equal(alone.labels, model.labels)
    assert alone.information == model.information


@pytest.mark.parametrize("told", [0.001, 0.0001])
def test_a_sigma_that_is_too_small_is_raised_in_tiles_as_in_one_piece(told, tmp_path):
    sensor = pw.Sensor(max_depth=20.0, resolution=0.001, noise=told)
    whole = pw.detect_planes_in_points(POINTS[:100_000], sensor)
    tiled = pw.detect_planes_in_cloud(
        pw.PointCloud(points=POINTS[:100_000]), sensor, tile_points=30_000, folder=tmp_path
    )
    assert len(whole) > 30
    same(tiled, whole)


def test_there_is_no_limit_to_planes_unless_it_is_asked_for(one_piece):
    model = detect_planes_in_cloud(pw.PointCloud(points=POINTS), SENSOR, tile_points=100_000)
    same(model, one_piece)
    assert len(model) > 90
    assert model.settings["max_planes"] is None


def test_a_small_cloud_is_searched_in_memory(one_piece):
    cloud = pw.PointCloud(points=POINTS)
    same(detect_planes_in_cloud(cloud, SENSOR, tile_points=10**6, max_planes=200), one_piece)


def test_tiles_with_rays_far_points_and_rows_that_are_none():
    points = POINTS[:40_000].astype(np.float32)
    points[5], points[6], points[7] = np.nan, (np.inf, 0, 0), (9e6, 0, 0)
    origin = np.array([2.0, 2.0, 1.5])
    whole = pw.detect_planes_in_points(points, SENSOR, origin=origin)
    cloud = pw.PointCloud(points=points)
    same(detect_planes_in_cloud(cloud, SENSOR, origin=origin, tile_points=6_000), whole)
    assert not whole.labels[5:8].any()


@pytest.mark.parametrize("noise", [pw.noise.proportional(0.005), "auto"])
def test_missing_returns_in_tiles(noise):
    sensor = pw.Sensor(max_depth=20.0, resolution=0.001, noise=noise)
    points = POINTS[:40_000].copy()
    points[::9], points[5] = 0.0, np.nan
    given = points.copy()
    whole = pw.detect_planes_in_points(points, sensor)
    tiled = detect_planes_in_cloud(pw.PointCloud(points=points), sensor, tile_points=6_000)
    same(tiled, whole)
    assert_array_equal(points, given)
    assert not whole.labels[::9].any()
    assert whole.readings == tiled.readings == np.count_nonzero(points.any(axis=1)) - 1
    assert len(whole) > 5


def test_phi_of_the_least_noise_is_a_number_in_tiles():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 5, (1500, 3))
    points[:750, 0], points[750:, 1] = 0.0, 0.0
    sensor = pw.Sensor(max_depth=100.0, resolution=1e-12, noise="auto")
    model = detect_planes_in_cloud(pw.PointCloud(points=points), sensor, tile_points=100)
    assert len(model) == 2
    assert np.isfinite(model.information)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_tiles_with_a_sigma_and_a_scanner_for_every_point(tmp_path, kind):
    points = POINTS[:60_000].astype(kind)
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.008, 0.012, len(points))
    places = np.array([[2.5, 2.0, 1.4], [7.7, 2.0, 1.4], [2.5, 6.2, 4.5]])
    scan = ((points[:, None] - places) ** 2).sum(axis=2).argmin(axis=1)
    cloud = pw.PointCloud(points=points)
    whole = pw.detect_planes_in_points(points, SENSOR, sigma=sigma, max_planes=200)
    np.save(tmp_path / "sigma.npy", sigma)
    mapped = np.load(tmp_path / "sigma.npy", mmap_mode="r")
    found = detect_planes_in_cloud(cloud, SENSOR, sigma=mapped, tile_points=9_000, max_planes=200)
    same(found, whole)
    whole = pw.detect_planes_in_points(points, SENSOR, origin=places[scan])
    same(
        detect_planes_in_cloud(cloud, SENSOR, origin=places[scan], tile_points=9_000),
        whole,
    )
    both = {"sigma": sigma, "origin": places[scan]}
    whole = pw.detect_planes_in_points(points, SENSOR, **both)
    same(detect_planes_in_cloud(cloud, SENSOR, **both, tile_points=9_000), whole)
    # What a file says of its scans.
    path = tmp_path / "scans.npz"
    np.savez(path, points=points, scan=scan, origins=places)
    whole = pw.detect_planes_in_points(points, SENSOR, origin=places[scan])
    for size in (9_000, 10**6):
        same(detect_planes_in_cloud(path, SENSOR, origin="file", tile_points=size), whole)


def test_scans_that_the_file_does_not_know():
    cloud = pw.PointCloud(
        points=POINTS[:100], scan=np.full(100, 2, np.int32), origins=np.zeros((2, 3))
    )
    with pytest.raises(PlanewiseError, match=r"name scans 2 to 2, but the file says of 2"):
        detect_planes_in_cloud(cloud, SENSOR, origin="file")
    unnamed = pw.PointCloud(points=POINTS[:100], origins=np.zeros((2, 3)))
    with pytest.raises(PlanewiseError, match="where 2 scanners stood, but not whose each point is"):
        detect_planes_in_cloud(unnamed, SENSOR, origin="file")
    with pytest.raises(PlanewiseError, match="does not say where its scanner stood"):
        detect_planes_in_cloud(pw.PointCloud(points=POINTS[:100]), SENSOR, origin="file")


def test_sorted_tiles_are_the_sorted_cloud():
    points = np.random.default_rng(0).permutation(POINTS)[:60_000]
    whole = cloud_of(points, SENSOR, None, 2)
    tiled = tiled_cloud(points, SENSOR, None, None, 2, 7_000, Disk())
    assert len(tiled.parts) > 4
    for name in ("local", "starts", "cubes", "about", "nodes", "variance"):
        assert_array_equal(getattr(tiled, name), getattr(whole, name), err_msg=name)
    assert_array_equal(tiled.rows, whole.rows)


def test_tiles_hold_no_more_than_they_may_and_cut_no_block_that_fits():
    rng = np.random.default_rng(1)
    cubes = np.unique(rng.integers(0, 1 << 30, 3000).astype(np.uint64))
    starts = np.append(0, np.cumsum(rng.integers(1, 9, len(cubes))))
    for most in (10, 100, 5000, 10**6):
        parts = tile_bounds(cubes, starts, most)
        assert parts[0][0] == 0
        assert parts[-1][1] == len(cubes)
        assert all(a[1] == b[0] for a, b in pairwise(parts))
        assert all(starts[b] - starts[a] <= most for a, b in parts)
        block = cubes >> np.uint64(24)  # the largest cubes that cells may have
        held = dict(
            zip(*np.unique(np.repeat(block, np.diff(starts)), return_counts=True), strict=True)
        )
        for first, _ in parts[1:]:
            assert block[first] != block[first - 1] or held[block[first]] > most


def test_cells_that_are_too_many_merge_in_runs():
    cells = cells_of(cloud_of(POINTS, SENSOR, None, 2))
    cost = 3 * np.log(2e4)
    rows, of_cell, _ = cloud_segments.merged_cells(cells, cost, 2, Memory())
    for at_once in (len(cells.ends) // 3, len(cells.ends) // 8):
        few, of_few, _ = cloud_segments.merged_cells(cells, cost, 2, Memory(), at_once)
        # The same cells are together: of each segment, those in the one that most of them are in.
        table = np.zeros((len(rows), len(few)), np.int64)
        np.add.at(table, (of_cell, of_few), 1)
        assert table.max(axis=1).sum() > 0.995 * len(of_cell)
        assert table.max(axis=0).sum() > 0.995 * len(of_cell)
        assert abs(len(few) / len(rows) - 1) < 0.02


def test_merging_in_runs_finds_the_same_planes(one_piece, monkeypatch):
    merged = cloud_segments.merged_cells
    monkeypatch.setattr(
        cloud_segments,
        "merged_cells",
        lambda cells, cost, workers, memory: merged(
            cells, cost, workers, memory, len(cells.ends) // 4
        ),
    )
    cloud = pw.PointCloud(points=POINTS)
    model = detect_planes_in_cloud(cloud, SENSOR, tile_points=80_000, max_planes=200)
    assert abs(len(model) - len(one_piece)) <= 1
    table = np.zeros((len(one_piece) + 1, len(model) + 1), np.int64)
    np.add.at(table, (one_piece.labels, model.labels), 1)
    assert table.max(axis=0).sum() >= 0.995 * len(POINTS)
    for j, plane in enumerate(one_piece.planes[:50], start=1):
        other = model.planes[table[j, 1:].argmax()]
        sigma = np.sqrt(np.diag(plane.covariance))
        assert (np.abs(other.coefficients - plane.coefficients) < sigma + 1e-12).all()


def test_too_few_points():
    points = np.full((100, 3), np.nan)
    points[:2] = 1.0
    model = detect_planes_in_cloud(pw.PointCloud(points=points), SENSOR, tile_points=10)
    assert "2 finite points" in model.note
    assert model.labels.shape == (100,)


def test_equal_points_stay_in_one_tile():
    points = np.ones((5_000, 3))
    model = detect_planes_in_cloud(pw.PointCloud(points=points), SENSOR, tile_points=1_000)
    assert len(model) == 0
    assert model.readings == 5_000


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        *(
            ({"tile_points": bad}, "tile_points must be a whole number of at least 1, got")
            for bad in (0, 1.5, float("nan"), "a", True)
        ),
        ({"origin": (0, 0)}, "origin must be one place or one a point"),
        ({"origin": (0, 0, np.nan)}, "origin must be finite"),
        ({"origin": "here"}, "origin must be coordinates or 'file', got 'here'"),
        ({"sigma": np.ones(3)}, "sigma must hold one number a point"),
        ({"sigma": np.full(100, np.nan)}, "sigma must be positive and finite"),
        ({"max_planes": 0}, "max_planes must lie"),
        ({"folder": 3}, "folder must be a path, got 3"),
    ],
)
def test_wrong_arguments(wrong, message):
    with pytest.raises(ValueError, match=message):
        detect_planes_in_cloud(pw.PointCloud(points=POINTS[:100]), SENSOR, **wrong)


def test_a_folder_that_is_not_there(tmp_path):
    cloud = pw.PointCloud(points=POINTS[:1000])
    with pytest.raises(PlanewiseError, match="takes no temporary files"):
        detect_planes_in_cloud(cloud, SENSOR, tile_points=100, folder=tmp_path / "none")


def test_a_full_disk_is_an_error_in_one_line(monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    cloud = pw.PointCloud(points=POINTS[:1000])
    with pytest.raises(PlanewiseError, match=r"cannot be written \(No space left"):
        detect_planes_in_cloud(cloud, SENSOR, tile_points=100)


def test_arrays_on_a_disk_are_arrays(tmp_path):
    disk = Disk(tmp_path)
    array = disk.empty((1000, 3), np.float32)
    array[:] = np.arange(3000).reshape(1000, 3)
    disk.release()
    assert array[999, 2] == 2999
    assert disk.empty(0, np.int64).shape == (0,)
    for memory in (disk, Memory()):
        rows, numbers = memory.growing(np.int32, 2), memory.growing(np.float64)
        assert numbers.array().shape == (0,)
        rows.append(np.ones((3, 2), np.int32))
        rows.append(np.zeros((0, 2), np.int32))
        rows.append(np.full((1, 2), 7, np.int32))
        assert_array_equal(rows.array(), [[1, 1], [1, 1], [1, 1], [7, 7]])
        assert memory.growing(np.int32, 2).array().shape == (0, 2)
    assert not list(tmp_path.iterdir())  # their files have no name


def test_points_of_a_file_are_read_once_in_blocks(tmp_path):
    path = tmp_path / "cloud.npy"
    np.save(path, np.tile(POINTS, (4, 1)))
    tracemalloc.start()
    cloud = points_on_disk(pw.open_cloud(path), Disk(tmp_path))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(cloud) == 4 * len(POINTS)
    assert peak < 4e6 * 24  # blocks of a million points, not the file
    assert_array_equal(cloud.points[-len(POINTS) :], POINTS)
    box, strays = extent_of_most(cloud.points)
    assert strays == 0
    assert_array_equal(box, (POINTS.min(axis=0), POINTS.max(axis=0)))


def test_the_command_writes_the_same_in_tiles(tmp_path):
    path = tmp_path / "building.las"
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales, header.offsets = np.full(3, 1e-4), np.array([500_000.0, 6_000_000.0, 0.0])
    las = laspy.LasData(header)
    las.xyz = POINTS[:50_000] + header.offsets
    las.write(path)
    for name, tiles in (("whole", "auto"), ("tiled", "9000")):
        code, *text = run(
            "points", path, "--sigma", 0.01, "--tiles", tiles, "--outlines", "-o", tmp_path / name
        )
        assert code == 0, text
    records = [json.loads((tmp_path / n / "planes.json").read_text()) for n in ("whole", "tiled")]
    assert len(records[0]["planes"]) > 20
    assert [p["readings"] for p in records[0]["planes"]] == [
        p["readings"] for p in records[1]["planes"]
    ]
    for name in ("labelled.ply", "labelled.las", "preview.png"):
        a, b = ((tmp_path / folder / name).read_bytes() for folder in ("whole", "tiled"))
        assert a == b, name
    outlines = [
        json.loads((tmp_path / n / "outlines.json").read_text()) for n in ("whole", "tiled")
    ]
    assert len(outlines[0]["features"]) == len(outlines[1]["features"]) > 20
    planes = plyfile.PlyData.read(tmp_path / "tiled" / "labelled.ply")["vertex"]["plane"]
    assert_array_equal(planes, laspy.read(tmp_path / "tiled" / "labelled.las")["plane"])
    assert sorted(each.name for each in tmp_path.iterdir()) == ["building.las", "tiled", "whole"]


def test_the_command_takes_the_scans_of_a_file_in_tiles(tmp_path):
    path, points = tmp_path / "scans.npz", POINTS[:20_000]
    places = np.array([[2.5, 2.0, 1.4], [7.7, 2.0, 1.4]])
    scan = (points[:, 0] > 5).astype(np.int32)
    np.savez(path, points=points, scan=scan, origins=places)
    for name, tiles in (("whole", "auto"), ("tiled", "5000")):
        code, *text = run(
            "points", path, "--origin", "file", "--tiles", tiles, "-o", tmp_path / name
        )
        assert code == 0, text
        assert "m, estimated" in "".join(text)
    whole, tiled = ((tmp_path / n / "labelled.ply").read_bytes() for n in ("whole", "tiled"))
    assert whole == tiled


def test_wrong_tiles_and_damaged_files_leave_nothing(tmp_path):
    path = tmp_path / "cloud.xyz"
    np.savetxt(path, POINTS[:3000])
    for tiles in ("0", "-3", "many"):
        code, *text = run("points", path, "--sigma", 0.01, "--tiles", tiles, "-o", tmp_path / "out")
        assert code == 2
        assert "tiles must be a number of points" in text[1]
    with path.open("a") as stream:
        stream.write("1 2 three\n")
    code, *text = run("points", path, "--sigma", 0.01, "--tiles", 500, "-o", tmp_path / "out")
    assert code == 2
    assert "bad line of points" in text[1]
    assert [each.name for each in tmp_path.iterdir()] == ["cloud.xyz"]
