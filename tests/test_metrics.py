from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
import skimage.metrics
import sklearn.metrics
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planewise.metrics import (
    clustering,
    contingency_table,
    detection,
    evaluate,
    hoover_counts,
    plane_errors,
    summarise,
)
from planewise.metrics.confidence import mean_interval, student_t
from tests.command import run_python

REFERENCE = Path(__file__).resolve().parents[2] / "shared" / "tools" / "score.py"
POLICIES = {"a": "labelled", "b": "k_best", "c": "frame", "v": "valid"}
COUNTS = ("correct", "over", "under", "missed", "noise")
INVALID = {"labels of floats": np.zeros((2, 2)), "a negative label": np.full((2, 2), -1)}


def image(*rows):
    """Label image of strings of digits."""
    return np.array([[int(digit) for digit in row] for row in rows])


@pytest.fixture(scope="module")
def score():
    if not REFERENCE.exists():
        pytest.skip("the reference definition of the metrics is not part of the project")
    spec = importlib.util.spec_from_file_location("reference_score", REFERENCE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.score


def scenes(seed, count):
    """Pairs of truth and prediction: blocks, some merged, split, lost, ragged."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        height, width = rng.integers(1, 40, 2)
        blocks = rng.integers(0, rng.integers(1, 8), (height // 4 + 1, width // 4 + 1))
        truth = np.kron(blocks, np.ones((4, 4), int))[:height, :width]
        ragged = rng.random((height, width)) < rng.random() * 0.5
        predicted = np.where(ragged, rng.integers(0, 6, truth.shape), truth * 3)
        change = rng.integers(0, 4)
        if change == 1:
            predicted //= 2
        elif change == 2:
            predicted[predicted == 3] += (np.indices(truth.shape)[1] // 10)[predicted == 3]
        yield predicted, truth, rng


label_images = arrays(np.int64, (6, 7), elements=st.integers(0, 4))


def test_contingency_table_by_hand():
    table = contingency_table(image("0055", "0055"), image("9922", "0022"))
    assert table.truth_labels.tolist() == [0, 2, 9]
    assert table.predicted_labels.tolist() == [0, 5]
    assert table.counts.tolist() == [[2, 0], [0, 4], [2, 0]]
    assert table.overlaps().tolist() == [[1.0], [0.0]]


def test_contingency_table_of_valid_pixels_large_labels_and_masks():
    truth = np.array([[2**40, 2**40, 7]])
    table = contingency_table([[True, False, True]], truth, valid=[[True, True, False]])
    assert table.truth_labels.tolist() == [0, 2**40]
    assert table.counts.tolist() == [[0, 0], [1, 1]]


def test_large_labels_of_unsigned_numbers_are_told_apart():
    labels = np.array([[2**60, 2**60 + 1, 5]], np.uint64)
    table = contingency_table(labels, [[1, 2, 2]])
    assert table.predicted_labels.tolist() == [0, 5, 2**60, 2**60 + 1]
    assert table.counts.tolist() == [[0] * 4, [0, 0, 1, 0], [0, 1, 0, 1]]


def test_masked_pixels_are_no_plane_and_not_valid():
    left = np.arange(4) < 2
    predicted, truth = (np.ma.masked_array([labels], left) for labels in ([-1, 9, 3, 3], [5] * 4))
    table = contingency_table(predicted, truth)
    assert table.counts.tolist() == [[2, 0], [0, 2]]
    assert table.predicted_labels.tolist() == [0, 3]
    scores = evaluate(predicted, truth, valid=np.ma.masked_array([[True] * 4], left))
    assert (scores.predicted_planes, scores.true_planes) == (1, 1)
    assert (scores.frame.pixels, scores.labelled.pixels, scores.valid.pixels) == (4, 2, 2)
    assert predicted.mask.tolist() == [left.tolist()]


def test_policies_by_hand():
    truth = image("11112200")
    predicted = image("11334400")
    scores = evaluate(predicted, truth, valid=truth > 1, minimum_pixels=0)
    # Of 6 labelled pixels 4 are split into halves, 1 bit each.
    assert scores.labelled.variation_of_information == pytest.approx(4 / 6)
    assert scores.labelled.rand_index == pytest.approx(1 - 4 / 15)
    assert scores.labelled.covering == pytest.approx((4 * 0.5 + 2 + 2 * 0.5 + 2 * 0.5 + 2) / 12)
    assert scores.frame.variation_of_information == pytest.approx(4 / 8)
    # Two true planes: predicted 4 goes, being as large as 1 and 3 and last.
    assert scores.k_best.variation_of_information == pytest.approx(4 / 6)
    assert scores.valid.variation_of_information == 0


def test_the_k_largest_are_kept_the_lower_label_first():
    table = contingency_table(image("1223344445"), image("1111111112"))
    assert table.k_best().tolist() == [[0, 0, 0], [3, 4, 2], [1, 0, 0]]
    # Sizes are those over the whole frame; of no plane there were some before.
    table = contingency_table(image("1111220033"), image("0001111111"))
    assert table.k_best().tolist() == [[0, 3], [6, 1]]


def test_losing_a_plane_shows_in_the_frame_only():
    truth = image("111222000")
    lost = evaluate(np.where(truth == 2, 0, truth), truth, minimum_pixels=0)
    assert lost.labelled.variation_of_information == 0
    assert lost.frame.variation_of_information == pytest.approx(6 / 9)
    assert lost.detections[0].recall == 0.5
    assert lost.hoover.missed == 1


def test_nothing_predicted_and_nothing_true():
    scores = evaluate(np.zeros((20, 30), int), np.ones((20, 30), int))
    assert scores.detections[0].precision == scores.detections[0].f1 == 0
    none = evaluate(np.zeros((20, 30), int), np.zeros((20, 30), int))
    assert math.isnan(none.detections[0].recall)
    assert none.frame.rand_index == none.labelled.covering == 1
    lost, empty, alarm = (
        evaluate(predicted, truth).row()["precision@0.5"]
        for predicted, truth in (
            (np.zeros((20, 30), int), np.ones((20, 30), int)),
            (np.zeros((20, 30), int), np.zeros((20, 30), int)),
            (np.ones((20, 30), int), np.zeros((20, 30), int)),
        )
    )
    assert lost == alarm == 0
    assert math.isnan(empty)
    assert evaluate(np.zeros((0, 4), int), np.zeros((0, 4), int)).true_planes == 0


def test_small_true_planes_are_neither_hit_nor_miss():
    truth = image("1111112233", "1111112200")
    predicted = image("1111112233", "1111112240")
    found = detection(contingency_table(predicted, truth), minimum_pixels=4)
    assert (found.hits, found.precision, found.recall) == (2, 2 / 3, 1.0)
    assert found.f1 == pytest.approx(0.8)


def test_a_plane_matches_above_the_overlap_only():
    table = contingency_table(image("11110"), image("11111"))
    assert detection(table, iou=0.79, minimum_pixels=0).hits == 1
    assert detection(table, iou=0.8, minimum_pixels=0).hits == 0


@pytest.mark.parametrize(
    ("predicted", "truth", "expected"),
    [
        ("1111122222", "1111122222", (2, 0, 0, 0, 0)),
        ("1111122222", "1111111111", (0, 1, 0, 0, 0)),
        ("1111111111", "1111122222", (0, 0, 1, 0, 0)),
        ("0000022222", "1111100000", (0, 0, 0, 1, 1)),
        ("1111222233", "1111111100", (0, 1, 0, 0, 1)),
        ("1111111120", "1111111111", (0, 1, 0, 0, 0)),  # both parts measure more than the one
        ("01111", "11111", (1, 0, 0, 0, 0)),  # the tolerance itself
        ("01", "11", (0, 0, 0, 1, 1)),  # inside it, but half of it only
        ("11111", "12222", (0, 0, 1, 0, 0)),  # both together measure more than the larger one
        ("111111111", "001111222", (0, 0, 0, 2, 1)),  # 7 of 9 pixels are too few
    ],
)
def test_hoover_by_hand(predicted, truth, expected):
    counts = hoover_counts(contingency_table(image(predicted), image(truth)).counts)
    assert tuple(getattr(counts, name) for name in COUNTS) == expected


def test_regions_without_a_pixel_correspond_to_nothing():
    counts = hoover_counts([[3, 0, 0], [0, 0, 0], [0, 9, 0]])
    assert tuple(getattr(counts, name) for name in COUNTS) == (1, 0, 0, 0, 0)


def test_normal_and_distance_errors():
    truth, predicted = image("111222", "111222"), image("555000", "555777")
    planes = np.zeros((7, 4))
    planes[:, 2] = 1
    planes[4] = 0, -2 * math.sin(math.radians(3)), 2 * math.cos(math.radians(3)), -2.2
    errors = plane_errors(
        contingency_table(predicted, truth), planes, [(0, 0, -1, 1), (0, 0, -1, 2)],
        minimum_pixels=0,
    )  # fmt: skip
    assert (errors.truth_labels.tolist(), errors.predicted_labels.tolist()) == ([1], [5])
    assert errors.normals == pytest.approx([3])
    assert errors.mean_distance == pytest.approx(0.1)


def test_errors_are_of_the_planes_that_count_at_the_first_overlap():
    truth, predicted = image("1111111123"), image("0111111124")  # 7 of 8 pixels; one pixel each
    planes = [(0, 0, 1, -2), (0, 0, 1, -3), (0, 0, 1, -4), (0, 0, 1, -5)]
    given = {"predicted_planes": planes, "truth_planes": planes}
    found = evaluate(predicted, truth, iou=(0.8, 0.9), minimum_pixels=2, **given)
    assert [each.hits for each in found.detections] == [1, 0]
    assert found.errors.truth_labels.tolist() == [1]
    none = evaluate(predicted, truth, iou=(0.9, 0.8), minimum_pixels=2, **given)
    assert none.errors.truth_labels.size == 0


def test_planes_of_a_model_will_do():
    labels = np.repeat([[1, 2]], 40, axis=0).repeat(40, axis=1)
    rows = [[0, 0, 1, -2], [1, 0, 0, -1]]
    planes = [SimpleNamespace(coefficients=np.array(row)) for row in rows]
    found = evaluate(labels, labels, predicted_planes=planes, truth_planes=rows)
    assert found.errors.mean_normal == found.errors.mean_distance == 0
    none = evaluate(0 * labels, 0 * labels, predicted_planes=(), truth_planes=())
    assert math.isnan(none.errors.mean_normal)


def test_no_match_has_no_error():
    scores = evaluate(
        image("10"), image("01"), predicted_planes=[(0, 0, 1, 1)], truth_planes=[(0, 0, 1, 1)]
    )
    assert math.isnan(scores.row()["normal_error_deg"])
    assert math.isnan(scores.errors.mean_distance)


def test_agrees_with_the_reference(score):
    for predicted, truth, rng in scenes(0, 300):
        valid = rng.random(truth.shape) < 0.8
        smallest = int(rng.integers(0, 60))
        tolerance = float(rng.choice([0.51, 0.6, 0.8, 0.9, 1.0]))
        expected = score(predicted, truth, valid, smallest, tolerance)
        scores = evaluate(
            predicted, truth, valid=valid, minimum_pixels=smallest, tolerance=tolerance
        )
        row = scores.row()
        ours = {"n_pred": row["planes_predicted"], "n_gt": row["planes_true"]}
        ours |= {"n_gt400": row["planes_counted"]}
        for letter, policy in POLICIES.items():
            each = getattr(scores, policy)
            ours |= {f"{letter}_voi": each.variation_of_information}
            ours |= {f"{letter}_ri": each.rand_index, f"{letter}_sc": each.covering}
        for found, digits in zip(scores.detections, ("50", "80"), strict=True):
            ours |= {f"tp{digits}": found.hits, f"prec{digits}": found.precision}
            ours |= {f"rec{digits}": found.recall, f"f{digits}": found.f1}
        ours |= {f"h_{name}": row[f"hoover_{name}"] for name in COUNTS}
        for key, value in ours.items():
            assert value == pytest.approx(expected[key], abs=1e-10, nan_ok=True), key
        assert expected.keys() - ours.keys() == {"h_pairs"}


@given(label_images, label_images)
def test_agrees_with_scikit_image_and_scikit_learn(predicted, truth):
    scores = evaluate(predicted, truth).frame
    split, merged = skimage.metrics.variation_of_information(truth, predicted)
    assert scores.variation_of_information == pytest.approx(split + merged, abs=1e-9)
    expected = sklearn.metrics.rand_score(truth.ravel(), predicted.ravel())
    assert scores.rand_index == pytest.approx(expected)


@given(label_images, label_images)
def test_over_labelled_pixels_it_is_what_scikit_image_and_learn_make_of_them(predicted, truth):
    scores = evaluate(predicted, truth).labelled
    there = truth > 0
    if there.sum() < 2:
        return
    split, merged = skimage.metrics.variation_of_information(truth, predicted, ignore_labels=[0])
    assert scores.variation_of_information == pytest.approx(split + merged, abs=1e-9)
    expected = sklearn.metrics.rand_score(truth[there], predicted[there])
    assert scores.rand_index == pytest.approx(expected)


def masks_one_by_one(predicted, truth):
    """VOI, RI and SC as the literature's programs have them, mask by mask and pair by pair.

    A mask for every true plane, one for every predicted one and one for what none of them has;
    only pixels of a true plane count.
    """
    there = truth > 0
    ours = [(truth == label)[there] for label in np.unique(truth[there])]
    theirs = [(predicted == label)[there] for label in np.unique(predicted)]
    theirs = [mask for mask in theirs if mask.any()]
    k = int(there.sum())

    def entropy(masks):
        return -sum(mask.mean() * math.log2(mask.mean()) for mask in masks if mask.any())

    both = [a & b for a in ours for b in theirs]
    voi = 2 * entropy(both) - entropy(ours) - entropy(theirs)
    a, b = truth[there], predicted[there]
    agree = [(a[i] == a[j]) == (b[i] == b[j]) for i in range(k) for j in range(i)]

    def cover(masks, others):
        best = (max((m & o).sum() / (m | o).sum() for o in others) for m in masks)
        return sum(mask.sum() * iou for mask, iou in zip(masks, best, strict=True)) / k

    return voi, np.mean(agree), (cover(ours, theirs) + cover(theirs, ours)) / 2


@settings(max_examples=50)
@given(label_images, label_images)
def test_over_labelled_pixels_it_is_what_the_literature_computes(predicted, truth):
    if (truth > 0).sum() < 2:
        return
    voi, ri, sc = masks_one_by_one(predicted, truth)
    scores = evaluate(predicted, truth).labelled
    assert scores.variation_of_information == pytest.approx(voi, abs=1e-9)
    assert scores.rand_index == pytest.approx(ri)
    assert scores.covering == pytest.approx(sc)


@given(label_images, label_images)
def test_tables_and_overlaps_agree_with_scikit_image_and_scikit_learn(predicted, truth):
    table = contingency_table(predicted, truth)
    expected = skimage.metrics.contingency_table(truth, predicted).toarray()
    rows, columns = table.truth_labels, table.predicted_labels
    padded = np.zeros((5, 5))
    padded[: expected.shape[0], : expected.shape[1]] = expected
    assert np.array_equal(table.counts, padded[np.ix_(rows, columns)])
    for i, row in enumerate(table.overlaps()):
        for j, overlap in enumerate(row):
            pair = truth == rows[i + 1], predicted == columns[j + 1]
            jaccard = sklearn.metrics.jaccard_score(*(each.ravel() for each in pair))
            assert overlap == pytest.approx(jaccard)


@given(label_images, label_images)
def test_clustering_is_symmetric(first, second):
    forth, back = (contingency_table(*pair) for pair in ((first, second), (second, first)))
    assert np.array_equal(forth.counts.T, back.counts)
    one, other = clustering(forth.counts), clustering(back.counts)
    assert one.variation_of_information == pytest.approx(other.variation_of_information, abs=1e-9)
    assert one.rand_index == pytest.approx(other.rand_index)
    assert one.covering == pytest.approx(other.covering)


@given(label_images, label_images, st.permutations(range(1, 5)))
def test_names_of_labels_do_not_matter(predicted, truth, names):
    renamed = np.array([0, *names])[truth] * 11
    before = evaluate(predicted, truth, minimum_pixels=3).row()
    after = evaluate(predicted, renamed, minimum_pixels=3).row()
    # Hoover's instances of equal measure go by label, so only their sums are safe.
    for name in before.keys() - {f"hoover_{kind}" for kind in COUNTS}:
        assert after[name] == pytest.approx(before[name], nan_ok=True, abs=1e-9)


@given(label_images)
def test_the_truth_itself_is_perfect(truth):
    scores = evaluate(truth, truth, valid=truth >= 0, minimum_pixels=1)
    planes, row = len(np.unique(truth[truth > 0])), scores.row()
    for policy in POLICIES.values():
        each = getattr(scores, policy)
        assert each.variation_of_information == pytest.approx(0, abs=1e-9)
        assert each.rand_index == each.covering == 1
        assert each.pixels == (truth.size if policy in ("frame", "valid") else (truth > 0).sum())
    assert row["hoover_correct"] == planes
    assert row["f1@0.8"] == 1 if planes else math.isnan(row["f1@0.8"])


@settings(max_examples=50)
@given(label_images, label_images)
def test_hoover_counts_no_region_twice(predicted, truth):
    table = contingency_table(predicted, truth).counts
    ours = hoover_counts(table)
    # An over-segmentation takes one true and at least two predicted regions, and so on.
    assert ours.missed + ours.correct + ours.over + 2 * ours.under <= len(table) - 1
    assert ours.noise + ours.correct + 2 * ours.over + ours.under <= len(table.T) - 1
    assert (ours.missed == len(table) - 1) == (ours.noise == len(table.T) - 1)


def test_inputs_are_not_changed():
    inputs = image("1121", "0022"), image("1122", "0022"), image("1111", "0011") > 0
    before = [array.copy() for array in inputs]
    for array in inputs:
        array.setflags(write=False)
    predicted, truth, valid = inputs
    assert evaluate(predicted, truth, valid=valid).row()["voi_labelled"] > 0
    assert all(np.array_equal(*pair) for pair in zip(inputs, before, strict=True))


@pytest.mark.parametrize("bad", INVALID.values(), ids=INVALID)
@pytest.mark.parametrize("name", ["predicted", "truth"])
def test_bad_images_are_refused(name, bad):
    good = {"predicted": np.ones((2, 2), int), "truth": np.ones((2, 2), int)}
    with pytest.raises(ValueError, match=name):
        evaluate(**good | {name: bad})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("predicted", np.ones((2, 3), int)),
        ("predicted", np.full((2, 2), 2**63, np.uint64)),
        ("valid", np.ones((2, 2), int)),
        ("valid", np.ones((2, 1), bool)),
        ("iou", (0.3,)),
        ("iou", (1.0,)),
        ("iou", ()),
        ("iou", 0.5),
        ("iou", ("half",)),
        ("minimum_pixels", -1),
        ("minimum_pixels", "few"),
        ("tolerance", 0.5),
        ("tolerance", "some"),
        ("truth_planes", [(0, 0, 1, 1)]),
        ("predicted_planes", [(0, 0, 1, 1)]),
    ],
)
def test_bad_settings_are_refused(name, value):
    good = {"predicted": np.ones((2, 2), int), "truth": np.ones((2, 2), int)}
    with pytest.raises(ValueError, match="predicted_planes|truth_planes" if "pl" in name else name):
        evaluate(**good | {name: value})


@pytest.mark.parametrize(
    "planes", [np.zeros((1, 4)), np.ones((1, 3)), np.ones((0, 4)), np.full((1, 4), np.nan)]
)
def test_bad_parameters_are_refused(planes):
    labels = np.ones((2, 2), int)
    with pytest.raises(ValueError, match="predicted_planes"):
        evaluate(labels, labels, predicted_planes=planes, truth_planes=[(0, 0, 1, 1)])
    with pytest.raises(ValueError, match=r"truth_planes must have shape \(3, 4\), got \(2, 4\)"):
        evaluate(labels, 3 * labels, predicted_planes=[(0, 0, 1, 1)], truth_planes=np.ones((2, 4)))


def test_other_bad_input_is_refused():
    with pytest.raises(ValueError, match="different values"):
        contingency_table(np.arange(10_000), np.arange(10_000))
    with pytest.raises(ValueError, match="counts"):
        clustering([1, 2])
    with pytest.raises(ValueError, match="counts"):
        hoover_counts([[-1]])
    for number in (np.inf, np.nan):
        for score in (clustering, hoover_counts):
            with pytest.raises(ValueError, match="counts must be finite numbers"):
                score([[number, 1], [1, number]])


@pytest.mark.parametrize("coverage", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 9, 34, 35, 499])
def test_student_t_agrees_with_scipy(coverage, freedom):
    expected = scipy.stats.t.ppf((1 + coverage) / 2, freedom)
    assert student_t(coverage, freedom) == pytest.approx(expected, rel=1e-9)


def test_mean_interval():
    values = np.random.default_rng(1).normal(3, 2, 12)
    expected = scipy.stats.ttest_1samp(values, 0).confidence_interval(0.95)
    ours = mean_interval(np.append(values, np.nan))
    assert (ours.low, ours.high) == pytest.approx(tuple(expected))
    assert (ours.mean, ours.count) == (pytest.approx(values.mean()), 12)
    one, none = mean_interval([4.0]), mean_interval([])
    assert (one.mean, one.count, math.isnan(one.low)) == (4, 1, True)
    assert (none.count, math.isnan(none.mean)) == (0, True)


@pytest.mark.parametrize("values", [[math.inf], [[1.0]], 3.0])
def test_bad_values_are_refused(values):
    with pytest.raises(ValueError, match="values"):
        mean_interval(values)


def test_bad_coverage_is_refused():
    with pytest.raises(ValueError, match="coverage"):
        mean_interval([1.0], coverage=95)
    with pytest.raises(ValueError, match="freedom"):
        student_t(0.95, 0)


def test_summary_leaves_out_what_is_not_defined():
    summary = summarise([{"a": 1.0, "b": math.nan}, {"a": 3.0, "b": 5.0}])
    assert (summary["a"].mean, summary["a"].count) == (2, 2)
    assert (summary["b"].mean, summary["b"].count) == (5, 1)
    assert np.isnan([summary["b"].low, summary["b"].high]).all()
    summary = summarise([{"a": 1.0}, {"a": 3.0, "valid": 5.0}])
    assert (summary["valid"].mean, summary["valid"].count) == (5, 1)


def test_intervals_end_where_scores_do():
    shares = "ri_frame", "sc_frame", "precision@0.5", "recall@0.5", "f1@0.5"
    rows = (dict.fromkeys(shares, 0.9) | {"voi_frame": 0.1}, dict.fromkeys(shares, 1.0))
    summary = summarise([rows[0], rows[1] | {"voi_frame": 2.0}])
    for name in shares:
        assert 0 < summary[name].low < summary[name].high == 1
    assert summary["voi_frame"].low == 0
    assert summary["voi_frame"].high > 2


def test_frames_without_labelled_or_valid_pixels_are_left_out_of_the_means():
    truth, predicted = image("1122", "1122"), image("1112", "1112")
    frames = [
        evaluate(predicted, truth, valid=truth > 0),
        evaluate(predicted, truth * 0, valid=truth < 0),
        evaluate(predicted, image("0000", "1000")),
    ]
    summary = summarise(frame.row() for frame in frames)
    for policy, count in {"labelled": 1, "k_best": 1, "frame": 3, "valid": 1}.items():
        assert {summary[f"{name}_{policy}"].count for name in ("voi", "ri", "sc")} == {count}
    assert summary["ri_labelled"].mean == frames[0].labelled.rand_index < 1


def test_every_module_that_a_user_calls_is_an_attribute():
    code = "import planewise as pw; [getattr(pw, name) for name in pw.__all__]; pw.metrics.evaluate"
    run_python(code)
