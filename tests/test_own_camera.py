"""Cameras that are not the package's: other frames, other projections, and what they get wrong."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import jsonschema
import numpy as np
import pytest
from benchmarks.faults import InOrder
from numpy.testing import assert_allclose

import planewise as pw
from planewise import scenes
from planewise.batch import Batch, DepthFolder, Recipe, Store
from planewise.batch.stored_source import camera_of
from planewise.gallery import write_gallery
from planewise.results.planes_json import SCHEMA_FILE, describe_model

SHAPE = (120, 160)
TURN = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Own:
    """A pinhole camera of another class."""

    of: pw.PinholeCamera
    frame = "x right, y down, z forward"
    wraps = False
    bends = False

    @property
    def pixel_size(self):
        return self.of.pixel_size

    def check(self, shape):
        self.of.check(shape)

    def rays(self, shape):
        return self.of.rays(shape)

    def ray_rows(self, shape):
        return self.of.ray_rows(shape)

    def pixel_area(self, shape):
        return self.of.pixel_area(shape)

    def unproject(self, pixels):
        return self.of.unproject(pixels)

    def sectors(self, shape):
        return self.of.sectors(shape)

    def describe(self):
        return {"model": "own"}


class Forward(Own):
    """The same in the frame of ROS: x forward, y left, z up; depth is x."""

    frame = "x forward, y left, z up"

    def rays(self, shape):
        return self.of.rays(shape) @ TURN.T

    def ray_rows(self, shape):
        return TURN @ self.of.ray_rows(shape)

    def unproject(self, pixels):
        return self.of.unproject(pixels) @ TURN.T

    def sectors(self, shape):
        sectors = self.of.sectors(shape)
        return replace(sectors, turn=TURN @ sectors.turn)


class Ranges(Own):
    """Readings are distances from the centre, along unit rays."""

    bends = True

    def rays(self, shape):
        rays = self.of.rays(shape)
        return rays / np.linalg.norm(rays, axis=2, keepdims=True)

    def ray_rows(self, shape):
        return np.moveaxis(self.rays(shape), -1, 0).reshape(3, -1).copy()

    def pixel_area(self, shape):
        return self.of.pixel_area(shape) * self.rays(shape)[..., 2] ** 3

    def unproject(self, pixels):
        rays = self.of.unproject(pixels)
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def sectors(self, shape):
        flat = self.of.sectors(shape)
        return replace(flat, straight=False, ratio=self.rays(shape)[..., 2].astype(np.float32))


@pytest.fixture(scope="module")
def corner():
    return scenes.corner(size=SHAPE)


@pytest.fixture(scope="module")
def planes(corner):
    return pw.detect_planes(corner.depth, corner.camera, corner.sensor)


def test_depth_along_another_axis(corner, planes):
    camera = Forward(corner.camera)
    model = pw.detect_planes(corner.depth, camera, corner.sensor)
    points = pw.observe(corner.depth, camera, corner.sensor).positions().reshape(*SHAPE, 3)
    assert len(model) == len(planes) >= 3
    for label, (plane, same) in enumerate(zip(model.planes, planes.planes, strict=True), start=1):
        assert_allclose(plane.normal, TURN @ same.normal, atol=1e-6)
        assert_allclose(plane.centroid, TURN @ same.centroid, atol=1e-9)
        assert_allclose(plane.centroid, points[model.labels == label].mean(axis=0), atol=1e-5)


def test_noise_of_depth_along_another_axis():
    room = scenes.room(0)
    auto = replace(room.sensor, noise="auto", parts=None)
    found = pw.estimate_noise(room.depth, Forward(room.camera), auto)
    assert found.describe() == pw.estimate_noise(room.depth, room.camera, auto).describe()
    assert found.describe()["source"] == "estimated"


def test_ranges_need_no_columns(corner, planes):
    camera = Ranges(corner.camera)
    depth = corner.depth * corner.sensor.resolution / camera.rays(SHAPE)[..., 2]
    model = pw.detect_planes(depth, camera, replace(corner.sensor, max_depth=10.0))
    assert len(model) == len(planes)
    for plane, same in zip(model.planes, planes.planes, strict=True):
        assert_allclose(plane.normal, same.normal, atol=2e-3)
        assert_allclose(plane.area, same.area, rtol=0.02)


def _rows_of(shape):
    return lambda self, _: self.of.ray_rows(shape)


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        (
            "pixel_size",
            0.002,
            "pixel_size of Wrong must be a tuple of two .*; got 0.002",
        ),
        ("rays", lambda self, shape: self.ray_rows(shape), r"rays .*\(120, 160, 3\); got .*19200"),
        ("ray_rows", _rows_of((60, 80)), r"float64 of shape \(3, 19200\); got .* \(3, 4800\)"),
        ("ray_rows", lambda self, shape: self.rays(shape), r"ray_rows .*got .* \(120, 160, 3\)"),
        (
            "ray_rows",
            lambda self, shape: self.of.ray_rows(shape) / 0,
            r"ray_rows .* finite \(NaN",
        ),
        ("pixel_area", lambda self, shape: 1e-5, "pixel_area .*array of float64 .*; got 1e-05"),
        ("sectors", lambda self, shape: None, "sectors of Wrong must be .*Sectors; got None"),
        ("sectors", lambda self, _: self.of.sectors((60, 80)), r"sectors\.x .*got .* \(60, 80\)"),
        (
            "sectors",
            lambda self, shape: replace(self.of.sectors(shape), y=np.ones(shape)),
            r"sectors\.y .* array of float32 .*; got float64",
        ),
        (
            "sectors",
            lambda self, shape: replace(self.of.sectors(shape), column=np.arange(159)),
            r"sectors\.column .* the columns 0 \.\.\. 159 of the image",
        ),
        (
            "sectors",
            lambda self, shape: replace(
                self.of.sectors(shape), column=np.arange(160), stop=np.array([100])
            ),
            r"sectors\.start and stop .* the ends of the columns",
        ),
        (
            "sectors",
            lambda self, shape: replace(self.of.sectors(shape), ratio=np.zeros(shape, np.float32)),
            r"sectors\.ratio .* positive; got 0",
        ),
        (
            "sectors",
            lambda self, shape: replace(self.of.sectors(shape), turn=np.ones((1, 3, 3))),
            r"sectors\.turn .* inverted",
        ),
        ("__hash__", None, "must be hashable .*unhashable type: 'Wrong'"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_what_a_camera_gives_is_checked(corner, name, given, message):
    camera = type("Wrong", (Own,), {name: given})(corner.camera)
    with pytest.raises(ValueError, match=f"camera: .*{message}"):
        pw.observe(corner.depth, camera, corner.sensor)


def test_what_a_camera_lacks_is_named(corner):
    bare = type("Bare", (), {"check": Own.check, "ray_rows": Own.ray_rows, "frame": ""})
    with pytest.raises(ValueError, match=r"a Bare lacks wraps, pixel_size, rays, .*describe"):
        pw.Detector(bare(), corner.sensor)


def test_a_camera_is_checked_once_per_image_size(corner):
    asked = []

    class Counted(Own):
        def rays(self, shape):
            asked.append(shape)
            return super().rays(shape)

    for _ in range(3):
        pw.observe(corner.depth, Counted(corner.camera), corner.sensor)
    assert asked == [SHAPE]


def test_rays_may_be_missing_where_a_lens_bends(corner):
    def blind(self, shape):
        rays = self.of.ray_rows(shape).copy()
        rays[:2, :320] = np.nan
        return rays

    for bends in (True, False):
        camera = type("Blind", (Own,), {"ray_rows": blind, "bends": bends})(corner.camera)
        if bends:
            assert pw.observe(corner.depth, camera, corner.sensor).count == 19200 - 320
        else:
            with pytest.raises(ValueError, match=r"ray_rows .* finite \(NaN is for pixels"):
                pw.observe(corner.depth, camera, corner.sensor)


class Fisheye(Own):
    def describe(self):
        return {"model": "fisheye", "fx": self.of.fx, "elevation": "level"}


@pytest.mark.parametrize("kind", [Own, Fisheye])
def test_results_of_any_camera_are_valid(corner, planes, kind):
    record = describe_model(
        planes, depth=corner.depth, camera=kind(corner.camera), sensor=corner.sensor
    )
    jsonschema.validate(json.loads(json.dumps(record)), json.loads(SCHEMA_FILE.read_text()))
    assert record["camera"]["model"] in ("own", "fisheye")


@pytest.mark.parametrize("kind", [Own, Fisheye])
def test_pages_of_any_camera(corner, kind, tmp_path):
    (tmp_path / "frames").mkdir()
    np.savez(tmp_path / "frames" / "1.npz", depth=corner.depth)
    recipe = Recipe(sensor=corner.sensor, options=pw.Options(), camera=kind(corner.camera))
    batch = Batch(source=DepthFolder(tmp_path / "frames"), store=tmp_path / "store", recipe=recipe)
    with batch.started(InOrder()) as run:
        assert [outcome.reason for outcome in run] == [""]
    store = Store(tmp_path / "store")
    write_gallery(store, tmp_path / "page.html")
    assert recipe.camera.describe()["model"] in (tmp_path / "page.html").read_text()
    assert [camera_of(frame) for frame in store] == [None]
