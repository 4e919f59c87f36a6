import copy
import os
import pickle
import threading

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import planewise as pw
from planewise import scenes
from planewise.runtime.workspace import Workspace


def take(workspace):
    """Arrays of a frame of two stages, each with a number of its own."""
    kept, stages = [workspace.kept((3, 5)), workspace.kept(7, np.uint16)], []
    kept[0][...], kept[1][...] = 1, 2
    for n in (3, 4):
        with workspace.stage():
            stages.append([workspace.empty(11, np.int32), workspace.copy(np.full((2, 2), 9.0))])
            stages[-1][0][...] = n
            kept.append(workspace.kept(100, np.float32))
            kept[-1][...] = n
            assert_array_equal(stages[-1][0], n)
            assert_array_equal(stages[-1][1], 9)
    for array, n in zip(kept, (1, 2, 3, 4), strict=True):
        assert_array_equal(array, n)
    return kept, stages


def test_memory_is_handed_out_again():
    workspace = Workspace()
    with workspace.frame():
        first = take(workspace)
    assert workspace._held == 0
    with workspace.frame():
        second = take(workspace)
    with workspace.frame():
        third = take(workspace)
    for a, b in zip(*(kept + one + two for kept, (one, two) in (second, third)), strict=True):
        assert np.shares_memory(a, b)
        assert a.ctypes.data % 64 == 0
    assert np.shares_memory(second[1][0][0], second[1][1][0])
    assert not np.shares_memory(first[0][0], second[0][0])
    assert workspace._held < 2000


def test_what_does_not_fit_is_allocated():
    workspace = Workspace()
    with workspace.frame():
        workspace.kept(10)
    with workspace.frame():
        small, large = workspace.kept(10), workspace.empty(1000)
        assert large.shape == (1000,)
        assert not np.shares_memory(small, large)
    with workspace.frame():
        assert workspace._held >= 8080


def test_a_detector_repeats_itself_whatever_it_saw_before():
    frames = [scenes.room(seed, size=(240, 320)) for seed in range(3)]
    detector = pw.Detector(frames[0].camera, frames[0].sensor)
    images = [frame.depth for frame in frames] + [frames[0].depth[:, ::-1].copy()]
    alone = [pw.detect_planes(z, frames[0].camera, frames[0].sensor) for z in images]
    for n in (0, 1, 2, 3, 1, 0, 3):
        model = detector(images[n])
        assert_array_equal(model.labels, alone[n].labels)
        assert model.information == alone[n].information
        assert_array_equal(model.coefficients, alone[n].coefficients)
    before = model.labels.copy()
    detector(images[2])
    assert_array_equal(model.labels, before)


def test_a_detector_at_work_refuses_another_thread():
    frame = scenes.corner(size=(60, 80))
    started, go_on = threading.Event(), threading.Event()

    def whole(view):
        started.set()
        assert go_on.wait(30)
        return np.ones(view.depth.shape, int)

    detector = pw.Detector(frame.camera, frame.sensor, partition=whole)
    models = []
    thread = threading.Thread(target=lambda: models.append(detector(frame.depth)))
    thread.start()
    assert started.wait(30)
    with pytest.raises(RuntimeError, match="one thread at a time"):
        detector(frame.depth)
    go_on.set()
    thread.join()
    assert_array_equal(detector(frame.depth).labels, models[0].labels)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_forked_process_does_not_wait_for_a_thread_it_does_not_have():
    workspace, inside, go_on = Workspace(), threading.Event(), threading.Event()

    def work():
        with workspace.frame():
            inside.set()
            go_on.wait(30)

    thread = threading.Thread(target=work)
    thread.start()
    assert inside.wait(30)
    child = os.fork()
    if not child:
        try:
            with workspace.frame():
                os._exit(0)
        finally:
            os._exit(1)
    assert os.waitpid(child, 0)[1] == 0
    with pytest.raises(RuntimeError, match="one thread at a time"), workspace.frame():
        pass
    go_on.set()
    thread.join()


def test_an_error_does_not_keep_a_detector_busy():
    frame = scenes.corner(size=(60, 80))
    detector = pw.Detector(frame.camera, frame.sensor)
    with pytest.raises(ValueError, match="depth must be a 2-D image"):
        detector(frame.depth[0])
    assert len(detector(frame.depth)) == 4


def pickled(detector):
    return pickle.loads(pickle.dumps(detector))


@pytest.mark.parametrize("made", [copy.copy, copy.deepcopy, pickled])
def test_a_copy_of_a_detector_has_memory_of_its_own(made):
    frame = scenes.corner(size=(60, 80))
    detector = pw.Detector(frame.camera, frame.sensor, max_planes=3)
    labels = detector(frame.depth).labels
    detector(frame.depth)
    other = made(detector)
    with detector._workspace.frame():
        assert_array_equal(other(frame.depth).labels, labels)
    assert len(pickle.dumps(detector)) < 10_000
