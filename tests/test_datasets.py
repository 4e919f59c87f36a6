"""Datasets: what every reader keeps to, NYU-v2 in its forms, and files nobody should trust."""

import builtins
import pickle
import struct
from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import planewise as pw
from planewise import datasets
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.nyu import FULL, PLANE_CROP, camera_of
from planewise.errors import MissingExtraError, PlanewiseError

from .nyu_files import frame, write_archive, write_folder, write_mat

CAMERA = pw.PinholeCamera(fx=50, fy=52, cx=31.0, cy=24.5)


@pytest.fixture
def frames():
    return [frame(n) for n in range(3)]


@pytest.fixture
def mat(tmp_path, frames):
    path = tmp_path / "nyu_depth_v2_labeled.mat"
    write_mat(path, frames)
    return path


@pytest.fixture
def folder(tmp_path, frames):
    write_folder(tmp_path / "nyu", dict(zip((2, 10, 9), frames, strict=True)))
    return tmp_path / "nyu"


@pytest.fixture
def archives(tmp_path, frames):
    (tmp_path / "cut").mkdir()
    for n, each in enumerate(frames):
        write_archive(tmp_path / "cut" / f"nyu_{n}.npz", each, CAMERA)
    return tmp_path / "cut"


def opened(kind, request):
    return datasets.open_nyu(
        request.getfixturevalue(kind), camera=None if kind == "archives" else CAMERA
    )


KINDS = pytest.mark.parametrize("kind", ["mat", "folder", "archives"])


@KINDS
def test_every_reader_keeps_to_the_protocol(kind, request):
    dataset = opened(kind, request)
    assert isinstance(dataset, Dataset)
    assert len(dataset) == len(dataset.ids) == 3
    assert [each.id for each in dataset] == list(dataset.ids)
    assert dataset.ids[0] in dataset
    assert "nothing" not in dataset
    with pytest.raises(PlanewiseError, match="has no frame 'nothing'; it has"):
        dataset["nothing"]
    one, again = dataset[dataset.ids[1]], dataset[dataset.ids[1]]
    for name in ("depth", "rgb", "labels"):
        array = getattr(one, name)
        if array is not None:
            assert not np.shares_memory(array, getattr(again, name))
            assert array.flags.writeable
    assert one.camera == CAMERA
    copied = pickle.loads(pickle.dumps(dataset))  # to another process
    assert_array_equal(copied[one.id].depth, one.depth)
    with ThreadPoolExecutor(3) as pool:
        for seen in pool.map(dataset.__getitem__, dataset.ids * 3):
            assert_array_equal(seen.depth, dataset[seen.id].depth)


@pytest.mark.parametrize("depth", ["depths", "rawDepths"])
def test_the_mat_comes_out_upright(mat, frames, depth):
    dataset = datasets.NyuLabelled(mat, depth=depth, camera=CAMERA)
    assert dataset.ids == ("1", "2", "3")
    for seen, each in zip(dataset, frames, strict=True):
        assert seen.depth.shape == (48, 64)
        assert seen.depth.dtype == np.float32
        assert seen.depth_scale is None
        assert_allclose(seen.depth, each["depth" if depth == "depths" else "raw"], rtol=1e-6)
        assert_array_equal(seen.rgb, each["rgb"])
        assert seen.labels is None  # its labels are of objects
        assert_array_equal(seen.valid, seen.depth > 0)


def test_the_folder_has_millimetres_and_natural_order(folder, frames):
    dataset = datasets.NyuFolder(folder, camera=CAMERA)
    assert dataset.ids == ("2", "9", "10")
    seen = dataset["10"]
    assert seen.depth_scale == 0.001
    assert_allclose(seen.depth * seen.depth_scale, frames[1]["raw"], atol=0.00051)
    assert_array_equal(seen.rgb, frames[1]["rgb"])
    assert_array_equal(seen.labels, frames[1]["planes"])


def test_a_folder_may_have_depth_alone(tmp_path, frames):
    write_folder(tmp_path, {7: frames[0]}, kinds=("depth",))
    seen = datasets.NyuFolder(tmp_path, camera=CAMERA)["7"]
    assert seen.rgb is None
    assert seen.labels is None


def test_archives_bring_everything(archives, frames):
    seen = datasets.ArchiveFolder(archives)["nyu_1"]
    assert_array_equal(seen.labels, frames[1]["planes"])
    assert_array_equal(seen.rgb, frames[1]["rgb"])
    assert seen.camera == CAMERA
    assert seen.depth_scale == 0.001
    np.savez(archives / "nyu_9.npz", depth=np.ones((4, 5), np.uint16), K=np.ones(4))
    bare = datasets.ArchiveFolder(archives)["nyu_9"]
    assert bare.labels is None
    assert bare.depth_scale == 0.001


def test_true_planes_may_lie_beside(mat, tmp_path, frames):
    truth = tmp_path / "truth"
    truth.mkdir()
    Image.fromarray(frames[1]["planes"].astype(np.uint8)).save(truth / "0002.png")
    dataset = datasets.open_nyu(mat, truth=truth, camera=CAMERA)
    assert_array_equal(dataset["2"].labels, frames[1]["planes"])
    assert dataset["1"].labels is None
    assert not dataset.truth.is_plane_set


def test_the_plane_set_is_laid_over_the_part_it_labels(tmp_path):
    small = np.arange(192 * 256).reshape(192, 256) * 20 // (192 * 256)
    (tmp_path / "truth").mkdir()
    np.savez(
        tmp_path / "truth" / "plane_instance_1.npz",
        plane_instance=small.astype(np.uint8),
        plane_param=np.ones((19, 3)),
    )
    Image.fromarray(np.zeros((192, 256, 3), np.uint8)).save(
        tmp_path / "truth" / "plane_instance_1.png"  # a picture to look at
    )
    whole = {**frame(0, FULL), "planes": np.ones(FULL)}
    write_folder(tmp_path / "nyu", {1: whole})
    dataset = datasets.open_nyu(tmp_path / "nyu", truth=tmp_path / "truth")
    assert dataset.truth.is_plane_set
    seen = dataset["1"]
    assert seen.camera == pw.cameras.NYU
    outside = seen.labels.copy()
    outside[PLANE_CROP] = 0
    assert not outside.any()
    # Every pixel of the crop has the label of the small image at the same relative place.
    inside = seen.labels[PLANE_CROP]
    for y, x in ((0, 0), (200, 300), (426, 560), (13, 559)):
        assert inside[y, x] == small[int((y + 0.5) * 192 / 427), int((x + 0.5) * 256 / 561)]
    with pytest.raises(PlanewiseError, match="labels a part of the whole frame"):
        dataset.truth.labels("1", (48, 64))


def test_cameras_of_whole_frames_and_crops():
    assert camera_of(FULL) == pw.cameras.NYU
    crop = camera_of((427, 561))
    assert (crop.cx, crop.cy) == (pw.cameras.NYU.cx - 40, pw.cameras.NYU.cy - 44)
    with pytest.raises(PlanewiseError, match="48 x 64 pixels is no whole frame"):
        camera_of((48, 64))


@KINDS
def test_a_damaged_frame_concerns_no_other(kind, request, tmp_path):
    path = request.getfixturevalue(kind)
    if kind == "mat":
        with h5py.File(path, "r") as file:
            at = file["depths"].id.get_chunk_info_by_coord((1, 16, 12))
        with path.open("r+b") as stream:
            stream.seek(at.byte_offset)
            stream.write(bytes(at.size))
    elif kind == "folder":
        (path / "depth" / "9.png").write_bytes(b"\x89PNG no more")
    else:
        (path / "nyu_1.npz").write_bytes(b"PK no more")
    dataset = opened(kind, request)  # what is wrong with a frame does not show yet
    assert len(dataset) == 3
    good, bad = [], []
    for each in dataset.ids:
        try:
            good.append(dataset[each].id)
        except PlanewiseError as error:
            bad.append(str(error))
    assert good == [dataset.ids[0], dataset.ids[2]]
    assert bad[0].startswith(f"{dataset.name}, frame {dataset.ids[1]}: ")
    assert "\n" not in bad[0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(1000)), "is no HDF5 file"),
        (lambda path: path.unlink(), "there is no file"),
        (lambda path: path.write_bytes(path.read_bytes()[:3000]), "cut short"),
    ],
    ids=["version 5", "missing", "cut"],
)
def test_what_is_no_such_mat_is_refused_at_once(mat, make, message):
    make(mat)
    with pytest.raises(PlanewiseError, match=message) as error:
        datasets.NyuLabelled(mat)
    assert "\n" not in str(error.value)


def hostile(path, how):
    with h5py.File(path, "w") as file:
        if how == "other dimensions":
            file["depths"] = np.zeros((2, 3), np.float32)
        elif how == "text":
            file["depths"] = "hello"
        elif how == "no depth":
            file["images"] = np.zeros((1, 3, 4, 4), np.uint8)
        elif how == "group":
            file.create_group("depths")
        elif how == "external link":
            file["depths"] = h5py.ExternalLink("other.h5", "/depths")
        elif how == "soft link":
            file["depths"] = h5py.SoftLink("/elsewhere")
        elif how == "external storage":
            file.create_dataset("depths", (1, 8, 8), "f4", external=[("secret", 0, 256)])
        elif how == "virtual":
            layout = h5py.VirtualLayout((1, 8, 8), "f4")
            layout[0] = h5py.VirtualSource("other.h5", "depths", (8, 8))
            file.create_virtual_dataset("depths", layout)
        elif how == "huge frame":
            file.create_dataset("depths", (1, 10**5, 10**5), "f4", chunks=(1, 10, 10))
        elif how == "many frames":
            file.create_dataset("depths", (10**12, 4, 4), "f4", chunks=(1, 4, 4))


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("other dimensions", r"shape \(2, 3\); expected 3 dimensions"),
        ("text", "expected 3 dimensions"),
        ("no depth", "has no array 'depths'; it holds images"),
        ("group", "has no array 'depths'"),
        ("external link", "has no array 'depths'"),
        ("soft link", "has no array 'depths'"),
        ("external storage", "keeps the array 'depths' in other files"),
        ("virtual", "keeps the array 'depths' in other files"),
        ("huge frame", "claims 10,000,000,000 values"),
        ("many frames", "claims 1,000,000,000,000 frames"),
    ],
)
def test_files_that_reach_elsewhere_or_claim_too_much_are_refused(tmp_path, how, message):
    path = tmp_path / "x.mat"
    hostile(path, how)
    with pytest.raises(PlanewiseError, match=message):
        datasets.NyuLabelled(path)


def test_a_piece_larger_than_any_image_is_refused(tmp_path):
    path = tmp_path / "x.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("depths", (2000, 200, 200), "f4", chunks=(2000, 200, 200))
    with pytest.raises(PlanewiseError, match="frame 1: claims 80,000,000 values"):
        datasets.NyuLabelled(path, camera=CAMERA)["1"]


def test_a_piece_that_swells_is_refused(mat):
    """A deflated piece of 16 x 12 readings that holds 64 MB."""
    import zlib

    bomb = zlib.compress(bytes(64 << 20), 9)
    with h5py.File(mat, "r+") as file:
        del file["depths"]
        stored = file.create_dataset(
            "depths", (3, 64, 48), "f4", chunks=(1, 16, 12), compression="gzip"
        )
        stored[:] = 1.0
        stored.id.write_direct_chunk((1, 16, 24), zlib.compress(bytes(16 * 12 * 4 + 1)))
        stored.id.write_direct_chunk((2, 0, 0), bomb)
    dataset = datasets.NyuLabelled(mat, camera=CAMERA)
    assert dataset["1"].depth.min() == 1.0
    with pytest.raises(PlanewiseError, match="frame 2: is damaged: a piece holds more than"):
        dataset["2"]
    with pytest.raises(PlanewiseError, match="frame 3: is damaged: a piece of 768 bytes is stored"):
        dataset["3"]


def test_filters_that_matlab_does_not_use_are_refused(tmp_path):
    path = tmp_path / "x.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("depths", data=np.ones((1, 48, 64), "f4"), compression="lzf")
    with pytest.raises(PlanewiseError, match="packed in an unusual way"):
        datasets.NyuLabelled(path, camera=CAMERA)["1"]


@pytest.mark.parametrize("chunks", [True, (3, 20, 10), (2, 64, 48), None])
def test_pieces_of_any_shape_and_shuffled_ones_are_read(tmp_path, frames, chunks):
    path = tmp_path / "x.mat"
    write_mat(path, frames)
    packed = {"compression": 9, "shuffle": True, "fletcher32": True} if chunks else {}
    with h5py.File(path, "r+") as file:
        data = file["depths"][:]
        del file["depths"]
        file.create_dataset("depths", data=data, chunks=chunks, **packed)
    seen = datasets.NyuLabelled(path, camera=CAMERA)["3"]
    assert_allclose(seen.depth, frames[2]["depth"], rtol=1e-6)


def test_big_endian_numbers_become_native(tmp_path):
    path = tmp_path / "x.mat"
    with h5py.File(path, "w") as file:
        file["depths"] = np.full((1, 64, 48), 2.5, ">f4")
    seen = datasets.NyuLabelled(path, camera=CAMERA)["1"]
    assert seen.depth.dtype == np.float32
    assert (seen.depth == 2.5).all()


def test_without_h5py_the_message_names_the_extra(mat, monkeypatch):
    load = builtins.__import__

    def absent(name, *rest):
        if name == "h5py":
            raise ImportError
        return load(name, *rest)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(MissingExtraError, match=r"pip install 'planewise\[datasets\]'"):
        datasets.NyuLabelled(mat)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: datasets.open_nyu(path / "none"), "there is no file or folder"),
        (lambda path: datasets.open_nyu(path), "is neither nyu_depth_v2_labeled.mat"),
        (lambda path: datasets.NyuFolder(path), "has no folder depth/"),
        (lambda path: datasets.ArchiveFolder(path / "none"), "is not a folder"),
        (lambda path: datasets.ArchiveFolder(path), "holds no frames"),
        (lambda path: datasets.NyuLabelled(path), "is a folder; give the file in it"),
        (lambda path: datasets.NyuFolder(empty(path)), "holds no frames"),
        (lambda path: datasets.NyuFolder(empty(path), truth=path / "none"), "truth: .* not a fol"),
        (lambda path: datasets.NyuFolder(empty(path), truth=path), "truth: .* holds no labels"),
    ],
)
def test_what_is_no_dataset_is_refused(tmp_path, make, message):
    with pytest.raises(PlanewiseError, match=message):
        make(tmp_path)


def empty(path):
    (path / "depth").mkdir()
    return path


def test_truth_of_another_size_is_refused_with_the_frame(folder):
    Image.fromarray(np.zeros((5, 5), np.uint8)).save(folder / "gt" / "9.png")
    dataset = datasets.NyuFolder(folder, camera=CAMERA)
    with pytest.raises(PlanewiseError, match=r"nyu, frame 9: labels must be integers of the depth"):
        dataset["9"]


def test_archives_have_their_own_truth(archives, tmp_path):
    with pytest.raises(PlanewiseError, match="the archives hold their own labels"):
        datasets.open_nyu(archives, truth=tmp_path)


def test_frames_check_what_they_are_given():
    depth = np.ones((4, 5))
    with pytest.raises(PlanewiseError, match="depth must be an image"):
        DatasetFrame(id="1", depth=depth[0], camera=CAMERA)
    with pytest.raises(PlanewiseError, match="labels must be integers"):
        DatasetFrame(id="1", depth=depth, camera=CAMERA, labels=depth)
    with pytest.raises(PlanewiseError, match="depth_scale is for integer depth"):
        DatasetFrame(id="1", depth=depth, camera=CAMERA, depth_scale=0.001)
    with pytest.raises(PlanewiseError, match="give depth_scale"):
        DatasetFrame(id="1", depth=depth.astype(np.uint16), camera=CAMERA)
    with pytest.raises(ValueError, match="depth must be 'depths' or 'rawDepths'"):
        datasets.NyuLabelled("x.mat", depth="other")


class Twice(Dataset):
    def _read(self, frame):
        raise struct.error("two\nlines")


def test_ids_are_unique_and_errors_one_line():
    with pytest.raises(PlanewiseError, match="x holds two frames named 1"):
        Twice("x", ["1", "2", "1"])
    with pytest.raises(PlanewiseError, match=r"x, frame 1: cannot be read; it is damaged \(two\)"):
        Twice("x", ["1"])["1"]
