"""Cameras that are not the package's: other frames, other projections, and what they get wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import planewise as pw
from planewise import scenes

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
