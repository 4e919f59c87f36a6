"""Waiting for another thread for so long that going to sleep and being woken would take longer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic

from planewise.kernels.jit import compiled


def _load(_: Any, counter: Any) -> tuple[Any, Callable[..., Any]]:
    """Return counter[0] of (1,) int64 as another thread may have written it just now."""

    def load(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.load_atomic(array.data, "monotonic", 8)

    return types.int64(counter), load


_in_memory: Any = intrinsic(_load)


@compiled
def look_until(counter, least, looks, more):  # type: ignore[no-untyped-def]
    """Look at counter[0] until it is `least`, so often at most, and then some times more.

    counter: (1,) int64. The interpreter's lock is not held: what the other thread has to do with it
    after it has counted is done by the time of the last look. Returns counter[0].
    """
    seen = _in_memory(counter)
    for _ in range(looks):
        if seen >= least:
            break
        seen = _in_memory(counter)
    for _ in range(more if seen >= least else 0):
        seen = max(seen, _in_memory(counter))
    return seen
