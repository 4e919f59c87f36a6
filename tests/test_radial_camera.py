"""Pinhole cameras whose readings are distances."""

from __future__ import annotations

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from benchmarks.faults import InOrder
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import scenes
from planewise.batch import Batch, DepthFolder, Recipe, Store
from planewise.batch.stored_source import camera_of
from planewise.errors import PlanewiseError
from planewise.files.camera import read_camera
from planewise.gallery import write_gallery
from planewise.metrics import evaluate
from planewise.results.planes_json import SCHEMA_FILE, describe_model
from tests.command import run
from tests.distances import lengths, with_distances

BARREL = (-0.25, 0.05, 0.001, -0.0005)


def read(scene, sigma):
    """A scene in metres, with so much noise along whatever is read."""
    metres = scene.depth * scene.sensor.resolution
    noise = np.random.default_rng(7).normal(0, sigma, metres.shape)
    return replace(scene, depth=metres + noise, sensor=pw.Sensor(noise=sigma))


def found(scene, **options):
    return pw.detect_planes(scene.depth, scene.camera, scene.sensor, **options)


@pytest.mark.parametrize("distortion", [(), BARREL])
def test_rays_of_distances_have_length_one(distortion):
    camera = pw.PinholeCamera(fx=100, fy=110, cx=80, cy=60, distortion=distortion)
    radial, shape = replace(camera, radial=True), (120, 160)
    rays, length = radial.rays(shape), lengths(camera, shape)
    assert_allclose(np.linalg.norm(rays, axis=-1), 1)
    assert_allclose(rays * length[..., None], camera.rays(shape), atol=1e-12)
    assert_allclose(radial.directions(shape), camera.directions(shape), rtol=1e-15, atol=1e-15)
    places = radial.project(rays)
    assert_allclose(radial.unproject(places), rays, atol=1e-8)
    # A pixel covers its share of the sphere: less the farther out and the more it leans.
    assert_allclose(radial.pixel_area(shape), camera.pixel_area(shape) / length**3, rtol=1e-6)
    sectors = radial.sectors(shape)
    assert_allclose(sectors.ratio, 1 / length, rtol=1e-6)
    assert_allclose(sectors.x, camera.sectors(shape).x, rtol=1e-6)
    assert camera.sectors(shape).ratio is None


def test_a_wide_pinhole_covers_its_part_of_the_sphere():
    shape = 400, 400
    camera = pw.PinholeCamera(fx=200, fy=200, cx=199.5, cy=199.5, radial=True)
    # A cube's face seen from its middle is a sixth of 4 pi.
    assert_allclose(camera.pixel_area(shape).sum(), 4 * np.pi / 6, rtol=1e-5)


def test_crops_and_other_sizes_stay_radial():
    camera = pw.PinholeCamera(fx=100, fy=100, cx=80, cy=60, width=160, height=120, radial=True)
    for other in (camera.scaled(0.5), camera.binned(2, 2), camera.cropped(10, 20, (60, 80))):
        assert other.radial


@pytest.mark.parametrize("value", [1, None, "yes"])
def test_radial_is_true_or_false(value):
    with pytest.raises(ValueError, match="radial must be True or False"):
        pw.PinholeCamera(fx=100, fy=100, cx=80, cy=60, radial=value)


@pytest.mark.parametrize("objective", ["spatial", "paper"])
@pytest.mark.parametrize("make", [scenes.corner, scenes.staircase])
def test_distances_tell_the_planes_that_depth_does(make, objective):
    scene = make(sigma=1e-4)
    for each in (scene, with_distances(scene)):
        model = found(read(each, 0.005), objective=objective)
        assert len(model) == 4
        assert not model.note
        apart = np.abs(model.coefficients[:, None] - scene.planes).max(axis=2)
        assert_array_equal(np.sort(apart.argmin(axis=1)), np.arange(4))
        assert apart.min(axis=1).max() < 0.002
        assert_allclose([plane.rms for plane in model.planes], 0.005, rtol=0.15)
        if objective == "spatial":
            assert evaluate(model.labels, scene.labels).row()["voi_labelled"] < 0.05


def test_distances_through_a_lens_tell_the_planes():
    camera = pw.PinholeCamera(fx=260, fy=260, cx=159.5, cy=119.5, distortion=BARREL, radial=True)
    rays = camera.rays((240, 320))
    planes = np.array([(0, 0, -1, 3.0), (0, -1, 0, 1.2), (-0.8, 0, -0.6, 2.2)])
    with np.errstate(divide="ignore"):
        hits = -planes[:, 3, None, None] / np.einsum("hwc,nc->nhw", rays, planes[:, :3])
    hits[~(hits > 0)] = np.inf
    depth = hits.min(axis=0) + np.random.default_rng(0).normal(0, 0.003, rays.shape[:2])
    model = pw.detect_planes(depth, camera, pw.Sensor(noise=0.003))
    assert len(model) == 3
    assert evaluate(model.labels, hits.argmin(axis=0) + 1).row()["voi_labelled"] < 0.02
    known = planes[:, :3] @ np.stack([plane.normal for plane in model.planes]).T
    assert_allclose(known.max(axis=1), 1, atol=1e-5)


@pytest.mark.parametrize(
    "options",
    [
        {"instances": True},
        {"partition": "blocks"},
        {"search": "sequential", "reassign": "normals"},
        {"objective": "paper", "partition": "blocks"},
    ],
    ids=lambda each: ", ".join(each),
)
def test_every_search_takes_distances(options):
    scene = scenes.corner(sigma=1e-4)
    distances = with_distances(scene)
    model, other = (found(read(each, 0.005), **options) for each in (scene, distances))
    assert len(model) == len(other) >= 4
    areas = [[plane.area for plane in each.planes] for each in (model, other)]
    assert_allclose(*map(sorted, areas), rtol=0.03)
    assert_allclose(*[sorted(each.coefficients[:, 3]) for each in (model, other)], atol=0.003)


def test_few_distances_are_searched_in_space():
    distances = read(with_distances(scenes.corner(sigma=1e-4)), 0.005)
    there = np.random.default_rng(0).random(distances.depth.shape) < 0.05
    model = found(replace(distances, depth=distances.depth * there))
    assert_allclose(sorted(model.coefficients[:, 3]), [0.7, 0.7, 0.7, 1.5], atol=0.003)
    assert_allclose([plane.rms for plane in model.planes], 0.005, rtol=0.15)  # along the rays


def test_noise_of_distances_is_estimated_along_the_rays():
    scene = read(with_distances(scenes.corner(sigma=1e-4)), 0.008)
    noise = pw.estimate_noise(scene.depth, scene.camera, pw.Sensor(noise="auto"))
    assert_allclose(noise.white([1.1, 1.7]), 0.008, rtol=0.03)


def test_an_image_of_repeated_distances_is_searched_at_its_own_size():
    scene = with_distances(scenes.corner(sigma=0.005))
    twice = np.repeat(np.repeat(scene.depth, 2, axis=0), 2, axis=1)
    model = pw.detect_planes(twice, scene.camera.scaled(2), scene.sensor)
    assert model.settings["own_size"] == list(scene.depth.shape)
    assert_array_equal(model.labels[::2, ::2], found(scene).labels)


def test_cameras_are_said_to_be_radial(tmp_path):
    numbers = read_camera("500,501,320,240:radial")
    assert numbers == pw.PinholeCamera(fx=500, fy=501, cx=320, cy=240, radial=True)
    assert read_camera("nyu:radial") == replace(pw.cameras.PRESETS["nyu"], radial=True)
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"fx": 500, "fy": 501, "cx": 320, "cy": 240}))
    assert read_camera(f"{path}:radial") == numbers
    path.write_text(json.dumps(numbers.describe()))
    assert read_camera(str(path)) == read_camera(f"{path}:radial") == numbers
    path.write_text(json.dumps({"P": [400, 0, 320, 0, 0, 400, 240, 0, 0, 0, 1, 0]}))
    assert read_camera(f"{path}:rect:radial").radial
    path.write_text(json.dumps(numbers.describe() | {"radial": [0.1, 0.2]}))
    with pytest.raises(PlanewiseError, match=r"radial .* expected true or false"):
        read_camera(str(path))
    with pytest.raises(PlanewiseError, match="ranges of a LiDAR are distances as they are"):
        read_camera("velodyne-vlp16:radial")


def test_the_command_takes_distances(tmp_path):
    scene = with_distances(scenes.corner(sigma=0.002))
    depth, camera = tmp_path / "distance.npy", scene.camera
    np.save(depth, 0.001 * scene.depth)
    radial = f"{camera.fx},{camera.fy},{camera.cx},{camera.cy}:radial"
    given = ("--camera", radial, "--noise", "2mm", "-o", tmp_path / "out")
    code, out, _ = run("detect", depth, *given)
    assert code == 0
    assert "4 planes" in out
    told = json.loads((tmp_path / "out" / "planes.json").read_text())
    assert told["camera"]["radial"] is True
    jsonschema.validate(told, json.loads(SCHEMA_FILE.read_text()))


def test_a_preset_that_is_radial_names_its_sensor(tmp_path):
    np.save(tmp_path / "wall.npy", np.full((480, 640), 2.0))
    code, out, _ = run(
        "detect", tmp_path / "wall.npy", "--camera", "kinect-v1:radial", "-o", tmp_path / "out"
    )
    assert code == 0
    assert "plane" in out
    told = json.loads((tmp_path / "out" / "planes.json").read_text())
    assert told["sensor"]["max_depth_m"] == pw.sensors.KINECT_V1.max_depth


def test_stores_keep_that_a_camera_is_radial(tmp_path):
    scene = with_distances(scenes.corner(sigma=0.005))
    (tmp_path / "frames").mkdir()
    np.save(tmp_path / "frames" / "one.npy", scene.depth)
    recipe = Recipe(sensor=scene.sensor, options=pw.Options(), camera=scene.camera, labels="png")
    batch = Batch(source=DepthFolder(tmp_path / "frames"), store=tmp_path / "store", recipe=recipe)
    with batch.started(InOrder()) as running:
        for _ in running:
            pass
    store = Store(tmp_path / "store")
    assert [camera_of(frame) for frame in store] == [scene.camera]
    write_gallery(store, tmp_path / "page.html")
    assert "cy 240.0 (pixels), radial" in (tmp_path / "page.html").read_text(encoding="utf-8")
    model = found(scene)
    told = describe_model(model, camera=scene.camera, sensor=scene.sensor, depth=scene.depth)
    assert told["camera"] == scene.camera.describe()


def test_outlines_lie_on_planes_of_distances():
    scene = scenes.corner(sigma=0.002)
    distances = with_distances(scene)
    areas = [
        sum(surface.area for surface in pw.outline_image(found(each), each.camera))
        for each in (scene, distances)
    ]
    assert_allclose(*areas, rtol=0.01)
