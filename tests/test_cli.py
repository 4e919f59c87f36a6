from __future__ import annotations

import errno
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from rich.console import Console
from typer.testing import CliRunner

import planewise as pw
from planewise.commands import terminal
from planewise.commands.app import command_line
from planewise.errors import MissingExtraError
from planewise.files.result_names import FILES
from planewise.metrics.confidence import Interval
from tests.command import run, run_python
from tests.dataset_files import write_sens, write_tum

CAMERA = "125,125,80,60"
ARGUMENTS = ("--camera", CAMERA, "--sensor", "kinect-v1", "--noise", "5mm")
INTERRUPTED = "error: interrupted; nothing was left half-written"
with_signals = pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")


@pytest.fixture
def out(tmp_path):
    return tmp_path / "results" / "frame"


def test_detect_writes_everything_and_says_so(depth, out):
    before = depth.read_bytes()
    code, text, errors = run("detect", depth, *ARGUMENTS, "-o", out)
    assert (code, errors) == (0, "")
    assert sorted(path.name for path in out.iterdir()) == sorted(FILES)
    assert [path.name for path in out.parent.iterdir()] == ["frame"]
    for word in ("rank", "nats", "readings", "share", "normal", "distance", "area", "rms"):
        assert word in text
    assert "nats of planes are against outliers" in text
    assert "4 planes, Phi = " in text
    assert "…" not in text  # nothing is cut off at 80 columns
    assert depth.read_bytes() == before
    record = json.loads((out / "planes.json").read_text())
    assert record["input"]["file"] == "depth.png"
    assert record["sensor"]["noise"] == "0.005 m"


def test_command_line_and_python_agree(depth, out, scene):
    run("detect", depth, *ARGUMENTS, "--max-depth", 2, "--seed", 3, "-o", out)
    camera = pw.PinholeCamera(fx=125, fy=125, cx=80, cy=60)
    sensor = pw.Sensor(max_depth=2.0, noise=0.005)
    model = pw.detect_planes(scene.depth, camera, sensor, rng=3)
    record = json.loads((out / "planes.json").read_text())
    assert record["information"] == model.information
    assert np.array_equal(np.asarray(Image.open(out / "labels.png")), model.labels)


def test_options_reach_the_search(depth, out):
    code, *_ = run(
        *("detect", depth, *ARGUMENTS, "-o", out, "--search", "sequential", "--max-planes", 2),
        *("--confidence", 0.9, "--inlier-ratio", 0.2, "--seed", 7, "--threads", 1),
    )
    assert code == 0
    options = json.loads((out / "planes.json").read_text())["options"]
    expected = {"search": "sequential", "max_planes": 2, "confidence": 0.9, "rng": 7}
    assert options | expected == options
    assert options["inlier_ratio"] == 0.2


def test_an_npz_needs_no_camera_and_brings_its_picture(tmp_path, out, scene):
    path = tmp_path / "frame.npz"
    k = (125.0, 125.0, 80.0, 60.0)
    np.savez(path, depth=scene.depth * 2, depth_scale=0.0005, K=k, rgb=scene.rgb)
    code, text, _ = run("detect", path, "--noise", "0.005", "-o", out)
    assert code == 0
    assert "4 planes" in text
    assert json.loads((out / "planes.json").read_text())["input"]["depth_scale"] == 0.0005


def test_camera_file_and_rgb(depth, out, tmp_path, scene):
    (tmp_path / "camera.json").write_text('{"fx": 125, "fy": 125, "cx": 80, "cy": 60}')
    Image.fromarray(scene.rgb).resize((320, 240)).save(tmp_path / "colour.jpg")
    code, *_ = run(
        *("detect", depth, "--camera", tmp_path / "camera.json", "--noise", "5mm"),
        *("--rgb", tmp_path / "colour.jpg", "-o", out),
    )
    assert code == 0


def test_existing_results_are_replaced(depth, out):
    out.mkdir(parents=True)
    (out / "labels.png").write_text("old")
    (out / "notes.txt").write_text("mine")
    assert run("detect", depth, *ARGUMENTS, "-o", out)[0] == 0
    with Image.open(out / "labels.png") as labels:
        assert labels.size == (160, 120)
    assert (out / "notes.txt").read_text() == "mine"


def test_only_where_a_run_was_its_files_go(depth, out):
    out.mkdir(parents=True)
    others = ("planes.ply", "planes.obj", "planes.mtl", "outlines.json", "labelled.las")
    for name in others:
        (out / name).write_text("mine")
    assert run("detect", depth, *ARGUMENTS, "-o", out)[0] == 0
    assert sorted(path.name for path in out.iterdir()) == sorted((*FILES, *others))
    assert {(out / name).read_text() for name in others} == {"mine"}
    assert run("detect", depth, *ARGUMENTS, "-o", out)[0] == 0
    assert sorted(path.name for path in out.iterdir()) == sorted(FILES)


def test_a_link_to_nothing_is_no_output(depth, tmp_path):
    (tmp_path / "link").symlink_to("nowhere")
    code, _, errors = run("detect", depth, *ARGUMENTS, "-o", tmp_path / "link")
    assert code == 2
    assert f"output: {tmp_path / 'link'} is a link to what is not there" in errors
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "link"]


def test_terminals_obey_no_name_of_a_file(depth, tmp_path):
    hostile = "a\x1b]0;title\x07\x9b31m\x1b[2J [red]b"
    code, _, errors = run("detect", tmp_path / hostile, *ARGUMENTS, "-o", tmp_path / "out")
    assert code == 2
    assert r"a\x1b]0;title\x07\x9b31m\x1b[2J [red]b" in errors
    assert all(each.isprintable() for each in errors.rstrip("\n"))


def test_lines_that_are_wrapped_hold_no_controls(monkeypatch):
    shown = io.StringIO()
    monkeypatch.setattr(terminal, "_OUT", Console(width=80, file=shown))
    terminal.say_wrapped("a\x1b[2J\tb\n")
    assert shown.getvalue() == "a\\x1b[2J b\n"


def test_what_a_stream_cannot_encode_is_no_error():
    code = "import sys; sys.argv[1:] = ['info']; from planewise.cli import main; main()"
    told = run_python(code, PYTHONIOENCODING="ascii", COLUMNS="60")
    assert (told.returncode, told.stderr) == (0, "")
    assert "kinect-v1" in told.stdout


@pytest.mark.parametrize("errors", ["strict", "surrogateescape"])
def test_signs_that_a_stream_does_not_have_are_words(errors):
    """As in the C locale, whose streams take bytes of names for granted, and else nothing."""
    code = "from planewise import cli; from planewise.commands import terminal as t\n"
    code += "cli._encode_all(); t.say('\\u03c3 = 5 mm \\xb1 1 \\u2603 \\udc9b')"
    told = run_python(code, PYTHONIOENCODING=f"ascii:{errors}")
    assert told.stdout == "sigma = 5 mm +- 1 ? ?\n"


def test_no_number_is_cut_off_in_a_narrow_terminal(monkeypatch):
    shown = io.StringIO()
    monkeypatch.setattr(sys, "stdout", shown)
    monkeypatch.setattr(terminal, "_OUT", Console(width=40, file=shown))
    names = ("objective and noise", "VOI", "RI", "SC")
    rows = [("published, 2 % of depth", "1.503±4.321", "0.895±0.123", "0.731±0.057")]
    terminal.show_table("A table", rows, names)
    terminal.show_scores({"voi_labelled": Interval(mean=0.571, low=0.48, high=0.66, count=35)})
    for text in (*rows[0], "0.4800 ... 0.6600", "voi_labelled"):
        assert text in shown.getvalue()


def test_small_areas_have_three_digits_their_points_below_each_other(monkeypatch, scene):
    shown = io.StringIO()
    monkeypatch.setattr(sys, "stdout", shown)
    camera = pw.PinholeCamera(fx=125, fy=125, cx=80, cy=60)
    model = pw.detect_planes(scene.depth, camera, pw.Sensor(noise=0.005))
    areas = (12.3456, 0.01912, 0.00041234, float("nan"))
    planes = (replace(plane, area=area) for plane, area in zip(model.planes, areas, strict=True))
    terminal.show_planes(replace(model, planes=tuple(planes)))
    *lines, unknown = (line.partition(" m ")[2] for line in shown.getvalue().splitlines()[1:5])
    assert [line.split()[0] for line in lines] == ["12.346", "0.0191", "0.000412"]
    assert (
        len({line.index(".") for line in lines}) == len({line.index(" m2") for line in lines}) == 1
    )
    assert "m2" not in unknown


@pytest.mark.parametrize("columns", [40, 80])
def test_no_name_of_an_option_is_cut_off_in_a_narrow_terminal(columns):
    code = "import sys; from planewise.cli import main; sys.argv[1:] = {}; main()"
    told = run_python(code.format(["detect", "-h"]), COLUMNS=str(columns)).stdout
    for name in ("--output", "--inlier-ratio", "--significance"):
        assert name in told
    told = run_python(code.format([]), check=False, COLUMNS=str(columns))
    assert (told.returncode, told.stderr) == (2, "")
    assert "calibrate" in told.stdout


@pytest.mark.parametrize(
    "arguments", [("--version",), ("-h",), ("detect", "none.png", "-o", "out")]
)
def test_a_terminal_of_no_columns_hides_nothing(arguments):
    code = "from planewise.cli import main; main()"
    told = run_python(code, *arguments, check=False, COLUMNS="0")
    usual = run_python(code, *arguments, check=False, COLUMNS="80")
    assert usual.stdout + usual.stderr
    assert (told.stdout, told.stderr) == (usual.stdout, usual.stderr)


BAD_ARGUMENTS = {
    "camera of another size": (("--camera", "nyu"), "camera"),
    "zero focal length": (("--camera", "0,125,80,60"), "fx"),
    "focal length in metres": (("--camera", "0.125,0.125,80,60"), "fx"),
    "focal length far too long": (("--camera", "125000,125000,80,60"), "fx"),
    "centre of a larger image": (("--camera", "125,125,800,60"), "cx"),
    "camera that is none": (("--camera", "nikon"), "camera"),
    "sensor that is none": (("--sensor", "eyes"), "sensor"),
    "noise zero": (("--noise", "0"), "noise"),
    "noise negative": (("--noise", "-0.1"), "noise"),
    "noise nan": (("--noise", "nan"), "noise"),
    "range below resolution": (("--max-depth", "0.0005"), "resolution"),
    "range nan": (("--max-depth", "nan"), "--max-depth must"),
    "range of no number": (("--max-depth", "1.7e308"), "--max-depth must be at most 1e+09 metres"),
    "resolution too fine": (("--resolution", "1e-310"), "resolution must be at least 1e-12 metres"),
    "scale too fine": (("--depth-scale", "1e-300"), "--depth-scale must lie within 1e-12 and"),
    "noise too large": (("--noise", "1e300"), "noise must be positive and finite"),
    "resolution zero": (("--resolution", "0"), "resolution"),
    "resolution above range": (("--resolution", "20"), "resolution"),
    "scale zero": (("--depth-scale", "0"), "--depth-scale must"),
    "no planes": (("--max-planes", "0"), "--max-planes must"),
    "confidence one": (("--search", "sequential", "--confidence", "1"), "confidence must lie"),
    "inlier ratio zero": (("--search", "sequential", "--inlier-ratio", "0"), "--inlier-ratio must"),
    "confidence of no samples": (("--confidence", "0.9"), "confidence goes with --search seq"),
    "inlier ratio of no samples": (("--inlier-ratio", "0.2"), "--inlier-ratio goes with --search"),
    "confidence in regions": (
        ("--search", "sequential", "--partition", "blocks", "--confidence", "0.9"),
        "confidence goes with --search sequential without a --partition",
    ),
    "seed negative": (("--seed", "-1"), "seed"),
    "no threads": (("--threads", "0"), "threads"),
    "search that is none": (("--search", "magic"), "'--search': 'magic' is not one of"),
    "instances of the paper": (
        ("--instances", "--objective", "paper"),
        "--instances needs --objective spatial",
    ),
    "option that is none": (("--magic",), "; see 'planewise detect -h'"),
    "rgb that is not there": (("--rgb", "none.png"), "rgb"),
}


@pytest.mark.parametrize("name", BAD_ARGUMENTS)
def test_bad_arguments(depth, out, name):
    arguments, named = BAD_ARGUMENTS[name]
    code, text, errors = run("detect", depth, *ARGUMENTS, *arguments, "-o", out)
    assert (code, text) == (2, "")
    assert errors.startswith("error: ")
    assert named in errors
    assert "Traceback" not in errors
    assert not out.parent.exists()


@pytest.mark.parametrize(
    ("arguments", "named"), [(("-o", ""), "an argument"), (("--output=",), "--output")]
)
def test_an_empty_argument_is_not_the_current_folder(
    depth, tmp_path, monkeypatch, arguments, named
):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    code, text, errors = run("detect", depth, *ARGUMENTS, *arguments)
    assert (code, text) == (2, "")
    assert errors.startswith(f"error: {named} is empty, perhaps a variable of the shell")
    assert sorted(tmp_path.iterdir()) == before


def bad_image(path, kind):
    """Write an unusable image of some kind; return its path."""
    good = np.full((120, 160), 1000, np.uint16)
    path = path.with_suffix(
        ".npy" if kind in ("line", "row", "column", "negative", "text") else ".png"
    )
    if kind == "line":
        np.save(path, good.ravel())
    elif kind == "row":
        np.save(path, good[:1])
    elif kind == "column":
        np.save(path, good[:, :1])
    elif kind == "negative":
        np.save(path, good - 1001.0)
    elif kind == "text":
        np.save(path, np.full((120, 160), "1"))
    elif kind == "8 bits":
        Image.fromarray(good.astype(np.uint8)).save(path)
    elif kind == "colour":
        Image.fromarray(np.zeros((120, 160, 3), np.uint8)).save(path)
    elif kind == "truncated":
        Image.fromarray(np.arange(120 * 160, dtype=np.uint16).reshape(120, 160)).save(path)
        path.write_bytes(path.read_bytes()[:-2000])
    elif kind == "junk":
        path.write_bytes(b"junk")
    return path


@pytest.mark.parametrize(
    "kind",
    ["line", "row", "column", "negative", "text", "8 bits", "colour", "truncated", "junk", "none"],
)
def test_bad_images(tmp_path, out, kind):
    path = bad_image(tmp_path / "depth", kind)
    code, text, errors = run("detect", path, *ARGUMENTS, "-o", out)
    assert (code, text) == (2, "")
    assert "depth" in errors
    assert "Traceback" not in errors
    assert not out.parent.exists()


def test_folder_that_cannot_be_made(depth, tmp_path, monkeypatch):
    find_planes = "planewise.commands.jobs.find_planes"
    monkeypatch.setattr(find_planes, lambda *_: pytest.fail("work was started"))
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "file", tmp_path / "file" / "out"):
        code, _, errors = run("detect", depth, *ARGUMENTS, "-o", target)
        assert code == 2
        assert "output" in errors
        code, _, errors = run("detect", depth.parent, *ARGUMENTS, "-o", target)
        assert code == 2
        assert "output" in errors


def test_a_full_disk_is_said_and_leaves_nothing(depth, out, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("planewise.commands.jobs.write_results", full)
    code, text, errors = run("detect", depth, *ARGUMENTS, "-o", out)
    assert (code, text) == (2, "")
    no_room = "error: output: there is no room left for the results (No space left"
    assert errors.startswith(no_room)
    assert not out.exists()
    depth.with_name("second.png").write_bytes(depth.read_bytes())
    code, text, errors = run("detect", depth.parent, *ARGUMENTS, "-o", out)
    assert (code, text) == (2, "")
    assert errors.startswith(no_room)
    assert errors.count("error: ") == 1
    assert not out.exists()


def test_inputs_are_not_written_over(tmp_path, depth):
    mine = depth.rename(depth.with_name("labels.png"))
    before = mine.read_bytes()
    code, _, errors = run("detect", mine, *ARGUMENTS, "-o", mine.parent)
    assert code == 2
    assert "output" in errors
    assert mine.read_bytes() == before


def test_a_camera_file_is_not_written_over(depth, tmp_path):
    kept = tmp_path / "planes.json"
    kept.write_text('{"fx": 125, "fy": 125, "cx": 80, "cy": 60}')
    for camera in (kept, f"{kept}:raw"):
        code, _, errors = run("detect", depth, "--camera", camera, "--noise", "5mm", "-o", tmp_path)
        assert code == 2
        assert "written over" in errors
        assert "fx" in kept.read_text()


def test_a_camera_that_may_be_another_is_told(depth, tmp_path):
    camera = tmp_path / "camera_info.yaml"
    camera.write_text(
        "D: [0.001, 0, 0, 0, 0]\nK: [125, 0, 80, 0, 125, 60, 0, 0, 1]\n"
        "P: [120, 0, 80, 0, 0, 120, 60, 0, 0, 0, 1, 0]\n"
    )
    out = ("--noise", "5mm", "-o", tmp_path / "out")
    code, _, errors = run("detect", depth, "--camera", camera, *out)
    assert code == 0
    assert "camera_info.yaml:raw or camera_info.yaml:rect" in errors
    code, _, errors = run("detect", depth, "--camera", f"{camera}:rect", *out)
    assert (code, errors) == (0, "")
    camera = json.loads((tmp_path / "out" / "planes.json").read_text())["camera"]
    assert camera == {"fx": 120, "fy": 120, "cx": 80, "cy": 60}


@with_signals
@pytest.mark.parametrize("arguments", [("info",), ("--help",), ("none",)])
def test_a_closed_pipe_ends_quietly(arguments):
    code = """if True:
        import os, sys
        from planewise.cli import main
        reading, writing = os.pipe()
        os.close(reading)
        os.dup2(writing, 1)
        main()
        """
    told = run_python(code, *arguments, check=False)
    if arguments == ("none",):  # has nothing to say there
        assert (told.returncode, told.stderr.count("\n")) == (2, 1)
    else:
        assert (told.returncode, told.stderr) == (141, "")


@pytest.mark.skipif(sys.platform != "linux", reason="a device that is always full")
@pytest.mark.parametrize("columns", ["40", "80"])
@pytest.mark.parametrize("arguments", [(), ("--version",), ("detect", "-h")])
def test_help_that_cannot_be_written_is_no_traceback(arguments, columns):
    code = """if True:
        import os, sys
        from planewise.cli import main
        os.dup2(os.open("/dev/full", os.O_WRONLY), 1)
        main()
        """
    told = run_python(code, *arguments, check=False, COLUMNS=columns)
    reason = "stdout cannot be written to (No space left on device)"
    assert (told.returncode, told.stderr) == (2, f"error: {reason}\n")


def test_a_file_that_is_not_there_is_said_first(out):
    assert "no file or folder none.png" in run("detect", "none.png", "-o", out)[2]


def test_what_has_to_be_given_is_named(depth, out):
    assert "camera" in run("detect", depth, "--sensor", "nyu", "-o", out)[2]
    assert "sensor" in run("detect", depth, "--camera", CAMERA, "-o", out)[2]
    assert "--output" in run("detect", depth, "--camera", CAMERA)[2]
    assert run("detect")[0] == 2


@pytest.mark.parametrize("value", [0.0, np.nan, 50.0])
def test_frames_without_readings_warn_and_are_written(tmp_path, out, value):
    path = tmp_path / "empty.npy"
    np.save(path, np.full((120, 160), value))
    code, text, errors = run("detect", path, *ARGUMENTS, "-o", out)
    assert code == 0
    assert "0 planes" in text
    assert "warning" in errors
    assert "0 valid readings" in errors
    assert sorted(path.name for path in out.iterdir()) == sorted(FILES)


def test_constant_depth_is_a_plane(tmp_path, out):
    np.save(tmp_path / "wall.npy", np.full((120, 160), 2.0))
    code, text, errors = run("detect", tmp_path / "wall.npy", *ARGUMENTS, "-o", out)
    assert (code, errors) == (0, "")
    assert "1 plane," in text


def test_folder_goes_on_after_a_bad_frame(depth, tmp_path, out, scene):
    folder = depth.parent
    np.save(folder / "f2.npy", scene.depth)
    np.save(folder / "f10.npy", np.zeros((120, 160)))
    Image.fromarray(np.zeros((120, 160), np.uint8)).save(folder / "f3.png")
    (folder / "notes.txt").write_text("not depth")
    pictures = tmp_path / "rgb"
    pictures.mkdir()
    for name in ("depth", "f2", "f3", "f10"):
        Image.fromarray(scene.rgb).save(pictures / f"{name}.jpg")
    code, text, errors = run("detect", folder, *ARGUMENTS, "--rgb", pictures, "-o", out)
    assert code == 2
    assert "3 of 4 frames done" in text
    assert text.index("depth.png") < text.index("f2.npy") < text.index("f10.npy")
    assert "f3.png" in errors
    assert "8 bits" in errors
    assert "f10.npy: no plane was found" in errors
    assert sorted(path.name for path in out.iterdir()) == ["depth", "f10", "f2"]
    for frame in out.iterdir():
        assert sorted(path.name for path in frame.iterdir()) == sorted(FILES)


def test_a_bad_frame_of_a_folder_is_named_whatever_is_wrong_with_it(depth, out, scene):
    np.save(depth.parent / "below.npy", -scene.depth.astype(np.float32))
    camera = depth.parent.parent / "camera.json"
    camera.write_text('{"fx": 131, "fy": 131, "cx": 79, "cy": 59, "width": 160, "height": 120}')
    np.save(depth.parent / "half.npy", scene.depth[::2, ::2])
    arguments = ("--camera", camera, "--sensor", "nyu", "-o", out)
    code, text, errors = run("detect", depth.parent, *arguments)
    assert code == 2
    assert "1 of 3 frames done" in text
    assert "error: below.npy: depth must not be negative" in errors
    assert "error: half.npy: camera is for images of 160 x 120 pixels" in errors


def test_a_frame_that_fails_now_is_said_to_keep_what_an_earlier_run_found(depth, out, scene):
    np.save(depth.parent / "other.npy", scene.depth)
    assert run("detect", depth.parent, *ARGUMENTS, "-o", out)[0] == 0
    np.save(depth.parent / "other.npy", -scene.depth.astype(np.float32))
    code, _, errors = run("detect", depth.parent, *ARGUMENTS, "-o", out)
    assert code == 2
    assert f"; {out / 'other'} still has what an earlier run found" in " ".join(errors.split())
    assert errors.count("an earlier run") == 1


def test_frames_of_another_size_are_warned_of_once(depth, out, scene):
    np.save(depth.parent / "half1.npy", scene.depth[::2, ::2])
    np.save(depth.parent / "half2.npy", scene.depth[::2, ::2])
    camera = ("--camera", "131,131,39.5,29.5", "--sensor", "nyu")
    code, _, errors = run("detect", depth.parent, *camera, "-o", out)
    assert (code, errors.count("warning: ")) == (0, 1)
    assert "half1.npy has 80 x 60 pixels and frames before it 160 x 120; --camera is" in errors


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize(
    ("module", "extra", "options"),
    [
        ("shapely", "cloud", ("--outlines",)),
        ("skimage.segmentation", "partition", ("--partition", "graph")),
    ],
)
def test_a_package_that_options_need_is_missed_at_once(
    module, extra, options, many, depth, out, scene, monkeypatch
):
    """Not once for each frame, nor after it was detected, or loops were compiled for it."""

    def observe(*_, **__):
        raise AssertionError("it looked at a frame")

    np.save(depth.parent / "another.npy", scene.depth)
    monkeypatch.setattr("planewise.observation.observe", observe)
    monkeypatch.setitem(sys.modules, module, None)
    given = depth.parent if many else depth
    code, text, errors = run("detect", given, *ARGUMENTS, *options, "-o", out)
    assert (code, text) == (2, "")
    assert errors.count("error: ") == errors.count(f"'planewise[{extra}]'") == 1
    assert not out.exists()


def test_a_package_that_frames_need_is_missed_once(depth, out, scene, monkeypatch):
    np.save(depth.parent / "another.npy", scene.depth)

    def lacking(*_, **__):
        raise MissingExtraError("openexr", "reading .exr files")

    monkeypatch.setattr("planewise.commands.jobs.read_depth", lacking)
    code, text, errors = run("detect", depth.parent, *ARGUMENTS, "-o", out)
    assert (code, text) == (2, "")
    assert errors.count("openexr") == 1
    assert not out.exists()


@pytest.mark.parametrize("before", [False, True])
def test_where_files_are_is_said_only_if_there_are_any(depth, out, before):
    depth.write_bytes(b"nothing")
    if before:
        out.mkdir(parents=True)
        (out / "notes.txt").write_text("mine")
    code, text, _ = run("detect", depth.parent, *ARGUMENTS, "-o", out)
    assert (code, text) == (2, "0 of 1 frame done ")


def test_one_picture_is_none_of_a_folder(depth, out, tmp_path, scene):
    picture = tmp_path / "rgb.png"
    Image.fromarray(scene.rgb).save(picture)
    code, _, errors = run("detect", depth.parent, *ARGUMENTS, "--rgb", picture, "-o", out)
    assert code == 2
    assert "rgb.png is one picture; a folder of depth images takes a folder of them" in errors
    assert not out.exists()


def test_readings_out_of_range_are_said(depth, out, scene):
    far = np.quantile(scene.depth, 0.4) / 1000
    arguments = ("--camera", CAMERA, "--sensor", "nyu", "-o", out, "--max-depth", f"{far:.3f}")
    code, text, errors = run("detect", depth, *arguments)
    assert code == 0
    assert "0 planes" not in text
    assert re.search(r"warning: \d+ of 19200 lie outside the sensor's range of 0 to ", errors)
    assert "units were taken for 1 mm (--depth-scale 0.001)" in errors
    assert "are they 1/5000 m (--depth-scale 0.0002)?" in errors
    code, text, errors = run("detect", depth.parent, *arguments)
    assert "warning: depth.png: " in errors


@pytest.mark.parametrize("kept", [0, 300])
def test_readings_out_of_range_are_said_once_without_planes(depth, out, kept):
    far = np.random.default_rng(0).integers(20_000, 60_000, (120, 160))
    far.flat[:kept] = np.random.default_rng(1).integers(500, 3000, kept)  # no plane either
    Image.fromarray(far.astype(np.uint16)).save(depth)
    for given in (depth, depth.parent):
        code, text, errors = run("detect", given, *ARGUMENTS, "-o", out)
        assert code == 0
        assert "0 planes" in text
        assert errors.count("no plane was found") == 1
        assert errors.count("lie outside the sensor's range") == 1


def test_lines_of_results_are_80_columns(out):
    result = CliRunner().invoke(command_line(), ["demo", "-o", str(out)])
    lines = [line for line in result.stdout.splitlines() if str(out) not in line]
    assert "302,507 readings" in result.stdout
    assert max(map(len, lines)) <= 80


def test_frames_of_the_same_name_keep_apart(depth, out, scene):
    np.save(depth.with_suffix(".npy"), scene.depth)
    assert run("detect", depth.parent, *ARGUMENTS, "-o", out)[0] == 0
    assert sorted(path.name for path in out.iterdir()) == ["depth.npy", "depth.png"]


def test_no_frame_has_the_folder_of_another(depth, out, scene):
    names = ["depth.npy", "depth.png", "depth.png.npy"]  # the last one's stem is a name
    for name in (names[0], names[2]):
        np.save(depth.with_name(name), scene.depth)
    assert run("detect", depth.parent, *ARGUMENTS, "-o", out)[0] == 0
    assert sorted(path.name for path in out.iterdir()) == names
    for name in names:
        record = json.loads((out / name / "planes.json").read_text())
        assert record["input"]["file"] == name


def test_a_dataset_is_for_batch(tmp_path, out):
    for data in (write_tum(tmp_path / "tum"), write_sens(tmp_path / "scan.sens")):
        code, _, errors = run("detect", data, "--camera", "nyu", "-o", out)
        assert code == 2
        assert "is a dataset of the kind '" in errors
        assert errors.endswith("'; 'planewise batch' takes it ")
        assert not out.exists()


def test_folder_without_frames(tmp_path, out):
    code, _, errors = run("detect", tmp_path, *ARGUMENTS, "-o", out)
    assert code == 2
    assert "no depth files" in errors
    assert not out.parent.exists()


def test_demo(tmp_path):
    code, text, errors = run("demo", "-o", tmp_path / "demo", "--seed", 1)
    assert (code, errors) == (0, "")
    assert re.search(r"\d+ of the room's \d+ planes were found", text)
    names = {path.name for path in (tmp_path / "demo").iterdir()}
    assert names == {*FILES, "rgb.png", "depth.png", "truth.png"}
    assert np.asarray(Image.open(tmp_path / "demo" / "depth.png")).dtype == np.uint16


def test_a_demo_replaces_an_earlier_one_with_its_outlines(tmp_path):
    assert run("demo", "-o", tmp_path)[0] == 0
    before = (tmp_path / "planes.json").read_bytes()
    (tmp_path / "planes.ply").write_bytes(b"as detect --outlines writes it")
    assert run("demo", "-o", tmp_path, "--seed", 1)[0] == 0
    assert not (tmp_path / "planes.ply").exists()
    assert (tmp_path / "planes.json").read_bytes() != before


@pytest.mark.parametrize("names", [["depth.png"], ["truth.png"], ["rgb.png", "truth.png"]])
@pytest.mark.parametrize("planes", ["{}", '{"input": {"file": "depth.png"}}', None])
def test_demo_replaces_nothing_but_a_demo(tmp_path, names, planes):
    for name in names:
        (tmp_path / name).write_bytes(b"mine")
    if planes is not None:
        (tmp_path / "planes.json").write_text(planes)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    code, _, errors = run("demo", "-o", tmp_path)
    assert code == 2
    assert f"{names[0]} is no demo's and would be replaced" in errors
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_info_and_version():
    code, text, _ = run("info")
    assert code == 0
    for word in (pw.__version__, "NumPy", "Numba", "threads", "cache", "kinect-v1", "518.86"):
        assert word in text
    assert run("--version")[1].strip() == f"planewise {pw.__version__}"
    for command in ("detect", "demo", "info"):
        assert command in run("--help")[1]


def test_library_warnings_go_to_stderr(depth, out, monkeypatch, started):
    from planewise import compilation

    compilation.announce.cache_clear()
    monkeypatch.setattr(compilation, "is_cached", lambda _: False)
    monkeypatch.setattr(compilation, "available", lambda: 2)
    monkeypatch.delenv("PLANEWISE_COMPILES_FOR_ANOTHER", raising=False)
    code, text, errors = run("detect", depth, *ARGUMENTS, "-o", out)
    assert code == 0
    parts = "describing", "valuing", "labelling", "surfaces"
    assert started == [[sys.executable, "-P", "-m", "planewise.warm_up", *parts]]
    assert "compiling" in errors
    assert "ms, compiling included, files in" in text
    assert "compiling for this machine" not in text
    compilation.announce("cloud")
    assert started[1:] == [[sys.executable, "-P", "-m", "planewise.clouds.warm_up"]]
    monkeypatch.undo()
    compilation.announce.cache_clear()
    monkeypatch.setattr(compilation, "_said", set())  # whatever the tests before have compiled
    text = run("detect", depth, *ARGUMENTS, "-o", out)[1]
    assert "compiling" not in text


def process(*arguments, **options):
    command = [sys.executable, "-m", "planewise.cli", *map(str, arguments)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


@with_signals
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_interrupt_leaves_nothing(depth, out, name):
    how = getattr(signal, name)

    def interruptible():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

    job = process(
        *("detect", depth, *ARGUMENTS, "-o", out, "--search", "sequential"),
        *("--inlier-ratio", "0.01", "--threads", "1"),
        preexec_fn=interruptible,
    )
    deadline = time.monotonic() + 60
    while not out.parent.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(0.3)
    assert job.poll() is None, job.communicate()
    interrupted = time.monotonic()
    job.send_signal(how)
    text, errors = job.communicate(timeout=60)
    # Where it comes within exec() of a string, CPython ends by the signal: 130 to a shell, too.
    assert job.returncode in (130, -signal.SIGINT)
    assert time.monotonic() - interrupted < 5
    assert text == ""
    assert errors.strip() == INTERRUPTED
    assert not out.parent.exists()


def detect_after(code, depth, out, **environment):
    """Exit code and lines on stderr of `planewise detect` in a process that runs `code` first."""
    code += f"""
from planewise.cli import main
sys.argv = ["planewise", "detect", {str(depth)!r}, *{ARGUMENTS!r}, "-o", {str(out)!r}]
main()
"""
    job = run_python(code, check=False, **environment)
    assert not out.parent.exists()
    return job.returncode, job.stderr.strip().splitlines()


@pytest.mark.parametrize("where", ["planewise.commands.app.command_line", "planewise.search.find"])
def test_what_an_interrupt_leaves_half_made_says_nothing(depth, out, where):
    """As an object of llvmlite, which looks for what it has not got yet when it is deleted."""
    module, name = where.rsplit(".", 1)
    code = f"""
import importlib, sys
class Half:
    def __init__(self, *_, **__): raise KeyboardInterrupt
    def __del__(self): self.missing
setattr(importlib.import_module("{module}"), "{name}", Half)
"""
    assert detect_after(code, depth, out) == (130, [INTERRUPTED])


@pytest.mark.parametrize("drops", ["an object that is deleted", "a callback from C"])
def test_an_interrupt_that_python_drops_comes_again(depth, out, drops):
    code = f"""
import ctypes, sys, time
import planewise.search
class Dropped:
    def __del__(self): raise KeyboardInterrupt
@ctypes.CFUNCTYPE(None)
def callback(): raise KeyboardInterrupt
def find(*_, **__):
    if {drops!r} == "a callback from C": callback()
    else: Dropped()
    for _ in range(1000): time.sleep(0.01)
planewise.search.find = find
"""
    assert detect_after(code, depth, out) == (130, [INTERRUPTED])


@with_signals
@pytest.mark.parametrize("where", ["it works", "an object is deleted"])
def test_an_error_that_comes_of_an_interrupt_is_no_traceback(depth, out, where):
    """Numba's registries, if they are interrupted: RuntimeError, generator raised StopIteration."""
    code = f"""
import os, signal, sys
import planewise.search
class Deleted:
    def __del__(self): os.kill(os.getpid(), signal.SIGINT)
def find(*_, **__):
    try:
        if {where!r} == "it works": os.kill(os.getpid(), signal.SIGINT)
        else: Deleted()
    finally:
        raise RuntimeError("half-made")
planewise.search.find = find
signal.signal(signal.SIGINT, signal.default_int_handler)
"""
    assert detect_after(code, depth, out) == (130, [INTERRUPTED])


@with_signals
@pytest.mark.parametrize("where", ["shutil.rmtree", "planewise.commands.terminal.error"])
def test_a_second_interrupt_lets_the_command_tidy_up(depth, out, where):
    module, name = where.rsplit(".", 1)
    code = f"""
import importlib, os, signal, sys
import planewise.search
module = importlib.import_module("{module}")
ends = module.{name}
def find(*_, **__): os.kill(os.getpid(), signal.SIGINT)
def with_ctrl_c(*arguments, **options):
    os.kill(os.getpid(), signal.SIGINT)
    ends(*arguments, **options)
planewise.search.find, module.{name} = find, with_ctrl_c
signal.signal(signal.SIGINT, signal.default_int_handler)
"""
    assert detect_after(code, depth, out) == (130, [INTERRUPTED])


@with_signals
def test_an_interrupt_that_is_caught_does_not_make_the_next_one_vain():
    code = """
import os, signal, time
from planewise.commands import interrupts
signal.signal(signal.SIGINT, signal.default_int_handler)
interrupts.heed_interrupts()
for _ in range(2):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(100): time.sleep(0.01)
    except KeyboardInterrupt:
        print("caught")
        time.sleep(interrupts._ENDING)
"""
    assert run_python(code).stdout.split() == ["caught", "caught"]


@with_signals
def test_an_interrupt_while_llvm_calls_back_ends_the_command(depth, out, tmp_path):
    """Numba would go on without what LLVM has compiled."""
    code = """
import os, signal, sys
from numba.core.codegen import CPUCodeLibrary
compiled = CPUCodeLibrary._object_compiled_hook
@classmethod
def with_ctrl_c(cls, module, code):
    os.kill(os.getpid(), signal.SIGINT)
    compiled(module, code)
CPUCodeLibrary._object_compiled_hook = with_ctrl_c
signal.signal(signal.SIGINT, signal.default_int_handler)
"""
    anew = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PLANEWISE_COMPILES_FOR_ANOTHER": "1"}
    ended, (announced, *rest) = detect_after(code, depth, out, **anew)
    assert ended == 130
    assert announced.startswith("compiling for this machine, once (10 s, or minutes on a busy ")
    assert rest == [INTERRUPTED]


def test_only_the_command_that_is_asked_for_is_loaded():
    loaded = (
        "import sys; from planewise.commands.app import command_line; command_line(sys.argv[1:]);"
        "print(*sorted(m for m in sys.modules if m.startswith('planewise.commands.')))"
    )

    def modules(*arguments):
        return run_python(loaded, *arguments).stdout.split()

    everything = {f"planewise.commands.{name}" for name in ("detect", "batch", "eval", "info")}
    assert everything <= set(modules("--help"))
    assert everything <= set(modules("detcet"))
    assert everything & set(modules("eval", "--iou", "0.5")) == {"planewise.commands.eval"}


def test_without_the_extra_one_line_says_so(tmp_path):
    (tmp_path / "typer.py").write_text("raise ModuleNotFoundError('no typer', name='typer')")
    job = process("info", env={**os.environ, "PYTHONPATH": str(tmp_path)})
    text, errors = job.communicate(timeout=60)
    assert job.returncode == 1
    assert text == ""
    assert errors.count("\n") == 1
    assert "planewise[cli]" in errors
