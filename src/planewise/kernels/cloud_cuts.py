"""Loops over cubes with a slice of a sheet of points: the rest of it lies in a cube beside."""

from __future__ import annotations

import math

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
    add_row,
    misfit_beside,
    write_normal,
)
from planewise.kernels.jit import compiled, in_order

SLICE = (
    0.62  # of the variance is left where a normal variable is cut so that its mean is off by 0.3
)


@compiled
def wholes(nodes, about, white, hopeless, tilt, shared, first, last, whole):  # type: ignore[no-untyped-def]
    """Cube beside each of cubes[first:last] that holds more of the sheet it has a slice of, or -1.

    nodes (n, 18): moments of all cubes; about (n, 27): `cubes_about`; white, hopeless, tilt:
    `make_plane`; shared: of the white variance, what makes no slice. Writes whole (n,).

    A slice is flatter than noise would have it, by three standard deviations of chi^2, and its
    centroid is off the plane of a fuller cube beside; of these the one least far along it counts.
    """
    mine, plane = np.empty(ROW), np.empty((1, ROW))
    for cube in range(first, last):
        whole[cube] = -1
        count = nodes[cube, COUNT]
        freedom = count - 3.0
        most = white * min(SLICE * freedom, freedom - 3.0 * math.sqrt(2.0 * freedom))
        if not most > 0.0:
            continue
        for e in range(ROW):
            mine[e] = nodes[cube, e]
        across, _, _ = write_normal(mine)
        if across > most:
            continue
        nearest = np.inf
        for direction in range(27):
            near = about[cube, direction]
            if near < 0 or nodes[near, COUNT] < count:
                continue
            if nodes[near, COUNT] == count and near <= cube:
                continue
            for e in range(ROW):
                plane[0, e] = nodes[near, e]
            across, _, middle = write_normal(plane[0])
            if not middle > 0.0 or white / middle > tilt:
                continue
            if across > hopeless * white * (nodes[near, COUNT] - 3.0):
                continue
            if misfit_beside(plane, 0, nodes, cube, white) > hopeless * white * count:
                continue
            dx, dy = plane[0, CX] - mine[CX], plane[0, CY] - mine[CY]
            dz = plane[0, CZ] - mine[CZ]
            over = dx * plane[0, NX] + dy * plane[0, NY] + dz * plane[0, NZ]
            if over * over * mine[WEIGHT] < shared * white * count:
                continue
            beside = dx * dx + dy * dy + dz * dz - over * over
            # Both together are as thick as the noise, unlike surfaces that are smoother.
            add_row(plane[0], nodes[cube])
            across, _, _ = write_normal(plane[0])
            if across > SLICE * white * plane[0, COUNT] and beside < nearest:
                nearest, whole[cube] = beside, near


@in_order
def fold_groups(slices, whole, places, rows, label, kept):  # type: ignore[no-untyped-def]
    """Add groups of slices to those of the same label in their whole cube; clears kept of them.

    slices (s,): cubes; whole (n,): as of `wholes`; places (n + 1,): where the groups of each cube
    begin; rows (m, 18) and label (m,) of groups.
    """
    for k in range(slices.size):
        cube = slices[k]
        for g in range(places[cube], places[cube + 1]):
            for other in range(places[whole[cube]], places[whole[cube] + 1]):
                if label[other] == label[g]:
                    add_row(rows[other], rows[g])
                    kept[g] = False
