"""Loops that find the pieces of planes: the points of each in the cells of a grid on it."""

from __future__ import annotations

import numpy as np

from planewise.kernels.cloud_keys import middle_of
from planewise.kernels.jit import compiled, in_order, inlined
from planewise.kernels.roots import root_of

_BLOCK = 8  # occupied cells of three by three that make a piece wide
_BRIDGE = 5  # cells of a narrow piece that joins two wide ones
_BEYOND = 2  # cells: pieces so near each other touch


@compiled
def extents(  # type: ignore[no-untyped-def]
    local, labels, starts, cubes, side, middle, turn, axes, finest, first, last, low, high, places
):  # fmt: skip
    """Least and largest coordinates on its plane of the points of each label in cubes[first:last].

    Points as of `cloud_labels.label_points`; axes (N + 1, 2, 3): in the plane of every label.
    Lowers low and raises high (N + 1, 2), and adds to places (N + 1,) the finest cubes, so wide,
    that hold points: copies of a point are one place, and so is much of a dense line of a scanner.
    """
    before, scale = np.empty(3), 1.0 / finest
    for cube in range(first, last):
        x0, y0, z0 = middle_of(cubes[cube], side, middle, turn)
        for i in range(starts[cube], starts[cube + 1]):
            j = labels[i]
            x, y, z = local[i, 0] + x0, local[i, 1] + y0, local[i, 2] + z0
            for e in range(2):
                u = axes[j, e, 0] * x + axes[j, e, 1] * y + axes[j, e, 2] * z
                low[j, e] = min(low[j, e], u)
                high[j, e] = max(high[j, e], u)
            new = i == starts[cube] or labels[i - 1] != j
            for e in range(3):
                u = turn[e, 0] * local[i, 0] + turn[e, 1] * local[i, 1] + turn[e, 2] * local[i, 2]
                u = np.floor(u * scale)
                new = new or u != before[e]
                before[e] = u
            places[j] += new


@inlined
def _cell(x, y, z, axes, low, scale, width):  # type: ignore[no-untyped-def]
    """Place of a point in the grid of its plane, row by row."""
    u = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - low[0]) * scale
    v = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - low[1]) * scale
    return np.int64(v) * width + np.int64(u)


@compiled
def occupy(  # type: ignore[no-untyped-def]
    local, labels, starts, cubes, side, middle, turn, axes, low, scale, width, begins, first, last,
    grid,
):  # fmt: skip
    """Mark the cells that hold points of cubes[first:last].

    low (N + 1, 2), scale (N + 1,), one over the side of a cell, and width (N + 1,) of the grid of
    every label, which begins at begins (N + 2,) in grid. Writes 1 to it.
    """
    for cube in range(first, last):
        x0, y0, z0 = middle_of(cubes[cube], side, middle, turn)
        for i in range(starts[cube], starts[cube + 1]):
            j = labels[i]
            if begins[j + 1] > begins[j]:
                x, y, z = local[i, 0] + x0, local[i, 1] + y0, local[i, 2] + z0
                grid[begins[j] + _cell(x, y, z, axes[j], low[j], scale[j], width[j])] = 1


@compiled
def relabel(  # type: ignore[no-untyped-def]
    local, labels, starts, cubes, side, middle, turn, axes, low, scale, width, begins, grid, new,
    first, last, out,
):  # fmt: skip
    """Label the points of cubes[first:last] by the piece that their cell is part of.

    grid: pieces 1, 2 ... of every label, as `pieces` writes them; new (N + 1,): label of the first
    of them, to which the number of the piece less one is added. Writes out (k,).
    """
    for cube in range(first, last):
        x0, y0, z0 = middle_of(cubes[cube], side, middle, turn)
        for i in range(starts[cube], starts[cube + 1]):
            j = labels[i]
            out[i] = new[j]
            if begins[j + 1] > begins[j]:
                x, y, z = local[i, 0] + x0, local[i, 1] + y0, local[i, 2] + z0
                cell = begins[j] + _cell(x, y, z, axes[j], low[j], scale[j], width[j])
                out[i] = new[j] + grid[cell] - 1


@in_order
def pieces(grid, height, width):  # type: ignore[no-untyped-def]
    """Number the pieces of a plane: occupied cells that touch. Returns how many there are.

    grid (height * width,): 1 where a cell is occupied, else 0; overwritten with 1, 2 ... by size,
    and 0. Only wide pieces count, those with eight occupied cells in a block of three by three: the
    lines of a scanner on a sparse surface are narrow, and each is part of the wide pieces near it.
    If it is of some size it joins them; what is near none is part of the largest.
    """
    # Cells that touch, by a first pass over the rows before.
    parent = np.empty(height * width // 2 + 2, np.int32)
    found = 0
    for y in range(height):
        for x in range(width):
            cell = y * width + x
            if grid[cell] == 0:
                continue
            mine = 0
            for direction in range(4):
                dx, dy = (direction - 1, -1) if direction < 3 else (-1, 0)
                if y + dy < 0 or x + dx < 0 or x + dx >= width:
                    continue
                other = grid[cell + dy * width + dx]
                if other == 0:
                    continue
                other = root_of(parent, other)
                if mine == 0:
                    mine = other
                elif other != mine:
                    low, high = min(mine, other), max(mine, other)
                    parent[high] = low
                    mine = low
            if mine == 0:
                found += 1
                parent[found] = mine = found
            grid[cell] = mine
    size, wide = np.zeros(found + 1, np.int64), np.zeros(found + 1, np.bool_)
    for cell in range(grid.size):
        if grid[cell] > 0:
            grid[cell] = root_of(parent, grid[cell])
            size[grid[cell]] += 1
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            cell = y * width + x
            mine = max(grid[cell], grid[cell - 1])
            if mine == 0 or wide[mine]:
                continue
            held = 0
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    held += grid[cell + dy * width + dx] == mine
            wide[mine] = held >= _BLOCK
    seeds = 0
    for k in range(1, found + 1):
        seeds += wide[k]
    if seeds < 2:
        grid[:] = grid > 0
        return 1
    # What narrow pieces are near: the first wide one, and others that they join to it.
    near = np.zeros(found + 1, np.int32)
    changed = True
    while changed:
        changed = False
        for y in range(height):
            for x in range(width):
                mine = grid[y * width + x]
                if mine == 0 or wide[mine]:
                    continue
                for v in range(max(y - _BEYOND, 0), min(y + _BEYOND + 1, height)):
                    for u in range(max(x - _BEYOND, 0), min(x + _BEYOND + 1, width)):
                        other = grid[v * width + u]
                        if other == 0 or other == mine:
                            continue
                        if not wide[other]:
                            other = near[other]
                            if other == 0:
                                continue
                        other = root_of(parent, other)
                        if near[mine] == 0:
                            near[mine] = other
                            changed = True
                        elif size[mine] >= _BRIDGE and root_of(parent, near[mine]) != other:
                            one = root_of(parent, near[mine])
                            parent[max(one, other)] = min(one, other)
                            changed = True
    total = np.zeros(found + 1, np.int64)
    for k in range(1, found + 1):
        root = root_of(parent, k) if wide[k] else root_of(parent, near[k]) if near[k] > 0 else 0
        total[root] += size[k]
    number, seeds = np.zeros(found + 1, np.int32), 0
    for k in np.argsort(-total, kind="mergesort"):
        if wide[k] and parent[k] == k:
            seeds += 1
            number[k] = seeds
    for cell in range(grid.size):
        mine = grid[cell]
        if mine > 0:
            root = mine if wide[mine] else near[mine]
            grid[cell] = number[root_of(parent, root)] if root > 0 else 1
    return seeds
