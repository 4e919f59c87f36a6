"""planewise reproduce: what the report is made of, and a short version of the whole."""

import csv
import io
import math
import re
import sys
import time
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from planewise import scenes
from planewise.commands import reproduce as reproduce_command
from planewise.drawing.palette import distinct_colours
from planewise.metrics import contingency_table
from planewise.reproduce import methods, report, tasks
from planewise.reproduce.angle_errors import ERRORS, Case, cases, rms
from planewise.reproduce.angles import ANGLES, _checks
from planewise.reproduce.bound import Bound, cramer_rao, with_rounding
from planewise.reproduce.experiment import Experiment, Settings
from planewise.reproduce.experiments import EXPERIMENTS
from planewise.reproduce.flatness import order_found
from planewise.reproduce.methods import OPEN3D, OURS, PAPER, Found, Frame, detect
from planewise.reproduce.open3d_ransac import one_after_the_other, why_missing
from planewise.reproduce.page import page
from planewise.reproduce.pictures import BORDER, mask
from planewise.reproduce.scores import (
    like_the_truth,
    parameter_errors,
    partners,
    placed,
    scored,
)
from planewise.reproduce.section import Section, Table

from .command import run

SIZE = (72, 96)


# The bound


def test_bound_of_a_wall_seen_head_on():
    scene = scenes.flatness(amplitude=0.0, size=(48, 64), quantise=False)
    bound = cramer_rao(scene, 0.005)
    readings = np.bincount(scene.labels.ravel())[1:]
    # Bands beside the axis know their distance less well than the mean of their readings.
    assert (bound.distances > 0.005 / np.sqrt(readings)).all()
    rays = scene.camera.rays((48, 64))
    for label, plane in enumerate(scene.planes, start=1):
        r = rays[scene.labels == label]
        # z = d / (1 + slopes): to first order a linear fit of z / d over (u, v, 1).
        covariance = np.linalg.inv(r.T @ r) * (0.005 / plane[3]) ** 2
        angle = np.degrees(np.sqrt(covariance[0, 0] + covariance[1, 1]))
        assert bound.normals[label - 1] == pytest.approx(angle, rel=1e-9)
        assert bound.distances[label - 1] == pytest.approx(
            plane[3] * np.sqrt(covariance[2, 2]), rel=1e-9
        )


def test_least_squares_with_true_labels_attain_the_bound():
    sigma, errors = 0.002, []
    for seed in range(150):
        scene = scenes.two_planes(100, sigma=sigma, size=(36, 48), rng=seed, quantise=False)
        rays = scene.camera.rays((36, 48))
        planes = []
        for label, plane in enumerate(scene.planes, start=1):
            r, z = rays[scene.labels == label], scene.depth[scene.labels == label]
            theta = -plane[:3] / plane[3]
            for _ in range(3):  # Gauss-Newton on z - 1 / (theta . r)
                model = 1 / (r @ theta)
                theta = theta - np.linalg.lstsq(model[:, None] ** 2 * r, z - model, rcond=None)[0]
            planes.append(np.append(-theta, 1) / np.linalg.norm(theta))
        found = Found(labels=scene.labels, planes=np.array(planes), seconds=0.0)
        each = parameter_errors(scene, found)
        errors.append((each.normals, each.distances))
    bound = cramer_rao(scene, sigma)
    normals, distances = np.sqrt(np.mean(np.square(errors), axis=0))
    # 150 numbers of a distance, twice as many of a normal: 6 % and 4 % of standard deviation.
    assert normals / bound.normals == pytest.approx(np.ones(2), abs=0.2)
    assert distances / bound.distances == pytest.approx(np.ones(2), abs=0.2)


def test_rounding_adds_the_variance_of_a_uniform():
    rng = np.random.default_rng(0)
    z = 1 + rng.normal(0, 0.002, 100_000)
    read = (np.floor(z / 0.001) + 0.5) * 0.001
    assert np.std(read) == pytest.approx(with_rounding(0.002, 0.001), rel=0.01)


# Scores


@pytest.fixture
def corner():
    return scenes.corner(size=SIZE, sigma=0.0)


def test_scores_of_the_truth_are_perfect(corner):
    found = Found(labels=corner.labels, planes=corner.planes, seconds=0.25)
    row = scored(corner, found)
    assert (row["planes"], row["true_planes_found"]) == (4, 4)
    assert (row["voi_bits"], row["rand_index"], row["covering"]) == (0, 1, 1)
    assert row["normal_error_deg"] == pytest.approx(0, abs=1e-6)
    assert row["distance_error_mm"] == 0
    assert row["time_ms"] == 250


def test_errors_are_those_of_the_plane_with_most_readings(corner):
    labels = np.where(corner.labels == 2, 1, corner.labels)  # planes 1 and 2 found as one
    labels = np.where(corner.labels == 4, 0, labels)  # plane 4 not found
    planes = corner.planes.copy()
    planes[0, 3] += 0.002
    errors = parameter_errors(corner, Found(labels=labels, planes=planes, seconds=0.0))
    assert errors.distances[0] == pytest.approx(0.002)
    between = np.degrees(np.arccos(corner.planes[0, :3] @ corner.planes[1, :3]))
    assert errors.normals[1] == pytest.approx(between)
    assert errors.normals[2] == pytest.approx(0, abs=1e-6)
    assert math.isnan(errors.normals[3])
    assert math.isnan(errors.distances[3])


def test_readings_are_right_wrong_or_on_none(corner):
    labels = np.array([0, 3, 1, 2, 7])[corner.labels]  # every plane found, under another label
    first = np.flatnonzero(corner.labels == 1)
    labels.flat[first[:10]] = 7
    labels.flat[first[10:15]] = 0
    labels.flat[first[15:17]] = 9  # a plane that is none
    table = contingency_table(labels, corner.labels)
    assert partners(table) == {1: 3, 2: 1, 3: 2, 4: 7}
    where = placed(corner, labels)
    assert (where.wrong, where.none) == (12, 5)
    assert where.right == corner.labels.size - 17
    assert where.share_right == where.right / corner.labels.size
    shown = like_the_truth(corner, labels)
    assert (shown == corner.labels).sum() == where.right
    assert (shown[labels == 9] > 4).all()
    assert (shown[labels == 0] == 0).all()


def test_a_labelling_without_planes_has_no_errors_to_tell(corner):
    nothing = Found(labels=np.zeros(SIZE, np.uint16), planes=np.empty((0, 4)), seconds=0.0)
    row = scored(corner, nothing)
    assert row["planes"] == 0
    assert math.isnan(row["normal_error_deg"])
    assert placed(corner, nothing.labels).share_right == 0


def test_order_of_bands():
    scene = scenes.flatness(size=SIZE)
    assert order_found(scene, scene.labels) == [0, 2, 10, 100]
    assert order_found(scene, np.array([0, 2, 4, 1, 3])[scene.labels]) == [10, 0, 100, 2]


def test_root_mean_squares_against_the_bound():
    row = {"angle_deg": 90.0, "sigma_m": 0.005, "method": OURS, "planes": 2, "share_right": 1.0}
    for plane in (1, 2):
        row |= {f"normal_error_deg_{plane}": 3.0 * plane, f"distance_error_mm_{plane}": -4.0}
    missed = row | {"planes": 1, "share_right": 0.5, "normal_error_deg_2": math.nan}
    bound = Bound(normals=np.array([1.0, 1.0]), distances=np.array([0.002, 0.002]))
    (case,) = cases([row, missed], {90.0: bound})
    assert (case.frames, case.missed, case.right, case.labelled_right) == (2, 1, 0.5, False)
    assert case.errors["normal_error_deg"] == pytest.approx(math.sqrt((9 + 36 + 9) / 3))
    assert case.ratios["distance_error_mm"] == pytest.approx(2.0)
    assert math.isnan(rms([math.nan]))


# Methods


def test_planes_are_taken_out_one_after_the_other():
    points = np.zeros((10, 3))
    points[4:, 2] = [1, 1, 1, 2, 2, 3]

    def most_frequent_height(rest):
        heights, counts = np.unique(rest[:, 2], return_counts=True)
        best = heights[counts.argmax()]
        return np.array([0, 0, 1, -best]), np.flatnonzero(rest[:, 2] == best)

    labels, planes = one_after_the_other(most_frequent_height, points, 8)
    assert labels.tolist() == [1] * 4 + [2] * 3 + [0] * 3
    assert planes[:, 3].tolist() == [0, -1]
    labels, planes = one_after_the_other(most_frequent_height, points, 1)
    assert labels.max() == len(planes) == 1
    labels, planes = one_after_the_other(most_frequent_height, points, 8, smallest=0.5)
    assert labels.max() == len(planes) == 0


@pytest.mark.parametrize("method", [OPEN3D, PAPER, methods.REASSIGNED, OURS])
def test_every_method_finds_a_corner_without_noise(method, corner):
    if method == OPEN3D and why_missing():
        pytest.skip(why_missing())
    frame = Frame.of(corner, 0.002, inlier_ratio=0.25, max_planes=4, seed=3)
    found = detect(method, frame)
    assert found.labels.shape == SIZE
    assert found.planes.shape == (4, 4)
    assert np.linalg.norm(found.planes[:, :3], axis=1) == pytest.approx(np.ones(4))
    assert (found.planes[:, 3] >= 0).all()
    row = scored(corner, found)
    assert row["true_planes_found"] == 4
    assert row["normal_error_deg"] < 0.5
    assert row["distance_error_mm"] < 2
    if method != OPEN3D:  # its threads race for the best sample, whatever the seed
        again = detect(method, frame)
        assert np.array_equal(again.labels, found.labels)


@pytest.mark.parametrize("method", [PAPER, OURS])
def test_no_first_call_is_timed(method, monkeypatch):
    waits = [0.2, 0.0]

    def call():
        time.sleep(waits.pop(0))
        return np.zeros((2, 2), int), np.array([[0.0, 0.0, -1.0, 2.0]])

    monkeypatch.setattr(methods, "prepared", lambda method, frame: call)
    assert detect(method, None).seconds < 0.1


@pytest.mark.parametrize(
    ("ours", "frames", "quick", "verdicts"),
    [
        (1.1, 4, True, ["met", "met"]),
        (1.4, 4, True, ["not decided", "not decided"]),
        (1.4, 4, False, ["missed", "missed"]),
        (9.0, 400, True, ["missed", "missed"]),
        (math.nan, 4, True, ["missed", "missed"]),
    ],
)
def test_what_few_frames_cannot_decide_is_not_missed(ours, frames, quick, verdicts):
    common = {"angle": 90.0, "sigma": 0.005, "planes": 2.0, "share_right": 1.0, "missed": 0}
    found = [
        Case(
            method=method, frames=count, right=1.0, **common,
            errors=dict.fromkeys(ERRORS, ratio), ratios=dict.fromkeys(ERRORS, ratio),
        )
        for method, count, ratio in ((OURS, frames, ours), (PAPER, 1, 1.3))
    ]  # fmt: skip
    assert [each.verdict for each in _checks(found, quick=quick)] == verdicts


# Processes


def test_results_do_not_depend_on_the_number_of_processes():
    settings = Settings(methods=(PAPER, OURS), seeds=1, size=SIZE, quick=True)
    trials = ANGLES.trials(settings)[:3]
    here = [ANGLES.measure(trial) for trial in trials]
    there = list(tasks.each_in_order([(ANGLES.measure, trial) for trial in trials], 2))
    assert [[each.row for each in one] for one in here] == [
        [each.row for each in one] for one in there
    ]


# The command


class _Page(HTMLParser):
    """Tags of a page with their attributes; complains about what is not closed."""

    VOID = ("meta", "img", "br", "link", "hr")

    def __init__(self, text):
        super().__init__()
        self.tags, self.open = [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def all(self, name):
        return [attributes for tag, attributes in self.tags if tag == name]


@pytest.fixture
def without_open3d(monkeypatch):
    for module in (methods, report):
        monkeypatch.setattr(module, "why_missing", lambda: "ModuleNotFoundError: open3d")


def test_a_short_version_of_everything(tmp_path, without_open3d):
    out = tmp_path / "report"
    arguments = ("--quick", "--size", "96x72", "--processes", 2)
    code, text, errors = run("reproduce", "all", "-o", out, *arguments)
    assert code == 0
    assert errors.startswith("warning: without Open3D")
    assert (
        text.count("target: ") == sum(map(text.count, (" met ", " missed ", " not decided "))) == 9
    )
    assert text.count("claim of the paper: ") == 4
    assert "report.html" in text
    assert [path.name for path in tmp_path.iterdir()] == ["report"]

    source = (out / "report.html").read_text(encoding="utf-8")
    page = _Page(source)
    assert page.all("script") == []
    assert [each["id"] for each in page.all("section")] == list(EXPERIMENTS)
    assert all(each["alt"] for each in page.all("img"))
    assert all(each["src"].startswith("data:image/png;base64,") for each in page.all("img"))
    scrollers = [each for each in page.all("div") if "wide" in each.get("class", "")]
    assert all((each["tabindex"], each["role"]) == ("0", "region") for each in scrollers)
    assert len({each["aria-label"] for each in scrollers}) == len(scrollers) > 10
    links = [each["href"] for each in page.all("a")]
    assert links == [f"#{name}" for name in EXPERIMENTS]
    addresses = set(re.findall(r"https?://[^\s\"'<>)]+", source))
    assert all(each.startswith("http://www.w3.org/") for each in addresses)  # names, not files
    assert "prefers-color-scheme: dark" in source
    assert "@media print" in source
    assert "ModuleNotFoundError: open3d" in source
    assert "and standard deviation" not in source  # of one frame there is none
    assert source.count("<svg") == 1
    assert "nan" not in re.sub(r"<svg.*?</svg>|base64,[^\"]*", "", source, flags=re.DOTALL)

    names = {path.name for path in out.iterdir()}
    for name in EXPERIMENTS:
        assert f"{name}.csv" in names
    assert {"angles.svg", "corner-truth.png", "corner-paper-2mm.png"} <= names
    told = {name for each in EXPERIMENTS.values() for name in each.files}
    assert names == {"report.html"} | {name for name in told if "open3d" not in name}
    with (out / "staircase.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 2  # assumed noises, methods; one frame
    assert {row["method"] for row in rows} == {PAPER, OURS}
    assert {float(row["sigma_m"]) for row in rows} == {0.002, 0.005, 0.01}
    assert all(int(row["planes"]) == 4 for row in rows if row["method"] == OURS)
    with (out / "angles-bound.csv").open(newline="", encoding="utf-8") as file:
        bounds = list(csv.DictReader(file))
    with (out / "angles.csv").open(newline="", encoding="utf-8") as file:
        angles = list(csv.DictReader(file))
    assert len(angles) == len(bounds) * 3 * 2
    for row in angles:
        bound = next(each for each in bounds if each["angle_deg"] == row["angle_deg"])
        if row["rms_normal_error_deg"]:
            ratio = float(row["rms_normal_error_deg"]) / float(bound["rms_normal_error_deg"])
            assert ratio == pytest.approx(float(row["normal_error_deg_over_bound"]))


def test_planes_of_masks_are_parted_by_lines_but_stray_readings_are_seen():
    scene = scenes.corner(size=(48, 64))
    labels = scene.labels.copy()
    labels[5, 5] = 2 if labels[5, 5] != 2 else 3
    shown = mask(scene, labels, "name", "title", "note")
    seen = np.asarray(Image.open(io.BytesIO(shown.png)).convert("RGB")).astype(int)
    line = (seen == BORDER).all(axis=2)
    inside = ~line
    meet = labels[:, 1:] != labels[:, :-1]
    meet[5, 4:6] = False
    assert (line[:, 1:] | line[:, :-1])[meet].mean() > 0.85  # but at tips
    assert inside.mean() > 0.9
    for label in np.unique(labels):
        colours = np.unique(seen[inside & (labels == label)], axis=0)
        assert colours.tolist() == [distinct_colours(int(label))[-1].tolist()]
    assert inside[4:7, 4:7].all()


def test_captions_are_seen_whole_on_narrow_screens(opened, tmp_path):
    table = Table(
        caption="What was measured, and how. " * 5,
        header=["scene", "method", *10 * ["misassigned"]],
        rows=[["without noise", "planewise", *10 * ["1,234"]]],
    )
    section = Section(title="Scenes", text=(), blocks=(table,))
    (tmp_path / "report.html").write_text(page({}, {"scenes": section}), encoding="utf-8")
    opened.look(width=390)
    opened.open(tmp_path / "report.html")
    scroller = "document.querySelector('.wide:has(caption)')"
    assert opened.value(f"{scroller}.scrollWidth > {scroller}.clientWidth")
    for place in (0, 200):
        opened.value(f"{scroller}.scrollLeft = {place}")
        left, right = opened.value(
            "((e) => [e.left, e.right])("
            "document.querySelector('caption span').getBoundingClientRect())"
        )
        assert 0 <= left < right <= 390
    opened.look(media="print")
    text, caption = opened.value(
        "['body', 'caption span'].map((each) => "
        "parseFloat(getComputedStyle(document.querySelector(each)).fontSize))"
    )
    assert caption < text


def test_the_command_knows_every_experiment():
    assert [name.value for name in reproduce_command._Name] == [*EXPERIMENTS, "all"]
    assert all(name == each.name for name, each in EXPERIMENTS.items())


def test_one_experiment_alone(tmp_path, without_open3d):
    out = tmp_path / "flat"
    code, _, _ = run(
        "reproduce", "flatness", "-o", out, "--seeds", 1, "--size", "96x72", "--processes", 1
    )
    assert code == 0
    page = _Page((out / "report.html").read_text(encoding="utf-8"))
    assert [each["id"] for each in page.all("section")] == ["flatness"]
    assert sorted(path.suffix for path in out.iterdir()) == [".csv", ".html", *[".png"] * 4]


def test_beside_a_report_are_no_files_of_an_earlier_one(tmp_path, monkeypatch):
    section = Section(title="Speed", text=(), blocks=(), files={"speed": [{"time_ms": 1}]})
    short = replace(EXPERIMENTS["speed"], trials=lambda _: [], section=lambda *_: section)
    monkeypatch.setitem(EXPERIMENTS, "speed", short)
    mine, stale = {"corner-mine.png"}, {"angles.svg", "corner-open3d-2mm.png", "flatness.csv"}
    written = {"report.html", "speed.csv"}
    for name in mine | stale:
        (tmp_path / name).touch()
    for left in (mine | stale, mine):  # where there was no report, all files are somebody's own
        assert run("reproduce", "speed", "-o", tmp_path)[0] == 0
        assert {path.name for path in tmp_path.iterdir()} == written | left


BAD_ARGUMENTS = {
    "no seeds": (("--seeds", "0"), "seeds"),
    "no processes": (("--processes", "0"), "processes"),
    "size that is none": (("--size", "large"), "size"),
    "size too small": (("--size", "8x8"), "size"),
}


@pytest.mark.parametrize("name", BAD_ARGUMENTS)
def test_what_cannot_be_used_is_said(name, tmp_path):
    arguments, word = BAD_ARGUMENTS[name]
    code, text, errors = run("reproduce", "speed", "-o", tmp_path / "out", *arguments)
    assert (code, text) == (2, "")
    assert errors.startswith(f"error: {word}")
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_cannot_be_a_folder_is_refused_at_once(tmp_path):
    (tmp_path / "file").write_text("mine")
    code, text, errors = run("reproduce", "speed", "-o", tmp_path / "file")
    assert (code, text) == (2, "")
    assert errors.count("error: ") == 1
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("package", ["matplotlib", "jinja2"])
def test_a_missing_extra_is_named(package, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    code, text, errors = run("reproduce", "speed", "-o", tmp_path / "out")
    assert (code, text) == (2, "")
    assert package in errors
    assert "planewise[reproduce]" in errors
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_of_a_report_that_failed(tmp_path, monkeypatch):
    broken = Experiment(
        name="speed",
        trials=lambda _: ["x"],
        measure=int,
        section=lambda *_: None,
        files=(),
        alone=True,
    )
    monkeypatch.setitem(EXPERIMENTS, "speed", broken)
    code, _, errors = run("reproduce", "speed", "-o", tmp_path / "deep" / "out")
    assert code == 2
    assert "invalid literal" in errors
    assert list(tmp_path.iterdir()) == []
