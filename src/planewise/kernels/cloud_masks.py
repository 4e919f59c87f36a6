"""Codes of the labels of a cloud, in Morton order: of points, or of thick sheets.

Where sheets are thin, points are coded one after the other as pixels are (`kernels.masks`).

Where they are thick, the code says which planes the points of each cube are on. Each is given
the ones before it along the three axes of the grid: first which of their labels it has, too; then,
one after the other, those that none of them has. How often each happens is learned on the fly.

Then the points of a cube are told apart: points are drawn from all sheets in a cube at once, and
their place says from which. What has to be said is where one sheet ends and the next begins, as a
line that parts n points, of which there are n (n - 1) / 2 + 1. Stray points on none have a name
each where that is shorter, one of n! / (n1! n2!) ways.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cloud_rows import COUNT
from planewise.kernels.jit import compiled, in_order, inlined, internal
from planewise.kernels.masks import PRIOR, add_change, write_lengths

BEFORE = (4, 10, 12)  # of the cubes about one (`cubes_about`): along the three axes of the grid
_LATELY = 8192  # neighbourhoods of different labels that are remembered

# Codes of what happens: a label that h of q cubes before have is there, or not; one more label that
# none has, or no more; it is a plane, or none.
_HAVE = 0  # 2 (q (q - 1) / 2 + h - 1) + there
_MORE, _NO_MORE, _NEW_PLANE, _NEW_NONE = 12, 13, 14, 15
CODES = 16
_LARGEST = 4  # cubes that have a say


@in_order
def mask_edges(labels, starts, about, first, last, previous, alike, edges):  # type: ignore[no-untyped-def]
    """Find the points of cubes[first:last] that have not the label of all their neighbours.

    The code of `kernels.masks` in Morton order. Neighbours already coded: the point before, and the
    last ones in the cubes before this one along the three axes of the grid (where one is empty, the
    point before). previous: label of the point before. Adds the others to alike (N + 1,), by label.
    Writes edges (., 6): the labels of neighbours and point, and how often they come; those that
    came lately once. Returns how many rows there are, and the label of the last point.
    """
    found = 0
    lately = np.full(_LATELY, -1, np.int64)
    beside = np.empty(3, np.int64)
    for cube in range(first, last):
        for axis in range(3):
            at = about[cube, BEFORE[axis]]
            beside[axis] = labels[starts[at + 1] - 1] if at >= 0 else -1
        for i in range(starts[cube], starts[cube + 1]):
            raw = np.int64(labels[i])
            x = beside[0] if beside[0] >= 0 else previous
            y = beside[1] if beside[1] >= 0 else previous
            z = beside[2] if beside[2] >= 0 else previous
            if previous == raw and x == raw and y == raw and z == raw:
                alike[raw] += 1
            else:
                slot = (previous + 7 * x + 61 * y + 509 * z + 1021 * raw) % _LATELY
                edge = edges[lately[slot]]
                if (
                    lately[slot] >= 0
                    and edge[0] == previous
                    and edge[1] == x
                    and edge[2] == y
                    and edge[3] == z
                    and edge[4] == raw
                ):
                    edge[5] += 1
                else:
                    edge = edges[found]
                    edge[0], edge[1], edge[2], edge[3], edge[4] = previous, x, y, z, raw
                    edge[5] = 1
                    lately[slot] = found
                    found += 1
            previous = raw
    return found, previous


@in_order
def mask_lengths(edges, alike, place, changes, lengths):  # type: ignore[no-untyped-def]
    """Nats of the labels if only the first 0 ... N planes were there, labels of others 0.

    edges, alike: `mask_edges`; place (N + 1,): 1 ... N of every label in that order, 0 for none;
    changes (N + 1, `masks.CODES`): zeros to count the symbols in, by the planes from which they are
    so. Writes lengths (N + 1,).
    """
    for e in range(edges.shape[0]):
        add_change(
            changes,
            np.int64(place[edges[e, 0]]),
            np.int64(place[edges[e, 1]]),
            np.int64(place[edges[e, 2]]),
            np.int64(place[edges[e, 3]]),
            np.int64(place[edges[e, 4]]),
            edges[e, 5],
        )
    write_lengths(alike, place, changes, lengths)


@inlined
def _have(cubes, having, there):  # type: ignore[no-untyped-def]
    return _HAVE + 2 * (cubes * (cubes - 1) // 2 + having - 1) + there


@inlined
def _either(a, b):  # type: ignore[no-untyped-def]
    """Nats of a yes and b no that an adaptive code learns."""
    nats = math.lgamma(a + b + 2.0 * PRIOR) - math.lgamma(2.0 * PRIOR)
    return nats - math.lgamma(a + PRIOR) - math.lgamma(b + PRIOR) + 2.0 * math.lgamma(PRIOR)


@in_order
def count_sets(label, places, about, first, last, place, changes):  # type: ignore[no-untyped-def]
    """Count what happens in cubes[first:last] if only the first 0 ... N planes were there.

    label (g,), places (n + 1,): of groups, those of each cube; about (n, 27): `cubes_about`; place
    (N + 1,): 1 ... N of every label in that order, 0 for none; of planes that are not there points
    are on none. Adds to changes (N + 1, CODES) from one number of planes to the next.
    """
    end, most = np.int64(place.size), np.int64(1)
    for cube in range(places.size - 1):
        most = max(most, places[cube + 1] - places[cube])
    # Place of every label there, and which of the cubes have it: bit 0 for this one.
    known, owners = np.empty(_LARGEST * most, np.int64), np.empty(_LARGEST * most, np.int64)
    now, before = np.empty(CODES, np.int64), np.empty(CODES, np.int64)
    for cube in range(first, last):
        size, cubes = 0, 0
        alike = places[cube + 1] - places[cube] == 1
        own = label[places[cube]]
        for axis in range(-1, 3):
            at = cube if axis < 0 else about[cube, BEFORE[axis]]
            if at < 0:
                continue
            if axis >= 0:
                cubes += 1
            alike &= places[at + 1] - places[at] == 1 and label[places[at]] == own
            for g in range(places[at], places[at + 1]):
                rank, k = np.int64(place[label[g]]), 0
                while k < size and known[k] != rank:
                    k += 1
                if k == size:
                    known[k], owners[k] = rank, 0
                    size += 1
                owners[k] |= 1 << (cubes if axis >= 0 else 0)
        if alike and cubes > 0:
            changes[0, _have(cubes, cubes, 1)] += 1
            changes[0, _NO_MORE] += 1
            continue
        n = np.int64(0)
        for code in range(CODES):
            before[code] = 0
        while n < end:
            # From one of the labels to the next higher one, those above are none.
            following = end
            for code in range(CODES):
                now[code] = 0
            none, inherited, new = 0, 0, 0
            for k in range(size):
                rank = known[k]
                if rank > n:
                    following = min(following, rank)
                if rank == 0 or rank > n:
                    none |= owners[k]
                    continue
                having = (owners[k] >> 1 & 1) + (owners[k] >> 2 & 1) + (owners[k] >> 3 & 1)
                there = owners[k] & 1
                if having > 0:
                    now[_have(cubes, having, there)] += 1
                    inherited += there
                else:
                    now[_NEW_PLANE] += 1
                    new += 1
            having, there = (none >> 1 & 1) + (none >> 2 & 1) + (none >> 3 & 1), none & 1
            if having > 0:
                now[_have(cubes, having, there)] += 1
                inherited += there
            elif there > 0:
                now[_NEW_NONE] += 1
                new += 1
            now[_MORE] += new - (1 if inherited == 0 else 0)  # no cube is empty
            now[_NO_MORE] += 1
            for code in range(CODES):
                changes[n, code] += now[code] - before[code]
                before[code] = now[code]
            n = following


@in_order
def set_lengths(changes, lengths):  # type: ignore[no-untyped-def]
    """Write nats of the sets with the first 0 ... N planes to lengths (N + 1,), sums to changes."""
    for n in range(lengths.size):
        if n > 0:
            for code in range(CODES):
                changes[n, code] += changes[n - 1, code]
        nats = 0.0
        for code in range(0, CODES, 2):
            if changes[n, code] + changes[n, code + 1] > 0:
                nats += _either(changes[n, code], changes[n, code + 1])
        if changes[n, _NEW_PLANE] > 0:
            nats += changes[n, _NEW_PLANE] * math.log(n)  # which one
        lengths[n] = nats


@internal
def _lines(n):  # type: ignore[no-untyped-def]
    """Nats to say which of n points lie on one side of a line: there are n (n - 1) / 2 + 1 ways."""
    return math.log(0.5 * n * (n - 1.0) + 1.0)


@internal
def _names(points, on_none, sheets):  # type: ignore[no-untyped-def]
    """Nats to tell apart the points on planes, so many sheets, and those on none in one cube."""
    if sheets == 0:
        return 0.0
    nats = (sheets - 1) * _lines(points)
    if on_none > 0.0:
        n = points + on_none
        drawn = math.log(n - 1.0) + math.lgamma(n + 1.0)
        drawn -= math.lgamma(points + 1.0) + math.lgamma(on_none + 1.0)
        nats += min(drawn, _lines(n))
    return nats


@compiled
def name_points(groups, label, places, place, first, last, names, left):  # type: ignore[no-untyped-def]
    """Nats to tell apart the points of cubes[first:last], with all planes and without some.

    groups (m, 18), label (m,), places (n + 1,): groups, those of each cube; place (N + 1,): 1 ...
    N of every plane. Writes names (n,), with all planes, and left (m,): how many more it is when
    the plane of a group goes after those behind it.
    """
    for cube in range(first, last):
        begin, end = places[cube], places[cube + 1]
        points, on_none, sheets = 0.0, 0.0, 0
        for g in range(begin, end):
            left[g] = 0.0
            if label[g] > 0:
                points, sheets = points + groups[g, COUNT], sheets + 1
            else:
                on_none = groups[g, COUNT]
        names[cube] = paid = _names(points, on_none, sheets)
        behind = np.int64(place.size)
        while sheets > 0:
            gone, at = np.int64(0), begin
            for g in range(begin, end):
                rank = np.int64(place[label[g]])
                if gone < rank < behind:
                    gone, at = rank, g
            points, on_none = points - groups[at, COUNT], on_none + groups[at, COUNT]
            sheets -= 1
            now = _names(points, on_none, sheets)
            left[at] = now - paid
            paid, behind = now, gone
