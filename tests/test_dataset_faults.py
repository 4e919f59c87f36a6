"""Datasets that are damaged, or made to harm: an error of one line, and the other frames go on."""

import json
import os
import random
import struct
import zipfile
import zlib

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from planewise import datasets
from planewise.batch import DepthFolder
from planewise.datasets.paths import inside
from planewise.errors import PlanewiseError
from planewise.files.depth import read_depth

from . import dataset_files as files
from .bag_files import DEPTH, INFO, START, frames, write_bag
from .command import run_python
from .dataset_files import CAMERA, COUNT, FRAMES, POSES, sens_frame, units
from .nyu_files import write_archive, write_mat

FOLDERS = {
    "tum": files.write_tum,
    "icl-nuim": files.write_icl,
    "7-scenes": files.write_seven_scenes,
    "scannet": files.write_scannet,
    "redwood": files.write_redwood,
    "folder": files.write_generic,
}


def messages_of(dataset):
    """Errors of the frames that cannot be read, and how many can."""
    bad = []
    good = sum(1 for _ in dataset.readable(lambda frame, error: bad.append(str(error))))
    return bad, good


# Recordings of ScanNet


def test_a_recording_cut_short_keeps_what_is_whole(tmp_path):
    path = files.write_sens(tmp_path / "scene.sens")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) - 100])
    bad, good = messages_of(datasets.open(path))
    assert good == COUNT - 1
    assert len(bad) == 1
    assert "frame 000002: is not in the file, which is cut short or damaged after 2 of 3" in bad[0]


@pytest.mark.parametrize("where", ["colour", "depth"])
def test_a_frame_that_claims_too_much_ends_the_recording(tmp_path, where):
    pieces = [sens_frame(each, POSES[n], n, 2, 1) for n, each in enumerate(FRAMES)]
    at = 64 + 16 + 8 * (where == "depth")
    pieces[1] = pieces[1][:at] + struct.pack("<Q", 2**62) + pieces[1][at + 8 :]
    bad, good = messages_of(datasets.open(files.write_sens(tmp_path / "a.sens", frames=pieces)))
    assert (good, len(bad)) == (1, 2)


def with_depth(data):
    """A frame of a recording whose packed depth is replaced."""
    whole = sens_frame(FRAMES[0], POSES[0], 0, 2, 1)
    colour = struct.unpack_from("<Q", whole, 80)[0]
    return whole[:88] + struct.pack("<Q", len(data)) + whole[96 : 96 + colour] + data


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (zlib.compress(bytes(10_000_000), 9), "it has more than 6,144 bytes"),
        (zlib.compress(bytes(6000)), "it has 6,000 bytes, expected 6,144"),
        (zlib.compress(units(FRAMES[0], 0.001).tobytes())[:-3], "its end is missing"),
        (b"not zlib at all", "it is damaged"),
        (b"", "it has 0 bytes"),
    ],
)
def test_packed_depth_that_swells_or_is_damaged(tmp_path, data, message):
    pieces = [sens_frame(each, POSES[n], n, 2, 1) for n, each in enumerate(FRAMES)]
    pieces[1] = with_depth(data)
    bad, good = messages_of(datasets.open(files.write_sens(tmp_path / "a.sens", frames=pieces)))
    assert (good, len(bad)) == (2, 1)
    assert bad[0].startswith("a.sens, frame 000001: ")
    assert message in bad[0]


def test_memory_is_not_taken_for_a_claim(tmp_path):
    """16 MB that unpack to 16 GB: the process stays small."""
    bomb = with_depth(zlib.compress(bytes(1 << 24), 9))
    path = files.write_sens(tmp_path / "a.sens", frames=[bomb])
    code = (
        "import resource, sys; from planewise import datasets\n"
        "dataset = datasets.open(sys.argv[1])\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "list(dataset.readable(lambda *_: None))\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    taken = int(run_python(code, path).stdout)
    assert taken < 12_000  # kilobytes, the decoder of pictures included


@pytest.mark.parametrize(
    ("at", "value", "message"),
    [
        (0, struct.pack("<I", 5), "is no recording of ScanNet of version 4"),
        (4, struct.pack("<Q", 2**40), "is no recording"),
        (283, struct.pack("<ii", 7, 1), "has compressions 7"),
        (283 + 4, struct.pack("<i", 2), "and 2 .depth.; known are"),
        (283 + 16, struct.pack("<II", 2**31, 2**31), "at most 50,000,000 are read"),
        (283 + 16, struct.pack("<I", 0), "has a damaged header"),
        (283 + 24, struct.pack("<f", float("nan")), "has a damaged header"),
        (283 + 28, struct.pack("<Q", 2**60), "has a damaged header"),
        (27 + 128, struct.pack("<f", float("inf")), "the intrinsics are damaged"),
    ],
)
def test_headers_of_recordings(tmp_path, at, value, message):
    path = files.write_sens(tmp_path / "a.sens")
    data = path.read_bytes()
    path.write_bytes(data[:at] + value + data[at + len(value) :])
    with pytest.raises(PlanewiseError, match=f"data: a.sens .*{message}"):
        datasets.open(path)


# Bits that fall over, and ends that are missing


def one_file(kind, tmp_path):
    """A dataset in one file, with the options that open it."""
    if kind == "sens":
        return files.write_sens(tmp_path / "a.sens", colour=1), {}
    if kind == "mat":
        write_mat(tmp_path / "a.mat", FRAMES)
        return tmp_path / "a.mat", {"camera": CAMERA}

    def contents(messages):
        yield from frames(messages, f"{DEPTH}/compressedDepth", compressed=True)
        yield INFO, START, messages.info()

    path = write_bag(tmp_path / "run", kind, contents)
    return (path if path.is_file() else next(path.glob("run.*"))), {}


@pytest.mark.parametrize("kind", ["sens", "mat", "bag-lz4", "bag-bz2", "db3", "mcap-zstd"])
def test_whatever_bit_is_wrong_the_error_is_ours(kind, tmp_path):
    path, options = one_file(kind, tmp_path)
    whole = path.read_bytes()
    chance = random.Random(kind)
    read = 0
    for _ in range(60 if kind in ("sens", "mat") else 15):
        data = bytearray(whole)
        for _ in range(chance.choice((1, 1, 3))):
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        path.write_bytes(data[: chance.randrange(len(data))] if chance.random() < 0.2 else data)
        good, bad, count = outcome(path, options)
        assert good + len(bad) == count
        assert not any("\n" in message for message in bad)
        read += good
    assert read > 0


def outcome(path, options):
    """Frames that can be read, errors of the others, and how many there are; 1 for the whole."""
    try:
        dataset = datasets.open(path, **options)
    except PlanewiseError as error:
        return 0, [str(error)], 1
    bad, good = messages_of(dataset)
    return good, bad, len(dataset)


@pytest.mark.parametrize("kind", FOLDERS)
def test_whatever_bit_of_a_picture_is_wrong_the_other_frames_are_read(kind, tmp_path):
    root = FOLDERS[kind](tmp_path / "data")
    dataset = datasets.open(root)
    victim = next(path for path in root.rglob("*.png") if "depth" in str(path))
    whole = victim.read_bytes()
    chance = random.Random(kind)
    for _ in range(20):
        data = bytearray(whole)
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        victim.write_bytes(data[: chance.randrange(len(data))] if chance.random() < 0.3 else data)
        bad, good = messages_of(dataset)
        assert good >= COUNT - 1
        assert len(bad) + good == COUNT


# Larger than they say, or than anything


def png_of(width, height, rows=b""):
    """A PNG of 16 bits grey that claims a size, with few rows in it."""

    def chunk(name, data):
        body = name + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize("kind", FOLDERS)
def test_pictures_that_claim_too_much(kind, tmp_path):
    root = FOLDERS[kind](tmp_path / "data")
    dataset = datasets.open(root)
    depth = sorted(path for path in root.rglob("*.png") if "depth" in str(path))
    depth[0].write_bytes(png_of(8000, 8000))
    colour = dataset._files[dataset.ids[1]].rgb
    Image.new("1", (9000, 9000)).save(root / colour, "PNG")
    bad, good = messages_of(dataset)
    assert good == 1
    assert "claims 64,000,000 values; at most 50,000,000 are read" in bad[0]
    assert "the picture" in bad[1]
    assert "claims 81,000,000 values" in bad[1]
    assert len(messages_of(dataset.without_pictures())[0]) == 1


def test_lists_numbers_and_sweeps_that_are_too_large(tmp_path, monkeypatch):
    root = files.write_tum(tmp_path / "tum")
    os.truncate(root / "depth.txt", 1 << 30)  # sparse
    with pytest.raises(PlanewiseError, match=r"depth.txt is too large"):
        datasets.open(root)
    root = files.write_kitti(tmp_path / "kitti")
    os.truncate(root / "velodyne/000001.bin", 1 << 34)
    bad, good = messages_of(datasets.open(root))
    assert good == COUNT - 1
    assert "claims 1,073,741,824 values" in bad[0]
    root = files.write_icl_rendered(tmp_path / "icl")
    os.truncate(root / "scene_00_0001.depth", 1 << 34)
    bad, good = messages_of(datasets.open(root, camera=pinhole()))
    assert good == COUNT - 1
    assert "scene_00_0001.depth is too large" in bad[0]


def pinhole():
    import planewise as pw

    return pw.PinholeCamera(fx=50, fy=52, cx=31.0, cy=24.5, width=64, height=48)


def test_a_folder_of_archives_with_one_that_swells(tmp_path):
    """One archive's depth image claims, and could unpack to, 800 MB."""
    root = tmp_path / "cut"
    root.mkdir()
    for n, each in enumerate(FRAMES):
        write_archive(root / f"{n}.npz", each, CAMERA)
    claim = {"descr": "<u2", "fortran_order": False, "shape": (20_000, 20_000)}
    with (
        zipfile.ZipFile(root / "1.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("depth.npy", "w") as stream,
    ):
        np.lib.format.write_array_header_1_0(stream, claim)
        stream.write(bytes(1 << 20))
    bad, good = messages_of(datasets.open(root))
    assert good == COUNT - 1
    assert "at most 50,000,000 are read" in bad[0]


# Names that lead out of the dataset


@pytest.mark.parametrize("kind", FOLDERS)
def test_links_out_of_the_dataset_are_not_followed(kind, tmp_path):
    root = FOLDERS[kind](tmp_path / "data")
    dataset = datasets.open(root)
    depth = sorted(path for path in root.rglob("*.png") if "depth" in str(path))
    depth[1].rename(tmp_path / "private.png")
    depth[1].symlink_to(tmp_path / "private.png")
    bad, good = messages_of(dataset)
    assert good == COUNT - 1
    assert "lies outside the dataset, or is a link out of it" in bad[0]
    depth[1].unlink()
    depth[1].symlink_to(depth[0])  # a link inside is one way to repeat a frame
    assert messages_of(dataset) == ([], COUNT)


@pytest.mark.parametrize("name", ["../secret.png", "/secret.png", "rgb/../../secret.png"])
@pytest.mark.parametrize("column", [0, 1])
def test_lists_may_not_name_files_elsewhere(tmp_path, name, column):
    root = files.write_icl(tmp_path / "data")
    (root / "depth/0.png").rename(tmp_path / "secret.png")
    name = name.replace("/secret.png", f"{tmp_path}/secret.png") if name[0] == "/" else name
    images = [f"depth/{n}.png" for n in range(COUNT)], [f"rgb/{n}.png" for n in range(COUNT)]
    images[column][0] = name
    lines = [f"{n} {images[0][n]} {n} {images[1][n]}" for n in range(COUNT)]
    (root / "associations.txt").write_text("\n".join(lines))
    if column:
        (tmp_path / "secret.png").rename(root / "depth/0.png")
    bad, good = messages_of(datasets.open(root))
    assert good == COUNT - 1
    assert "lies outside the dataset" in bad[0]


@pytest.mark.parametrize("kind", ["scannet", "redwood", "folder"])
def test_whole_folders_and_cameras_that_are_links_out(kind, tmp_path):
    for name in ("depth", "camera"):
        root = FOLDERS[kind](tmp_path / f"data-{name}")
        path = root / "depth"
        if name == "camera":
            path = next(each for each in root.rglob("*") if each.name.startswith(
                ("camera", "intrinsic_depth")
            ))  # fmt: skip
        path.rename(tmp_path / f"private-{name}")
        path.symlink_to(tmp_path / f"private-{name}")
        with pytest.raises(PlanewiseError, match="lies outside the dataset"):
            datasets.open(root)


def test_a_plain_folder_may_be_made_of_links(tmp_path):
    root = files.write_generic(tmp_path / "data")
    (tmp_path / "chosen").mkdir()
    (tmp_path / "chosen/a.png").symlink_to(min((root / "depth").iterdir()))
    found = DepthFolder(tmp_path / "chosen")["a"].depth
    assert_array_equal(found, read_depth(min((root / "depth").iterdir())).depth)


def test_a_dataset_may_itself_be_a_link(tmp_path):
    root = files.write_generic(tmp_path / "data")
    (tmp_path / "link").symlink_to(root)
    assert messages_of(datasets.open(tmp_path / "link")) == ([], COUNT)
    assert inside(tmp_path / "link", "camera.json").read_bytes()


def test_a_collection_does_not_follow_links_out_of_it(tmp_path):
    files.write_sens(tmp_path / "private.sens")
    (tmp_path / "scans").mkdir()
    files.write_sens(tmp_path / "scans/a.sens")
    (tmp_path / "scans/b.sens").symlink_to(tmp_path / "private.sens")
    (tmp_path / "scans/c").symlink_to(tmp_path)
    bad, good = messages_of(datasets.open(tmp_path / "scans"))
    assert good == COUNT
    assert len(bad) == 2
    assert all("lies outside the dataset" in message for message in bad)


def test_links_in_a_circle_cost_themselves_only(tmp_path):
    root = files.write_generic(tmp_path / "scans" / "a")
    depth = min((root / "depth").iterdir())
    for path in (depth, tmp_path / "scans" / "b"):
        path.unlink(missing_ok=True)
        path.symlink_to(path.name)
    bad, good = messages_of(datasets.open(tmp_path / "scans"))
    assert good == COUNT - 1
    assert any("a, frame view 0: depth" in message for message in bad)


def test_a_damaged_first_archive_does_not_hide_the_others(tmp_path):
    for n, each in enumerate(FRAMES):
        write_archive(tmp_path / f"{n}.npz", each, CAMERA)
    (tmp_path / "0.npz").write_bytes(b"PK\x05\x06")
    bad, good = messages_of(datasets.open(tmp_path))
    assert (good, len(bad)) == (COUNT - 1, 1)


def test_names_that_differ_by_zeros_or_capitals_are_in_one_order(tmp_path):
    """Shards on several machines have to agree, whatever order a file system lists."""
    root = files.write_generic(tmp_path / "data")
    whole = (root / "depth/view 0.png").read_bytes()
    names = ["b1", "b01", "B1", "B01", "a"]
    for name in names:
        (root / f"depth/{name}.png").write_bytes(whole)
    ids = datasets.open(root).ids
    assert ids[:5] == ("a", "B01", "B1", "b01", "b1")


@pytest.mark.parametrize("name", ["a/b", "..", ".", "", "a\\b", "a\nb", "a\0b"])
def test_ids_are_names_that_a_store_can_use(name):
    class Odd(datasets.Dataset):
        def _read(self, frame):
            raise AssertionError

    with pytest.raises(PlanewiseError, match="no name for a file"):
        Odd("odd", ["good", name])


def test_pipes_are_not_waited_for(tmp_path):
    """Whoever opens a pipe to read waits until somebody writes."""
    root = files.write_icl(tmp_path / "parts/data")
    os.mkfifo(tmp_path / "parts/pipe")
    for place in ("depth/0.png", "rgb/1.png"):
        (root / place).unlink()
        os.mkfifo(root / place)
    bad, good = messages_of(datasets.open(tmp_path / "parts"))
    assert (good, len(bad)) == (COUNT - 2, 2)


def test_a_camera_file_of_any_size_and_depth_of_brackets(tmp_path):
    root = files.write_generic(tmp_path / "data")
    (root / "camera.json").write_text("[" * 100_000)
    with pytest.raises(PlanewiseError, match=r"camera\.json|camera: "):
        datasets.open(root)
    (root / "camera.json").write_text(json.dumps({"fx": "x" * 2_000_000}))
    with pytest.raises(PlanewiseError, match="too large to be a calibration"):
        datasets.open(root)


def test_inputs_are_never_changed(tmp_path):
    for kind, write in FOLDERS.items():
        root = write(tmp_path / kind)
        before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
        messages_of(datasets.open(root))
        after = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
        assert before == after
    first = datasets.open(tmp_path / "7-scenes")[0]
    first.depth[:] = 1
    assert_array_equal(datasets.open(tmp_path / "7-scenes")[0].valid, FRAMES[0]["raw"] > 0)
