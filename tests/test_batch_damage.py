"""Stores of which files were lost or cut short: what batch does again, and what readers say."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from benchmarks.faults import InOrder, Tally, batch_of, compare, fill, write_frames
from PIL import Image

from planewise.batch import Store
from planewise.batch.journal import line_of
from planewise.batch.label_png import has_its_end, png_of_labels
from planewise.errors import PlanewiseError
from tests.command import run

COUNT = 5
CAMERA = ("--camera", "65.625,65.625,39.5,29.5", "--sensor", "kinect-v1")
AGAIN = "the 'planewise batch' that made the store"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder of depth images, and a store of them that nothing is wrong with."""
    folder = tmp_path_factory.mktemp("damage")
    camera = write_frames(folder / "frames", COUNT)
    fill(batch_of(folder / "frames", folder / "store", camera))
    return folder


@pytest.fixture
def here(made, tmp_path, monkeypatch):
    """Copy of both, whose frames are done in this process."""
    monkeypatch.setattr("planewise.commands.batch._engine", lambda *_: InOrder())
    return shutil.copytree(made, tmp_path / "here")


def batch(here, *more):
    return run("batch", here / "frames", "-o", here / "store", *CAMERA, *more)


def tables(store):
    return {path: path.read_bytes() for path in store.rglob("*.parquet")}


def cut(path, size):
    path.write_bytes(path.read_bytes()[:size])


@pytest.mark.parametrize("how", ["missing", "empty", "short", "all"])
def test_lost_label_images_are_made_again(made, here, how):
    labels = here / "store" / "labels"
    if how == "all":
        shutil.rmtree(labels)
    elif how == "missing":
        (labels / "00001.png").unlink()
    else:
        cut(labels / "00001.png", {"empty": 0, "short": 100}[how])
    before, count = tables(here / "store"), COUNT if how == "all" else 1
    code, out, errors = batch(here, "--dry-run")
    assert code == 0
    assert f"{COUNT - count} in the store, 0 failed before, {count} to do" in out
    code, out, errors = batch(here)
    assert code == 0
    assert f"to be made again: {count} label image" in errors
    assert f"such as that of the frame 0000{1 if count == 1 else 0}" in errors
    assert f"{count} of {count} frame" in out
    assert f"holds {COUNT} of the {COUNT} frames" in out
    tally = Tally()
    compare(Store(here / "store"), Store(made / "store"), tally)
    assert (tally.lost, tally.double, tally.corrupt) == (0, 0, 0)
    assert tables(here / "store") == before
    assert "nothing to do" in batch(here)[1]


def test_frames_that_are_not_asked_for_are_left_alone(here):
    (here / "store" / "labels" / "00003.png").unlink()
    assert "nothing to do" in batch(here, "--limit", 2)[1]
    assert "1 of 1 frame done" in batch(here, "--shard", "2/2")[1]


@pytest.mark.parametrize("how", ["other", "damaged"])
def test_a_frame_that_is_no_longer_the_same_keeps_its_rows(here, monkeypatch, how):
    frame, before = here / "frames" / "00001.png", tables(here / "store")
    if how == "other":
        Image.fromarray(np.full((60, 80), 2000, np.uint16)).save(here / "other.png")
    else:
        (here / "other.png").write_bytes(b"none")
    (here / "store" / "labels" / "00001.png").unlink()

    class Changing(InOrder):
        """Changes the frame only now: before, it would be seen that this is another source."""

        def run(self, work, frames):
            (here / "other.png").replace(frame)
            return super().run(work, frames)

    monkeypatch.setattr("planewise.commands.batch._engine", lambda *_: Changing())
    _, out, errors = batch(here)
    assert "frame 00001: its label image is lost, and cannot be made again: " in errors
    if how == "other":
        assert "its readings, camera or planes are no longer those of the store" in errors
    assert f"holds {COUNT - 1} of the {COUNT} frames" in out
    assert tables(here / "store") == before
    assert not (here / "store" / "labels" / "00001.png").exists()


def test_readers_say_which_frame_is_damaged_and_what_to_do(made, here, tmp_path):
    store = Store(here / "store")
    (here / "store" / "labels" / "00001.png").unlink()
    with pytest.raises(PlanewiseError, match=rf"frame 00001: .*no file .*\.png; {AGAIN} makes it"):
        store.labels("00001")
    cut(here / "store" / "labels" / "00002.png", 100)
    with pytest.raises(PlanewiseError, match=f"00002.*; once it is deleted, {AGAIN} makes it"):
        store.labels("00002")
    Image.new("I;16", (5, 5)).save(here / "store" / "labels" / "00003.png")
    with pytest.raises(PlanewiseError, match=f"of another frame.*; once it is deleted, {AGAIN}"):
        store.labels("00003")
    truth = shutil.copytree(made / "store" / "labels", tmp_path / "truth")
    for command in (
        ("export", here / "store", "--format", "png", "-o", tmp_path / "png"),
        ("eval", here / "store", truth),
    ):
        code, out, errors = run(*command)
        assert (code, errors.count(AGAIN)) == (2, 3)
        assert "2 of 5 frames" in out
    code, out, errors = run("view", here / "store", "-o", tmp_path / "page.html")
    assert (code, errors.count(AGAIN)) == (0, 3)


@pytest.mark.parametrize("table", ["frames", "planes"])
@pytest.mark.parametrize("how", ["missing", "short", "changed"])
def test_damaged_tables_are_told_with_what_to_do(made, here, table, how):
    name = "all-000001.parquet"
    path = here / "store" / table / name
    if how == "missing":
        path.unlink()
    elif how == "short":
        cut(path, 3000)
    else:
        path.write_bytes(path.read_bytes().replace(b"\x15", b"\x16"))
    said = f"once {name} of frames/ and planes/ is deleted, {AGAIN} does its frames again"
    if (table, how) != ("frames", "missing"):  # else those frames are still to do
        with pytest.raises(PlanewiseError) as caught:
            list(Store(here / "store"))
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)
        assert batch(here)[::2] == (2, f"error: {caught.value} ")
        told = run("eval", here / "store", made / "store" / "labels")
        assert told[::2] == (2, f"error: {caught.value} ")  # and not once a frame
    for each in ("frames", "planes"):
        (here / "store" / each / name).unlink(missing_ok=True)
    assert batch(here)[0] == 0
    tally = Tally()
    compare(Store(here / "store"), Store(made / "store"), tally)
    assert (tally.lost, tally.double, tally.corrupt) == (0, 0, 0)


@pytest.mark.parametrize("name", ["made_with", "source", "sensor", "versions", "made_with.options",
                                  "made_with.camera", "source.path", "source.frames",
                                  "made_with.planewise", "made_with.options.search",
                                  "sensor.noise"])  # fmt: skip
def test_a_damaged_description_is_told(here, tmp_path, name):
    *parts, key = name.split(".")
    path = here / "store" / "store.json"
    whole = json.loads(path.read_text())
    for other in ("missing", 3.5, [7]):
        info = json.loads(json.dumps(whole))
        place = info
        for part in parts:
            place = place[part]
        place[key] = other
        if other == "missing":
            del place[key]
        path.write_text(json.dumps(info))
        with pytest.raises(PlanewiseError, match=rf"json is damaged: it lacks {name}, or has"):
            Store(here / "store")
        assert batch(here)[0] == 2
    whole["source"]["topic"] = [3]
    path.write_text(json.dumps(whole))
    assert run("view", here / "store", "-o", tmp_path / "page.html")[0] == 2


@pytest.mark.parametrize("text", ['{"schema":' + "[" * 100_000, "[" * 10_000_001])
def test_a_description_that_is_a_bomb_is_told(here, text):
    (here / "store" / "store.json").write_text(text)
    with pytest.raises(PlanewiseError, match=r"store\.json is (damaged|too large)"):
        Store(here / "store")


@pytest.mark.parametrize("camera", [
    {"model": "spherical"},
    {"model": "spherical", "elevation": ["<"], "columns": 9},
    {"fx": "<", "fy": 1.0, "cx": 1.0, "cy": 1.0},
])  # fmt: skip
def test_a_camera_that_cannot_be_is_told(here, camera):
    path = here / "store" / "store.json"
    info = json.loads(path.read_text())
    info["made_with"]["camera"] = camera
    path.write_text(json.dumps(info))
    with pytest.raises(PlanewiseError, match=r"store\.json is damaged"):
        Store(here / "store")


@pytest.mark.parametrize(("column", "value"), [
    ("frame", None), ("number", None), ("status", None), ("width", None), ("curve", None),
    ("readings", None), ("planes", None), ("width", "80"), ("fx", None), ("camera", "[" * 100_000),
    ("camera", "[]"), ("camera", '{"model": "spherical"}'), ("fx", -1.0),
])  # fmt: skip
@pytest.mark.parametrize("sealed", [True, False])
def test_rows_that_no_run_writes_are_told(here, tmp_path, column, value, sealed):
    file = here / "store" / "frames" / "all-000001.parquet"
    rows = pq.read_table(file)
    planes = pq.read_table(here / "store" / "planes" / file.name)
    if column == "camera":
        rows = with_column(rows, "fx", None)
    if sealed:
        pq.write_table(with_column(rows, column, value), file)
    else:
        row = rows.to_pylist()[0]
        found = [list(each.values()) for each in planes.to_pylist()[: row["planes"]]]
        record = {"frame": row | {column: value}, "planes": found}
        file.unlink()
        (here / "store" / "journal" / "all-000001.jsonl").write_bytes(
            line_of(json.dumps(record).encode())
        )
    code, _, errors = run("view", here / "store", "-o", tmp_path / "page.html")
    assert code == 2
    assert errors.startswith("error: store: ")
    assert "is damaged" in errors


def with_column(table, name, value):
    kind = pa.string() if isinstance(value, str) else table.schema.field(name).type
    column = pa.array([value] * len(table), kind)
    return table.set_column(table.column_names.index(name), name, column)


def test_frames_of_fewer_planes_than_none_are_told(here):
    file = here / "store" / "frames" / "all-000001.parquet"
    rows = pq.read_table(file)
    first, second, *others = rows["planes"].to_pylist()
    counts = pa.array([-1, first + second + 1, *others], pa.int32())
    place = rows.column_names.index("planes")
    pq.write_table(rows.set_column(place, "planes", counts), file)
    with pytest.raises(PlanewiseError, match="is damaged"):
        list(Store(here / "store"))


@pytest.mark.parametrize("record", [b"[" * 100_000, b"{}", b'{"frame": 3, "planes": []}', b"x"])
def test_a_journal_of_others_is_told(here, record):
    (here / "store" / "journal" / "other-000001.jsonl").write_bytes(line_of(record))
    with pytest.raises(PlanewiseError, match=r"other-000001\.jsonl is damaged"):
        list(Store(here / "store"))
    assert batch(here)[0] == 2


def test_the_end_of_a_label_image(tmp_path):
    path = tmp_path / "a.png"
    assert not has_its_end(path)
    data = png_of_labels(np.zeros((3, 4), np.uint16))
    for size in range(len(data) + 1):
        path.write_bytes(data[:size])
        assert has_its_end(path) == (size == len(data))
    Image.new("I;16", (5, 5)).save(path)  # as others write it
    assert has_its_end(path)
