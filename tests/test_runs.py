"""The exact search for the lowest score against scoring every plane on every reading."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.kernels import runs as kernels
from planewise.paper import runs as paper_runs
from planewise.paper.evaluate import Evaluator
from planewise.paper.ray_evaluator import RayEvaluator
from planewise.paper.runs import Runs
from planewise.paper.sequential import distinct_tuples

from . import oracles

SIZES = (3, 63, 64, 65, 3000)


def readings(seed, k, noise=0.01):
    """Whitened readings on two planes and around them, and planes through some of them."""
    rng = np.random.default_rng(seed)
    rays = np.vstack((rng.uniform(-0.6, 0.6, (2, k)), np.ones(k)))
    z = rng.uniform(0.5, 4, k)
    for part, plane in ((slice(0, k // 3), [0.1, 0.2, 0.6]), (slice(k // 3, k // 2), [-0.3, 0, 1])):
        z[part] = 1 / (plane @ rays)[part] * (1 + rng.normal(0, noise, z[part].size))
    sigma = np.sqrt(2) * noise * z
    evaluator = RayEvaluator(rays * sigma, z / sigma, rng.uniform(-1, 7, k))
    planes = evaluator.through(distinct_tuples(rng, 200, k, 3))
    return evaluator, planes


def exact_scores(evaluator, planes):
    with np.errstate(divide="ignore", invalid="ignore"):
        scores = oracles.score_rays(planes, evaluator.a, evaluator.s, evaluator.tau)
    return np.nan_to_num(scores)


def in_runs(evaluator, workers=1):
    return Runs.of(evaluator.a, evaluator.s, evaluator.tau, workers)


def lowest_by(runs, planes, guess):
    """What is found where these are the scores on the sample."""
    asked = np.zeros(len(planes), np.bool_)

    def on_sample(*given):
        first, last, scores = given[-3:]
        scores[first:last], asked[first:last] = guess[first:last], True

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper_runs, "score_rays", on_sample)
        found = runs.lowest(planes)
    assert asked.all()
    return found


@pytest.mark.parametrize("k", [3, 64, kernels.STRIP + 5000])
def test_order_rays_has_every_reading_once(k):
    evaluator, _ = readings(k, k)
    order = np.full(k, -1, np.int32)
    kernels.order_rays(evaluator.a, evaluator.s, 0, -(-k // kernels.STRIP), order)
    assert_array_equal(np.sort(order), np.arange(k))


@pytest.mark.parametrize("k", SIZES)
def test_pack_rays_holds_and_bounds_the_readings_of_every_run(k):
    evaluator, _ = readings(k, k)
    runs = in_runs(evaluator)
    flat = runs.data.transpose(1, 0, 2).reshape(5, -1)
    order = np.lexsort(flat[:4, :k])
    expected = np.vstack((evaluator.a, evaluator.s, evaluator.tau)).astype(np.float32)
    assert_array_equal(flat[:, :k][:, order], expected[:, np.lexsort(expected[:4])])
    assert not flat[4, k:].any()
    for part, box, worth in zip(
        runs.data.astype(float), runs.box.T.astype(float), runs.worth, strict=True
    ):
        a, s, tau = part[:3].T, part[3], part[4]
        assert (np.abs(a - box[:3]) <= box[3:6]).all()
        gaining = tau > 0
        assert (box[6] <= (s - np.sqrt(np.maximum(tau, 0)))[gaining]).all()
        assert (box[7] >= (s + np.sqrt(np.maximum(tau, 0)))[gaining]).all()
        assert tau[gaining].sum() <= worth <= tau[gaining].sum() * 1.0001 + 1


@pytest.mark.parametrize("k", SIZES)
@pytest.mark.parametrize("noise", [0.001, 0.02, 0.5])
def test_scores_are_bounded_and_then_exact(k, noise):
    evaluator, planes = readings(k, k, noise)
    runs, theta = in_runs(evaluator), planes.astype(np.float32)
    rest, total = np.empty(len(theta), np.int64), np.zeros(len(theta))
    kernels.bound_rays(theta, runs.box, runs.worth, 0, len(theta), rest)
    exact = exact_scores(evaluator, theta.astype(float))
    assert (-rest <= exact + 1e-3 * np.abs(exact)).all()
    chosen = np.arange(len(theta))
    whole = (theta, runs.data, runs.box, runs.worth, chosen)
    kernels.score_runs(*whole, np.inf, 0, len(theta), rest, total)
    assert not rest.any()
    assert_allclose(total, exact, rtol=2e-4, atol=0.05)
    # What is given up stays above the score that it was held against.
    best = float(np.median(total))
    again = np.zeros(len(theta))
    kernels.bound_rays(theta, runs.box, runs.worth, 0, len(theta), rest)
    kernels.score_runs(*whole, best, 0, len(theta), rest, again)
    assert_array_equal(again[total <= best], total[total <= best])
    assert (again[total > best] > best).all()


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    k=st.sampled_from(SIZES),
    noise=st.sampled_from([0.0005, 0.01, 0.1, 1.0]),
    workers=st.integers(1, 3),
)
def test_the_lowest_score_is_found_whatever_is_scored_first(seed, k, noise, workers):
    evaluator, planes = readings(seed, k, noise)
    planes[3], planes[5] = np.nan, -planes[4]  # behind the sensor
    exact = exact_scores(evaluator, planes.astype(np.float32).astype(float))
    rng = np.random.default_rng(seed)
    runs = in_runs(evaluator, workers)
    guesses = exact, -exact, rng.random(len(planes))
    found = {lowest_by(runs, planes, guess) for guess in guesses}
    assert len(found) == 1
    pick, score = found.pop()
    assert exact[pick] <= exact.min() + 1e-3 * abs(exact.min())
    assert score == pytest.approx(exact[pick], rel=1e-3, abs=0.05)


def test_of_equal_planes_the_first_is_taken():
    evaluator, planes = readings(0, 3000)
    runs = in_runs(evaluator)
    pick, score = lowest_by(runs, planes, np.zeros(len(planes)))
    twice = np.vstack((planes, planes))
    assert lowest_by(runs, twice, np.zeros(len(twice))) == (pick, score)


def test_planes_that_save_nothing_score_zero():
    evaluator, _ = readings(0, 3000)
    planes = np.full((20, 3), np.nan)
    assert evaluator.lowest(planes) == (0, 0.0)


@pytest.mark.parametrize("depth", ["roof", "room", "flat", "rows"])
@pytest.mark.parametrize("threads", [1, 2])
def test_the_search_finds_what_scoring_everything_finds(monkeypatch, roof, camera, depth, threads):
    sensor = pw.Sensor(max_depth=10, noise=0.004)
    image = {"roof": roof[0], "flat": np.full((48, 64), 2.0), "rows": np.full((48, 64), 2.0)}
    if depth == "room":
        scene = pw.scenes.room(3)
        arguments = scene.depth, scene.camera, scene.sensor
    else:
        arguments = image[depth], camera, sensor
    if depth == "rows":
        image["rows"][5:] = 0.0
    options = {"search": "sequential", "inlier_ratio": 0.2, "threads": threads}
    fast = pw.detect_planes(*arguments, **options)
    monkeypatch.setattr(RayEvaluator, "lowest", Evaluator.lowest)
    plain = pw.detect_planes(*arguments, **options)
    assert fast.information == plain.information
    assert_array_equal(fast.labels, plain.labels)
    assert_array_equal(fast.coefficients, plain.coefficients)
