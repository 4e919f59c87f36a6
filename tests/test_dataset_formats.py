"""Formats of datasets: small files in the real format in, the frames that were put in out."""

import os
import pickle
import re
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import planewise as pw
from planewise import datasets
from planewise.batch import open_source
from planewise.datasets import hypersim
from planewise.datasets.association import nearest
from planewise.datasets.collection import Collection
from planewise.datasets.frames import Dataset
from planewise.errors import PlanewiseError

from . import dataset_files as files
from .command import run_python
from .dataset_files import CAMERA, COUNT, FRAMES, POSES
from .nyu_files import write_archive, write_folder, write_mat


def _archives(root):
    root.mkdir()
    for n, each in enumerate(FRAMES):
        write_archive(root / f"{n}.npz", each, CAMERA)
    return root


def _mat(path):
    write_mat(path, FRAMES)
    return path


# Name of the kind, writer, and whether the reader has to be told the camera.
FORMATS = {
    "tum": (files.write_tum, True),
    "icl-nuim": (files.write_icl, True),
    "icl-nuim-rendered": (files.write_icl_rendered, True),
    "7-scenes": (files.write_seven_scenes, True),
    "hypersim": (files.write_hypersim, True),
    "scannet": (files.write_scannet, False),
    "sens": (files.write_sens, False),
    "redwood": (files.write_redwood, False),
    "folder": (files.write_generic, False),
    "nyu-raw": (files.write_nyu_raw, True),
    "archives": (_archives, False),
    "nyu-labelled": (_mat, True),
}
SIZED = pw.PinholeCamera(fx=50, fy=52, cx=31.0, cy=24.5, width=64, height=48)


def opened(kind, tmp_path):
    write, told = FORMATS[kind]
    return datasets.open(write(tmp_path / "data"), camera=SIZED if told else None)


@pytest.fixture(params=FORMATS)
def kind(request):
    return request.param


@pytest.fixture
def dataset(kind, tmp_path):
    return opened(kind, tmp_path)


def test_every_format_is_recognised_and_gives_what_was_put_in(kind, dataset):
    assert dataset.kind == kind
    assert isinstance(dataset, Dataset)
    assert len(dataset) == len(dataset.ids) == COUNT
    for seen, each, frame in zip(dataset, FRAMES, dataset.ids, strict=True):
        assert seen.id == frame
        camera = seen.camera
        numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
        assert_allclose(numbers, (50, 52, 31.0, 24.5), rtol=1e-6)
        scale = 1.0 if seen.depth_scale is None else seen.depth_scale
        wanted = each["depth"] if kind == "nyu-labelled" else files.expected(kind, each)
        step = 1e-5 if seen.depth_scale is None else 0.5 * scale + 1e-6
        assert_allclose(seen.depth * scale, wanted, atol=step)
        assert_array_equal(seen.valid, wanted > 0)
        assert seen.rgb.shape[2] == 3
        lossy = kind in ("sens", "redwood", "hypersim")
        small = seen.rgb[:: seen.rgb.shape[0] // 48, :: seen.rgb.shape[1] // 64].astype(float)
        assert np.abs(small - each["rgb"]).mean() < (60 if lossy else 1e-9)


def test_frames_by_number_slice_and_name_are_the_same(dataset):
    middle = dataset[1]
    assert middle.id == dataset.ids[1] == dataset[-2].id
    fewer = dataset[::2]
    assert fewer.ids == dataset.ids[::2]
    assert len(fewer) == 2
    assert_array_equal(fewer[1].depth, dataset[2].depth)
    assert middle.id not in fewer
    assert dataset[np.int64(1)].id == middle.id
    assert len(dataset[5:]) == 0
    with pytest.raises(PlanewiseError, match="has no frame"):
        fewer[middle.id]
    with pytest.raises(PlanewiseError, match="no number 3"):
        dataset[3]
    again = pickle.loads(pickle.dumps(fewer))  # to a worker
    assert_array_equal(again[1].depth, dataset[2].depth)
    assert again.kind == dataset.kind


def test_pictures_may_be_left_out(dataset):
    bare = dataset.without_pictures()
    assert bare[0].rgb is None
    assert_array_equal(bare[0].depth, dataset[0].depth)
    assert dataset[0].rgb is not None


@pytest.mark.parametrize("kind", sorted(FORMATS.keys() - {"sens", "nyu-labelled"}))
def test_a_damaged_file_concerns_its_frame_alone(kind, tmp_path):
    """Files are read when they are asked for: this one is damaged after opening."""
    dataset = opened(kind, tmp_path)
    depth = [path for path in (tmp_path / "data").rglob("*") if _is_depth(path)]
    victim = sorted(depth)[1]
    victim.write_bytes(victim.read_bytes()[:40])
    reported = []
    good = list(dataset.readable(lambda frame, error: reported.append((frame, str(error)))))
    assert len(good) == COUNT - 1
    assert [frame for frame, _ in reported] == [dataset.ids[1]]
    assert "\n" not in reported[0][1]
    assert dataset.ids[1] in reported[0][1]


def _is_depth(path):
    return (
        path.suffix in (".pgm", ".npz", ".depth")
        or "depth_meters" in path.name
        or (path.suffix == ".png" and (path.parent.name == "depth" or ".depth." in path.name))
    )


@pytest.mark.parametrize("parts", [".", "scene0000_00"])
def test_a_damaged_pose_costs_nothing_where_poses_are_not_wanted(tmp_path, parts):
    files.write_scannet(tmp_path / "data" / parts)
    (tmp_path / "data" / parts / "pose/2.txt").write_text("1 0 0")
    dataset = datasets.open(tmp_path / "data")
    with pytest.raises(PlanewiseError, match=r"pose/2.txt must hold 4 x 4 numbers"):
        dataset[2]
    for bare in (dataset.without_poses(), dataset.without_pictures().without_poses()):
        assert_array_equal(bare[2].depth, files.units(FRAMES[2], 0.001))
        assert [each.pose for each in bare] == [None] * COUNT
    assert dataset[0].pose is not None
    source = open_source(tmp_path / "data")
    assert source[source.ids[2]].pose is None
    posed = open_source(tmp_path / "data", poses=True)
    assert posed[posed.ids[0]].pose is not None


def test_damaged_lines_of_a_trajectory_are_left_out(tmp_path, caplog):
    dataset = opened("tum", tmp_path)
    path = tmp_path / "data/groundtruth.txt"
    lines = path.read_text().splitlines()
    more = ["1305031102.3 1 2 3 0 0", "nan 1 2 3 0 0 0 1", "1305031102.3 1 2 x 0 0 0 1"]
    path.write_text("\n".join(more + lines))
    again = datasets.open(tmp_path / "data")
    assert "3 lines of groundtruth.txt cannot be read" in caplog.text
    for each, other in zip(again, dataset, strict=True):
        assert_array_equal(each.pose, other.pose)


def test_tum_takes_the_nearest_picture_and_pose(tmp_path):
    dataset = opened("tum", tmp_path)
    assert dataset.ids[0] == "1305031102.160407"
    assert dataset[0].timestamp == 1305031102.160407
    assert dataset[0].depth_scale == 1 / 5000
    for n in range(COUNT):
        assert_allclose(dataset[n].pose, POSES[n])
    assert datasets.TumSequence(tmp_path / "data").camera == pw.cameras.KINECT_V1
    strict = datasets.TumSequence(tmp_path / "data", apart=0.005)
    assert strict[0].rgb is None
    assert strict[0].pose is not None


@pytest.mark.parametrize("first", ["depth", "rgb"])
def test_a_list_of_pairs_by_times_is_no_icl_nuim(tmp_path, first):
    dataset = opened("tum", tmp_path)
    root = tmp_path / "data"
    lines = []
    for each in dataset.ids[::-1]:
        depth = f"{each} depth/{each}.png"
        time = float(each) + 0.01
        rgb = f"{time:.6f} rgb/{time:.6f}.png"
        lines.append(f"{depth} {rgb}" if first == "depth" else f"{rgb} {depth}")
    (root / "associations.txt").write_text("\n".join(lines))
    for name in ("depth.txt", "rgb.txt"):
        (root / name).unlink()
    pairs = datasets.open(root)
    assert pairs.kind == "tum"
    assert pairs.camera == pw.cameras.KINECT_V1
    assert pairs.sensor == pw.sensors.KINECT_V1
    assert pairs.ids == dataset.ids
    for each, other in zip(pairs, dataset, strict=True):
        assert each.timestamp == other.timestamp
        assert_array_equal(each.rgb, other.rgb)
        assert_allclose(each.pose, other.pose)


def test_a_list_of_times_with_names_that_are_none_may_be_of_any_camera(tmp_path):
    opened("icl-nuim", tmp_path)
    lines = [f"{1e9 + n} depth/{n}.png {1e9 + n} rgb/{n}.png" for n in range(COUNT)]
    (tmp_path / "data/associations.txt").write_text("\n".join(lines))
    with pytest.raises(PlanewiseError, match="no dataset of a known kind"):
        datasets.open(tmp_path / "data")
    assert datasets.open(tmp_path / "data", "icl-nuim", camera=CAMERA)[1].timestamp == 1e9 + 1


def test_times_of_icl_nuim_are_those_of_depth_where_pictures_come_first(tmp_path):
    dataset = opened("icl-nuim", tmp_path)
    lines = [f"{n + 7} rgb/{n}.png {n} depth/{n}.png" for n in range(COUNT)]
    (tmp_path / "data/associations.txt").write_text("\n".join(lines))
    again = datasets.open(tmp_path / "data")
    assert again.kind == "icl-nuim"
    for each, other in zip(again, dataset, strict=True):
        assert (each.id, each.timestamp) == (other.id, other.timestamp)
        assert_array_equal(each.rgb, other.rgb)
    (tmp_path / "data/associations.txt").write_text("0 rgb/0.png zero depth/0.png")
    with pytest.raises(PlanewiseError, match=r"expected a time before depth/0.png, got zero"):
        datasets.open(tmp_path / "data")


def test_a_quaternion_turns_as_it_should():
    from planewise.datasets.tum import rigid

    half = np.sqrt(0.5)
    turned = rigid(np.array([1.0, 2.0, 3.0, 0.0, 0.0, 2 * half, 2 * half]))  # 90 degrees about z
    assert_allclose(turned @ (1, 0, 0, 1), (1, 3, 3, 1), atol=1e-12)
    assert rigid(np.zeros(7)) is None
    assert rigid(np.array([1.0, np.nan, 3.0, 0.0, 0.0, 0.0, 1.0])) is None


def test_nearest_in_time():
    times = [0.0, 1.0, 1.03, 5.0]
    assert [nearest(times, t, 0.5) for t in (-0.6, -0.4, 1.014, 1.016, 3.0, 5.5)] == [
        None, 0, 1, 2, None, 3,
    ]  # fmt: skip
    assert nearest([], 1.0) is None


@pytest.mark.parametrize("line", ["abc depth/1.png", "1.0", "nan depth/1.png"])
def test_a_damaged_list_is_named_with_its_line(tmp_path, line):
    files.write_tum(tmp_path / "data")
    with (tmp_path / "data/depth.txt").open("a") as stream:
        stream.write(line + "\n")
    with pytest.raises(PlanewiseError, match=r"depth.txt, line 6: expected a time and a name"):
        datasets.open(tmp_path / "data")


def test_poses_and_those_that_are_not_known(tmp_path):
    for kind in ("7-scenes", "scannet", "sens"):
        (tmp_path / kind).mkdir()
        dataset = opened(kind, tmp_path / kind)
        poses = [dataset[n].pose for n in range(COUNT)]
        assert_allclose(poses[0], POSES[0])
        assert_allclose(poses[2], POSES[2])
        assert (poses[1] is None) == (kind != "7-scenes")


@pytest.mark.parametrize("colour", [0, 1, 2])
@pytest.mark.parametrize("depth", [0, 1])
def test_all_compressions_of_recordings(tmp_path, colour, depth):
    path = files.write_sens(tmp_path / "scene.sens", colour, depth)
    dataset = datasets.open(path)
    assert dataset.ids == ("000000", "000001", "000002")
    seen = dataset[2]
    assert_array_equal(seen.depth, files.units(FRAMES[2], 0.001))
    assert seen.timestamp == 0.0665
    assert seen.depth_scale == 0.001
    assert (seen.camera.width, seen.camera.height) == (64, 48)
    assert dataset.sensor == pw.sensors.STRUCTURE
    if colour < 2:
        assert_array_equal(seen.rgb, FRAMES[2]["rgb"])


def test_a_scene_folder_opens_as_its_recording(tmp_path):
    files.write_sens(tmp_path / "scene0000_00.sens")
    (tmp_path / "scene0000_00.txt").write_text("axisAlignment = 1 0 0\n")
    assert datasets.open(tmp_path).kind == "sens"


@pytest.mark.parametrize("rows", [3, 4])
def test_the_layout_of_scannets_25k_frames(tmp_path, rows):
    dataset = opened("scannet", tmp_path)
    root = tmp_path / "data"
    shutil.rmtree(root / "intrinsic")
    files.matrix(root / "intrinsics_depth.txt", files.intrinsics()[:rows, :rows])
    files.matrix(root / "intrinsics_color.txt", files.intrinsics()[:rows, :rows])
    again = datasets.open(root)
    assert again.kind == "scannet"
    assert again[0].camera == CAMERA
    assert again.ids == dataset.ids
    (root / "intrinsics_depth.txt").write_text("1 2 3 4")
    with pytest.raises(PlanewiseError, match=r"depth.txt must hold 4 x 4 or 3 x 3 numbers"):
        datasets.open(root)


def test_a_line_twice_and_names_that_differ_in_their_ending_cost_nothing(tmp_path, caplog):
    dataset = opened("tum", tmp_path)
    path = tmp_path / "data/depth.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, lines[-1]]))
    assert datasets.open(tmp_path / "data").ids == dataset.ids
    assert "1 depth image listed again" in caplog.text
    (tmp_path / "scan").mkdir()
    files.write_scannet(tmp_path / "scan")
    np.save(tmp_path / "scan/depth/0.npy", files.units(FRAMES[0], 0.001))
    scan = datasets.open(tmp_path / "scan")
    assert scan.ids == ("0.npy", "0.png", "1.png", "2.png")
    assert_allclose(scan["2.png"].pose, POSES[2])
    assert all(each.rgb is not None for each in scan)
    assert_array_equal(scan["0.npy"].depth, scan["0.png"].depth)


def test_redwood_pairs_by_number_where_names_differ(tmp_path):
    dataset = opened("redwood", tmp_path)
    assert dataset.ids[1] == "0000002-000000033333"
    assert dataset[1].timestamp == pytest.approx(0.033333)
    (tmp_path / "data/image/0000003-000000066675.jpg").unlink()
    fewer = datasets.open(tmp_path / "data")
    assert [each.rgb is None for each in fewer] == [False, False, True]
    assert fewer.pictured == fewer.ids[:2]
    for each, kept in zip(fewer, dataset[:2], strict=False):
        assert_array_equal(each.rgb, kept.rgb)


@pytest.mark.parametrize(
    ("depth", "rgb", "pairs"),
    [
        ("1-0 3-9 4-13", "1-0 2-5 3-9 4-14", {1: 1, 3: 3, 4: 4}),  # Redwood, the first by its name
        ("0001 0003 0005", "0002 0004 0006", {}),
        ("d1 d3 d4", "c1 c2 c3", {1: 1, 3: 3}),
        ("0 1 2", "000 001 002", {0: 0, 1: 1, 2: 2}),
        ("a_1 b_2", "a_2 b_1", {}),  # of two sequences
        ("1-1 1-2 2-1", "1-5 1-6 2-5", {2: 2}),
    ],
)
def test_pictures_are_paired_by_name_or_number_and_never_by_position(
    tmp_path, caplog, depth, rgb, pairs
):
    def number(name):
        return int(re.search(r"\d+", name)[0])

    for name in depth.split():
        files.png(tmp_path / f"depth/{name}.png", np.ones((4, 5), np.uint16))
    for name in rgb.split():
        files.png(tmp_path / f"rgb/{name}.png", np.full((4, 5, 3), number(name), np.uint8))
    (tmp_path / "camera.json").write_text('{"fx": 5, "fy": 5, "cx": 2, "cy": 2, "depth_scale": 1}')
    dataset = datasets.open(tmp_path)
    found = {number(each.id): each.rgb[0, 0, 0] for each in dataset if each.rgb is not None}
    assert found == pairs
    alone = len(dataset) - len(pairs)
    assert len(dataset.pictured) == len(pairs)
    assert (f"{alone} of {len(dataset)} frames have no picture" in caplog.text) == (alone > 0)


def test_any_folder_with_a_camera(tmp_path):
    root = files.write_generic(
        tmp_path / "data", width=64, height=48, sensor="kinect-v1", distortion=[0.1, 0, 0, 0]
    )
    dataset = datasets.open(root)
    assert dataset.sensor == pw.sensors.KINECT_V1
    assert dataset.ids == ("view 0", "view 1", "view 2")
    assert dataset[0].camera.distortion == (0.1, 0, 0, 0)
    assert (dataset[0].camera.width, dataset[0].depth_scale) == (64, 0.0005)
    other = datasets.open(root, camera=CAMERA, depth_scale=0.001)
    assert other[0].camera == CAMERA
    assert other[0].depth_scale == 0.001


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"depth_scale": 0}, r"^camera.json: depth_scale must be a positive number"),
        ({"depth_scale": "1mm"}, "depth_scale must be a positive number"),
        ({"sensor": "kinect-v9"}, "sensor: "),
        ({"sensor": 3}, "must name one of kinect"),
        ({"sensor": ["kinect"]}, "must name one of kinect"),
        ({"sensor": "/etc/passwd"}, "must name one of kinect.*got '/etc/passwd'"),
        ({"fx": None}, "states no intrinsics"),
    ],
)
def test_what_a_camera_file_must_say(tmp_path, more, message):
    with pytest.raises(PlanewiseError, match=message):
        datasets.open(files.write_generic(tmp_path / "data", **more))


@pytest.mark.parametrize(("write", "name"), [("tum", "depth.txt"), ("generic", "camera.json")])
def test_a_mark_that_editors_put_before_a_text_is_passed_over(tmp_path, write, name):
    root = getattr(files, f"write_{write}")(tmp_path / "data")
    plain = datasets.open(root)
    (root / name).write_bytes(b"\xef\xbb\xbf" + (root / name).read_bytes())
    marked = datasets.open(root)
    assert marked.ids == plain.ids
    assert marked[0].camera == plain[0].camera


def test_integer_depth_without_unit_is_refused_with_the_frame(tmp_path):
    dataset = datasets.open(files.write_generic(tmp_path / "data", depth_scale=None))
    with pytest.raises(PlanewiseError, match=r"frame view 0: .*give depth_scale.* --depth-scale"):
        dataset[0]


def test_depth_in_metres_needs_no_unit(tmp_path):
    root = files.write_generic(tmp_path / "data", depth_scale=None)
    for n in range(COUNT):
        (root / f"depth/view {n}.png").unlink()
        np.save(root / f"depth/{n}.npy", FRAMES[n]["raw"].astype(np.float32))
    for scale in (None, 1):
        seen = datasets.open(root, depth_scale=scale)[2]
        assert seen.depth_scale is None
        assert_allclose(seen.depth, FRAMES[2]["raw"], rtol=1e-6)
    with pytest.raises(PlanewiseError, match="frame 2: depth_scale is for integer depth; floating"):
        datasets.open(root, depth_scale=0.001)[2]


def test_the_rendered_distances_become_depth(tmp_path):
    root = files.write_icl_rendered(tmp_path / "data")
    with pytest.raises(PlanewiseError, match=r"frame scene_00_0000: .* expected 307,200"):
        datasets.open(root)[0]  # the real ones are 640 x 480
    with pytest.raises(PlanewiseError, match="width and height must be given"):
        datasets.open(root, camera=CAMERA)


def test_distances_of_hypersim_are_those_of_a_radial_camera(tmp_path):
    root = files.write_hypersim(tmp_path / "ai_001_001")
    dataset = datasets.open(root)
    assert dataset.ids == ("cam_00.0000", "cam_00.0001", "cam_01.0000")
    seen = dataset["cam_01.0000"]
    assert seen.camera == hypersim.CAMERA
    assert seen.camera.radial
    half = 0.5 * seen.camera.width / seen.camera.fx
    assert np.degrees(2 * np.arctan(half)) == pytest.approx(60, abs=0.01)
    assert seen.depth[0, 0] == 0  # NaN in the file
    assert datasets.open(root, camera=SIZED)[0].camera == replace(SIZED, radial=True)
    shutil.rmtree(root / "images/scene_cam_01_final_preview")
    assert datasets.open(root)[2].rgb is None
    for path in root.rglob("*.depth_meters.hdf5"):
        path.unlink()
    with pytest.raises(PlanewiseError, match=r"holds no frame.0000.depth_meters.hdf5"):
        datasets.open(root)


def test_raw_readings_of_either_order_of_bytes(tmp_path):
    for name, order in (("little", "<"), ("big", ">")):
        dataset = datasets.open(files.write_nyu_raw(tmp_path / name, order), camera=CAMERA)
        assert_array_equal(dataset[0].depth, files.raw_metres(FRAMES[0]))
        assert dataset[0].timestamp == pytest.approx(1315330262.204702)
    assert_allclose(
        files.raw_metres(FRAMES[0]), FRAMES[0]["raw"], atol=0.012
    )  # of steps of 11 bits
    assert datasets.NyuRaw(tmp_path / "big").camera.fx == pytest.approx(582.62, abs=0.01)


def test_sweeps_of_points(tmp_path):
    root = files.write_kitti(tmp_path / "00")
    for path in (root, root / "velodyne"):
        dataset = datasets.open(path)
        assert dataset.kind == "lidar"
        assert dataset.ids == ("000000", "000001", "000002")
        for n, seen in enumerate(dataset):
            assert_array_equal(seen.points, files.sweep(n)[:, :3])
            assert_array_equal(seen.intensity, files.sweep(n)[:, 3])
    assert datasets.open(root)[1].timestamp == pytest.approx(0.1036224)
    again = pickle.loads(pickle.dumps(datasets.open(root)[1:]))
    assert_array_equal(again[0].points, files.sweep(1)[:, :3])
    wide = datasets.open(root, columns=5)
    with pytest.raises(PlanewiseError, match=r"frame 000001: .* no multiple of 20"):
        wide["000001"]


def test_sweeps_of_nuscenes_have_five_columns(tmp_path):
    path = tmp_path / "samples/LIDAR_TOP/n015__LIDAR_TOP__1532402927647951.pcd.bin"
    path.parent.mkdir(parents=True)
    rows = np.random.default_rng(0).normal(size=(100, 5)).astype("<f4")
    rows.tofile(path)
    seen = datasets.open(tmp_path)[0]
    assert_array_equal(seen.points, rows[:, :3])
    assert_array_equal(seen.intensity, rows[:, 3])
    assert len(datasets.open(path.parent, columns=4)[0].points) == 125


def test_times_of_raw_drives_are_dates(tmp_path):
    place = tmp_path / "drive/velodyne_points/data"
    place.mkdir(parents=True)
    for n in range(2):
        files.sweep(n).tofile(place / f"{n:010d}.bin")
    stamps = "2011-09-26 13:02:25.951199337\n2011-09-26 13:02:26.055061\n"
    (tmp_path / "drive/velodyne_points/timestamps.txt").write_text(stamps)
    first, second = datasets.open(tmp_path / "drive")
    assert first.timestamp == pytest.approx(1317042145.951199, abs=1e-5)
    assert second.timestamp - first.timestamp == pytest.approx(0.103862, abs=1e-5)


def test_a_frame_of_a_collection_is_found_without_a_look_at_all_parts(tmp_path):
    """There may be thousands of them, with hundred frames each."""

    class Parts(dict):
        looks = 0

        def items(self):
            self.looks += 1
            return super().items()

    part = datasets.open(files.write_generic(tmp_path / "a"))
    both = Collection("both", {"a": part, "b": part, "c": "is damaged"})
    both.parts = Parts(both.parts)
    assert all(each in both for each in both.ids)
    assert "a" not in both
    with pytest.raises(PlanewiseError, match="both, frame c: is damaged"):
        both["c"]
    assert both.parts.looks == 0


def test_many_sequences_are_one_collection(tmp_path):
    files.write_seven_scenes(tmp_path / "chess/seq-01")
    files.write_seven_scenes(tmp_path / "chess/seq-02")
    files.write_seven_scenes(tmp_path / "fire/seq-01")
    (tmp_path / "fire/TrainSplit.txt").write_text("sequence1\n")
    dataset = datasets.open(tmp_path, camera=SIZED)
    assert dataset.kind == "collection"
    assert len(dataset) == 3 * COUNT
    assert dataset.ids[3] == "chess--seq-02--frame-000000"
    assert dataset.sensor == pw.sensors.KINECT_V1
    assert dataset[3].id == dataset.ids[3]
    assert dataset[3].camera == SIZED
    assert dataset.without_pictures()[3].rgb is None
    assert_array_equal(pickle.loads(pickle.dumps(dataset[3:]))[0].depth, dataset[3].depth)


def test_files_of_other_things_are_no_datasets(tmp_path):
    """Maps and features lie beside sequences, in formats that hold anything."""
    import sqlite3

    import h5py

    files.write_generic(tmp_path / "a")
    with sqlite3.connect(tmp_path / "rtabmap.db") as database:
        database.execute("CREATE TABLE Node (id INTEGER)")
    database.close()
    with h5py.File(tmp_path / "features.h5", "w") as file:
        file["keypoints"] = np.zeros((3, 2))
    assert datasets.open(tmp_path).ids == tuple(f"a--view {n}" for n in range(COUNT))


def test_a_part_that_cannot_be_opened_is_one_frame_that_cannot_be_read(tmp_path):
    files.write_sens(tmp_path / "a.sens")
    files.write_sens(tmp_path / "b.sens")
    (tmp_path / "a.sens").write_bytes((tmp_path / "a.sens").read_bytes()[:100])
    dataset = datasets.open(tmp_path)
    assert dataset.ids == ("a.sens", *(f"b.sens--{n:06d}" for n in range(COUNT)))
    with pytest.raises(PlanewiseError, match=r"frame a.sens: .*a.sens is cut short"):
        dataset[0]
    assert len(list(dataset.readable(lambda frame, error: None))) == COUNT


def test_a_part_without_its_camera_is_not_left_out(run, tmp_path):
    for name in "abc":
        files.write_generic(tmp_path / name)
    (tmp_path / "b" / "camera.json").unlink()
    (tmp_path / "notes").mkdir()
    dataset = datasets.open(tmp_path)
    assert list(dataset.parts) == ["a", "b", "c"]
    with pytest.raises(PlanewiseError, match=r"frame b: .*nothing states its camera"):
        dataset["b"]
    code, out, err = run(tmp_path, "--check")
    assert (code, err.count("\n")) == (2, 1)
    assert f"{2 * COUNT} of {2 * COUNT + 1} frames can be read" in out


def test_a_frame_of_another_size_than_its_camera_is_damaged(run, tmp_path):
    root = files.write_generic(tmp_path / "data", width=64, height=48)
    depth = np.full((24, 64), 1000, np.uint16)
    Image.fromarray(depth).save(root / "depth/view 2.png")
    code, out, err = run(root, "--check")
    assert (code, err.count("\n")) == (2, 1)
    assert "error: data, frame view 2: camera is for images of" in err
    assert "2 of 3 frames can be read" in out


def test_points_and_depth_are_not_mixed(tmp_path):
    files.write_kitti(tmp_path / "points")
    files.write_sens(tmp_path / "scene.sens")
    (tmp_path / "more").mkdir()
    files.write_sens(tmp_path / "more/scene.sens")
    (tmp_path / "scene.sens").unlink()
    with pytest.raises(PlanewiseError, match="holds both depth images and points"):
        datasets.open(tmp_path)
    files.write_kitti(tmp_path / "drives/0")
    files.write_kitti(tmp_path / "drives/1")
    assert datasets.open(tmp_path / "drives").ids[-1] == "1--000002"
    assert len(datasets.open(tmp_path / "drives")[-1].points) == 102


def test_what_is_not_recognised_is_listed(tmp_path):
    (tmp_path / "frames").mkdir()
    with pytest.raises(PlanewiseError, match=r"is an empty folder$"):
        datasets.open(tmp_path / "frames")
    (tmp_path / "frames/notes.txt").write_text("none")
    message = r"it holds notes.txt\) is no dataset of a known kind"
    with pytest.raises(PlanewiseError, match=message) as error:
        datasets.open(tmp_path / "frames")
    for reader in datasets.opening.READERS:
        assert f"{reader.kind} = {reader.holds}" in str(error.value)
    with pytest.raises(PlanewiseError, match="there is no file or folder"):
        datasets.open(tmp_path / "nothing")


def test_archives_have_to_be_unpacked(tmp_path):
    import shutil

    files.write_tum(tmp_path / "data")
    for form in ("zip", "gztar"):
        made = shutil.make_archive(str(tmp_path / "packed"), form, tmp_path / "data")
        with pytest.raises(PlanewiseError, match="is an archive; unpack it"):
            datasets.open(made)


def test_the_current_folder_and_a_single_image(tmp_path, monkeypatch):
    monkeypatch.chdir(files.write_seven_scenes(tmp_path / "seq-01"))
    assert datasets.open(".", camera=SIZED).name == "seq-01"
    with pytest.raises(PlanewiseError, match="is one depth image, no dataset"):
        datasets.open("frame-000001.depth.png")
    with pytest.raises(PlanewiseError, match="is one depth image, no dataset"):
        datasets.open(_archives(tmp_path / "cut") / "1.npz")


def test_kinds_and_options_that_are_none(tmp_path):
    root = files.write_tum(tmp_path / "data")
    with pytest.raises(PlanewiseError, match=r"kind must be one of .*7-scenes.*, got 'kinect'"):
        datasets.open(root, "kinect")
    with pytest.raises(ValueError, match="columns is no option of the kind 'tum'; it has camera"):
        datasets.open(root, columns=4)
    write_folder(tmp_path / "nyu", dict(enumerate(FRAMES)), kinds=("rgb", "depth"))
    with pytest.raises(PlanewiseError, match="no dataset of a known kind"):
        datasets.open(tmp_path / "nyu")  # whose camera is it?
    assert len(datasets.open(tmp_path / "nyu", "nyu", camera=CAMERA)) == COUNT


@pytest.mark.parametrize("name", datasets.opening.KINDS)
def test_what_is_not_of_the_kind_that_was_named_is_said(name, tmp_path):
    with pytest.raises(PlanewiseError) as error:
        datasets.open(tmp_path, name)
    start = f"data: {tmp_path} cannot be opened as the kind {name!r} ("
    assert str(error.value).startswith(start)
    assert "data:" not in str(error.value).removeprefix(start)


def test_detecting_planes_in_any_frame(tmp_path):
    seen = opened("sens", tmp_path)[0]
    model = pw.detect_planes(
        seen.depth, seen.camera, pw.sensors.KINECT_V1, depth_scale=seen.depth_scale
    )
    assert len(model) == 2


def test_sixteen_bit_colour_is_refused_as_depth_and_read_as_picture(tmp_path):
    root = files.write_generic(tmp_path / "data")
    Image.fromarray(FRAMES[0]["rgb"]).save(root / "depth/view 0.png")
    with pytest.raises(PlanewiseError, match=r"frame view 0: .*colour picture, not depth"):
        datasets.open(root)[0]


# The command


@pytest.fixture
def run(capfd):
    from typer.testing import CliRunner

    from planewise.commands.app import command_line

    def call(*arguments):
        result = CliRunner().invoke(command_line(), ["frames", *map(str, arguments)])
        out, err = capfd.readouterr()
        return result.exit_code, result.stdout + out, result.stderr + err

    return call


def test_the_command_says_what_is_there(run, tmp_path):
    root = files.write_tum(tmp_path / "data")
    code, out, _ = run(root)
    assert code == 0
    assert out.startswith("tum: a folder with depth.txt and rgb.txt")
    assert "3 frames: 1305031102.160407, " in out
    assert "camera: fx 525.0, fy 525.0, cx 319.5, cy 239.5" in out
    assert "sensor: kinect-v1" in out
    assert "first frame: 64 x 48, units of 0.2 mm, 99% with a reading, 1.82 ... 2.13 m" in out
    code, out, _ = run(files.write_kitti(tmp_path / "kitti"), "--check")
    assert (code, "first frame: 100 points" in out) == (0, True)
    assert "3 of 3 frames can be read" in out


def test_the_command_reports_damage(run, tmp_path):
    root = files.write_generic(tmp_path / "data")
    (root / "depth/view 1.png").write_bytes(b"\x89PNG")
    (root / "rgb/view 2.png").write_bytes(b"\x89PNG")
    code, out, err = run(root, "--check")
    assert code == 2
    assert "1 of 3 frames can be read" in out
    assert [line.split(":")[1].strip() for line in err.splitlines()] == [
        "data, frame view 1",
        "data, frame view 2",
    ]
    code, _, err = run(tmp_path / "data/rgb")
    assert (code, err.count("\n")) == (2, 1)
    code, out, err = run(root, "--camera", "nyu")
    assert code == 0
    assert "camera is for images of 640 x 480 pixels" in err


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere every name is text")
def test_the_command_reports_names_that_are_no_text(run, tmp_path):
    files.write_generic(tmp_path / "data")
    name = os.fsdecode(b"z\xff1.png")
    shutil.copy(tmp_path / "data/depth/view 1.png", tmp_path / "data/depth" / name)
    code, text, errors = run(tmp_path / "data", "--check")
    assert code == 2
    assert "3 of 4 frames can be read" in text
    assert "has a frame z\\xff1, which is not valid UTF-8; rename it" in errors.replace("\n", " ")


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere every name is text")
def test_a_name_that_the_locale_cannot_read_need_not_be_changed(tmp_path):
    depth = files.write_generic(tmp_path / "data") / "depth"
    (depth / "view 1.png").rename(depth / "für.png")
    code = """
import sys
from planewise.cli import main
sys.argv[0] = "planewise"
main()
"""
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = run_python(code, "frames", tmp_path / "data", "--check", check=False, **locale)
    assert done.returncode == 2
    assert "which cannot be read in this locale (ascii); set PYTHONUTF8=1" in done.stderr
    read = run_python(code, "frames", tmp_path / "data", "--check", PYTHONUTF8="1")
    assert "3 of 3 frames can be read" in read.stdout


def test_what_is_wrong_with_all_frames_is_said_of_a_few(run, tmp_path):
    root = files.write_generic(tmp_path / "data", width=7, height=7)
    for n in range(3, 30):
        shutil.copy(root / "depth/view 0.png", root / f"depth/view {n}.png")
    (root / "depth/view 8.png").write_bytes(b"\x89PNG")
    code, out, err = run(root, "--check")
    assert code == 2
    assert "0 of 30 frames can be read" in out
    *said, more = (line for line in err.splitlines() if line.startswith("error: "))
    numbers = [int(line.partition("frame view ")[2].partition(":")[0]) for line in said]
    assert numbers == [0, 1, 2, 8]
    assert "the same as of frame view 0 goes for 26 more frames: view 3, view 4, " in more


def test_a_damaged_first_frame_is_said_once(run, tmp_path):
    root = files.write_generic(tmp_path / "data")
    for path in (root / "depth").iterdir():
        path.write_bytes(b"\x89PNG")
    code, out, err = run(root, "--check")
    assert code == 2
    assert "0 of 3 frames can be read" in out
    assert err.count("\n") == 3
    assert "warning: data, frame" in run(root)[2]


def test_images_without_a_camera_are_told_what_they_lack(run, tmp_path):
    root = files.write_generic(tmp_path / "data")
    (root / "camera.json").unlink()
    for given in (root, root / "depth"):
        code, _, err = run(given)
        assert code == 2
        assert "nothing states its camera: put the images into a folder depth/" in err
        assert f"or give {root / 'depth'} to 'planewise detect'" in err
        assert err.count("\n") == 1


def test_the_command_knows_collections(run, tmp_path):
    files.write_sens(tmp_path / "a.sens")
    files.write_sens(tmp_path / "b.sens")
    code, out, _ = run(tmp_path, "--check")
    assert (code, "collection: 2 datasets" in out) == (0, True)
    assert "6 of 6 frames can be read" in out
