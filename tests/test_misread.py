"""Readings that are not what they are taken for: it is said, and never of those that are."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.curved_frames import CAMERA, SURFACES, rays
from benchmarks.other_sensors import READINGS, camera_of, frame_in_metres, named

import planewise as pw
from planewise import scenes
from planewise.batch import Store
from planewise.misread import misread
from tests.command import run
from tests.distances import with_distances

DISTANCES = "readings look like distances from the camera"
DEPTH = "readings look like depth along z"
DISPARITY = "readings look like disparity"
SENSOR = pw.Sensor(max_depth=1000, noise=0.002)


def found(scene, **options):
    return pw.detect_planes(scene.depth, scene.camera, scene.sensor, **options)


def of(depth, camera):
    return misread(pw.observe(depth, camera, SENSOR))


def in_metres(reading, seed):
    z, *_ = frame_in_metres(reading, seed)
    return z, camera_of(reading.size)


def disparity(z):
    return np.where(z > 0, 10 / np.where(z > 0, z, 1), 0)


@pytest.mark.parametrize("seed", range(4))
def test_distances_that_were_taken_for_depth_are_told(seed):
    scene = scenes.corner(sigma=0.002, rng=seed)
    distances = with_distances(scene)
    taken = replace(distances, camera=scene.camera)
    assert DISTANCES in found(taken).note
    assert "--camera CAMERA:radial" in found(taken, objective="paper").note
    assert DEPTH in found(replace(scene, camera=distances.camera)).note
    assert found(scene).note == found(distances).note == ""


@pytest.mark.parametrize("name", ["2 mm", "time of flight", "phone, 256 x 192"])
@pytest.mark.parametrize("seed", range(2))
def test_each_kind_is_told_from_the_others(name, seed):
    z, camera = in_metres(named(name), seed)
    radial = replace(camera, radial=True)
    u, v = camera.directions(z.shape)
    distance = z * np.sqrt(1 + u * u + v * v)
    assert of(z, camera) == of(distance, radial) == ""
    assert of(distance, camera).startswith(DISTANCES)
    assert of(z, radial).startswith(DEPTH)
    assert of(disparity(z), camera).startswith(DISPARITY)
    assert of(disparity(z), radial).startswith(DISPARITY)
    # Integers are no other.
    assert of(np.rint(1000 * distance).astype(np.uint16), camera).startswith(DISTANCES)
    assert of(np.rint(1000 * disparity(z)).astype(np.uint16), camera).startswith(DISPARITY)


@pytest.mark.parametrize("k1", [-0.2, -0.1, 0.1])
@pytest.mark.parametrize("seed", [1, 3])
def test_a_lens_that_the_camera_does_not_know_is_told(k1, seed):
    precise = named("2 mm")
    z, camera = in_metres(replace(precise, distortion=k1), seed)
    said = of(z, camera)
    about = float(re.search(r"about k1 = (-?[\d.]+)", said)[1])
    assert 0.6 < about / k1 < 1.7
    known = replace(camera, distortion=(k1, 0.0, 0.0, 0.0))
    assert of(z, known) == ""
    length = np.linalg.norm(np.dstack((*known.directions(z.shape), np.ones(z.shape))), axis=2)
    assert of(z * length, replace(known, radial=True)) == ""
    # The other way round: rectified images, and a camera that is said to bend.
    z, camera = in_metres(precise, seed)
    assert "about k1 = " in of(z, replace(camera, distortion=(k1, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize("reading", READINGS, ids=lambda each: each.name)
def test_depth_is_depth(reading):
    z, camera = in_metres(reading, 0)
    assert of(z, camera) == ""


def test_real_depth_is_depth(every_real_frame):
    said = {each.name: of(each.depth_scale * each.depth, each.camera) for each in every_real_frame}
    assert said == dict.fromkeys(said, "")


@pytest.mark.parametrize(
    "name", ["tank", "silo", "pipe", "tunnel", "tower, inside", "ball of 1 m", "bowl"]
)
def test_what_is_curved_is_depth(name):
    z = SURFACES[name](rays())
    z = np.where(np.isfinite(z), z, 0)
    noise = np.random.default_rng(0).normal(0, 0.001, z.shape)
    assert of(np.where(z > 0, z + noise, 0), CAMERA) == ""


@pytest.mark.parametrize("depth", [0.7, 2.0, 3.3])
@pytest.mark.parametrize("lean", [0.0, 1e-12, 1e-9])
def test_a_wall_that_is_faced_says_nothing(depth, lean):
    camera = pw.PinholeCamera(fx=131, fy=131, cx=79.5, cy=59.5)
    wall = depth * (1 + lean * np.arange(160) + np.zeros((120, 1)))
    assert of(wall, camera) == of(wall.astype(np.float32), camera) == ""
    rounding = np.random.default_rng(0).normal(0, 1e-16, wall.shape)
    assert of(wall + rounding, camera) == ""


def test_frames_that_cannot_tell_say_nothing():
    scene = scenes.room(0)  # a Kinect's noise hides it
    assert of(0.001 * with_distances(scene).depth, scene.camera) == ""
    camera = pw.PinholeCamera(fx=50, fy=50, cx=20, cy=20)
    assert of(np.full((24, 24), 2.0), camera) == ""
    corner = with_distances(scenes.corner(sigma=0.001))
    y, x = np.indices(corner.depth.shape)
    some = np.where((x // 30 + y // 30) % 2, corner.depth, 0)  # no square is whole
    plain = replace(corner.camera, radial=False)
    assert of(corner.depth, plain).startswith(DISTANCES)
    assert of(some, plain) == ""
    lidar = scenes.street(0)
    assert misread(pw.observe(lidar.depth, lidar.camera, lidar.sensor)) == ""


def test_the_command_says_it(tmp_path):
    scene = with_distances(scenes.corner(sigma=0.002))
    depth, camera = tmp_path / "distance.npy", scene.camera
    np.save(depth, 0.001 * scene.depth)
    text = f"{camera.fx},{camera.fy},{camera.cx},{camera.cy}"
    for camera_given, said in ((text, True), (f"{text}:radial", False)):
        given = ("--camera", camera_given, "--noise", "2mm", "-o", tmp_path / str(said))
        code, out, err = run("detect", depth, *given)
        assert code == 0
        assert (DISTANCES in out + err) == said


def test_a_batch_counts_frames_that_look_misread(tmp_path):
    scene = with_distances(scenes.corner(sigma=0.002))
    frames, camera = tmp_path / "frames", scene.camera
    frames.mkdir()
    for number in range(2):
        np.save(frames / f"{number}.npy", 0.001 * scene.depth)
    text = f"{camera.fx},{camera.fy},{camera.cx},{camera.cy}"
    arguments = ("batch", frames, "--noise", "2mm", "-o")
    _, _, errors = run(*arguments, tmp_path / "trial", "--camera", text, "--dry-run")
    assert f"warning: 2 frames: {DISTANCES}" in errors
    code, _, errors = run(*arguments, tmp_path / "store", "--camera", text)
    assert code == 0
    assert f"warning: 2 frames: {DISTANCES}" in errors
    notes = Store(tmp_path / "store").frames["note"].to_pylist()
    assert all(DISTANCES in note for note in notes)
    _, _, errors = run(*arguments, tmp_path / "other", "--camera", f"{text}:radial")
    assert "look like" not in errors


def test_a_calibration_counts_frames_by_what_they_look_like(tmp_path):
    precise = named("2 mm")
    for seed in (1, 3):
        z, camera = in_metres(replace(precise, distortion=-0.1), seed)
        np.save(tmp_path / f"{seed}.npy", z)
    np.save(tmp_path / "other.npy", disparity(z))
    text = f"{camera.fx},{camera.fy},{camera.cx},{camera.cy}"
    out = tmp_path / "sensor.json"
    code, _, errors = run("calibrate", tmp_path, "--camera", text, "-o", out)
    assert code == 0
    assert errors.count("planes look bent by a lens") == 1
    assert "warning: 2 frames: planes look bent by a lens" in errors
    assert f"warning: 1 frame: {DISPARITY}" in errors


@pytest.mark.parametrize("threads", [1, 2])
def test_a_detector_looks_at_its_first_frame(threads):
    scene = with_distances(scenes.corner(sigma=0.002))
    camera = replace(scene.camera, radial=False)
    detector = pw.Detector(camera, scene.sensor, threads=threads)
    notes = [model.note for model in detector.stream([scene.depth] * 3)]
    assert notes[0].startswith(DISTANCES)
    assert notes[1:] == ["", ""]
    detector = pw.Detector(camera, scene.sensor, threads=threads)
    assert [bool(detector(scene.depth).note) for _ in range(2)] == [True, False]
    assert [model.note for model in detector.stream([scene.depth] * 2)] == ["", ""]
