"""Loops over squares of cells: those that are clearly one plane are joined at once.

What is left are the segments whose merges `kernels.segments` puts in order.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import COUNT, FREE, MISFIT, SEGMENT
from planewise.kernels.edges import write_roots
from planewise.kernels.forms import FORM, discord_of, write_form
from planewise.kernels.jit import compiled
from planewise.kernels.segments import mix_drift, tempered


@compiled
def join_blocks(  # type: ignore[no-untyped-def]
    unit, whole, right, rows, forms, free, drift, lean, limit, levels, tails, root, square, joined,
    shapes,
):  # fmt: skip
    """Join 2 x 2 squares of cells that are clearly one plane, and again 2 x 2 of those.

    unit (rows, columns): unit of every cell, or -1; whole (n,): those of 2 x 2 cells, which the
    first level joins, and right: discords of those side by side (`forms.square_discords`). Squares
    are joined where no discord (left and right, then upper and lower half) is above `limit`. rows,
    forms (n, .): of the units; free (n,): what they cost as a free smooth surface. drift is changed
    in place; lean: as `forms.write_form` takes it, tails as `segments.tempered`. Writes root (n,):
    the unit that each is part of, the upper left one of its square; square (n,): where its joined
    row and form (n / 4, .) are, if any. Returns the number of roots.
    """
    level = np.empty(root.size, np.int8)
    for k in range(root.size):
        root[k], square[k] = k, -1
        level[k] = 1 if whole[k] else 0
    halves, shape = np.empty((2, SEGMENT)), np.empty((2, FORM))
    side, squares, left = 2, 0, root.size
    for step in range(1, levels + 1):
        of, like = joined, shapes
        if step == 1:
            of, like = rows, forms
        for i in range(0, unit.shape[0] - side, 2 * side):
            for j in range(0, unit.shape[1] - side, 2 * side):
                a, b = unit[i, j], unit[i, j + side]
                c, d = unit[i + side, j], unit[i + side, j + side]
                if a < 0 or b < 0 or c < 0 or d < 0:
                    continue
                if level[a] != step or level[b] != step or level[c] != step or level[d] != step:
                    continue
                if step == 1:
                    m, n, o, p = a, b, c, d
                    upper, lower = right[i // 2, j // 2], right[i // 2 + 1, j // 2]
                else:
                    m, n, o, p = square[a], square[b], square[c], square[d]
                    upper, lower = (
                        discord_of(like[m], like[n]),
                        discord_of(like[o], like[p]),
                    )
                if upper > limit or lower > limit:
                    continue
                for e in range(SEGMENT):
                    halves[0, e] = of[m, e] + of[n, e]
                    halves[1, e] = of[o, e] + of[p, e]
                if step == 1:
                    halves[0, FREE], halves[1, FREE] = free[a] + free[b], free[c] + free[d]
                write_form(halves[0], 0.5 * (drift[a] + drift[b]), lean, shape[0])
                write_form(halves[1], 0.5 * (drift[c] + drift[d]), lean, shape[1])
                both = discord_of(shape[0], shape[1])
                if both > limit:
                    continue
                misfit = tempered(both, halves[1, COUNT], tails)
                misfit += tempered(upper, of[n, COUNT], tails)
                misfit += tempered(lower, of[p, COUNT], tails)
                mix_drift(drift, c, d, of[o, COUNT], of[p, COUNT])
                mix_drift(drift, a, b, of[m, COUNT], of[n, COUNT])
                mix_drift(drift, a, c, halves[0, COUNT], halves[1, COUNT])
                if step == 1:
                    square[a] = squares
                    squares += 1
                row = joined[square[a]]
                for e in range(SEGMENT):
                    row[e] = halves[0, e] + halves[1, e]
                row[MISFIT] += misfit
                write_form(row, drift[a], lean, shapes[square[a]])
                root[b] = root[c] = root[d] = a
                level[a] = step + 1
                left -= 3
        side *= 2
    write_roots(root)
    return left


@compiled
def keep_roots(  # type: ignore[no-untyped-def]
    root, square, rows, forms, free, joined, shapes, drift, offset_prior, slope_prior, place,
    out_rows, out_forms, numbers,
):  # fmt: skip
    """Copy what `join_blocks` left, and say in root (n,) where each unit's segment is.

    place (n,): room to work in. Writes rows and forms of the segments, as many as there are roots,
    and numbers (3, .): their drift and priors.
    """
    found = 0
    for k in range(root.size):
        if root[k] == k:
            place[k] = found
            source, like, at = rows, forms, np.int32(k)
            if square[k] >= 0:
                source, like, at = joined, shapes, square[k]
            # Written out: assigning rows would compile checks of their shapes.
            for e in range(SEGMENT):
                out_rows[found, e] = source[at, e]
            for e in range(FORM):
                out_forms[found, e] = like[at, e]
            if square[k] < 0:
                out_rows[found, FREE] = free[k]
            numbers[0, found] = drift[k]
            numbers[1, found], numbers[2, found] = offset_prior[k], slope_prior[k]
            found += 1
    for k in range(root.size):
        root[k] = place[root[k]]
