"""Helpers beside the calling thread: what they do, and that their errors are not lost."""

import threading

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import planewise as pw
from planewise import scenes, threads


def names(allowed):
    """Threads that the work and the block of `beside` run in."""
    seen = []
    with threads.allowed(allowed), threads.beside(lambda: seen.append(threading.current_thread())):
        here = threading.current_thread()
    return seen, here


def test_a_helper_works_beside_where_two_threads_are_allowed():
    (worker,), here = names(2)
    assert worker is not here
    (again,), _ = names(2)
    assert again is worker  # it waits for more


def test_one_thread_does_all_one_after_the_other():
    (worker,), here = names(1)
    assert worker is here


@pytest.mark.parametrize("allowed", [1, 2])
def test_an_error_of_the_helper_is_raised(allowed):
    def fail():
        raise ValueError("from the helper")

    for _ in range(2):
        with (
            pytest.raises(ValueError, match="from the helper"),
            threads.allowed(allowed),
            threads.beside(fail),
        ):
            pass
    assert len(names(allowed)[0]) == 1  # and it works on


def test_an_error_of_the_block_waits_for_the_helper():
    done = threading.Event()
    with pytest.raises(KeyError), threads.allowed(2), threads.beside(done.set):
        raise KeyError
    assert done.is_set()


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_chunks_cover_everything_once(count):
    out = np.zeros(1000, int)

    def add(first, last):
        out[first:last] += 1

    threads.over_chunks(add, out.size, count)
    assert (out == 1).all()


def test_errors_of_chunks_are_raised_when_all_are_done():
    out = np.zeros(9, int)

    def add(first, last):
        out[first:last] += 1
        if first:
            raise ValueError(f"part from {first}")

    with pytest.raises(ValueError, match="part from"):
        threads.over_chunks(add, out.size, 3)
    assert (out == 1).all()


def test_halves_meet_at_the_same_place():
    parts = []
    for allowed in (1, 2):
        with threads.allowed(allowed):
            threads.halves(lambda *part: parts.append(part), 11)
    assert sorted(parts[:2]) == sorted(parts[2:]) == [(0, 5), (5, 11)]


def test_detectors_in_several_threads_do_not_disturb_each_other():
    every = [scenes.room(seed, size=(120, 160)) for seed in range(3)]
    expected = [pw.detect_planes(s.depth, s.camera, s.sensor, threads=1).labels for s in every]
    found = {}

    def detect(n):
        scene = every[n]
        detector = pw.Detector(scene.camera, scene.sensor, threads=2)
        found[n] = [detector(scene.depth).labels for _ in range(5)]

    workers = [threading.Thread(target=detect, args=(n,)) for n in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for n, labels in enumerate(expected):
        for each in found[n]:
            assert_array_equal(each, labels)
