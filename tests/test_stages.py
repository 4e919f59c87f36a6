"""Stages of a call, and that they are free where nobody records."""

import contextlib
import threading
import time
from timeit import repeat
from types import SimpleNamespace

import numpy as np
import pytest

import planewise as pw
from planewise.runtime.stages import recorded, stage


@pytest.fixture
def wait(monkeypatch):
    """A clock that goes on only when it is told to."""
    now = [100.0]

    def let_pass(seconds):
        now[0] += seconds

    clock = SimpleNamespace(perf_counter=lambda: now[0])
    monkeypatch.setattr("planewise.runtime.stages.time", clock)
    return let_pass


def test_a_stage_counts_without_the_stages_inside_it(wait):
    with recorded() as seconds:
        with stage("outer"):
            wait(1.0)
            for _ in range(2):
                with stage("inner"):
                    wait(2.0)
        wait(8.0)
        with stage("after"):
            wait(0.5)
    assert list(seconds.items()) == [("inner", 4.0), ("outer", 1.0), ("after", 0.5)]


def test_the_parts_add_up_to_the_whole(wait):
    with recorded() as seconds, stage("a"):
        for _ in range(50):
            wait(0.25)
            with stage("b"), stage("c"):
                wait(0.5)
    assert seconds == {"a": 12.5, "b": 0.0, "c": 25.0}


def test_an_error_ends_its_stages(wait):
    with recorded() as seconds:
        with contextlib.suppress(RuntimeError), stage("outer"), stage("inner"):
            wait(2.0)
            raise RuntimeError
        with stage("next"):
            wait(1.0)
    assert seconds == {"inner": 2.0, "outer": 0.0, "next": 1.0}


def test_recordings_nest_and_end():
    with recorded() as outer:
        with recorded() as inner, stage("a"):
            pass
        with stage("b"):
            pass
    with stage("c"):
        pass
    assert (list(outer), list(inner)) == (["b"], ["a"])


def test_another_thread_is_not_recorded():
    def work():
        with stage("elsewhere"):
            pass

    with recorded() as seconds:
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    assert seconds == {}


def test_costs_next_to_nothing_where_nobody_records():
    def work():
        with stage("free"):
            pass

    number = 10_000
    assert min(repeat(work, timer=time.thread_time, number=number, repeat=5)) / number < 2e-6


def test_a_call_names_its_stages(camera):
    detector = pw.Detector(camera, pw.Sensor(noise=0.01))
    wall = np.full((48, 64), 2.0)
    with recorded() as seconds:
        model = detector(wall)
    assert len(model) == 1
    assert {"observe", "cells", "segments", "labels", "ledger", "describe"} <= set(seconds)
    assert min(seconds.values()) >= 0
