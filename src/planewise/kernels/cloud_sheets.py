"""Loops that put sheets of points together again which least cubes have cut into slices.

Where noise is as thick as a cube, part of a sheet lies in the cubes over and under its middle. Such
a slice is flat, but neither its offset nor its normal is the sheet's.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cloud_cells import stacked
from planewise.kernels.cloud_rows import (
    AREA,
    COUNT,
    ROW,
    WEIGHT,
    add_row,
    make_plane,
    write_normal,
)
from planewise.kernels.jit import in_order


@in_order
def join_slices(  # type: ignore[no-untyped-def]
    about, nodes, owner, level_of, order, limits, thickest, widest, rows, points, root
):
    """Join cells that lie over each other where their points together are one sheet.

    Only cells of least cubes, in this order (m,), each with the one that makes the smallest sheet.
    about (n, 27), nodes (n, 18), owner (n,): of the least cubes, the cell that each is part of, or
    -1; level_of (m,) of cells; limits: `cloud_cells.node_states`; thickest: variance of a sheet's
    points, times the white one; widest: area of a sheet; points (m, 18): to work in. Writes rows
    (m, 18) of what is joined, and root (m,): the cell that each is part of.
    """
    white, _, tilt, least, offset_share, prior, _ = limits
    cells, cubes = rows.shape[0], owner.size
    # Cubes of a cell, one after the other.
    first, last = np.empty(cells, np.int64), np.empty(cells, np.int64)
    after = np.empty(cubes, np.int64)
    seen, sheet = np.empty(cells, np.int64), np.empty(ROW)
    for cell in range(cells):
        root[cell], first[cell], seen[cell] = cell, -1, -1
    for cube in range(cubes):
        cell = owner[cube]
        after[cube] = -1
        if cell < 0:
            continue
        if first[cell] < 0:
            first[cell] = cube
            for e in range(ROW):
                points[cell, e] = nodes[cube, e]
        else:
            after[last[cell]] = cube
            add_row(points[cell], nodes[cube])
        last[cell] = cube
    looks = 0
    for k in range(cells):
        cell = order[k]
        while root[cell] == cell and level_of[cell] == 0:
            looks += 1
            best, area = -1, widest
            cube = first[cell]
            while cube >= 0:
                for direction in range(27):
                    near = about[cube, direction]
                    other = owner[near] if near >= 0 else -1
                    if other < 0:
                        continue
                    while root[other] != other:
                        other = root[other]
                    if other == cell or seen[other] == looks or level_of[other] > 0:
                        continue
                    seen[other] = looks
                    if not stacked(rows, cell, other):
                        continue
                    for e in range(ROW):
                        sheet[e] = points[cell, e]
                    add_row(sheet, points[other])
                    chi2, largest, middle = write_normal(sheet)
                    if not middle > 0.0 or chi2 > thickest * white * (sheet[COUNT] - 3.0):
                        continue
                    wide = 12.0 * math.sqrt(largest * middle) / sheet[WEIGHT]
                    if wide < area:
                        best, area = other, wide
                cube = after[cube]
            if best < 0:
                break
            # As wide as the denser one and what the other adds, or as they are together.
            wide = min(
                rows[best, AREA] / points[best, COUNT], rows[cell, AREA] / points[cell, COUNT]
            )
            add_row(points[best], points[cell])
            root[cell] = best
            after[last[best]] = first[cell]
            last[best] = last[cell]
            for e in range(ROW):
                rows[best, e] = points[best, e]
            make_plane(rows[best], white, thickest, tilt, least, offset_share, prior, 0.0)
            rows[best, AREA] = min(rows[best, AREA], wide * rows[best, COUNT])
            cell = best
    for cell in range(cells):
        at = root[cell]
        while root[at] != at:
            at = root[at]
        root[cell] = at
