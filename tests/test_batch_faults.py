"""Processes that die while a batch is done."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest
from benchmarks.faults import Tally, batch_of, compare, fill, kill_again_and_again, write_frames

from planewise.batch import Batch, LocalEngine, RayEngine, Store, local_engine, workers
from planewise.errors import PlanewiseError
from tests.batch_sources import Deadly

COUNT = 40


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults") / "frames"
    return folder, write_frames(folder, COUNT)


@pytest.fixture(scope="module")
def reference(frames, tmp_path_factory):
    path = tmp_path_factory.mktemp("reference") / "store"
    fill(batch_of(frames[0], path, frames[1]))
    return Store(path)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills processes that are forked")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_kills_at_random_instants_lose_nothing(frames, reference, tmp_path):
    tally = kill_again_and_again(*frames, reference, tmp_path, kills=20, seed=time.time_ns())
    assert tally.kills == 20
    assert tally.stores >= 1
    assert (tally.lost, tally.double, tally.corrupt) == (0, 0, 0)


def done_with(source, batch, store):
    """Fill a store with two workers."""
    batch = Batch(source=source, store=store, recipe=batch.recipe)
    with batch.started(LocalEngine(workers=2)) as run:
        outcomes = list(run)
    assert len({each.frame for each in outcomes}) == len(outcomes) == COUNT
    return Store(store)


def test_a_frame_that_kills_every_worker_has_failed(frames, reference, tmp_path):
    source = Deadly(frames[0], "00005")
    store = done_with(source, batch_of(*frames[:1], tmp_path, frames[1]), tmp_path / "store")
    assert store.failed == ("00005",)
    (row,) = [row for row in store.frames.to_pylist() if row["status"] == "failed"]
    assert row["reason"] == "2 workers were killed by SIGKILL with this frame"
    tally = Tally()
    compare(store, reference, tally)
    assert (tally.lost, tally.double, tally.corrupt) == (0, 0, 1)  # the failed one differs


def test_a_worker_that_dies_once_costs_nothing(frames, reference, tmp_path):
    marks = tmp_path / "marks"
    marks.mkdir()
    source = Deadly(frames[0], "00007", times=1, marks=marks)
    store = done_with(source, batch_of(*frames[:1], tmp_path, frames[1]), tmp_path / "store")
    assert len(list(marks.iterdir())) == 1
    tally = Tally()
    compare(store, reference, tally)
    assert (tally.lost, tally.double, tally.corrupt) == (0, 0, 0)


@pytest.mark.parametrize("engine", [LocalEngine, RayEngine])
@pytest.mark.parametrize("workers", [0, 2.5, "two"])
def test_workers_are_a_whole_number(engine, workers):
    with pytest.raises(ValueError, match="workers"):
        engine(workers=workers)


def test_workers_that_cannot_start_are_given_up(frames, tmp_path, monkeypatch):
    monkeypatch.setattr("planewise.batch.local_engine._serve", os._exit)
    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    with (
        pytest.raises(PlanewiseError, match="3 in a row ended with code 1 at the start"),
        batch.started(LocalEngine(workers=2)) as run,
    ):
        list(run)
    assert not (tmp_path / "store").exists()


def test_what_ended_a_worker_is_named():
    assert local_engine._cause(-9) == "were killed by SIGKILL"
    assert local_engine._cause(-35) == "were killed by signal 35"
    assert local_engine._cause(3) == "ended with code 3"


@pytest.mark.parametrize("times", [1, 2])
def test_a_process_is_started_once_more(times, monkeypatch):
    """What it is forked from may have been killed."""
    tries = []

    class Process:
        def __init__(self, **_):
            tries.append(self)

        def start(self):
            if len(tries) <= times:
                raise EOFError

    monkeypatch.setattr(workers, "Process", Process)
    if times == 1:
        assert workers.started(print, None) is tries[1]
    else:
        with pytest.raises(PlanewiseError, match=r"none can be started \(EOFError\)"):
            workers.started(print, None)
    assert len(tries) == 2


BESIDE = """
import multiprocessing, os, signal, sys

def look(pipe):
    deaf = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    pipe.send((deaf, os.environ.get("OMP_NUM_THREADS"), "planewise" in sys.modules))

if __name__ == "__main__":
    from planewise.batch import workers
    ours, theirs = multiprocessing.Pipe()
    workers.started(look, theirs).join()
    print(ours.poll() and ours.recv())
    child = multiprocessing.get_context("forkserver").Process(target=look, args=(theirs,))
    child.start()
    child.join()
    print(ours.poll() and ours.recv())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere processes are not forked")
def test_workers_leave_processes_of_the_program_alone(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(BESIDE)
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    result = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=True, env=environment,
        timeout=120,
    )  # fmt: skip
    assert result.stdout.splitlines() == ["(True, '1', True)", "(False, None, False)"]
