"""planewise bench."""

import json

import numpy as np
import pytest
from PIL import Image

from planewise import scenes
from planewise.commands.bench import timed

from .command import run

STAGES = ("observe", "frame", "cells", "segments", "labels", "ledger", "describe", "rest")


def test_a_room_is_timed():
    code, text, errors = run("bench", "--runs", 2, "--size", "160x120", "--threads", 1)
    assert (code, errors) == (0, "")
    for word in ("threads used: 1 of", "python 3.", "numba", "synthetic room, 160 x 120"):
        assert word in text
    for word in ("median", "quartiles", "frames/s", "first call"):
        assert word in text
    assert "segments" not in text
    assert "…" not in text


def test_stages_and_file_say_the_same(tmp_path):
    out = tmp_path / "bench.json"
    code, text, errors = run("bench", "--runs", 3, "--size", "160x120", "--stages", "--json", out)
    assert (code, errors) == (0, "")
    assert [path.name for path in tmp_path.iterdir()] == ["bench.json"]
    record = json.loads(out.read_text())
    assert (record["schema"], record["schema_version"]) == ("planewise/bench", 1)
    assert record["frame"]["width"] == 160
    assert 0 < record["frame"]["readings"] <= 160 * 120
    times = np.array(record["times_ms"])
    assert len(times) == 3
    assert record["median_ms"] == np.median(times)
    assert record["quartiles_ms"] == list(np.percentile(times, (25, 75)))
    assert set(STAGES) <= set(record["stages_ms"])
    # Medians do not add up where other work interrupts some calls.
    assert all(0 <= each <= times.max() for each in record["stages_ms"].values())
    for name, each in record["stages_ms"].items():
        assert f"{name} {each:.2f} ms" in text
    assert f"{record['median_ms']:.2f} ms" in text
    assert {"python", "planewise", "numpy", "numba"} == set(record["machine"]["versions"])


def test_a_file_is_timed(tmp_path):
    scene = scenes.corner(size=(120, 160))
    depth = tmp_path / "depth.png"
    Image.fromarray(scene.depth).save(depth)
    given = ("--camera", "125,125,80,60", "--noise", "5mm")
    code, text, errors = run("bench", depth, *given, "--runs", 1)
    assert (code, errors) == (0, "")
    assert "depth.png, 160 x 120" in text
    assert "4 planes" in text
    k = (125.0, 125.0, 80.0, 60.0)
    np.savez(tmp_path / "frame.npz", depth=scene.depth, depth_scale=0.001, K=k)
    code, text, _ = run("bench", tmp_path / "frame.npz", "--noise", "5mm", "--runs", 1)
    assert code == 0
    assert "4 planes" in text


def test_stages_of_a_call_without_any():
    class Model:
        readings = 7

        def __len__(self):
            return 2

    calls = []
    times = timed(lambda: calls.append(0) or Model(), 4)
    assert len(calls) == 5
    assert (times.readings, times.planes) == (7, 2)
    assert np.array_equal(times.stages["rest"], times.milliseconds)


BAD_ARGUMENTS = {
    "no runs": (("--runs", "0"), "runs"),
    "size that is none": (("--size", "large"), "size"),
    "size too small": (("--size", "8x8"), "size"),
    "size too large": (("--size", "99999x480"), "size"),
    "no threads": (("--threads", "0"), "threads"),
    "camera without a file": (("--camera", "nyu"), "DEPTH"),
    "noise without a file": (("--noise", "5mm"), "DEPTH"),
    "no folder for the file": (("--json", "nowhere/bench.json"), "json"),
    "a folder for the file": (("--json", "."), "json: . is a folder"),
    "file that is not there": (("no.png", "--camera", "nyu", "--noise", "5mm"), "no.png"),
    "size of a file": (("no.png", "--size", "64x48", "--noise", "5mm"), "size"),
}


@pytest.mark.parametrize("name", BAD_ARGUMENTS)
def test_what_cannot_be_used_is_said(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, word = BAD_ARGUMENTS[name]
    code, text, errors = run("bench", *arguments)
    assert (code, text) == (2, "")
    assert errors.startswith("error: ")
    assert word in errors
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("over", ["depth.png", "camera.json"])
def test_inputs_are_not_written_over(over, tmp_path):
    scene = scenes.corner(size=(120, 160))
    Image.fromarray(scene.depth).save(tmp_path / "depth.png")
    camera = tmp_path / "camera.json"
    camera.write_text('{"fx": 125, "fy": 125, "cx": 80, "cy": 60}')
    before = (tmp_path / over).read_bytes()
    given = ("--camera", camera, "--noise", "5mm", "--runs", 1, "--json", tmp_path / over)
    code, text, errors = run("bench", tmp_path / "depth.png", *given)
    assert (code, text) == (2, "")
    assert errors.startswith("error: json: ")
    assert (tmp_path / over).read_bytes() == before


def test_a_file_without_camera_is_refused(tmp_path):
    Image.fromarray(scenes.corner(size=(120, 160)).depth).save(tmp_path / "depth.png")
    code, _, errors = run("bench", tmp_path / "depth.png", "--noise", "5mm")
    assert code == 2
    assert "--camera" in errors
