import dataclasses
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise import scenes
from planewise.batch.frame_work import Recipe
from planewise.model import Curve, Move
from planewise.objective import PAPER as PAPER_OBJECTIVE
from planewise.observation import RayObservation
from planewise.outlines.outlines import Surface
from planewise.paper import rank
from planewise.paper.evaluate import Assignment, evaluator
from planewise.paper.problem import Problem, Solution
from planewise.paper.rank import merge_found, merge_into_better
from planewise.partition import PartitionOptions
from planewise.point_observation import PointObservation
from planewise.results.planes_json import describe_model
from planewise.sensor_files import describe_exactly

from . import oracles
from .conftest import render

SENSOR = pw.Sensor(max_depth=10, noise=0.002)
PAPER = {"search": "joint", "objective": "paper"}
WAYS = {"paper": PAPER, "sequential": {"search": "sequential"}, "spatial": {}}
every_way = pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)


def angle(a, b):
    """Degrees between two unit vectors."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


@every_way
def test_a_roof_has_two_planes(roof, camera, way):
    depth, planes, labels = roof
    model = pw.detect_planes(depth, camera, SENSOR, **way)
    assert len(model) == 2
    for plane in model.planes:
        errors = [angle(plane.normal, row[:3]) for row in planes]
        truth = planes[np.argmin(errors)]
        assert min(errors) < 0.2
        assert plane.distance == pytest.approx(truth[3], abs=0.002)
        assert plane.rms == pytest.approx(0.002, rel=0.1)
    first = np.argmin([angle(model.planes[0].normal, row[:3]) for row in planes]) + 1
    agree = (model.labels == 1) == (labels == first)
    assert agree.mean() > 0.95


@pytest.mark.parametrize("way", [PAPER, WAYS["sequential"]], ids=["joint", "sequential"])
def test_phi_is_that_of_an_independent_program(roof, camera, way):
    depth = roof[0].copy()
    depth[3:9, 4:20] = 0
    sensor = pw.Sensor(max_depth=9, noise=pw.noise.quadratic(0.002, 0.001))
    model = pw.detect_planes(depth, camera, sensor, **way)
    phi = oracles.phi(
        depth,
        camera.rays(depth.shape),
        model.labels,
        model.coefficients,
        sensor.sigma(depth),
        9,
        0.001,
    )
    assert model.information == pytest.approx(phi, rel=1e-9)
    judge = pw.information(pw.observe(depth, camera, sensor), model.planes, model.labels)
    assert judge == pytest.approx(phi, rel=1e-12)
    assert model.curve[len(model)] == pytest.approx(phi, rel=1e-9)
    assert model.curve[model.curve.chosen] == min(model.curve)


@every_way
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_answer_does_not_depend_on_threads(roof, camera, way, threads):
    one = pw.detect_planes(roof[0], camera, SENSOR, **way, threads=1)
    more = pw.detect_planes(roof[0], camera, SENSOR, **way, threads=threads)
    assert one.information == more.information
    assert_array_equal(one.labels, more.labels)
    assert_array_equal(one.coefficients, more.coefficients)


@every_way
def test_a_seed_fixes_the_answer(roof, camera, way):
    detector = pw.Detector(camera, SENSOR, **way, rng=3)
    first, second = detector(roof[0]), detector(roof[0])
    assert_array_equal(first.coefficients, second.coefficients)
    generator = pw.detect_planes(roof[0], camera, SENSOR, **way, rng=np.random.default_rng(3))
    assert_array_equal(first.coefficients, generator.coefficients)


@every_way
@pytest.mark.parametrize("value", [0.0, np.nan])
def test_a_frame_without_readings_gives_an_empty_model_that_says_why(camera, way, value):
    model = pw.detect_planes(np.full((48, 64), value), camera, SENSOR, **way)
    assert len(model) == 0
    assert model.coefficients.shape == (0, 4)
    assert not model.labels.any()
    assert model.information == 0
    assert model.note == "0 valid readings; 3 are needed for a plane"
    assert model.curve.reason == model.note


@every_way
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_a_handful_of_readings(camera, way, count):
    depth = np.zeros((48, 64))
    depth.flat[np.arange(count) * 500] = 2.0
    model = pw.detect_planes(depth, camera, SENSOR, **way)
    assert model.readings == count
    # Up to four readings cannot pay for the three parameters of a plane and a mask.
    assert len(model) == 0
    assert model.note


@every_way
def test_readings_on_one_line_are_no_plane_and_no_error(camera, way):
    depth = np.zeros((48, 64))
    depth[20] = 2.0
    model = pw.detect_planes(depth, camera, SENSOR, **way)
    assert np.isfinite(model.information)
    assert np.isfinite(model.coefficients).all()


@every_way
def test_a_constant_depth_is_a_plane(camera, way):
    model = pw.detect_planes(np.full((48, 64), 2.0), camera, SENSOR, **way)
    assert len(model) == 1
    plane = model.planes[0]
    assert_allclose(plane.normal, [0, 0, -1], atol=1e-9)
    assert plane.distance == pytest.approx(2)
    assert plane.count == 48 * 64
    assert plane.rms == pytest.approx(0, abs=1e-6)
    assert plane.area == pytest.approx(48 * 64 * 4 / (50 * 52))
    assert plane.bounding_box == (0, 0, 48, 64)
    assert_allclose(plane.centroid, [2 * (31.5 - 31) / 50, 2 * (23.5 - 24.5) / 52, 2], atol=1e-9)


@every_way
def test_uniform_noise_has_no_plane(camera, way):
    depth = np.random.default_rng(0).uniform(0.1, 10, (48, 64))
    model = pw.detect_planes(depth, camera, SENSOR, **way)
    assert len(model) == 0
    assert model.note
    assert model.information == pytest.approx(model.curve[0])


def test_planes_are_ranked_and_the_best_can_be_kept(camera):
    planes = np.array([[0, 0, -1, 1.6], [0.6, 0, -0.8, 1.5], [-0.6, 0, -0.8, 1.5]])
    depth, _ = render(planes, camera, (48, 64))
    depth += np.random.default_rng(0).normal(0, 0.002, depth.shape)
    model = pw.detect_planes(depth, camera, SENSOR, objective="paper")
    assert len(model) == 3
    worth = [plane.information for plane in model.planes]
    assert worth == sorted(worth)
    assert worth[0] < 0
    observation = pw.observe(depth, camera, SENSOR)
    for k in range(5):
        best = model.top(k)
        assert len(best) == min(k, 3)
        assert best.labels.max(initial=0) == len(best)
        judge = pw.information(observation, best.planes, best.labels)
        assert best.information == pytest.approx(judge, rel=1e-9)
    for bad in (-1, 1.5, "2"):
        with pytest.raises(ValueError, match="k must be a whole number"):
            model.top(bad)


def test_statistics_of_each_plane_match_its_readings(roof, camera):
    model = pw.detect_planes(roof[0], camera, SENSOR)
    observation = pw.observe(roof[0], camera, SENSOR)
    marks = model.labels.reshape(-1)[observation.index]
    for j, plane in enumerate(model.planes, start=1):
        mine = marks == j
        residual = observation.residuals(plane.coefficients)[mine]
        assert plane.count == mine.sum()
        assert plane.rms == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-6)
        assert_allclose(plane.centroid, observation.positions()[mine].mean(axis=0))
        assert plane.mean_information == pytest.approx(plane.information / plane.count)
        assert replace(plane, count=0).mean_information == 0
        assert np.linalg.norm(plane.normal) == pytest.approx(1)
        assert plane.distance >= 0
        rows, columns = np.nonzero(model.labels == j)
        assert plane.bounding_box == (
            rows.min(),
            columns.min(),
            rows.max() + 1,
            columns.max() + 1,
        )


def test_covariance_is_the_scatter_of_the_estimates(camera):
    """The Cramer-Rao bound: over many noisy frames of a plane the estimates scatter so."""
    plane = np.array([0.3, -0.2, -0.93, 1.5])
    plane[:3] /= np.linalg.norm(plane[:3])
    depth, _ = render(plane[None], camera, (48, 64))
    rng = np.random.default_rng(0)
    found, claimed = [], []
    for _ in range(200):
        model = pw.detect_planes(depth + rng.normal(0, 0.002, depth.shape), camera, SENSOR)
        found.append(model.coefficients[0])
        claimed.append(model.planes[0].covariance)
    deviation = np.array(found) - plane
    expected = np.mean(claimed, axis=0)
    assert_allclose(np.cov(deviation.T), expected, atol=0.25 * np.abs(expected).max())
    distance_sigma = np.sqrt(expected[3, 3])
    assert np.std(deviation[:, 3]) == pytest.approx(distance_sigma, rel=0.2)


@pytest.mark.parametrize("drifts", [False, True])
@settings(max_examples=10)
@given(factor=st.floats(0.1, 10) | st.sampled_from([0.125, 0.5, 2.0, 8.0]))
def test_scaling_the_scene_scales_the_planes(factor, drifts):
    """Exactly so by powers of two; else 1 / z, in single precision, is rounded otherwise.

    How far the error drifts, where it may, is told by quantiles of it, which moves Phi by more.
    """

    def detect(factor):
        parts = None if drifts else pw.noise.ErrorParts(white=0.002 * factor, shared=0, drift=0)
        sensor = pw.Sensor(
            max_depth=10 * factor, resolution=0.001 * factor, noise=0.002 * factor, parts=parts
        )
        return pw.detect_planes(depth * factor, camera, sensor)

    camera = pw.PinholeCamera(fx=50, fy=52, cx=31.0, cy=24.5)
    planes = np.array([[0.5, 0.0, -0.8, 1.4], [-0.5, 0.1, -0.8, 1.4]])
    planes[:, :3] /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    depth, _ = render(planes, camera, (48, 64))
    depth += np.random.default_rng(7).normal(0, 0.002, depth.shape)
    plain, scaled = detect(1.0), detect(factor)
    exact = math.frexp(factor)[0] == 0.5
    within = 1e-12 if exact else 5e-6 if drifts else 1e-6
    assert scaled.information == pytest.approx(plain.information, rel=within)
    assert (scaled.labels != plain.labels).mean() < 0.002
    assert_allclose(scaled.coefficients[:, 3], factor * plain.coefficients[:, 3], rtol=1e-4)


def test_integer_and_float_depth_agree(roof, camera):
    raw = np.round(roof[0] * 1000).astype(np.uint16)
    integer = pw.detect_planes(raw, camera, SENSOR)
    metres = pw.detect_planes(raw * 0.001, camera, SENSOR)
    assert integer.information == pytest.approx(metres.information, rel=1e-9)


@pytest.mark.parametrize("seed", [0, 9])
def test_a_limit_makes_no_other_planes(seed):
    """It used to count those that were cut later, and gave fewer with a higher Phi."""
    room = scenes.room(seed, size=(240, 320))

    def found(**options):
        return pw.detect_planes(room.depth, room.camera, room.sensor, **options)

    for options in ({}, {"instances": True}):
        full = found(**options)
        for most in (len(full), len(full) + 3):
            same = found(**options, max_planes=most)
            assert_array_equal(same.labels, full.labels)
            assert same.information == full.information
            assert same.curve.reason == full.curve.reason
        few, best = found(**options, max_planes=5), full.top(5)
        assert_array_equal(few.labels, best.labels)
        assert few.information == pytest.approx(best.information, rel=1e-12)
        assert few.curve.reason == "reached max_planes = 5"
        assert few.curve.chosen == np.argmin(list(few.curve)) == 5


def test_a_limit_makes_no_other_planes_of_points():
    rng = np.random.default_rng(0)
    boxes = [
        rng.uniform(0, 1, (n, 3)) * (1, 1, 0) + (2 * k, 0, k) for k, n in enumerate((900, 600, 400))
    ]
    points = np.concatenate(boxes) + rng.normal(0, 0.005, (1900, 3)) * (0, 0, 1)
    sensor = pw.Sensor(noise=0.005, max_depth=10.0)
    full = pw.detect_planes_in_points(points, sensor)
    assert len(full) == 3
    same = pw.detect_planes_in_points(points, sensor, max_planes=3)
    assert_array_equal(same.labels, full.labels)
    assert (same.information, same.curve.reason) == (full.information, full.curve.reason)
    few = pw.detect_planes_in_points(points, sensor, max_planes=2)
    assert_array_equal(few.labels, full.top(2).labels)
    assert few.curve.reason == "reached max_planes = 2"


def test_max_planes_is_kept(roof, camera):
    for way in WAYS.values():
        model = pw.detect_planes(roof[0], camera, SENSOR, **way, max_planes=1)
        assert len(model) == 1
        assert "max_planes = 1" in model.curve.reason


def test_moves_and_curve_are_recorded(roof, camera):
    model = pw.detect_planes(roof[0], camera, SENSOR, **PAPER)
    assert model.curve.moves[0].kind == "greedy"
    assert model.curve.moves[-1].information == pytest.approx(model.information)
    assert model.curve.reason == "no move lowers the information"
    assert len(model.curve) >= 3
    assert list(model.curve) == model.curve.information.tolist()
    assert model.curve[0] == pytest.approx(model.readings * np.log(10 / 0.001))


def test_the_model_is_the_minimum_of_its_curve():
    # Phi of all readings may fall with planes that did not pay on the sample.
    rooms = [pw.scenes.room(seed) for seed in (3, 4)]
    for room in rooms:
        model = pw.detect_planes(room.depth, room.camera, pw.sensors.KINECT_V1, **PAPER)
        assert np.argmin(model.curve.information) == model.curve.chosen == len(model)
        assert model.curve[len(model)] == pytest.approx(model.information, rel=1e-12)
        observed = pw.observe(room.depth, room.camera, pw.sensors.KINECT_V1)
        phi = pw.information(observed, model.planes, model.labels)
        assert phi == pytest.approx(model.information, rel=1e-12)


def test_the_curve_is_that_of_the_planes_left_where_some_merged():
    scene = pw.scenes.room(6, size=(240, 320))
    model = pw.detect_planes(
        scene.depth, scene.camera, scene.sensor, search="sequential", inlier_ratio=0.25
    )
    assert model.curve[len(model)] == model.information == min(model.curve)
    assert model.curve.chosen == len(model)
    *found, merged = model.curve.moves
    assert {move.kind for move in found} == {"add"}
    assert merged == Move(kind="merge", planes=len(model), information=model.information)
    assert merged.information < min(move.information for move in found)


def test_planes_that_do_not_pay_once_others_merged_are_left_out(roof, camera):
    depth, planes, labels = roof
    observation = pw.observe(depth, camera, SENSOR)
    readings = evaluator(observation, PAPER_OBJECTIVE.thresholds(observation))
    theta = -planes[:, :3] / planes[:, 3:]
    # The second plane is the first one again, the third has a few readings.
    given = np.where(labels.ravel() == 1, 1 + np.arange(labels.size) % 3 // 2, 0)
    given[np.flatnonzero(labels.ravel() == 2)[:200]] = 3
    each = np.stack([readings.assign(theta[j : j + 1]).best for j in (0, 0, 1)])
    gains = np.where(given > 0, each[given - 1, np.arange(given.size)], 0.0)
    few = -float(gains[given == 3].sum())
    problem = Problem(
        evaluator=readings, empty=1e5, structure=np.array([0, 1, 2 + 2 * few, 3 + 2 * few])
    )
    assignment = Assignment.of(given.astype(np.uint16), gains, 3)
    found = Solution(theta[[0, 0, 1]], assignment, problem.phi(3, assignment.gain))
    before = Curve(information=problem.phis(assignment), chosen=3, reason="")
    left, curve = merge_found(problem, found, before)
    assert [(move.kind, move.planes) for move in curve.moves] == [("merge", 2), ("cut", 1)]
    assert left.phi == curve[1] == min(curve) == problem.phi(1, left.assignment.gain)
    assert (len(left), curve.chosen, len(curve)) == (1, 1, 3)
    assert_array_equal(left.assignment.labels, labels.ravel() == 1)
    assert_array_equal(assignment.labels, given)  # its input is as it was


def test_readings_that_were_merged_go_on_to_a_still_better_plane(roof, camera):
    depth, planes, labels = roof
    observation = pw.observe(depth, camera, SENSOR)
    readings = evaluator(observation, PAPER_OBJECTIVE.thresholds(observation))
    theta = -planes[:1, :3] / planes[:1, 3:]
    theta = np.vstack((theta, theta * 1.0003, theta * 1.0003))
    # The last plane is the second one again; that has fewer readings than the first.
    given = np.where(
        labels.ravel() == 1, 1 + np.searchsorted([12, 18], np.arange(labels.size) % 20), 0
    )
    each = np.stack([readings.assign(theta[j : j + 1]).best for j in range(3)])
    gains = np.where(given > 0, each[given - 1, np.arange(given.size)], 0.0)
    problem = Problem(evaluator=readings, empty=0.0, structure=np.array([0.0, 1e5, 2e5, 3e5]))
    assignment = Assignment.of(given.astype(np.uint16), gains, 3)
    merged = merge_into_better(problem, Solution(theta, assignment, 0.0))
    on_first = np.where(labels.ravel() == 1, each[0], 0.0)
    assert_array_equal(merged.parameters, theta[:1])
    assert_array_equal(merged.assignment.labels, on_first < 0)
    assert_array_equal(merged.assignment.best, on_first)
    assert merged.phi == problem.phi(1, merged.assignment.gain)


@pytest.mark.parametrize("seed", [2, 3, 6])
def test_earlier_planes_explain_no_reading_of_planes_found_in_turn(monkeypatch, seed):
    scene = pw.scenes.room(seed, size=(240, 320))
    merged = []

    def of_all_planes(problem, solution, *, in_turn):
        assert in_turn
        merged.extend(merge_into_better(problem, solution, in_turn=way) for way in (True, False))
        return merged[0]

    monkeypatch.setattr(rank, "merge_into_better", of_all_planes)
    arguments = scene.depth, scene.camera, scene.sensor
    model = pw.detect_planes(*arguments, search="sequential", inlier_ratio=0.25)
    some, every = merged
    assert some.phi == every.phi
    assert_array_equal(some.parameters, every.parameters)
    assert_array_equal(some.assignment.labels, every.assignment.labels)
    assert_array_equal(some.assignment.best, every.assignment.best)
    assert ("merge" in {move.kind for move in model.curve.moves}) == (seed != 2)


def test_a_search_of_next_to_no_confidence_takes_one_sample_a_plane(roof, camera):
    options = {"search": "sequential", "confidence": 1e-17}
    assert len(pw.detect_planes(roof[0], camera, SENSOR, **options)) > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"search": "ransac"}, "search must be 'joint' or 'sequential', got 'ransac'"),
        ({"objective": "best"}, "objective must be"),
        ({"confidence": 1.0}, "confidence must lie between 0 and 1"),
        ({"inlier_ratio": 0.0}, "inlier_ratio must lie between 0 and 1"),
        ({"max_planes": 0}, "max_planes must lie in"),
        ({"max_planes": 70000}, "max_planes must lie in"),
        ({"max_planes": 2.5}, "max_planes must lie in 1 ... 65535, a whole number, got 2.5"),
        ({"threads": 0}, "threads must be a whole number of at least 1, got 0"),
        ({"threads": 1.5}, "threads must be a whole number of at least 1, got 1.5"),
        ({"significance": -0.5}, "significance must be a number of nats, not negative, got -0.5"),
        ({"significance": "5"}, "significance must be a number of nats, not negative, got '5'"),
        ({"confidence": "x", "search": "sequential"}, "confidence must lie between 0 and 1"),
        ({"rng": "a"}, "rng must be a seed, not negative, or a numpy.random.Generator, got 'a'"),
        ({"rng": -1}, "rng must be a seed, not negative, .* got -1"),
        ({"rng": True}, "rng must be a seed, not negative, .* got True"),
        ({"max_planes": True}, "max_planes must lie in 1 ... 65535, a whole number, got True"),
        ({"instances": "no"}, "instances must be True or False, got 'no'"),
        ({"search": ["joint"]}, r"search must be 'joint' or 'sequential', got \['joint'\]"),
        ({"partition_options": None}, "partition_options must be a planewise.partition.Partition"),
    ],
)
def test_bad_options_are_refused(roof, camera, options, message):
    with pytest.raises(ValueError, match=message):
        pw.detect_planes(roof[0], camera, SENSOR, **options)


@pytest.mark.parametrize(
    ("ratio", "samples"), [(1e-200, "inf"), (1e-4, "4.61e[+]12"), (1e-3, "4.61e[+]09")]
)
def test_a_share_that_needs_too_many_samples_is_refused_where_they_are_drawn(
    roof, camera, ratio, samples
):
    message = f"got {ratio}: a plane in 3 dimensions would take {samples} .* give at least 0.008,"
    options = {"search": "sequential", "inlier_ratio": ratio}
    for refused in (
        lambda: pw.detect_planes(roof[0], camera, SENSOR, **options),
        lambda: pw.Detector(camera, SENSOR, **options),
        lambda: Recipe(sensor=SENSOR, options=pw.Options(**options)),
    ):
        with pytest.raises(ValueError, match=message):
            refused()
    for others in ({"search": "joint"}, PAPER, {"partition": "blocks"}):
        assert len(pw.Detector(camera, SENSOR, **(options | others))(roof[0])) > 0


@pytest.mark.parametrize("name", ["region_inlier_ratio", "remainder_inlier_ratio"])
def test_of_regions_too_small_a_share_is_named_before_a_frame_is_there(roof, camera, name):
    how = PartitionOptions(**{name: 1e-4})
    options = {"partition": "blocks", "partition_options": how}
    for search in ({"search": "sequential"}, PAPER):
        with pytest.raises(ValueError, match=f"^{name} is too small, got 0.0001"):
            pw.Detector(camera, SENSOR, **(options | search))
    assert len(pw.Detector(camera, SENSOR, **options)(roof[0])) > 0  # draws none
    few = PartitionOptions(**{name: 0.005}, confidence=0.5)  # a seventh of the samples of 0.99
    pw.Detector(camera, SENSOR, **(options | PAPER | {"partition_options": few}))


@pytest.mark.parametrize("scale", [0, -0.001, np.nan, np.inf, "1mm", True])
def test_a_detector_refuses_a_bad_unit_at_once(camera, scale):
    with pytest.raises(ValueError, match="depth_scale must be a positive number of metres, got"):
        pw.Detector(camera, SENSOR, depth_scale=scale)


@pytest.mark.parametrize(
    "given", ["nyu", None, (525.0, 525.0, 319.5, 239.5), np.eye(3), pw.PinholeCamera]
)
def test_what_is_no_camera_or_sensor_is_named(roof, camera, given):
    depth, points = roof[0], np.zeros((9, 3))
    for call in (
        lambda: pw.detect_planes(depth, given, SENSOR),
        lambda: pw.Detector(given, SENSOR),
        lambda: pw.estimate_noise(depth, given, SENSOR),
    ):
        with pytest.raises(ValueError, match=r"camera must be a planewise\.PinholeCamera .* got"):
            call()
    for call in (
        lambda: pw.detect_planes(depth, camera, given),
        lambda: pw.Detector(camera, given),
        lambda: pw.estimate_noise(depth, camera, given),
        lambda: pw.detect_planes_in_points(points, given),
        lambda: pw.detect_planes_in_points(points, given, objective="paper"),
    ):
        with pytest.raises(ValueError, match=r"sensor must be a planewise\.Sensor, .* got"):
            call()


def test_all_options_are_known_to_those_who_check_types():
    from planewise.options import GivenOptions

    declared = {each.name for each in dataclasses.fields(pw.Options)}
    assert GivenOptions.__annotations__.keys() == declared


@pytest.mark.parametrize(
    "options",
    [
        {"rng": np.int64(3), "max_planes": np.uint8(3), "significance": np.float32(2)},
        {"instances": np.True_, "threads": np.int64(1)},
        {"search": "sequential", "confidence": np.float32(0.9), "inlier_ratio": np.float64(0.5)},
    ],
)
def test_numbers_of_numpy_are_recorded_as_plain_ones(roof, camera, options):
    lengths = {"max_depth": 10, "min_depth": 0.1, "resolution": 0.001, "depth_range": 9}
    sensor = pw.Sensor(
        **{name: np.float32(value) for name, value in lengths.items()},
        noise=pw.noise.constant(np.float32(0.002)),
    )
    units = (1000 * roof[0]).astype(np.uint16)
    model = pw.detect_planes(units, camera, sensor, depth_scale=np.float32(0.001), **options)
    assert len(model) == 2
    plain = {name: getattr(value, "item", lambda v=value: v)() for name, value in options.items()}
    told = {name: model.settings[name] for name in options if name in model.settings}
    assert json.loads(json.dumps(dict(model.settings))) == model.settings
    assert told == {name: plain[name] for name in told}
    json.dumps(describe_exactly(sensor))
    record = describe_model(
        model, camera=camera, sensor=sensor, depth=units, depth_scale=np.float32(0.001)
    )
    assert json.loads(json.dumps(record))["input"]["depth_scale"] == pytest.approx(0.001)


def test_why_there_is_no_plane(camera):
    rng = np.random.default_rng(0)
    mixed = pw.PinholeCamera(fx=70, fy=70, cx=40, cy=30)
    sensor = pw.Sensor(noise=0.005)
    nothing = pw.detect_planes(rng.uniform(1, 5, (60, 80)), mixed, sensor, search="sequential")
    assert len(nothing.curve) > 1
    assert (len(nothing), nothing.note) == (0, "no plane saves more than it costs")
    floor = rng.uniform(0, 3, (2000, 3)) * (1, 1, 0) + (0, 0, 2)
    for options, count, why in (
        ({}, 1, ""),
        (
            {"significance": 1e6},
            0,
            "no plane saves more than it costs by more than significance = 1e+06 nats; "
            "flat pieces of curved surfaces are none",
        ),
    ):
        model = pw.detect_planes_in_points(floor, sensor, **options)
        assert (len(model), model.note) == (count, why)
    assert pw.detect_planes(np.full((48, 64), 2.0), camera, SENSOR).top(0).note


def test_what_is_curved_all_over_is_said_to_be_no_plane():
    wide = pw.PinholeCamera(fx=400, fy=400, cx=159.5, cy=119.5)
    stretch = 1 + np.square((np.arange(320) - 159.5) / 400)  # a pillar of 1 m about z = 2.5 m
    near = (2.5 - np.sqrt(2.5**2 - stretch * (2.5**2 - 1))) / stretch
    depth = near + np.random.default_rng(0).normal(0, 0.001, (240, 320))
    model = pw.detect_planes(depth, wide, pw.Sensor(noise=0.001))
    assert len(model) == 0
    assert model.note.endswith("; flat pieces of curved surfaces are none")


def test_masked_readings_and_those_at_infinity_are_none(roof, camera):
    depth = roof[0].astype(np.float32)
    left = np.broadcast_to(np.arange(64) < 32, depth.shape)
    alone = pw.detect_planes(np.where(left, 0, depth), camera, SENSOR)
    assert alone.readings == depth.size // 2
    for masked in (
        np.ma.masked_array(depth, mask=left),
        np.ma.masked_array((1000 * depth).round().astype(np.uint16), mask=left),
        np.where(left, -np.inf, depth),
    ):
        model = pw.detect_planes(masked, camera, SENSOR)
        assert model.readings == alone.readings
        assert not model.labels[left].any()
        assert len(model) == len(alone)
    with pytest.raises(ValueError, match=r"must not be negative, got -1\.0"):
        pw.detect_planes(np.where(left, -np.inf, -depth / depth), camera, SENSOR)


def test_planes_can_be_looked_up_and_models_are_short_to_read(roof, camera):
    model, again = (pw.detect_planes(roof[0], camera, SENSOR) for _ in range(2))
    assert model.planes.index(model.planes[1]) == 1
    assert again.planes[0] not in model.planes
    assert model != again
    assert len({model, again, *model.planes}) == 4
    phi = f"Phi = {model.information:,.0f} nats"
    assert repr(model) == f"<PlaneModel: 2 planes, {phi}, 3,072 readings>"
    assert repr(model.planes[0]).startswith("<Plane: normal (")


def test_an_objective_can_be_put_together(roof, camera):
    class FreeMask:
        def information(self, readings, planes):
            return 0.0

    custom = pw.Objective(mask=FreeMask())
    model = pw.detect_planes(roof[0], camera, SENSOR, objective=custom)
    paper = pw.detect_planes(roof[0], camera, SENSOR, **PAPER)
    assert model.objective == "custom"
    assert model.information < paper.information
    assert len(model) >= len(paper)


@pytest.mark.parametrize("options", [{}, {"search": "sequential"}, {"partition": "blocks"}])
def test_a_mask_that_costs_without_planes_costs_once(roof, camera, options):
    class Dearer:
        def information(self, readings, planes):
            return 1000.0 + readings * np.log(planes + 1)

    dearer = pw.detect_planes(
        roof[0], camera, SENSOR, objective=pw.Objective(mask=Dearer()), **options
    )
    paper = pw.detect_planes(roof[0], camera, SENSOR, objective="paper", **options)
    assert dearer.information - paper.information == pytest.approx(1000)
    assert_allclose(np.subtract(dearer.prefix, paper.prefix), 1000)
    assert_allclose(dearer.curve.information - paper.curve.information, 1000)


@pytest.mark.parametrize(
    ("nats", "message"),
    [
        (lambda count: np.full(count, np.nan), "null.information must return finite nats, got nan"),
        (lambda count: np.zeros(count - 1), r"for each of 3072 readings, .* got shape \(3071,\)"),
        (lambda count: 9.0, r"for each of 3072 readings, .* got shape \(\)"),
        (lambda count: ["a"] * count, "for each of 3072 readings, .* got dtype"),
    ],
)
def test_an_objective_has_to_price_every_reading(roof, camera, nats, message):
    class Null:
        def information(self, observation):
            return nats(observation.count)

    with pytest.raises(ValueError, match=f"objective: .*{message}"):
        pw.detect_planes(roof[0], camera, SENSOR, objective=pw.Objective(null=Null()))


@pytest.mark.parametrize("nats", [np.nan, None, "1"])
def test_masks_that_cost_no_number_are_refused(roof, camera, nats):
    class Mask:
        def information(self, count, planes):
            return nats

    with pytest.raises(ValueError, match=r"mask\.information must return finite nats, got"):
        pw.detect_planes(roof[0], camera, SENSOR, objective=pw.Objective(mask=Mask()))


@pytest.mark.parametrize("part", ["white", "shared", "drift"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -0.001])
def test_parts_of_the_noise_that_are_no_sigma_are_refused(roof, camera, part, wrong):
    parts = dict.fromkeys(("white", "shared", "drift"), pw.noise.constant(0.002))
    parts[part] = lambda z: np.where(z > z.min(), 0.002, wrong)
    sensor = replace(SENSOR, parts=pw.noise.ErrorParts(**parts))
    with pytest.raises(ValueError, match="parts of a sensor's noise must be finite"):
        pw.detect_planes(roof[0], camera, sensor)


@pytest.mark.parametrize("part", ["white", "drift"])
def test_parts_of_the_noise_of_another_shape_are_refused(roof, camera, part):
    parts = {"white": 0.002, "shared": 0, "drift": 0, part: lambda z: np.full(3, 0.002)}
    sensor = replace(SENSOR, parts=pw.noise.ErrorParts(**parts))
    with pytest.raises(ValueError, match=rf"parts\.{part} must return one sigma per depth"):
        pw.detect_planes(roof[0], camera, sensor)


def test_what_is_no_objective_is_refused():
    with pytest.raises(ValueError, match=r"objective must be 'paper', 'spatial' .* got \[\]"):
        pw.Options(objective=[])
    with pytest.raises(ValueError, match="mask must have a method information, got None"):
        pw.Objective(mask=None)


def test_the_objective_follows_from_what_there_is(roof, camera):
    image = pw.detect_planes(roof[0], camera, SENSOR)
    sequential = pw.detect_planes(roof[0], camera, SENSOR, search="sequential")
    points = pw.detect_planes_in_points(np.zeros((3, 3)), SENSOR)
    hyper = pw.detect_planes_in_points(np.zeros((4, 4)), SENSOR)
    assert [m.objective for m in (image, points)] == ["spatial", "spatial"]
    assert [m.objective for m in (sequential, hyper)] == ["paper", "paper"]
    assert image.settings["objective"] == "spatial"


@pytest.mark.parametrize(
    "kind",
    [
        pw.scenes.scene.Scene, pw.PointCloud, pw.NoiseEstimate, pw.metrics.ContingencyTable,
        pw.datasets.DatasetFrame, pw.batch.StoredFrame, RayObservation, PointObservation, Surface,
    ],
)  # fmt: skip
def test_what_holds_arrays_is_the_same_only_as_itself(kind):
    assert kind.__eq__ is object.__eq__
    assert kind.__hash__ is object.__hash__


@pytest.mark.parametrize(
    ("options", "most"),
    [({}, None), ({"objective": "spatial", "max_planes": 5}, 5), ({"objective": "paper"}, 64),
     ({"search": "sequential"}, 8), ({"search": "sequential", "partition": "blocks"}, None),
     ({"objective": "paper", "max_planes": 65_534}, 65_534), ({"max_planes": 65_535}, None)],
)  # fmt: skip
def test_the_largest_number_of_planes_is_recorded_as_it_is(options, most):
    assert pw.Options(**options).describe()["max_planes"] == most


def test_more_than_64_planes_are_found():
    rng = np.random.default_rng(0)
    z = rng.uniform(1, 4, (9, 12)).repeat(40, axis=0).repeat(40, axis=1)
    depth = z + rng.normal(0, 0.002, z.shape)
    camera = pw.PinholeCamera(fx=400, fy=400, cx=240, cy=180)
    model = pw.detect_planes(depth, camera, pw.Sensor(noise=0.002))
    assert len(model.planes) > 64


@pytest.mark.parametrize("farthest", [5e3, 1e5, 1e7])
def test_metres_far_below_the_largest_depth_keep_their_resolution(farthest):
    """As many planes as for integers, whatever else the sensor may see."""
    scene = pw.scenes.room(9)
    sensor = pw.Sensor(max_depth=farthest, resolution=0.001, noise=0.002)
    whole = pw.detect_planes(scene.depth, scene.camera, sensor)
    metres = pw.detect_planes(scene.depth * 0.001, scene.camera, sensor)
    assert (metres.labels == whole.labels).mean() > 0.999
