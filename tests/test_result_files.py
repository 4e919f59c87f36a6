from __future__ import annotations

import json
import os
import pickle
import tempfile
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from PIL import Image

import planewise as pw
from planewise.errors import MissingExtraError, PlanewiseError
from planewise.files.result_names import FILES
from planewise.results.image import depth_in_metres, write_results
from planewise.results.planes_json import SCHEMA_FILE, SCHEMA_VERSION
from planewise.whole_files import output_folder, parent_folder

DOCUMENT = Path(__file__).parent.parent / "docs" / "planes-json.md"


def write(folder, scene, model, **options):
    write_results(
        folder, model, depth=scene.depth, camera=scene.camera, sensor=scene.sensor, **options
    )
    return json.loads((folder / "planes.json").read_text())


def validate(record):
    schema = json.loads(SCHEMA_FILE.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(record, schema)


def test_files_say_what_the_model_says(tmp_path, scene, model):
    record = write(tmp_path, scene, model, source="depth.png")
    validate(record)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(FILES)
    labels = np.asarray(Image.open(tmp_path / "labels.png"))
    assert labels.dtype == np.uint16
    assert np.array_equal(labels, model.labels)
    assert record["planewise_version"] == pw.__version__
    assert record["information"] == model.information
    assert record["readings"] == model.readings
    assert record["input"] == {
        "file": "depth.png",
        "width": 160,
        "height": 120,
        "depth_scale": 0.001,
    }
    assert record["options"] == dict(model.settings)
    assert record["curve"]["information"] == list(model.curve)
    assert len(record["planes"]) == len(model) == 4
    for written, plane in zip(record["planes"], model.planes, strict=True):
        assert np.array_equal(written["normal"], plane.normal)
        assert written["distance"] == plane.distance
        assert written["readings"] == plane.count
        assert np.array_equal(written["covariance"], plane.covariance)
        assert np.count_nonzero(labels == written["label"]) == plane.count
    for name in ("overlay.png", "curve.png"):
        with Image.open(tmp_path / name) as picture:
            assert picture.mode == "RGB"


@pytest.mark.parametrize(("name", "text"), [(b"tiefe \xc3\xa4", "tiefe ä"), (b"\xe4", "\\xe4")])
def test_names_that_the_locale_cannot_decode_are_valid_text(tmp_path, scene, model, name, text):
    source = name.decode("ascii", "surrogateescape")
    assert write(tmp_path, scene, model, source=source)["input"]["file"] == text


def test_a_model_without_planes_is_written_too(tmp_path, scene):
    depth = np.full((120, 160), np.nan)
    model = pw.detect_planes(depth, scene.camera, scene.sensor)
    write_results(tmp_path, model, depth=depth, camera=scene.camera, sensor=scene.sensor)
    record = json.loads((tmp_path / "planes.json").read_text())
    validate(record)
    assert record["planes"] == []
    assert record["note"]
    assert record["input"]["depth_scale"] is None


def test_distorted_camera_and_custom_noise_are_valid(tmp_path, scene):
    camera = pw.PinholeCamera(fx=125, fy=125, cx=80, cy=60, distortion=(0.05, 0.0, 0.0, 0.0))
    sensor = pw.Sensor(max_depth=3.0, noise=lambda z: 0.004 + 0 * z)
    model = pw.detect_planes(scene.depth, camera, sensor, search="sequential", inlier_ratio=0.2)
    write_results(tmp_path, model, depth=scene.depth, camera=camera, sensor=sensor)
    record = json.loads((tmp_path / "planes.json").read_text())
    validate(record)
    assert record["camera"]["distortion"][:4] == [0.05, 0.0, 0.0, 0.0]
    assert record["sensor"]["noise"]


def test_the_document_describes_every_field():
    text = DOCUMENT.read_text()
    schema = json.loads(SCHEMA_FILE.read_text())
    assert f"Schema version {SCHEMA_VERSION}" in text
    for name in (*schema["properties"], *schema["$defs"]["plane"]["properties"]):
        assert f"`{name}`" in text, name
    parts = (schema["properties"]["curve"], schema["$defs"]["image"], schema["$defs"]["cloud"])
    for part in parts:
        for name in part["properties"]:
            assert f"`{name}`" in text, name


def test_new_folder_appears_whole(tmp_path):
    target = tmp_path / "a" / "b"
    with output_folder(target) as folder:
        (folder / "x").write_text("1")
        assert not target.exists()
    assert (target / "x").read_text() == "1"
    assert [path.name for path in target.parent.iterdir()] == ["b"]


def test_existing_folder_keeps_its_other_files(tmp_path):
    (tmp_path / "x").write_text("old")
    (tmp_path / "y").write_text("mine")
    with output_folder(tmp_path) as folder:
        (folder / "x").write_text("new")
        assert (tmp_path / "x").read_text() == "old"
    assert (tmp_path / "x").read_text() == "new"
    assert (tmp_path / "y").read_text() == "mine"


@pytest.mark.parametrize("name", ["x", "stale"])
def test_nothing_is_replaced_where_a_folder_is_in_the_way(tmp_path, name):
    (tmp_path / "a").write_text("old")
    (tmp_path / name).mkdir()

    def write():
        with output_folder(tmp_path, ["stale"]) as folder:
            for each in "ax":
                (folder / each).write_text("new")

    with pytest.raises(PlanewiseError, match=f"/{name} is a folder"):
        write()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", name]
    assert (tmp_path / "a").read_text() == "old"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize("exists", [False, True])
def test_nothing_is_left_after_an_error(tmp_path, error, exists):
    target = tmp_path / "a" / "b"
    if exists:
        target.mkdir(parents=True)

    def fail():
        with output_folder(target) as folder:
            (folder / "x").write_text("1")
            raise error

    with pytest.raises(error):
        fail()
    assert list(tmp_path.rglob("*")) == ([target.parent, target] if exists else [])


def test_folders_that_cannot_be_made_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(PlanewiseError, match="output"), output_folder(target):
            pytest.fail("the work must not start")
        with pytest.raises(PlanewiseError, match="output"), parent_folder(target):
            pytest.fail("the work must not start")
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


NOBODY = 65534


@pytest.mark.skipif(not hasattr(os, "fork"), reason="permissions as POSIX has them")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_folder_without_permission_is_refused():
    with tempfile.TemporaryDirectory() as name:  # outside of pytest's, which is the user's alone
        folder = Path(name)
        folder.chmod(0o555)
        child = os.fork()
        if not child:  # root may write anywhere, nobody may not
            code = 1
            try:
                if os.geteuid() == 0:
                    os.setuid(NOBODY)
                with pytest.raises(PlanewiseError, match="output"), output_folder(folder / "new"):
                    pytest.fail("the work must not start")
                code = 0
            finally:
                os._exit(code)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert not list(folder.iterdir())
        folder.chmod(0o755)


def test_a_file_goes_to_a_folder_that_can_be_written_to(tmp_path, monkeypatch):
    from planewise.whole_files import written_whole

    (tmp_path / "file").touch()
    for folder in (tmp_path / "none", tmp_path / "file"):
        with (
            pytest.raises(PlanewiseError, match="is not a folder that can be written to"),
            written_whole(folder / "page.html"),
        ):
            pytest.fail("work was started")
    monkeypatch.setattr("os.access", lambda *_: False)
    with (
        pytest.raises(PlanewiseError, match="is not a folder that can be written to"),
        written_whole(tmp_path / "page.html"),
    ):
        pytest.fail("work was started")


def test_names_on_the_way_are_as_long_as_the_system_takes(tmp_path):
    from planewise.whole_files import written_whole

    name = "n" * 250 + ".json"
    with written_whole(tmp_path / name) as partial:
        assert partial.suffix == ".json"
        partial.write_text("new")
    with output_folder(tmp_path / ("f" * 255)) as folder:
        (folder / "x").write_text("1")
    assert {path.name for path in tmp_path.iterdir()} == {name, "f" * 255}


def test_two_that_make_one_folder_at_once_both_do(tmp_path):
    """Processes of two containers may have one number: neither may take the other's files."""
    target = tmp_path / "a"
    with output_folder(target) as first:
        with output_folder(target) as second:
            assert first != second
            (second / "x").write_text("second")
            (second / "y").write_text("second")
        (first / "x").write_text("first")
    assert (target / "x").read_text() == "first"
    assert (target / "y").read_text() == "second"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_an_error_for_want_of_an_extra_goes_to_other_processes():
    error = MissingExtraError("laspy", "reading it", "cloud")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (MissingExtraError, str(error))


def test_pipes_and_links_stay_what_they_are(tmp_path):
    from planewise.whole_files import written_whole

    pipe, file, link = (tmp_path / name for name in ("pipe.csv", "file.csv", "link.csv"))
    os.mkfifo(pipe)
    with pytest.raises(PlanewiseError, match="is not a regular file"), written_whole(pipe):
        pytest.fail("work was started")
    assert pipe.is_fifo()
    link.symlink_to(file)
    with written_whole(link) as partial:
        partial.write_text("new")
    assert link.readlink() == file
    assert file.read_text() == "new"


def test_an_empty_parent_goes_again(tmp_path):
    with parent_folder(tmp_path / "a" / "b"):
        pass
    assert not list(tmp_path.iterdir())
    with parent_folder(tmp_path / "a") as folder:
        (folder / "x").write_text("")
    assert (tmp_path / "a" / "x").exists()


def test_depth_in_metres_leaves_out_what_is_no_reading():
    sensor = pw.Sensor(min_depth=0.5, max_depth=2.0, resolution=0.001)
    integer = depth_in_metres(np.array([[0, 499, 500], [2000, 2001, 1000]], np.uint16), sensor)
    assert np.array_equal(integer, [[np.nan, np.nan, 0.5], [2, np.nan, 1]], equal_nan=True)
    floating = depth_in_metres(np.array([[np.inf, np.nan, 1.5]]), sensor)
    assert np.array_equal(floating, [[np.nan, np.nan, 1.5]], equal_nan=True)
