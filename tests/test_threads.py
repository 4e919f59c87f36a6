"""Helpers beside the calling thread: what they do, and that their errors are not lost."""

import signal
import threading
import time

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import planewise as pw
from planewise import scenes
from planewise.kernels import waiting
from planewise.runtime import threads


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


def test_who_waits_for_a_helper_looks_for_a_while_and_sees_what_another_thread_writes():
    done = np.zeros(1, np.int64)
    assert waiting.look_until(done, 1, 1000, 10) == 0  # then a lock is waited for
    late = threading.Timer(0.05, done.__setitem__, (0, 3))
    late.start()
    assert waiting.look_until(done, 3, 1 << 40, 10) == 3
    late.join()


@pytest.mark.parametrize(
    ("files", "processors"),
    [
        ({"cpu.max": "max 100000\n"}, 64),
        ({"cpu.max": "250000 100000\n"}, 3),
        ({"cpu.max": "50000 100000\n"}, 1),
        ({"cpu.max": "9900000 100000\n"}, 64),
        ({"quota": "-1\n", "period": "100000\n"}, 64),
        ({"quota": "300000\n", "period": "100000\n"}, 3),
        ({"quota": "300000\n"}, 64),
        ({}, 64),
    ],
)
def test_a_containers_quota_bounds_the_processors(files, processors, tmp_path, monkeypatch):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    names = ("cpu.max",), ("quota", "period")
    paths = tuple(tuple(str(tmp_path / name) for name in each) for each in names)
    monkeypatch.setattr(threads, "_QUOTAS", paths)
    monkeypatch.setattr(threads.os, "sched_getaffinity", lambda _: range(64), raising=False)
    threads._quota.cache_clear()
    try:
        assert threads.available() == processors
        assert threads.chosen(None) == processors
        assert threads.chosen(5) == 5
        assert threads.chosen(100_000) == threads.MOST
    finally:
        threads._quota.cache_clear()


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


def test_no_more_threads_are_started_than_a_machine_can_bear(monkeypatch):
    parts, helpers, start = [], [], threads._started

    def started(work):
        helpers.append(start(work))
        return helpers[-1]

    monkeypatch.setattr(threads, "_started", started)
    threads.over_chunks(lambda first, last: parts.append((first, last)), 10_000, 100_000)
    assert len(helpers) == threads.MOST - 1
    assert sorted(x for part in parts for x in range(*part)) == list(range(10_000))


def test_parts_are_taken_by_the_thread_that_is_free():
    rest_is_done, by = threading.Event(), {}

    def work(first, last):
        by[first] = threading.get_ident()
        if first == 0:
            assert rest_is_done.wait(60)
        elif len(by) == 8:
            rest_is_done.set()

    threads.over_chunks(work, 8, 2)
    assert len(by) == 8
    assert len({by[first] for first in range(1, 8)} - {by[0]}) == 1


def test_an_error_of_a_helper_is_raised_when_all_parts_are_done():
    done, met = set(), threading.Barrier(2)

    def work(first, last):
        if not done:
            met.wait(60)
        if threading.current_thread() is not threading.main_thread():
            raise ValueError(f"part from {first}")
        done.update(range(first, last))

    with pytest.raises(ValueError, match="part from") as raised:
        threads.over_chunks(work, 8, 2)
    assert len(done) == 7
    assert f"part from {({*range(8)} - done).pop()}" in str(raised.value)


def test_after_an_error_no_part_is_begun_and_those_that_have_begun_are_waited_for(monkeypatch):
    begun, done, met = [], [], threading.Barrier(2)
    drained, wait = threading.Event(), threads._wait
    monkeypatch.setattr(threads, "_wait", lambda helpers: (drained.set(), wait(helpers)))

    def work(first, last):
        begun.append(first)
        met.wait(60)
        if threading.current_thread() is threading.main_thread():
            raise ValueError(f"part from {first}")
        assert drained.wait(60)
        done.append(first)

    with pytest.raises(ValueError, match="part from"):
        threads.over_chunks(work, 8, 2)
    assert len(begun) == 2
    assert len(done) == 1


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


@pytest.mark.parametrize("count", [1, 2, 3])
def test_results_come_in_the_order_of_the_items(count):
    at_work, most, lock = set(), [], threading.Lock()

    def worker(number):
        def work(item):
            with lock:
                assert number not in at_work  # one item at a time
                at_work.add(number)
                most.append(len(at_work))
            time.sleep(0.002 * (item % 3))  # some take longer than those behind them
            with lock:
                at_work.remove(number)
            return item * item

        return work

    results = threads.in_order([worker(n) for n in range(count)], iter(range(20)))
    assert list(results) == [n * n for n in range(20)]
    assert max(most) == count
    assert list(threads.in_order([worker(0)], [])) == []


def test_items_are_taken_as_results_are():
    taken = []

    def items():
        for n in range(100):
            taken.append(n)
            yield n

    results = threads.in_order([lambda n: n] * 2, items())
    assert next(results) == 0
    assert taken == [0]  # which is done alone
    assert next(results) == 1
    assert taken == [0, 1, 2, 3]
    results.close()
    assert len(taken) == 4


@pytest.mark.parametrize("count", [1, 2])
def test_an_error_comes_in_its_place_and_ends_the_work(count):
    def fail(item):
        if item == 3:
            raise ValueError("the fourth")
        return item

    results = threads.in_order([fail] * count, range(1000))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="the fourth"):
        next(results)
    assert list(results) == []


@pytest.mark.parametrize("count", [1, 2, 3])
def test_an_error_of_the_source_comes_after_what_it_gave(count):
    def items():
        yield from range(6)
        raise OSError("torn")

    results = threads.in_order([lambda n: n] * count, items())
    assert [next(results) for _ in range(6)] == list(range(6))
    with pytest.raises(OSError, match="torn"):
        next(results)


def test_an_interrupt_waits_for_the_helper_and_leaves_none():
    """What the helper writes to is not free before it is done."""
    done = []

    def work():
        time.sleep(0.02)
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.02)
        done.append(1)

    names(2)
    before = threading.active_count()
    asked = signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs of a shell ignore it
    try:
        for _ in range(3):
            with threads.allowed(2), pytest.raises(KeyboardInterrupt), threads.beside(work):
                pass
    finally:
        signal.signal(signal.SIGINT, asked)
    assert len(done) == 3
    assert threading.active_count() == before


def same(one, other):
    assert_array_equal(one.labels, other.labels)
    assert one.information == other.information
    for plane, same_plane in zip(one.planes, other.planes, strict=True):
        assert_array_equal(plane.normal, same_plane.normal)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_stream_gives_what_calls_give(count):
    rooms = [scenes.room(seed, size=(120, 160)) for seed in range(5)]
    camera, sensor = rooms[0].camera, rooms[0].sensor
    detector = pw.Detector(camera, sensor, threads=count)
    models = list(detector.stream(room.depth for room in rooms))
    assert len(models) == len(rooms)
    for room, model in zip(rooms, models, strict=True):
        same(model, pw.detect_planes(room.depth, camera, sensor, threads=1))
    same(models[0], detector(rooms[0].depth))  # it still serves


def test_a_stream_draws_random_numbers_frame_by_frame():
    room = scenes.room(0, size=(60, 80))

    def detector():
        rng = np.random.default_rng(5)
        return pw.Detector(room.camera, room.sensor, search="sequential", rng=rng, threads=3)

    models, one_by_one = detector().stream([room.depth] * 3), detector()
    for model in models:
        same(model, one_by_one(room.depth))


def test_a_stream_names_what_is_wrong():
    room = scenes.room(0, size=(60, 80))
    detector = pw.Detector(room.camera, room.sensor, threads=2)
    models = detector.stream([room.depth, room.depth, np.full((60, 80), -1.0)])
    assert len([next(models), next(models)]) == 2
    with pytest.raises(ValueError, match="negative"):
        next(models)
    parts = pw.Detector(room.camera, room.sensor, partition="blocks", threads=2)
    with pytest.raises(ValueError, match="without a partition"):
        parts.stream([room.depth])
