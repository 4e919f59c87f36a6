"""planewise calibrate, and what detect makes of its file."""

import json
import os
import re

import numpy as np
import pytest
from benchmarks.other_sensors import camera_of, frame, named
from PIL import Image

import planewise as pw
from planewise import noise, scenes
from planewise.drawing.noise import draw_noise
from planewise.errors import MissingExtraError

from . import bag_files
from .bag_files import write_bag
from .command import run
from .dataset_files import write_generic

CAMERA = ("--camera", "250,250,160,120")
ONE_DEPTH = r"warning: all flat cells lie (at|from) .* m, so that noise at other depths is a guess"


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    for seed, far in enumerate((1, 2)):
        for make in (scenes.corner, scenes.staircase):
            scene = make(sigma=0.004 / far, size=(240, 320), rng=seed)
            Image.fromarray(far * scene.depth).save(folder / f"{make.__name__}{seed}.png")
    return folder


def test_a_sensor_is_made_and_used(frames, tmp_path):
    out, picture = tmp_path / "made" / "sensor.json", tmp_path / "made" / "curve.png"
    arguments = ("--sensor", "kinect-v1", "--picture", picture, "-o", out)
    code, text, errors = run("calibrate", frames, *CAMERA, *arguments)
    assert (code, errors) == (0, "")
    for word in (
        "depth",
        "sigma",
        "95 % band",
        "flat cells",
        "preset",
        "noise: sqrt((0.00",
        "the band is of the curve, on walls",
    ):
        assert word in text
    assert "4 of 4 frames used, sensor in" in text
    assert "…" not in text
    assert sorted(path.name for path in out.parent.iterdir()) == ["curve.png", "sensor.json"]
    with Image.open(picture) as image:
        assert image.size == (800, 500)
    sensor = pw.sensors.load(out)
    assert sensor.max_depth == pw.sensors.KINECT_V1.max_depth
    assert np.abs(sensor.sigma([0.9, 1.3]) - 0.004).max() < 0.0002
    record = json.loads(out.read_text())["calibration"]
    low, high, curve = (np.array(record[k]) for k in ("curve_low_m", "curve_high_m", "curve_m"))
    assert (low <= high).all()
    assert np.abs(curve - 0.004).max() < 0.0002
    assert record["frames"] == 4

    result = tmp_path / "result"
    frame = frames / "corner0.png"
    code, text, errors = run("detect", frame, *CAMERA, "--sensor", out, "-o", result)
    assert (code, errors) == (0, "")
    assert "4 planes" in text
    written = json.loads((result / "planes.json").read_text())["sensor"]["noise"]
    assert written == str(sensor.noise)


def test_an_error_that_is_no_drift_is_told(tmp_path):
    reading = named("stereo, 424 x 240")
    for seed in range(300, 303):
        np.save(tmp_path / f"{seed}.npy", frame(reading, seed)[0])
    camera = camera_of(reading.size)
    intrinsics = ("--camera", f"{camera.fx},{camera.fy},{camera.cx},{camera.cy}")
    out = tmp_path / "sensor.json"
    code, text, errors = run("calibrate", tmp_path, *intrinsics, "--depth-scale", 0.001, "-o", out)
    assert (code, errors) == (0, "")
    assert "z^2 m, but not as by a drift: each frame tells how far it goes" in text
    assert not pw.sensors.load(out).parts.bounds


def test_single_files_and_the_same_band_twice(frames, tmp_path):
    texts = []
    for name in ("a.json", "b.json"):
        code, *_ = run("calibrate", frames / "corner0.png", *CAMERA, "-o", tmp_path / name)
        assert code == 0
        texts.append((tmp_path / name).read_text())
    assert texts[0] == texts[1]


def test_noise_auto(frames, tmp_path):
    arguments = (*CAMERA, "--noise", "auto", "--objective", "spatial", "-o", tmp_path / "out")
    code, text, errors = run("detect", frames / "staircase0.png", *arguments)
    assert (code, errors) == (0, "")
    assert "4 planes" in text
    record = json.loads((tmp_path / "out" / "planes.json").read_text())
    assert record["sensor"]["noise"] == "auto"
    used = record["options"]["noise"]
    assert used["source"] == "estimated"
    assert used["white"].startswith("0.00")
    assert used["shared"] == "0 m"


def test_a_noise_that_was_assumed_is_warned_of(tmp_path):
    wall = np.zeros((400, 480), np.uint16)
    wall[:24, :24] = np.random.default_rng(0).normal(2000, 2, (24, 24))
    (tmp_path / "frames").mkdir()
    Image.fromarray(wall).save(tmp_path / "frames" / "wall.png")
    for name, said in (("frames/wall.png", ""), ("frames", "wall.png: ")):
        given = (tmp_path / name, *CAMERA, "--noise", "auto", "-o", tmp_path / "out")
        code, text, errors = run("detect", *given, "--objective", "paper")
        assert code == 0
        assert "1 plane" in text
        assert f"warning: {said}noise: " in errors
        assert "sigma = 0.01 z m was assumed" in " ".join(errors.split())


def test_bad_frames_are_reported_and_the_others_used(frames, tmp_path):
    Image.fromarray(np.zeros((240, 320), np.uint8)).save(tmp_path / "grey.png")
    out = tmp_path / "s.json"
    code, text, errors = run("calibrate", frames, tmp_path / "grey.png", *CAMERA, "-o", out)
    assert code == 2
    assert "4 of 5 frames used" in text
    assert "grey.png" in errors
    assert "8 bits" in errors
    assert out.exists()


def test_a_package_that_frames_need_is_missed_once(frames, tmp_path, monkeypatch):
    def lacking(*_):
        raise MissingExtraError("openexr", "reading .exr files")

    monkeypatch.setattr("planewise.commands.calibrate.read_depth", lacking)
    code, text, errors = run("calibrate", frames, *CAMERA, "-o", tmp_path / "s.json")
    assert (code, text) == (2, "")
    assert errors.count("openexr") == 1


def test_one_camera_for_frames_of_two_sizes_is_warned_of(frames, tmp_path):
    half = np.asarray(Image.open(frames / "corner0.png"))[::2, ::2]
    Image.fromarray(half).save(tmp_path / "half.png")
    code, _, errors = run(
        "calibrate", frames, tmp_path / "half.png", *CAMERA, "-o", tmp_path / "s.json"
    )
    assert code == 0
    assert errors.count("warning: ") == 1
    assert "half.png has 160 x 120 pixels and frames before it 320 x 240" in errors


def test_a_unit_that_nobody_states_is_told_once(frames, tmp_path):
    given = ("calibrate", frames, "--camera", CAMERA[1], "-o", tmp_path / "s.json")
    _, _, errors = run(*given, "--resolution", "0.0002")
    assert errors.count("warning: whole numbers are taken in units of 0.2 mm") == 1
    _, _, errors = run(*given, "--resolution", "0.0002", "--depth-scale", "0.001")
    assert "units of" not in errors


def test_frames_that_tell_nothing_are_reported_and_not_counted(frames, tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    good = (frames / "corner0.png").read_bytes()
    (folder / "good.png").write_bytes(good)
    (folder / "broken.png").write_bytes(good[:100])
    Image.fromarray(np.zeros((240, 320), np.uint16)).save(folder / "void.png")
    wild = np.random.default_rng(0).integers(0, 1 << 16, (240, 320), np.uint16)
    Image.fromarray(wild).save(folder / "wild.png")
    out = tmp_path / "s.json"
    code, text, errors = run("calibrate", folder, *CAMERA, "-o", out)
    assert code == 2
    assert "1 of 4 frames used" in text
    assert errors.count("error: ") == 3
    for name in ("void.png: 0 flat cells, too few", "wild.png: ", "broken.png: "):
        assert f"error: {name}" in errors
    assert json.loads(out.read_text())["calibration"]["frames"] == 1


def test_a_file_that_is_given_twice_is_read_once(frames, tmp_path, monkeypatch):
    monkeypatch.chdir(frames)
    given = ("corner0.png", frames / "corner0.png", frames)
    code, text, errors = run("calibrate", *given, *CAMERA, "-o", tmp_path / "s.json")
    assert (code, errors) == (0, "")
    assert "4 of 4 frames used" in text


def test_datasets_tell_camera_and_unit(tmp_path):
    data = write_generic(tmp_path / "data")
    files = (data / "depth", "--camera", "50,52,31,24.5", "--depth-scale", "0.0005")
    code, _, errors = run("calibrate", *files, "-o", tmp_path / "files.json")
    assert code == 0
    assert re.fullmatch(f"{ONE_DEPTH}.*", errors)
    code, out, again = run("calibrate", data, "-o", tmp_path / "data.json")
    assert (code, again) == (0, errors)
    assert "3 of 3 frames used" in out
    assert (tmp_path / "data.json").read_text() == (tmp_path / "files.json").read_text()
    (data / "depth" / "view 1.png").write_bytes(b"none")
    code, out, errors = run("calibrate", data, data, "-o", tmp_path / "data.json")
    assert code == 2
    assert errors.startswith("error: data, frame view 1: depth: view 1.png")
    assert "2 of 3 frames used" in out


def test_no_file_of_a_dataset_is_written_over(tmp_path):
    data = write_generic(tmp_path / "data")
    (tmp_path / "link.json").symlink_to(data / "camera.json")
    before = {each: each.read_bytes() for each in tmp_path.rglob("*") if each.is_file()}
    for option, arguments in (
        ("output", ("-o", data / "camera.json")),
        ("output", ("-o", tmp_path / "link.json")),
        ("picture", ("-o", tmp_path / "s.json", "--picture", data / "depth" / "view 1.png")),
    ):
        code, text, errors = run("calibrate", data, *arguments)
        assert (code, text) == (2, "")
        assert errors.startswith(f"error: {option}: {arguments[-1]} would be written over")
        assert {each: each.read_bytes() for each in tmp_path.rglob("*") if each.is_file()} == before
    assert run("calibrate", data, "-o", data / "sensor.json")[0] == 0  # where nothing was
    assert (data / "sensor.json").exists()


def test_frames_that_are_not_taken_are_not_written_over(frames, tmp_path, monkeypatch):
    monkeypatch.setattr("planewise.commands.calibrate._MOST_FRAMES", 1)
    picture, *_ = sorted(frames.iterdir(), reverse=True)
    before = picture.read_bytes()
    arguments = (*CAMERA, "-o", tmp_path / "s.json", "--picture", picture)
    code, _, errors = run("calibrate", frames, *arguments)
    assert code == 2
    assert f"picture: {picture} would be written over" in errors
    assert picture.read_bytes() == before


def test_one_camera_of_a_bag_is_calibrated(tmp_path):
    other = "/other/depth/image_raw"

    def contents(messages):
        yield from bag_files.frames(messages)
        yield from bag_files.frames(messages, other, metres=True)
        yield bag_files.INFO, bag_files.START, messages.info()

    bag, sensor = write_bag(tmp_path / "run", "bag", contents), tmp_path / "sensor.json"
    code, _, errors = run("calibrate", bag, "-o", sensor)
    assert code == 2
    assert f"give one (--topic): {bag_files.DEPTH}, {other}" in errors
    assert not sensor.exists()
    topics = ("--topic", other, "--camera-topic", bag_files.INFO)
    code, out, errors = run("calibrate", bag, *topics, "-o", sensor)
    assert code == 0
    assert re.fullmatch(f"{ONE_DEPTH}.*", errors)
    assert "3 of 3 frames used" in out


@pytest.mark.parametrize("seed", range(4))
def test_at_one_depth_noise_is_constant_and_a_warning_says_so(tmp_path, seed):
    rng, out = np.random.default_rng(seed), tmp_path / "s.json"
    wall = 1200 + 4 * rng.standard_normal((240, 320))
    Image.fromarray(wall.round().astype(np.uint16)).save(tmp_path / "wall.png")
    code, _, errors = run("calibrate", tmp_path / "wall.png", *CAMERA, "-o", out)
    assert code == 0
    assert re.fullmatch(f"{ONE_DEPTH}.*", errors)
    assert np.ptp(pw.sensors.load(out).sigma([0.3, 1.2, 9.0])) == 0
    assert json.loads(out.read_text())["calibration"]["caution"].startswith("all flat cells lie")


BAD = {
    "no such file": (("none.png",), "there is no file or folder"),
    "no frame": (("empty",), "empty is an empty folder"),
    "topic of what is no bag": (("wall.png", *CAMERA, "--topic", "/depth"), "no dataset"),
    "no camera": (("wall.png",), "give --camera"),
    "no noise in it": (("void.npy", *CAMERA), "flat cells"),
    "picture of another kind": (
        ("wall.png", *CAMERA, "--picture", "p.jpg"),
        "expected a .png file, got p.jpg",
    ),
    "sensor that is none": (("wall.png", *CAMERA, "--sensor", "eyes"), "neither a preset"),
    "sensor file that is not there": (("wall.png", *CAMERA, "--sensor", "x.json"), "no file"),
    "seed": (("wall.png", *CAMERA, "--seed", "-1"), "seed"),
    "scale": (("wall.png", *CAMERA, "--depth-scale", "nan"), "--depth-scale"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_used_is_named(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    Image.fromarray(np.full((240, 320), 1000, np.uint16)).save("wall.png")
    np.save("void.npy", np.zeros((240, 320)))
    arguments, message = BAD[name]
    code, text, errors = run("calibrate", *arguments, "-o", "sensor.json")
    assert (code, text) == (2, "")
    assert message in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "sensor.json").exists()


def test_output_is_checked_first(frames, tmp_path, monkeypatch):
    noise_of_frame = "planewise.calibration.calibrate.noise_of_frame"
    monkeypatch.setattr(noise_of_frame, lambda *_: pytest.fail("begun"))
    (tmp_path / "file").write_text("")
    for target, message in (
        (tmp_path, "is a folder"),
        (tmp_path / "sensor.yaml", "expected a .json file"),
        (tmp_path / "file" / "sensor.json", "not a folder that can be written to"),
    ):
        code, _, errors = run("calibrate", frames, *CAMERA, "-o", target)
        assert code == 2
        assert message in errors
    for option in ("--camera", "--sensor"):
        kept = tmp_path / "kept.json"
        kept.write_text('{"fx": 250, "fy": 250, "cx": 160, "cy": 120}')
        code, _, errors = run("calibrate", frames, option, kept, "-o", kept)
        assert (code, errors.split()[:2]) == (2, ["error:", "output:"])
        assert "written over" in errors
        assert "fx" in kept.read_text()
    code, _, errors = run(
        "detect", frames / "corner0.png", *CAMERA, "--sensor", "no.json", "-o", "x"
    )
    assert code == 2
    assert "no.json" in errors


def test_sensor_and_picture_are_written_both_or_neither(frames, tmp_path):
    out, picture = tmp_path / "s.json", tmp_path / "p.png"
    os.mkfifo(picture)
    given = (*CAMERA, "-o", out, "--picture", picture)
    code, text, errors = run("calibrate", frames / "corner0.png", *given)
    assert (code, text) == (2, "")
    assert "p.png is not a regular file" in errors
    assert list(tmp_path.iterdir()) == [picture]
    picture.unlink()
    out.mkdir()  # by another program, after it was looked at
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("planewise.commands.calibrate.check_output", lambda *_: None)
        assert run("calibrate", frames / "corner0.png", *given)[0] == 2
    assert list(tmp_path.iterdir()) == [out]


def test_the_picture_stands_without_a_band_and_with_one_depth(camera):
    flat = pw.estimate_noise(np.full((48, 64), 2.0), camera, pw.Sensor())
    assert draw_noise(flat).shape == (500, 800, 3)
    scene = scenes.corner(size=(240, 320))
    found = pw.observe(scene.depth, scene.camera, pw.Sensor(noise="auto")).estimate
    assert draw_noise(found, noise.KINECT, "kinect-v1").std() > 1
