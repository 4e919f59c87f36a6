"""The long search: Phi only falls, and is always the ledger's."""

import numpy as np
import pytest
from benchmarks.frames import Frame
from benchmarks.long_run import descend, long_run, restart
from benchmarks.phi_moves import MOVES, Judge, Solution

from planewise import scenes


@pytest.fixture(scope="module")
def frame():
    scene = scenes.room(1, size=(60, 80))
    return Frame("room", scene.depth, scene.camera, scene.sensor)


@pytest.fixture(scope="module")
def judge(frame):
    return Judge(frame)


def exact(judge, solution):
    return judge.book(solution.affine, solution.labels).curve[-1]


def disturbed(judge, solution):
    """A worse start: a plane in two halves, another moved, stray labels."""
    labels = solution.labels.copy()
    columns = np.arange(labels.shape[1])
    labels[(labels == 1) & (columns > np.median(columns))] = len(solution) + 1
    labels[10:14, 10:14] = 1
    affine = np.vstack((solution.affine, solution.affine[0]))
    affine[1, 0] += 0.01
    return judge.solution(affine, np.where(judge.frame.p > 0, labels, 0).astype(np.uint16))


def test_the_judge_returns_what_the_default_call_does(frame, judge):
    model, found = frame.detect(), judge.default()
    assert found.phi == pytest.approx(model.information, rel=1e-12)
    assert len(found) == len(model) > 1
    assert np.array_equal(found.labels, model.labels)
    assert judge.nothing().phi == pytest.approx(model.curve[0], rel=1e-12)


@pytest.mark.parametrize("move", MOVES, ids=lambda move: move.__name__)
def test_no_move_raises_phi_and_each_is_accounted_for(judge, move):
    found = judge.default()
    start = disturbed(judge, found)
    assert start.phi > found.phi
    gains = {}
    end = descend(judge, start, [found], gains, moves=[move])
    assert end.phi <= start.phi
    assert end.phi == pytest.approx(exact(judge, end), rel=1e-12)
    assert gains == {move.__name__: pytest.approx(start.phi - end.phi, abs=1e-6)}


def test_all_moves_together_mend_what_was_disturbed(judge):
    found = judge.default()
    start, gains = disturbed(judge, found), {}
    end = descend(judge, start, [found], gains)
    assert end.phi < found.phi + 1
    assert sum(gains.values()) == pytest.approx(start.phi - end.phi, abs=1e-6)


def test_no_plane_is_a_start_too(judge):
    nothing = judge.nothing()
    assert isinstance(nothing, Solution)
    assert len(nothing) == 0
    assert descend(judge, nothing, [judge.default()], {}).phi < nothing.phi


def test_restarts_differ_and_leave_no_constant_behind(judge):
    before = judge.default().phi
    found = {restart(judge, np.random.default_rng(seed)).phi for seed in range(4)}
    assert len(found) > 1
    assert judge.default().phi == before


def test_a_long_run_is_no_higher_than_the_default(frame, judge):
    run = long_run(frame, restarts=3, seconds=0.5)
    assert run.best.phi <= run.default.phi < run.empty
    assert run.best.phi == pytest.approx(exact(judge, run.best), rel=1e-12)
    assert sum(run.gains.values()) == pytest.approx(run.default.phi - run.best.phi, abs=1e-6)
    assert run.gap >= 0
    assert 0 <= run.unsaved < 100
