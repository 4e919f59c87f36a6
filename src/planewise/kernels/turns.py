"""Rows of segments (`kernels.cells`) in the coordinates of other sectors (`planewise.sectors`)."""

from __future__ import annotations

from planewise.kernels.jit import compiled


@compiled
def turn_row(row, back, out):  # type: ignore[no-untyped-def]
    """Row of a segment in the coordinates of another sector: P' = B P B', P' t' = B P t.

    What follows P and P t does not depend on coordinates.
    """
    p = row[0], row[1], row[2], row[1], row[3], row[4], row[2], row[4], row[5]
    at = 0
    for i in range(3):
        a, b, c = back[i, 0], back[i, 1], back[i, 2]
        x, y = a * p[0] + b * p[3] + c * p[6], a * p[1] + b * p[4] + c * p[7]
        z = a * p[2] + b * p[5] + c * p[8]
        for j in range(i, 3):
            out[at] = x * back[j, 0] + y * back[j, 1] + z * back[j, 2]
            at += 1
        out[6 + i] = a * row[6] + b * row[7] + c * row[8]
    for e in range(9, row.size):
        out[e] = row[e]


@compiled
def turn_rows(rows, home, turns, out):  # type: ignore[no-untyped-def]
    """The same of rows (n, E), home (n,): the sector of each; turns (K, 3, 3): B of every sector.

    Writes out (n, E).
    """
    for k in range(rows.shape[0]):
        turn_row(rows[k], turns[home[k]], out[k])
