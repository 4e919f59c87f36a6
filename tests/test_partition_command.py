"""`planewise detect --partition`."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

import planewise as pw
from planewise.results.partition import read_partition
from tests.command import run
from tests.test_cli import ARGUMENTS


def options_of(out):
    return json.loads((out / "planes.json").read_text())["options"]


@pytest.mark.parametrize("kind", ["png", "npy", "npz", "masks.npy", "folder"])
def test_every_kind_of_file_gives_the_same_regions(kind, depth, tmp_path, scene):
    labels = scene.labels.astype(np.uint8)
    masks = labels == np.arange(1, labels.max() + 1)[:, None, None]
    path = tmp_path / f"regions.{kind}"
    if kind == "png":
        Image.fromarray(labels).save(path)
    elif kind == "npy":
        np.save(path, labels)
    elif kind == "npz":
        np.savez(path, labels=labels)
    elif kind == "masks.npy":
        np.save(path, masks)
    else:
        path.mkdir()
        for i, mask in enumerate(masks):
            Image.fromarray(mask).save(path / f"{i}.png")
    out = tmp_path / "out"
    search = ("--search", "sequential", "--max-depth", 2)
    code, _, errors = run("detect", depth, *ARGUMENTS, *search, "--partition", path, "-o", out)
    assert (code, errors) == (0, "")
    camera = pw.PinholeCamera(fx=125, fy=125, cx=80, cy=60)
    sensor = pw.Sensor(max_depth=2.0, noise=0.005)
    model = pw.detect_planes(
        scene.depth, camera, sensor, search="sequential", partition=scene.labels
    )
    with Image.open(out / "labels.png") as image:
        found = np.asarray(image)
    assert np.array_equal(found, model.labels)
    wanted = f"{len(masks)} masks" if kind in ("masks.npy", "folder") else "label image"
    options = options_of(out)
    assert options["partition"] == wanted
    assert not {"confidence", "inlier_ratio"} & options.keys()  # the regions have their own


@pytest.mark.parametrize("name", ["blocks", "graph", "auto"])
def test_partitions_by_name(name, depth, tmp_path, scene):
    out = tmp_path / "out"
    code, _, errors = run("detect", depth, *ARGUMENTS, "--partition", name, "-o", out)
    assert (code, errors) == (0, "")
    assert options_of(out)["partition"].startswith("blocks of" if name == "blocks" else "graph")


def test_a_folder_of_frames_takes_a_folder_of_regions(depth, tmp_path, scene):
    frames, regions = depth.parent, tmp_path / "regions"
    Image.fromarray(scene.depth).save(frames / "second.png")
    Image.fromarray(scene.depth).save(frames / "third.png")
    (regions / "second").mkdir(parents=True)
    Image.fromarray(scene.labels.astype(np.uint8)).save(regions / "depth.png")
    for j in (1, 2):
        Image.fromarray(scene.labels == j).save(regions / "second" / f"{j}.png")
    code, text, errors = run(
        "detect", frames, *ARGUMENTS, "--partition", regions, "-o", tmp_path / "out"
    )
    assert code == 2
    assert "holds no label image and no folder of masks named third" in errors
    assert "2 of 3 frames done" in text
    assert options_of(tmp_path / "out" / "depth")["partition"] == "label image"
    assert options_of(tmp_path / "out" / "second")["partition"] == "2 masks"


def test_pictures_are_looked_at(depth, tmp_path, scene):
    rgb = tmp_path / "rgb.png"
    picture = np.zeros((*scene.depth.shape, 3), np.uint8)
    picture[:, 80:] = 255
    Image.fromarray(picture).save(rgb)
    seen = []

    def look(view):
        seen.append(view.rgb)
        return np.zeros(view.depth.shape, int)

    from planewise.commands.jobs import Job
    from planewise.options import Options

    camera = pw.PinholeCamera(fx=125, fy=125, cx=80, cy=60)
    job = Job(sensor=pw.Sensor(), options=Options(partition=look), camera=camera, rgb=rgb)
    job.run(depth, tmp_path / "out")
    assert np.array_equal(seen[0], picture)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--partition", "squares"), "expected auto, graph, blocks, sam, or a file or folder"),
        (("--partition", "sam"), "partition: sam needs a picture of the view; give --rgb"),
        (("--partition", "blocks", "--sam-model", "x"), "go with --partition sam"),
        (("--sam-device", "cuda"), "go with --partition sam"),
        (("--partition", "IN/wrong.npy"), "must have the depth image's shape (120, 160)"),
        (("--partition", "IN/line.npy"), "got shape (5,)"),
        (("--partition", "IN/real.npy"), "must hold whole numbers as labels, got float64"),
        (("--partition", "IN/broken.png"), "broken.png cannot be read"),
        (("--partition", "IN/empty"), "holds no masks"),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(arguments, message, depth, tmp_path):
    folder = depth.parent
    np.save(folder / "wrong.npy", np.zeros((3, 4), int))
    np.save(folder / "line.npy", np.zeros(5, int))
    np.save(folder / "real.npy", np.zeros((120, 160)))
    (folder / "broken.png").write_bytes(b"nothing")
    (folder / "empty").mkdir()
    arguments = [each.replace("IN", str(folder)) for each in arguments]
    code, _, errors = run("detect", depth, *ARGUMENTS, *arguments, "-o", tmp_path / "out")
    assert code == 2
    assert message in errors
    assert not (tmp_path / "out").exists()


def test_a_file_is_no_partition_of_many_frames(tmp_path):
    np.save(tmp_path / "labels.npy", np.zeros((2, 2), int))
    with pytest.raises(ValueError, match="has to be a folder, too"):
        read_partition(tmp_path / "labels.npy", "frame", many=True)


def test_results_do_not_go_among_the_masks(depth, tmp_path, scene):
    masks = tmp_path / "masks"
    masks.mkdir()
    Image.fromarray(scene.labels == 1).save(masks / "overlay.png")
    given = ("--partition", masks, "-o", masks)
    code, _, errors = run("detect", depth, *ARGUMENTS, *given)
    assert code == 2
    assert "masks would be written over" in errors
    assert [each.name for each in masks.iterdir()] == ["overlay.png"]


def test_results_of_a_folder_do_not_go_among_the_masks_of_a_frame(depth, tmp_path, scene):
    masks = tmp_path / "masks" / "depth"
    masks.mkdir(parents=True)
    Image.fromarray(scene.labels == 1).save(masks / "labels.png")
    before = (masks / "labels.png").read_bytes()
    for given, out in ((depth.parent, masks.parent), (depth, masks)):
        code, _, errors = run("detect", given, *ARGUMENTS, "--partition", masks.parent, "-o", out)
        assert code == 2
        assert f"output: {masks} would be written over" in errors
        assert "earlier run" not in errors
        assert [each.name for each in masks.iterdir()] == ["labels.png"]
        assert (masks / "labels.png").read_bytes() == before
