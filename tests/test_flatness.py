"""Walls are not flat; what they bulge by is no reason to see several."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.bulging import CAMERA, corner, flat, room

import planewise as pw
from planewise.metrics import evaluate
from planewise.sectors import Sectors


def image(bulge, sigma):
    depth, truth = corner(bulge, np.random.default_rng(5))
    depth += sigma * np.random.default_rng(0).standard_normal(depth.shape)
    sensor = pw.Sensor(max_depth=10, resolution=1e-4, noise=sigma)
    return evaluate(pw.detect_planes(depth, CAMERA, sensor).labels, truth)


def cloud(bulge, sigma):
    points, truth = room(bulge, np.random.default_rng(0))
    points += np.random.default_rng(1).normal(0, sigma, points.shape)
    sensor = pw.Sensor(max_depth=20, resolution=1e-4, noise=sigma)
    return evaluate(pw.detect_planes_in_points(points, sensor).labels[None], truth[None])


@pytest.mark.parametrize(
    ("scene", "bulge", "sigma"), [(image, 0.01, 0.003), (cloud, 0.01, 0.001), (cloud, 0.005, 5e-4)]
)
def test_walls_that_bulge_are_planes(scene, bulge, sigma):
    found, expected = scene(bulge, sigma), scene(0.0, sigma)
    assert found.detections[0].recall == expected.detections[0].recall == 1.0
    assert found.predicted_planes <= expected.predicted_planes + 1
    assert found.labelled.variation_of_information < 0.08
    with flat():
        fallen_apart = scene(bulge, sigma)
    assert fallen_apart.labelled.variation_of_information > 0.2


def test_what_leans_has_no_unit():
    """Pieces of an image lean by the same angle at any distance and focal length."""
    from planewise.flatness import LEAN

    camera = pw.PinholeCamera(fx=300, fy=300, cx=320, cy=240)
    sectors: Sectors = camera.sectors((480, 640))
    for z, pixels in ((1.0, 100), (4.0, 50)):
        of_w = sectors.lean / z * pixels / 100
        assert of_w * z**2 == pytest.approx(LEAN * z * pixels / 300)
