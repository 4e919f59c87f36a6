"""Loops over the borders of segments: their price in nats, and which segments pay for theirs."""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import SIDE
from planewise.kernels.forms import discord_of
from planewise.kernels.jit import compiled, in_order, inlined, internal
from planewise.kernels.masks import list_marked, room_for_runs


@inlined
def falling(discord, price):  # type: ignore[no-untyped-def]
    """Nats of a border, a pixel or a point of it: low + (high - low) / (1 + (discord / knee)^2)."""
    low, high, knee = price
    times = discord / knee
    return low + (high - low) / (1.0 + times * times)


@in_order
def border_price(discord, price):  # type: ignore[no-untyped-def]
    """Nats of a side of a cell, of SIDE pixels; the least ones where there is no discord (-1).

    price: (low, high, knee) (`falling`).
    """
    if discord < 0.0:
        return SIDE * price[0]
    return SIDE * falling(discord, price)


@internal
def list_apart(row, below, marked, places):  # type: ignore[no-untyped-def]
    """List the cells of a row unlike the one to their right or below, and the last; how many.

    marked, places: `room_for_runs` of so many. Few are, and a vector loop tells which.
    """
    for j in range(row.size - 1):
        marked[j] = (row[j] != row[j + 1]) | (row[j] != below[j])
    return list_marked(marked, places)


@inlined
def _write_segments(units, segment, out):  # type: ignore[no-untyped-def]
    """Write the segment of every cell of a row, or -1 where it has no unit."""
    for j in range(out.size):
        out[j] = segment[units[j]] if units[j] >= 0 else -1


@in_order
def border_discords(unit, whole, segment, forms, right, below, out):  # type: ignore[no-untyped-def]
    """Discord across every side shared by two units: out[0] to the right, out[1] below; else -1.

    unit (rows, columns): of every cell, or -1; sides within a segment (units,) are left out. forms
    of the units; right, below: discords of units that are whole (units,), from `square_discords`;
    out (2, rows, columns). Returns how many sides are not -1.
    """
    rows, columns = unit.shape
    lines = np.empty((2, columns), np.int32)  # segments of the cells of a row, and of the next
    marked, places = room_for_runs(columns)
    _write_segments(unit[0], segment, lines[0])
    found = 0
    for i in range(rows):
        here, lower = lines[i & 1], lines[1 - (i & 1)]
        _write_segments(unit[min(i + 1, rows - 1)], segment, lower)
        for k in range(out.shape[0]):
            line = out[k, i]
            for side in range(columns):
                line[side] = -1.0
        for n in range(list_apart(here, lower, marked, places)):
            j = np.intp(places[n])
            u = unit[i, j]
            if u < 0:
                continue
            # Each direction is written out: in a loop both would be asked which they are.
            if j + 1 < columns and here[j + 1] != here[j] and here[j + 1] >= 0:
                v = unit[i, j + 1]
                known = whole[u] and whole[v]
                out[0, i, j] = right[i >> 1, j >> 1] if known else discord_of(forms[u], forms[v])
                found += 1
            if lower[j] != here[j] and lower[j] >= 0:
                v = unit[i + 1, j]
                known = whole[u] and whole[v]
                out[1, i, j] = below[i >> 1, j >> 1] if known else discord_of(forms[u], forms[v])
                found += 1
    return found


@compiled
def segments_of_cells(unit, segment, out):  # type: ignore[no-untyped-def]
    """Write the segment of every cell of out (rows, columns): segment[unit], or -1 as unit is."""
    for i in range(unit.shape[0]):
        _write_segments(unit[i], segment, out[i])


@in_order
def segment_borders(unit, of_cell, discords, price, wraps, border, ends, units, at, nats):  # type: ignore[no-untyped-def]
    """Nats of the borders of every segment: dear where the surface goes on, else cheap.

    unit, of_cell (rows, columns): of every cell, and its segment, or -1; price as `border_price`
    takes it; wraps: whether the last column is beside the first. Writes border (2, n): nats, and
    number, of all sides of each; and for each side between two segments these, ends (., 2), units
    (., 2), at (.): twice the place of the first cell, and 1 if the other is below it, not beside
    it; and nats (.). Returns how many of these there are.
    """
    rows, columns = of_cell.shape
    marked, places = room_for_runs(columns)
    border[:] = 0.0
    found = 0
    for i in range(rows):
        for n in range(list_apart(of_cell[i], of_cell[min(i + 1, rows - 1)], marked, places)):
            j = np.intp(places[n])
            u = of_cell[i, j]
            for k in range(2):
                row, column = i + k, j + 1 - k
                if wraps and column == columns:
                    column = np.intp(0)
                if row >= rows or column >= columns or of_cell[row, column] == u:
                    continue
                v, cost = of_cell[row, column], border_price(discords[k, i, j], price)
                if u >= 0:
                    border[0, u] += cost
                    border[1, u] += 1.0
                if v >= 0:
                    border[0, v] += cost
                    border[1, v] += 1.0
                if u >= 0 and v >= 0:
                    ends[found, 0], ends[found, 1], nats[found] = u, v, cost
                    units[found, 0], units[found, 1] = unit[i, j], unit[row, column]
                    at[found] = 2 * (i * columns + j) + k
                    found += 1
    return found


@in_order
def accept(worth, ends, price, least, accepted):  # type: ignore[no-untyped-def]
    """Accept the segments that are worth more than `least` nats; a border is paid for once.

    worth (n,): with all borders paid for; what accepted neighbours pay is added to it. Every
    accepted segment makes its neighbours cheaper, so adding those that pay, until no more do, ends
    at the same ones in any order.
    """
    alone = np.empty(worth.size)
    for k in range(worth.size):
        alone[k], accepted[k] = worth[k], worth[k] > least
    more = True
    while more:
        for k in range(alone.size):
            worth[k] = alone[k]
        for e in range(price.size):
            u, v = ends[e, 0], ends[e, 1]
            if accepted[v]:
                worth[u] += price[e]
            if accepted[u]:
                worth[v] += price[e]
        more = False
        for k in range(worth.size):
            if worth[k] > least and not accepted[k]:
                accepted[k] = more = True
