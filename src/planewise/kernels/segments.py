"""Loops over segments: merging neighbours while that saves nats.

A segment is a row as `kernels.cells` lays it out; joining segments is adding rows. What needs no
order is joined before, by `kernels.squares`.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import COUNT, MISFIT, SEGMENT
from planewise.kernels.edges import (
    append_half,
    find_edge,
    keep_alive,
    list_edges,
    list_sides,
    unite_edges,
    write_roots,
)
from planewise.kernels.elementary import logarithm
from planewise.kernels.forms import (
    FORM,
    LEANING,
    compare_forms,
    compare_pairs,
    write_form,
)
from planewise.kernels.heap import SPARE, clear, update
from planewise.kernels.jit import called, compiled, inlined, internal
from planewise.kernels.masks import room_for_runs
from planewise.kernels.turns import turn_row

_CELL = 36.0
_BATCH = 200  # edges that are valued at once; columns a power of 2 apart share lines of the cache


@internal
def tempered(discord, count, tails):  # type: ignore[no-untyped-def]
    """Discord with the tails of Student's t: (nu + 3) ln(1 + discord / nu), nu growing with pixels.

    The size of a cell's error is uncertain, so that a cell on a rounded edge costs little; an
    average over many cells is normal. tails: nu of one cell of 6 x 6 pixels.
    """
    nu = tails * max(1.0, count / _CELL)
    return (nu + 3.0) * logarithm(1.0 + discord / nu)


@internal
def _form_in(facing, segments, forms, home, turns, drift, lean, u, form, row):  # type: ignore[no-untyped-def]
    """Write the form of segment u in the coordinates of a sector; row (13,): room to work in."""
    if home[u] == facing:
        for e in range(FORM):
            form[e] = forms[u, e]
        return
    turn_row(segments[u], turns[home[u], facing], row)
    write_form(row, drift[u], lean, form)


@called
def _across(segments, forms, home, turns, drift, lean, small, large, offset, slope, work):  # type: ignore[no-untyped-def]
    """`compare_forms` of segments that lie in several sectors, in the one that faces the smaller.

    There its readings lie before the sector: P t of its row, in space the sum of p d / r over its
    directions d, points along the sector's axis most. In others they may lie beside or behind it,
    where no centroid says where two segments meet. What the larger one leans by is taken where
    they do, for it may lie on all sides.
    """
    facing, best = np.int32(0), -np.inf
    for k in range(turns.shape[0]):
        along, of_small = 0.0, turns[home[small], k, 0]
        for i in range(3):
            along += of_small[i] * segments[small, 6 + i]
        if along > best:
            facing, best = np.int32(k), along
    here, there, row = work[0], work[1], work[2]
    _form_in(facing, segments, forms, home, turns, drift, lean, small, here, row)
    _form_in(facing, segments, forms, home, turns, drift, lean, large, there, row)
    there[LEANING] = here[LEANING]
    return compare_forms(there, here, offset, slope)


@inlined
def _share_left(evidence, boundary, misfit, most, longest):  # type: ignore[no-untyped-def]
    """Share of the nats saved by a merge that its misfit leaves; nats that lack where none is left.

    Saved are evidence, at most a plane's parameters, and boundary, at most `longest`.
    """
    saved = min(evidence, most) + min(boundary, longest)
    gain = saved - 0.5 * misfit
    return gain / saved if gain > 0.0 else gain


@internal
def _merge_value(  # type: ignore[no-untyped-def]
    segments,
    forms,
    home,
    turns,
    drift,
    lean,
    u,
    v,
    boundary,
    offset_prior,
    slope_prior,
    most,
    longest,
    tails,
    work,
):
    """`_share_left` by joining two segments, and the misfit of the join; work: of `_across`."""
    small = u if segments[u, COUNT] < segments[v, COUNT] else v
    offset, slope = offset_prior[small], slope_prior[small]
    if turns.shape[0] == 1:
        discord, evidence = compare_forms(forms[u], forms[v], offset, slope)
    else:
        large = u + v - small
        discord, evidence = _across(
            segments, forms, home, turns, drift, lean, small, large, offset, slope, work
        )
    misfit = tempered(discord, segments[small, COUNT], tails)
    return _share_left(evidence, boundary, misfit, most, longest), misfit


@internal
def _first_values(  # type: ignore[no-untyped-def]
    segments,
    forms,
    home,
    turns,
    drift,
    lean,
    ends,
    boundary,
    offset_prior,
    slope_prior,
    most,
    longest,
    tails,
    current,
    misfit,
):
    """`_merge_value` of edges (n, 2), all at once: writes current and misfit (n,)."""
    of_each, work = np.empty((4, misfit.size)), np.empty((3, SEGMENT))
    offset, slope, discord, evidence = of_each[0], of_each[1], of_each[2], of_each[3]
    for edge in range(misfit.size):
        u, v = ends[edge, 0], ends[edge, 1]
        small = u if segments[u, COUNT] < segments[v, COUNT] else v
        offset[edge], slope[edge] = offset_prior[small], slope_prior[small]
    compare_pairs(forms, ends, offset, slope, discord, evidence)
    for edge in range(misfit.size):
        u, v = ends[edge, 0], ends[edge, 1]
        if home[u] == home[v]:
            pixels = min(segments[u, COUNT], segments[v, COUNT])
            misfit[edge] = tempered(discord[edge], pixels, tails)
            current[edge] = _share_left(evidence[edge], boundary[edge], misfit[edge], most, longest)
        else:
            current[edge], misfit[edge] = _merge_value(
                segments, forms, home, turns, drift, lean, u, v, boundary[edge], offset_prior,
                slope_prior, most, longest, tails, work,
            )  # fmt: skip


@internal
def mix_drift(drift, u, v, of_u, of_v):  # type: ignore[no-untyped-def]
    """Drift of segment u when v becomes part of it: their mean by readings, of_u and of_v."""
    share = of_v / (of_u + of_v)
    drift[u] += share * (drift[v] - drift[u])


@internal
def _join(segments, forms, drift, lean, u, v, misfit):  # type: ignore[no-untyped-def]
    """Make segment v part of segment u, in whose coordinates it is."""
    mix_drift(drift, u, v, segments[u, COUNT], segments[v, COUNT])
    for e in range(SEGMENT):
        segments[u, e] += segments[v, e]
    segments[u, MISFIT] += misfit
    write_form(segments[u], drift[u], lean, forms[u])


@called
def _merge_best_first(  # type: ignore[no-untyped-def]
    segments, forms, drift, lean, offset_prior, slope_prior, home, turns, most, longest, tails,
    segment, ends, edges, following, alive, valued, head, tail, degree, version, boundary, misfit,
    keys, items, place, size, work,
):  # fmt: skip
    """The merges of `agglomerate`, once its edges are in the heap; work: of `_across`.

    valued: versions of both ends when an edge was last valued; misfit: of the two segments then.
    """
    while True:
        if size == 0:
            # What saved nothing may, now that its segments have grown: all are valued again.
            for edge in range(edges):
                if alive[edge] and valued[edge] != version[ends[edge, 0]] + version[ends[edge, 1]]:
                    size = update(keys, items, place, size, np.int32(edge), np.inf)
            if size == 0:
                break
        edge, gain = items[0], 0.0
        u, v = ends[edge, 0], ends[edge, 1]
        old = valued[edge] != version[u] + version[v]
        if old:
            valued[edge] = version[u] + version[v]
            gain, misfit[edge] = _merge_value(
                segments, forms, home, turns, drift, lean, u, v, boundary[edge], offset_prior,
                slope_prior, most, longest, tails, work,
            )  # fmt: skip
        size = update(keys, items, place, size, edge, gain)
        if old:
            continue
        if segments[u, COUNT] < segments[v, COUNT]:
            u, v = v, u
        if home[u] != home[v]:
            turn_row(segments[v], turns[home[v], home[u]], work[2])
            for e in range(SEGMENT):
                segments[v, e] = work[2, e]
        _join(segments, forms, drift, lean, u, v, misfit[edge])
        version[u] += version[v] + 1
        segment[v] = u
        alive[edge] = 0
        degree[u] -= 1
        # The edges of v become u's; where both had one to the same neighbour they become one.
        half = head[v]
        while half >= 0:
            after, moved = following[half], half >> 1
            other = ends[moved, 1 - (half & 1)]
            if alive[moved]:
                # An edge between u and the neighbour is in both lists: look into the shorter one.
                walked, wanted = (other, u) if degree[other] < degree[u] else (u, other)
                kept = find_edge(walked, wanted, ends, alive, head, tail, following)
                if kept >= 0:
                    boundary[kept] += boundary[moved]
                    alive[moved] = 0
                    degree[other] -= 1
                    # Its gain has risen: it must come up before anything it may now beat.
                    valued[kept] = version[u] + version[other]
                    gain, misfit[kept] = _merge_value(
                        segments, forms, home, turns, drift, lean, u, other, boundary[kept],
                        offset_prior, slope_prior, most, longest, tails, work,
                    )  # fmt: skip
                    size = update(keys, items, place, size, moved, 0.0)
                    size = update(keys, items, place, size, kept, gain)
                else:
                    ends[moved, half & 1] = u
                    degree[u] += 1
                    append_half(u, half, head, tail, following)
            half = after


def room(sides: int, segments: int) -> tuple[int, int]:
    """Sizes of the integers and floating-point numbers that `agglomerate` works in."""
    return 8 * sides + SPARE + 5 * segments, 3 * sides + SPARE


@compiled
def agglomerate(  # type: ignore[no-untyped-def]
    unit,
    discords,
    price,
    segments,
    forms,
    drift,
    lean,
    offset_prior,
    slope_prior,
    home,
    turns,
    wraps,
    most,
    longest,
    tails,
    roots,
    segment,
    ints,
    floats,
):
    """Merge neighbouring segments, of what is saved what loses least first, while any is left.

    So what is alike grows together before a long border joins what is not: as if the price of
    borders and parameters rose slowly from nothing (Koepfler, Lopez and Morel, 1994).

    unit (rows, columns): segment of every cell, or -1; discords (2, rows, columns): across each
    side shared with the cell to the right and below, which `price` (`border_price`) turns into the
    nats that a merge saves there. segments, their forms and drift are changed in place: the row of
    a root holds its whole segment. lean: as `forms.write_form` takes it; home (n,): the sector in
    whose coordinates each is; turns (K, K, 3, 3): what `turn_row` takes from the first to the
    second; wraps: whether the last column is beside the first; most, longest: as `_share_left`
    takes them, tails as `tempered`. Writes roots (n,), as many as it returns, and segment (n,):
    which of these each has become part of. ints, floats: room to work in, `room` of so many sides
    and segments.

    Gains are valued lazily: an edge at the top whose segments have changed since is valued again;
    one whose gain has risen meanwhile comes up late. The edges of a segment are a linked list of
    half-edges, 2 e and 2 e + 1.
    """
    count = segments.shape[0]
    most_edges = (ints.size - 5 * count - SPARE) // 8
    ends = ints[: 2 * most_edges].reshape((most_edges, 2))
    following = ints[2 * most_edges : 4 * most_edges]
    alive, valued = ints[4 * most_edges : 5 * most_edges], ints[5 * most_edges : 6 * most_edges]
    place, items = ints[6 * most_edges : 7 * most_edges], ints[7 * most_edges : -5 * count]
    head, tail, degree, seen, version = ints[ints.size - 5 * count :].reshape((5, count))
    boundary, misfit = floats[:most_edges], floats[most_edges : 2 * most_edges]
    keys = floats[2 * most_edges :]
    degree[:] = version[:] = 0
    edges = list_sides(
        unit, discords, price, wraps, ends, boundary, alive,
        np.empty((2, unit.shape[1]), np.int32), *room_for_runs(unit.shape[1]),
    )  # fmt: skip
    list_edges(ends, edges, head, tail, following)
    unite_edges(ends, boundary, alive, head, following, seen)
    edges = keep_alive(ends, boundary, alive, edges)
    list_edges(ends, edges, head, tail, following)

    for u in range(count):
        segment[u] = u
    clear(keys, place[:edges])
    size, gains = np.intp(0), np.empty(_BATCH)
    for start in range(0, edges, _BATCH):
        stop = min(start + _BATCH, int(edges))
        _first_values(
            segments, forms, home, turns, drift, lean, ends[start:stop], boundary[start:stop],
            offset_prior, slope_prior, most, longest, tails, gains, misfit[start:stop],
        )  # fmt: skip
        for edge in range(start, stop):
            degree[ends[edge, 0]] += 1
            degree[ends[edge, 1]] += 1
            valued[edge] = 0
            size = update(keys, items, place, size, np.int32(edge), gains[edge - start])
    _merge_best_first(
        segments, forms, drift, lean, offset_prior, slope_prior, home, turns, most, longest, tails,
        segment, ends, edges, following, alive, valued, head, tail, degree, version, boundary,
        misfit, keys, items, place, size, np.empty((3, SEGMENT)),
    )  # fmt: skip
    write_roots(segment)
    found = 0
    for u in range(count):
        if segment[u] == u:
            roots[found], seen[u] = u, found
            found += 1
    for u in range(count):
        segment[u] = seen[segment[u]]
    return found


@compiled
def far_off(rows, drift, segment, place, planes, limit, off):  # type: ignore[no-untyped-def]
    """Mark the units that lie far off the plane of their segment; returns how many.

    rows (n, 13), drift (n,), segment (n,): of every unit; place (segments,): its plane among planes
    (., 3), -1 for none; limit: of the square of the offset against its variance, the unit's own and
    that of a drift over 100 pixels. None of a segment that has no more than half of them near it.
    """
    count = np.zeros((2, planes.shape[0]), np.int64)
    for u in range(off.size):
        k = place[segment[u]]
        off[u] = False
        if k >= 0:
            row, precision = rows[u], rows[u, 0]
            offset = (
                row[6] - precision * planes[k, 0] - row[1] * planes[k, 1] - row[2] * planes[k, 2]
            )
            off[u] = offset * offset > limit * precision * (1.0 + precision * drift[u])
            count[1 if off[u] else 0, k] += 1
    found = 0
    for u in range(off.size):
        if off[u]:
            k = place[segment[u]]
            off[u] = count[0, k] > count[1, k]
            found += off[u]
    return found


@compiled
def connected(unit, off, fewest, queue, piece, boxes):  # type: ignore[no-untyped-def]
    """Number connected units that are marked, where there are at least `fewest` of them.

    unit (rows, columns): of every cell, or -1; off (n,); queue: room for the cells of all that are
    marked. Writes piece (n,): number of each, from 0, or -1; boxes (., 4): its first row and
    column, and the last ones. Returns how many there are, at most as many as boxes has room for.
    """
    rows, columns = unit.shape
    seen = np.zeros((rows, columns), np.bool_)
    for u in range(piece.size):
        piece[u] = -1
    found = 0
    for i in range(rows):
        for j in range(columns):
            if unit[i, j] < 0 or seen[i, j] or not off[unit[i, j]] or found == boxes.shape[0]:
                continue
            box, members, end = boxes[found], 0, 1
            box[0], box[1], box[2], box[3] = i, j, i, j
            queue[0], seen[i, j] = i * columns + j, True
            at = 0
            while at < end:
                row, column = queue[at] // columns, queue[at] % columns
                at += 1
                u = unit[row, column]
                members += piece[u] != found
                piece[u] = found
                box[0], box[1] = min(box[0], row), min(box[1], column)
                box[2], box[3] = max(box[2], row), max(box[3], column)
                for k in range(4):
                    r, c = row + (k == 0) - (k == 1), column + (k == 2) - (k == 3)
                    if r < 0 or c < 0 or r >= rows or c >= columns or seen[r, c]:
                        continue
                    if unit[r, c] >= 0 and off[unit[r, c]]:
                        queue[end], seen[r, c] = r * columns + c, True
                        end += 1
            if members >= fewest:
                found += 1
            else:
                for k in range(end):
                    piece[unit[queue[k] // columns, queue[k] % columns]] = -1
    return found
