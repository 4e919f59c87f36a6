"""Loops that were compiled before, by another process."""

import ast
import inspect
import pkgutil
from importlib import import_module
from os import utime
from pathlib import Path
from shutil import copytree, ignore_patterns

import pytest

from planewise import kernels
from planewise.kernels import jit, loop_cache, pieces
from tests.command import run_python

DECORATORS = {"compiled", "in_order", "internal", "called", "inlined"}

LOOPS = """
import numpy as np
from planewise.kernels.jit import called, compiled

@called
def total(values):
    out = 0.0
    for i in range(values.size):
        out += values[i]
    return out

@compiled
def mean(values):
    return total(values) / values.size

@compiled
def spread(values):
    middle = mean(values)
    return total((values - middle) ** 2) / values.size
"""
COUNT = """
import sys
import numpy as np
from numba.core import event

class Compiled(event.Listener):
    names = set()
    def on_start(self, event):
        self.names.add(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass

event.register("numba:compile", Compiled())
import loops
values = np.arange(5.0)
print(*(getattr(loops, name)(values) for name in sys.argv[1:]))
print(*sorted(Compiled.names & {"total", "mean", "spread"}))
"""


@pytest.fixture
def called(tmp_path):
    """Call loops by name in a process; what they gave, and what was compiled for it."""
    (tmp_path / "loops.py").write_text(LOOPS, encoding="utf-8")
    kept = str(tmp_path / "kept")

    def call(*names, before="", **settings):
        found = {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": kept}
        done = run_python(before + COUNT, *names, **found, **settings)
        values, compiled = done.stdout.split("\n")[:2]
        return [float(value) for value in values.split()], compiled.split()

    return call


def test_what_is_kept_is_not_compiled_again(called):
    assert called("mean") == ([2.0], ["mean", "total"])
    assert called("mean") == ([2.0], [])


@pytest.mark.parametrize("setting", [{"NUMBA_BOUNDSCHECK": "1"}, {"NUMBA_LOOP_VECTORIZE": "0"}])
def test_what_is_compiled_by_other_settings_is_for_them_alone(called, setting):
    """To check bounds, for instance: it is slow, and would stay so."""
    assert called("mean", **setting) == ([2.0], ["mean", "total"])
    assert called("mean", **setting) == ([2.0], [])
    assert called("mean") == ([2.0], ["mean", "total"])
    assert called("mean") == ([2.0], [])
    assert called("mean", **setting) == ([2.0], [])


def test_loops_can_be_compiled_that_call_what_was_kept(called):
    called("mean")
    assert called("mean", "spread") == ([2.0, 2.0], ["spread"])
    assert called("spread", "mean") == ([2.0, 2.0], [])


COUNT_PARSED = """
from llvmlite import binding
parse, sizes = binding.parse_bitcode, []

def counts(bitcode, *rest):
    sizes.append(len(bitcode))
    return parse(bitcode, *rest)

binding.parse_bitcode = counts
import atexit
atexit.register(lambda: print(*sizes))
"""


def test_a_loop_is_compiled_from_what_is_kept_of_those_it_calls(called, tmp_path):
    """Else machine code would depend on which process compiled which of them."""
    call = run_python(
        COUNT_PARSED + COUNT,
        "spread",
        PYTHONPATH=str(tmp_path),
        NUMBA_CACHE_DIR=str(tmp_path / "a"),
    )
    parsed = [int(size) for size in call.stdout.split("\n")[2].split()]
    assert len(parsed) == 2  # mean and total


def test_types_of_variables_are_not_kept(called, tmp_path):
    called("mean")
    kept = b"".join(path.read_bytes() for path in (tmp_path / "kept").glob("**/*.nbc"))
    assert b"_ZN" in kept
    assert b"# --- LINE" not in kept


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_what_is_damaged_is_compiled_again(called, tmp_path, ending):
    called("mean")
    for path in (tmp_path / "kept").glob(f"**/loops.mean*.{ending}"):
        path.write_bytes(path.read_bytes()[:30])
    assert called("mean") == ([2.0], ["mean"])
    assert called("mean") == ([2.0], [])


@pytest.mark.parametrize("part", [b"\x7fELF", b"BC\xc0\xde"])
def test_a_page_that_is_lost_is_compiled_again(called, tmp_path, part):
    """Of machine code, which would end the process, or of bitcode."""
    called("mean")
    (path,) = (tmp_path / "kept").glob("**/loops.mean*.nbc")
    kept = bytearray(path.read_bytes())
    start = kept.rindex(part) + 300
    kept[start : start + 200] = bytes(200)
    path.write_bytes(kept)
    assert called("mean") == ([2.0], ["mean"])
    assert called("mean", "spread") == ([2.0, 2.0], ["spread"])


def test_a_full_disk_leaves_no_loop_of_an_older_source(called, tmp_path):
    called("mean")
    changed = LOOPS.replace("total(values) / values.size", "2 * total(values) / values.size", 1)
    (tmp_path / "loops.py").write_text(changed, encoding="utf-8")
    full = """
from numba.core.caching import IndexDataCacheFile

def no_room(*_):
    raise OSError(28, "No space left on device")

IndexDataCacheFile._save_data = no_room
"""
    assert called("mean", before=full) == ([4.0], ["mean", "total"])
    assert called("mean") == ([4.0], ["mean", "total"])
    assert called("mean") == ([4.0], [])


PIECES = """
import numpy as np
from planewise.kernels.pieces import label_pieces

labels = np.array([[1, 1, 0, 1], [0, 1, 0, 1]], np.int32)
parent, label = np.empty((2, labels.size), np.int32)
print(label_pieces(labels, 1, False, parent, label, np.zeros_like(labels)))
"""


def test_a_loop_is_compiled_again_where_what_it_calls_in_another_module_has_changed(tmp_path):
    package, roots = tmp_path / "planewise", tmp_path / "planewise/kernels/roots.py"
    copytree(Path(kernels.__file__).parents[1], package, ignore=ignore_patterns("__pycache__"))
    found = {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    found["PYTHONDONTWRITEBYTECODE"] = "1"  # of a source as old and as large
    assert int(run_python(PIECES, **found).stdout) == 2
    before, source = roots.stat(), roots.read_text(encoding="utf-8")
    changed = source.replace("parent[k] != k", "parent[k] <  0")  # every pixel is a root
    assert changed != source
    roots.write_text(changed, encoding="utf-8")
    utime(roots, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert roots.stat().st_size == before.st_size
    assert int(run_python(PIECES, **found).stdout) > 2


def test_loops_are_kept_where_there_are_no_sources(monkeypatch, tmp_path):
    """As in a program that was frozen: by its date."""
    loop = pieces.label_pieces.py_func
    of_sources = loop_cache.LoopCache(loop)._cache_file._source_stamp
    monkeypatch.setattr(pieces, "__file__", str(tmp_path / "absent.py"))
    loop_cache._digest.cache_clear()
    try:
        kept = loop_cache.LoopCache(loop)
    finally:
        loop_cache._digest.cache_clear()
    assert kept._cache_file._source_stamp == kept._impl.locator.get_source_stamp() != of_sources


def test_an_interrupt_while_bitcode_is_parsed_does_no_harm(called):
    called("mean")
    interrupted = """
import numpy as np
import loops
from planewise.kernels import loop_cache

values = np.arange(5.0)
loops.mean(values)
parse = loop_cache.llvm.parse_bitcode

def interrupt(code):
    loop_cache.llvm.parse_bitcode = parse
    raise KeyboardInterrupt

loop_cache.llvm.parse_bitcode = interrupt
try:
    loops.spread(values)
except KeyboardInterrupt:
    pass
else:
    raise AssertionError("nothing was linked")
"""
    assert called("spread", before=interrupted)[0] == [2.0]
    assert called("spread") == ([2.0], [])


def test_what_is_kept_needs_nothing_that_numba_compiles(called, tmp_path):
    """Nor SciPy, whose BLAS it looks for."""
    called("spread")
    done = run_python(
        COUNT + 'print(*{"numba.np.linalg", "scipy.linalg"} & set(sys.modules))',
        "spread",
        PYTHONPATH=str(tmp_path),
        NUMBA_CACHE_DIR=str(tmp_path / "kept"),
    )
    assert done.stdout.split("\n")[:3] == ["2.0", "", ""]


def test_loops_of_others_find_all_that_numba_compiles(called):
    """Numba multiplies matrices by SciPy's BLAS."""
    called("spread")
    product = """
import numpy as np
from numba import njit
import loops
loops.spread(np.arange(5.0))
assert njit(lambda a: a @ a)(np.full((2, 2), 2.0)).sum() == 32.0
"""
    assert called("spread", before=product) == ([2.0], [])


def powers_in(source):
    """Whole powers in the loops of a source, by line."""
    return [
        f"{power.lineno}: {ast.unparse(power)}"
        for loop in ast.walk(ast.parse(source))
        if isinstance(loop, ast.FunctionDef)
        and DECORATORS & {ast.unparse(decorator) for decorator in loop.decorator_list}
        for power in ast.walk(loop)
        if isinstance(power, ast.BinOp)
        and isinstance(power.op, ast.Pow)
        and not isinstance(getattr(power.right, "value", 0), float)
    ]


@pytest.mark.parametrize(
    "name", sorted(each.name for each in pkgutil.iter_modules(kernels.__path__))
)
def test_no_loop_has_whole_powers(name):
    """Numba compiles one once a process, by the options of the first loop that has it."""
    assert powers_in(inspect.getsource(import_module(f"planewise.kernels.{name}"))) == []


def test_whole_powers_are_found():
    assert vars(jit).keys() >= DECORATORS
    assert powers_in("@called\ndef f(x, n):\n    return x**2 + x**n + x**0.5") == [
        "3: x ** 2",
        "3: x ** n",
    ]
