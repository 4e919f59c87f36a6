"""Scans of E57 and PTX files as images: rows and columns, which way up, and which scan."""

import json

import numpy as np
import pye57
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import planewise as pw
from planewise.errors import PlanewiseError
from planewise.files.cloud import open_cloud
from planewise.files.depth import read_depth
from planewise.files.scans import gridded, upright
from tests.command import run
from tests.e57_files import spherical_e57

ROWS, COLUMNS = 48, 100
AXES = ("cartesianX", "cartesianY", "cartesianZ")


@pytest.fixture(scope="module")
def scene():
    camera = pw.SphericalCamera.spinning(np.linspace(80, -60, ROWS), COLUMNS)
    return pw.scenes.panorama(1, camera=camera, lost=0.05)


@pytest.fixture(scope="module")
def points(scene):
    return np.nan_to_num(scene.camera.points(0.001 * scene.depth))


def fields(points, rgb, rows=slice(None), columns=slice(None), seed=0):
    """Columns of a scan, in any order; `rows` and `columns` of the image lie where 0, 1 ... do."""
    points, rgb = points[rows, columns], rgb[rows, columns]
    row, column = np.nonzero(points.any(axis=2))
    order = np.random.default_rng(seed).permutation(len(row))
    row, column = row[order], column[order]
    out = dict(zip(AXES, points[row, column].T.copy(), strict=True))
    names = ("colorRed", "colorGreen", "colorBlue")
    out |= dict(zip(names, rgb[row, column].T.copy(), strict=True))
    return out | {"rowIndex": row + 7, "columnIndex": column + 300}


def write(path, *scans):
    with pye57.E57(str(path), mode="w") as file:
        for data in scans:
            pose = np.array([0.9, 0.1, -0.2, 0.3])
            pose /= np.linalg.norm(pose)
            file.write_scan_raw(data, rotation=pose, translation=np.array([5e5, 4e6, 30]))


@pytest.mark.parametrize("rows", [slice(None), slice(None, None, -1)])
@pytest.mark.parametrize("columns", [slice(None), slice(None, None, -1)])
def test_rows_and_columns_are_an_upright_image(tmp_path, scene, points, rows, columns):
    path = tmp_path / "scan.e57"
    write(path, fields(points, scene.rgb, rows, columns))
    frame = read_depth(path)
    there = points.any(axis=2)
    assert_allclose(frame.depth, np.linalg.norm(points, axis=2), atol=2e-6)
    assert_array_equal(frame.rgb[there], scene.rgb[there])
    assert not frame.rgb[~there].any()
    assert_allclose(
        frame.camera.rays(frame.depth.shape), scene.camera.rays(frame.depth.shape), atol=1e-5
    )


def test_an_image_of_range_and_angles(tmp_path, points):
    row, column = np.nonzero(points.any(axis=2))
    x, y, z = points[row, column].T
    polar = {
        "sphericalRange": np.linalg.norm(points[row, column], axis=1),
        "sphericalAzimuth": np.arctan2(y, x),
        "sphericalElevation": np.arctan2(z, np.hypot(x, y)),
        "rowIndex": row.astype(float),
        "columnIndex": column.astype(float),
    }
    spherical_e57(tmp_path / "scan.e57", [(polar, None)])
    frame = read_depth(tmp_path / "scan.e57")
    assert_allclose(frame.depth, np.linalg.norm(points, axis=2), atol=2e-6)
    assert frame.rgb is None


@pytest.mark.parametrize("degrees", [0.0, 0.7])
def test_the_command_finds_the_planes_of_a_scan(tmp_path, scene, points, degrees):
    path, tilt = tmp_path / "scan.e57", Rotation.from_euler("x", degrees, degrees=True)
    write(path, fields(points @ tilt.as_matrix().T, scene.rgb))
    code, _, errors = run("detect", path, "--noise", "2mm", "-o", tmp_path / "out")
    assert (code, errors) == (0, "")
    told = json.loads((tmp_path / "out" / "planes.json").read_text())
    model = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    assert len(told["planes"]) == pytest.approx(len(model), abs=1)
    assert ("turn" in told["camera"]) == (degrees > 0)
    assert_allclose(told["planes"][0]["normal"], tilt.apply(model.planes[0].normal), atol=1e-3)


def test_a_scanner_sees_as_far_as_its_points_lie(tmp_path, scene, points):
    path, out = tmp_path / "scan.e57", tmp_path / "out"
    farther = 6 * points
    write(path, fields(farther, scene.rgb))
    farthest = np.linalg.norm(farther, axis=2).max()
    assert farthest > 12
    for given, limit in (((), farthest), (("--max-depth", 12), 12), (("--sensor", "nyu"), 10)):
        code, _, _ = run("detect", path, "--noise", "12mm", *given, "-o", out)
        told = json.loads((out / "planes.json").read_text())
        assert code == 0
        assert told["sensor"]["max_depth_m"] == pytest.approx(limit, rel=1e-6)
        assert (told["readings"] == np.count_nonzero(points.any(axis=2))) == (limit == farthest)


def test_one_scan_of_several_is_chosen(tmp_path, scene, points):
    path, further = tmp_path / "scans.e57", 2 * points
    write(path, fields(points, scene.rgb), fields(further, scene.rgb))
    assert_allclose(read_depth(path, scan=1).depth, np.linalg.norm(further, axis=2), atol=4e-6)
    code, _, errors = run("detect", path, "--noise", "2mm", "-o", tmp_path / "out")
    assert code == 2
    assert "holds 2 scans, each an image of its own: --scan says which, 0 to 1" in errors
    code, _, errors = run("detect", path, "--scan", 2, "--noise", "2mm", "-o", tmp_path / "out")
    assert (code, "holds scans 0 to 1, and no scan 2" in errors) == (2, True)
    assert not (tmp_path / "out").exists()
    code, _, errors = run("detect", path, "--scan", 1, "--noise", "2mm", "-o", tmp_path / "out")
    assert (code, errors) == (0, "")


def test_only_files_of_scans_have_scans(tmp_path):
    np.save(tmp_path / "depth.npy", np.ones((48, 64)))
    with pytest.raises(PlanewiseError, match=r"^depth: depth\.npy holds no scans to choose from"):
        read_depth(tmp_path / "depth.npy", scan=0)
    code, _, errors = run(
        "detect", tmp_path, "--scan", 0, "--camera", "nyu", "--noise", "2mm", "-o", tmp_path / "out"
    )
    assert (code, errors.startswith("error: scan: ")) == (2, True)


def test_what_is_no_image_is_refused(tmp_path, scene, points, monkeypatch):
    path = tmp_path / "scan.e57"
    whole = fields(points, scene.rgb)
    write(path, {name: values for name, values in whole.items() if name != "rowIndex"})
    with pytest.raises(PlanewiseError, match=r"^depth: scan\.e57 has points without rowIndex and"):
        read_depth(path)
    polar = {"sphericalRange": 2.0, "sphericalAzimuth": 0.1, "sphericalElevation": 0.2}
    polar = {name: np.full(9, value) for name, value in polar.items()}
    polar |= {"rowIndex": np.arange(9.0), "columnIndex": np.arange(9.0)}
    spherical_e57(path, [(polar | {"sphericalInvalidState": np.ones(9, np.int8)}, None)])
    with pytest.raises(PlanewiseError, match=r"^depth: scan\.e57 has no valid points in scan 0"):
        read_depth(path)
    write(path, whole | {"rowIndex": whole["rowIndex"] * 9})
    monkeypatch.setattr("planewise.files.depth.MAX_PIXELS", 40_000)
    with pytest.raises(PlanewiseError, match=r"^depth: scan\.e57 claims 42,400 values; at most"):
        read_depth(path)


def test_points_that_have_not_a_bit_each_are_refused(tmp_path):
    path, names = tmp_path / "scan.e57", ("Range", "Azimuth", "Elevation")
    nothing = np.zeros(200_000, np.uint8)
    spherical = {f"spherical{name}": nothing for name in names}
    spherical_e57(path, [(spherical | {"rowIndex": nothing, "columnIndex": nothing}, None)])
    for read in (open_cloud, read_depth):
        with pytest.raises(PlanewiseError, match="claims 200,000 points, which cannot be in a fi"):
            read(path)


def test_the_nearest_of_several_points_counts():
    points = np.array([[3.0, 0, 1], [2, 0, 1], [4, 0, 1], [5, 1, 0]])
    places = np.array([[4.0, 4], [4, 4], [4, 4], [5, 6]])
    grid, colour = gridded(points, np.arange(12, dtype=np.uint8).reshape(4, 3), places)
    assert_array_equal(grid[0, 0], points[1])
    assert_array_equal(grid[1, 2], points[3])
    assert_array_equal(colour[0, 0], [3, 4, 5])
    assert np.isnan(grid[0, 1:]).all()
    assert grid.shape == colour.shape == (2, 3, 3)
    with pytest.raises(PlanewiseError, match="no numbers"):
        gridded(points, None, np.where(places == 6, np.nan, places))


def test_images_of_cameras_stay_as_they_are():
    camera = pw.PinholeCamera(fx=50.0, fy=50.0, cx=31.5, cy=23.5)
    image = pw.image_of_points(2.0 * camera.rays((48, 64)))
    assert upright(image, None) == (image, None)


def test_an_image_that_is_upright_stays(scene, points):
    image = pw.image_of_points(points)
    same, rgb = upright(image, scene.rgb)
    assert same.camera == image.camera
    assert_array_equal(same.depth, image.depth)
    assert_array_equal(rgb, scene.rgb)
