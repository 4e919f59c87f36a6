from __future__ import annotations

import struct
import sys
import warnings
import zipfile
from concurrent.futures import ThreadPoolExecutor
from time import process_time
from types import SimpleNamespace

import laspy
import numpy as np
import plyfile
import pye57
import pytest
from laspy import VLR
from laspy.vlrs.vlrlist import VLRList
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from pye57 import libe57
from pypcd4 import Encoding
from pypcd4 import PointCloud as OtherCloud

from planewise.errors import MissingExtraError, PlanewiseError
from planewise.files.cloud import KINDS, open_cloud, read_cloud
from planewise.files.cloud_records import read_words
from planewise.files.depth import read_depth
from planewise.files.e57 import _colour, _limit, _middle
from planewise.files.las import copy_with_planes, write_las
from planewise.files.ply import write_ply
from planewise.kernels.lzf import unpack
from planewise.point_cloud import PointCloud, joined, less, offset_of
from tests.e57_files import spherical_e57

UTM = np.array([536_258.0, 6_581_099.0, 47.0])
FURTHER = np.array([536_262.0, 6_581_099.0, 47.0])


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-3, 3, (500, 3)).round(6)


@pytest.fixture
def colour():
    return np.random.default_rng(1).integers(0, 256, (500, 3)).astype(np.uint8)


def in_blocks(path, size=77):
    """Read by blocks, which must be no larger than asked for and agree with the whole."""
    file = open_cloud(path)
    blocks = list(file.chunks(size))
    assert all(len(block) <= size for block in blocks)
    whole = file.read()
    assert_array_equal(np.concatenate([block.points for block in blocks]), whole.points)
    assert all(np.array_equal(block.offset, file.offset) for block in blocks)
    assert file.count in (None, len(whole))
    return whole


@pytest.mark.parametrize("order", ["<", ">", "ascii"])
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_ply_of_another_writer(tmp_path, points, colour, order, kind):
    rows = np.empty(500, [*((n, kind) for n in "xyz"), ("red", "u1"), ("green", "u1"),
                          ("blue", "u1"), ("nx", "f4"), ("label", "i4")])  # fmt: skip
    for k, name in enumerate("xyz"):
        rows[name] = points[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        rows[name] = colour[:, k]
    rows["nx"], rows["label"] = 0.5, np.arange(500)
    element = plyfile.PlyElement.describe(rows, "vertex")
    faces = np.array([([0, 1, 2],)], [("vertex_indices", "i4", (3,))])
    other = plyfile.PlyElement.describe(faces, "face")
    path = tmp_path / "a.ply"
    text = order == "ascii"
    plyfile.PlyData(
        [element, other], text=text, byte_order="=" if text else order, comments=["x"]
    ).write(str(path))
    cloud = in_blocks(path)
    assert cloud.points.dtype == (np.float32 if kind == "f4" and not text else np.float64)
    assert_allclose(cloud.points, points, atol=0 if kind == "f8" else 3e-7)
    assert_array_equal(cloud.colour, colour)
    assert_array_equal(cloud.labels, np.arange(500))
    assert not cloud.offset.any()


def test_ply_of_ours_is_read_by_another_reader(tmp_path, points, colour):
    far = points + UTM
    blocks = (
        {"x": far[a:b, 0], "y": far[a:b, 1], "z": far[a:b, 2], "red": colour[a:b, 0],
         "plane": np.arange(a, b, dtype=np.uint16)}
        for a, b in ((0, 0), (0, 200), (200, 500))
    )  # fmt: skip
    write_ply(tmp_path / "a.ply", 500, blocks, ["by a test"])
    vertex = plyfile.PlyData.read(str(tmp_path / "a.ply"))["vertex"]
    assert_array_equal(np.stack([vertex[name] for name in "xyz"], axis=1), far)
    assert_array_equal(vertex["plane"], np.arange(500))
    assert_array_equal(vertex["red"], colour[:, 0])
    with pytest.raises(PlanewiseError, match="2 points came where 3 were announced"):
        write_ply(tmp_path / "b.ply", 3, [dict(zip("xyz", np.eye(3)[:, :2], strict=True))], [])
    write_ply(tmp_path / "none.ply", 0, [], [])
    assert len(read_cloud(tmp_path / "none.ply")) == 0


def test_ply_with_a_camera_and_elements_before_the_points(tmp_path, points):
    first = plyfile.PlyElement.describe(np.zeros(3, [("a", "f4"), ("b", "u1")]), "other")
    rows = np.array([tuple(row) for row in points], [(name, "f8") for name in "xyz"])
    camera = np.array([(1.0, 2.0, 3.0)], [(f"view_p{axis}", "f4") for axis in "xyz"])
    elements = [
        first,
        plyfile.PlyElement.describe(rows, "vertex"),
        plyfile.PlyElement.describe(np.zeros(5, [("c", "f8")]), "more"),
        plyfile.PlyElement.describe(camera, "camera"),
    ]
    plyfile.PlyData(elements).write(str(tmp_path / "a.ply"))
    cloud = in_blocks(tmp_path / "a.ply")
    assert_array_equal(cloud.points, points)
    assert_array_equal(cloud.origins, [[1, 2, 3]])


def test_the_place_of_a_scanner_is_relative_to_the_offset(tmp_path, points):
    place = np.add(UTM, (1.0, 2.0, 3.0))
    rows = np.array([tuple(row) for row in points + UTM], [(name, "f8") for name in "xyz"])
    camera = np.array([tuple(place)], [(f"view_p{axis}", "f8") for axis in "xyz"])
    elements = [
        plyfile.PlyElement.describe(rows, "vertex"),
        plyfile.PlyElement.describe(camera, "camera"),
    ]
    plyfile.PlyData(elements).write(str(tmp_path / "a.ply"))
    cloud = in_blocks(tmp_path / "a.ply")
    assert cloud.offset.any()
    assert_allclose(cloud.origins + cloud.offset, [place], atol=1e-9)


def test_labels_of_a_text_ply_may_be_missing(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 2\n"
    kinds = "".join(f"property {kind}\n" for kind in ("float x", "float y", "float z", "int label"))
    (tmp_path / "a.ply").write_text(head + kinds + "end_header\n1 2 3 nan\n4 5 6 7\n")
    assert_array_equal(read_cloud(tmp_path / "a.ply").labels, [0, 7])


def test_lists_before_the_points_of_a_binary_ply_are_refused(tmp_path, points):
    rows = np.array([tuple(row) for row in points], [(name, "f8") for name in "xyz"])
    faces = np.array([([0, 1, 2],)], [("vertex_indices", "i4", (3,))])
    elements = [
        plyfile.PlyElement.describe(faces, "face"),
        plyfile.PlyElement.describe(rows, "vertex"),
    ]
    plyfile.PlyData(elements).write(str(tmp_path / "a.ply"))
    with pytest.raises(PlanewiseError, match="lists before its points; write the element vertex"):
        open_cloud(tmp_path / "a.ply")
    plyfile.PlyData(elements, text=True).write(str(tmp_path / "b.ply"))
    assert_array_equal(in_blocks(tmp_path / "b.ply").points, points)  # a line each


@pytest.mark.parametrize("case", ["none", "not finite", "behind lists", "cut short"])
def test_ply_with_a_camera_that_says_nothing(tmp_path, points, case):
    rows = np.array([tuple(row) for row in points], [(name, "f8") for name in "xyz"])
    place = (np.nan if case == "not finite" else 1.0, 2.0, 3.0)
    camera = np.array([place] * (case != "none"), [(f"view_p{axis}", "f4") for axis in "xyz"])
    faces = np.array([([0, 1, 2],)], [("vertex_indices", "i4", (3,))])
    between = [plyfile.PlyElement.describe(faces, "face")] * (case == "behind lists")
    elements = [
        plyfile.PlyElement.describe(rows, "vertex"),
        *between,
        plyfile.PlyElement.describe(camera, "camera"),
        plyfile.PlyElement.describe(np.ones(9, [("c", "f8")]), "more"),
    ]
    plyfile.PlyData(elements).write(str(tmp_path / "a.ply"))
    if case == "cut short":
        whole = (tmp_path / "a.ply").read_bytes()
        (tmp_path / "a.ply").write_bytes(whole[: -9 * 8 - 4])  # in the camera
    cloud = in_blocks(tmp_path / "a.ply")
    assert_array_equal(cloud.points, points)
    assert cloud.origins is None


@pytest.mark.parametrize("encoding", [Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED])
def test_pcd_of_another_writer(tmp_path, points, colour, encoding):
    packed = OtherCloud.encode_rgb(colour)
    columns = [*points.astype(np.float32).T, packed, np.arange(500, dtype=np.uint16)]
    cloud = OtherCloud.from_points(
        columns,
        ("x", "y", "z", "rgb", "intensity"),
        (np.float32, np.float32, np.float32, np.float32, np.uint16),
    )
    cloud.metadata = cloud.metadata.derive(viewpoint=(1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0))
    path = tmp_path / "a.pcd"
    cloud.save(path, encoding)
    ours = in_blocks(path)
    assert_allclose(ours.points, points, atol=3e-7)
    if encoding != Encoding.ASCII:  # the other writer rounds the packed number away
        assert_array_equal(ours.colour, colour)
    assert_array_equal(ours.intensity, np.arange(500))
    assert_array_equal(ours.origins, [[1, 2, 3]])


@pytest.mark.parametrize(("name", "kind"), [("rgb", "F"), ("rgb", "U"), ("rgba", "U")])
def test_pcd_colours_as_the_point_cloud_library_writes_them(tmp_path, name, kind):
    packed = np.array([200 << 16 | 3 << 8 | 9], np.uint32)
    value = repr(float(packed.view(np.float32)[0])) if kind == "F" else str(packed[0])
    (tmp_path / "a.pcd").write_text(
        f"FIELDS x y z {name}\nSIZE 4 4 4 4\nTYPE F F F {kind}\nWIDTH 1\nHEIGHT 1\nDATA ascii\n"
        f"1 2 3 {value}\n"
    )
    assert_array_equal(read_cloud(tmp_path / "a.pcd").colour, [[200, 3, 9]])


def test_pcd_with_padding_counts_and_nan(tmp_path):
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x _ y z normal\nSIZE 4 1 4 4 4\nTYPE F U F F F\n"
        "COUNT 1 4 1 1 3\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA "
    )
    rows = [struct.pack("<f4sff3f", 1, b"abcd", 2, 3, 7, 8, 9) for _ in range(2)]
    path = tmp_path / "a.pcd"
    path.write_bytes(head.encode() + b"binary\n" + b"".join(rows))
    assert_array_equal(in_blocks(path).points, [[1, 2, 3]] * 2)
    path.write_text(head + "ascii\n1 9 9 9 9 2 3 7 8 9\nnan 9 9 9 9 nan nan 7 8 9\n")
    cloud = in_blocks(path)
    assert_array_equal(cloud.points, [[1, 2, 3], [np.nan] * 3])
    assert cloud.origins is None


def test_pcd_of_old_versions_has_columns_of_four_bytes(tmp_path, points):
    rows = points.astype("<f4")
    head = f"COLUMNS x y z\nPOINTS {len(rows)}\nDATA binary\n".encode()
    (tmp_path / "a.pcd").write_bytes(head + rows.tobytes())
    assert_array_equal(in_blocks(tmp_path / "a.pcd").points, rows)


def test_packed_pcd_has_one_field_after_the_other(tmp_path):
    """In files of many blocks, too, and with fields of several numbers a point."""
    import lzf

    rng = np.random.default_rng(0)
    normals, columns = rng.normal(size=(500, 3)).astype("<f4"), rng.integers(0, 9, (3, 500))
    data = normals.tobytes() + columns.astype("<f4").tobytes()
    packed = lzf.compress(data)
    head = "COLUMNS normal x y z\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 3 1 1 1\nWIDTH 500\n"
    path = tmp_path / "a.pcd"
    lengths = struct.pack("<II", len(packed), len(data))
    path.write_bytes(head.encode() + b"DATA binary_compressed\n" + lengths + packed)
    assert_array_equal(in_blocks(path).points, columns.T)


def test_unpacking_equals_a_plain_reading_of_the_format():
    import lzf

    def plain(packed):
        out, at = bytearray(), 0
        while at < len(packed):
            control, at = packed[at], at + 1
            if control < 32:
                out += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length, at = length + packed[at], at + 1
            back, at = ((control & 31) << 8) + packed[at] + 1, at + 1
            for _ in range(length + 2):
                out.append(out[-back])
        return bytes(out)

    rng = np.random.default_rng(0)
    for data in (bytes(5000), rng.integers(0, 3, 20_000, np.uint8).tobytes(), b"abc" * 3000):
        packed = lzf.compress(data)
        out = np.empty(len(data), np.uint8)
        assert unpack(np.frombuffer(packed, np.uint8), out) == len(data)
        assert out.tobytes() == plain(packed) == data
        short = np.empty(len(data) - 1, np.uint8)
        assert unpack(np.frombuffer(packed, np.uint8), short) == -1
        assert unpack(np.frombuffer(packed[:-1], np.uint8), out) < len(data)
    for packed in (b"\xe0", b"\x20\x00", b"\x05a", b"\x20", b"\x00a\x3f\xff"):
        assert unpack(np.frombuffer(packed, np.uint8), np.empty(99, np.uint8)) == -1


TEXTS = {
    "spaces.xyz": ("", " ", ""),
    "commas.csv": ("x,y,z,intensity\n", ",", ",7"),
    "semicolons.csv": ("Z;Y;X\n", ";", ""),
    "comment.txt": ("//X Y Z Intensity\n", " ", " 7"),
    "tabs.asc": ("# made by hand\n\n", "\t", "\t7"),
    "count.pts": ("500\n", " ", " 7 1 2 3"),
    "colours.xyz": ("", " ", " 1 2 3"),
    "ends.csv": ("x,y,z,Intensity,\n", ",", ",7,"),
    "ends.txt": ("", "; ", ";"),
    "normals.xyz": ("", " ", " 0.1 0.2 0.3"),
    "five.xyz": ("", " ", " 0.5 0.25"),
    "heights.csv": ("x,y,z,height\n", ",", ",5"),
    "whole numbers.xyz": ("", " ", " 1 2 300"),
    "units.csv": ("X [m],Y [m],Z [m],Intensity\n", ",", ",7"),
    "more units.txt": ("X (metres) Y (metres) Z (metres)\n", " ", ""),
    "map.csv": ("Easting,Northing,Elevation\n", ",", ""),
    "map.txt": ("# E N H i\n", " ", " 7"),
    "title.txt": ("A scan of 2024\nx y z\n", " ", ""),
    "text.csv": ("x,y,z,code,i\n", ",", ",WALL,7"),
    "text of any.csv": ("x,y,z,code,i\n", ",", ',"a, ""b""",7'),
    "text without names.csv": ("", ",", ",WALL"),
    "text and more.txt": ("", " ", " WALL 7"),
    "commas in text.csv": ("x;y;z;code;i\n", ";", ";WALL, old;7"),
    "quotes.csv": ("", ",", ',"7"'),
    "more quotes.txt": ('"x" "y" "z" "i"\n', " ", ' "7"'),
}


@pytest.mark.parametrize("name", TEXTS)
def test_text(tmp_path, points, name):
    head, delimiter, rest = TEXTS[name]
    order = (2, 1, 0) if head.startswith("Z") else (0, 1, 2)
    lines = [delimiter.join(repr(float(row[k])) for k in order) + rest for row in points]
    path = tmp_path / name
    path.write_text(head + "\n".join(lines) + "\n")
    cloud = in_blocks(path)
    assert_array_equal(cloud.points, points)
    assert (cloud.intensity is not None) == ("7" in rest)
    assert (cloud.colour is not None) == rest.endswith("1 2 3")
    if cloud.colour is not None:
        assert_array_equal(cloud.colour[-1], [1, 2, 3])


def test_scans_one_after_the_other(tmp_path, points):
    path = tmp_path / "scans.pts"
    lines = [f"{x!r} {y!r} {z!r} 5 1 2 3" for x, y, z in points.tolist()]
    path.write_text("\n".join(["200", *lines[:200], "0", "300", *lines[200:]]) + "\n")
    assert_array_equal(in_blocks(path).points, points)
    path.write_text("\n".join(["200", *lines[:200], "400", *lines[200:]]) + "\n")
    with pytest.raises(PlanewiseError, match="is cut short: 300 of 400 points are there"):
        in_blocks(path)


def test_the_first_of_several_scans_may_hold_no_points(tmp_path):
    path = tmp_path / "scans.pts"
    path.write_text("0\n2\n1 2 3\n4 5 6\n1\n7 8 9\n")
    assert_array_equal(in_blocks(path).points, [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    path.write_text("2\n2\n1 2 3\n4 5 6\n")
    with pytest.raises(PlanewiseError, match="has 1 number a line; a point has at least three"):
        read_cloud(path)


@pytest.mark.parametrize("full", [1.0, 255, 65535])
@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_dark_points_have_the_colours_of_their_file(tmp_path, full, suffix):
    """Whatever block they are read in: what colours are counted in is a matter of the file."""
    colour = np.array([[200, 10, 10], [1, 1, 1], [0, 0, 0], [1, 0, 1]])
    path, told = tmp_path / f"a{suffix}", colour * full / 255
    if suffix == ".npz":
        kind = np.float64 if full == 1 else np.uint16
        np.savez(path, points=np.eye(4, 3), colors=told.astype(kind))
    else:
        rows = np.hstack((np.eye(4, 3), told))
        np.savetxt(path, rows, delimiter=",", header="x,y,z,red,green,blue", comments="")
    for size in (1, 2, 100):
        blocks = [block.colour for block in open_cloud(path).chunks(size)]
        assert_array_equal(np.concatenate(blocks), colour)


def test_colours_after_many_dark_points_are_no_brighter_for_it(tmp_path):
    """What colours are counted in is told by the first points, unless others go beyond."""
    colour = np.zeros((10_100, 3), np.uint16)
    colour[:10_000], colour[10_000:] = 200, 25_700
    np.savez(tmp_path / "a.npz", points=np.zeros((10_100, 3)), colors=colour)
    assert_array_equal(open_cloud(tmp_path / "a.npz").read().colour[10_000:], 100)


def test_colours_that_were_rounded_to_a_little_above_1_are_shares_of_it(tmp_path):
    colour = np.array([[0.0, 0.5, 1 + 1e-7], [np.inf, 0.2, 0.0]])
    np.savez(tmp_path / "a.npz", points=np.eye(3)[:2], rgb=colour)
    assert_array_equal(read_cloud(tmp_path / "a.npz").colour, [[0, 128, 255], [255, 51, 0]])


@pytest.mark.parametrize(
    ("name", "kind", "value", "stated"),
    [
        ("a.ply", "uchar", "300", "uint8"),
        ("a.ply", "uint", "-1", "uint32"),
        ("a.ply", "float", "1e300", "float32"),
        ("a.pcd", "U", "1e20", "uint32"),
        ("a.pcd", "U", "nan", "uint32"),
        ("a.pcd", "F", "1e300", "float32"),
    ],
)
def test_text_that_its_header_cannot_hold_is_refused(tmp_path, name, kind, value, stated):
    heads = {
        "a.ply": f"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
        f"property float z\nproperty {kind} rgb\nend_header\n",
        "a.pcd": f"VERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F {kind}\nCOUNT 1 1 1 1\n"
        "WIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n",
    }
    (tmp_path / name).write_text(f"{heads[name]}0 0 0 0\n1 0 0 {value}\n")
    with pytest.raises(PlanewiseError, match=f"has rgb .*, where its header states {stated}"):
        read_cloud(tmp_path / name)


def test_whole_numbers_are_no_shares_of_full_colour(tmp_path):
    """However dark; of 16 bits the nearest of 8."""
    for colour, expected in (([1, 0, 1], [1, 0, 1]), ([65_535, 1000, 0], [255, 4, 0])):
        np.savez(tmp_path / "a.npz", points=np.ones((1, 3)), rgb=np.array([colour], np.uint16))
        assert_array_equal(read_cloud(tmp_path / "a.npz").colour, [expected])


def test_colours_that_are_missing_tell_nothing_of_the_others(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z,red,green,blue\n0,0,0,nan,nan,7\n0,0,1,nan,200,7\n")
    colour = open_cloud(tmp_path / "a.csv").read().colour
    assert_array_equal(colour, [[0, 0, 7], [0, 200, 7]])


def test_numbers_of_planes_that_are_none(tmp_path):
    """What no integer of 32 bits holds is the nearest of them; what is no number, no plane."""
    planes = ["7", "nan", "inf", "-inf", "1e10"]
    (tmp_path / "a.csv").write_text("x,y,z,plane\n" + "".join(f"1,2,3,{k}\n" for k in planes))
    assert read_cloud(tmp_path / "a.csv").labels.tolist() == [7, 0, 0, 0, 2**31 - 1]


def test_columns_of_a_cloud_are_of_one_kind():
    cloud = PointCloud(points=np.eye(3), intensity=[1, 2, 3], scan=[0.0, 1.0, 1.0])
    assert (cloud.intensity.dtype, cloud.scan.dtype) == (np.float32, np.int32)
    for name, values in (
        ("scan", [0.5, 1, 2]), ("labels", [2**40, 0, 0]), ("colour", [[0, 0, 300]] * 3),
        ("colour", [["a", "b", "c"]] * 3), ("intensity", [True, False, True]),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f"{name} must be numbers that u?(int|float)"):
            PointCloud(points=np.eye(3), **{name: values})


def test_threads_that_read_leave_filters_of_warnings_alone(tmp_path):
    """These belong to the whole process."""
    lines = "".join(f"{k},0,0\n" for k in range(300))
    (tmp_path / "a.csv").write_text("x,y,z\n" + lines)
    Image.fromarray(np.full((40, 50), 700, np.uint16)).save(tmp_path / "a.png")

    def read(_):
        list(open_cloud(tmp_path / "a.csv").chunks(3))
        for _ in range(20):
            read_depth(tmp_path / "a.png")

    before = list(warnings.filters)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(read, range(12)))
    assert warnings.filters == before


@pytest.mark.parametrize("first", [0, 1])
def test_empty_cells_are_missing_and_their_rows_stay(tmp_path, points, first):
    """As tables of pandas have them, where the last cell may be empty, too."""
    lines = [f"{x!r},{y!r},{z!r},{k}" for k, (x, y, z) in enumerate(points.tolist())]
    lines[first], lines[7], lines[9] = ",,,", lines[7].rpartition(",")[0] + ",", ",0,0,7"
    (tmp_path / "a.csv").write_text("x,y,z,i\n" + "\n".join(lines))
    cloud = in_blocks(tmp_path / "a.csv", 5)
    finite = np.ones(500, bool)
    finite[[first, 9]] = False
    assert_array_equal(np.isfinite(cloud.points).all(axis=1), finite)
    assert_array_equal(cloud.points[finite], points[finite])
    assert_array_equal(np.flatnonzero(np.isnan(cloud.intensity)), [first, 7])


@pytest.mark.parametrize("name", ["P", "1_"])  # 1_000 is a number of Python's alone
def test_points_may_have_names(tmp_path, points, name):
    rows = enumerate(points.tolist())
    lines = (f"{name}{k} {x!r} {y!r} {z!r}\n" for k, (x, y, z) in rows)
    (tmp_path / "a.txt").write_text("".join(lines))
    assert_array_equal(in_blocks(tmp_path / "a.txt").points, points)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("X [mm],Y [mm],Z [mm]\n1,2,3\n", r"one column x; its columns are X \[mm\]"),
        ("lat,lon,h\n1,2,3\n", "one column x; its columns are lat, lon"),
        ("x,y,elevation,height\n1,2,3,4\n", "one column z"),
        ("x,y,z,X\n1,2,3,4\n", "one column x; its columns are x, y, z, X"),
        ("x,y,z\nmade,by,hand\n1,2,3\n", "second line that is no point: 'made,by,hand'"),
        ("x,y,z,code\n1,2,3,A\n1,two,3,A\n", "number 2: expected 4 numbers, got '1,two,3,A'"),
        ("x,y,z,code\n1,2,3,A\n1,2,A\n", "number 2: expected 4 numbers, got '1,2,A'"),
        ("P1 1.0 2.0 3.0\n2 1.0 2.0 3.0\n", "number 1: expected 4 numbers, got 'P1 1.0 2"),
        ("1_1 1.0 2.0 3.0\nB 1.0 2.0\n", "number 2: expected 4 numbers, got 'B 1.0 2.0'"),
        ('"1,5","2","3","4"\n', "numbers with a decimal comma"),
        ("1,5;2;3;4\n", "numbers with a decimal comma"),
    ],
)
def test_tables_that_are_not_understood_are_refused(tmp_path, text, said):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(PlanewiseError, match=said):
        read_cloud(tmp_path / "a.csv")


@pytest.mark.parametrize("fraction", [0.0, 0.5])
@pytest.mark.parametrize("rest", ["7", "1 2 3", "7 1 2 3"])
def test_coordinates_that_count_are_no_numbers_of_points(tmp_path, rest, fraction):
    """A raster's x counts along each of its rows, however long these are."""
    y, x = np.mgrid[5_740_000:5_740_004, 592_000:595_000]
    raster = np.column_stack((x.ravel(), y.ravel() + fraction, np.round(80 + 0.01 * x.ravel(), 2)))
    lines = (f"{x:.0f} {y:.8g} {z:.2f} {rest}\n" for x, y, z in raster.tolist())
    (tmp_path / "a.xyz").write_text("".join(lines))
    assert_array_equal(open_cloud(tmp_path / "a.xyz").read().coordinates, raster)


NUMBERS = {
    "from 100": np.arange(100, 600),
    "in tens": np.arange(500) * 10 + 10,
    "with gaps": np.arange(500) + np.arange(500) // 7,
    "shuffled": np.random.default_rng(0).permutation(500),
}


@pytest.mark.parametrize("code", ["", ",7"])
@pytest.mark.parametrize("numbers", NUMBERS)
def test_numbers_of_the_points_are_no_coordinates(tmp_path, points, numbers, code):
    rows = zip(NUMBERS[numbers], points.tolist(), strict=True)
    path = tmp_path / "a.csv"
    path.write_text("".join(f"{k},{x!r},{y!r},{z!r}{code}\n" for k, (x, y, z) in rows))
    cloud = in_blocks(path)
    assert_array_equal(cloud.points, points)
    assert (cloud.intensity is not None) == bool(code)


@pytest.mark.parametrize("count", [9, 10])
def test_a_few_points_may_be_counted_by_chance(tmp_path, points, count):
    rows = enumerate(points[:count].tolist())
    (tmp_path / "a.xyz").write_text("".join(f"{k} {x!r} {y!r} {z!r}\n" for k, (x, y, z) in rows))
    cloud = read_cloud(tmp_path / "a.xyz")
    first = points[:count, 0] if count == 10 else np.arange(count)
    assert_array_equal(cloud.points[:, 0], first)
    assert (cloud.intensity is not None) == (count == 9)


@pytest.mark.parametrize(
    "case", ["whole", "one row", "its first row", "but heights", "with gaps", "two scans"]
)
def test_a_column_that_may_be_x_or_numbers_is_refused(tmp_path, points, case):
    """Unless names say which it is."""
    whole = (points * 1000).astype(int)
    k = np.arange(500)
    table = {
        "whole": np.column_stack((k + 5001, whole)),
        "one row": np.column_stack((k + 592_000, np.full(500, 5_740_000), whole[:, :2])),
        "its first row": np.column_stack((k, np.full(500, 5_740_000), whole[:, :2])),
        "but heights": np.column_stack((k + 5001, whole[:, :2], points[:, 2])),
        "with gaps": np.column_stack((k + k // 7, whole)),
        "two scans": np.column_stack((k % 250, points)),
    }[case]
    lines = "".join(
        f"{row[0]:.0f} " + " ".join(f"{x:.8g}" for x in row[1:]) + "\n" for row in table
    )
    path = tmp_path / "a.xyz"
    path.write_text(lines)
    with pytest.raises(PlanewiseError, match=r"x or numbers of the points.*'x y z intensity' or"):
        read_cloud(path)
    path.write_text("number x y z\n" + lines)
    assert_array_equal(read_cloud(path).coordinates, table[:, 1:])


@pytest.mark.parametrize(
    "head",
    [
        "# Units: x y z in metres\n",
        "# x y z [m]\n",
        "// this has x y and z of points\n500\n",
        "//X Y Z\n500\n",
        "500\n//X Y Z\n",
        "# of x y z, that is\nx y z\n",
    ],
)
def test_remarks_may_name_coordinates(tmp_path, points, head):
    path = tmp_path / "a.asc"
    path.write_text(head + "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()))
    assert_array_equal(in_blocks(path).points, points)


def test_a_remark_may_hold_the_last_word_of_a_header(tmp_path):
    path = tmp_path / "a.ply"
    head = "ply\nformat ascii 1.0\ncomment end_header is below\nelement vertex 2\n"
    rows = "property float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n4 5 6\n"
    path.write_text(head + rows)
    assert_array_equal(read_cloud(path).points, [[1, 2, 3], [4, 5, 6]])


def test_text_with_tabs_and_spaces(tmp_path, points):
    path = tmp_path / "mixed.xyz"
    path.write_text("".join(f"{x!r}\t{y!r}  {z!r}\n" for x, y, z in points.tolist()))
    assert_array_equal(in_blocks(path).points, points)
    for between in (" ,\t", "; ", ",\t "):  # spaces and tabs beside what stands between numbers
        lines = (between.join(map(repr, row)) + "\n" for row in points.tolist())
        path.write_text("".join(lines))
        assert_array_equal(in_blocks(path).points, points)


@pytest.mark.parametrize("fortran", [False, True])
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_npz(tmp_path, points, colour, fortran, save):
    array = np.asfortranarray(points) if fortran else points
    path = tmp_path / "a.npz"
    save(path, points=array, rgb=colour, gt=np.arange(500), intensity=np.ones(500), offset=UTM,
         origins=np.ones((2, 3)), scan=np.arange(500) % 2)  # fmt: skip
    cloud = in_blocks(path)
    assert_array_equal(cloud.points, points)
    assert_array_equal(cloud.offset, UTM)
    assert_array_equal(cloud.colour, colour)
    assert_array_equal(cloud.labels, np.arange(500))
    assert_array_equal(cloud.scan, np.arange(500) % 2)
    assert_array_equal(cloud.origins, np.ones((2, 3)))
    save(path, points=array + UTM, origins=np.ones((2, 3)) + UTM)  # nothing was subtracted yet
    far = in_blocks(path)
    assert_allclose(far.origins + far.offset, np.ones((2, 3)) + UTM, atol=1e-6)
    assert abs(far.origins).max() < 1e3
    np.save(tmp_path / "a.npy", array.astype(np.float32))
    assert in_blocks(tmp_path / "a.npy").points.dtype == np.float32


def las_file(path, points, colour, version="1.4", point_format=7):
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales, header.offsets = np.full(3, 0.001), np.floor(points.min(axis=0))
    data = laspy.LasData(header)
    data.x, data.y, data.z = points.T
    data.intensity = np.arange(len(points))
    data.classification = np.arange(len(points)) % 5
    data.red, data.green, data.blue = colour.astype(np.uint16).T * 257
    data.write(path)
    return data


GEOGCS = 'GEOGCS["b",DATUM["d",SPHEROID["s",6378137,298]],PRIMEM["g",0],UNIT["degree",0.0174]]'
BASE = 'BASEGEOGCRS["b",DATUM["d",ELLIPSOID["e",6378137,298,LENGTHUNIT["metre",1]]]]'
EASTING = 'CONVERSION["c",METHOD["m"],PARAMETER["False easting",0,LENGTHUNIT["metre",1]]]'
UP = 'VERTCRS["v",VDATUM["d"],CS[vertical,1],AXIS["height (H)",up,LENGTHUNIT["{}",1]]]'
PLANE = 'AXIS["e (E)",east,LENGTHUNIT["{0}",1]],AXIS["n",north,LENGTHUNIT["{0}",1]]'
UNITS = {
    f'PROJCS["a",{GEOGCS},UNIT["metre",1,AUTHORITY["EPSG","9001"]]]': "",
    f'COMPD_CS["c",PROJCS["a",{GEOGCS},UNIT["Meter",1]],VERT_CS["v",UNIT["m",1]]]': "",
    f'COMPD_CS["c",PROJCS["a",{GEOGCS},UNIT["metre",1]],VERT_CS["v",UNIT["foot",0.3]]]': (
        "metres, heights in foot"
    ),
    f'PROJCS["a",{GEOGCS},UNIT["foot",0.3]],VERTCS["v",UNIT["foot",0.3]]': "foot",
    GEOGCS: "degrees",
    f'COMPD_CS["c",{GEOGCS},VERT_CS["v",UNIT["metre",1]]]': "degrees, heights in metres",
    'GEOCCS["a",DATUM["d",SPHEROID["s",6378137,298]],UNIT["metre",1]]': "",
    f'PROJCRS["a",{BASE},{EASTING},CS[Cartesian,2],AXIS["e",east],LENGTHUNIT["foot",0.3]]': "foot",
    f'PROJCRS["a",{BASE},{EASTING},CS[Cartesian,2],{PLANE.format("foot")}]': "foot",
    f'COMPOUNDCRS["c",PROJCRS["a",{BASE},{EASTING},{PLANE.format("metre")}],{UP.format("foot")}]': (
        "metres, heights in foot"
    ),
    f'COMPOUNDCRS["c",PROJCRS["a",{BASE},{PLANE.format("metre")}],{UP.format("metre")}]': "",
    'GEOGCRS["a",DATUM["d",ELLIPSOID["e",6378137,298]],CS[ellipsoidal,2],ANGLEUNIT["degree",0]]': (
        "degrees"
    ),
    f'BOUNDCRS[SOURCECRS[PROJCRS["a",{BASE},UNIT["foot",0.3]]],TARGETCRS[{GEOGCS}]]': "foot",
    "]]](1[": "",
    (1024, 1, 3072, 2263): "",
    (1024, 1, 3072, 26918, 3076, 9001, 4099, 9001): "",
    (1024, 1, 3072, 26918, 3076, 9001, 4099, 9003): "metres, heights in US survey feet",
    (1024, 1, 3072, 2263, 4099, 9003): "the unit of their projection, heights in US survey feet",
    (1024, 1, 3076, 9003, 4099, 9003): "US survey feet",
    (1024, 2, 2048, 4326): "degrees",
}


@pytest.mark.parametrize("said", UNITS, ids=range(len(UNITS)))
def test_units_of_a_las_file_that_are_no_metres_are_told(tmp_path, said):
    header = laspy.LasHeader(point_format=3, version="1.2")
    if isinstance(said, str):
        header.vlrs.append(VLR("LASF_Projection", 2112, "", said.encode()))
    else:
        keys = [
            word
            for key in zip(said[::2], said[1::2], strict=True)
            for word in (key[0], 0, 1, key[1])
        ]
        data = struct.pack(f"<{4 + len(keys)}H", 1, 1, 0, len(said) // 2, *keys)
        header.vlrs.append(VLR("LASF_Projection", 34735, "", data))
    laspy.LasData(header).write(tmp_path / "a.las")
    assert open_cloud(tmp_path / "a.las").unit == UNITS[said]


@pytest.mark.parametrize("ending", [".las", ".laz"])
def test_las_keeps_what_its_whole_numbers_say(tmp_path, points, colour, ending):
    path = tmp_path / f"a{ending}"
    data = las_file(path, points + UTM, colour)
    cloud = in_blocks(path)
    whole = np.stack((data.X, data.Y, data.Z), axis=1).astype(np.int64)
    # Exact in whole millimetres: offset and header's offset are whole metres.
    exact = whole + ((data.header.offsets - cloud.offset) * 1000).round().astype(np.int64)
    assert_allclose(cloud.points, exact / 1000, rtol=0, atol=1e-12)
    assert np.abs(cloud.points).max() < 200
    assert_array_equal(cloud.colour, colour)
    assert_array_equal(cloud.intensity, np.arange(500))
    bounds = open_cloud(path).bounds
    assert_allclose(bounds, [cloud.coordinates.min(0), cloud.coordinates.max(0)], atol=2e-3)


def test_points_behind_a_short_header_are_no_numbers_of_records(tmp_path, points, colour):
    """In LAS 1.3 the height of the first point is where 1.4 counts the records at the end."""
    points[0, 2] += 4000
    las_file(tmp_path / "a.las", points, colour, "1.3", 3)
    assert_allclose(read_cloud(tmp_path / "a.las").coordinates, points, atol=6e-4)


@pytest.mark.parametrize("ending", [".las", ".laz"])
@pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 7)])
def test_las_copies_keep_every_field(tmp_path, points, colour, ending, version, point_format):
    source, target = tmp_path / f"a{ending}", tmp_path / f"b{ending}"
    before = las_file(source, points + UTM, colour, version, point_format)
    if version == "1.4":
        before.evlrs = VLRList([VLR("me", 7, "behind the points", b"data")])
        before.write(source)
    labels = (np.arange(500) % 7).astype(np.uint16)
    copy_with_planes(source, target, labels, size=64)
    after = laspy.read(target)
    for name in before.point_format.dimension_names:
        assert_array_equal(after[name], before[name], err_msg=name)
    assert [each.record_data for each in after.evlrs or []] == [b"data"] * (version == "1.4")
    assert_array_equal(after["plane"], labels)
    assert_array_equal(after.header.scales, before.header.scales)
    copy_with_planes(target, tmp_path / f"c{ending}", labels[::-1].copy())  # once more
    assert_array_equal(read_cloud(tmp_path / f"c{ending}").labels, labels[::-1])


def test_las_copies_keep_scaled_fields_as_they_are_stored(tmp_path, points, colour):
    """Scaled to floats and back, numbers are rounded, or no longer fit."""
    data = las_file(tmp_path / "a.las", points, colour)
    time = np.arange(10**18, 10**18 + 500, dtype=np.uint64)
    place = np.arange(-750, 750, dtype=np.int16).reshape(500, 3)
    data.add_extra_dim(laspy.ExtraBytesParams("time", "u8", scales=[1e-9], offsets=[0.0]))
    data.add_extra_dim(
        laspy.ExtraBytesParams("place", "3i2", scales=[0.01] * 3, offsets=[0.0, 0.0, 1000.0])
    )
    data.points.array["time"], data.points.array["place"] = time, place
    data.write(tmp_path / "a.las")
    copy_with_planes(tmp_path / "a.las", tmp_path / "b.las", np.ones(500, np.uint16))
    after = laspy.read(tmp_path / "b.las").points.array
    assert_array_equal(after["time"], time)
    assert_array_equal(after["place"], place)


def test_the_order_of_a_copc_file_is_not_copied(tmp_path, points, colour):
    source, target = tmp_path / "a.copc.laz", tmp_path / "b.laz"
    before = las_file(source, points + UTM, colour)
    before.header.vlrs.append(VLR("copc", 1, "copc info", bytes(160)))
    before.header.vlrs.append(VLR("me", 7, "mine", b"data"))
    before.write(source)
    labels = (np.arange(500) % 7).astype(np.uint16)
    copy_with_planes(source, target, labels)
    after = laspy.read(target)
    assert [each.user_id for each in after.header.vlrs if each.user_id in ("copc", "me")] == ["me"]
    assert_array_equal(after["plane"], labels)
    assert_array_equal(after.X, before.X)


@pytest.mark.parametrize(
    ("kind", "kept"), [(np.uint8, np.uint16), (np.int32, np.int32), (np.float32, np.float32)]
)
def test_labels_fit_a_dimension_of_their_name(tmp_path, points, colour, kind, kept):
    source, target = tmp_path / "a.las", tmp_path / "b.las"
    data = las_file(source, points, colour)
    data.add_extra_dim(laspy.ExtraBytesParams("plane", kind))
    data.add_extra_dim(laspy.ExtraBytesParams("behind", np.float64))
    data["behind"] = np.arange(500) / 8
    data.write(source)
    labels = np.arange(500, dtype=np.uint16)
    copy_with_planes(source, target, labels)
    after = laspy.read(target)
    assert after["plane"].dtype == kept
    assert_array_equal(after["plane"], labels)
    assert_array_equal(after["behind"], data["behind"])
    assert_array_equal(after.X, data.X)


@pytest.mark.parametrize(
    "there",
    [
        {"type": np.int32, "scales": [10.0], "offsets": [0.0]},
        {"type": np.uint8, "scales": [0.5], "offsets": [1.0]},
        {"type": "3f4"},
    ],
)
def test_a_dimension_that_cannot_hold_labels_is_replaced(tmp_path, points, colour, there):
    source, target = tmp_path / "a.las", tmp_path / "b.las"
    data = las_file(source, points, colour)
    data.add_extra_dim(laspy.ExtraBytesParams("plane", **there))
    data.write(source)
    assert len(read_cloud(source)) == 500
    labels = (np.arange(500) % 7).astype(np.uint16)
    copy_with_planes(source, target, labels)
    assert_array_equal(laspy.read(target)["plane"], labels)


@pytest.mark.parametrize("north", [5_000_000, 1_000_000])  # the first is beyond 32 bits of 1 mm
def test_bounds_that_were_never_filled_in_do_not_say_where_points_are(
    tmp_path, points, colour, north
):
    path = tmp_path / "a.las"
    las_file(path, points + np.array([500_000, north, 0]), colour).write(path)
    before = read_cloud(path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<6d", data, 179, *[0.0] * 6)
    path.write_bytes(data)
    after = open_cloud(path)
    assert after.bounds is None
    assert np.abs(after.offset - before.offset).max() <= 100
    after = after.read()
    assert_allclose(after.points + after.offset, before.points + before.offset, atol=1e-9)


def test_the_offset_of_a_las_file_is_near_the_middle_of_its_bounds(tmp_path):
    """However much of what is read first lies at one end."""
    points = np.repeat([[500_010.0, 7.0, 3.0], [502_030.0, 7.0, 3.0]], [10_001, 9], axis=0)
    las_file(tmp_path / "a.las", points, np.zeros((len(points), 3), np.uint8))
    assert_array_equal(open_cloud(tmp_path / "a.las").offset, [501_000, 0, 0])


def test_a_file_without_points_has_no_bounds(tmp_path):
    las_file(tmp_path / "a.las", np.ones((1, 3)), np.zeros((1, 3), np.uint8))
    whole = laspy.read(tmp_path / "a.las")
    whole.points = whole.points[:0]
    whole.write(tmp_path / "a.las")
    file = open_cloud(tmp_path / "a.las")
    assert (file.count, file.bounds, len(file.read())) == (0, None, 0)


@pytest.mark.parametrize("wrong", [1e300, -1e300, np.nan, np.inf])
def test_bounds_that_no_point_can_have_do_not_move_the_points(tmp_path, points, colour, wrong):
    path = tmp_path / "a.las"
    las_file(path, points, colour).write(path)
    before = read_cloud(path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<6d", data, 179, *[wrong] * 6)
    path.write_bytes(data)
    after = read_cloud(path)
    assert np.abs(after.offset - before.offset).max() <= 100
    assert_allclose(after.points + after.offset, before.points + before.offset, atol=1e-9)


@pytest.mark.parametrize("scale", [1e300, 0.0, -0.001, np.nan])
def test_scales_that_are_none_are_refused(tmp_path, points, colour, scale):
    path = tmp_path / "a.las"
    las_file(path, points, colour).write(path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<3d", data, 131, *[scale] * 3)
    path.write_bytes(data)
    with pytest.raises(PlanewiseError, match="that are none"):
        read_cloud(path)


def test_coordinates_of_a_damaged_file_may_be_of_any_size(tmp_path):
    rows = np.linspace(-3e38, -2.99e38, 300).astype(np.float32).reshape(100, 3)
    rows[4] = 3e38
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 100\nHEIGHT 1\nPOINTS 100\n"
    path = tmp_path / "damaged.pcd"
    path.write_bytes(head.encode() + b"DATA binary\n" + rows.tobytes())
    cloud = read_cloud(path)
    assert_array_equal(np.isfinite(cloud.points).all(axis=1), np.arange(100) != 4)


def test_strays_do_not_cost_the_others_digits(tmp_path, points):
    cloud = PointCloud(points=points.copy(), offset=UTM)
    bounds = np.array((points.min(0), points.max(0))) + UTM
    cloud.points[:3] = -UTM  # missing ones, at the origin of the map
    path = tmp_path / "a.las"
    write_las(path, [(cloud, np.ones(500, np.uint16), np.zeros((500, 3), np.uint8))], bounds)
    kept = laspy.read(path)
    assert len(kept) == 497
    assert_allclose(kept.xyz, points[3:] + UTM, atol=6e-6)


@pytest.mark.parametrize(("brightest", "expected"), [(255.0, [0, 1, 200]), (0.5, [0, 32768, 0])])
def test_intensities_of_all_blocks_are_scaled_alike(tmp_path, points, brightest, expected):
    values = np.array([0, 1, 200] if brightest > 1 else [0, 0.5, 0], np.float32)
    blocks = [
        (
            PointCloud(points=points[k : k + 1], intensity=values[k : k + 1]),
            np.zeros(1, np.uint16),
            np.zeros((1, 3), np.uint8),
        )
        for k in range(3)
    ]
    path = tmp_path / "a.las"
    write_las(path, blocks, np.array((points.min(0), points.max(0))), brightest)
    assert laspy.read(path).intensity.tolist() == expected


@pytest.mark.parametrize("ending", [".las", ".laz"])
def test_las_of_ours(tmp_path, points, colour, ending):
    cloud = PointCloud(points=points, offset=UTM, intensity=np.linspace(0, 1, 500, dtype="f4"))
    cloud.points[7] = np.nan
    labels = (np.arange(500) % 7).astype(np.uint16)
    keep = np.arange(500) != 7
    bounds = np.array((points[keep].min(0), points[keep].max(0))) + UTM
    path = tmp_path / f"a{ending}"
    write_las(path, [(cloud, labels, colour)], bounds)
    data = laspy.read(path)
    assert_allclose(data.xyz, cloud.coordinates[keep], atol=1e-5)
    assert_array_equal(data.header.scales, 1e-5)  # finer steps are no measurement
    assert_array_equal(data["plane"], labels[keep])
    assert_array_equal(data.green, colour[keep, 1].astype(int) * 257)
    assert int(data.intensity.max()) == 65535


def test_laz_of_a_stream_has_its_table_at_the_end(tmp_path, points, colour):
    """A writer that cannot go back leaves -1 where the place of the table belongs."""
    path = tmp_path / "a.laz"
    las_file(path, points, colour)
    before, data = read_cloud(path), bytearray(path.read_bytes())
    (start,) = struct.unpack_from("<I", data, 96)
    place = data[start : start + 8]
    data[start : start + 8] = struct.pack("<q", -1)
    path.write_bytes(data + place)
    assert_array_equal(read_cloud(path).points, before.points)


def e57_file(path, scans):
    with pye57.E57(str(path), mode="w") as file:
        for data, rotation, translation in scans:
            file.write_scan_raw(
                data, rotation=np.array(rotation, float), translation=np.array(translation, float)
            )


def rewritten_xml(path, change):
    """Write the XML of an E57 file anew, and the checksums of all its pages."""
    raw = path.read_bytes()
    data = b"".join(raw[k : k + 1020] for k in range(0, len(raw), 1024))
    place, size = struct.unpack_from("<2Q", data, 24)
    start = place // 1024 * 1020 + place % 1024
    xml = change(data[start : start + size])
    data = data[:start] + xml
    data += bytes(-len(data) % 1020)
    length = len(data) // 1020 * 1024
    data = data[:16] + struct.pack("<3Q", length, place, len(xml)) + data[40:]
    pages = (data[k : k + 1020] for k in range(0, len(data), 1020))
    path.write_bytes(b"".join(page + struct.pack(">I", crc32c(page)) for page in pages))


def crc32c(data):
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def within(xml, what):
    return xml.replace(b"</e57Root>", what + b"</e57Root>")


E57_XML = {
    "has XML with a DOCTYPE": lambda xml: xml.replace(
        b"<e57Root", b'<!DOCTYPE e57Root [<!ENTITY x SYSTEM "file:///etc/hostname">]><e57Root', 1
    ),
    "names a schema in another file": lambda xml: xml.replace(
        b"<e57Root",
        b'<e57Root xmlns:s="http://www.w3.org/2001/XMLSchema-instance" '
        b's:schemaLocation="http://www.astm.org/COMMIT/E57/2010-e57-v1.0 file:///dev/null"',
        1,
    ),
    "more than 100 elements in one another": lambda xml: within(
        xml, b'<a type="Structure">' * 100 + b"</a>" * 100
    ),
    "has XML in ISO-8859-1; that of E57 is in UTF-8": lambda xml: xml.replace(
        b"UTF-8", b"ISO-8859-1"
    ),
    "has XML in UTF-16 or UTF-32": lambda xml: xml.decode().partition("?>")[2].encode("utf-16"),
}


@pytest.mark.parametrize("said", E57_XML)
def test_e57_xml_that_is_more_than_its_scans_is_refused(tmp_path, points, said):
    path = tmp_path / "a.e57"
    names = ("cartesianX", "cartesianY", "cartesianZ")
    e57_file(path, [(dict(zip(names, points.T.copy(), strict=True)), (1, 0, 0, 0), UTM)])
    rewritten_xml(path, lambda xml: within(xml, b'<a type="Structure"/>'))
    assert len(read_cloud(path)) == 500
    rewritten_xml(path, E57_XML[said])
    with pytest.raises(PlanewiseError, match=said):
        open_cloud(path)


@pytest.mark.parametrize(
    ("at", "number", "said"),
    [
        (24, 2**63, "is cut short: 0 of .* bytes of its XML are there"),
        (32, 2**25 + 1, "claims 33,554,433 bytes of XML; at most 33,554,432 are read"),
        (40, 512, "claims pages of 512 bytes"),
    ],
)
def test_e57_headers_are_held_against_their_file(tmp_path, points, at, number, said):
    path = tmp_path / "a.e57"
    names = ("cartesianX", "cartesianY", "cartesianZ")
    e57_file(path, [(dict(zip(names, points.T.copy(), strict=True)), (1, 0, 0, 0), UTM)])
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, at, number)
    path.write_bytes(data)
    with pytest.raises(PlanewiseError, match=said):
        open_cloud(path)


def test_e57_scans_are_moved_to_their_poses(tmp_path, points, colour):
    half = np.sqrt(0.5)  # the writer has single precision
    names = ("cartesianX", "cartesianY", "cartesianZ")
    local = dict(zip(names, points.T.copy(), strict=True))
    rich = local | {"intensity": np.linspace(0, 1, 500, dtype=np.float32)}
    rich |= {f"color{name}": colour[:, k].copy() for k, name in enumerate(("Red", "Green", "Blue"))}
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    path = tmp_path / "a.e57"
    e57_file(path, [(rich, (half, 0, 0, half), UTM), (rich, (1, 0, 0, 0), FURTHER)])
    cloud = in_blocks(path)
    assert_allclose(cloud.points[:500], points @ turn.T + (UTM - cloud.offset), atol=5e-7)
    assert_allclose(cloud.points[500:], points + (FURTHER - cloud.offset), atol=5e-7)
    assert np.abs(cloud.points).max() < 200
    assert_array_equal(cloud.scan, np.repeat([0, 1], 500))
    assert_allclose(cloud.origins + cloud.offset, [UTM, FURTHER])
    assert_array_equal(cloud.colour[:500], colour)
    assert_allclose(cloud.intensity[:500], np.linspace(0, 1, 500), atol=1e-6)
    other = pye57.E57(str(path)).read_scan(0, ignore_missing_fields=True)
    assert_allclose(cloud.coordinates[:500, 1], other["cartesianY"], atol=1e-8)


def test_e57_points_marked_as_invalid_are_left_out(tmp_path, points):
    names = ("cartesianX", "cartesianY", "cartesianZ")
    data = dict(zip(names, points.T.copy(), strict=True))
    data["cartesianInvalidState"] = (np.arange(500) % 5 == 0).astype(np.int8)
    e57_file(tmp_path / "a.e57", [(data, (1, 0, 0, 0), (0, 0, 0))])
    assert open_cloud(tmp_path / "a.e57").count is None
    assert_allclose(in_blocks(tmp_path / "a.e57").points, points[np.arange(500) % 5 > 0])


def test_e57_of_range_and_angles(tmp_path, points):
    flat = np.hypot(points[:, 0], points[:, 1])
    polar = {
        "sphericalRange": np.linalg.norm(points, axis=1),
        "sphericalAzimuth": np.arctan2(points[:, 1], points[:, 0]),
        "sphericalElevation": np.arctan2(points[:, 2], flat),
    }
    marked = polar | {"sphericalInvalidState": (np.arange(500) % 5 % 3).astype(np.int8)}
    half, turn = np.sqrt(0.5), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    path = tmp_path / "a.e57"
    spherical_e57(path, [(marked, ((half, 0, 0, half), UTM)), (polar, ((1, 0, 0, 0), FURTHER))])
    cloud = in_blocks(path)
    valid = points[np.arange(500) % 5 % 3 == 0]
    assert np.abs(cloud.points).max() < 200
    assert_allclose(cloud.points[:200], valid @ turn.T + (UTM - cloud.offset), atol=5e-6)
    assert_allclose(cloud.points[200:], points + (FURTHER - cloud.offset), atol=5e-6)
    assert_array_equal(cloud.scan, np.repeat([0, 1], (200, 500)))
    assert_allclose(cloud.origins + cloud.offset, [UTM, FURTHER])
    other = pye57.E57(str(path)).read_scan(0, ignore_missing_fields=True)
    assert_allclose(cloud.coordinates[:200, 0], other["cartesianX"], atol=1e-8)
    spherical_e57(path, [(polar, None)])
    assert_allclose(in_blocks(path).points, points, atol=5e-6)


def e57_node(file, values):
    node = libe57.StructureNode(file.image_file)
    for name, value in values.items():
        node.set(name, libe57.FloatNode(file.image_file, float(value)))
    return node


@pytest.mark.parametrize("limits", [{"colorRedMaximum": 1023}, {"colorRedMaximum": 0}, {}])
def test_e57_colours_go_up_to_the_limit_of_their_scan(tmp_path, limits):
    header = type("Header", (dict,), {"scan_fields": ["colorLimits"]})()
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        header["colorLimits"] = e57_node(file, limits)
        limit = _limit(header)
    most = limits.get("colorRedMaximum", 255) or 255  # of a limit of 0 colours are as they are
    names = ("colorRed", "colorGreen", "colorBlue")
    columns = dict.fromkeys(names, np.array([0.0, most / 3, most]))
    assert_array_equal(_colour(columns, limit), [[0] * 3, [85] * 3, [255] * 3])


@pytest.mark.parametrize("moved", [False, True])
def test_e57_bounds_may_be_those_of_the_scan_or_of_the_file(tmp_path, moved):
    """The offset is near the middle of the points either way."""
    low = np.array([-3.0, 2, 0]) + moved * UTM
    bounds = {f"{axis}Minimum": value for axis, value in zip("xyz", low, strict=True)}
    bounds |= {f"{axis}Maximum": value for axis, value in zip("xyz", low + 4, strict=True)}
    header = SimpleNamespace(has_pose=lambda: True, rotation_matrix=np.eye(3), translation=UTM)
    header.scan_fields = ["cartesianBounds"]
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        header.cartesianBounds = e57_node(file, bounds)
        assert_allclose(_middle(header), np.add(UTM, (-1, 4, 2)))


@pytest.mark.parametrize("ending", [".ply", ".xyz", ".npy"])
def test_coordinates_of_a_map_grid_lose_nothing(tmp_path, points, ending):
    far = points + UTM
    path = tmp_path / f"a{ending}"
    if ending == ".ply":
        write_ply(path, 500, [dict(zip("xyz", far.T, strict=True))], [])
    elif ending == ".npy":
        np.save(path, far)
    else:
        path.write_text("\n".join(" ".join(map(repr, row)) for row in far.tolist()))
    cloud = in_blocks(path)
    assert np.abs(cloud.points).max() < 200
    assert_array_equal(cloud.coordinates, far)  # to the last bit
    assert not (cloud.offset % 100).any()


def test_subtraction_of_an_offset_is_exact():
    from fractions import Fraction

    rng = np.random.default_rng(3)
    for kind in (np.float32, np.float64):
        far = (rng.uniform(-60, 60, (200, 3)) + UTM).astype(kind)
        offset = offset_of(far)
        near = less(far, offset)
        assert near.dtype == kind
        for a, b in zip(far.ravel(), near.ravel(), strict=True):
            assert Fraction(float(a)) - Fraction(float(b)) in map(Fraction, offset.tolist())
    assert not offset_of(np.full((3, 3), np.nan)).any()


def write_bad(folder, name):
    """Write a file that cannot be used, and return it."""
    head = "ply\nformat {} 1.0\nelement vertex {}\n{}end_header\n"
    xyz = "".join(f"property float {axis}\n" for axis in "xyz")
    pcd = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\n"
        "POINTS {0}\nDATA {1}\n"
    )
    little = "binary_little_endian"
    few = np.ones((4, 3), np.float32)
    made = {
        "empty.ply": b"",
        "empty.xyz": b"",
        "blank.csv": b"\n\n",
        "names only.csv": b"x,y,z\n",
        "junk.ply": b"junk" * 99,
        "junk.pcd": b"junk" * 99,
        "junk.xyz": bytes(range(256)),
        "junk.npy": b"junk" * 99,
        "junk.npz": b"junk" * 99,
        "junk.las": b"junk" * 99,
        "junk.laz": b"LASF" + bytes(400),
        "junk.e57": b"junk" * 99,
        "magic.e57": b"ASTM-E57" + bytes(400),
        "bomb.ply": head.format(little, 10**12, xyz).encode() + few.tobytes(),
        "bomb ascii.ply": head.format("ascii", 10**12, xyz).encode() + b"1 2 3\n",
        "bomb before.ply": b"ply\nformat ascii 1.0\nelement other 9999999999\nproperty int a\n"
        + head.format("ascii", 1, xyz).partition("1.0\n")[2].encode() + b"1 2 3\n",
        "short.ply": head.format(little, 5, xyz).encode() + few.tobytes(),
        "short ascii.ply": head.format("ascii", 2, xyz).encode() + b"1 2 3\n" + b" " * 99,
        "words.ply": head.format("ascii", 2, xyz).encode() + b"1 2 3\n1 two 3\n",
        "no z.ply": head.format(little, 1, xyz[:-17]).encode() + bytes(40),
        "twice.ply": head.format(little, 1, xyz * 2).encode() + bytes(40),
        "unknown type.ply": head.format(little, 1, xyz + "property quad q\n").encode(),
        "list.ply": head.format(little, 1, xyz + "property list uchar int q\n").encode(),
        "no vertex.ply": b"ply\nformat ascii 1.0\nelement face 1\nend_header\n1 2 3\n",
        "no format.ply": b"ply\nelement vertex 1\nend_header\n",
        "no end.ply": b"ply\nformat ascii 1.0\n",
        "bomb.pcd": pcd.format(10**12, "binary").encode() + few.tobytes(),
        "bomb ascii.pcd": pcd.format(10**12, "ascii").encode() + b"1 2 3\n",
        "bomb packed.pcd": pcd.format(10**8, "binary_compressed").encode()
        + struct.pack("<II", 9, 12 * 10**8) + bytes(9),
        "short packed.pcd": pcd.format(4, "binary_compressed").encode()
        + struct.pack("<II", 50, 48) + bytes(9),
        "damaged packed.pcd": pcd.format(4, "binary_compressed").encode()
        + struct.pack("<II", 9, 48) + b"\xff" * 9,
        "short unpacked.pcd": pcd.format(4, "binary_compressed").encode()
        + struct.pack("<II", 9, 48) + b"\x07" + bytes(8),
        "other packed.pcd": pcd.format(4, "binary_compressed").encode()
        + struct.pack("<II", 9, 47) + b"\x07" + bytes(8),
        "short.pcd": pcd.format(5, "binary").encode() + few.tobytes(),
        "sizes.pcd": pcd.format(4, "binary").replace("SIZE 4 4 4", "SIZE 4 4").encode(),
        "count.pcd": pcd.format(4, "binary").replace("POINTS 4", "POINTS 3").encode() + bytes(99),
        "kind.pcd": pcd.format(4, "zip").encode() + bytes(99),
        "fields.pcd": pcd.format(4, "ascii").replace("x y z", "a b c").encode() + bytes(99),
        "counts.pcd": pcd.format(4, "binary").replace("COUNT 1 1 1", "COUNT 1 1 0").encode()
        + bytes(99),
        "type.pcd": pcd.format(4, "binary").replace("TYPE F", "TYPE Q").encode() + bytes(99),
        "two.xyz": b"1 2\n3 4\n",
        "ragged.xyz": b"1 2 3\n1 2\n",
        "words.xyz": b"1 2 3\n1 two 3\n",
        "names.csv": b"x,y,z,w\n1,2,3\n",
        "no z.csv": b"x,y,w\n1,2,3\n",
        "few.pts": b"3\n1 2 3\n4 5 6\n",
        "many.pts": b"1\n1 2 3\n4 5 6\n",
        "line.xyz": b"1" * 100_000,
        "comma.csv": b"1000001,0791;2000002,3849;100,0115\n" * 2,
        "comma.xyz": b"1,5 2,5 3\n",
        "comma named.csv": b"x;y;z\n1,5;2,5;3,5\n",
    }  # fmt: skip
    path = folder / name
    if name in made:
        path.write_bytes(made[name])
    elif name == "bomb.npy":
        np.save(path, few)
        data = path.read_bytes()
        path.write_bytes(data.replace(b"(4, 3), }" + b" " * 12, b"(10000000000, 3), }  "))
    elif name == "pickle.npy":
        np.save(path, np.array([[{}] * 3]), allow_pickle=True)
    elif name == "flat.npy":
        np.save(path, np.ones(9))
    elif name == "two.npy":
        np.save(path, np.ones((9, 2)))
    elif name == "image.npy":
        np.save(path, np.ones((48, 64), np.uint16))
    elif name == "text.npy":
        np.save(path, np.array([["a"] * 3]))
    elif name == "other.npz":
        np.savez(path, depth=few)
    elif name == "uneven.npz":
        np.savez(path, points=few, gt=np.zeros(5))
    elif name == "swollen.npz":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            head = np.lib.format.header_data_from_array_1_0(few) | {"shape": (10**11, 3)}
            with archive.open("points.npy", "w") as stream:
                np.lib.format.write_array_header_1_0(stream, head)
                stream.write(few.tobytes())
    else:
        source = folder / f"good{path.suffix}"
        points = np.random.default_rng(0).uniform(0, 1, (3000, 3))
        if path.suffix == ".e57":
            names = ("cartesianX", "cartesianY", "cartesianZ")
            e57_file(source, [(dict(zip(names, points.T.copy(), strict=True)), (1, 0, 0, 0), UTM)])
        else:
            las_file(source, points, np.zeros((3000, 3), np.uint8))
        data = bytearray(source.read_bytes())
        source.unlink()
        if "records behind" in name:
            data[243:247] = struct.pack("<I", 4 * 10**9)
        elif "records" in name:
            data[100:104] = struct.pack("<I", 4 * 10**9)
        elif "bomb" in name:
            data[247:255] = struct.pack("<Q", 10**12)
        path.write_bytes(data[: len(data) * 2 // 3] if "short" in name else data)
    return path


BAD = [
    "empty.ply", "empty.xyz", "blank.csv", "names only.csv", "junk.ply", "junk.pcd", "junk.xyz",
    "junk.npy", "junk.npz", "junk.las", "junk.laz", "junk.e57", "magic.e57", "bomb.ply",
    "bomb ascii.ply", "bomb before.ply", "short.ply", "short ascii.ply", "words.ply", "no z.ply",
    "twice.ply",
    "unknown type.ply", "list.ply", "no vertex.ply", "no format.ply", "no end.ply", "bomb.pcd",
    "bomb ascii.pcd", "bomb packed.pcd", "short packed.pcd", "damaged packed.pcd",
    "short unpacked.pcd", "other packed.pcd", "counts.pcd", "short.pcd", "sizes.pcd",
    "count.pcd", "kind.pcd", "fields.pcd", "type.pcd", "two.xyz", "ragged.xyz", "words.xyz",
    "names.csv", "no z.csv", "few.pts", "many.pts", "line.xyz", "bomb.npy", "pickle.npy",
    "flat.npy", "image.npy", "text.npy", "other.npz", "uneven.npz", "swollen.npz",
    "short.las", "bomb.las", "records.las", "records.laz",
    "records behind.las", "short.laz", "bomb.laz", "short.e57",
]  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, name):
    path = write_bad(tmp_path, name)
    before = path.read_bytes()
    with pytest.raises(PlanewiseError) as caught:
        read_cloud(path)
    message = str(caught.value)
    assert message.startswith("cloud: ")
    assert name in message
    assert "\n" not in message
    assert len(message) < 300
    assert path.read_bytes() == before


@pytest.mark.parametrize("name", ["comma.csv", "comma.xyz", "comma named.csv"])
def test_decimal_commas_are_told(tmp_path, name):
    with pytest.raises(PlanewiseError, match=r"decimal comma.* '1.*write them with a decimal poi"):
        read_cloud(write_bad(tmp_path, name))


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "a.las", "a.laz", "a.e57", "a.npz", "a.csv"])
def test_changed_bytes_are_read_or_refused(tmp_path, points, colour, name):
    path = tmp_path / name
    columns = dict(zip("xyz", points.T, strict=True))
    if name == "a.ply":
        write_ply(path, 500, [columns], [])
    elif name == "a.pcd":
        cloud = OtherCloud.from_xyz_points(points.astype(np.float32))
        cloud.save(path, Encoding.BINARY_COMPRESSED)
    elif name == "a.npz":
        np.savez(path, points=points, rgb=colour)
    elif name == "a.csv":
        np.savetxt(path, points, delimiter=",", header="x,y,z", comments="")
    elif name == "a.e57":
        names = ("cartesianX", "cartesianY", "cartesianZ")
        e57_file(path, [(dict(zip(names, points.T.copy(), strict=True)), (1, 0, 0, 0), UTM)])
    else:
        las_file(path, points, colour)
    good, rng = path.read_bytes(), np.random.default_rng(0)
    messages = []
    for _ in range(25):
        bad = bytearray(good)
        for at in rng.integers(0, min(len(bad), 600), 3):
            bad[at] = rng.integers(256)
        path.write_bytes(bad)
        try:
            read_cloud(path)
        except PlanewiseError as error:
            messages.append(str(error))
    assert messages
    assert all(message.isprintable() and len(message) < 400 for message in messages)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("short.ply", "it claims 5 points, there is room for 4"),
        ("short.pcd", "it claims 5 points, there is room for 4"),
        ("list.ply", "has lists in its points"),
        ("two.npy", r"must hold points of shape \(k, 3\), got float64 of shape \(9, 2\)"),
        ("short packed.pcd", "is cut short: 9 of 50 packed bytes"),
        ("other packed.pcd", "it claims 4 points, 48 bytes, where its packed .* states 47"),
        ("counts.pcd", "has a COUNT that is none: 1 1 0"),
        ("bomb ascii.pcd", "it claims 1,000,000,000,000 points, there is room for 1"),
        ("bomb packed.pcd", "it claims 100,000,000 points, 1,200,000,000 bytes, where its packed "),
        ("records.las", "it claims 4,000,000,000 records before and after its points"),
        ("records behind.las", "it claims 4,000,000,000 records before and after its points"),
        ("bomb.npy", "it claims 120,000,000,000 bytes of an array, 48 are there"),
    ],
)
def test_what_a_header_claims_is_held_against_the_size_of_the_file(tmp_path, name, said):
    with pytest.raises(PlanewiseError, match=said):
        open_cloud(write_bad(tmp_path, name))


def cloud_text(kind, encoding, claimed, faces=()):
    """Header of points x, y, z, and lines or bytes of faces that it claims."""
    if kind == "pcd":
        head = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {claimed}\nHEIGHT 1\nDATA {encoding}\n"
        return head.encode()
    order = "ascii" if encoding == "ascii" else "binary_little_endian"
    xyz = "".join(f"property float {axis}\n" for axis in "xyz")
    after = f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
    head = f"ply\nformat {order} 1.0\nelement vertex {claimed}\n{xyz}{after}end_header\n"
    return head.encode()


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
@pytest.mark.parametrize("kind", ["ply", "pcd"])
def test_more_points_than_the_header_claims_are_refused(tmp_path, points, kind, encoding):
    """In memory and in blocks; what is no whole point, or but zeros, is not of account."""
    path = tmp_path / f"a.{kind}"
    points = points.astype(np.float32)
    lines = "".join(f"{x} {y} {z}\n" for x, y, z in points).encode()
    body = lines if encoding == "ascii" else points.tobytes()
    rest = b"\n# end\n 7\n\x1a" if encoding == "ascii" else b"\n" * 11
    path.write_bytes(cloud_text(kind, encoding, 500) + body + rest)
    assert len(in_blocks(path)) == 500
    if encoding == "binary":
        path.write_bytes(cloud_text(kind, encoding, 500) + body + bytes(4096))
        assert len(in_blocks(path)) == 500
    for claimed in (499, 100, 1, 0):
        path.write_bytes(cloud_text(kind, encoding, claimed) + body.removesuffix(b"\n"))
        said = f"a.{kind} holds more than the {claimed} points? it claims: .*; mend its header"
        with pytest.raises(PlanewiseError, match=said):
            read_cloud(path)
        with pytest.raises(PlanewiseError, match=said):
            list(open_cloud(path).chunks(77))


def test_faces_behind_the_points_of_a_ply_are_no_points(tmp_path, points):
    path = tmp_path / "a.ply"
    lines = "".join(f"{x} {y} {z}\n" for x, y, z in points)
    faces = ["3 0 1 2", "40000 " + "3 " * 40_000, "3 2 3 4"]
    for behind, more in (("\n".join(faces), False), ("\n".join([*faces, "1 2 3"]), True)):
        path.write_bytes(cloud_text("ply", "ascii", 500, faces) + (lines + behind).encode())
        if more:
            with pytest.raises(PlanewiseError, match="holds more than the 500 points it claims"):
                read_cloud(path)
        else:
            assert len(in_blocks(path)) == 500
    binary = cloud_text("ply", "binary", 500, faces[:1]) + points.astype(np.float32).tobytes()
    path.write_bytes(binary + struct.pack("<B3i", 3, 0, 1, 2))
    assert len(in_blocks(path)) == 500


def test_archives_that_swell_to_more_points_than_they_have_bits_are_refused(tmp_path, monkeypatch):
    """Those of a few points may: a grid without noise packs a hundred times."""
    path = tmp_path / "a.npz"
    np.savez_compressed(path, points=np.zeros((100_000, 3)))
    assert 8 * path.stat().st_size < 100_000
    assert len(read_cloud(path)) == 100_000
    monkeypatch.setattr("planewise.files.npz._PACKED_ANYHOW", 99_999)
    with pytest.raises(PlanewiseError, match="claims 100,000 points, which cannot be in a file of"):
        open_cloud(path)
    np.savez(path, points=np.zeros((100_000, 3)))
    assert len(read_cloud(path)) == 100_000


def test_long_headers_take_no_longer_than_their_length(tmp_path):
    names = "".join(f"property char a{n}\n" for n in range(30_000))
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 1\n"
    xyz = "".join(f"property float {name}\n" for name in "xyz")
    ply = (head + xyz + names + "end_header\n").encode() + bytes(12 + 30_000)
    (tmp_path / "a.ply").write_bytes(ply)
    (tmp_path / "a.xyz").write_text("# x" + " " * 60_000 + "y z\n1 2 3\n2 3 4\n")
    start = process_time()
    assert len(read_cloud(tmp_path / "a.ply")) == 1
    assert len(read_cloud(tmp_path / "a.xyz")) == 2
    assert process_time() - start < 5  # in quadratic time each took 30 s


def test_what_cannot_be_opened(tmp_path):
    for name in ("none.ply", ".", "a.obj"):
        (tmp_path / "a.obj").write_text("x")
        with pytest.raises(PlanewiseError, match="cloud"):
            open_cloud(tmp_path / name)
    assert len(KINDS) == 13


@pytest.mark.parametrize(
    ("ending", "package"), [(".las", "laspy"), (".laz", "lazrs"), (".e57", "pye57")]
)
def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch, points, ending, package):
    path = tmp_path / f"a{ending}"
    if ending == ".e57":
        path.write_bytes(b"ASTM-E57" + bytes(99))
    else:
        las_file(path, points, np.zeros((500, 3), np.uint8))
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=rf"{package}.*planewise\[cloud\]"):
        read_cloud(path)


@pytest.mark.parametrize("order", "CF")
def test_rows_of_many_numbers_are_no_points(tmp_path, order):
    np.save(tmp_path / "a.npy", np.zeros((3, 20_000), order=order))
    with pytest.raises(PlanewiseError, match="holds rows of 20000 numbers, not points"):
        open_cloud(tmp_path / "a.npy")


def test_a_file_that_shrinks_while_it_is_read(tmp_path, points):
    np.save(tmp_path / "a.npy", points)
    file = open_cloud(tmp_path / "a.npy")
    with pytest.raises(ValueError, match="size"):
        next(file.chunks(0))
    np.save(tmp_path / "a.npy", points[:100])
    with pytest.raises(PlanewiseError, match="cut short"):
        file.read()


def test_clouds_of_wrong_shape_are_refused(points):
    good = PointCloud(points=points)
    for field, value in {
        "points": points[:, :2],
        "offset": np.zeros(2),
        "colour": np.zeros((9, 3), np.uint8),
        "intensity": np.zeros((500, 1), np.float32),
        "origins": np.zeros(3),
    }.items():
        with pytest.raises(ValueError, match=field):
            PointCloud(**({"points": points} | {field: value}))
    assert joined([good, good], good.offset, None).points.shape == (1000, 3)
    assert len(joined([], good.offset, None)) == 0


def test_blocks_of_words_count_their_lines():
    import io

    lines = io.StringIO("1 2 3\n\n# note\n4 5 6\n7 8\n")
    tables = read_words(lines, 3, 2)
    assert_array_equal(next(tables), [[1, 2, 3], [4, 5, 6]])
    with pytest.raises(PlanewiseError, match=r"number 3.*'7 8'"):
        next(tables)
