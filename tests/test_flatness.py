"""Walls are not flat; what they bulge by is no reason to see several."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks import flat_edges
from benchmarks.bulging import flat, scored, wave

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


def test_a_wave_of_a_wall_is_one_plane_in_an_image():
    x, y = flat_edges.wall((480, 640))
    relief = flat_edges.SMOOTH["wave of 2 m, 3 mm high"](x, y)
    model = flat_edges.found(relief, 5e-4)
    assert len(model) == 1
    assert model.planes[0].count > 0.99 * relief.size
    with flat():
        fallen_apart = flat_edges.found(relief, 5e-4)
    assert len(fallen_apart) == 4


@pytest.mark.parametrize(("bulge", "sigma"), [(0.02, 5e-4), (0.03, 0.001), (0.04, 0.003)])
def test_facets_of_a_wall_are_one_plane_in_a_cloud(bulge, sigma):
    found = scored("clouds", bulge, sigma, 5)
    assert found.detections[0].recall == 1.0
    assert found.predicted_planes <= 7
    assert found.labelled.variation_of_information < 0.25
    with flat():
        fallen_apart = scored("clouds", bulge, sigma, 5)
    assert fallen_apart.detections[0].recall <= 0.5


@pytest.mark.parametrize(("degrees", "planes"), [(4, 1), (6, 0)])
def test_a_strip_of_a_tower_is_a_plane_if_it_hardly_turns(degrees, planes):
    rng, radius, sigma = np.random.default_rng(0), 40.0, 5e-4
    angle = np.radians(rng.uniform(-degrees / 2, degrees / 2, 60_000))
    height = rng.uniform(0, 3, 60_000)
    points = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), height))
    points += rng.normal(0, sigma, points.shape)
    model = pw.detect_planes_in_points(points, pw.Sensor(max_depth=100.0, noise=sigma))
    assert len(model) == planes
    assert (model.labels > 0).mean() == pytest.approx(planes, abs=0.01)


@pytest.mark.parametrize(
    ("proud", "degrees", "planes"), [(0.0, 0.0, 1), (0.01, 0.0, 2), (0.0, 1.5, 2), (0.0, 0.5, 1)]
)
def test_panels_and_edges_of_walls_that_bulge(proud, degrees, planes):
    rng, sigma = np.random.default_rng(0), 0.001
    x, y = rng.uniform(0, (4, 3), (40_000, 2)).T
    z = wave(np.column_stack((x, y)), np.eye(2), 0.04, np.array([1.0, 4.0]))
    z += proud * ((abs(x - 2) < 0.6) & (abs(y - 1.5) < 0.6))
    z += np.tan(np.radians(degrees)) * np.maximum(x - 2, 0) + rng.normal(0, sigma, x.size)
    sensor, found = pw.Sensor(max_depth=10.0, noise=sigma), []
    for turn in range(8):  # how it lies to the grid tips the scales in one of eight
        across = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turn else np.eye(3)
        model = pw.detect_planes_in_points(np.column_stack((x, y, z)) @ across, sensor)
        found.append(len(model))
        assert (model.labels > 0).mean() > 0.97
    assert found.count(planes) >= 7


def test_bushes_are_no_part_of_ground_that_undulates():
    rng, sigma = np.random.default_rng(0), 0.02
    along = rng.uniform(0, 60, (2, 200_000))
    middle = rng.uniform(5, 55, (2, 12)).repeat(400, axis=1)
    bush = middle + rng.normal(0, 0.5, middle.shape)
    above = np.append(np.zeros(along.shape[1]), 0.1 + np.abs(rng.normal(0, 0.25, bush.shape[1])))
    at = np.hstack((along, bush))
    points = np.vstack((at, 0.1 * np.sin(2 * np.pi * at / 60).sum(axis=0) + above)).T
    points += rng.normal(0, sigma, points.shape)
    labels = pw.detect_planes_in_points(points, pw.Sensor(max_depth=100.0, noise=sigma)).labels
    assert (labels[above == 0] > 0).mean() > 0.98
    assert (labels[above > 0] > 0).mean() < 0.06


def test_what_leans_has_no_unit():
    """Pieces of an image lean by the same angle at any distance and focal length."""
    camera = pw.PinholeCamera(fx=300, fy=300, cx=320, cy=240)
    sectors = camera.sectors((480, 640))
    for z, pixels in ((1.0, 100), (4.0, 50)):
        of_w = sectors.lean / z * pixels / 100
        assert of_w * z**2 == pytest.approx(LEAN * z * pixels / 300)
