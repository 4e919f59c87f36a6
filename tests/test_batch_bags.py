"""Stores made from bags: which topic they are of, and what does not go together."""

import json
import shutil

import numpy as np
import pytest
from benchmarks.faults import InOrder

from planewise import scenes
from planewise.batch import Store, open_source
from planewise.errors import PlanewiseError

from .bag_files import DEPTH, INFO, POINTS, START, frames, write_bag
from .command import run
from .dataset_files import FRAMES, units, write_generic

OTHER, OTHER_INFO = "/other/depth/image_raw", "/other/depth/camera_info"
SENSOR = ("--sensor", "kinect-v1")


def two_cameras(messages):
    yield from frames(messages)
    yield from list(frames(messages, OTHER))[:2]
    yield INFO, START, messages.info()
    yield OTHER_INFO, START, messages.info(fx=55.0)


@pytest.fixture
def bag(tmp_path):
    return write_bag(tmp_path / "run", "bag", two_cameras)


@pytest.fixture(autouse=True)
def _here(monkeypatch):
    """Have frames done in this process."""
    monkeypatch.setattr("planewise.commands.batch._engine", lambda *_: InOrder())


def test_the_topic_of_a_store_is_chosen_kept_and_held_to(bag, tmp_path):
    store = tmp_path / "store"
    code, _, errors = run("batch", bag, "-o", store, *SENSOR)
    assert code == 2
    assert f"several topics of depth images; give one (--topic): {DEPTH}, {OTHER}" in errors
    assert not store.exists()
    arguments = ("batch", bag, "-o", store, *SENSOR, "--topic", OTHER)
    assert run(*arguments, "--limit", 1)[::2] == (0, "")
    source = json.loads((store / "store.json").read_text())["source"]
    assert (source["topic"], source["camera_topic"]) == ([OTHER], [OTHER_INFO])
    code, _, errors = run(*arguments[:-1], DEPTH)
    assert code == 2
    assert f'made with other options: topic is "{OTHER}" there, "{DEPTH}" here' in errors
    code, _, errors = run(*arguments, "--camera-topic", INFO)
    assert code == 2
    assert f'camera_topic is "{OTHER_INFO}" there, "{INFO}" here' in errors
    assert run(*arguments)[0] == 0
    assert [Store(store)[each].row["fx"] for each in Store(store).ids] == [55, 55]
    code, out, errors = run("view", store, "-o", tmp_path / "page.html")
    assert (code, errors) == (0, "")  # drawn over the depth of the same topic
    assert "2 frames" in out


def test_range_images_of_a_lidar_take_its_camera(tmp_path):
    street, topic = scenes.street(0), "/ouster/range_image"

    def contents(messages):
        ranges = np.round(street.depth * (street.sensor.resolution / 0.004)).astype(np.uint16)
        message = messages.image(0, ranges)
        message.encoding = "mono16"  # and no CameraInfo: both as the maker's driver has it
        yield topic, START, message

    bag, camera = write_bag(tmp_path / "run", "bag", contents), tmp_path / "lidar.json"
    camera.write_text(json.dumps(street.camera.describe()))
    options = ("--topic", topic, "--camera", camera, "--depth-scale", "0.004")
    code, out, _ = run("frames", bag, *options)
    assert (code, "elevation 16.6 ... -16.6 (64), columns 1024" in out) == (0, True)
    assert run("batch", bag, "-o", tmp_path / "store", *options, "--sensor", "ouster-os1")[0] == 0
    found = Store(tmp_path / "store")["000000"].planes
    assert len(found) > 9
    assert np.abs(found[:, 2]).max() > 0.99  # the ground
    assert run("view", tmp_path / "store", "-o", tmp_path / "page.html")[::2] == (0, "")


def test_the_only_topic_may_be_named_or_not(tmp_path):
    def contents(messages):
        yield from frames(messages)
        yield INFO, START, messages.info()

    bag = write_bag(tmp_path / "run", "bag", contents)
    arguments = ("batch", bag, "-o", tmp_path / "store", *SENSOR)
    assert run(*arguments)[0] == 0
    code, out, _ = run(*arguments, "--topic", DEPTH)
    assert (code, "nothing to do" in out) == (0, True)


def test_topics_that_are_not_there_are_told_with_those_that_are(bag, tmp_path):
    for command in (("batch", bag, "-o", tmp_path / "store", *SENSOR), ("frames", bag)):
        code, _, errors = run(*command, "--topic", "/depth")
        assert code == 2
        assert errors.startswith("error: data: /depth is no topic of ")
        assert f"{OTHER} (sensor_msgs/msg/Image)" in errors
        code, _, errors = run(*command, "--topic", OTHER, "--camera-topic", "/info")
        assert code == 2
        assert f"(--camera-topic): {INFO}, {OTHER_INFO}" in errors
    assert not (tmp_path / "store").exists()


def test_frames_says_which_topics_it_took(tmp_path):
    def contents(messages):
        yield from frames(messages)
        yield "/rgb/camera_info", START, messages.info()  # the only one, though not beside them
        yield POINTS, START, messages.cloud(0)

    bag = write_bag(tmp_path / "run", "bag", contents)
    assert f" topic: {DEPTH} camera topic: /rgb/camera_info " in run("frames", bag)[1]
    out = run("frames", bag, "--camera", "50,52,31,24.5")[1]
    assert (f"topic: {DEPTH} " in out, "camera topic" in out) == (True, False)
    assert f" topic: {POINTS} " in run("frames", bag, "--kind", "ros-points")[1]


def test_the_topic_holds_for_all_bags_of_a_folder(tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    for name in ("a", "b"):
        write_bag(folder / name, "bag", two_cameras)
    code, _, errors = run("frames", folder)
    assert code == 2
    assert "holds 2 datasets, none of which can be opened; a.bag: the bag has several" in errors
    assert "--topic" in errors
    code, _, errors = run("frames", folder, "--topic", "/depth")
    assert code == 2
    assert "a.bag: /depth is no topic of" in errors
    source = open_source(folder, topic=OTHER)
    assert [source[each].camera.fx for each in source.ids] == [55] * 4


def test_topics_of_what_is_no_bag_are_refused(tmp_path):
    (tmp_path / "alone").mkdir()
    np.save(tmp_path / "alone" / "0.npy", units(FRAMES[0], 0.001))
    for name in ("a", "b"):
        shutil.copytree(tmp_path / "alone", tmp_path / "many" / name / "depth")
        camera = '{"fx": 50, "fy": 50, "cx": 31, "cy": 23, "depth_scale": 0.001}'
        (tmp_path / "many" / name / "camera.json").write_text(camera)
    for path, kind in (("alone", None), ("many/a", None), ("many/a", "folder"), ("many", None)):
        with pytest.raises(ValueError, match=r"^topic is no option of"):
            open_source(tmp_path / path, kind, topic=DEPTH)


def test_a_topic_that_one_of_several_datasets_lacks_costs_its_frames(tmp_path):
    write_generic(tmp_path / "a")
    write_bag(tmp_path / "run", "bag", two_cameras)
    source = open_source(tmp_path, topic="/depth")
    assert source.ids == ("a--view 0", "a--view 1", "a--view 2", "run.bag")
    with pytest.raises(PlanewiseError, match=r"/depth is no topic of"):
        source["run.bag"]


def test_options_are_called_as_they_are_typed(bag, tmp_path):
    camera = ("--camera", "50,52,31,24.5", "--camera-topic", INFO)
    code, _, errors = run("frames", bag, "--topic", DEPTH, *camera)
    assert (code, errors) == (
        2,
        "error: --camera-topic is not needed with a camera; give one of them ",
    )
    code, _, errors = run("frames", write_generic(tmp_path / "a"), "--topic", DEPTH)
    assert code == 2
    assert errors.startswith("error: --topic is no option of the kind 'folder'")


def test_camera_and_unit_are_for_datasets_of_a_kind_that_is_named_too(tmp_path):
    np.savez(tmp_path / "0.npz", depth=units(FRAMES[0], 0.001), K=[50, 50, 31, 23])
    for kind in (None, "archives"):
        assert len(open_source(tmp_path, kind, depth_scale=0.002).ids) == 1


def test_a_damaged_bag_further_down_is_a_frame_that_cannot_be_read(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir(parents=True)
        bag = write_bag(tmp_path / name / "run", "bag", two_cameras)
    bag.write_bytes(bag.read_bytes()[:2000])
    source = open_source(tmp_path, topic=DEPTH)
    assert source.ids[3:] == ("b--run.bag",)
    with pytest.raises(PlanewiseError, match=r"run\.bag cannot be opened"):
        source["b--run.bag"]
