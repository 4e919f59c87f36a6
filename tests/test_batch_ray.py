"""The Ray engine; ``make test-ray`` installs Ray and runs this."""

from __future__ import annotations

import os
import time

import pytest

ray = pytest.importorskip("ray", reason="Ray is not installed: make test-ray does it")

from benchmarks.faults import Tally, batch_of, compare, fill, write_frames  # noqa: E402

from planewise.batch import Batch, LocalEngine, RayEngine, Store  # noqa: E402
from planewise.errors import PlanewiseError  # noqa: E402
from tests.batch_sources import Deadly, Slow  # noqa: E402

COUNT = 60

# Ray leaves sockets and files to the end of the process, and warns of what it will change.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning:ray"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ray") / "frames"
    return folder, write_frames(folder, COUNT)


@pytest.fixture(scope="module")
def reference(frames, tmp_path_factory):
    """Store that the local engine has filled."""
    batch = batch_of(frames[0], tmp_path_factory.mktemp("local") / "store", frames[1])
    with batch.started(LocalEngine(workers=2)) as run:
        assert len(list(run)) == COUNT
    return Store(batch.store)


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    """Let workers of Ray import the tests, as they would import an installed package."""
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))  # noqa: PTH120, PTH100
    monkeypatch.setenv("PYTHONPATH", here)


def same(store, reference, corrupt=0):
    tally = Tally()
    compare(store, reference, tally)
    assert (tally.lost, tally.double, tally.corrupt) == (0, 0, corrupt)


def test_results_are_those_of_the_local_engine(frames, reference, tmp_path):
    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    with batch.started(RayEngine(workers=2)) as run:
        assert len(list(run)) == COUNT
    assert not ray.is_initialized()
    same(Store(batch.store), reference)


def test_a_node_that_is_killed_loses_nothing(frames, reference, tmp_path):
    from ray.cluster_utils import Cluster

    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    batch = Batch(source=Slow(frames[0], 0.1), store=batch.store, recipe=batch.recipe)
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        node = cluster.add_node(num_cpus=3)
        cluster.wait_for_nodes()
        ray.init(address=cluster.address, log_to_driver=False)
        killed = 0
        with batch.started(RayEngine()) as run:
            outcomes = []
            for outcome in run:
                outcomes.append(outcome)
                if len(outcomes) == COUNT // 3:
                    cluster.remove_node(node, allow_graceful=False)
                    killed += 1
        assert killed == 1
        until = time.monotonic() + 60  # Ray takes its time to call a node dead
        while sum(each["Alive"] for each in ray.nodes()) == 2 and time.monotonic() < until:
            time.sleep(0.2)
        assert [each["Alive"] for each in ray.nodes()].count(True) == 1
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert len({each.frame for each in outcomes}) == len(outcomes) == COUNT
    assert not any(each.reason for each in outcomes)
    same(Store(batch.store), reference)


def test_a_frame_that_kills_its_workers_has_failed(frames, tmp_path):
    marks = tmp_path / "marks"
    marks.mkdir()
    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    source = Deadly(frames[0], "00002", marks=marks)
    batch = Batch(source=source, store=batch.store, recipe=batch.recipe)
    with batch.started(RayEngine(workers=2)) as run:
        list(run)
    store = Store(batch.store)
    assert store.failed == ("00002",)
    assert len(store) == COUNT - 1
    assert len(list(marks.iterdir())) == 4


def test_only_so_many_frames_are_under_way(frames, tmp_path):
    asked = []

    class Watched(list):
        def __iter__(self):
            for each in super().__iter__():
                asked.append(each)
                yield each

    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    fill(batch)
    from planewise.batch.frame_work import FrameWork

    work = FrameWork(batch.source, batch.recipe)
    outcomes = RayEngine(workers=2).run(work, Watched(enumerate(batch.source.ids)))
    next(outcomes)
    time.sleep(0.2)
    assert len(asked) == 4
    outcomes.close()
    assert not ray.is_initialized()


def test_a_cluster_that_is_not_there_is_said(frames, tmp_path):
    batch = batch_of(frames[0], tmp_path / "store", frames[1])
    with (
        pytest.raises(PlanewiseError, match="address"),
        batch.started(RayEngine(address="127.0.0.1:1")) as run,
    ):
        list(run)
