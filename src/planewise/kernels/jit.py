"""How loops are compiled.

``error_model="numpy"``, for the default checks every division and keeps loops from being vector
code; of ``fastmath`` only what honours NaN and infinity; no wrappers that nobody calls, for each
costs compilation time. So do types: a literal handed to another loop is a type of its own, for
which that is compiled again, hence ``np.intp(0)``; and so do calls of NumPy, once for every type:
``np.zeros`` takes four times as long as ``np.empty``, ``np.arange`` seven. And what a loop calls
is optimised once more with each loop above it: of a chain of calls `inlined` makes one. Loops have
``x * x`` and no ``x**2``: that is compiled once a process, by the options of the first loop that
has it, and last bits would depend on which that is. A loop whose number of rounds is written down
is unrolled with all the loops inside: over rows of an array it is ``range(out.shape[0])``. And a
call costs as much as forty operations where arrays are handed over: what a heap asks ten thousand
times is `internal`.

A loop that makes no array and returns none counts no references (`kernels.compiler`): each takes as
long as twenty operations, and Numba leaves many in, as for every row that a loop looks at. So what
is hot and needs room to work in is given it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

from numba import config, njit

from planewise.errors import SetupError
from planewise.kernels.compiler import LoopCompiler
from planewise.kernels.loop_cache import LoopCache

if config.DISABLE_JIT:  # type: ignore[attr-defined]  # it sets them by name
    raise SetupError(
        "NUMBA_DISABLE_JIT is set, and planewise finds nothing without compiled loops; unset it"
    )

_njit: Any = njit  # its types know fewer options than it has
_FAST = {"reassoc", "contract", "arcp", "nsz"}
_IN_ORDER = {"contract", "nsz"}
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "forceinline": False,  # else a loop that is compiled for one of `internal` is, too
    "pipeline_class": LoopCompiler,
}


def _kept(**options: Any) -> Callable[[Any], Any]:
    """`numba.njit`; what it compiles is kept on disk, where it can be."""

    def decorate(loop: Callable[..., Any]) -> Any:
        out = _njit(**{**_OPTIONS, **options})(loop)
        # Without a folder that can be written to every process compiles.
        with contextlib.suppress(RuntimeError):
            out._cache = LoopCache(loop)
        return out

    return decorate


compiled = _kept(fastmath=_FAST)
"""Sums may be taken in any order, which lets them be vector code."""

in_order = _kept(fastmath=_IN_ORDER)
"""Sums are taken in the order in which they are written."""

internal = _kept(fastmath=_FAST, no_cpython_wrapper=True, forceinline=True)
"""`compiled` for what only other loops call."""

called = _kept(fastmath=_FAST, no_cpython_wrapper=True)
"""`internal` for what is large, which compiles sooner if it is not copied into its callers: what is
called in several places of one module, or all that a loop does once it has room to work in. Where
two loops have it, it depends on which of both was compiled first whose copy Numba 0.62 runs: such
as is in every loop has to be `internal`."""

inlined = _njit(inline="always")
"""Part of its caller: for what is called in one place, or has to be vector code there."""
