from __future__ import annotations

import errno
import itertools
import os
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from planewise.datasets.paths import listed
from planewise.errors import PlanewiseError
from planewise.files import depth as depth_files
from planewise.files.colour import read_colour
from planewise.files.depth import (
    MAX_PIXELS,
    is_depth_file,
    list_depth_files,
    natural_order,
    read_depth,
)
from planewise.files.labels import label_images, read_labels
from planewise.files.result_names import CLOUD_FILES, FILES, OUTLINE_FILES

DEPTH = np.random.default_rng(0).integers(500, 9000, (12, 16)).astype(np.uint16)
METRES = (DEPTH / 1000).astype(np.float32)


def write_exr(path, channels, **more):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **more}
    with OpenEXR.File(header, channels) as image:
        image.write(str(path))


def write_pgm(path, depth, largest=65535, comment=b""):
    height, width = depth.shape
    head = b"P5\n" + comment + b"%d %d\n%d\n" % (width, height, largest)
    path.write_bytes(head + depth.astype(">u2").tobytes())


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff"])
def test_16_bit_pictures(tmp_path, suffix):
    path = tmp_path / f"depth{suffix}"
    Image.fromarray(DEPTH).save(path)
    depth = read_depth(path).depth
    assert depth.dtype == np.uint16
    assert np.array_equal(depth, DEPTH)


def test_floating_point_tiff(tmp_path):
    Image.fromarray(METRES).save(tmp_path / "depth.tiff")
    assert np.array_equal(read_depth(tmp_path / "depth.tiff").depth, METRES)


@pytest.mark.parametrize("largest", [65535, 10000, 256])  # 256 takes two bytes, too
def test_pgm_keeps_its_values(tmp_path, largest):
    write_pgm(tmp_path / "depth.pgm", DEPTH, largest, b"# made by hand\n")
    assert np.array_equal(read_depth(tmp_path / "depth.pgm").depth, DEPTH)


def test_plain_text_pgm(tmp_path):
    text = "P2\n16 12\n65535\n" + " ".join(map(str, DEPTH.ravel()))
    (tmp_path / "depth.pgm").write_text(text)
    assert np.array_equal(read_depth(tmp_path / "depth.pgm").depth, DEPTH)


@pytest.mark.parametrize("array", [DEPTH, METRES, np.asfortranarray(METRES), DEPTH[..., None]])
def test_npy(tmp_path, array):
    np.save(tmp_path / "depth.npy", array)
    assert np.array_equal(read_depth(tmp_path / "depth.npy").depth, array.reshape(12, 16))


def test_npz_states_camera_scale_and_picture(tmp_path):
    rgb = np.zeros((12, 16, 3), np.uint8)
    k = (500.0, 501.0, 8.0, 6.0)
    path = tmp_path / "frame.npz"
    np.savez_compressed(path, depth=DEPTH, K=k, depth_scale=0.0002, rgb=rgb, note="a note")
    frame = read_depth(path)
    assert np.array_equal(frame.depth, DEPTH)
    assert frame.depth_scale == 0.0002
    assert (frame.camera.fx, frame.camera.fy, frame.camera.cx, frame.camera.cy) == k
    assert frame.rgb.shape == (12, 16, 3)


def test_pictures_may_have_as_many_pixels_as_their_depth(tmp_path, monkeypatch):
    path = tmp_path / "frame.npz"
    np.savez(path, depth=DEPTH, rgb=np.zeros((12, 16, 3), np.uint8))
    monkeypatch.setattr(depth_files, "MAX_PIXELS", 12 * 16)
    assert read_depth(path).rgb.shape == (12, 16, 3)
    monkeypatch.setattr(depth_files, "MAX_PIXELS", 12 * 16 - 1)
    with pytest.raises(PlanewiseError, match="claims 192 values; at most 191 are read"):
        read_depth(path)


def test_npz_with_one_array_of_any_name_and_a_matrix(tmp_path):
    np.savez(tmp_path / "one.npz", anything=METRES)
    assert np.array_equal(read_depth(tmp_path / "one.npz").depth, METRES)
    matrix = np.array(((500.0, 0, 8), (0, 501, 6), (0, 0, 1)))
    np.savez(tmp_path / "k.npz", depth=METRES, K=matrix, depth_scale=1)
    frame = read_depth(tmp_path / "k.npz")
    assert frame.camera.fy == 501
    assert frame.depth_scale is None  # metres have no unit to be told
    np.savez(tmp_path / "k.npz", depth=METRES * 1000, depth_scale=0.001)
    refused(tmp_path / "k.npz", "depth_scale is for integer depth; floating-point depth is in")


@pytest.mark.parametrize("channel", ["Z", "depth", "Y"])
def test_exr(tmp_path, channel):
    write_exr(tmp_path / "depth.exr", {channel: METRES})
    assert np.array_equal(read_depth(tmp_path / "depth.exr").depth, METRES)


@pytest.mark.parametrize(
    ("x", "y"), [(0, 0), (4, 2), (-3, 5), (5, -4), (-20, 3), (3, -20), (25, 0), (0, 40)]
)
def test_exr_may_be_a_window_of_a_larger_picture(tmp_path, x, y):
    """Or reach beyond it; its camera is that of the picture."""
    corners = np.array(((0, 0), (24, 19), (x, y), (x + 15, y + 11)), np.int32) + 90_000
    windows = {"displayWindow": tuple(corners[:2]), "dataWindow": tuple(corners[2:])}
    write_exr(tmp_path / "depth.exr", {"Z": METRES}, **windows)
    wide = np.zeros((20 + 80, 25 + 80), np.float32)
    wide[40 + y : 52 + y, 40 + x : 56 + x] = METRES
    assert_array_equal(read_depth(tmp_path / "depth.exr").depth, wide[40:60, 40:65])


def test_the_picture_of_an_exr_counts_before_it_is_made(tmp_path):
    first = np.array((0, 0), np.int32)
    write_exr(tmp_path / "a.exr", {"Z": METRES}, displayWindow=(first, first + 99_999))
    refused(tmp_path / "a.exr", "claims 10,000,000,000 values")


def test_a_damaged_exr_is_called_so(tmp_path):
    write_exr(tmp_path / "d.exr", {"Z": METRES})
    data = (tmp_path / "d.exr").read_bytes()
    (tmp_path / "d.exr").write_bytes(data[: len(data) - 50])
    # The first OpenEXR 3.4 raises; later ones print why, and return nothing.
    refused(tmp_path / "d.exr", r"d\.exr (is damaged or cut short|cannot be read; it is damaged)")


def test_exr_in_colour_is_read_only_with_a_depth_channel(tmp_path):
    colour = dict.fromkeys("RGB", METRES * 0)
    write_exr(tmp_path / "both.exr", {**colour, "Z": METRES})
    assert np.array_equal(read_depth(tmp_path / "both.exr").depth, METRES)
    write_exr(tmp_path / "colour.exr", colour)
    with pytest.raises(PlanewiseError, match="colour"):
        read_depth(tmp_path / "colour.exr")


def refused(path, match):
    with pytest.raises(PlanewiseError, match=match) as error:
        read_depth(path)
    assert path.name in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("scale", [0, np.inf, [0.001, 0.001]])
def test_a_scale_that_is_none_is_refused(tmp_path, scale):
    np.savez(tmp_path / "d.npz", depth=DEPTH, depth_scale=scale)
    refused(tmp_path / "d.npz", "has depth_scale .*; expected one positive number of metres")


def test_8_bit_is_refused_everywhere(tmp_path):
    small = (DEPTH // 40).astype(np.uint8)
    for name in ("d.png", "d.tiff", "d.pgm"):
        Image.fromarray(small).save(tmp_path / name)
        refused(tmp_path / name, "8 bits")
    np.save(tmp_path / "d.npy", small)
    refused(tmp_path / "d.npy", "8 bits")
    np.save(tmp_path / "b.npy", small > 100)
    refused(tmp_path / "b.npy", "8 bits")


def test_colour_is_refused(tmp_path):
    rgb = np.zeros((12, 16, 3), np.uint8)
    Image.fromarray(rgb).save(tmp_path / "d.png")
    refused(tmp_path / "d.png", "colour")
    np.save(tmp_path / "d.npy", rgb.astype(float))
    refused(tmp_path / "d.npy", "colour")


@pytest.mark.parametrize("name", ["d.png", "d.tiff", "d.pgm", "d.npy", "d.npz", "d.exr"])
@pytest.mark.parametrize("damage", ["truncated", "junk", "empty"])
@pytest.mark.filterwarnings("ignore")
def test_damaged_files_are_refused(tmp_path, name, damage, capfd):
    path = tmp_path / name
    if name == "d.npy":
        np.save(path, DEPTH)
    elif name == "d.npz":
        np.savez(path, depth=DEPTH)
    elif name == "d.pgm":
        write_pgm(path, DEPTH)
    elif name == "d.exr":
        write_exr(path, {"Z": METRES})
    else:
        Image.fromarray(DEPTH).save(path)
    data = path.read_bytes()
    broken = {"truncated": data[: len(data) * 2 // 3], "junk": b"junk" * 50, "empty": b""}
    path.write_bytes(broken[damage])
    refused(path, "d\\.")


@pytest.mark.parametrize("read", [read_depth, read_colour, read_labels])
def test_a_png_whose_checksum_is_wrong_is_refused(tmp_path, read):
    """Its decoder would give another number there, and no error."""
    path = tmp_path / "d.png"
    Image.fromarray(DEPTH).save(path, compress_level=0)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    with pytest.raises(PlanewiseError, match=r"d\.png cannot be read.*checksum"):
        read(path)


def test_several_images_in_a_file_are_refused(tmp_path):
    first, second = Image.fromarray(DEPTH), Image.fromarray(DEPTH + 1)
    first.save(tmp_path / "d.tiff", save_all=True, append_images=[second])
    refused(tmp_path / "d.tiff", "holds several images; export one frame a file")


def test_other_refusals(tmp_path):
    refused(tmp_path / "none.png", "no file")
    (tmp_path / "folder.png").mkdir()
    refused(tmp_path / "folder.png", "not a file")
    (tmp_path / "depth.jpg").write_bytes(b"")
    refused(tmp_path / "depth.jpg", "no known kind")
    np.save(tmp_path / "line.npy", DEPTH.ravel())
    refused(tmp_path / "line.npy", "shape")
    np.save(tmp_path / "complex.npy", METRES.astype(complex))
    refused(tmp_path / "complex.npy", "integers or floating-point")
    np.savez(tmp_path / "two.npz", a=DEPTH, b=DEPTH)
    refused(tmp_path / "two.npz", "it holds a, b")
    np.savez(tmp_path / "k.npz", depth=DEPTH, K=np.ones(5))
    refused(tmp_path / "k.npz", "intrinsics of 5 numbers")
    np.savez(tmp_path / "k.npz", depth=DEPTH, K=np.full(4, np.nan))
    refused(tmp_path / "k.npz", "K of no camera .*fx must be a positive number of pixels, got nan")
    np.savez(tmp_path / "k.npz", depth=DEPTH, K=[[500, 5, 320], [0, 500, 240], [0, 0, 1]])
    refused(tmp_path / "k.npz", "skew")


def test_a_file_that_may_not_be_read_is_not_called_damaged(tmp_path, monkeypatch):
    np.save(tmp_path / "d.npy", DEPTH)

    def closed(*_):
        raise PermissionError(errno.EACCES, "Permission denied", "d.npy")

    monkeypatch.setattr(Path, "open", closed)
    with pytest.raises(
        PlanewiseError, match=r"^depth: d.npy cannot be read \(Permission denied\)$"
    ):
        read_depth(tmp_path / "d.npy")


def test_pickles_are_never_loaded(tmp_path):
    class Trap:
        def __reduce__(self):
            return (pytest.fail, ("it was loaded",))

    np.save(tmp_path / "trap.npy", np.array([Trap()], dtype=object), allow_pickle=True)
    refused(tmp_path / "trap.npy", "pickled")


def test_bombs_are_refused_before_they_are_unpacked(tmp_path):
    side = int(MAX_PIXELS**0.5) + 1
    header = {"descr": "<u2", "fortran_order": False, "shape": (side, side)}
    with (tmp_path / "bomb.npy").open("wb") as stream:
        np.lib.format.write_array_header_1_0(stream, header)
    refused(tmp_path / "bomb.npy", "at most")
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(tmp_path / "bomb.npy", "depth.npy")
    refused(tmp_path / "bomb.npz", "at most")

    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    ihdr = struct.pack(">IIBBBBB", side, side, 16, 0, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", ihdr) + chunk(b"IDAT", zlib.compress(b"\0" * 99))
    (tmp_path / "bomb.png").write_bytes(png + chunk(b"IEND", b""))
    refused(tmp_path / "bomb.png", "at most")
    (tmp_path / "bomb.pgm").write_bytes(b"P5 %d %d 65535\n" % (side, side))
    refused(tmp_path / "bomb.pgm", "at most")


def claimed(path, **arrays):
    """Write an archive whose members are headers alone, but for those that are arrays."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as stream:
                if isinstance(array, np.ndarray):
                    np.lib.format.write_array(stream, array)
                else:
                    shape, kind = array
                    header = {"descr": kind, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(stream, header)


def test_what_goes_with_depth_is_judged_before_it_is_unpacked(tmp_path, caplog):
    path = tmp_path / "a.npz"
    claimed(path, depth=DEPTH, rgb=((12, 16, 3), "<c16"))
    assert read_depth(path).rgb is None
    assert "a.npz: rgb has shape (12, 16, 3) and type complex128" in caplog.text
    claimed(path, depth=DEPTH, rgb=((10**6, 10**6, 3), "|u1"))
    assert read_depth(path).rgb is None
    claimed(path, depth=DEPTH, K=((10**7, 3), "<f8"))
    refused(path, "a.npz K claims 30,000,000 values; at most 16 are read")
    claimed(path, depth=DEPTH, depth_scale=((17,), "<f8"))
    refused(path, "a.npz depth_scale claims 17 values; at most 16 are read")
    claimed(path, depth=((5000, 5000, 3), "<c16"))
    refused(path, "claims 75,000,000 values; at most 50,000,000 are read")


def test_the_channels_of_an_exr_count_before_they_are_unpacked(tmp_path, monkeypatch):
    import OpenEXR

    path = tmp_path / "a.exr"
    for module in ("depth", "exr"):
        monkeypatch.setattr(f"planewise.files.{module}.MAX_PIXELS", METRES.size)
    write_exr(path, {"Z": METRES, "a": METRES, "b": METRES, "c": METRES})
    assert np.array_equal(read_depth(path).depth, METRES)
    write_exr(path, {"Z": METRES, "a": METRES, "b": METRES, "c": METRES, "d": METRES})
    refused(path, f"claims {5 * METRES.size} values; at most {4 * METRES.size} are read")
    parts = [OpenEXR.Part({"name": name}, {"Z": METRES, "a": METRES}) for name in "xyz"]
    OpenEXR.File(parts).write(str(path))
    refused(path, f"claims {6 * METRES.size:,} values; at most {4 * METRES.size} are read")
    samples = np.empty(METRES.shape, object)
    for at in np.ndindex(samples.shape):
        samples[at] = METRES[at].repeat(2)
    deep = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}
    OpenEXR.File(deep, {"Z": samples}).write(str(path))
    refused(path, "is a deep OpenEXR file")


def test_names_that_differ_little_are_in_one_order_everywhere():
    names = ["01.png", "1.png", "A.png", "a.png"]
    for order in itertools.permutations(map(Path, names)):
        assert [path.name for path in sorted(order, key=natural_order)] == names


def test_folder_is_listed_in_natural_order(tmp_path):
    for name in ("f10.png", "f2.npy", "f1.EXR", "notes.txt", ".hidden.png", "rgb.jpg"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "sub.png").mkdir()
    assert [path.name for path in list_depth_files(tmp_path)] == ["f1.EXR", "f2.npy", "f10.png"]
    with pytest.raises(PlanewiseError, match="no depth files"):
        list_depth_files(tmp_path / "sub.png")
    with pytest.raises(PlanewiseError, match="not a folder"):
        list_depth_files(tmp_path / "notes.txt")


def test_results_in_a_folder_of_depth_images_are_none(tmp_path):
    for name in ("1.png", *FILES, *OUTLINE_FILES, *CLOUD_FILES):
        (tmp_path / name).write_bytes(b"")
    assert [path.name for path in list_depth_files(tmp_path)] == ["1.png"]
    assert [path.name for path in listed(tmp_path, is_depth_file)] == ["1.png"]
    (tmp_path / "planes.json").unlink()
    names = ["1.png", "curve.png", "labels.png", "overlay.png", "preview.png"]
    assert [path.name for path in list_depth_files(tmp_path)] == names


def test_what_goes_with_depth_is_not_taken_for_it(tmp_path):
    path = tmp_path / "camera.npz"
    np.savez(path, K=np.array([50.0, 50.0, 32.0, 24.0]))
    with pytest.raises(PlanewiseError, match="an array named 'depth', or one only; it holds K"):
        read_depth(path)


@pytest.mark.skipif(os.name != "posix", reason="links as POSIX has them")
def test_a_link_to_nothing_is_a_file_that_cannot_be_read(tmp_path):
    np.save(tmp_path / "1.npy", np.ones((4, 5)))
    (tmp_path / "2.npy").symlink_to(tmp_path / "nowhere.npy")
    assert [path.name for path in list_depth_files(tmp_path)] == ["1.npy", "2.npy"]
    with pytest.raises(PlanewiseError, match="there is no file"):
        read_depth(tmp_path / "2.npy")


def test_exr_with_channels_that_say_nothing_of_depth(tmp_path):
    write_exr(tmp_path / "alpha.exr", {"A": np.ones_like(METRES), "V": METRES})
    assert np.array_equal(read_depth(tmp_path / "alpha.exr").depth, METRES)
    write_exr(tmp_path / "two.exr", {"U": METRES, "V": METRES})
    with pytest.raises(PlanewiseError, match="'Z' or 'depth', or one only; it has U, V"):
        read_depth(tmp_path / "two.exr")


def write_tiff(path, image, order="<", packed=False):
    """One strip behind the tags, for what Pillow does not write."""
    data = image.astype(image.dtype.newbyteorder(order)).tobytes()
    data = zlib.compress(data) if packed else data
    kinds = {"i": {339: 2}, "f": {339: 3}}  # unsigned integers need no such tag
    signs = kinds.get(image.dtype.kind, {})
    (height, width), start = image.shape, 8 + 2 + (8 + len(signs)) * 12 + 4
    tags = {
        256: width, 257: height, 258: 8 * image.itemsize, 259: 8 if packed else 1, 262: 1,
        273: start, 278: height, 279: len(data), **signs,
    }  # fmt: skip
    body = b"".join(struct.pack(f"{order}HHII", tag, 4, 1, value) for tag, value in tags.items())
    head = struct.pack(f"{order}HIH", 42, 8, len(tags)) + body + struct.pack(f"{order}I", 0)
    path.write_bytes({"<": b"II", ">": b"MM"}[order] + head + data)


def test_tiffs_that_are_not_read_are_told_from_damaged_ones(tmp_path):
    path = tmp_path / "depth.tif"
    for kind in (np.float64, np.float16):
        write_tiff(path, METRES.astype(kind))
        with pytest.raises(PlanewiseError, match="kind that is not read; write integers of 16"):
            read_depth(path)
    write_tiff(path, METRES.astype(np.float32))
    assert np.array_equal(read_depth(path).depth, METRES.astype(np.float32))


@pytest.mark.parametrize(
    "read",
    [lambda path: read_depth(path).depth, read_colour, lambda path: read_labels(path).labels],
)
def test_damaged_tags_that_do_not_matter_are_not_warned_of(tmp_path, read):
    """Warnings are errors here; on a terminal they are two lines of Pillow's code."""
    image = DEPTH if read is not read_colour else DEPTH.astype(np.uint8)
    write_tiff(tmp_path / "whole.tif", image)
    data = (tmp_path / "whole.tif").read_bytes()
    rows = struct.pack("<HHI", 278, 4, 1)
    (tmp_path / "damaged.tif").write_bytes(data.replace(rows, struct.pack("<HHI", 278, 4, 9999)))
    assert_array_equal(read(tmp_path / "damaged.tif"), read(tmp_path / "whole.tif"))


def test_parameters_are_those_of_labels_that_a_run_wrote(tmp_path):
    (tmp_path / "planes.json").write_text('{"planes": [{"normal": [0, 0, -1], "distance": 2}]}')
    for name in ("labels.png", "mine.png"):
        Image.fromarray(np.ones((4, 5), np.uint8)).save(tmp_path / name)
    assert read_labels(tmp_path / "labels.png").planes.tolist() == [[0, 0, -1, 2]]
    assert read_labels(tmp_path / "mine.png").planes is None


def test_archives_of_labels_say_where_there_are_readings(tmp_path):
    labels, path = np.array([[1, 2, 0, 1]]), tmp_path / "a.npz"
    np.savez(path, labels=labels, depth=[[0.0, np.nan, np.inf, 2.0]])
    assert read_labels(path).valid.tolist() == [[False, False, False, True]]
    np.savez(path, gt=labels * 7, plane_instance=labels)
    assert np.array_equal(read_labels(path).labels, labels * 7)
    for wrong, said in (
        ({"labels": labels / 2}, "must hold integer labels, got float64"),
        ({"labels": labels[0]}, r"must hold an image of shape \(H, W\), got shape \(4,\)"),
        ({"labels": labels, "depth": [[1.0, 2.0]]}, "has depth of float64"),
        ({"labels": labels, "planes": np.ones((2, 3))}, "has planes of shape"),
    ):
        np.savez(path, **wrong)
        with pytest.raises(PlanewiseError, match=said):
            read_labels(path)


def test_a_folder_of_one_frame_has_the_name_of_the_frame(tmp_path):
    (tmp_path / "room 1.5").mkdir()
    np.save(tmp_path / "room 2.5.npy", np.ones((4, 5), int))
    (tmp_path / "._room 2.5.npy").write_bytes(b"what some systems put beside files")
    Image.fromarray(np.ones((4, 5), np.uint8)).save(tmp_path / "room 1.5" / "labels.png")
    assert list(label_images(tmp_path)) == ["room 1.5", "room 2.5"]


@pytest.mark.parametrize("kind", [np.uint32, np.int32])
def test_tiffs_of_32_bits(tmp_path, kind):
    units = np.array([[0, 2000], [3000, np.iinfo(kind).max]], kind)
    write_tiff(tmp_path / "depth.tif", units)
    found = read_depth(tmp_path / "depth.tif").depth
    assert found.dtype == kind
    assert np.array_equal(found, units)


@pytest.mark.parametrize("kind", [np.uint16, np.int16, np.int32, np.float32])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("packed", [False, True])
def test_tiffs_of_both_byte_orders(tmp_path, kind, order, packed):
    """Of packed ones Pillow swaps some, which are in the machine's order already."""
    image = DEPTH.astype(kind)
    write_tiff(tmp_path / "depth.tif", image, order, packed)
    assert_array_equal(read_depth(tmp_path / "depth.tif").depth, image)
    if kind != np.float32:
        assert_array_equal(read_labels(tmp_path / "depth.tif").labels, image)


def test_a_picture_of_another_size_is_left_out_and_told(tmp_path, caplog):
    """Regions may be looked for in it."""
    path = tmp_path / "a.npz"
    np.savez(path, depth=np.ones((4, 5)), rgb=np.zeros((8, 10, 3), np.uint8))
    assert read_depth(path).rgb is None
    assert "a.npz: rgb has shape (8, 10, 3) and type uint8" in caplog.text
