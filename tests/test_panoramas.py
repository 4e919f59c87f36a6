"""Rooms all around a scanner: whole spheres, straight up and down, precise readings, commands."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.metrics import evaluate
from tests.command import run

WHOLE = pw.SphericalCamera.panorama(256)
PART = pw.SphericalCamera.spinning([e for e in WHOLE.elevation if -60 < e < 60], 512)


def found(scene, **options):
    """A model of a scene and its scores."""
    model = pw.detect_planes(scene.depth, scene.camera, scene.sensor, **options)
    truth = evaluate(
        model.labels,
        scene.labels,
        predicted_planes=model.coefficients,
        truth_planes=scene.planes,
    )
    return model, truth


@pytest.mark.parametrize("sigma", [0.0005, 0.002, 0.01])
@pytest.mark.parametrize("camera", [WHOLE, PART], ids=["whole", "part"])
@pytest.mark.parametrize("seed", range(4))
def test_planes_of_a_furnished_room(camera, sigma, seed):
    """A ceiling that lies on all sides is no part of a wall, however precise the readings are."""
    scene = pw.scenes.panorama(seed, camera=camera, sigma=sigma)
    model, truth = found(scene)
    assert truth.row()["voi_labelled"] < (0.02 if sigma < 0.01 else 0.1)
    assert truth.row()["recall@0.5"] > (0.99 if sigma < 0.01 else 0.8)
    assert truth.errors.mean_distance < sigma
    faces = pw.scenes.panorama(seed, camera=camera, sigma=sigma, every_face=True).labels
    assert evaluate(model.labels, faces).row()["precision@0.5"] > 0.9


def test_pixels_straight_up_and_down_have_the_labels_of_those_about_them():
    scene = pw.scenes.panorama(0, camera=WHOLE)
    model, _ = found(scene)
    for rows in (np.s_[:12], np.s_[-12:]):
        label = np.bincount(scene.labels[rows].ravel()).argmax()
        its = model.labels[rows][scene.labels[rows] == label]
        assert (its == np.bincount(its).argmax()).mean() > 0.999
        assert np.bincount(its).argmax() > 0


def test_rows_may_lie_at_the_poles():
    """An image from straight up to straight down, both included, in which all columns agree."""
    elevation = np.linspace(90, -90, 129)
    camera = pw.SphericalCamera.spinning(elevation, 256)
    scene = pw.scenes.panorama(5, camera=camera)
    model, truth = found(scene)
    assert truth.row()["recall@0.5"] == 1
    for row in (0, -1):
        assert len(np.unique(model.labels[row])) == 1
        assert model.labels[row, 0] > 0
    assert np.isfinite(model.information)
    sectors = camera.sectors(camera.shape)
    assert np.isfinite(sectors.x).all()
    assert np.isfinite(sectors.y).all()
    assert sectors.ratio.min() > 0


def test_ways_up_and_around_are_the_same():
    """The image upside down and mirrored, with angles that say so: the same planes."""
    scene = pw.scenes.panorama(1, camera=WHOLE)
    plain, _ = found(scene)
    flipped = pw.SphericalCamera(
        elevation=WHOLE.elevation[::-1], azimuth=np.unwrap(WHOLE.azimuth[::-1], period=360)
    )
    other = pw.detect_planes(scene.depth[::-1, ::-1], flipped, scene.sensor)
    assert len(other) == len(plain)
    assert_allclose(other.coefficients[:6], plain.coefficients[:6], atol=1e-3)
    assert (other.labels[::-1, ::-1] == plain.labels).mean() > 0.995


def test_a_panorama_looks_ahead_in_its_middle():
    camera = pw.SphericalCamera.panorama(4, 8)
    assert camera.shape == (4, 8)
    assert camera.wraps
    assert_allclose(camera.elevation, [67.5, 22.5, -22.5, -67.5])
    assert_allclose(camera.azimuth, 157.5 - 45 * np.arange(8))
    assert_allclose(camera.unproject([[3.5, 1.5], [1.5, 1.5]]), [[1, 0, 0], [0, 1, 0]], atol=1e-9)
    assert_allclose(camera.pixel_area(camera.shape).sum(), 4 * np.pi)
    assert_array_equal(camera.pixels([[0, 0, 1.0], [0, 0, -1.0]])[:, 0], [0, 3])
    assert pw.SphericalCamera.panorama(6).shape == (6, 12)


@pytest.mark.parametrize(("rows", "columns"), [(1, 2), (0, 8), (4, 2), (2.5, 8), ("4", 8)])
def test_panoramas_of_too_few_pixels_are_refused(rows, columns):
    with pytest.raises(ValueError, match=r"camera: (rows|columns) must be a whole number"):
        pw.SphericalCamera.panorama(rows, columns)


def test_angles_in_radians_are_refused():
    with pytest.raises(ValueError, match="are the angles in degrees"):
        pw.SphericalCamera.spinning(np.radians(WHOLE.elevation), 512)


def test_phi_of_a_model_is_that_of_its_labels():
    scene = pw.scenes.panorama(2, camera=WHOLE)
    model, _ = found(scene)
    seen = pw.observe(scene.depth, scene.camera, scene.sensor)
    information = pw.information(seen, model.planes, model.labels, objective="spatial")
    assert information == pytest.approx(model.information, rel=1e-9)


def test_the_paper_s_search_takes_panoramas():
    scene = pw.scenes.panorama(1, camera=WHOLE)
    model, truth = found(scene, objective="paper")
    assert len(model) >= 6
    assert truth.row()["voi_labelled"] < 0.3


def test_areas_are_those_of_outlines():
    scene = pw.scenes.panorama(1, camera=WHOLE)
    model, _ = found(scene)
    surfaces = pw.outline_image(model, scene.camera)
    for plane, surface in zip(model.planes[:5], surfaces[:5], strict=True):
        assert plane.area == pytest.approx(surface.area, rel=0.03)


def test_noise_is_told_by_the_frame():
    scene = pw.scenes.panorama(3, camera=WHOLE, sigma=0.004)
    sensor = pw.Sensor(max_depth=20, resolution=0.001, noise="auto")
    model = pw.detect_planes(scene.depth, scene.camera, sensor)
    assert evaluate(model.labels, scene.labels).row()["voi_labelled"] < 0.03
    estimate = pw.estimate_noise(scene.depth, scene.camera, sensor)
    assert_allclose(estimate.sensor(sensor).sigma([1.0, 2.0]), 0.004, rtol=0.05)


def test_the_command_line_takes_panoramas(tmp_path):
    scene = pw.scenes.panorama(0, camera=pw.SphericalCamera.panorama(96))
    np.save(tmp_path / "ranges.npy", 0.001 * scene.depth)
    given = ["detect", str(tmp_path / "ranges.npy"), "--noise", "2mm"]
    assert run(*given, "--camera", "panorama:192x96", "-o", str(tmp_path / "out"))[0] == 0
    told = json.loads((tmp_path / "out" / "planes.json").read_text())
    assert told["camera"]["model"] == "spherical"
    assert len(told["planes"]) >= 6
    (tmp_path / "camera.json").write_text(json.dumps(told["camera"]))
    camera = str(tmp_path / "camera.json")
    assert run(*given, "--camera", camera, "-o", str(tmp_path / "again"))[0] == 0
    again = json.loads((tmp_path / "again" / "planes.json").read_text())
    assert again["planes"] == told["planes"]


@pytest.mark.parametrize(
    ("camera", "what"),
    [
        ("panorama:192x95", "camera has 95 rows and 192 columns, the range image has 96 and 192"),
        ("panorama:2x96", "columns must be a whole number of at least 3"),
        ("panorama:wide", "nor panorama:1024x512, nor a file"),
        ("panorama:192x96:radial", "distances as they are"),
    ],
)
def test_panoramas_of_another_size_are_refused(tmp_path, camera, what):
    np.save(tmp_path / "ranges.npy", np.ones((96, 192)))
    arguments = "detect", str(tmp_path / "ranges.npy"), "--noise", "2mm", "--camera", camera
    code, _, error = run(*arguments, "-o", str(tmp_path / "out"))
    assert code == 2
    assert what in error
    assert not (tmp_path / "out").exists()


def test_scenes_are_the_same_for_the_same_seed():
    camera = pw.SphericalCamera.panorama(32)
    one, two, other = (pw.scenes.panorama(seed, camera=camera) for seed in (3, 3, 4))
    assert_array_equal(one.depth, two.depth)
    assert (one.depth != other.depth).any()
    lost = pw.scenes.panorama(3, camera=camera, lost=0.5)
    assert 0.4 < (lost.depth == 0).mean() < 0.6
    assert (lost.labels[lost.depth == 0] == 0).all()
    with pytest.raises(ValueError, match="sigma must be a positive number"):
        pw.scenes.panorama(0, sigma=0)
    with pytest.raises(ValueError, match="lost must be a share"):
        pw.scenes.panorama(0, lost=1.0)
