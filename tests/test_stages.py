"""Stages of a call, and that they are free where nobody records."""

import threading
import time
from timeit import repeat

import numpy as np
import pytest

import planewise as pw
from planewise.stages import recorded, stage


def wait(seconds):
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def test_a_stage_counts_without_the_stages_inside_it():
    with recorded() as seconds:
        with stage("outer"):
            wait(0.01)
            for _ in range(2):
                with stage("inner"):
                    wait(0.01)
        with stage("after"):
            pass
    assert list(seconds) == ["inner", "outer", "after"]
    assert seconds["inner"] >= 0.02
    assert 0.01 <= seconds["outer"] < seconds["inner"]
    assert seconds["after"] < 0.01


def test_the_parts_add_up_to_the_whole():
    start = time.perf_counter()
    with recorded() as seconds, stage("a"):
        for _ in range(50):
            with stage("b"), stage("c"):
                wait(0.0001)
    whole = time.perf_counter() - start
    assert sum(seconds.values()) <= whole
    assert sum(seconds.values()) == pytest.approx(whole, rel=0.2)


def test_an_error_ends_its_stages():
    with recorded() as seconds:
        with pytest.raises(RuntimeError), stage("outer"), stage("inner"):
            raise RuntimeError
        with stage("next"):
            wait(0.001)
    assert set(seconds) == {"outer", "inner", "next"}
    assert seconds["next"] >= 0.001


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
    assert min(repeat(work, number=number, repeat=5)) / number < 2e-6


def test_a_call_names_its_stages(camera):
    detector = pw.Detector(camera, pw.Sensor(noise=0.01))
    wall = np.full((48, 64), 2.0)
    with recorded() as seconds:
        model = detector(wall)
    assert len(model) == 1
    assert {"observe", "cells", "segments", "labels", "ledger", "describe"} <= set(seconds)
    assert min(seconds.values()) >= 0
