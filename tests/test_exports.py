from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from PIL import Image

import planewise as pw
from planewise import scenes
from planewise.batch import Store
from planewise.batch.label_png import png_of_labels
from planewise.batch.open_source import open_source
from planewise.batch.stored_source import StoredSource, metres
from planewise.errors import PlanewiseError
from planewise.exports import FORMATS, CocoExport, NpzExport, PngExport, export
from planewise.exports.planercnn import _colours, _scene_of, nearest_points
from planewise.files.coco_rle import decode_mask
from planewise.files.depth import DepthFile
from planewise.files.labels import read_labels
from tests import dataset_files
from tests.batch_sources import Renamed
from tests.command import run
from tests.stores import Sweeps, make_folder_store, make_store, write_frames

COUNT = 4
DONE = COUNT + 1  # and the frame without a reading


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exports")
    write_frames(folder / "frames", COUNT)
    make_folder_store(folder / "frames", folder / "png")
    make_folder_store(folder / "frames", folder / "rle", labels="rle")
    return folder


@pytest.fixture(params=["png", "rle"])
def store(made, request):
    return Store(made / request.param)


@pytest.fixture
def own(made, tmp_path):
    """A copy of the store that may be damaged."""
    shutil.copytree(made / "png", tmp_path / "store")
    return tmp_path / "store"


def all_of(store, form, output, **options):
    return [each for each in export(store, form, output, **options) if each.reason]


def test_coco_masks_are_those_of_the_labels(store, tmp_path):
    assert not all_of(store, CocoExport, tmp_path / "out")
    assert [each.name for each in (tmp_path / "out").iterdir()] == ["annotations.json"]
    coco = json.loads((tmp_path / "out" / "annotations.json").read_text())
    assert [each["frame"] for each in coco["images"]] == list(store.ids)
    assert len({each["id"] for each in coco["annotations"]}) == len(coco["annotations"])
    for image in coco["images"]:
        frame = store[image["frame"]]
        found = [each for each in coco["annotations"] if each["image_id"] == image["id"]]
        assert [each["plane"] for each in found] == frame.planes.tolist()
        for label, each in enumerate(found, start=1):
            mask = decode_mask(each["segmentation"]["counts"], frame.labels.shape)
            assert np.array_equal(mask, frame.labels == label)


class _Panoramas(Sweeps):
    def __getitem__(self, frame):
        room = scenes.panorama(2, camera=pw.SphericalCamera.panorama(128))
        return DepthFile(depth=room.depth, camera=room.camera)


@pytest.mark.parametrize("source", [Sweeps(), _Panoramas()])
def test_boxes_of_a_panorama_hold_their_masks(source, tmp_path):
    """Those across its seam, too, of which some have no pixel in the first column."""
    store = make_store(source, tmp_path / "store")
    assert not all_of(store, CocoExport, tmp_path / "out")
    found = json.loads((tmp_path / "out" / "annotations.json").read_text())["annotations"]
    height, width = store["sweep"].labels.shape
    assert (store["sweep"].plane_table["right"].to_numpy() > width).any()
    for each in found:
        rows, columns = decode_mask(each["segmentation"]["counts"], (height, width)).nonzero()
        left, top, wide, high = each["bbox"]
        assert (left, left + wide) == (columns.min(), columns.max() + 1)
        assert (top, top + high) == (rows.min(), rows.max() + 1)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning:pycocotools")
def test_the_coco_tools_read_it(store, tmp_path):
    from pycocotools import coco as tools
    from pycocotools import mask as masks

    assert not all_of(store, CocoExport, tmp_path / "out")
    coco = tools.COCO(tmp_path / "out" / "annotations.json")
    assert coco.loadCats(coco.getCatIds())[0]["name"] == "plane"
    seen = 0
    for image in coco.loadImgs(coco.getImgIds()):
        labels = store[image["frame"]].labels
        anns = coco.loadAnns(coco.getAnnIds(imgIds=image["id"], iscrowd=False))
        for label, each in enumerate(anns, start=1):
            assert np.array_equal(coco.annToMask(each), labels == label)
            assert masks.area(each["segmentation"]) == each["area"]
            assert masks.toBbox(each["segmentation"]).tolist() == each["bbox"]
            seen += 1
    assert seen >= COUNT


def test_both_kinds_of_store_give_the_same_coco(made, tmp_path):
    for kind in ("png", "rle"):
        assert not all_of(Store(made / kind), CocoExport, tmp_path / kind)
    texts = [(tmp_path / kind / "annotations.json").read_text() for kind in ("png", "rle")]
    assert texts[0] == texts[1]


def test_label_images_and_tables(store, tmp_path):
    assert not all_of(store, PngExport, tmp_path / "out")
    with (tmp_path / "out" / "frames.csv").open(newline="") as file:
        frames = list(csv.DictReader(file))
    with (tmp_path / "out" / "planes.csv").open(newline="") as file:
        planes = list(csv.DictReader(file))
    assert [each["frame"] for each in frames] == list(store.ids)
    for each in frames:
        frame = store[each["frame"]]
        with Image.open(tmp_path / "out" / each["labels"]) as image:
            assert image.mode.startswith("I;16")
            assert np.array_equal(np.asarray(image), frame.labels)
        rows = [row for row in planes if row["frame"] == each["frame"]]
        parameters = ("normal_x", "normal_y", "normal_z", "distance")
        found = np.array([[float(row[name]) for name in parameters] for row in rows])
        assert np.array_equal(found.reshape(-1, 4), frame.planes)


def test_tables_state_the_whole_camera_and_the_unit(tmp_path):
    distortion = [0.01, 0.002, 0.0, 0.001, 0.003]
    dataset_files.write_generic(tmp_path / "data", distortion=distortion)
    store = make_store(open_source(tmp_path / "data"), tmp_path / "store")
    assert not all_of(store, PngExport, tmp_path / "out")
    with (tmp_path / "out" / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3
    for row in rows:
        frame = store[row["frame"]].row
        assert json.loads(row["distortion"]) == frame["distortion"] == distortion
        assert float(row["depth_scale"]) == frame["depth_scale"] == 0.0005
        assert float(row["fx"]) == frame["fx"]


def test_archives_hold_labels_planes_and_camera(store, tmp_path):
    assert not all_of(store, NpzExport, tmp_path / "out")
    for frame in store:
        path = tmp_path / "out" / f"{frame.id.replace(' ', '%20')}.npz"
        with np.load(path) as arrays:  # nothing in it is pickled
            assert np.array_equal(arrays["labels"], frame.labels)
            assert np.array_equal(arrays["planes"], frame.planes)
            assert arrays["covariance"].shape == (len(frame.planes), 4, 4)
            assert arrays["K"].tolist() == [frame.row[k] for k in ("fx", "fy", "cx", "cy")]
            assert str(arrays["frame"]) == frame.id
        read = read_labels(path)
        assert np.array_equal(read.planes, frame.planes)


def test_a_covariance_that_is_not_known_is_nan(made, tmp_path):
    store = Store(made / "png")
    frame = store["room 0"]
    table = frame.plane_table
    at, kind = table.schema.get_field_index("covariance"), table.schema.field("covariance")
    table = table.set_column(at, kind, pa.nulls(len(table), kind.type))
    NpzExport(tmp_path, store, store.ids).add(replace(frame, plane_table=table), None)
    with np.load(tmp_path / "room%200.npz") as arrays:
        assert arrays["covariance"].shape == (len(table), 4, 4)
        assert np.isnan(arrays["covariance"]).all()


@pytest.mark.parametrize("time", [None, 0.0, 2.5])
def test_archives_state_a_time_that_is_known(made, tmp_path, time):
    store = Store(made / "png")
    frame = store["room 0"]
    form = NpzExport(tmp_path, store, store.ids)
    form.add(replace(frame, row={**frame.row, "timestamp": time}), None)
    with np.load(tmp_path / "room%200.npz") as arrays:
        assert arrays.get("timestamp") == time


def _as_the_training_reads(scene, index):
    """Labels, planes and depth of a frame, by the equations of PlaneRCNN's loader."""
    lines = (scene / f"{scene.name}.txt").read_text().splitlines()
    info = {line.split(" ")[0]: float(line.split(" ")[2]) for line in lines}
    pose = np.loadtxt(scene / f"frames/pose/{index}.txt")
    with Image.open(scene / f"annotation/segmentation/{index}.png") as image:
        red, green, blue = np.moveaxis(np.asarray(image).astype(int), 2, 0)
    with Image.open(scene / f"frames/depth/{index}.png") as image:
        depth = np.asarray(image) / 1000
    with Image.open(scene / f"frames/color/{index}.jpg") as image:
        colour = image.size
    points = np.load(scene / "annotation/planes.npy")
    number = (red * 65536 + green * 256 + blue) // 100 - 1
    # World to camera, of each plane's nearest point and of a second point on its normal.
    to_camera = np.linalg.inv(pose)
    there = points @ to_camera[:3, :3].T + to_camera[:3, 3]
    normal = (points / np.linalg.norm(points, axis=1, keepdims=True)) @ to_camera[:3, :3].T
    planes = np.column_stack([normal, -(there * normal).sum(axis=1)])
    return info, number, planes, depth, colour


def test_scenes_as_planercnn_reads_them(made, tmp_path):
    store = Store(made / "png")
    source = StoredSource(store)
    assert not all_of(store, FORMATS["planercnn"], tmp_path / "out", source=source)
    out = tmp_path / "out"
    (name,) = (out / "scenes.txt").read_text().split()
    scene = out / "scans" / name
    with (out / "frames.csv").open(newline="") as file:
        frames = list(csv.DictReader(file))
    assert [each["frame"] for each in frames] == list(store.ids)
    info = np.load(scene / "annotation/plane_info.npy", allow_pickle=True)
    seen = 0
    for each in frames:
        frame = store[each["frame"]]
        about, number, planes, depth, colour = _as_the_training_reads(scene, each["index"])
        assert colour == (about["depthWidth"], about["depthHeight"]) == depth.shape[::-1]
        assert about["numDepthFrames"] == DONE
        assert about["fx_depth"] == frame.row["fx"]
        truth = np.nan_to_num(metres(frame, source[frame]))
        assert np.abs(depth - truth).max() <= 0.0005 + 1e-9
        assert np.array_equal(number >= 0, frame.labels > 0)
        for label, plane in enumerate(frame.planes, start=1):
            of_it = np.unique(number[frame.labels == label])
            assert of_it.size == 1
            read = planes[of_it[0]]
            # Their planes are signed by their point: normal and distance flip together.
            assert np.allclose(read * np.sign(read @ plane), plane, atol=1e-7)
            assert info[of_it[0]] + [7] == [(of_it[0], 41, 41), 7]  # lists, to which is added
            seen += 1
    assert seen == len(info) == len(planes)


def test_colours_number_all_planes_of_a_scene():
    """As its reader has it: (red 65536 + green 256 + blue) / 100 - 1, black is none."""
    colours = _colours(np.array([[0, 1, 60]], np.uint16), 100_000)
    number = colours.astype(int) @ (65536, 256, 1)
    assert number.tolist() == [[0, 100 * 100_001, 100 * 100_060]]


def test_planes_in_the_world_come_back_by_the_pose():
    rng = np.random.default_rng(3)
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned * np.linalg.det(turned), (0.4, -2.0, 1.3)
    normals = rng.normal(size=(6, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    planes = np.column_stack([normals, rng.uniform(0.5, 3, 6)])
    points = nearest_points(planes, pose)
    back = (points - pose[:3, 3]) @ pose[:3, :3]  # R' (x - t): in the camera's frame
    assert np.allclose((back * normals).sum(axis=1) + planes[:, 3], 0)
    on_plane = -planes[:, 3:] * normals + np.cross(normals, (1.0, 0, 0))
    in_world = on_plane @ pose[:3, :3].T + pose[:3, 3]
    assert ((in_world**2).sum(axis=1) >= (points**2).sum(axis=1) - 1e-9).all()


def test_scans_with_poses_go_into_one_world(tmp_path, caplog):
    for name in ("scene0000_00", "scene0001_00"):
        dataset_files.write_scannet(tmp_path / "scans" / name)
    store = make_store(open_source(tmp_path / "scans"), tmp_path / "store")
    source = StoredSource(store)
    assert not all_of(store, FORMATS["planercnn"], tmp_path / "out", source=source)
    assert len(caplog.messages) == 2
    assert caplog.messages[0].startswith("scene scene0000_00: the poses of 1 of 3 frames are not")
    seen = 0
    for name in ("scene0000_00", "scene0001_00"):
        scene = tmp_path / "out" / "scans" / name
        posed = np.loadtxt(scene / "frames/pose/2.txt")
        assert np.allclose(posed, dataset_files.POSES[2])
        assert np.array_equal(np.loadtxt(scene / "frames/pose/1.txt"), np.eye(4))  # it was lost
        for index, frame in enumerate(each for each in store if each.id.startswith(name)):
            _, number, planes, _, _ = _as_the_training_reads(scene, index)
            for label, plane in enumerate(frame.planes, start=1):
                (of_it,) = np.unique(number[frame.labels == label])
                read = planes[of_it]
                assert np.allclose(read * np.sign(read @ plane), plane, atol=1e-6)
                seen += 1
    assert seen >= 4


@pytest.mark.parametrize("posed", [False, True])
def test_scenes_without_poses_are_told(tmp_path, caplog, posed):
    write = dataset_files.write_scannet if posed else dataset_files.write_generic
    write(tmp_path / "data")
    store = make_store(open_source(tmp_path / "data"), tmp_path / "store")
    all_of(store, FORMATS["planercnn"], tmp_path / "out", source=StoredSource(store))
    told = [each for each in caplog.messages if each.startswith("no pose is known of 1 scene: all")]
    assert len(told) == (not posed)


@pytest.mark.parametrize("bent", [0.0, 0.1])
def test_distortion_that_scenes_cannot_state_is_told(tmp_path, caplog, bent):
    dataset_files.write_generic(tmp_path / "data", distortion=[bent, 0, 0, 0])
    store = make_store(open_source(tmp_path / "data"), tmp_path / "store")
    all_of(store, FORMATS["planercnn"], tmp_path / "out", source=StoredSource(store))
    told = [each for each in caplog.messages if "lens of 3 frames has a distortion" in each]
    assert len(told) == bool(bent)


@pytest.mark.parametrize("kind", ["7_scenes", "generic"])
def test_pictures_of_a_camera_beside_the_depth_camera_are_told(tmp_path, caplog, kind):
    write = {"7_scenes": dataset_files.write_seven_scenes, "generic": dataset_files.write_generic}
    write[kind](tmp_path / "data")
    opened = open_source(tmp_path / "data", camera=dataset_files.CAMERA)
    store = make_store(opened, tmp_path / "store")
    for form, options in (("planercnn", {}), ("coco", {}), ("coco", {"pictures": True})):
        caplog.clear()
        source = StoredSource(store)
        output = tmp_path / f"{form}{len(options)}"
        assert not all_of(store, FORMATS[form], output, source=source, **options)
        assert not any("are not known" in each for each in caplog.messages)
        warned = any("of a camera beside" in each for each in caplog.messages)
        assert warned == (kind == "7_scenes" and (form == "planercnn" or "pictures" in options))


def test_long_scenes_are_cut(made, tmp_path, monkeypatch):
    monkeypatch.setattr("planewise.exports.planercnn._FRAMES_A_SCENE", 2)
    store = Store(made / "png")
    source = StoredSource(store)
    assert not all_of(store, FORMATS["planercnn"], tmp_path / "out", source=source)
    scenes = (tmp_path / "out" / "scenes.txt").read_text().split()
    assert scenes == ["frames", "frames%part1", "frames%part2"]
    for name in scenes:
        scene = tmp_path / "out" / "scans" / name
        indices = sorted(int(path.stem) for path in scene.rglob("*.jpg"))
        assert indices == list(range(len(indices)))
        number = _as_the_training_reads(scene, indices[-1])[1]
        assert number.max() == len(np.load(scene / "annotation/planes.npy")) - 1


def test_a_scene_has_one_camera(made, tmp_path):
    store = Store(made / "png")
    source, (one, other) = StoredSource(store), (store["room 0"], store["room 1"])
    form = FORMATS["planercnn"](tmp_path, store, store.ids)
    form.add(one, source[one])
    moved = replace(other, row={**other.row, "cx": other.row["cx"] + 1})
    with pytest.raises(PlanewiseError, match="frame room 1: it has another camera than its scene"):
        form.add(moved, source[other])
    with pytest.raises(PlanewiseError, match=r"room 1: .* or a picture of another size"):
        form.add(other, replace(source[other], rgb=np.zeros((120, 160, 3), np.uint8)))
    form.add(other, source[other])
    form.close()


def test_a_scene_states_its_camera_and_depth_in_millimetres(made, tmp_path, monkeypatch):
    store = Store(made / "png")
    frame = store["room 0"]
    camera = {"fx": 101.0, "fy": 102.0, "cx": 31.0, "cy": 22.5}
    frame = replace(frame, row={**frame.row, **camera})
    depth = np.ones(frame.labels.shape)
    depth[0, :5] = 1.2344, 1.2346, 65.535, 70.0, np.nan
    monkeypatch.setattr("planewise.exports.planercnn.metres", lambda *_: depth)
    form = FORMATS["planercnn"](tmp_path, store, ["room 0"])
    seen = StoredSource(store)[frame]
    form.add(frame, replace(seen, rgb=np.zeros((120, 200, 3), np.uint8)))
    form.close()
    with Image.open(tmp_path / "scans/frames/frames/depth/0.png") as image:
        assert np.asarray(image)[0, :5].tolist() == [1234, 1235, 65_535, 0, 0]
    lines = (tmp_path / "scans/frames/frames.txt").read_text().splitlines()
    height, width = depth.shape
    assert dict(line.split(" = ") for line in lines) == {
        "fx_depth": "101.0", "fy_depth": "102.0", "mx_depth": "31.0", "my_depth": "22.5",
        "colorWidth": "200", "colorHeight": "120", "numColorFrames": "1",
        "depthWidth": str(width), "depthHeight": str(height), "numDepthFrames": "1",
    }  # fmt: skip


def test_a_scene_has_no_more_planes_than_colours(made, tmp_path, monkeypatch):
    store = Store(made / "png")
    counts = [len(store[each].planes) for each in store.ids]
    monkeypatch.setattr("planewise.exports.planercnn._MOST_PLANES", sum(counts) - 1)
    left_out = all_of(store, FORMATS["planercnn"], tmp_path / "out", source=StoredSource(store))
    last = max(k for k, count in enumerate(counts) if count)
    assert [each.frame for each in left_out] == [store.ids[last]]
    assert left_out[0].reason.endswith("its scene has too many planes")
    planes = np.load(tmp_path / "out/scans/frames/annotation/planes.npy")
    assert len(planes) == sum(counts) - counts[last]


def test_frames_of_a_scene_may_come_in_any_order(made, tmp_path):
    store = Store(made / "png")
    source = StoredSource(store)
    form = FORMATS["planercnn"](tmp_path, store, store.ids)
    for each in reversed(store.ids):
        if each == "room 1":
            form.left_out(store[each])
        else:
            form.add(store[each], source[store[each]])
    form.finish()
    form.close()
    with (tmp_path / "frames.csv").open(newline="") as file:
        frames = list(csv.DictReader(file))
    assert [each["frame"] for each in frames] == [each for each in store.ids if each != "room 1"]
    for each in frames:
        frame = store[each["frame"]]
        _, number, _, _, _ = _as_the_training_reads(tmp_path / "scans/frames", each["index"])
        assert np.array_equal(number >= 0, frame.labels > 0)


@pytest.mark.parametrize(
    ("frame", "scene"),
    [
        ("a--b/c", "a"),
        ("a/b/c", "a%2Fb"),
        ("a", "whole"),
        ("two words--c", "two%20words"),
        ("color.jpg--c", "%63olor%2Ejpg"),  # what its reader replaces in paths
    ],
)
def test_a_scene_is_the_folder_of_its_frames(frame, scene):
    assert _scene_of(frame, "whole") == scene


def test_scenes_follow_the_parts_of_a_collection(made, tmp_path, monkeypatch):
    ids = ("flat one--a", "flat one--b", "flat_one--a", "yard--..")
    source = Renamed(made / "frames", ["damaged", "no reading", *ids])
    store = make_store(source, tmp_path / "store")
    monkeypatch.setattr("planewise.batch.stored_source._open", lambda *_: source)
    reads = StoredSource(store, made)
    assert not all_of(store, FORMATS["planercnn"], tmp_path / "out", source=reads)
    scenes = (tmp_path / "out" / "scenes.txt").read_text().split()
    assert scenes == ["flat%20one", "flat_one", "renamed", "yard"]
    counts = [len(list((tmp_path / "out/scans" / each).rglob("*.jpg"))) for each in scenes]
    assert counts == [2, 1, 1, 1]


@pytest.mark.parametrize("form", ["coco", "png", "npz"])
def test_ids_lead_nowhere_else(made, tmp_path, form):
    ids = ["../../up", "/etc/x", "a/../b", ".hidden", "\n"]
    store = make_store(Renamed(made / "frames", ids), tmp_path / "store")
    before = set(tmp_path.rglob("*"))
    assert not all_of(store, FORMATS[form], tmp_path / "out")
    new = set(tmp_path.rglob("*")) - before
    assert all((tmp_path / "out") in (each, *each.parents) for each in new)
    assert not [each for each in new if each.name.startswith(".")]


def test_a_camera_that_is_no_pinhole_is_told_in_words(tmp_path, monkeypatch):
    store = make_store(Sweeps(), tmp_path / "store")
    words = json.loads(store["sweep"].row["camera"])
    for form in ("coco", "png", "npz"):
        assert not all_of(store, FORMATS[form], tmp_path / form)
    coco = json.loads((tmp_path / "coco" / "annotations.json").read_text())
    assert coco["images"][0]["camera"] == words
    with np.load(tmp_path / "npz" / "sweep.npz") as arrays:
        assert json.loads(str(arrays["camera"])) == words
        assert "K" not in arrays
    monkeypatch.setattr("planewise.batch.stored_source._open", lambda *_: Sweeps())
    reads = StoredSource(store)
    with pytest.raises(PlanewiseError, match="no picture"):
        all_of(store, FORMATS["planercnn"], tmp_path / "scenes", source=reads)


def test_pictures_go_with_coco_and_nothing_else(made, tmp_path):
    code, text, _ = run("export", made / "png", "--format", "coco", "--pictures", "-o",
                        tmp_path / "out")  # fmt: skip
    assert (code, text) == (0, f"{DONE} of {DONE} frames in {tmp_path}/out ")
    coco = json.loads((tmp_path / "out" / "annotations.json").read_text())
    for image in coco["images"]:
        with Image.open(tmp_path / "out" / image["file_name"]) as picture:
            assert picture.size == (image["width"], image["height"])
    code, _, errors = run("export", made / "png", "--format", "png", "--pictures", "-o",
                          tmp_path / "b")  # fmt: skip
    assert code == 2
    assert "a choice of the format coco alone" in errors


def test_a_damaged_label_file_costs_its_frame_only(own, tmp_path):
    file = Store(own).label_file("room 1")
    file.write_bytes(file.read_bytes()[:-40])
    for form in ("coco", "png", "npz", "planercnn"):
        code, text, errors = run("export", own, "--format", form, "-o", tmp_path / form)
        assert code == 2
        assert f"{DONE - 1} of {DONE} frames in {tmp_path / form}" in text
        assert "error: store: frame room 1:" in errors
    coco = json.loads((tmp_path / "coco" / "annotations.json").read_text())
    assert "room 1" not in [each["frame"] for each in coco["images"]]
    scene = tmp_path / "planercnn/scans/frames"
    assert (scene / "annotation/planes.npy").exists()


def test_where_nothing_can_be_exported_the_first_reason_is_told(own, tmp_path):
    store = Store(own)
    for each in store.ids:
        store.label_file(each).write_bytes(b"")
    with pytest.raises(PlanewiseError, match=f"the first: store: frame {store.ids[0]}:"):
        all_of(store, PngExport, tmp_path / "out")


def test_a_plane_without_a_pixel_has_no_mask(own, tmp_path):
    store = Store(own)
    frame = store["room 0"]
    labels = np.where(frame.labels == 1, 0, frame.labels)
    store.label_file("room 0").write_bytes(png_of_labels(labels))
    assert not all_of(store, CocoExport, tmp_path / "out")
    coco = json.loads((tmp_path / "out" / "annotations.json").read_text())
    (image,) = (each["id"] for each in coco["images"] if each["frame"] == "room 0")
    found = [each for each in coco["annotations"] if each["image_id"] == image]
    assert [each["plane"] for each in found] == frame.planes[1:].tolist()
    assert [each["area"] for each in found] == np.bincount(labels.ravel())[2:].tolist()


def test_what_is_left_out_of_a_scene_leaves_no_gap(own, tmp_path):
    store = Store(own)
    file = store.label_file("room 1")
    file.write_bytes(file.read_bytes()[:-40])
    source = StoredSource(store)
    (left_out,) = all_of(store, FORMATS["planercnn"], tmp_path / "out", source=source)
    assert left_out.frame == "room 1"
    scene = tmp_path / "out/scans/frames"
    for folder in ("frames/color", "frames/depth", "frames/pose", "annotation/segmentation"):
        indices = sorted(int(path.stem) for path in (scene / folder).iterdir())
        assert indices == list(range(DONE - 1))
    with (tmp_path / "out" / "frames.csv").open(newline="") as file:
        frames = list(csv.DictReader(file))
    assert [each["index"] for each in frames] == [str(k) for k in range(DONE - 1)]
    assert [each["frame"] for each in frames] == [each for each in store.ids if each != "room 1"]
    for each in frames:
        frame = store[each["frame"]]
        about, number, _, depth, _ = _as_the_training_reads(scene, each["index"])
        assert about["numColorFrames"] == about["numDepthFrames"] == DONE - 1
        assert np.array_equal(number >= 0, frame.labels > 0)
        truth = np.nan_to_num(metres(frame, source[frame]))
        assert np.abs(depth - truth).max() <= 0.0005 + 1e-9


def test_nothing_is_left_of_what_does_not_end(made, tmp_path):
    frames = export(Store(made / "png"), CocoExport, tmp_path / "new" / "out")
    next(frames)
    assert (tmp_path / "new").exists()
    frames.close()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_other_files_is_left_alone(made, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(PlanewiseError, match="is not empty"):
        all_of(Store(made / "png"), PngExport, tmp_path)
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_an_export_is_no_part_of_the_store(own, made):
    with pytest.raises(PlanewiseError, match="new is in the store; choose another folder"):
        all_of(Store(own), PngExport, own / "labels" / "new")
    assert not (own / "labels" / "new").exists()


def test_without_the_source_scenes_cannot_be_made(own, made, tmp_path):
    path = own / "store.json"
    info = json.loads(path.read_text())
    info["source"]["path"] = str(tmp_path / "gone")
    path.write_text(json.dumps(info))
    arguments = ("export", own, "--format", "planercnn", "-o", tmp_path / "out")
    code, _, errors = run(*arguments)
    assert code == 2
    assert f"there is no {tmp_path}/gone; give --source" in errors
    assert not (tmp_path / "out").exists()
    assert run(*arguments, "--source", made / "frames")[0] == 0


def test_frames_that_changed_are_not_taken_for_those_of_the_store(own, tmp_path):
    write_frames(tmp_path / "frames", 1)
    (tmp_path / "frames" / "empty.npz").unlink()
    with np.load(tmp_path / "frames" / "room 0.npz") as read:
        arrays = dict(read)
    arrays["depth"] = np.where(arrays["depth"] > 0, arrays["depth"] * 2, arrays["depth"])
    np.savez(tmp_path / "frames" / "room 0.npz", **arrays)
    code, _, errors = run(
        "export", own, "--format", "planercnn", "-o", tmp_path / "out", "--source",
        tmp_path / "frames",
    )  # fmt: skip
    assert code == 2
    assert "the readings of room 0 are no longer those of the store" in errors
    assert "no frame could be exported" in errors
    assert not (tmp_path / "out").exists()


def test_some_of_the_frames(made, tmp_path):
    code, text, _ = run("export", made / "rle", "--format", "npz", "-o", tmp_path / "out",
                        "--every", 2, "--limit", 2)  # fmt: skip
    assert (code, text) == (0, f"2 of 2 frames in {tmp_path}/out ")
    assert sorted(each.name for each in (tmp_path / "out").iterdir()) == [
        "empty.npz", "room%201.npz",
    ]  # fmt: skip


def test_exported_labels_are_scored_against_the_store(made, tmp_path):
    assert run("export", made / "png", "--format", "png", "-o", tmp_path / "out")[0] == 0
    code, text, errors = run("eval", made / "png", tmp_path / "out" / "labels", "--minimum-pixels",
                             10)  # fmt: skip
    assert (code, errors) == (0, "")
    assert f"{DONE} of {DONE} frames scored" in text
    assert re.search(r"f1@0\.8 1\.0000", text)


def test_what_is_no_store_is_refused(tmp_path):
    for command in (("export", "--format", "coco"), ("view",)):
        code, _, errors = run(*command, tmp_path, "-o", tmp_path / "out")
        assert code == 2
        assert "is none: it has no store.json" in errors
        code, _, errors = run(*command, tmp_path / "none", "-o", tmp_path / "out")
        assert (code, f"store: there is no folder {tmp_path / 'none'}" in errors) == (2, True)
