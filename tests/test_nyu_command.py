"""The paper's evaluation on NYU-v2, on small files in the real formats."""

import csv

import numpy as np
import pytest
from PIL import Image
from skimage.metrics import variation_of_information

import planewise as pw
from planewise.datasets.frames import DatasetFrame
from planewise.datasets.nyu import FULL
from planewise.errors import PlanewiseError
from planewise.metrics.contingency import Clustering
from planewise.reproduce.nyu import (
    PUBLISHED,
    Protocol,
    Row,
    counted,
    lines_of,
    scores_of,
    table_of,
)
from tests.command import run as run_command

from .nyu_files import frame, write_archive, write_folder, write_mat

SMALL = "50,52,31,24.5"
CAMERA = pw.PinholeCamera(fx=50, fy=52, cx=31.0, cy=24.5)


def run(*arguments):
    return run_command("nyu", *arguments)


@pytest.fixture
def folder(tmp_path):
    write_folder(tmp_path / "nyu", {n: frame(n) for n in (1, 2, 3)})
    return tmp_path / "nyu"


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def read(out):
    with (out / "nyu.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_folder_gives_the_papers_table_and_ours(folder, out):
    code, text, errors = run(folder, "-o", out, "--camera", SMALL)
    assert (code, errors) == (0, "")
    for name, *numbers in (
        ("PlaneTR", "1.110", "0.898", "0.726"),
        ("PlaneRecTR", "1.045", "0.915", "0.745"),
        ("PlaneSeg", "1.684", "0.856", "0.741"),
        ("paper experimental", "1.259", "0.890", "0.703"),
        ("paper proportional", "0.874", "0.934", "0.799"),
    ):
        assert f"{name} published {' '.join(numbers)}" in text
    assert "…" not in text
    assert "This is NOT the NYUv2-Plane set" in text
    assert "Frames of 48 x 64 are cropped already" in text
    assert "3 of 3 frames scored" in text
    rows = read(out)
    assert len(rows) == 3 * 8
    assert {row["frame"] for row in rows} == {"1", "2", "3"}
    page = (out / "nyu.md").read_text(encoding="utf-8")
    for search in ("sequential", "default"):
        for kind in ("experimental", "proportional"):
            for kept in ("k best", "all"):
                mine = [
                    float(row["voi"])
                    for row in rows
                    if (row["search"], row["noise"], row["kept"]) == (search, kind, kept)
                ]
                assert f"| {search} | {kind} | {kept} | {np.mean(mine):.3f}±" in page
    assert all(int(row["planes"]) <= 2 for row in rows if row["kept"] == "k best")


def test_the_mat_takes_its_planes_from_elsewhere(tmp_path, out):
    frames = [frame(n) for n in range(3)]
    write_mat(tmp_path / "nyu.mat", frames)
    code, _, errors = run(tmp_path / "nyu.mat", "-o", out, "--camera", SMALL)
    assert code == 2
    assert "truth: " in errors
    assert "give a folder with --truth" in errors
    assert not out.exists()
    (tmp_path / "truth").mkdir()
    for number in (1, 3):
        labels = frames[number - 1]["planes"].astype(np.uint8)
        Image.fromarray(labels).save(tmp_path / "truth" / f"{number}.png")
    code, text, errors = run(
        *(tmp_path / "nyu.mat", "-o", out, "--camera", SMALL),
        *("--truth", tmp_path / "truth", "--depth", "raw", "--limit", 5),
    )
    assert (code, errors) == (0, "")
    assert "2 of 2 frames scored" in text  # frame 2 has no truth
    assert {row["frame"] for row in read(out)} == {"1", "3"}


def test_whole_frames_of_the_plane_set_are_said_to_be_that(tmp_path, out):
    write_folder(tmp_path / "nyu", {5: frame(5, FULL)}, kinds=("rgb", "depth"))
    small = np.repeat([[1, 2]], 192, axis=0).repeat(128, axis=1).astype(np.uint8)
    (tmp_path / "truth").mkdir()
    np.savez(tmp_path / "truth" / "plane_instance_5.npz", plane_instance=small)
    code, text, _ = run(tmp_path / "nyu", "--truth", tmp_path / "truth", "-o", out)
    assert code == 0
    assert "pixels in rows 45:471, columns 41:601 count" in text
    assert "The true planes are those of NYUv2-Plane, 1 of the 654 frames." in text
    assert "NOT" not in text


def test_whole_frames_with_other_labels_are_left_to_the_reader(tmp_path, out):
    write_folder(tmp_path / "nyu", {1: frame(1, FULL)})
    _, text, _ = run(tmp_path / "nyu", "-o", out)
    assert "Nothing in the files says that the labels of this frame are those of" in text


def test_frames_without_true_planes_are_named(folder, out):
    (folder / "gt" / "2.png").unlink()
    code, text, errors = run(folder, "-o", out, "--camera", SMALL)
    assert code == 0
    assert "1 of 3 frames without true planes are left out: 2" in errors
    assert "2 of 2 frames scored" in text


def test_archives_are_never_the_plane_set(tmp_path, out):
    (tmp_path / "cut").mkdir()
    write_archive(tmp_path / "cut" / "a.npz", frame(1), CAMERA)
    code, text, _ = run(tmp_path / "cut", "-o", out)
    assert code == 0
    assert "This is NOT the NYUv2-Plane set" in text


def test_a_frame_that_cannot_be_used_is_reported_and_the_others_go_on(folder, out):
    (folder / "depth" / "2.png").write_bytes(b"no picture")
    code, text, errors = run(folder, "-o", out, "--camera", SMALL)
    assert code == 2
    assert "nyu, frame 2: depth: 2.png cannot be read" in errors
    assert "2 of 3 frames scored" in text
    assert {row["frame"] for row in read(out)} == {"1", "3"}


def test_nothing_is_left_where_no_frame_can_be_used(folder, out):
    for path in (folder / "gt").iterdir():
        Image.fromarray(np.zeros((48, 64), np.uint8)).save(path)
    code, _, errors = run(folder, "-o", out, "--camera", SMALL)
    assert code == 2
    assert "frame 1 has no reading on a true plane" in errors
    assert "none of 3 frames could be scored" in errors
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--limit", 0), "limit must be at least 1, got 0"),
        (("--seed", -1), "seed must not be negative"),
        (("--threads", 0), "threads must be a whole number of at least 1"),
        (("--truth", "none"), "truth: none is not a folder"),
        (("--depth", "raw"), "is a folder; --depth chooses among those of a .mat"),
    ],
)
def test_what_cannot_be_is_refused(folder, out, arguments, message):
    code, _, errors = run(folder, "-o", out, *arguments)
    assert code == 2
    assert message in errors
    assert not out.exists()


def seen(shape=FULL, **more):
    depth = np.full(shape, 2.0)
    return DatasetFrame(id="1", depth=depth, camera=pw.cameras.NYU, **more)


def test_only_readings_on_true_planes_inside_the_crop_count():
    labels = np.ones(FULL, np.uint8)
    labels[100:200] = 0
    frame = seen(labels=labels)
    frame.depth[300:310, 50:60] = 0
    frame.depth[320:330, 50:60] = np.nan
    region, truth = counted(frame)
    expected = np.zeros(FULL, bool)
    expected[45:471, 41:601] = True
    expected[100:200] = expected[300:310, 50:60] = expected[320:330, 50:60] = False
    assert np.array_equal(region, expected)
    assert truth.shape == (expected.sum(),)
    whole, _ = counted(seen((426, 560), labels=np.ones((426, 560), np.uint8)))
    assert whole.all()


def test_a_frame_without_truth_is_refused():
    with pytest.raises(PlanewiseError, match="frame 1 has no true planes"):
        counted(seen())
    with pytest.raises(PlanewiseError, match="frame 1 has no reading on a true plane"):
        counted(seen(labels=np.zeros(FULL, np.uint8)))
    labels = np.ones(FULL, np.int16)
    labels[7, 7] = -1  # "no plane" elsewhere: which labels are none is not to be guessed
    with pytest.raises(ValueError, match="frame 1: truth must hold labels of at least 0, got -1"):
        counted(seen(labels=labels))


def test_scores_are_those_of_scikit_image():
    rng = np.random.default_rng(0)
    truth, labels = rng.integers(1, 5, 500), rng.integers(0, 6, 500)
    scores = scores_of(labels, truth)
    voi = sum(variation_of_information(truth[None], labels[None]))
    assert scores.variation_of_information == pytest.approx(voi)


def test_as_many_planes_are_kept_as_are_true_among_what_counts():
    each = frame(4)
    truth = each["planes"].copy()
    truth[:, 32:] = 0  # one true plane is left
    found = DatasetFrame(id="4", depth=each["depth"], camera=CAMERA, labels=truth)
    rows = Protocol(options={"threads": 1}).run(found)
    assert [(row.search, row.noise, row.kept) for row in rows] == [
        (search, noise, kept)
        for search in ("sequential", "default")
        for noise in ("experimental", "proportional")
        for kept in ("k best", "all")
    ]
    assert {row.true_planes for row in rows} == {1}
    assert all(row.planes == 1 for row in rows if row.kept == "k best")
    assert all(row.planes == 2 for row in rows if row.kept == "all")
    # The plane that counts may be the one that is not kept; then everything true is unlabelled.
    perfect = Clustering(
        variation_of_information=0.0, rand_index=1.0, covering=1.0, pixels=(truth > 0).sum()
    )
    assert rows[0].scores == perfect
    best = pw.detect_planes(each["depth"], CAMERA, pw.sensors.KINECT_V1)
    assert rows[5].scores == scores_of(best.labels[truth > 0], truth[truth > 0])


def test_lines_are_means_over_frames():
    rows = [
        row
        for number in (1, 2, 3)
        for row in Protocol(options={"threads": 1}).run(
            DatasetFrame(
                id=str(number),
                depth=frame(number)["depth"],
                camera=CAMERA,
                labels=frame(number)["planes"],
            )
        )
    ]
    lines = lines_of(rows)
    assert len(lines) == 8
    mine = [row.scores.covering for row in rows if row.search == "default" and row.kept == "all"]
    first = next(line for line in lines if (line.search, line.kept) == ("default", "all"))
    assert first.sc.mean == pytest.approx(np.mean(mine[::2]))
    assert first.sc.count == 3
    assert len(PUBLISHED) == 5


def test_intervals_hold_nothing_that_a_score_cannot_be():
    common = {"search": "default", "noise": "experimental", "kept": "all", "seconds": 1.0}
    rows = [
        Row(
            frame=str(voi), true_planes=2, planes=2, **common,
            scores=Clustering(variation_of_information=voi, rand_index=ri, covering=sc, pixels=9),
        )
        for voi, ri, sc in ((0.0, 1.0, 0.81), (0.2, 0.97, 0.83))
    ]  # fmt: skip
    for mine, cells in (
        (rows, ("0.100 (0.000 ... 1.371)", "0.985 (0.794 ... 1.000)", "0.820±0.127")),
        (rows[:1] * 2, ("0.000±0.000", "1.000±0.000", "0.810±0.000")),
        (rows[:1], ("0.000", "1.000", "0.810")),
    ):
        (*_, last) = table_of(lines_of(mine))
        assert last[3:6] == cells


def test_the_papers_search_goes_through_regions(folder, out, tmp_path):
    code, text, errors = run(folder, "-o", out, "--camera", SMALL, "--partition", "blocks")
    assert (code, errors) == (0, "")
    assert "sequential: the paper's search as it is here, in regions (blocks" in text
    row = read(out)[1]
    assert (row["search"], row["noise"], row["kept"]) == ("sequential", "experimental", "all")
    depth = np.asarray(Image.open(folder / "depth" / "1.png"))
    options = {"search": "sequential", "confidence": 0.99, "inlier_ratio": 0.1}
    model = pw.detect_planes(depth, CAMERA, pw.sensors.KINECT_V1, **options, partition="blocks")
    region, truth = frame(1)["raw"] > 0, frame(1)["planes"]
    region &= truth > 0
    expected = scores_of(model.labels[region], truth[region])
    assert float(row["voi"]) == pytest.approx(expected.variation_of_information)

    regions = tmp_path / "regions"
    regions.mkdir()
    for number in (1, 2, 3):
        halves = np.repeat([[1, 2]], 48, axis=0).repeat(32, axis=1).astype(np.uint8)
        Image.fromarray(halves).save(regions / f"{number}.png")
    code, text, errors = run(folder, "-o", out, "--camera", SMALL, "--partition", regions)
    assert (code, errors) == (0, "")
    assert "in the regions of regions" in text
    (regions / "2.png").unlink()
    code, text, errors = run(folder, "-o", out, "--camera", SMALL, "--partition", regions)
    assert code == 2
    assert "2 of 3 frames scored" in text
    assert "named 2" in errors
    code, _, errors = run(folder, "-o", out, "--partition", "nothing")
    assert code == 2
    assert "partition: expected auto, graph, blocks" in errors


def test_real_frames(real_frames, tmp_path, out):
    """The table of `docs/nyu.md`, on two frames."""
    from .conftest import SHARED

    real_frames("nyu_dpd", "nyu_0002")  # skips where they are not here
    code, text, _ = run(SHARED / "nyu_dpd", "-o", out, "--limit", 2)
    assert code == 0
    rows = read(out)
    assert [row["frame"] for row in rows[::8]] == ["nyu_0002", "nyu_0015"]
    ours = [float(row["sc"]) for row in rows if row["search"] == "default"]
    theirs = [float(row["sc"]) for row in rows if row["search"] == "sequential"]
    assert np.mean(ours) > np.mean(theirs) > 0.5
    assert "NOT the NYUv2-Plane set" in text
