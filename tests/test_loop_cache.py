"""Loops that were compiled before, by another process."""

import pytest

from tests.command import run_python

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

    def call(*names):
        done = run_python(COUNT, *names, PYTHONPATH=str(tmp_path), NUMBA_CACHE_DIR=kept)
        values, compiled = done.stdout.split("\n")[:2]
        return [float(value) for value in values.split()], compiled.split()

    return call


def test_what_is_kept_is_not_compiled_again(called):
    assert called("mean") == ([2.0], ["mean", "total"])
    assert called("mean") == ([2.0], [])


def test_loops_can_be_compiled_that_call_what_was_kept(called):
    called("mean")
    assert called("mean", "spread") == ([2.0, 2.0], ["spread"])
    assert called("spread", "mean") == ([2.0, 2.0], [])


def test_types_of_variables_are_not_kept(called, tmp_path):
    called("mean")
    kept = b"".join(path.read_bytes() for path in (tmp_path / "kept").glob("**/*.nbc"))
    assert b"_ZN" in kept
    assert b"# --- LINE" not in kept


def test_a_process_of_ones_own_loads_no_blas_before_a_loop_asks_for_it():
    pytest.importorskip("scipy")
    done = run_python(
        """
import sys
import numpy as np
from numba import njit
from planewise.compilation import load_without_scipy

def has_blas():
    return "scipy.linalg.cython_blas" in sys.modules

load_without_scipy()
njit(lambda x: 2 * x)(1.0)
before = has_blas()
product = njit(lambda a: a @ a)(np.full((2, 2), 2.0))
load_without_scipy()
print(before, has_blas(), product.sum())
"""
    )
    assert done.stdout.split() == ["False", "True", "32.0"]
