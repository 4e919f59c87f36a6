"""What happens around the first compilation."""

import gc

import pytest
from numba import njit
from numba.core import event

from planewise import compilation  # noqa: F401 - registers itself


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
