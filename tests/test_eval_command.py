from __future__ import annotations

import csv
import json
import re

import numpy as np
import pytest
from PIL import Image

from planewise.metrics import evaluate
from tests.command import run


@pytest.fixture
def truth():
    labels = np.zeros((40, 60), np.uint16)
    labels[:, 5:30], labels[:, 30:] = 1, 300
    return labels


@pytest.fixture
def predicted(truth):
    return np.roll(truth, 3, axis=1)


@pytest.fixture
def folders(tmp_path, truth, predicted):
    """Frames 1, 2, 10 in many kinds of file; 3 only predicted, 4 only true."""
    found, true = tmp_path / "found", tmp_path / "true"
    for folder in (found / "10", true):
        folder.mkdir(parents=True)
    Image.fromarray(predicted).save(found / "1.png")
    np.save(true / "1.npy", truth)
    np.savez(found / "2.npz", labels=truth)
    np.savez(true / "2.npz", gt=truth, depth=truth % 7)
    Image.fromarray(predicted).save(found / "10" / "labels.png")  # as detect writes it
    Image.fromarray(truth).save(true / "10.png")
    np.save(found / "3.npy", truth)
    np.save(true / "4.npy", truth)
    (true / "notes.txt").write_text("ignored")
    (true / "empty").mkdir()
    return found, true


def read(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_two_files(tmp_path, truth, predicted):
    Image.fromarray(predicted).save(tmp_path / "a.png")
    np.save(tmp_path / "b.npy", truth)
    table = tmp_path / "new" / "scores.csv"
    code, text, errors = run("eval", tmp_path / "a.png", tmp_path / "b.npy", "-o", table)
    assert (code, errors) == (0, "")
    assert "1 of 1 frame scored" in text
    assert [path.name for path in table.parent.iterdir()] == ["scores.csv"]
    (line,) = read(table)
    assert line.pop("frame") == "b"
    expected = evaluate(predicted, truth).row()
    assert line.keys() == expected.keys()
    for name, value in expected.items():
        assert line[name] == ("" if np.isnan(value) else str(value))
    assert f"voi_labelled (bits) {expected['voi_labelled']:.4f}" in text
    assert "voi_valid" not in text  # nothing is known of the readings


def test_two_folders(folders, tmp_path, truth):
    code, text, errors = run("eval", *folders, "-o", tmp_path / "scores.csv")
    assert code == 0
    assert "lacks 1: 4" in errors
    assert "lacks 1: 3" in errors
    assert "3 of 3 frames scored" in text
    lines = read(tmp_path / "scores.csv")
    assert [line["frame"] for line in lines] == ["1", "2", "10"]
    assert [line["voi_valid"] for line in lines] == ["", "0.0", ""]
    assert "95 % confidence interval" in text
    assert re.search(r"voi_frame \(bits\) \d\.\d{4} 0\.0000 \.\.\. \d\.\d{4} 3", text)


def test_a_frame_without_a_true_plane_is_left_out_of_the_means(folders, tmp_path, truth):
    np.save(folders[1] / "1.npy", 0 * truth)
    code, text, _ = run("eval", *folders, "-o", tmp_path / "scores.csv")
    assert code == 0
    line = read(tmp_path / "scores.csv")[0]
    names = [
        f"{name}_{policy}" for name in ("voi", "ri", "sc") for policy in ("labelled", "k_best")
    ]
    assert {line[name] for name in names} == {""}
    assert re.search(r"voi_labelled \(bits\) \S+ \S+ \.\.\. \S+ 2", text)


def test_parameters_of_both_give_errors(tmp_path, truth):
    folder = tmp_path / "frame"
    folder.mkdir()
    labels = np.where(truth == 300, 2, truth)
    Image.fromarray(labels.astype(np.uint16)).save(folder / "labels.png")
    planes = [{"normal": [0, 0, -1], "distance": d} for d in (1.0, 2.0)]
    (folder / "planes.json").write_text(json.dumps({"planes": planes}))
    np.savez(tmp_path / "gt.npz", gt=labels, planes=[(0, 0, -1, 1.25), (0, 0, -1, 2.25)])
    code, text, _ = run("eval", folder / "labels.png", tmp_path / "gt.npz")
    assert code == 0
    assert "distance_error_m 0.2500" in text
    assert "normal_error_deg 0.0000" in text


def test_settings_reach_the_scores(folders, tmp_path):
    table = tmp_path / "scores.csv"
    settings = ("--iou", 0.6, "--minimum-pixels", 1100, "--tolerance", 0.99)
    code, *_ = run("eval", *folders, "-o", table, *settings)
    line = read(table)[0]
    assert code == 0
    assert line["recall@0.6"] == "1.0"
    assert line["planes_counted"] == "1"
    assert line["hoover_correct"] == "0"
    assert "f1@0.5" not in line


def test_a_frame_that_cannot_be_used_is_reported_and_the_others_go_on(folders, tmp_path):
    np.save(folders[0] / "4.npy", np.zeros((3, 3), int))
    code, text, errors = run("eval", *folders, "-o", tmp_path / "scores.csv")
    assert code == 2
    assert re.search(r"error: 4: .*\(3, 3\)", errors)
    assert "3 of 4 frames scored" in text
    assert len(read(tmp_path / "scores.csv")) == 3


def test_no_table_where_no_frame_can_be_used(tmp_path, truth):
    np.save(tmp_path / "a.npy", truth)
    np.save(tmp_path / "b.npy", truth[1:])
    code, text, errors = run(
        "eval", tmp_path / "a.npy", tmp_path / "b.npy", "-o", tmp_path / "s.csv"
    )
    assert code == 2
    assert errors.count("error: ") == 1
    assert text.strip() == "0 of 1 frame scored"
    assert not (tmp_path / "s.csv").exists()
    (tmp_path / "s.csv").write_text("earlier")
    _, text, _ = run("eval", tmp_path / "a.npy", tmp_path / "b.npy", "-o", tmp_path / "s.csv")
    assert f"0 of 1 frame scored; {tmp_path / 's.csv'} still has what an earlier run" in text
    assert (tmp_path / "s.csv").read_text() == "earlier"


BAD_FILES = {
    "floats": (lambda path: np.save(path, np.zeros((2, 2))), "integer labels"),
    "a row": (lambda path: np.save(path, np.zeros(4, int)), "shape"),
    "negative": (lambda path: np.save(path, np.full((40, 60), -1)), "predicted"),
    "pickles": (
        lambda path: np.save(path, np.array([[{}]], object), allow_pickle=True),
        "pickled",
    ),
    "no array": (lambda path: path.write_bytes(b"nothing"), "damaged"),
    "cut short": (lambda path: path.write_bytes(b"\x93NUMPY"), "damaged"),
}


@pytest.mark.parametrize(("write", "word"), BAD_FILES.values(), ids=BAD_FILES)
def test_files_without_labels_are_refused(tmp_path, truth, write, word):
    write(tmp_path / "bad.npy")
    np.save(tmp_path / "truth.npy", truth)
    code, text, errors = run("eval", tmp_path / "bad.npy", tmp_path / "truth.npy")
    assert (code, text) == (2, "")
    assert errors.count("error: ") == 1
    assert word in errors
    assert "Traceback" not in errors


def test_pictures_and_archives_without_labels_are_refused(tmp_path, truth):
    np.save(tmp_path / "truth.npy", truth)
    Image.fromarray(np.zeros((40, 60, 3), np.uint8)).save(tmp_path / "colour.png")
    Image.fromarray(np.zeros((40, 60), np.uint8)).save(tmp_path / "grey.jpg")
    np.savez(tmp_path / "other.npz", depth=truth)
    np.savez(tmp_path / "planes.npz", gt=truth, planes=np.ones((2, 3)))
    for name, word in (
        ("colour.png", "colour picture"),
        ("grey.jpg", "no known kind"),
        ("other.npz", "'labels' or 'gt'"),
        ("planes.npz", "(N, 4)"),
    ):
        code, _, errors = run("eval", tmp_path / name, tmp_path / "truth.npy")
        assert (code, errors.count("error: ")) == (2, 1)
        assert word in errors


def test_depth_that_does_not_fit_its_labels_is_refused(tmp_path, truth):
    np.save(tmp_path / "found.npy", truth)
    for depth in (np.ones((3, 3)), np.ones(truth.shape, bool)):
        np.savez(tmp_path / "true.npz", gt=truth, depth=depth)
        code, text, errors = run("eval", tmp_path / "found.npy", tmp_path / "true.npz")
        assert (code, text) == (2, "")
        assert f"true.npz has depth of {depth.dtype} and shape {depth.shape}; expected" in errors
        assert "shape of 'gt', (40, 60)" in errors


BAD_PARAMETERS = {
    "no JSON": ("{", "is not valid JSON"),
    "too deep": ("[" * 100_000, "is not valid JSON"),
    "no planes": ("{}", "no list of 'planes'"),
    "a list": ("[]", "no list of 'planes'"),
    "planes by name": ('{"planes": {"1": {}}}', "no list of 'planes'"),
    "an empty plane": ('{"planes": [{}]}', "for plane 1"),
    "a number": ('{"planes": [3]}', "for plane 1"),
    "no distance": ('{"planes": [{"normal": [0, 0, 1]}]}', "for plane 1"),
    "two numbers": ('{"planes": [{"normal": [0, 1], "distance": 1}]}', "for plane 1"),
    "words": ('{"planes": [{"normal": ["0", "0", "1"], "distance": 1}]}', "for plane 1"),
    "NaN": ('{"planes": [{"normal": [0, 0, 1], "distance": NaN}]}', "for plane 1"),
    "the second": ('{"planes": [{"normal": [0, 0, 1], "distance": 1}, null]}', "for plane 2"),
}


@pytest.mark.parametrize(("content", "word"), BAD_PARAMETERS.values(), ids=BAD_PARAMETERS)
def test_damaged_parameters_are_named(tmp_path, truth, content, word):
    Image.fromarray(truth).save(tmp_path / "labels.png")
    np.save(tmp_path / "truth.npy", truth)
    (tmp_path / "planes.json").write_text(content)
    code, text, errors = run("eval", tmp_path / "labels.png", tmp_path / "truth.npy")
    assert (code, text) == (2, "")
    assert errors.count("error: ") == 1
    assert "labels: planes.json beside labels.png " in errors
    assert word in errors
    assert "mend it, or remove it" in errors
    assert "damaged" not in errors


def test_small_and_indexed_pictures_are_labels(tmp_path, truth):
    labels = np.where(truth == 300, 2, truth).astype(np.uint8)
    np.save(tmp_path / "truth.npy", labels > 1)
    Image.fromarray(labels).save(tmp_path / "grey.png")
    indexed = Image.fromarray(labels).convert("P")
    indexed.putdata(labels.ravel().tolist())
    indexed.save(tmp_path / "indexed.png")
    Image.fromarray(labels.astype(np.uint16)).save(tmp_path / "wide.tiff")
    transparent = Image.fromarray(labels).convert("LA")
    transparent.save(tmp_path / "transparent.png")
    grey, by_index, wide, see_through = (
        run("eval", tmp_path / name, tmp_path / "truth.npy")
        for name in ("grey.png", "indexed.png", "wide.tiff", "transparent.png")
    )
    assert grey == by_index == wide == see_through
    assert grey[0] == 0


def test_the_folder_of_one_result_is_known(folders, tmp_path):
    _, true = folders
    alone = tmp_path / "alone"
    alone.mkdir()
    Image.fromarray(np.zeros((6, 8), np.uint8)).save(alone / "labels.png")
    for truth in (true, sorted(true.iterdir())[0]):
        code, text, errors = run("eval", alone, truth)
        assert (code, text) == (2, "")
        assert f", or {alone / 'labels.png'} for one image" in errors


def result(folder, labels):
    """Folder as detect writes it for one image."""
    folder.mkdir(parents=True)
    Image.fromarray(labels).save(folder / "labels.png")
    planes = [{"normal": [0, 0, -1], "distance": 1.0}] * int(labels.max())
    (folder / "planes.json").write_text(json.dumps({"planes": planes}))
    for name in ("overlay.png", "curve.png"):
        Image.fromarray(np.zeros((40, 60, 3), np.uint8)).save(folder / name)
    return folder


def test_the_result_of_one_image_is_one_frame(tmp_path, truth, predicted):
    first, second = result(tmp_path / "first", predicted), result(tmp_path / "second", truth)
    np.save(tmp_path / "second.npy", truth)
    for other in (second, tmp_path / "second.npy"):
        code, _, errors = run("eval", first, other, "-o", tmp_path / "scores.csv")
        assert (code, errors) == (0, "")
        (line,) = read(tmp_path / "scores.csv")
        assert line["frame"] == "second"
        assert float(line["voi_frame"]) > 0


def test_results_of_many_images_are_many_frames(folders, tmp_path, truth):
    _, true = folders
    found = result(tmp_path / "results", truth)  # an earlier run's, of one image
    result(found / "1", truth)
    result(found / "10", truth)
    code, text, errors = run("eval", found, true)
    assert code == 0
    assert "2 of 2 frames scored" in text
    code, text, errors = run("eval", found / "1", true)
    assert (code, text) == (2, "")
    assert "truth is a folder of frames and the other is one frame; give two of a kind" in errors


def test_folders_that_do_not_fit_are_refused(folders, tmp_path, truth):
    found, true = folders
    other = tmp_path / "other"
    other.mkdir()
    np.save(other / "99.npy", truth)
    np.save(true / "1.copy.npy", truth)
    for arguments, word in (
        ((found, other), "no frame is in both"),
        ((found, other), "has 1 such as 99; their names"),
        ((found, true / "1.npy"), "folder"),
        ((tmp_path / "absent", true), "there is no file or folder"),
    ):
        code, text, errors = run("eval", *arguments)
        assert (code, text) == (2, "")
        assert word in errors
    np.save(true / "10.npy", truth)
    assert "two label images of one frame" in run("eval", found, true)[2]


def test_outputs_that_cannot_be_written_are_refused(folders, tmp_path):
    found, true = folders
    for output, word in ((tmp_path, "is a folder"), (tmp_path / "scores.txt", ".csv")):
        code, text, errors = run("eval", found, true, "-o", output)
        assert (code, text) == (2, "")
        assert word in errors
    (tmp_path / "file").write_text("mine")
    assert run("eval", found, true, "-o", tmp_path / "file" / "scores.csv")[0] == 2


def test_settings_out_of_range_are_refused_once(folders):
    for setting in (("--iou", 2), ("--tolerance", 0.4), ("--minimum-pixels", -1)):
        code, text, errors = run("eval", *folders, *setting)
        assert (code, text) == (2, "")
        assert errors.count("error: ") == 1
        assert f"{setting[0].strip('-')} must" in errors
