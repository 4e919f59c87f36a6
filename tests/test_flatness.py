"""Walls are not flat; what they bulge by is no reason to see several."""

from __future__ import annotations

import pytest
from benchmarks.bulging import flat, scored

import planewise as pw
from planewise.flatness import LEAN


@pytest.mark.parametrize(
    ("scene", "bulge", "sigma"),
    [("depth images", 0.01, 0.003), ("clouds", 0.01, 0.001), ("clouds", 0.005, 5e-4)],
)
def test_walls_that_bulge_are_planes(scene, bulge, sigma):
    found, expected = scored(scene, bulge, sigma, 5), scored(scene, 0.0, sigma, 5)
    assert found.detections[0].recall == expected.detections[0].recall == 1.0
    assert found.predicted_planes <= expected.predicted_planes + 1
    assert found.labelled.variation_of_information < 0.08
    with flat():
        fallen_apart = scored(scene, bulge, sigma, 5)
    assert fallen_apart.labelled.variation_of_information > 0.2


def test_what_leans_has_no_unit():
    """Pieces of an image lean by the same angle at any distance and focal length."""
    camera = pw.PinholeCamera(fx=300, fy=300, cx=320, cy=240)
    sectors = camera.sectors((480, 640))
    for z, pixels in ((1.0, 100), (4.0, 50)):
        of_w = sectors.lean / z * pixels / 100
        assert of_w * z**2 == pytest.approx(LEAN * z * pixels / 300)
