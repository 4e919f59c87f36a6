"""Loops over the planes of a cloud: which are near each other, and what they are together."""

from __future__ import annotations

import numpy as np

from planewise.kernels.cloud_rows import (
    COUNT,
    CX,
    CY,
    CZ,
    NX,
    NY,
    NZ,
    ROW,
    WEIGHT,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
    add_row,
    write_normal,
)
from planewise.kernels.jit import compiled, internal

_PARALLEL = 0.9  # least cosine between normals of planes that are near


@internal
def _across(row, x, y, z):  # type: ignore[no-untyped-def]
    """Scatter of a row along (x, y, z)."""
    square = row[XX] * x * x + row[YY] * y * y + row[ZZ] * z * z
    return square + 2.0 * (row[XY] * x * y + row[XZ] * x * z + row[YZ] * y * z)


@compiled
def nearest_larger(rows, first, last, nearest, far):  # type: ignore[no-untyped-def]
    """For planes rows[first:last] (n, 18) the nearest one of more points, by their information.

    Writes nearest (n,), the plane itself if it is the largest, and far (n,), half the squared
    distance to it, in standard deviations: half of what its points take more there.
    """
    for k in range(first, last):
        row = rows[k]
        x, y, z = row[NX], row[NY], row[NZ]
        own = _across(row, x, y, z)
        nearest[k], far[k] = k, np.inf
        for j in range(rows.shape[0]):
            if rows[j, COUNT] < row[COUNT] or (rows[j, COUNT] == row[COUNT] and j >= k):
                continue
            a, b, c = rows[j, NX], rows[j, NY], rows[j, NZ]
            if abs(x * a + y * b + z * c) < _PARALLEL:
                continue
            off = a * (row[CX] - rows[j, CX]) + b * (row[CY] - rows[j, CY])
            off += c * (row[CZ] - rows[j, CZ])
            half = 0.5 * (row[WEIGHT] * off * off + _across(row, a, b, c) - own)
            if half < far[k]:
                nearest[k], far[k] = j, half


@compiled
def mixed_points(edges, nearest, mixed):  # type: ignore[no-untyped-def]
    """Add to mixed (N,) how many points of each plane and its nearest one are beside the other.

    edges (m, 6): labels of four neighbours and a point, and how often they come.
    """
    for e in range(edges.shape[0]):
        own = edges[e, 4] - 1
        if own < 0:
            continue
        for k in range(4):
            other = edges[e, k] - 1
            if other >= 0 and other != own:
                if nearest[own] == other:
                    mixed[own] += edges[e, 5]
                    break
                if nearest[other] == own:
                    mixed[other] += edges[e, 5]
                    break


@compiled
def points_together(groups, label, places, nearest, mixed):  # type: ignore[no-untyped-def]
    """Add to mixed (N,) how many points of each plane are in cubes of its nearest one, too.

    groups (m, 18), label (m,): those of each cube from places on. No more than that one has there.
    """
    for cube in range(places.size - 1):
        for g in range(places[cube], places[cube + 1]):
            j = label[g] - 1
            if j >= 0 and nearest[j] != j:
                for other in range(places[cube], places[cube + 1]):
                    if label[other] - 1 == nearest[j]:
                        mixed[j] += min(groups[g, COUNT], groups[other, COUNT])


@compiled
def leave_out(label, places, off, gone, starts, first, last, labels):  # type: ignore[no-untyped-def]
    """Set the labels of the points of groups that are off to 0, of cubes[first:last].

    label, off (m,): of groups, those of each cube from places on; gone (N + 1,): labels that count;
    labels (k,): of the points of each cube, from starts on.
    """
    for cube in range(first, last):
        for g in range(places[cube], places[cube + 1]):
            if off[g] and gone[label[g]]:
                for i in range(starts[cube], starts[cube + 1]):
                    if labels[i] == label[g]:
                        labels[i] = 0


@compiled
def add_rows(rows, place, out):  # type: ignore[no-untyped-def]
    """Add up rows (n, 18) by place (n,): out (m, 18), which begins as zeros, with its normals."""
    for k in range(rows.shape[0]):
        row = out[place[k]]
        if row[COUNT] == 0.0:
            for e in range(ROW):
                row[e] = rows[k, e]
        else:
            add_row(row, rows[k])
    for j in range(out.shape[0]):
        write_normal(out[j])
