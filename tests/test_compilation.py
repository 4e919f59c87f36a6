"""What happens around the first compilation."""

import gc
import os
import subprocess
import sys

import pytest
from numba import njit
from numba.core import event

from planewise import compilation


@pytest.mark.parametrize(
    ("module", "collecting"), [("planewise.kernels.made_up", False), ("elsewhere", True)]
)
def test_no_garbage_is_collected_while_a_loop_of_ours_compiles(module, collecting):
    class Looks(event.Listener):
        def on_start(self, event):
            seen.add(gc.isenabled())

        def on_end(self, event):
            seen.add(gc.isenabled())

    def inner(x):
        return x + 1

    inner.__module__ = module
    inner = njit(inner)

    def outer(x):
        return inner(x) + inner(2.0 * x)

    outer.__module__ = module
    seen = set()
    with event.install_listener("numba:run_pass", Looks()):
        assert njit(outer)(1) == 5
    assert seen == {collecting}
    assert gc.isenabled()


def test_the_collector_runs_again_after_a_loop_that_does_not_compile():
    def loop(x):
        return x.nothing_of_this_name

    loop.__module__ = "planewise.kernels.made_up"
    with pytest.raises(Exception, match="nothing_of_this_name"):
        njit(loop)(1)
    assert gc.isenabled()


def test_loops_of_images_and_of_clouds_are_compiled_apart(monkeypatch, tmp_path):
    """A change to a loop of clouds does not announce a compilation for images, nor the reverse."""
    cache, sources = tmp_path / "cache", tmp_path / "sources"
    for folder, names in (
        (cache, ("cells.merge-1.nbi", "cloud_cells.merge-1.nbi")),
        (sources, ("cells.py", "cloud_cells.py")),
    ):
        folder.mkdir()
        for name in names:
            (folder / name).touch()
            os.utime(folder / name, (100, 200 if folder == cache else 100))
    monkeypatch.setattr(compilation, "cache_directory", lambda: cache)
    monkeypatch.setattr(compilation, "_SOURCES", sources)
    assert [compilation.is_cached(cloud=cloud) for cloud in (False, True)] == [True, True]
    os.utime(sources / "cloud_cells.py", (100, 300))
    assert [compilation.is_cached(cloud=cloud) for cloud in (False, True)] == [True, False]
    compilation.confirm(cloud=True)  # it was written anew without a change
    assert compilation.is_cached(cloud=True)
    os.utime(sources / "cells.py", (100, 300))
    (cache / "cloud_cells.merge-1.nbi").unlink()
    assert [compilation.is_cached(cloud=cloud) for cloud in (False, True)] == [False, False]


def test_the_process_that_helps_can_be_waited_for(monkeypatch):
    helper = subprocess.Popen([sys.executable, "-c", ""])
    helper.returncode = 0  # as `announce` leaves it
    monkeypatch.setattr(compilation, "_helpers", [helper])
    compilation.wait_for_help()
    with pytest.raises(ChildProcessError):
        os.waitpid(helper.pid, os.WNOHANG)
    compilation.wait_for_help()  # there is none any more
