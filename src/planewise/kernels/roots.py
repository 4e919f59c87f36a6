"""Sets that are united: each member leads to another one of its set, the root to itself."""

from __future__ import annotations

from planewise.kernels.jit import inlined


@inlined
def root_of(parent, k):  # type: ignore[no-untyped-def]
    """Root of the set of k, the way to which is halved."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k
