from __future__ import annotations

import json
import re
import struct
import sys

import jsonschema
import laspy
import numpy as np
import plyfile
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import planewise as pw
from planewise.drawing.cloud import draw_cloud
from planewise.files.result_names import CLOUD_FILES, FILES, OUTLINE_FILES
from planewise.results.outlines import OUTLINES_SCHEMA_FILE
from planewise.results.planes_json import SCHEMA_FILE
from tests.command import run
from tests.test_outlines import model_of, plane_at

SIGMA = 0.01
UTM = np.array([536_258.0, 6_581_099.0, 47.0])


def box_corner(number=3000, seed=0):
    """Points on a floor and two walls, their true plane, and strays that are on none."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 2, (number, 3))
    face = rng.integers(0, 3, number)
    points[np.arange(number), face] = rng.normal(0, SIGMA, number)
    strays = rng.uniform(0.3, 2, (number // 20, 3))
    return np.vstack((points, strays)), np.append(face + 1, np.zeros(len(strays), int))


@pytest.fixture(scope="module")
def corner():
    return box_corner()


@pytest.fixture
def out(tmp_path):
    return tmp_path / "results" / "cloud"


def check(folder):
    """Hold the JSON files of a folder against their schemas; return planes.json."""
    for name, schema in (("planes.json", SCHEMA_FILE), ("outlines.json", OUTLINES_SCHEMA_FILE)):
        if (folder / name).exists():
            jsonschema.validate(
                json.loads((folder / name).read_text()), json.loads(schema.read_text())
            )
    return json.loads((folder / "planes.json").read_text())


def test_three_faces_and_all_files(tmp_path, out, corner):
    points, truth = corner
    path = tmp_path / "corner.npy"
    np.save(path, points)
    before = path.read_bytes()
    code, text, errors = run("points", path, "--sigma", SIGMA, "-o", out)
    assert (code, errors) == (0, "")
    assert "3 planes, Phi = " in text
    assert "nan" not in text
    assert sorted(each.name for each in out.iterdir()) == sorted(CLOUD_FILES)
    record = check(out)
    assert record["camera"] is None
    assert record["input"] == {
        "file": "corner.npy",
        "points": len(points),
        "offset": [0, 0, 0],
        "origins": None,
    }
    vertex = plyfile.PlyData.read(str(out / "labelled.ply"))["vertex"]
    assert_array_equal(np.stack([vertex[name] for name in "xyz"], axis=1), points)
    for label in (1, 2, 3):
        mine = vertex["plane"] == label
        assert np.count_nonzero(mine) == record["planes"][label - 1]["readings"]
        # One colour a plane, and one true face behind it.
        colours = {tuple(row) for row in np.stack([vertex[n][mine] for n in ("red", "green")], 1)}
        assert len(colours) == 1
        counts = np.bincount(truth[mine], minlength=4)
        assert counts.max() > 0.97 * counts.sum()
    assert path.read_bytes() == before
    with Image.open(out / "preview.png") as picture:
        assert picture.mode == "RGB"


def test_command_line_and_python_agree(tmp_path, out, corner):
    points, _ = corner
    np.save(tmp_path / "a.npy", points)
    run("points", tmp_path / "a.npy", "--sigma", "10mm", "--seed", 3, "--max-planes", 2, "-o", out)
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    sensor = pw.Sensor(max_depth=extent, noise=SIGMA)
    model = pw.detect_planes_in_points(points, sensor, rng=3, max_planes=2)
    record = check(out)
    assert record["information"] == model.information
    vertex = plyfile.PlyData.read(str(out / "labelled.ply"))["vertex"]
    assert_array_equal(vertex["plane"], model.labels)


@pytest.mark.parametrize("ending", [".las", ".laz"])
def test_las_on_a_map_grid(tmp_path, out, corner, ending):
    points, _ = corner
    path = tmp_path / f"a{ending}"
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.floor(UTM)
    data = laspy.LasData(header)
    data.x, data.y, data.z = (points + UTM).T
    data.classification = np.arange(len(points)) % 9
    data.write(path)
    code, _, errors = run("points", path, "--sigma", SIGMA, "--outlines", "--instances", "-o", out)
    assert (code, errors) == (0, "")
    names = (*CLOUD_FILES, *OUTLINE_FILES, f"labelled{ending}")
    assert sorted(each.name for each in out.iterdir()) == sorted(names)
    record = check(out)
    offset = np.array(record["input"]["offset"])
    assert not (offset % 100).any()
    copy = laspy.read(out / f"labelled{ending}")
    assert_array_equal(copy.X, data.X)
    assert_array_equal(copy.classification, data.classification)
    for plane in record["planes"]:
        mine = np.asarray(copy["plane"]) == plane["label"]
        assert np.count_nonzero(mine) == plane["readings"]
        away = (copy.xyz[mine] - offset) @ plane["normal"] + plane["distance"]
        assert np.sqrt(np.mean(away**2)) == pytest.approx(SIGMA, rel=0.1)
    features = json.loads((out / "outlines.json").read_text())["features"]
    largest = {each["properties"]["plane"]: each for each in reversed(features)}
    assert sorted(largest) == [1, 2, 3]
    for each in largest.values():
        assert each["properties"]["area"] == pytest.approx(4, rel=0.1)
        ring = np.array(each["geometry"]["coordinates"][0][0])
        assert (np.abs(ring - UTM - 1) < 1.2).all()


def test_las_of_another_file_is_made_when_asked_for(tmp_path, out, corner):
    points, _ = corner
    np.save(tmp_path / "a.npy", np.vstack((points, [[np.nan] * 3])))
    assert run("points", tmp_path / "a.npy", "--sigma", SIGMA, "--las", "-o", out)[0] == 0
    data = laspy.read(out / "labelled.las")
    vertex = plyfile.PlyData.read(str(out / "labelled.ply"))["vertex"]
    assert_allclose(data.xyz, points, atol=1e-5)
    assert_array_equal(data["plane"], vertex["plane"][:-1])
    assert vertex["plane"][-1] == 0
    (out / "notes.txt").write_text("mine")
    for name in OUTLINE_FILES:
        (out / name).write_text("of other planes")
    assert run("points", tmp_path / "a.npy", "--sigma", SIGMA, "-o", out)[0] == 0
    assert sorted(each.name for each in out.iterdir()) == sorted((*CLOUD_FILES, "notes.txt"))


def usual_cloud(name):
    """Points that are no ordinary scan, and how many planes they have."""
    wall = np.column_stack(
        (np.random.default_rng(0).uniform(-1, 1, (3000, 2)),
         np.random.default_rng(1).normal(0, SIGMA, 3000))
    )  # fmt: skip
    holey = wall.copy()
    holey[::5], holey[1::7] = np.nan, np.inf
    return {
        "one place": (np.ones((500, 3)), 0),
        "a line": (np.outer(np.linspace(0, 1, 500), (1.0, 2.0, 3.0)), 0),
        "all nan": (np.full((500, 3), np.nan), 0),
        "two points": (np.eye(3)[:2], 0),
        "none": (np.zeros((0, 3)), 0),
        "all twice": (np.repeat(wall, 2, axis=0), 1),
        "some nan": (holey, 1),
        "at 1e7": (wall + 1e7, 1),
        "single precision": (wall.astype(np.float32), 1),
    }[name]


@pytest.mark.parametrize(
    "name",
    ["one place", "a line", "all nan", "two points", "none", "all twice", "some nan", "at 1e7",
     "single precision"],
)  # fmt: skip
def test_unusual_clouds(tmp_path, out, name):
    points, planes = usual_cloud(name)
    np.save(tmp_path / "a.npy", points)
    code, text, errors = run(
        "points", tmp_path / "a.npy", "--sigma", SIGMA, "--outlines", "--las", "-o", out
    )
    assert code == 0
    record = check(out)
    assert len(record["planes"]) == planes
    assert ("no plane was found" in errors) == (planes == 0)
    features = json.loads((out / "outlines.json").read_text())["features"]
    assert len(features) == planes
    if planes:
        assert features[0]["properties"]["area"] == pytest.approx(4, rel=0.05)
        assert record["planes"][0]["rms"] == pytest.approx(SIGMA, rel=0.1)
    vertex = plyfile.PlyData.read(str(out / "labelled.ply"))["vertex"]
    assert len(vertex.data) == len(points)
    assert "Traceback" not in text + errors


@pytest.mark.parametrize("tiles", [(), ("--tiles", 1000)])
@pytest.mark.parametrize("place", [(0, 0, 0), (-9999, -9999, -9999), (1e30, 0, 0)])
def test_points_that_are_missing_make_no_cloud_of_the_earth(tmp_path, out, corner, place, tiles):
    points = corner[0] + UTM
    for name, rows in (("with", np.vstack((points, [place, place]))), ("without", points)):
        np.save(tmp_path / f"{name}.npy", rows)
        code, _, errors = run(
            *("points", tmp_path / f"{name}.npy", "--sigma", SIGMA, "-o", out / name), *tiles
        )
        assert code == 0
        missing = name == "with"
        assert ("left out: 2 points, a hundred times as far off as most" in errors) == missing
    told, true = (check(out / name) for name in ("with", "without"))
    assert len(told["planes"]) == len(true["planes"]) == 3
    labels = plyfile.PlyData.read(out / "with" / "labelled.ply")["vertex"]["plane"]
    assert not labels[-2:].any()
    for one, other in zip(told["planes"], true["planes"], strict=True):
        assert_allclose(one["normal"], other["normal"], atol=1e-3)
        assert one["readings"] == pytest.approx(other["readings"], rel=0.01)


def test_however_many_points_are_missing(tmp_path, out, corner):
    points = np.vstack((corner[0] + UTM, np.zeros((2000, 3))))
    np.save(tmp_path / "a.npy", points)
    code, text, errors = run("points", tmp_path / "a.npy", "-o", out)
    assert (code, "3 planes" in text) == (0, True)
    assert "left out: 2,000 points, a hundred times as far off as most" in errors


@pytest.mark.parametrize("tiles", [(), ("--tiles", 1000)])
def test_damaged_points_are_left_out_however_far_they_are(tmp_path, out, corner, tiles):
    far = np.array([[1.7e308, -1.7e308, 1.7e308], [1.7e308, 1.7e308, 1.7e308]])
    np.save(tmp_path / "a.npy", np.vstack((far, corner[0])))
    code, text, errors = run("points", tmp_path / "a.npy", "--sigma", SIGMA, "-o", out, *tiles)
    assert (code, "3 planes" in text) == (0, True)
    assert "left out: 2 points, a hundred times as far off as most" in errors


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (
            lambda points: np.add((1e308, 0, 0), points),
            "it lies 1e+308 m from the origin of its coordinates",
        ),
        (lambda points: np.sign(points - 1) * 1e308, "points are up to inf m apart, more than the"),
    ],
)
def test_a_cloud_that_is_nowhere_is_said_to_be(tmp_path, out, corner, points, said):
    np.save(tmp_path / "a.npy", points(corner[0]))
    code, text, errors = run("points", tmp_path / "a.npy", "-o", out)
    assert (code, text) == (2, "")
    assert said in errors
    assert not out.parent.exists()


def test_noise_that_points_do_not_tell_is_warned_of(tmp_path, out, corner):
    volume = np.random.default_rng(0).uniform(0, 5, (300, 3))
    for name, points in (("volume", volume), ("corner", corner[0])):
        np.save(tmp_path / f"{name}.npy", points)
        _, _, errors = run("points", tmp_path / f"{name}.npy", "-o", out)
        warned = "; noise: too few points lie on something flat; assumed 0.0086" in errors
        assert warned == (name == "volume")


def test_what_distances_are_from_is_said(tmp_path, out, corner):
    for name, points in (("near", corner[0]), ("far", corner[0] + UTM)):
        np.save(tmp_path / f"{name}.npy", points)
        _, text, errors = run("points", tmp_path / f"{name}.npy", "-o", out)
        assert ("distances are from 536300 6581100 0, which is" in text) == (name == "far")
        assert errors == ""


def test_a_scanner_far_from_its_points_is_warned_of(tmp_path, out, corner):
    np.save(tmp_path / "a.npy", corner[0] + UTM)
    far, near = "1,1,1", ",".join(map(str, UTM + 1))
    for place in (far, near):
        _, _, errors = run("points", tmp_path / "a.npy", "--origin", place, "-o", out)
        assert ("origin: that is 6,602," in errors) == (place == far)


@pytest.mark.parametrize("tiles", [(), ("--tiles", 1000)])
def test_the_origin_that_was_given_is_written(tmp_path, out, corner, tiles):
    place = UTM + 1
    np.savez(tmp_path / "a.npz", points=corner[0], origins=np.ones((1, 3)), offset=UTM)
    coordinates = ",".join(map(str, place))
    for given, written in (("", None), ("file", "file"), (coordinates, place.tolist())):
        origin = ("--origin", given) if given else ()
        code, _, errors = run("points", tmp_path / "a.npz", *origin, *tiles, "-o", out)
        assert (code, errors) == (0, "")
        record = check(out)
        assert record["options"].get("origin") == written
        assert record["input"]["origins"] == [[1, 1, 1]]


@pytest.mark.parametrize("said", ["key", "words", "metres", "nothing"])
def test_feet_are_no_metres(tmp_path, out, corner, said):
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = np.full(3, 0.001)
    if said == "key":
        keys = struct.pack("<8H", 1, 1, 0, 1, 3076, 0, 1, 9003)
        header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", keys))
    elif said != "nothing":
        unit = 'UNIT["US survey foot",0.3048]' if said == "words" else 'UNIT["metre",1]'
        words = f'PROJCS["a",GEOGCS["b",UNIT["degree",0.0174]],{unit}]'
        header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", words.encode()))
    data = laspy.LasData(header)
    data.x, data.y, data.z = corner[0].T
    data.write(tmp_path / "a.las")
    code, _, errors = run("points", tmp_path / "a.las", "-o", out)
    assert code == 0
    assert ("coordinates of a.las are in US survey feet" in errors) == (said == "key")
    assert ("coordinates of a.las are in US survey foot" in errors) == (said == "words")
    assert bool(errors) == (said in ("key", "words"))


def test_digits_that_a_file_has_lost_are_told(tmp_path, out):
    place = np.random.default_rng(0).uniform(0, 4, (2000, 3)) + np.array((500_000, 5_000_000, 100))
    place[0, 1] = 5_000_000.5  # one may lie on a step
    clouds = {
        "kept": place,
        "lost": place.astype(np.float32),
        "lost earlier": place.astype(np.float32).astype(np.float64),
        "whole metres": np.round(place).astype(np.float32),  # nothing was lost of them
        "near": (place - (500_000, 5_000_000, 0)).astype(np.float32),
    }
    for name, points in clouds.items():
        np.save(tmp_path / "a.npy", points)
        code, _, errors = run("points", tmp_path / "a.npy", "--sigma", SIGMA, "-o", out)
        assert code == 0
        assert ("were rounded to" in errors) == ("lost" in name), name
        assert ("to 0.5 m by numbers of 32 bits" in errors) == ("lost" in name), name


BAD = {
    "sigma of words": (("--sigma", "small"), "or 'auto', got 'small'"),
    "sigma zero": (("--sigma", 0), "sigma"),
    "sigma too large": (("--sigma", "1e200"), "noise must be positive and finite"),
    "sigma nan": (("--sigma", "nan"), "sigma"),
    "origin of two": (("--sigma", 0.01, "--origin", "1,2"), "origin"),
    "origin of a file without": (("--sigma", 0.01, "--origin", "file"), "origin"),
    "origin nowhere": (
        ("--origin", "1e300,2,1.5"),
        "must be x,y,z in metres, at most 1e+12",
    ),
    "origin of words": (("--sigma", 0.01, "--origin", "a,b,c"), "origin"),
    "resolution": (("--sigma", 0.01, "--resolution", "-1"), "resolution"),
    "resolution of the whole": (("--sigma", 0.01, "--resolution", 100), "smaller than the range"),
    "instances of nothing": (("--sigma", 0.01, "--instances"), "give --outlines"),
    "planes": (("--sigma", 0.01, "--max-planes", 0), "--max-planes must"),
    "seed": (("--sigma", 0.01, "--seed", -1), "seed"),
    "threads": (("--sigma", 0.01, "--threads", 0), "threads"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments(tmp_path, out, corner, name):
    arguments, named = BAD[name]
    np.save(tmp_path / "a.npy", corner[0])
    code, text, errors = run("points", tmp_path / "a.npy", *arguments, "-o", out)
    assert (code, text) == (2, "")
    assert named in errors
    assert not out.parent.exists()


@pytest.mark.parametrize("name", ["none.ply", "junk.ply", "short.ply", "a.obj", "wide.npy"])
def test_bad_files(tmp_path, out, name):
    path = tmp_path / name
    if name == "short.ply":
        header = "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\n"
        path.write_text(header + "".join(f"property float {n}\n" for n in "xyz") + "end_header\n")
    elif name == "wide.npy":
        np.save(path, np.vstack((np.zeros((9, 3)), [[1e30, 0, 0]])))
    elif name != "none.ply":
        path.write_text("junk")
    code, text, errors = run("points", path, "--sigma", 0.01, "-o", out)
    assert (code, text) == (2, "")
    assert errors.count("error:") == 1
    assert "cloud" in errors
    assert "Traceback" not in errors
    assert not out.parent.exists()


def test_no_number_of_a_large_cloud_is_cut_off(tmp_path, corner):
    np.save(tmp_path / "mm.npy", 1000 * corner[0] + 5e5)
    code, text, errors = run("points", tmp_path / "mm.npy", "-o", tmp_path / "out")
    assert (code, errors) == (0, "")
    assert "…" not in text
    assert re.search(r" 4,\d{3},\d{3} m2 ", text)


def test_results_are_not_written_over_what_is_read(tmp_path, corner):
    path = tmp_path / "labelled.ply"
    path.write_text("ply")
    code, _, errors = run("points", path, "--sigma", 0.01, "-o", tmp_path)
    assert code == 2
    assert "written over" in errors
    assert path.read_text() == "ply"


def test_where_no_run_was_nobodys_files_go(tmp_path, corner):
    np.save(tmp_path / "a.npy", corner[0])
    mine = ("planes.ply", "outlines.json", "labelled.las")
    for name in mine:
        (tmp_path / name).write_text("mine")
    assert run("points", tmp_path / "a.npy", "--sigma", SIGMA, "-o", tmp_path)[0] == 0
    assert {(tmp_path / name).read_text() for name in mine} == {"mine"}


def test_a_missing_package_leaves_nothing(tmp_path, out, corner, monkeypatch):
    np.save(tmp_path / "a.npy", corner[0])

    def find(*_):
        raise AssertionError("points were searched for nothing")

    for package, option in (("shapely", "--outlines"), ("laspy", "--las")):
        with monkeypatch.context() as patch:
            patch.setattr("planewise.commands.points._find", find)
            patch.setitem(sys.modules, package, None)
            code, _, errors = run("points", tmp_path / "a.npy", "--sigma", 0.01, option, "-o", out)
        assert code == 2
        assert package in errors
        assert "planewise[cloud]" in errors
        assert not out.parent.exists()


def test_outlines_of_a_depth_image(tmp_path, out):
    scene = pw.scenes.corner(size=(120, 160))
    path = tmp_path / "depth.png"
    Image.fromarray(scene.depth).save(path)
    arguments = ("--camera", "125,125,80,60", "--noise", "5mm", "--max-depth", 2)
    code, _, errors = run("detect", path, *arguments, "--outlines", "-o", out)
    assert (code, errors) == (0, "")
    assert sorted(each.name for each in out.iterdir()) == sorted((*FILES, *OUTLINE_FILES))
    record = check(out)
    features = json.loads((out / "outlines.json").read_text())["features"]
    assert [each["properties"]["plane"] for each in features] == [1, 2, 3, 4]
    for plane, each in zip(record["planes"], features, strict=True):
        assert each["properties"]["area"] == pytest.approx(plane["area"], rel=0.04)
    assert run("detect", path, *arguments, "-o", out)[0] == 0
    assert sorted(each.name for each in out.iterdir()) == sorted(FILES)


def known_model(points, truth, planes):
    """Model whose labels are the truth."""
    faces = []
    for label, normal in enumerate(planes, start=1):
        faces.append(plane_at(normal, points[truth == label].mean(axis=0)))
    return model_of(truth, *faces)


def test_pictures_show_each_plane_in_its_colour_and_cut_away_what_hides_the_rest(corner):
    points, truth = corner
    low = points[:, 2] < 0.7
    points, truth = points[low], truth[low]
    axes = np.eye(3)
    opened = draw_cloud(points, known_model(points, truth, axes))
    assert opened.dtype == np.uint8
    for label in (1, 2, 3):
        assert shown(opened, label, 3) > 5_000
    # A ceiling: with it, the floor could not be seen.
    rng = np.random.default_rng(0)
    ceiling = np.column_stack((rng.uniform(0, 2, (9000, 2)), rng.normal(0.8, SIGMA, 9000)))
    points, truth = np.vstack((points, ceiling)), np.append(truth, np.full(9000, 4))
    model = known_model(points, truth, [*axes, axes[2]])
    closed = draw_cloud(points, model)
    assert shown(closed, 3, 4) > 5_000
    assert shown(closed, 4, 4) < 500
    # Outlines are drawn over their planes, but not that of what is cut away.
    surfaces = pw.outline_points(model, points)
    lined = draw_cloud(points, model, surfaces=surfaces)
    assert 300 < dark(lined) - dark(closed) < 20_000
    assert np.array_equal(draw_cloud(points, model, surfaces=surfaces[3:]), closed)


def dark(picture):
    """Pixels in the colour of lines."""
    return np.count_nonzero((picture[:, :1200] == (28, 30, 34)).all(axis=2))


def shown(picture, label, planes):
    """Pixels of the picture, without its legend, that have the hue of a plane."""
    from planewise.drawing.palette import distinct_colours

    colour = distinct_colours(planes)[label - 1].astype(float)
    pixels = picture[:, :1200].reshape(-1, 3).astype(float)
    pixels = pixels[(np.ptp(pixels, axis=1) > 30)]
    cosine = pixels @ colour / np.linalg.norm(pixels, axis=1) / np.linalg.norm(colour)
    return np.count_nonzero(cosine > 0.9995)


def test_an_empty_picture_is_one():
    model = pw.detect_planes_in_points(np.zeros((0, 3)), pw.Sensor())
    assert draw_cloud(np.zeros((0, 3)), model).shape[2] == 3


def test_a_sigma_that_is_far_too_small_is_said_to_be(tmp_path):
    rng = np.random.default_rng(3)
    wall = np.column_stack((rng.uniform(0, 10, (20_000, 2)), rng.normal(0, 0.05, 20_000)))
    np.save(tmp_path / "wall.npy", wall)
    for sigma, warned in (("4mm", True), ("5cm", False)):
        code, _, err = run(
            "points", tmp_path / "wall.npy", "-o", tmp_path / "out", "--sigma", sigma
        )
        assert code == 0
        assert ("times as far from planes" in err) == warned


def test_of_detect_and_points_in_one_folder_the_last_stays(tmp_path, out, corner):
    scene = pw.scenes.corner(size=(120, 160))
    Image.fromarray(scene.depth).save(tmp_path / "depth.png")
    np.save(tmp_path / "a.npy", corner[0])
    camera = ("--camera", "125,125,80,60", "--noise", "5mm", "--max-depth", 2)
    detect = ("detect", tmp_path / "depth.png", *camera, "-o", out)
    points = ("points", tmp_path / "a.npy", "--sigma", SIGMA, "--las", "-o", out)
    out.mkdir(parents=True)
    (out / "preview.png").write_text("mine")  # of no run
    assert run(*detect)[0] == 0
    assert sorted(each.name for each in out.iterdir()) == sorted((*FILES, "preview.png"))
    assert run(*points)[0] == 0
    of_cloud = sorted((*CLOUD_FILES, "labelled.las"))
    assert sorted(each.name for each in out.iterdir()) == of_cloud
    assert run(*detect)[0] == 0
    assert sorted(each.name for each in out.iterdir()) == sorted(FILES)
