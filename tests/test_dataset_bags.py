"""Bags of ROS 1 and 2 and MCAP files, written by another program, and what damages them."""

import builtins
import errno
import os
import pickle
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import planewise as pw
from planewise import datasets
from planewise.datasets.bags import _READ, Bag
from planewise.errors import MissingExtraError, PlanewiseError

from .bag_files import DEPTH, FORMS, INFO, POINTS, START, STEP, frames, write_bag
from .dataset_files import CAMERA, COUNT, FRAMES, sweep, units

SIZED = pw.PinholeCamera(fx=50, fy=52, cx=31.0, cy=24.5, width=64, height=48)


def everything(messages):
    yield from frames(messages)
    yield INFO, START, messages.info()
    for n in range(COUNT):
        yield POINTS, START + n * STEP, messages.cloud(n)
        colour = messages.image(n, units(FRAMES[n], 0.001))
        colour.encoding = "bgr8"
        yield "/camera/color/image_raw", START + n * STEP, colour


@pytest.fixture(params=FORMS)
def bag(request, tmp_path):
    return write_bag(tmp_path / "run", request.param, everything)


def test_depth_and_camera_of_every_form(bag):
    dataset = datasets.open(bag)
    assert dataset.kind == "ros"
    assert dataset.ids == ("000000", "000001", "000002")
    for n in (0, 1, 2, 1, 0, 2):  # forwards, and back
        seen = dataset[n]
        assert_array_equal(seen.depth, units(FRAMES[n], 0.001))
        assert seen.camera == SIZED
        assert seen.depth_scale == 0.001
        assert seen.timestamp == pytest.approx((START + n * STEP) / 1e9, abs=1e-6)
    assert_array_equal(dataset[::2][1].depth, dataset[2].depth)
    again = pickle.loads(pickle.dumps(dataset))
    assert_array_equal(again[1].depth, dataset[1].depth)


def test_points_of_every_form(bag):
    dataset = datasets.open(bag, "ros-points")
    for n, seen in enumerate(dataset):
        assert_array_equal(seen.points, sweep(n)[:, :3])
        assert_array_equal(seen.intensity, sweep(n)[:, 3])
        assert seen.timestamp == pytest.approx((START + n * STEP) / 1e9, abs=1e-6)


def test_the_file_of_a_ros_2_bag_opens_alone(tmp_path):
    for form in ("db3", "mcap"):
        folder = write_bag(tmp_path / form, form, everything)
        file = next(folder.glob(f"*.{form}"))
        assert_array_equal(datasets.open(file)[1].depth, units(FRAMES[1], 0.001))


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("metres", [False, True])
def test_images_of_both_encodings_orders_and_padded_rows(tmp_path, metres, big):
    def contents(messages):
        depth = FRAMES[0]["raw"].astype(np.float32) if metres else units(FRAMES[0], 0.001)
        yield DEPTH, START, messages.image(0, depth, padding=6, big=big)
        yield INFO, START, messages.info()

    seen = datasets.open(write_bag(tmp_path / "run", "bag", contents))[0]
    scale = 1 if metres else 0.001
    assert seen.depth_scale == (None if metres else 0.001)
    assert seen.depth.dtype == (np.float32 if metres else np.uint16)
    assert_allclose(seen.depth * scale, FRAMES[0]["raw"], atol=0.00051)


@pytest.mark.parametrize("metres", [False, True])
def test_compressed_depth(tmp_path, metres):
    def contents(messages):
        yield from frames(messages, f"{DEPTH}/compressedDepth", compressed=True, metres=metres)
        yield INFO, START, messages.info()

    dataset = datasets.open(write_bag(tmp_path / "run", "mcap", contents))
    seen = dataset[1]
    if metres:  # coded as inverse depth in steps of 1 / 400
        valid = FRAMES[1]["raw"] > 0
        assert_array_equal(seen.valid, valid)
        difference = 1 / seen.depth[valid] - 1 / FRAMES[1]["raw"][valid]
        assert np.abs(difference).max() < 0.51 / 400
    else:
        assert_array_equal(seen.depth, units(FRAMES[1], 0.001))


def test_of_an_image_sent_twice_the_plain_one_is_read(tmp_path):
    def contents(messages):
        yield from frames(messages)
        yield from frames(messages, f"{DEPTH}/compressedDepth", compressed=True)
        yield INFO, START, messages.info()

    assert datasets.open(write_bag(tmp_path / "run", "db3", contents)).topic.name == DEPTH


def test_other_compressions_are_named(tmp_path):
    def contents(messages):
        message = messages.compressed(0, units(FRAMES[0], 0.001), "16UC1; compressedDepth rvl")
        message.data = message.data[::-1].copy()
        yield f"{DEPTH}/compressedDepth", START, message
        yield INFO, START, messages.info()

    dataset = datasets.open(write_bag(tmp_path / "run", "mcap", contents))
    with pytest.raises(
        PlanewiseError, match="compressedDepth rvl'; compressed depth is read from PNG"
    ):
        dataset[0]


def test_rectified_images_have_the_camera_of_p(tmp_path):
    def contents(messages):
        yield from frames(messages, "/camera/depth/image_rect")
        yield INFO, START, messages.info(distortion=(0.1, 0, 0, 0, 0))

    camera = datasets.open(write_bag(tmp_path / "run", "bag", contents)).camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (60, 61, 30, 20)
    assert not camera.distortion

    def raw(messages):
        yield from frames(messages)
        yield INFO, START, messages.info(distortion=(0.1, 0, 0, 0, 0))

    camera = datasets.open(write_bag(tmp_path / "other", "bag", raw)).camera
    assert (camera.fx, camera.distortion) == (50, (0.1, 0, 0, 0, 0))


@pytest.mark.parametrize("kind", ["bag", "db3"])
def test_a_camera_that_bins_its_pixels_is_that_of_the_image(tmp_path, kind):
    def contents(messages):
        yield from frames(messages)
        yield INFO, START, messages.info(binning=2)

    camera = datasets.open(write_bag(tmp_path / "run", kind, contents)).camera
    assert (camera.width, camera.height, camera.fx, camera.fy) == (32, 24, 25, 26)


def test_the_topic_is_asked_for_where_there_are_several(tmp_path):
    def contents(messages):
        yield from frames(messages)
        yield from frames(messages, "/other/depth/image_raw")
        yield INFO, START, messages.info()
        yield "/other/depth/camera_info", START, messages.info(fx=55.0)
        yield POINTS, START, messages.cloud(0)

    path = write_bag(tmp_path / "run", "bag", contents)
    with pytest.raises(PlanewiseError, match=f"several topics of depth images; .*{DEPTH}, /other"):
        datasets.open(path)
    assert datasets.open(path, topic=DEPTH).camera.fx == 50
    assert datasets.open(path, topic="/other/depth/image_raw").camera.fx == 55
    with pytest.raises(PlanewiseError, match="/nothing is no topic of sensor_msgs/msg/Image"):
        datasets.open(path, topic="/nothing")
    assert len(datasets.open(path, "ros-points")) == 1


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"topic": [DEPTH]}, "topic must be a string, got "),
        ({"camera_topic": 7}, "camera_topic must be a string, got 7"),
        ({"camera": "nyu"}, "camera must "),
        ({"depth_scale": -1}, "depth_scale must be a positive number"),
    ],
)
def test_options_of_another_kind_are_refused(tmp_path, option, message):
    path = write_bag(tmp_path / "run", "bag", everything)
    with pytest.raises(ValueError, match=f"^{message}"):
        datasets.open(path, **option)


def test_a_camera_is_asked_for_where_there_is_none(tmp_path):
    path = write_bag(tmp_path / "run", "bag", frames)
    with pytest.raises(PlanewiseError, match=f"has no CameraInfo {INFO}; give the camera"):
        datasets.open(path)
    assert datasets.open(path, camera=CAMERA)[0].camera == CAMERA

    def uncalibrated(messages):
        yield from frames(messages)
        message = messages.info()
        message.k[:] = 0
        yield INFO, START, message

    path = write_bag(tmp_path / "other", "mcap", uncalibrated)
    with pytest.raises(PlanewiseError, match="holds no calibration"):
        datasets.open(path)


def test_a_bag_of_points_alone_is_one_of_points(tmp_path):
    def contents(messages):
        yield POINTS, START, messages.cloud(0)

    assert datasets.open(write_bag(tmp_path / "run", "db3", contents)).kind == "ros-points"


def test_a_bag_of_nothing_that_is_known_says_what_it_has(tmp_path):
    def contents(messages):
        yield INFO, START, messages.info()

    with pytest.raises(PlanewiseError, match=f"no topic of depth images; it has {INFO} [^;]*$"):
        datasets.open(write_bag(tmp_path / "run", "db3", contents))


def test_images_that_may_be_depth_are_named(tmp_path):
    def contents(messages):
        message = messages.image(0, units(FRAMES[0], 0.001))
        message.encoding = "mono16"
        yield DEPTH, START, message
        yield INFO, START, messages.info()

    path = write_bag(tmp_path / "run", "db3", contents)
    with pytest.raises(PlanewiseError, match=r"no topic of depth .* give the topic \(--topic\)$"):
        datasets.open(path)
    assert_array_equal(datasets.open(path, topic=DEPTH)[0].depth, units(FRAMES[0], 0.001))


def test_messages_of_one_time_are_told_apart(tmp_path):
    def contents(messages):
        for n, each in enumerate(FRAMES):
            yield DEPTH, START, messages.image(n, units(each, 0.001))
        yield INFO, START, messages.info()

    for form in ("bag", "mcap", "db3"):
        dataset = datasets.open(write_bag(tmp_path / form, form, contents))
        assert len(dataset) == COUNT
        seen = {dataset[n].timestamp for n in (2, 1, 0)}
        assert len(seen) == COUNT
        assert_array_equal(dataset[1].depth, dataset[1].depth)


def depths(form):
    """Images of which each fills a chunk; those of MCAP's writer are a megabyte."""
    shape = (700, 800) if form.startswith("mcap") else (48, 64)
    return [np.full(shape, 1000 + n, np.uint16) for n in range(5)]


@pytest.fixture(params=["bag-bz2", "bag-lz4", "mcap-zstd"])
def chunks(request, tmp_path):
    """A bag with an image in each chunk, where the chunks' packed bytes lie, and the images."""

    images = depths(request.param)

    def contents(messages):
        for n, depth in enumerate(images):
            yield DEPTH, START + n * STEP, messages.image(n, depth)

    path = write_bag(tmp_path / "run", request.param, contents, chunk=1)
    path = path if path.is_file() else next(path.glob("*.mcap"))
    with Bag(path) as bag:
        pieces = bag._storages[0].chunks
        if isinstance(pieces, dict):  # ROS 1
            places = [(each.datapos, each.datasize) for each in pieces.values()]
        else:
            places = [
                (each.chunk_start_offset + 49 + len(each.compression), each.compressed_size)
                for each in pieces
            ]
    return path, sorted(places), images


def test_a_damaged_chunk_is_reported_and_the_others_are_read(chunks):
    path, places, images = chunks
    dataset = datasets.open(path, camera=CAMERA)
    start, size = places[2]
    data = bytearray(path.read_bytes())
    data[start : start + min(size, 16)] = bytes(min(size, 16))
    path.write_bytes(data)
    bad = []
    good = [seen.id for seen in dataset.readable(lambda each, error: bad.append(str(error)))]
    assert good == [dataset.ids[n] for n in (0, 1, 3, 4)]
    assert len(bad) == 1
    assert f"frame {dataset.ids[2]}: " in bad[0]
    assert "\n" not in bad[0]
    for n in (3, 0, 4, 1):
        assert_array_equal(dataset[n].depth, images[n])
    assert_array_equal(dataset[1::2][1].depth, images[3])  # past the damaged one


@pytest.mark.parametrize("form", ["bag", "mcap"])
@pytest.mark.parametrize("more", ["Nothing[] junk", "Nothing[200000000] junk"])
def test_messages_that_a_bag_defines_anew_are_refused(tmp_path, form, more):
    """Of a few bytes they would make any number of empty parts."""

    def contents(messages):
        yield from frames(messages)
        yield INFO, START, messages.info()
        messages.bytes(messages.image(0, units(FRAMES[0], 0.001)))  # from here on those of ROS
        store, name = messages.store, "sensor_msgs/msg/Image"
        text, _ = store.generate_msgdef(name, ros_version=1 if messages.ros1 else 2)
        bar = "=" * 80 + "\n"
        parts = [f"{text.partition(bar)[0]}{more}\n", text.partition(bar)[2]]
        text = bar.join([*parts, "MSG: sensor_msgs/Nothing\n"])
        store.fielddefs.update(get_types_from_msg(text, name))

    path = write_bag(tmp_path / "run", form, contents)
    with pytest.raises(PlanewiseError, match=r"run.*defines sensor_msgs/msg/Image otherwise"):
        datasets.open(path)


@pytest.mark.parametrize("store", [each for each in Stores if each != Stores.EMPTY])
def test_every_version_of_ros_defines_messages_as_they_are_read(store):
    other, ros1 = get_typestore(store).fielddefs, store.name.startswith("ROS1")
    known = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE).fielddefs
    assert all(other[name][1] == known[name][1] for name in _READ)


def test_a_chunk_that_swells_is_refused(chunks, monkeypatch):
    path, _, images = chunks
    dataset = datasets.open(path, camera=CAMERA)
    monkeypatch.setattr("planewise.datasets.bags.LARGEST_CHUNK", images[0].nbytes)
    with pytest.raises(PlanewiseError, match=f"holds more than its {images[0].nbytes:,} bytes"):
        dataset[1]


def test_a_message_that_swells_is_refused(tmp_path, monkeypatch):
    path = write_bag(tmp_path / "run", "db3-message", everything)
    dataset = datasets.open(path)
    monkeypatch.setattr("planewise.datasets.bags.LARGEST_CHUNK", 1000)
    with pytest.raises(PlanewiseError, match="holds more than its 1,000 bytes"):
        dataset[1]


def test_a_bag_that_is_compressed_as_a_whole_is_not_unpacked(tmp_path):
    path = write_bag(tmp_path / "run", "db3-file", everything)
    with pytest.raises(PlanewiseError, match="compressed as a whole"):
        datasets.open(path)


@pytest.mark.parametrize("form", ["bag", "mcap"])
def test_a_bag_that_is_cut_short_is_refused_at_once(tmp_path, form):
    path = write_bag(tmp_path / "run", form, everything)
    path = path if path.is_file() else next(path.glob(f"*.{form}"))
    data = path.read_bytes()
    for share in (0.01, 0.5, 0.99):
        path.write_bytes(data[: int(len(data) * share)])
        with pytest.raises(PlanewiseError, match=r"run.* is damaged|damaged, or lacks its index"):
            datasets.open(path)


def test_files_of_a_bag_may_not_be_links_out_of_it(tmp_path):
    path = write_bag(tmp_path / "run", "db3", everything)
    file = next(path.glob("*.db3"))
    file.rename(tmp_path / "elsewhere.db3")
    file.symlink_to(tmp_path / "elsewhere.db3")
    with pytest.raises(PlanewiseError, match=r"run.db3 lies outside the dataset"):
        datasets.open(path)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_forked_process_opens_the_bag_anew(tmp_path):
    """It shares the place in an open file, and has no thread to let go of a lock."""
    dataset = datasets.open(write_bag(tmp_path / "run", "bag", everything))
    first = dataset[0].depth
    opened = dataset.topic._bag
    with dataset.topic._lock:  # as if a thread were reading
        child = os.fork()
        if not child:
            signal.alarm(20)  # rather than to wait for ever
            code = 1
            try:
                code -= np.array_equal(dataset[0].depth, first) and dataset.topic._bag is not opened
            finally:
                os._exit(code)
    assert os.waitpid(child, 0)[1] == 0
    assert_array_equal(dataset[0].depth, first)
    assert dataset.topic._bag is opened


def test_several_threads_read_one_bag(tmp_path):
    dataset = datasets.open(write_bag(tmp_path / "run", "mcap-zstd", everything))
    numbers = [n % COUNT for n in range(40)]
    with ThreadPoolExecutor(4) as pool:
        for n, seen in zip(numbers, pool.map(dataset.__getitem__, numbers), strict=True):
            assert_array_equal(seen.depth, units(FRAMES[n], 0.001))


def test_few_of_many_bags_stay_open(tmp_path, monkeypatch):
    """A process may have a thousand files open; a collection may have more bags."""
    monkeypatch.setattr("planewise.datasets.bags._MOST_OPEN", 2)
    path = write_bag(tmp_path / "run", "bag", everything)
    first, *others = (datasets.open(path) for _ in range(5))

    def opened():
        return sum(each.topic._bag is not None for each in (first, *others))

    with first.topic._lock:  # as if a thread were reading
        first.topic._afresh(0)
        for dataset in others:
            assert_array_equal(dataset[1].depth, units(FRAMES[1], 0.001))
        assert first.topic._bag is not None
    for dataset in (*others, first):
        assert_array_equal(dataset[2].depth, units(FRAMES[2], 0.001))
        assert opened() == 2
    assert first.topic._bag is not None


def test_a_file_that_cannot_be_opened_is_not_called_damaged(tmp_path, monkeypatch):
    path = write_bag(tmp_path / "run", "bag", everything)
    dataset = datasets.open(path)

    def full(self, *mode):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE), str(self))

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(PlanewiseError, match=r"frame 000000: cannot be read \(Too many open files"):
        dataset[0]


def test_damaged_clouds_and_images_are_told(tmp_path):
    def contents(messages):
        yield POINTS, START, messages.cloud(0, width=101)
        yield POINTS, START + 1, messages.cloud(1, names=("x", "y", "intensity"))
        yield DEPTH, START, messages.image(0, units(FRAMES[0], 0.001))
        short = messages.image(0, units(FRAMES[0], 0.001))
        short.data = short.data[:-1]
        yield DEPTH, START + 1, short
        huge = messages.image(0, units(FRAMES[0], 0.001))
        huge.height, huge.width = 2**31, 2**31
        yield DEPTH, START + 2, huge
        colour = messages.image(0, units(FRAMES[0], 0.001))
        colour.encoding = "rgb8"
        yield DEPTH, START + 3, colour

    path = write_bag(tmp_path / "run", "bag", contents)
    points, depth = datasets.open(path, "ros-points"), datasets.open(path, camera=CAMERA)
    for dataset, messages in (
        (points, ["the cloud is damaged", "has no x, y and z"]),
        (depth[1:], ["the image is damaged", "at most 50,000,000 are read", "encoding is 'rgb8'"]),
    ):
        for n, message in enumerate(messages):
            with pytest.raises(PlanewiseError, match=message):
                dataset[n]


def test_without_rosbags_the_message_names_the_extra(tmp_path, monkeypatch):
    path = write_bag(tmp_path / "run", "bag", everything)
    find = builtins.__import__

    def missing(name, *more):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return find(name, *more)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(MissingExtraError, match=r"planewise\[ros\]"):
        datasets.open(path)
