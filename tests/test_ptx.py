"""PTX files: scans in their poses as clouds, and one scan as the range image that it is."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import planewise as pw
from planewise.errors import PlanewiseError
from planewise.files import ptx
from planewise.files.cloud import open_cloud
from planewise.files.depth import read_depth
from tests.command import run

TURN = Rotation.from_euler("xyz", [2, -1, 40], degrees=True).as_matrix()
PLACE = np.array([592_000.25, 6_740_000.5, 60.0])


def written(points, colour=None, intensity=True, turn=TURN, place=PLACE, end="\n"):
    """A scan of points (rows, columns, 3), the first row highest, as PTX has it."""
    rows, columns, _ = points.shape
    lines = [f"{columns}", f"{rows}", " ".join(map(str, place))]
    lines += [" ".join(map(str, axis)) for axis in turn.T]
    lines += [" ".join(map(str, (*axis, 0))) for axis in turn.T]
    lines.append(" ".join(map(str, (*place, 1))))
    for j in range(columns):
        for i in reversed(range(rows)):
            words = [f"{value:.6f}" for value in points[i, j]]
            words += ["0.500000"] * intensity
            words += [] if colour is None else [str(value) for value in colour[i, j]]
            lines.append(" ".join(words))
    return end.join(lines) + end


@pytest.fixture(scope="module")
def scene():
    camera = pw.SphericalCamera.spinning(np.linspace(80, -60, 48), 100)
    return pw.scenes.panorama(1, camera=camera, lost=0.05)


@pytest.fixture(scope="module")
def points(scene):
    return np.nan_to_num(scene.camera.points(0.001 * scene.depth))


def in_place(points, turn=TURN, place=PLACE):
    """Points with a return in the file's coordinates, column by column from below."""
    columns = points[::-1].swapaxes(0, 1).reshape(-1, 3)
    return columns[columns.any(axis=1)] @ turn.T + place


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("intensity", [True, False])
@pytest.mark.parametrize("coloured", [True, False])
def test_points_are_moved_to_their_pose(tmp_path, scene, points, coloured, intensity, end):
    path = tmp_path / "scan.ptx"
    text = written(points, scene.rgb if coloured else None, intensity, end=end)
    path.write_bytes(text.encode())
    file = open_cloud(path)
    cloud = file.read()
    assert_allclose(cloud.coordinates, in_place(points), atol=2e-6)
    assert_array_equal(cloud.offset, [592_000, 6_740_000, 0])
    assert_allclose(cloud.origins + cloud.offset, [PLACE])
    assert (cloud.scan == 0).all()
    assert file.count is None
    if coloured:
        there = scene.rgb[::-1].swapaxes(0, 1).reshape(-1, 3)
        there = there[points[::-1].swapaxes(0, 1).reshape(-1, 3).any(axis=1)]
        assert_array_equal(cloud.colour, there)
    else:
        assert cloud.colour is None
    assert (cloud.intensity is None) is not intensity
    parts = list(file.chunks(1000))
    assert len(parts) == 5
    assert_allclose(np.concatenate([part.points for part in parts]), cloud.points)


def test_several_scans_say_where_each_was_taken_from(tmp_path, points, monkeypatch):
    path, other = tmp_path / "scans.ptx", PLACE + np.array([3, 4, 0])
    text = written(points) + written(points[:30], turn=np.eye(3), place=other)
    path.write_text(text.removesuffix("\n"))
    monkeypatch.setattr(ptx, "_CHUNK", 1234)  # many to a scan
    cloud = open_cloud(path).read()
    assert_array_equal(np.unique(cloud.scan), [0, 1])
    assert_allclose(cloud.origins + cloud.offset, [PLACE, other])
    assert_allclose(cloud.coordinates[cloud.scan == 0], in_place(points), atol=2e-6)
    second = in_place(points[:30], np.eye(3), other)
    assert_allclose(cloud.coordinates[cloud.scan == 1], second, atol=2e-6)
    with pytest.raises(PlanewiseError, match=r"^depth: scans.ptx holds 2 scans"):
        read_depth(path)
    second = np.linalg.norm(points[:30], axis=-1)
    assert_allclose(read_depth(path, scan=1).depth, second, atol=2e-6)


def test_a_scan_is_a_range_image(tmp_path, scene, points):
    path = tmp_path / "scan.ptx"
    path.write_text(written(points, scene.rgb))
    frame = read_depth(path)
    assert_allclose(frame.depth, np.linalg.norm(points, axis=-1), atol=2e-6)
    assert_array_equal(frame.rgb, scene.rgb)
    assert_allclose(
        frame.camera.rays(frame.depth.shape), scene.camera.rays(frame.depth.shape), atol=1e-5
    )
    code, _, errors = run("detect", path, "--noise", "2mm", "-o", tmp_path / "out")
    assert (code, errors) == (0, "")
    told = json.loads((tmp_path / "out" / "planes.json").read_text())
    model = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    assert len(told["planes"]) == pytest.approx(len(model), abs=1)
    assert_allclose(told["planes"][0]["normal"], model.planes[0].normal, atol=1e-3)


def test_the_command_line_takes_scans_as_clouds(tmp_path, points):
    path = tmp_path / "scan.ptx"
    path.write_text(written(points))
    code, _, errors = run("points", path, "-o", tmp_path / "out")
    assert (code, errors) == (0, "")
    assert len(json.loads((tmp_path / "out" / "planes.json").read_text())["planes"]) > 3


def damaged(text, line, value):
    lines = text.split("\n")
    lines[line] = value
    return "\n".join(lines)


DAMAGED = {
    "cut short": (lambda text: text[: len(text) // 2], "is cut short"),
    "no header": (lambda text: text.split("\n", 10)[-1], "has no header of scan 0"),
    "half a header": (lambda text: "\n".join(text.split("\n")[:6]), "has no header of scan 0"),
    "words": (lambda text: damaged(text, 3, "1 0 up"), "in its line 4, got '1 0 up'"),
    "a side of none": (lambda text: damaged(text, 0, "0"), "claims a grid with a side of 0"),
    "half a column": (lambda text: damaged(text, 0, "4.5"), "claims a grid with a side of 4.5"),
    "too many points": (lambda text: damaged(text, 0, "1000000000"), "cut short or its header"),
    "no number": (lambda text: damaged(text, 1, "nan"), "claims a grid with a side of nan"),
    "no rotation": (lambda text: damaged(text, 6, "2 0 0 0"), "has a pose of scan 0 that is none"),
    "a pose in columns": (lambda text: damaged(text, 6, "1 0 0 5"), "has a pose of scan 0"),
    "two numbers": (lambda text: damaged(text, 10, "1 2"), "has 2 numbers a line"),
    "a bad point": (lambda text: damaged(text, 20, "1 2 x 4"), "has a bad line of points"),
    "more lines": (lambda text: text + "1 2 3 4\n", "has no header of scan 1"),
    "bytes": (lambda _: "\0\1\2\3" * 500, "has no header of scan 0"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_are_refused(tmp_path, points, name):
    change, reason = DAMAGED[name]
    path = tmp_path / "scan.ptx"
    path.write_text(change(written(points)))
    with pytest.raises(PlanewiseError, match=rf"^cloud: scan.ptx .*{reason}"):
        open_cloud(path).read()
    with pytest.raises(PlanewiseError, match=r"^depth: scan.ptx "):
        read_depth(path)


def test_grids_larger_than_any_image_are_refused(tmp_path, points, monkeypatch):
    path = tmp_path / "scan.ptx"
    path.write_text(written(points))
    monkeypatch.setattr("planewise.files.depth.MAX_PIXELS", 1000)
    with pytest.raises(PlanewiseError, match=r"^depth: scan.ptx claims 4,800 values"):
        read_depth(path)
