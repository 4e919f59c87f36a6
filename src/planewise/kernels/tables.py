"""Tables by depth, as `spatial.frame.ErrorTable` has them."""

from __future__ import annotations

from planewise.kernels.jit import inlined


@inlined
def between(table, row, last):  # type: ignore[no-untyped-def]
    """Value of a table at a row, linear between rows; at `last`, the last but one, beyond it."""
    row = min(row, last)
    below = int(row)
    return table[below] + (row - below) * (table[below + 1] - table[below])
