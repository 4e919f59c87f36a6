"""The parts of a store: names, files, journal, locks, and what is read back."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from benchmarks.faults import InOrder, batch_of, fill, write_frames
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import planewise as pw
from planewise import scenes
from planewise.batch import Batch, LocalEngine, Recipe, Selection, Store, open_source, store_writer
from planewise.batch.columns import FRAMES, PLANES
from planewise.batch.frame_names import safe_name
from planewise.batch.frame_work import FrameWork, failure
from planewise.batch.journal import Journal, line_of, read_records
from planewise.batch.label_png import png_of_labels
from planewise.batch.lock import locked
from planewise.batch.segments import Segment, segments_of
from planewise.batch.source import parse_shard
from planewise.batch.staging import Staging
from planewise.batch.store_writer import StoreWriter, opened
from planewise.batch.tables import parquet_of, read_table
from planewise.commands.label_pairs import pair_store
from planewise.commands.scoring import Scoring
from planewise.errors import PlanewiseError
from planewise.files.depth import DepthFile
from tests.batch_sources import Renamed
from tests.command import run
from tests.dataset_files import write_generic

COUNT = 12


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Folder of small depth images, and their camera."""
    folder = tmp_path_factory.mktemp("batch") / "frames"
    return folder, write_frames(folder, COUNT)


@pytest.fixture(scope="module")
def full(frames, tmp_path_factory):
    """A store of all of them."""
    path = tmp_path_factory.mktemp("full") / "store"
    fill(batch_of(frames[0], path, frames[1]))
    return Store(path)


# Names


@given(st.lists(st.text(max_size=200), min_size=2, max_size=2, unique=True))
def test_names_differ_and_stay_inside(ids):
    names = [safe_name(each, ".png") for each in ids]
    assert names[0] != names[1]
    for name in names:
        assert name.isascii()
        parts = name.split("/")
        assert all(part and not part.startswith(".") and len(part) < 200 for part in parts)
        assert not any(part.endswith(".png") for part in parts[:-1])


@pytest.mark.parametrize(
    ("frame", "name"),
    [
        ("00012", "00012.png"),
        ("scene0000_00/7", "scene0000_00/7.png"),
        ("/etc/passwd", "%/etc/passwd.png"),
        ("..", "%2E..png"),
        ("a.png/b", "a%2Epng/b.png"),
        ("C:\\x", "C%3A%5Cx.png"),
        ("", "%.png"),
    ],
)
def test_names_that_might_do_harm(frame, name):
    assert safe_name(frame, ".png") == name


def test_frames_of_any_id_stay_in_the_store(frames, tmp_path):
    ids = ("../../out", "/abs", "a/b", "a", "..", ".hidden", "a.png/b", "x" * 300)
    recipe = Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options(), camera=frames[1])
    path = tmp_path / "deep" / "store"
    fill(Batch(source=Renamed(frames[0], ids), store=path, recipe=recipe))
    store = Store(path)
    assert store.ids == ids
    assert [each.name for each in tmp_path.iterdir()] == ["deep"]
    assert [each.name for each in (tmp_path / "deep").iterdir()] == ["store"]
    assert len([p for p in (path / "labels").rglob("*") if p.is_file()]) == len(ids)
    assert all(store.labels(each).shape == (60, 80) for each in ids)


# Label files


@given(st.integers(0, 10_000), st.integers(1, 40), st.integers(1, 40))
def test_label_images_come_back(seed, height, width):
    labels = np.random.default_rng(seed).integers(0, 65_536, (height, width)).astype(np.uint16)
    labels[: height // 2] //= 20_000
    with Image.open(BytesIO(png_of_labels(labels))) as image:
        assert image.mode == "I;16"
        assert np.array_equal(np.asarray(image), labels)


# Journal


@settings(deadline=None, max_examples=20)
@given(st.lists(st.binary(max_size=30).filter(lambda b: not {10, 13} & set(b)), max_size=6))
def test_a_journal_cut_anywhere_has_whole_records_only(records):
    whole = b"".join(map(line_of, records))
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "j"
        for cut in range(len(whole) + 1):
            path.write_bytes(whole[:cut])
            found = read_records(path)
            assert found == records[: len(found)]
            assert sum(map(len, map(line_of, found))) <= cut


def test_a_journal_goes_on_where_a_kill_left_it(tmp_path):
    path = tmp_path / "j"
    path.write_bytes(line_of(b"one") + line_of(b"two")[:-1])
    journal = Journal(path)
    journal.add([b"next", b"last"])
    journal.close()
    assert journal.count == 3
    assert read_records(path) == [b"one", b"next", b"last"]


def test_a_damaged_line_ends_a_journal(tmp_path):
    path = tmp_path / "j"
    lines = [line_of(each) for each in (b"one", b"two", b"three")]
    lines[1] = lines[1].replace(b"w", b"v")
    path.write_bytes(b"".join(lines))
    assert read_records(path) == [b"one"]


def test_a_journal_is_no_link(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "j").symlink_to("precious")
    with pytest.raises(OSError, match="symbolic"):
        Journal(tmp_path / "j")
    assert (tmp_path / "precious").read_text() == "precious"


def test_a_segment_is_sealed_in_every_state_a_kill_can_leave(frames, full, tmp_path, monkeypatch):
    monkeypatch.setattr(Segment, "seal", lambda *_: None)
    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    fill(batch)
    monkeypatch.undo()
    (segment,) = segments_of(tmp_path / "store")
    expected = full.planes
    assert Store(tmp_path / "store").planes.equals(expected)  # a journal alone
    staging = Staging(tmp_path / "store" / ".unfinished")
    journal = segment.journal.read_bytes()
    segment.seal(staging)
    assert not segment.journal.exists()
    sealed = segment.frames_file.read_bytes()
    for state in ("planes without frames", "both and a journal"):
        segment.journal.write_bytes(journal)
        if state == "planes without frames":
            segment.frames_file.unlink()
            segment.planes_file.write_bytes(b"half of it")
        store = Store(tmp_path / "store")
        assert (len(store), store.planes.equals(expected)) == (COUNT, True), state
        segment.seal(staging)
        assert segment.frames_file.read_bytes() == sealed
        assert not segment.journal.exists()


# Locks


def test_a_store_in_use_is_refused(tmp_path):
    with (
        locked(tmp_path),
        pytest.raises(PlanewiseError, match=f"in use by another run .process {os.getpid()} on"),
        locked(tmp_path),
    ):
        pass


def test_shards_of_one_cut_share_a_store(tmp_path):
    with locked(tmp_path):
        pass
    with locked(tmp_path, "1-of-3"), locked(tmp_path, "2-of-3"):
        with pytest.raises(PlanewiseError, match="runs of its shards"), locked(tmp_path):
            pass
        for other in ("1-of-3", "all", "1-of-2", "2-of-3-every-2"):
            with pytest.raises(PlanewiseError, match="in use by"), locked(tmp_path, other):
                pass
    with locked(tmp_path), pytest.raises(PlanewiseError), locked(tmp_path, "1-of-3"):
        pass
    with locked(tmp_path, "1-of-2"):
        pass
    with locked(tmp_path, "1-of-3-every-2"), locked(tmp_path, "2-of-3-every-2"):
        pass


@pytest.mark.parametrize("name", [".lock", ".lock-1-of-2", "journal/all-000002.jsonl",
                                  "journal", "frames", "labels", "labels/b"])  # fmt: skip
def test_nothing_is_written_through_links_of_a_store(frames, tmp_path, name):
    ids = tuple(f"{'a' if number < 6 else 'b'}/{number:02}" for number in range(COUNT))
    recipe = Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options(), camera=frames[1])
    batch = Batch(source=Renamed(frames[0], ids), store=tmp_path / "store", recipe=recipe)
    fill(replace(batch, selection=Selection(limit=6)))
    link, own, victim = batch.store / name, tmp_path / "own", tmp_path / "victim"
    if link.exists():
        link.rename(own)
    if "." in name:
        victim.write_text("precious")
    elif own.exists():
        shutil.copytree(own, victim)
    else:
        victim.mkdir()
    link.symlink_to(victim)
    before = contents(victim)
    part = (1, 2) if "-of-" in name else (1, 1)
    with pytest.raises(PlanewiseError, match=f"{name} is a link, and what is written"):
        fill(replace(batch, selection=Selection(shard=part)))
    assert contents(victim) == before
    link.unlink()
    if own.exists():
        own.rename(link)
    fill(batch)
    assert Store(batch.store).ids == ids


def contents(path):
    return {each: each.is_file() and each.read_bytes() for each in (path, *path.rglob("*"))}


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from planewise.batch.lock import locked\n"
        "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert other.stdout.readline() == "held\n"
    with pytest.raises(PlanewiseError, match=f"process {other.pid}"), locked(tmp_path):
        pass
    other.kill()
    other.communicate()
    with locked(tmp_path):
        assert str(os.getpid()) in (tmp_path / ".lock").read_text()


def test_a_store_that_another_shard_uses_is_not_removed(frames, tmp_path):
    folder, camera = frames
    first, second = (
        replace(batch_of(folder, tmp_path / "store", camera), selection=Selection(shard=(part, 2)))
        for part in (1, 2)
    )
    under_way = ExitStack()
    others = []

    class Failing:
        def run(self, work, frames):
            others.append(under_way.enter_context(second.started(InOrder())))
            raise PlanewiseError("not here")

    with under_way:
        with pytest.raises(PlanewiseError, match="not here"), first.started(Failing()) as run:
            list(run)
        done = len(list(others[0]))
    assert len(Store(tmp_path / "store")) == done > 0


@pytest.mark.parametrize(("code", "left"), [(errno.ENOLCK, True), (errno.EOPNOTSUPP, False)])
def test_where_a_lock_fails_that_of_another_run_stays(tmp_path, monkeypatch, code, left):
    def fail(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("fcntl.flock", fail)
    with pytest.raises(PlanewiseError, match="cannot be locked"), locked(tmp_path):
        pass
    assert (tmp_path / ".lock").exists() == left


def test_the_first_error_is_the_one_that_is_raised(tmp_path, monkeypatch):
    monkeypatch.setattr(StoreWriter, "flush", lambda _: 1 / 0)
    closed, close = [], Journal.close
    monkeypatch.setattr(Journal, "close", lambda journal: closed.append(close(journal)))
    (tmp_path / "journal").mkdir()
    staging = Staging(tmp_path / "staging")
    with pytest.raises(KeyboardInterrupt), opened(tmp_path, "all", staging):
        raise KeyboardInterrupt
    assert len(closed) == 1


def test_a_lock_that_was_removed_holds_nothing(tmp_path, monkeypatch):
    def late(handle, kind):
        (tmp_path / ".lock").unlink(missing_ok=True)  # by who held it while this one waited

    monkeypatch.setattr("fcntl.flock", late)
    with pytest.raises(PlanewiseError, match="was removed by another run"), locked(tmp_path):
        pass


# Selections


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Recipe(sensor="nyu", options=pw.Options()), "sensor must be a planewise.Sensor"),
        (lambda: recipe_with(options={}), "options must be planewise.Options, got {}"),
        (lambda: recipe_with(camera=(1, 2, 3, 4)), "camera must be a planewise.PinholeCamera"),
        (lambda: recipe_with(depth_scale=-1), "depth_scale must be a positive number"),
        (lambda: Selection(every=2.5), r"every must be a whole number of at least 1, got 2\.5"),
        (lambda: Selection(limit=0), "limit must be a whole number of at least 1, got 0"),
        (lambda: Selection(shard="1/2"), r"shard must be two whole numbers \(i, n\), got '1/2'"),
        (lambda: LocalEngine(workers="2"), "workers must be a whole number of at least 1, got '2'"),
    ],
)
def test_what_makes_no_batch_is_refused_at_once(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def recipe_with(**options):
    return Recipe(**{"sensor": pw.sensors.KINECT_V1, "options": pw.Options()} | options)


def test_selections_are_disjoint_and_whole():
    ids = [str(k) for k in range(23)]
    parts = [Selection(every=2, shard=(i, 3)).of(ids) for i in (1, 2, 3)]
    assert sorted(each for part in parts for each in part) == [(k, str(k)) for k in range(0, 23, 2)]
    assert Selection(limit=4, every=5).of(ids) == [(k, str(k)) for k in (0, 5, 10, 15)]


@pytest.mark.parametrize("text", ["3", "0/2", "3/2", "a/b", "-1/2", "1/2/3"])
def test_shards_that_are_none(text):
    with pytest.raises(PlanewiseError, match="shard"):
        Selection(shard=parse_shard(text))


# What is read back


def test_a_store_gives_what_the_detector_gives(frames, full):
    detector = pw.Detector(frames[1], pw.sensors.KINECT_V1)
    assert full.ids == tuple(f"{k:05}" for k in range(COUNT))
    assert list(full.frames.column_names) == list(FRAMES)
    assert list(full.planes.column_names) == list(PLANES)
    for frame in full:
        with Image.open(frames[0] / f"{frame.id}.png") as image:
            model = detector(np.asarray(image))
        assert np.array_equal(frame.labels, model.labels)
        assert np.array_equal(full.labels(frame.id), model.labels)
        assert np.array_equal(frame.planes, model.coefficients)
        assert frame.row["information"] == model.information
        assert frame.row["curve"] == list(model.curve)
        assert frame.plane_table["readings"].to_pylist() == [p.count for p in model.planes]
        covariance = frame.plane_table["covariance"].to_pylist()
        for row, plane in zip(covariance, model.planes, strict=True):
            assert np.array_equal(np.reshape(row, (4, 4)), plane.covariance)


def test_cameras_that_are_no_pinholes_are_kept_in_words():
    street = scenes.street(0)
    source = {"sweep": DepthFile(depth=street.depth, camera=street.camera)}
    work = FrameWork(source, Recipe(sensor=street.sensor, options=pw.Options()))
    outcome = work(0, "sweep")
    row = json.loads(outcome.record)["frame"]
    assert outcome.reason == ""
    assert outcome.planes >= 1
    assert json.loads(row["camera"]) == json.loads(json.dumps(street.camera.describe()))
    assert "fx" not in row


@pytest.mark.parametrize("registered", [True, False])
def test_pictures_of_another_view_are_no_regions(registered):
    seen = []

    class Regions:
        def __call__(self, view):
            seen.append(view.rgb)
            return np.ones(view.depth.shape, int)

        def describe(self):
            return "all of it"

    room = scenes.room(0, size=(60, 80))
    source = _Pictured({"room": DepthFile(depth=room.depth, camera=room.camera, rgb=room.rgb)})
    source.registered = registered
    recipe = Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options(partition=Regions()))
    assert FrameWork(source, recipe)(0, "room").reason == ""
    assert [each is not None for each in seen] == [registered]


class _Pictured(dict):
    name = "pictured"


@pytest.mark.parametrize(
    ("partition", "got"),
    [
        (np.ones((60, 80), int), "label image"),
        (np.ones((2, 60, 80), bool), "2 masks"),
        (lambda view: np.ones(view.depth.shape, int), "<lambda>"),
    ],
)
def test_a_store_tells_its_partition_from_others(partition, got):
    with pytest.raises(ValueError, match=rf"partition must be a name or .* describe.*; got {got}"):
        Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options(partition=partition))


def test_a_store_goes_on_with_its_partition_alone(frames, tmp_path):
    batch = batch_of(frames[0], tmp_path / "store", frames[1])

    def with_graph(**settings):
        options = pw.Options(partition=pw.partition.Graph(**settings))
        return replace(batch, recipe=replace(batch.recipe, options=options))

    fill(replace(with_graph(colour=0.25), selection=Selection(limit=1)))
    with pytest.raises(PlanewiseError, match=r'pixels, colour 0\.25" there, "graph.* pixels" here'):
        fill(with_graph())


def test_every_column_is_documented():
    text = (Path(__file__).parents[1] / "docs" / "batch.md").read_text(encoding="utf-8")
    frames, planes = text.split("### `frames`")[1].split("### `planes`")
    for columns, part in ((FRAMES, frames), (PLANES, planes)):
        for name, kind in columns.items():
            (line,) = [
                line
                for line in part.splitlines()
                if line.startswith("|") and f"`{name}`" in line.split("|")[1]
            ]
            assert kind.replace("<", " of ").rstrip(">") in line


def test_masks_as_run_lengths_are_the_same_labels(frames, full, tmp_path):
    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    recipe = Recipe(**(vars(batch.recipe) | {"labels": "rle"}))
    fill(Batch(source=batch.source, store=batch.store, recipe=recipe))
    store = Store(batch.store)
    assert not list((batch.store / "labels").iterdir())
    for frame in store:
        assert np.array_equal(frame.labels, full.labels(frame.id))
    assert store.planes.drop_columns("rle").equals(full.planes.drop_columns("rle"))


def test_a_store_is_read_while_it_is_written(frames, tmp_path, monkeypatch):
    monkeypatch.setattr(store_writer, "_SECONDS_A_GROUP", 0.0)
    monkeypatch.setattr(store_writer, "_FRAMES_A_SEGMENT", 3)
    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    seen = []
    with batch.started(InOrder()) as run:
        for outcome in run:
            store = Store(batch.store)
            seen.append(len(store))
            assert len(store) <= len(list(store)) <= outcome.number + 1
    assert seen == sorted(seen)
    assert len(Store(batch.store)) == COUNT
    assert len(list((batch.store / "frames").iterdir())) > 1
    assert not list((batch.store / "journal").iterdir())
    assert not list(batch.store.glob(".unfinished*"))


def interrupted(batch, number):
    """Run a batch up to a frame."""
    with batch.started(InOrder()) as run:
        for outcome in run:
            if outcome.number == number:
                raise KeyboardInterrupt


def test_a_fresh_process_reads_a_store_that_is_a_journal(frames, tmp_path):
    """Whatever this one has loaded by now."""
    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    with pytest.raises(KeyboardInterrupt):
        interrupted(batch, 7)
    assert not list((batch.store / "frames").iterdir())
    code = (
        "import sys; from planewise.batch import Store; store = Store(sys.argv[1]);"
        "print(len(list(store)), len(store[store.ids[0]].planes) > 0)"
    )
    said = subprocess.run(
        [sys.executable, "-c", code, batch.store], check=True, capture_output=True, text=True
    )
    assert said.stdout == f"{len(Store(batch.store))} True\n"


def test_what_a_killed_shard_left_is_taken_over(frames, full, tmp_path):
    whole = batch_of(frames[0], tmp_path / "store", frames[1])
    part = Batch(
        source=whole.source,
        store=whole.store,
        recipe=whole.recipe,
        selection=Selection(shard=(2, 3)),
    )
    with pytest.raises(KeyboardInterrupt):
        interrupted(part, 7)
    (whole.store / ".unfinished-2-of-3").mkdir()
    assert [each.name for each in segments_of(whole.store)] == ["2-of-3-000001"]
    assert len(list((whole.store / "journal").iterdir())) == 1
    fill(whole)
    store = Store(whole.store)
    assert store.ids == full.ids
    assert len(list(store)) == COUNT
    assert not list((whole.store / "journal").iterdir())
    assert not list(whole.store.glob(".unfinished*"))


def spoiled(changing, number):
    """A frame that cannot be read any more, what it held, and the batch, whose store is gone."""
    folder, whole = changing
    bad = folder / f"{Store(whole.store).ids[number]}.png"
    good = bad.read_bytes()
    bad.write_bytes(b"none")
    shutil.rmtree(whole.store)
    return bad, good, whole


def test_other_shards_try_again_what_failed(changing):
    """Rows of failed frames go, whoever wrote them, unless he may be at work."""
    bad, good, whole = spoiled(changing, 4)
    for part in (1, 2, 3):
        fill(replace(whole, selection=Selection(shard=(part, 3))))
    assert Store(whole.store).failed == (bad.stem,)
    bad.write_bytes(good)
    for part in (1, 2):
        fill(replace(whole, selection=Selection(shard=(part, 2)), retry_failed=True))
    store = Store(whole.store)
    assert (len(store), store.failed, list(store.failures())) == (COUNT, (), [])
    assert len(store.frames) == len(list(store)) == COUNT


def test_shards_of_what_every_leaves_write_no_frame_twice(changing):
    """The third frame is of the first half of all, and of the second half of one in two."""
    bad, good, whole = spoiled(changing, 2)
    fill(replace(whole, selection=Selection(shard=(1, 2))))
    bad.write_bytes(good)
    again = Selection(shard=(2, 2), every=2)
    with locked(whole.store, "1-of-2"), pytest.raises(PlanewiseError, match="in use by"):
        fill(replace(whole, selection=again))
    fill(replace(whole, selection=again, retry_failed=True))
    store = Store(whole.store)
    assert (len(store), len(store.frames), store.failed) == (COUNT // 2, COUNT // 2, ())


def test_a_shard_leaves_what_failed_to_another_of_as_many(changing):
    bad, _, whole = spoiled(changing, 4)
    for part in (1, 2):
        fill(replace(whole, selection=Selection(shard=(part, 2)), retry_failed=True))
    store = Store(whole.store)
    assert (len(store.frames), store.failed) == (COUNT, (bad.stem,))


@pytest.fixture
def mended(changing):
    """Batch of frames of which two failed, the fourth and the fifth, and could be done now."""
    folder, whole = changing
    bad = [folder / f"{frame}.png" for frame in Store(whole.store).ids[3:5]]
    good = [path.read_bytes() for path in bad]
    shutil.rmtree(whole.store)
    for path in bad:
        path.write_bytes(b"none")
    fill(whole)
    for path, data in zip(bad, good, strict=True):
        path.write_bytes(data)
    return whole


@pytest.mark.parametrize(
    ("selection", "left"),
    [
        (Selection(limit=2), ["00003", "00004"]),
        (Selection(limit=4), ["00004"]),
        (Selection(shard=(1, 2)), ["00003"]),
    ],
)
def test_failures_that_are_not_tried_again_stay(mended, selection, left):
    fill(replace(mended, selection=selection, retry_failed=True))
    store = Store(mended.store)
    assert [frame for _, frame, _ in store.failures()] == left
    assert len(store.frames) == COUNT


def test_failures_of_a_journal_that_are_not_tried_again_stay(tmp_path):
    segment = Segment(tmp_path, "all-000001")
    records = [failure(number, frame, "no").record for number, frame in enumerate("abc")]
    segment.journal.parent.mkdir()
    segment.journal.write_bytes(b"".join(map(line_of, records)))
    segment.forget_failed({"b"}, Staging(tmp_path / "staging"))
    assert read_records(segment.journal) == [records[0], records[2]]


def test_shards_that_try_again_at_one_time_do_not_bring_failures_back(mended, monkeypatch):
    def slow(*arguments):
        table = read_table(*arguments)
        time.sleep(0.1)  # so that what one shard publishes, the other has not read
        return table

    monkeypatch.setattr("planewise.batch.segments.read_table", slow)
    parts = [Selection(shard=(part, 2)) for part in (1, 2)]
    with ThreadPoolExecutor(2) as pool:
        batches = [replace(mended, selection=part, retry_failed=True) for part in parts]
        list(pool.map(fill, batches))
    store = Store(mended.store)
    assert (store.failed, len(store.frames)) == ((), COUNT)


def test_no_room_for_another_journal_is_said_to_be_that(frames, tmp_path, monkeypatch):
    monkeypatch.setattr(store_writer, "_SECONDS_A_GROUP", 0.0)
    monkeypatch.setattr(store_writer, "_FRAMES_A_SEGMENT", 2)
    journals = []

    def journal(path):
        if journals:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        journals.append(Journal(path))
        return journals[0]

    monkeypatch.setattr(store_writer, "Journal", journal)
    with pytest.raises(OSError, match="No space left"):
        fill(batch_of(frames[0], tmp_path / "store", frames[1]))
    monkeypatch.undo()
    fill(batch_of(frames[0], tmp_path / "store", frames[1]))
    assert len(Store(tmp_path / "store").frames) == COUNT


def test_folders_are_made_to_last_once(frames, tmp_path, monkeypatch):
    monkeypatch.setattr(store_writer, "_SECONDS_A_GROUP", 0.0)
    synced = []
    monkeypatch.setattr(store_writer, "sync_folder", synced.append)
    fill(batch_of(frames[0], tmp_path / "store", frames[1]))
    assert synced.count(tmp_path / "store") == 1
    assert synced.count(tmp_path / "store" / "labels") > 1  # each time that files come into it


def test_frames_of_shards_are_read_by_turns_from_one_reading(frames, tmp_path, monkeypatch):
    whole = batch_of(frames[0], tmp_path / "store", frames[1])
    for part in (1, 2, 3):
        fill(replace(whole, selection=Selection(shard=(part, 3))))
    store, tables = Store(whole.store), Segment.tables
    assert len(store) == COUNT
    read = []
    monkeypatch.setattr(Segment, "tables", lambda each: read.append(each.name) or tables(each))
    assert [store[each].id for each in store.ids] == list(store.ids)
    assert read == ["1-of-3-000001", "2-of-3-000001", "3-of-3-000001"]


def test_what_is_no_store_is_refused(full, tmp_path):
    for text, word in (
        (None, "no store"),
        ("{", "damaged"),
        ("{}", "does not describe"),
        (json.dumps(full.info | {"schema_version": 99}), "layout 99"),
    ):
        if text is not None:
            (tmp_path / "store.json").write_text(text)
        with pytest.raises(PlanewiseError, match=word):
            Store(tmp_path)
    with pytest.raises(PlanewiseError, match="does not hold the frame 'x'"):
        full["x"]


def test_a_store_is_paired_with_the_truth(full, tmp_path):
    for name in ("00003", "00007", "other"):
        np.save(tmp_path / f"{name}.npy", np.zeros((60, 80), int))
    pairs = pair_store(full.path, tmp_path)
    assert [name for name, *_ in pairs.paired] == ["00003", "00007"]
    assert pairs.only_true == ("other",)
    assert len(pairs.only_predicted) == COUNT - 2
    read = pairs.paired[0][1].read()
    assert np.array_equal(read.labels, full.labels("00003"))
    assert np.array_equal(read.planes, full["00003"].planes)


def test_scores_do_not_go_into_a_store(full, tmp_path):
    np.save(tmp_path / "00003.npy", full.labels("00003"))
    table = full.path / "labels" / "scores.csv"
    code, _, errors = run("eval", full.path, tmp_path, "-o", table)
    assert (code, "scores.csv is in the store; choose another" in errors) == (2, True)
    assert not table.exists()


def test_a_true_image_is_of_one_frame(frames, tmp_path):
    recipe = Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options(), camera=frames[1])
    path, truth = tmp_path / "store", tmp_path / "truth"
    fill(Batch(source=Renamed(frames[0], ("a b", "a%20b")), store=path, recipe=recipe))
    truth.mkdir()
    np.save(truth / "a%20b.npy", np.zeros((60, 80), int))
    with pytest.raises(PlanewiseError, match=r"of the frame 'a b' .* or of 'a%20b'; name"):
        pair_store(path, truth)
    np.save(truth / "a b.npy", np.zeros((60, 80), int))
    paired = pair_store(path, truth).paired
    assert [(frame, file.stem) for frame, _, file in paired] == [("a b", "a b"), ("a%20b",) * 2]


def test_truth_of_another_size_names_the_frame_of_the_store(full, tmp_path):
    frame = full.ids[0]
    np.save(tmp_path / f"{frame}.npy", np.zeros((3, 3), int))
    (result,) = Scoring().run_pairs(pair_store(full.path, tmp_path))
    assert f"predicted: the frame {frame} of {full.path} has shape (60, 80), its" in result.reason


def test_a_damaged_table_is_named(frames, tmp_path):
    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    fill(batch)
    (path,) = (batch.store / "frames").iterdir()
    path.write_bytes(b"no table")
    with pytest.raises(PlanewiseError, match=rf"^store: {re.escape(str(path))} is damaged"):
        _ = Store(batch.store).frames


def copied(full, tmp_path):
    """Store of its own with the same frames."""
    store = tmp_path / "store"
    shutil.copytree(full.path, store)
    return store


def test_frames_without_their_recipe_are_not_gone_on_with(frames, full, tmp_path):
    store = copied(full, tmp_path)
    (store / "store.json").unlink()
    before = sorted(path.name for path in store.rglob("*"))
    with pytest.raises(PlanewiseError, match=r"holds frames, but not store\.json"):
        batch_of(frames[0], store, frames[1]).plan()
    assert sorted(path.name for path in store.rglob("*")) == before


@pytest.fixture
def changing(frames, tmp_path):
    """Folder of frames that may be changed, and a store of them."""
    folder, store = tmp_path / "frames", tmp_path / "store"
    shutil.copytree(frames[0], folder)
    fill(batch_of(folder, store, frames[1]))
    return folder, batch_of(folder, store, frames[1])


def test_a_source_that_has_grown_is_another_one(changing):
    folder, batch = changing
    batch.plan()
    first = min(folder.iterdir())
    shutil.copy(first, first.with_stem(f"{first.stem}a"))
    with pytest.raises(PlanewiseError, match=r"was made of [\d,]+ frames?, and .* has"):
        batch_of(folder, batch.store, batch.recipe.camera).plan()


def test_other_readings_are_noticed_in_the_last_frame_too(changing):
    folder, batch = changing
    last = folder / f"{Store(batch.store).ids[-1]}.png"
    depth = np.asarray(Image.open(last)).copy()
    depth[depth > 0] += 1
    Image.fromarray(depth).save(last)
    with pytest.raises(PlanewiseError, match="other readings"):
        batch.plan()


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [("fx", 60, "another camera"), ("depth_scale", 0.001, "another unit of depth")],
)
def test_another_camera_or_unit_that_the_dataset_states_is_noticed(tmp_path, name, value, told):
    folder = write_generic(tmp_path / "frames")
    recipe = Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options())
    start = Selection(limit=1)
    begun = Batch(
        source=open_source(folder), store=tmp_path / "store", recipe=recipe, selection=start
    )
    fill(begun)
    begun.plan()
    camera = json.loads((folder / "camera.json").read_text())
    (folder / "camera.json").write_text(json.dumps(camera | {name: value}))
    with pytest.raises(PlanewiseError, match=f"frame view 0 of frames has {told} than the one"):
        Batch(source=open_source(folder), store=tmp_path / "store", recipe=recipe).plan()


def test_a_label_file_of_another_frame_costs_its_frame(full, tmp_path):
    store = Store(copied(full, tmp_path))
    one, other = store.ids[:2]
    store.label_file(one).write_bytes(png_of_labels(np.full((5, 5), 1, np.uint16)))
    with pytest.raises(PlanewiseError, match=f"frame {one}: its label file is of another frame"):
        store.labels(one)
    height, width = store.labels(other).shape
    many = np.full((height, width), 500, np.uint16)
    store.label_file(one).write_bytes(png_of_labels(many))
    with pytest.raises(PlanewiseError, match="labels up to 500"):
        store.labels(one)


def test_a_missing_table_is_said_to_be_missing(full, tmp_path):
    path = copied(full, tmp_path)
    for table in (path / "planes").iterdir():
        table.unlink()
    with pytest.raises(PlanewiseError, match="is missing"):
        _ = Store(path).planes


def test_planes_without_some_rows_are_not_those_of_other_frames(full, tmp_path):
    path = copied(full, tmp_path)
    table = max((path / "planes").iterdir(), key=lambda each: each.stat().st_size)
    planes = read_table(table, PLANES)
    table.write_bytes(parquet_of(planes.slice(1)))
    with pytest.raises(PlanewiseError, match=f"{len(planes) - 1} planes in place of {len(planes)}"):
        _ = [frame.planes for frame in Store(path)]
    with pytest.raises(PlanewiseError, match="is damaged"):
        Store(path).labels(Store(path).ids[-1])
