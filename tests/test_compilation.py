"""What happens around the first compilation."""

import ast
import errno
import gc
import multiprocessing
import operator
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numba import njit
from numba.core import analysis, caching, event
from numba.core.inline_closurecall import InlineWorker
from numba.core.lowering import Lower
from numba.core.types.functions import BaseFunction
from numba.core.typing.arraydecl import GetItemBuffer
from numba.extending import overload
from numpy.testing import assert_array_equal

import planewise as pw
from planewise import compilation, warm_up
from planewise.kernels import compiler, jit
from planewise.kernels.loop_cache import ENDING
from tests.command import run_python


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


@pytest.mark.parametrize(
    ("module", "once"), [("planewise.kernels.made_up", True), ("elsewhere", False)]
)
def test_numba_is_asked_once_what_an_operator_gives_in_loops_of_ours(monkeypatch, module, once):
    def counts(self, args, kws):
        seen.append(args)
        return generic(self, args, kws)

    def loop(x, i):
        return x[i] + x[i] + x[i]

    seen, generic = [], GetItemBuffer.generic
    monkeypatch.setattr(GetItemBuffer, "generic", counts)
    monkeypatch.setattr(compiler, "_known", {})
    loop.__module__ = module
    assert njit(loop)(np.arange(3.0), 1) == 3.0
    assert (len(seen) == 1) == once
    assert BaseFunction.get_call_type is compiler._resolve


def test_what_numba_compiles_itself_is_asked_for_wherever_it_is_used(monkeypatch):
    """It is compiled with the options of the loop that uses it."""

    def twice(x):
        raise NotImplementedError

    @overload(twice)
    def _(x):
        return lambda x: x + x

    def loop(x):
        return twice(x) * x

    monkeypatch.setattr(compiler, "_known", {})
    loop.__module__ = "planewise.kernels.made_up"
    assert njit(loop)(3.0) == 18.0
    kept = {function.typing_key for function, *_ in compiler._known}
    assert {operator.add, operator.mul} <= kept
    assert twice not in kept


def test_what_is_part_of_its_callers_is_parsed_once_and_is_typed_in_each(monkeypatch):
    half = jit.inlined(lambda x: x / 2 if x > 0 else x - 1)

    def loop(x, i):
        return half(half(x)), half(i), half(-i)

    def counts(inliner, function, *args, **kws):
        parsed.append(function)
        return parse(inliner, function, *args, **kws)

    parsed, parse = [], InlineWorker.run_untyped_passes
    monkeypatch.setattr(InlineWorker, "run_untyped_passes", counts)
    loop.__module__ = "planewise.kernels.made_up"
    compiler._methods.cache_clear()
    try:
        for _ in range(2):
            assert njit(loop)(5.0, 3) == (1.25, 1.5, -4)
    finally:
        compiler._methods.cache_clear()
    assert parsed == [half.py_func]


def test_where_variables_live_is_found_out_once_in_a_loop_of_ours(monkeypatch):
    def loop(x):
        total = 0.0
        for i in range(x.size):
            row = x[i:]
            total += row[0] if row.size > 1 else 0.5
        return total

    def counts(*args):
        seen.append(args)
        return find(*args)

    seen, find = [], analysis.compute_live_variables
    monkeypatch.setattr(analysis, "compute_live_variables", counts)
    times = []
    for module in ("planewise.kernels.made_up", "elsewhere"):
        loop.__module__ = module
        seen.clear()
        values = np.arange(4.0)
        assert njit(pipeline_class=compiler.LoopCompiler)(loop)(values) == 3.5
        assert sys.getrefcount(values) == 2  # what is a view of it has let it go
        times.append(len(seen))
    assert times[0] == 1 < times[1]


def test_functions_of_numba_within_a_loop_of_ours_cannot_be_called_from_python(monkeypatch):
    def loop(n):
        return np.empty(n, np.uint16).size

    def counts(self, *args):
        seen.append(self.fndesc.modname)
        return make(self, *args)

    seen, make = [], Lower.create_cpython_wrapper
    monkeypatch.setattr(Lower, "create_cpython_wrapper", counts)
    for module in ("planewise.kernels.made_up", "elsewhere"):
        loop.__module__ = module
        assert njit(loop)(7) == 7
    assert seen.count("planewise.kernels.made_up") == 1
    assert "elsewhere" in seen


def test_expressions_of_whole_arrays_are_right_where_they_are_not_fused():
    @jit.compiled
    def loop(x, y, out):
        out[1:] = 2.0 * x[1:] * y[:-1] + x[0]

    x, y, out = np.arange(5.0), np.arange(5.0) ** 2, np.zeros(5)
    loop(x, y, out)
    assert_array_equal(out[1:], 2 * x[1:] * y[:-1] + x[0])


def test_loops_of_others_compile_whatever_their_module():
    """What `exec` makes in a bare namespace has none."""
    names = {}
    exec("def loop(x): return x + 1", names)
    names["loop"].__module__ = None
    assert njit(names["loop"])(1.0) == 2.0


@pytest.mark.parametrize("failing", ["no folder", "no room"])
def test_loops_work_where_they_cannot_be_kept(monkeypatch, failing):
    def save(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    if failing == "no folder":
        monkeypatch.setattr(caching.FunctionCache._impl_class, "_locator_classes", [])
    else:
        monkeypatch.setattr(caching.FunctionCache, "save_overload", save)

    @jit.compiled
    def twice(x):
        return 2 * x

    assert twice(3) == 6
    assert (twice.stats.cache_path is None) == (failing == "no folder")


def test_loops_that_make_no_arrays_count_no_references():
    compiled = njit(pipeline_class=compiler.LoopCompiler)  # nothing kept can be looked into

    @compiled
    def total(row):
        out = 0.0
        for k in range(row.size):
            out += row[k]
        return out

    @compiled
    def alternating(rows):
        out, last = 0.0, rows[0]
        for i in range(rows.shape[0]):
            here = rows[i] if i % 2 else last
            out += total(here.reshape(-1))
            last = here
        return out

    @compiled
    def with_room(rows):
        return total(np.ones(3)) + total(rows[0])

    @compiled
    def first_two(rows):
        return rows[0], rows[1]

    @compiled
    def roots(row):
        return np.sqrt(row).sum() + total(row[row > 1])

    @compiled
    def last(rows):
        return rows[-1]

    @compiled
    def of_last(rows):
        return total(last(rows))

    rows = np.arange(6.0).reshape(2, 3)
    before = sys.getrefcount(rows)
    results = {loop: loop(rows) for loop in (alternating, with_room, of_last)}
    results |= {loop: loop(rows[1]) for loop in (total, roots)}
    first, second = first_two(rows)
    expected = alternating, 15.0, with_room, 6.0, of_last, 12.0, total, 12.0
    assert dict(zip(expected[::2], expected[1::2], strict=True)).items() <= results.items()
    assert results[roots] == pytest.approx(np.sqrt(rows[1]).sum() + 12.0)
    counting = {loop for loop in results if "NRT_incref" in next(iter(loop.inspect_asm().values()))}
    assert counting.isdisjoint({total, alternating})
    assert {roots, of_last} <= counting
    assert sys.getrefcount(rows) > before  # of what was returned
    assert_array_equal((first, second), rows)
    del first, second
    assert sys.getrefcount(rows) == before


def test_who_cannot_keep_loops_hears_how_they_can_be(monkeypatch, started, caplog):
    monkeypatch.setattr(compilation, "score_rays", njit(lambda x: x))
    assert not compilation.is_cached("spatial")
    compilation._said.clear()
    compilation.announce.__wrapped__("spatial")
    assert "NUMBA_CACHE_DIR" in caplog.text
    assert not started  # what they would compile is lost


def test_without_compilation_it_is_refused_once(tmp_path):
    """Plain Python, as Numba has it then, would give loops other types, and take minutes."""
    np.save(tmp_path / "a.npy", np.ones((12, 16)))
    np.save(tmp_path / "b.npy", np.ones((12, 16)))
    code = """
import sys
from planewise.cli import main
sys.argv[0] = "planewise"
main()
"""
    given = (tmp_path, "--camera", "9,9,8,6", "--sensor", "nyu", "-o", tmp_path / "out")
    for arguments, ends in (
        (("info",), 0),
        (("detect", *given), 2),
        (("calibrate", *given[:-1], tmp_path / "out.json"), 2),
    ):
        done = run_python(code, *arguments, check=False, NUMBA_DISABLE_JIT="1")
        assert done.returncode == ends
        assert (done.stdout + done.stderr).count("NUMBA_DISABLE_JIT") == 1
        assert (done.stderr.count("\n") == 1) == (ends == 2)


def kept(loop):
    """Name of the file of a loop."""
    return f"{loop}-1.{ENDING}.nbi"


def test_loops_of_images_and_of_clouds_are_compiled_apart(monkeypatch, tmp_path):
    """A change to a loop of clouds does not announce a compilation for images, nor the reverse."""
    cache, sources = tmp_path / "cache", tmp_path / "sources"
    for folder, names in (
        (cache, map(kept, ("segments.merge", "cloud_segments.merge", "pairs.once"))),
        (sources, ("segments.py", "cloud_segments.py", "pairs.py")),
    ):
        folder.mkdir()
        for name in names:
            (folder / name).touch()
            os.utime(folder / name, (100, 200 if folder == cache else 100))
    monkeypatch.setattr(compilation, "cache_directory", lambda: cache)
    monkeypatch.setattr(compilation, "_SOURCES", sources)
    assert [compilation.is_cached(loops) for loops in ("spatial", "cloud")] == [True, True]
    os.utime(sources / "cloud_segments.py", (100, 300))
    assert [compilation.is_cached(loops) for loops in ("spatial", "cloud")] == [True, False]
    compilation.confirm(cloud=True)  # it was written anew without a change
    assert compilation.is_cached("cloud")
    os.utime(sources / "segments.py", (100, 300))
    (cache / kept("cloud_segments.merge")).unlink()  # what both need is left, and tells nothing
    assert [compilation.is_cached(loops) for loops in ("spatial", "cloud")] == [False, False]


def test_programs_that_are_frozen_have_no_sources_to_compare(monkeypatch, tmp_path):
    monkeypatch.setattr(compilation, "cache_directory", lambda: tmp_path)
    monkeypatch.setattr(compilation, "_SOURCES", tmp_path / "none")
    (tmp_path / "segments.merge-1.loop2-of-others.nbi").touch()
    assert not compilation.is_cached("spatial")
    (tmp_path / kept("segments.merge")).touch()
    assert compilation.is_cached("spatial")
    assert not compilation.is_cached("cloud")


def test_loops_that_tell_what_is_compiled_are_needed_by_one_search_alone():
    package = Path(compilation.__file__).parent
    modules = {
        "paper": {*package.glob("paper/*.py")},
        "spatial": {*package.glob("spatial/*.py")},
        "cloud": {*package.glob("clouds/*.py"), *package.glob("kernels/cloud_*.py")},
    }
    imported = {
        path: {
            name
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.ImportFrom)
            for name in (node.module, *(f"{node.module}.{each.name}" for each in node.names))
        }
        for path in package.glob("**/*.py")
    }
    for loops, its_own in modules.items():
        name, _ = compilation._TELLING[loops].split(".")
        users = {path for path, names in imported.items() if f"planewise.kernels.{name}" in names}
        assert users & its_own
        assert users.isdisjoint(set().union(*modules.values()) - its_own)


@pytest.mark.usefixtures("started")
@pytest.mark.parametrize("loops", ["spatial", "paper"])
def test_who_needs_some_loops_only_hears_nothing_once_these_are_compiled(
    monkeypatch, loops, caplog
):
    """The sequential search has none of the default's, and would be announced for ever."""
    compiled: set[str] = set()
    monkeypatch.setattr(compilation, "is_cached", compiled.__contains__)
    announce = compilation.announce.__wrapped__  # whatever it has said before
    heard = []
    for already in ((), ("depth image",), ("depth image", loops)):
        compiled.update(already)
        compilation._said.clear()
        caplog.clear()
        announce("depth image")
        announce(loops)
        assert compilation.has_compiled() == bool(caplog.messages)
        heard.append(len(caplog.messages))
    assert heard == [1, 1, 0]


@pytest.mark.usefixtures("started")
def test_clouds_of_few_points_and_points_in_a_plane_need_loops_of_their_own(monkeypatch, caplog):
    rng = np.random.default_rng(0)
    sensor = pw.Sensor(noise=0.01, max_depth=10.0)
    few, many = (rng.uniform(0, 3, (count, 3)) * [1, 1, 0.001] for count in (200, 5000))
    heard = []
    for compiled in ({"cloud"}, {"cloud", "points"}):
        monkeypatch.setattr(compilation, "is_cached", compiled.__contains__)
        for points in (many, few, few[:, [0, 2]]):
            compilation._said.clear()
            compilation.announce.cache_clear()
            caplog.clear()
            assert pw.detect_planes_in_points(points, sensor).planes
            heard.append(len(caplog.messages))
    assert heard == [0, 1, 1, 0, 0, 0]
    compilation.announce.cache_clear()
    assert any(compilation._kept(compilation._TELLING["points"]))


def test_the_process_that_helps_can_be_waited_for(monkeypatch):
    helper = subprocess.Popen([sys.executable, "-c", ""])
    helper.returncode = 0  # as `announce` leaves it
    monkeypatch.setattr(compilation, "_helpers", [helper])
    compilation.wait_for_help()
    with pytest.raises(ChildProcessError):
        os.waitpid(helper.pid, os.WNOHANG)
    compilation.wait_for_help()  # there is none any more


@pytest.mark.skipif(os.name != "posix", reason="zombies as POSIX has them")
def test_a_process_that_has_helped_is_no_zombie(monkeypatch):
    monkeypatch.setattr(compilation, "is_cached", lambda _: False)
    monkeypatch.setattr(compilation, "_shares", lambda *_: [["this"]])
    monkeypatch.delenv("PLANEWISE_COMPILES_FOR_ANOTHER", raising=False)
    monkeypatch.setattr(compilation, "_helpers", [])
    compilation._said.clear()
    compilation.announce.__wrapped__("spatial")
    (helper,) = compilation._helpers
    until = time.monotonic() + 30
    there = True
    while there and time.monotonic() < until:
        time.sleep(0.01)
        try:
            os.kill(helper.pid, 0)
        except ProcessLookupError:
            there = False
    assert not there


@pytest.mark.parametrize(
    ("idle", "images", "clouds"),
    [
        (0, [], 0),
        (1, [["describing", "valuing", "labelling", "surfaces"]], 1),
        (2, [["describing", "valuing"], ["labelling", "surfaces"]], 1),
        (4, [["describing", "valuing"], ["labelling", "surfaces"], ["merging"]], 1),
        (7, [["describing"], ["valuing"], ["labelling"], ["surfaces"], ["merging"]], 1),
    ],
)
def test_as_many_processes_help_as_there_are_idle_cores(idle, images, clouds):
    assert sum(compilation._PARTS, ()) == tuple(warm_up._PARTS)
    assert compilation._shares(idle, False) == [["planewise.warm_up", *parts] for parts in images]
    assert compilation._shares(idle, True) == [["planewise.clouds.warm_up"]] * clouds


@pytest.mark.parametrize(
    ("executable", "frozen", "helps"),
    [("/usr/bin/python3.12", False, True), ("/opt/app", False, False), ("/x/python", True, False)],
)
def test_only_python_itself_is_started_for_help(monkeypatch, executable, frozen, helps):
    monkeypatch.setattr(sys, "executable", executable)
    monkeypatch.setattr(sys, "frozen", frozen, raising=False)
    assert compilation._is_interpreter() == helps


def test_who_helps_imports_nothing_from_the_current_folder(monkeypatch, tmp_path):
    (tmp_path / "numba.py").write_text("raise SystemExit('not this one')")
    started = []
    monkeypatch.setattr(compilation, "is_cached", lambda _: False)
    monkeypatch.setattr(compilation, "available", lambda: 2)
    monkeypatch.setattr(compilation, "_shares", lambda *_: [["planewise.kernels.jit"]])
    monkeypatch.setattr(compilation, "_wait_for", lambda _: None)
    monkeypatch.setattr(compilation, "_helpers", started)
    monkeypatch.setenv("PLANEWISE_COMPILES_FOR_ANOTHER", "")
    monkeypatch.chdir(tmp_path)
    compilation._said.clear()
    compilation.announce.__wrapped__("spatial")
    (helper,) = started
    helper.returncode = None
    assert helper.wait(60) == 0


def test_a_worker_has_one_process_that_helps_and_none_if_it_does_without(monkeypatch, started):
    monkeypatch.setattr(compilation, "is_cached", lambda _: False)
    monkeypatch.setattr(compilation, "available", lambda: 8)
    monkeypatch.setenv("PLANEWISE_COMPILES_FOR_ANOTHER", "")
    announce = compilation.announce.__wrapped__  # whatever it has said before
    counts = []
    for parent, loops in (
        (None, "spatial"),
        (multiprocessing.current_process(), "spatial"),
        (None, "paper"),
    ):
        monkeypatch.setattr(multiprocessing, "parent_process", lambda parent=parent: parent)
        compilation._said.clear()
        started.clear()
        announce(loops)
        counts.append(len(started))
    compilation.without_help()
    compilation._said.clear()
    announce("spatial")
    assert [*counts, len(started)] == [5, 1, 0, 0]
