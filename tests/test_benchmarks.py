"""What the benchmarks decide by: bounds, the guard, and methods that are not installed."""

import numpy as np
import pytest
from benchmarks import ablation, cloud_rivals, guard, polyhedra
from benchmarks.frame_error import LAGS, told
from benchmarks.frames import Frame
from benchmarks.guard import Guarded
from benchmarks.labelled import LabelledFrame
from benchmarks.other_sensors import camera_of
from benchmarks.rival_points import Cloud
from benchmarks.rivals import METHODS, Method
from benchmarks.simulated import kinect_room
from benchmarks.speed_rows import Settings, SkippedError, against_open3d
from benchmarks.table import RATIO, Row
from benchmarks.timing import interleaved, one_core

import planewise as pw
from planewise import scenes


@pytest.mark.parametrize(
    ("value", "large", "verdict"),
    [(1.0, False, "aim"), (2.0, False, "held"), (2.1, False, "MISSED"), (3.0, True, "aim")],
)
def test_a_row_is_held_against_its_bounds(value, large, verdict):
    row = Row(what="x", unit="ms", values=[value, 0.0, 9.0], must=2.0, aim=1.0, large=large)
    assert row.median == value
    assert row.verdict == verdict
    assert row.line().endswith(f"| {verdict} |")


def test_a_row_without_bounds_and_a_small_ratio():
    row = Row(what="ratio", unit=RATIO, values=[0.002])
    assert row.verdict == ""
    assert row.line() == "| ratio | 1/500 |  | x | 1 |  |  |  |"


def test_calls_alternate():
    calls = []
    ours, theirs = interleaved(lambda: calls.append("a"), lambda: calls.append("b"), 2, repeats=2)
    assert calls == ["a", "b", *"aab", *"aab"]
    assert ours.shape == theirs.shape == (2,)


def test_the_guard_measures_again_before_it_fails():
    numbers = iter((2.0, 1.9, 1.4, 1.0))
    each = Guarded(lambda _: next(numbers), "x")
    assert each.best(1.0, 5) == 1.4
    assert guard.verdict(each, 1.4, 1.0) == "ok"
    numbers = iter((2.0, 1.9, 1.8, 1.0))
    assert each.best(1.0, 5) == 1.8
    assert guard.verdict(each, 1.8, 1.0) == "EXCEEDED"
    assert guard.verdict(each, 1.0, None) == "NOT RECORDED"
    assert guard.verdict(each, 0.5, 1.0).startswith("ok; far below")


def test_the_record_holds_everything_that_is_guarded():
    names = guard.guarded(Frame("none", np.zeros((2, 2)), pw.cameras.NYU, pw.Sensor()))
    assert list(guard.recorded()) == list(names)


def test_a_method_that_is_not_installed_says_why():
    absent = Method(name="x", settings="", prepare=METHODS[0].prepare, module="no_such_module")
    assert "no_such_module" in absent.missing()
    with pytest.raises(SkippedError, match="quick"):
        next(against_open3d(Settings(runs=1, quick=True)))


def test_methods_for_clouds_that_are_not_installed_are_skipped_which_is_said(monkeypatch, capsys):
    monkeypatch.setattr(
        cloud_rivals, "why_missing", lambda name: "" if name == "planewise" else f"no {name}"
    )
    assert [each.name for each in cloud_rivals.usable()] == ["planewise"]
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 2
    assert told[0] == "Open3D patches was skipped: no open3d (pip install -e '.[bench]')"


def test_points_of_a_frame_go_back_to_their_pixels():
    scene = scenes.room(0, size=(60, 80))
    cloud = Cloud.of(Frame("room", scene.depth, scene.camera, scene.sensor))
    assert np.array_equal(cloud.there, scene.depth > 0)
    labels = scene.labels[cloud.there]
    assert np.array_equal(cloud.image(labels), np.where(cloud.there, scene.labels, 0))
    plane = scene.planes[0]
    distance = cloud.points[labels == 1] @ plane[:3] + plane[3]
    assert np.abs(np.median(distance)) < 0.01


@pytest.mark.parametrize(
    "method", [each for each in METHODS if not each.slow], ids=lambda method: method.name
)
def test_every_fast_method_that_is_installed_finds_planes(method):
    if method.missing():
        pytest.skip(method.missing())
    scene = scenes.corner(size=(120, 160))
    with one_core():
        ready = method.prepare(Frame("corner", scene.depth, scene.camera, scene.sensor), False)
        labels = ready.labels(ready.detect())
    assert labels.shape == scene.labels.shape
    assert 2 <= labels.max() <= 40


def test_every_distance_tells_drift_by_itself():
    frame, _ = kinect_room(0)
    assert len(set(told(frame)[3 : 3 + len(LAGS)])) == len(LAGS)


@pytest.fixture(scope="module")
def room():
    """A room with a sphere, of hardly more pixels than make an image fine."""
    scene = scenes.room(1, size=(320, 420))
    frame = Frame("room", scene.depth, scene.camera, scene.sensor)
    return LabelledFrame(frame=frame, truth=scene.labels, chosen_on=True)


def planes_without(name, labelled):
    variant = next(each for each in ablation.VARIANTS if each.name.strip("*") == name)
    with variant.without():
        return variant.setting.run(labelled)["planes_predicted"]


def test_parts_of_the_objective_can_be_taken_out(room):
    whole = planes_without("spatial", room)
    assert whole > 2
    assert planes_without("spatial, uniform mask", room) == 0
    assert planes_without("spatial, uniform null", room) > 1.5 * whole
    assert planes_without("spatial, borders free", room) > whole
    assert planes_without("spatial, independent error", room) > 2
    assert planes_without("spatial", room) == whole


def test_polyhedra_are_convex_and_their_faces_flat():
    size = (120, 160)
    z, faces = polyhedra.faces_of(3, size)
    points = camera_of(size).rays(size) * z[..., None]
    assert 20 < faces.max() < 90
    assert z.min() > 0.3
    assert z.max() < 12
    for face in range(1, faces.max() + 1):
        on = points[faces == face]
        if len(on) > 3:  # all on one plane
            assert np.linalg.svd(on - on.mean(axis=0))[1][2] < 1e-9 * len(on)
    for kind in polyhedra.KINDS:
        shape = kind(np.random.default_rng(0))
        np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1)
        assert (shape.distances > 0).all()  # the middle is inside
        turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
        place = np.array([0.0, 0.0, 4.0])
        at, side = shape.placed(turn, 0.5, place).hit(np.array([[0.0, 0, 1], [1.0, 0, 1]]))
        entry = (np.array([0, 0, at[0]]) - place) @ turn / 0.5  # in its own coordinates
        assert (shape.normals @ entry <= shape.distances + 1e-9).all()
        assert shape.normals[side[0]] @ entry == pytest.approx(shape.distances[side[0]])
        assert at[1] == np.inf
