from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.faults import InOrder, Tally, children, compare, write_frames
from PIL import Image
from typer.testing import CliRunner

import planewise as pw
from planewise.batch import Outcome, Store
from planewise.batch.lock import locked
from planewise.commands import batch_progress
from planewise.commands.app import command_line
from planewise.errors import MissingExtraError
from tests.command import run

COUNT = 10
CAMERA = ("--camera", "65.625,65.625,39.5,39.5", "--sensor", "kinect-v1")


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    folder = tmp_path_factory.mktemp("batch") / "frames"
    write_frames(folder, COUNT)
    return folder


@pytest.fixture
def frames(originals, tmp_path):
    return shutil.copytree(originals, tmp_path / "frames")


@pytest.fixture
def store(tmp_path):
    return tmp_path / "results" / "store"


@pytest.fixture
def here(monkeypatch):
    """Have frames done in this process."""
    monkeypatch.setattr("planewise.commands.batch._engine", lambda *_: InOrder())


def test_a_store_of_failures_gives_way_to_other_options(frames, store):
    arguments = ("batch", frames, "-o", store, "--sensor", "kinect-v1", "--limit", 3)
    assert run(*arguments, "--camera", "nyu")[0] == 2
    assert len(Store(store).failed) == 3
    code, _, errors = run(*arguments, *CAMERA[:2], "--dry-run")
    assert (code, errors) == (0, "")
    assert len(Store(store).failed) == 3
    code, _, errors = run(*arguments, *CAMERA[:2])
    assert code == 0
    assert errors.count("begun anew") == 1
    found = Store(store)
    assert (len(found.ids), found.failed) == (3, ())
    assert found.info["made_with"]["camera"]["fx"] == 65.625
    code, _, errors = run(*arguments, "--camera", "nyu")
    assert (code, "made with other options" in errors) == (2, True)
    assert len(Store(store).ids) == 3


def test_a_store_that_is_being_filled_does_not_give_way(frames, store):
    arguments = ("batch", frames, "-o", store, "--sensor", "kinect-v1", "--limit", 1)
    assert run(*arguments, "--camera", "nyu")[0] == 2
    with locked(store, "1-of-2"):
        code, _, errors = run(*arguments, *CAMERA[:2], "--shard", "2/2")
    assert (code, "made with other options" in errors) == (2, True)
    assert len(Store(store).failed) == 1


def damage(path):
    path.write_bytes(path.read_bytes()[:-500])


def test_workers_fill_a_store_and_go_on_where_they_were(frames, store):
    arguments = ("batch", frames, "-o", store, *CAMERA, "--workers", 2)
    code, text, errors = run(*arguments, "--limit", 4)
    assert (code, errors) == (0, "")
    assert "4 of 4 frames done" in text
    code, text, errors = run(*arguments)
    assert (code, errors) == (0, "")
    assert "6 of 6 frames done" in text
    assert "ms to read" in text
    assert f"holds {COUNT} of the {COUNT} frames selected" in text
    before = {p: p.stat().st_mtime_ns for p in store.rglob("*.p*")}
    code, text, _ = run(*arguments)
    assert (code, text.strip()) == (
        0,
        f"nothing to do: {store} holds {COUNT} of the {COUNT} frames selected",
    )
    assert before == {p: p.stat().st_mtime_ns for p in store.rglob("*.p*")}
    info = json.loads((store / "store.json").read_text())
    assert info["made_with"]["camera"] == {"fx": 65.625, "fy": 65.625, "cx": 39.5, "cy": 39.5}
    assert info["source"]["frames"] == COUNT
    assert {"planewise", "numpy", "numba", "pyarrow"} <= info["versions"].keys()
    assert Store(store).ids == tuple(f"{k:05}" for k in range(COUNT))


@pytest.mark.usefixtures("here")
def test_frames_of_another_size_and_without_a_reading_are_warned_of(frames, store):
    first, second, *_ = sorted(frames.iterdir())
    depth = np.asarray(Image.open(second))
    Image.fromarray(np.zeros_like(depth)).save(first)
    Image.fromarray(depth[:, ::2]).save(second)
    code, _, errors = run("batch", frames, "-o", store, *CAMERA)
    assert code == 0
    assert errors.count("warning: ") == 2
    assert f"frame {second.stem} has 40 x 60 pixels and frames before it 80 x 60" in errors
    assert "1 frame without a reading, and so no plane" in errors


def test_archives_among_other_depth_images_are_not_taken_for_all(frames, store):
    np.savez(frames / "more.npz", depth=np.zeros((60, 80)), K=[60, 60, 40, 30])
    code, text, errors = run("batch", frames, "-o", store, *CAMERA)
    assert (code, text) == (2, "")
    assert f"holds archives (.npz) and {COUNT} other depth images such as 00000.png" in errors
    code, text, _ = run("batch", frames, "-o", store, *CAMERA, "--kind", "archives", "--dry-run")
    assert (code, "1 frame, 1 selected" in text) == (0, True)


@pytest.mark.usefixtures("here")
def test_shards_together_are_the_whole(frames, store, tmp_path):
    run("batch", frames, "-o", tmp_path / "whole", *CAMERA)
    for part in (2, 1, 3):
        assert run("batch", frames, "-o", store, *CAMERA, "--shard", f"{part}/3")[0] == 0
    tally = Tally()
    compare(Store(store), Store(tmp_path / "whole"), tally)
    assert (tally.lost, tally.double, tally.corrupt) == (0, 0, 0)
    assert len(list((store / "frames").iterdir())) == 3
    assert "nothing to do" in run("batch", frames, "-o", store, *CAMERA)[1]


@pytest.mark.usefixtures("here")
def test_other_options_are_refused_and_named(frames, store):
    assert run("batch", frames, "-o", store, *CAMERA, "--every", 5)[0] == 0
    for other, word in (
        (("--max-planes", 7), " max_planes is not given there, 7 here"),
        (("--noise", "1%"), 'sensor.noise is "0.0012 + 0.0019 (z - 0.4)^2 m" there, "0.01 z m"'),
        (("--labels", "rle"), 'labels is "png" there, "rle" here'),
        (("--depth-scale", 0.002), "depth_scale is not given there, 0.002 here"),
        (("--camera", "60,60,39.5,39.5"), "camera.fx is 65.625 there, 60.0 here"),
        (("--seed", 1), " seed is 0 there, 1 here"),
    ):
        code, text, errors = run("batch", frames, "-o", store, *CAMERA, *other)
        assert (code, text) == (2, "")
        assert word in errors
        assert errors.count("error: ") == 1
    assert len(Store(store)) == 2
    assert (
        run("batch", frames, "-o", store, *CAMERA, "--every", 5, "--objective", "spatial")[0] == 0
    )
    assert Store(store).info["made_with"]["options"]["objective"] == "spatial"


@pytest.mark.usefixtures("here")
def test_other_frames_are_refused(frames, store, tmp_path):
    run("batch", frames, "-o", store, *CAMERA, "--limit", 3)
    (frames / "00001.png").rename(frames / "other.png")
    assert "does not have, such as 00001" in run("batch", frames, "-o", store, *CAMERA)[2]
    (frames / "other.png").rename(frames / "00001.png")
    shutil.copy(frames / "00005.png", frames / "00000.png")
    assert "has other readings" in run("batch", frames, "-o", store, *CAMERA)[2]
    assert run("batch", frames, "-o", frames, *CAMERA)[0] == 2
    assert not (frames / "store.json").exists()


@pytest.mark.usefixtures("here")
def test_a_unit_that_nobody_states_is_told_once(frames, store, tmp_path):
    lidar = (*CAMERA[:2], "--sensor", "velodyne-hdl64e")
    said = "in units of 2 mm, the sensor's resolution; if they are millimetres"
    errors = run("batch", frames, "-o", store, *lidar)[2]
    assert f"warning: frame 00000: whole numbers are taken {said}" in errors
    assert errors.count(said) == 1
    assert run("batch", frames, "-o", tmp_path / "b", *lidar, "--dry-run")[2].count(said) == 1
    scale = ("--depth-scale", "0.001")
    assert said not in run("batch", frames, "-o", tmp_path / "b", *lidar, *scale)[2]
    metres = tmp_path / "metres"
    metres.mkdir()
    np.save(metres / "0.npy", 0.001 * np.asarray(Image.open(frames / "00000.png")))
    assert said not in run("batch", metres, "-o", tmp_path / "c", *lidar)[2]


@pytest.mark.usefixtures("here")
def test_frames_out_of_range_are_counted(frames, store):
    Image.fromarray(np.zeros((60, 80), np.uint16)).save(frames / "00001.png")  # holds no reading
    code, text, errors = run("batch", frames, "-o", store, *CAMERA, "--depth-scale", 1)
    assert code == 0
    assert f"{COUNT} of {COUNT} frames done, 0 planes" in text
    assert f"warning: most readings of {COUNT - 1} frames lie outside the sensor's range" in errors
    assert "--depth-scale" in errors


@pytest.mark.usefixtures("here")
def test_frames_whose_noise_was_assumed_are_counted(tmp_path, store):
    scenes_of = tmp_path / "auto"
    scenes_of.mkdir()
    wall = np.random.default_rng(0).normal(2.0, 0.002, (60, 80))
    np.save(scenes_of / "0.npy", np.pad(wall[:12, :12], ((0, 48), (0, 68))))
    np.save(scenes_of / "1.npy", wall)
    arguments = (scenes_of, "-o", store, *CAMERA[:2], "--noise", "auto")
    code, _, errors = run("batch", *arguments)
    assert code == 0
    assert "warning: the noise of 1 frame could not be estimated and was assumed" in errors
    notes = {row["frame"]: row["note"] for row in Store(store).frames.to_pylist()}
    assert "was assumed" in notes["0"]
    assert notes["1"] == ""


@pytest.mark.usefixtures("here")
def test_damaged_frames_are_recorded_and_tried_again_when_asked(frames, store):
    good = (frames / "00003.png").read_bytes()
    damage(frames / "00003.png")
    Image.fromarray(np.zeros((60, 80), np.uint8)).save(frames / "00007.png")
    code, text, errors = run("batch", frames, "-o", store, *CAMERA)
    assert code == 0
    assert "8 of 10 frames done" in text
    assert "error: frame 00003: depth: 00003.png cannot be read" in errors
    assert "error: frame 00007: depth: 00007.png holds 8 bits" in errors
    assert "warning: 2 frames failed; --retry-failed tries again" in errors
    rows = {row["frame"]: row for row in Store(store).frames.to_pylist()}
    assert rows["00003"]["status"] == "failed"
    assert "damaged" in rows["00003"]["reason"]
    assert rows["00004"]["status"] == "done"
    code, text, errors = run("batch", frames, "-o", store, *CAMERA)
    assert code == 0
    assert "nothing to do: " in text
    assert "holds 8 of the 10 frames selected" in text
    assert "2 frames failed" in errors
    (frames / "00003.png").write_bytes(good)
    code, text, errors = run("batch", frames, "-o", store, *CAMERA, "--retry-failed")
    assert "1 of 2 frames done" in text
    assert "1 frame failed" in errors
    read = Store(store)
    assert (len(read), read.failed, read.frames.num_rows) == (9, ("00007",), COUNT)
    assert read["00003"].row["reason"] is None
    code, text, _ = run("batch", frames, "-o", store, *CAMERA, "--retry-failed")
    assert code == 0  # for the store holds others
    assert "0 of 1 frame done" in text


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere every name is text")
@pytest.mark.usefixtures("here")
def test_a_failure_in_a_folder_whose_name_is_not_utf_8_is_kept(frames, store):
    """Its reason names the folder, and a store holds text."""
    (frames / "00003.png").unlink()
    (frames / "00003.png").symlink_to("nowhere.png")
    folder = frames.rename(os.fsdecode(bytes(frames) + b"\xff"))
    code, _, errors = run("batch", folder, "-o", store, *CAMERA)
    assert (code, "frame 00003" in errors) == (0, True)
    ((number, frame, reason),) = Store(store).failures()
    assert (number, frame) == (3, "00003")
    assert r"frames\udcff" in reason


@pytest.mark.parametrize("left", ["nothing", "an empty folder"])
def test_a_source_that_vanishes_ends_the_run_and_fails_no_frame(
    frames, store, tmp_path, monkeypatch, left
):
    class Vanishing(InOrder):
        def run(self, work, to_do):
            for done, (number, frame) in enumerate(to_do):
                if done == 4:
                    frames.rename(tmp_path / "elsewhere")
                    if left == "an empty folder":
                        frames.mkdir()
                yield work(number, frame)

    monkeypatch.setattr("planewise.commands.batch._engine", lambda *_: Vanishing())
    code, _, errors = run("batch", frames, "-o", store, *CAMERA)
    assert code == 2
    assert f"error: source: {frames} is there no more" in errors
    assert (len(Store(store).ids), Store(store).failed) == (4, ())
    if left == "an empty folder":
        frames.rmdir()
    (tmp_path / "elsewhere").rename(frames)
    monkeypatch.setattr("planewise.commands.batch._engine", lambda *_: InOrder())
    assert run("batch", frames, "-o", store, *CAMERA)[0] == 0
    assert len(Store(store).ids) == COUNT


@pytest.mark.usefixtures("here")
def test_where_no_frame_can_be_done_something_is_wrong(frames, store):
    code, text, errors = run("batch", frames, "-o", store, "--camera", "nyu", "--sensor", "nyu")
    assert code == 2
    assert f"0 of {COUNT} frames done" in text
    assert errors.count("error: frame") == COUNT
    code, text, errors = run("batch", frames, "-o", store, "--camera", "nyu", "--sensor", "nyu")
    assert code == 2
    assert "nothing to do: " in text
    assert f"{COUNT} frames failed" in errors


def test_a_dry_run_says_what_there_is_to_do_and_writes_nothing(frames, store):
    damage(frames / "00001.png")
    code, text, errors = run("batch", frames, "-o", store, *CAMERA, "--dry-run", "--every", 2)
    assert code == 0
    assert errors == ""
    assert f"{COUNT} frames, 5 selected, 0 in the store" in text
    words = ("search joint", "objective spatial", "noise 0.0012", "fx 65.625", "core-hours")
    for word in (*words, "of labels"):
        assert word in text
    assert not store.parent.exists()
    result = CliRunner().invoke(
        command_line(), ["batch", str(frames), "-o", str(store), *CAMERA, "--dry-run"]
    )
    assert max(map(len, result.stdout.splitlines())) <= 80


@pytest.mark.usefixtures("here")
def test_one_is_said_as_one(frames, store, tmp_path):
    arguments = ("batch", frames, "-o", store, *CAMERA, "--limit", 1, "--max-planes", 1)
    code, text, _ = run(*arguments, "--dry-run", "--workers", 1)
    assert code == 0
    assert "with 1 worker (" in text
    code, text, _ = run(*arguments)
    assert code == 0
    assert "1 of 1 frame done, 1 plane, " in text
    assert "holds 1 of the 1 frame selected" in text
    assert run(*arguments)[1].endswith("holds 1 of the 1 frame selected ")
    code, text, _ = run("view", store, "-o", tmp_path / "page.html")
    assert code == 0
    assert text.startswith("1 frame, of which 0 failed, ")
    assert f" kB in {tmp_path / 'page.html'} " in text


@pytest.mark.usefixtures("here")
def test_a_dry_run_of_a_begun_store(frames, store):
    run("batch", frames, "-o", store, *CAMERA, "--limit", 4)
    text = run("batch", frames, "-o", store, *CAMERA, "--dry-run")[1]
    assert "4 in the store, 0 failed before, 6 to do" in text


@pytest.mark.usefixtures("here")
def test_a_dataset_needs_neither_camera_nor_sensor(frames, store, tmp_path):
    (tmp_path / "set").mkdir()
    frames.rename(tmp_path / "set" / "depth")
    damage(tmp_path / "set" / "depth" / "00003.png")
    camera = {"fx": 65.625, "fy": 65.625, "cx": 39.5, "cy": 39.5}
    text = json.dumps(camera | {"depth_scale": 0.001, "sensor": "kinect-v1"})
    (tmp_path / "set" / "camera.json").write_text(text)
    code, text, errors = run("batch", tmp_path / "set", "-o", store)
    assert code == 0
    assert "9 of 10 frames done" in text
    assert "error: frame 00003: depth: 00003.png cannot be read" in errors
    read = Store(store)
    assert read.info["source"]["kind"] == "GenericFolder"
    assert read.info["sensor"]["noise"] == "0.0012 + 0.0019 (z - 0.4)^2 m"
    assert read["00001"].row["depth_scale"] == 0.001
    other = run("batch", tmp_path / "set", "-o", store, "--noise", "1%")
    assert "sensor.noise is" in other[2]
    (tmp_path / "points").mkdir()
    np.zeros((5, 4), np.float32).tofile(tmp_path / "points" / "1.bin")
    assert "holds points" in run("batch", tmp_path / "points", "-o", tmp_path / "new")[2]


@pytest.mark.usefixtures("here")
def test_a_partition_is_an_option_of_the_store(frames, store):
    arguments = ("batch", frames, "-o", store, *CAMERA, "--limit", 2)
    assert run(*arguments, "--partition", "blocks", "--search", "sequential")[0] == 0
    assert " search is " in run(*arguments)[2]
    assert "not a file" in run(*arguments, "--partition", frames / "00001.png")[2]


def test_pictures_without_a_camera_are_refused_at_once(originals, store):
    code, text, errors = run("batch", originals, "-o", store, "--sensor", "kinect-v1")
    assert (code, text) == (2, "")
    assert errors.count("error: ") == 1
    assert "frames does not state its intrinsics; give --camera" in errors
    assert not store.parent.exists()


BAD_ARGUMENTS = {
    "no part": (("--shard", "4/3"), "shard"),
    "no limit": (("--limit", "0"), "limit"),
    "every none": (("--every", "0"), "every"),
    "no workers": (("--workers", "0"), "workers"),
    "address without Ray": (("--address", "auto"), "--engine ray"),
    "negative GPUs": (("--engine", "ray", "--gpus", "-1"), "gpus"),
    "seed negative": (("--seed", "-1"), "seed"),
    "camera that is none": (("--camera", "nikon"), "camera"),
    "engine that is none": (("--engine", "steam"), "--engine"),
    "samples in regions": (
        ("--partition", "blocks", "--search", "sequential", "--confidence", "0.9"),
        "without a --partition",
    ),
}


@pytest.mark.parametrize("name", BAD_ARGUMENTS)
def test_bad_arguments(originals, store, name):
    arguments, named = BAD_ARGUMENTS[name]
    code, text, errors = run("batch", originals, "-o", store, *CAMERA, *arguments)
    assert (code, text) == (2, "")
    assert named in errors
    assert "Traceback" not in errors
    assert not store.parent.exists()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere every name is text")
def test_names_that_are_no_text_are_refused(frames, store):
    (frames / "00001.png").rename(os.fsdecode(bytes(frames) + b"/\xff1.png"))
    code, text, errors = run("batch", frames, "-o", store, *CAMERA)
    assert (code, text) == (2, "")
    assert "\\xff1, which is not valid UTF-8" in errors.replace("\n", " ")
    assert not store.parent.exists()


def test_without_pyarrow_one_line_says_so(originals, store, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    code, _, errors = run("batch", originals, "-o", store, *CAMERA)
    assert code == 2
    assert "planewise[batch]" in errors
    assert not store.parent.exists()


@pytest.mark.parametrize("shard", [(), ("--shard", "1/2")])
@pytest.mark.parametrize("empty", [False, True])
def test_without_ray_nothing_is_left(originals, store, monkeypatch, shard, empty):
    monkeypatch.setitem(sys.modules, "ray", None)
    if empty:
        store.mkdir(parents=True)
    code, text, errors = run("batch", originals, "-o", store, *CAMERA, "--engine", "ray", *shard)
    assert (code, text) == (2, "")
    assert "planewise[ray]" in errors
    assert store.exists() == store.parent.exists() == empty
    assert not empty or not list(store.iterdir())


def test_without_ray_a_begun_store_stays(frames, store, monkeypatch):
    monkeypatch.setattr("planewise.batch.local_engine.LocalEngine.run", InOrder().run)
    assert run("batch", frames, "-o", store, *CAMERA, "--limit", 2)[0] == 0
    before = {path: path.read_bytes() for path in store.rglob("*.*") if path.name != ".lock"}
    monkeypatch.setitem(sys.modules, "ray", None)
    assert run("batch", frames, "-o", store, *CAMERA, "--engine", "ray")[0] == 2
    assert before.items() <= {p: p.read_bytes() for p in store.rglob("*.*")}.items()
    assert len(Store(store)) == 2


@pytest.mark.usefixtures("here")
def test_a_package_that_all_frames_need_and_lack(originals, store, monkeypatch):
    def lacking(*_):
        raise MissingExtraError("h5py", "reading it", "datasets")

    monkeypatch.setattr("planewise.batch.frame_work.FrameWork._done", lacking)
    for dry in ((), ("--dry-run",)):
        code, text, errors = run("batch", originals, "-o", store, *CAMERA, *dry)
        assert (code, text) == (2, "")
        assert errors.count("planewise[datasets]") == 1
        assert not store.parent.exists()


@pytest.mark.usefixtures("here")
def test_a_store_is_scored(frames, store, tmp_path):
    run("batch", frames, "-o", store, *CAMERA, "--limit", 4)
    (tmp_path / "truth").mkdir()
    for frame in ("00001", "00002", "00009"):
        shutil.copy(store / "labels" / "00001.png", tmp_path / "truth" / f"{frame}.png")
    code, text, errors = run("eval", store, tmp_path / "truth", "-o", tmp_path / "s.csv")
    assert code == 0
    assert "2 of 2 frames scored" in text
    assert "lacks 1: 00009" in errors
    assert "lacks 2: 00000, 00003" in errors
    assert (tmp_path / "s.csv").read_text().splitlines()[1].startswith("00001,")
    assert run("eval", store, store / "labels" / "00001.png")[0] == 2
    for predicted in (tmp_path / "truth", tmp_path / "truth" / "00001.png", store):
        code, text, errors = run("eval", predicted, store)
        assert (code, text) == (2, "")
        assert f"truth: {store} is a store, which only PRED may be" in errors


def as_in_a_terminal():
    """Ctrl-C ends a process; what runs in the background, such as these tests, may ignore it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def process(*arguments, **options):
    command = [sys.executable, "-m", "planewise.cli", "batch", *map(str, arguments)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


def test_a_full_disk_is_said_and_leaves_a_store(originals, store, monkeypatch):
    # Files of at most so many bytes: the journal outgrows that, as it would a full disk.
    def small_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (16_000, resource.RLIM_INFINITY))

    job = process(originals, "-o", store, *CAMERA, "--workers", 1, preexec_fn=small_files)
    text, errors = job.communicate(timeout=120)
    assert (job.returncode, text) == (2, "")
    assert errors.startswith(f"error: store: there is no room left for {store}")
    assert errors.count("\n") == 1
    assert len(Store(store)) < COUNT
    monkeypatch.setattr("planewise.commands.batch._engine", lambda *_: InOrder())
    code, text, errors = run("batch", originals, "-o", store, *CAMERA)
    assert (code, errors) == (0, "")
    read = Store(store)
    assert len(list(read)) == len(read) == read.frames.num_rows == COUNT
    assert not list(store.glob(".unfinished*"))


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("error", "ends", "said"),
    [
        (KeyboardInterrupt(), 130, "interrupted; "),
        (OSError(errno.ENOSPC, "No space left"), 2, "store: there is no room left for STORE (No "),
    ],
)
@pytest.mark.parametrize("begun", [False, True])
def test_an_end_before_time_says_what_it_leaves(
    originals, store, monkeypatch, error, ends, said, begun
):
    def failing(*_):
        raise error

    if begun:
        assert run("batch", originals, "-o", store, *CAMERA, "--limit", 2)[0] == 0
    monkeypatch.setattr("planewise.batch.run.Batch._begin", failing)
    code, text, errors = run("batch", originals, "-o", store, *CAMERA)
    assert (code, text) == (ends, "")
    assert said.replace("STORE", str(store)) in errors
    assert ("; nothing was left " in errors) == (not begun)
    assert (f"; what is done is in {store}, and the same" in errors) == begun
    assert store.exists() == begun


@pytest.mark.usefixtures("here")
def test_a_limit_of_threads_is_one_line(originals, store, monkeypatch):
    start = threading.Thread.start

    def limited(thread):
        if thread.name.startswith("sync"):
            raise RuntimeError("can't start new thread")  # as Python does
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", limited)
    code, text, errors = run("batch", originals, "-o", store, *CAMERA)
    assert (code, text) == (2, "")
    assert errors.startswith("error: no more threads can be started: memory is short, or ")
    assert errors.count("error: ") == 1


def test_ctrl_c_while_workers_load_is_one_line(originals, store):
    job = process(
        originals, "-o", store, *CAMERA, "--workers", 2,
        start_new_session=True, preexec_fn=as_in_a_terminal,
    )  # fmt: skip
    until = time.monotonic() + 60
    while time.monotonic() < until and not any(
        b"forkserver" in Path(f"/proc/{each}/cmdline").read_bytes() for each in children(job.pid)
    ):
        time.sleep(0.01)
    time.sleep(0.3)  # it loads what workers need
    os.killpg(job.pid, signal.SIGINT)
    _, errors = job.communicate(timeout=60)
    assert job.returncode == 130
    assert errors.startswith("error: interrupted; ")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_a_scheduler_end_it_cleanly(originals, tmp_path, store, how):
    many = tmp_path / "many"
    many.mkdir()
    for k in range(600):
        os.link(originals / f"{k % COUNT:05}.png", many / f"{k:05}.png")
    job = process(
        many, "-o", store, *CAMERA, "--workers", 2,
        start_new_session=True, preexec_fn=as_in_a_terminal,
    )  # fmt: skip
    until = time.monotonic() + 60
    while not list(store.glob("labels/*.png")) and time.monotonic() < until:
        time.sleep(0.02)
    assert job.poll() is None, job.communicate()
    started = [*children(job.pid), *(k for each in children(job.pid) for k in children(each))]
    sent = time.monotonic()
    if how == signal.SIGINT:
        os.killpg(job.pid, how)  # as a terminal does
    else:
        job.send_signal(how)
    text, errors = job.communicate(timeout=60)
    assert job.returncode == 130
    assert time.monotonic() - sent < 10
    assert text == ""
    assert errors.startswith(f"error: interrupted; what is done is in {store}")
    assert errors.count("\n") == 1
    assert len(started) >= 3
    while any(Path(f"/proc/{each}").exists() for each in started):
        assert time.monotonic() - sent < 20
        time.sleep(0.05)
    count = len(Store(store))
    assert 0 < count < 600
    assert f"{count} in the store" in run("batch", many, "-o", store, *CAMERA, "--dry-run")[1]


def test_no_time_left_is_told_by_the_start_of_a_run(monkeypatch):
    """The first frame waits for loops that are compiled; 40 s of it made "53 min left"."""
    said, clock = [], SimpleNamespace(seconds=0.0)
    monkeypatch.setattr(batch_progress.time, "monotonic", lambda: clock.seconds)
    monkeypatch.setattr(batch_progress.terminal, "draws_bars", lambda: False)
    monkeypatch.setattr(batch_progress.terminal, "notice", said.append)
    recipe = SimpleNamespace(camera=None, sensor=pw.sensors.KINECT_V1)
    with batch_progress.Progress(SimpleNamespace(to_do=range(80)), recipe) as progress:
        for n in range(80):
            clock.seconds = 40 + 0.5 * n
            progress.count(Outcome(number=0, frame="0", present=1, planes=1))
    assert said == [
        "1 of 80 frames, 1 plane, 0 failed",
        "62 of 80 frames, 2.0 frames/s, 9 s left, 62 planes, 0 failed",
    ]
