"""The adaptive code of a label image: labels in raster order, given neighbours already coded.

A label is coded as "the same as" one of the neighbours left, above, above right and above left (in
this order, equal ones counted once), or as none of them and then as one of the other labels, all
alike. How often each happens is learned on the fly, separately for every pattern of which
neighbours are equal and for whether the left one is on a plane. Sender and receiver count alike, so
nothing but the labels is sent and the length is a fact, not a setting.

Pixels without a reading have no label and are passed over; a neighbour is then the last reading
before it in its row or column.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.jit import called, in_order, inlined, internal

NONE = 4  # symbol of a label that none of the neighbours has
SYMBOLS = 5
CONTEXTS = 48  # places of three neighbours among the distinct ones, and whether left is on a plane
CODES = SYMBOLS * CONTEXTS
ALIKE = SYMBOLS  # code of a label on a plane whose neighbours all have it; 0 on none
_16, _32, _48, _ONE = np.uint64(16), np.uint64(32), np.uint64(48), np.uint64(1)
_LOW = np.uint64(0xFFFF)
_1, _2 = np.uintp(1), np.uintp(2)
NOWHERE = np.uint16(0xFFFF)  # instead of a label where there is no reading
_SPREAD = np.uint64(0x9E3779B97F4A7C15)  # odd: 2^64 over the golden ratio
PRIOR = 0.5  # of each symbol's count: Krichevsky and Trofimov's estimate
_UNSEEN = np.array([math.lgamma(PRIOR * symbols) for symbols in range(1, SYMBOLS + 1)])


@inlined
def _code(left, above, right, corner, label):  # type: ignore[no-untyped-def]
    """Context and symbol of a label in one number: SYMBOLS * context + symbol."""
    a = 0 if above == left else 1
    r = 0 if right == left else 1 if right == above else a + 1
    new = max(a, r) + 1
    c = 0 if corner == left else 1 if corner == above else r if corner == right else new
    same = 0 if label == left else a if label == above else r if label == right else NONE
    symbol = c if same == NONE and label == corner else same
    return SYMBOLS * (((3 * a + r) * 4 + c) * 2 + (1 if left > 0 else 0)) + symbol


@inlined
def add_change(changes, left, above, right, corner, label, times):  # type: ignore[no-untyped-def]
    """Add what a label is coded as, to changes (N + 1, .) from one number of planes to the next.

    times: that it comes with these neighbours.
    """
    end = np.int64(changes.shape[0])
    n, code = np.int64(0), 0
    changes[0, 0] += times
    while True:
        # From one of the labels to the next higher one, labels above it are 0.
        following = end
        for other in (label, left, above, right, corner):
            following = min(following, other if other > n else end)
        if following == end:
            break
        n = following
        changes[n, code] -= times
        code = _code(
            left if left <= n else 0,
            above if above <= n else 0,
            right if right <= n else 0,
            corner if corner <= n else 0,
            label if label <= n else 0,
        )
        changes[n, code] += times


@inlined
def _length(counts, planes):  # type: ignore[no-untyped-def]
    """Nats of labels with these counts of contexts and symbols, 0 ... planes the labels.

    The order in which a context's symbols came does not change the length of an adaptive code:
    product over the symbols of (count so far + 1/2) / (all so far + symbols / 2).
    """
    total = 0.0
    for context in range(CONTEXTS):
        row = counts[SYMBOLS * context : SYMBOLS * (context + 1)]
        seen = 0
        for symbol in range(SYMBOLS):
            seen += row[symbol]
        if seen == 0:
            continue
        distinct = 1 + max(context // 24, context // 8 % 3, context // 2 % 4)
        symbols = distinct + (1 if planes >= distinct else 0)
        total += math.lgamma(seen + PRIOR * symbols) - _UNSEEN[symbols - 1]
        for symbol in range(SYMBOLS):
            if row[symbol] > 0:
                total -= math.lgamma(row[symbol] + PRIOR) - _UNSEEN[0]
        if row[NONE] > 0:
            total += row[NONE] * math.log(planes + 1.0 - distinct)
    return total


@inlined
def write_lengths(alike, place, changes, lengths):  # type: ignore[no-untyped-def]
    """Nats of the labels with the first 0 ... N planes, from the changes between these numbers.

    alike (L,): labels among neighbours of their own, which are added to the changes here; the
    others are in them (`add_change`). Writes lengths (N + 1,), and sums of the changes to these.
    """
    for k in range(alike.size):
        changes[0, 0] += alike[k]
        if place[k] > 0:
            changes[place[k], 0] -= alike[k]
            changes[place[k], ALIKE] += alike[k]
    for n in range(lengths.size):
        if n > 0:
            for k in range(changes.shape[1]):
                changes[n, k] += changes[n - 1, k]
        lengths[n] = _length(changes[n], n)


@inlined
def _count_keys(keys, raws, size, slots, around, label, times, found):  # type: ignore[no-untyped-def]
    """Count keys (the neighbours' labels) and labels; returns how many different ones there are.

    They are looked up in a table of slots (2^m,), -1 for empty. Stops when there is no more room.
    """
    last = np.uint64(slots.size - 1)
    for n in range(size):
        key, raw = keys[n], raws[n]
        mixed = (key ^ (np.uint64(raw) * _SPREAD)) * _SPREAD
        slot = (((mixed >> _32) ^ mixed) * _SPREAD) >> _32 & last
        while True:
            k = slots[slot]
            if k < 0:
                if found == times.size:
                    return found + 1
                slots[slot] = found
                around[found], label[found], times[found] = key, raw, 1
                found += 1
                break
            if (around[k] == key) & (label[k] == raw):
                times[k] += 1
                break
            slot = (slot + _ONE) & last
    return found


@internal
def list_marked(marked, places):  # type: ignore[no-untyped-def]
    """List where marked (8 n,) uint8 is 1, not 0; returns how many there are.

    places: room for eight more than that. Few are, and side by side.
    """
    eights, listed = marked.view(np.uint64), 0
    for eight in range(eights.size):
        if eights[eight] != 0:
            for x in range(8 * eight, 8 * eight + 8):
                places[listed] = x
                listed += marked[x]
    return listed


@internal
def room_for_runs(width):  # type: ignore[no-untyped-def]
    """Room that `list_runs` works in, for rows of so many pixels: last and places."""
    last, places = np.empty(-(-width // 8) * 8, np.uint8), np.empty(width + 8, np.uintp)
    for k in range(last.size):
        last[k] = k == width - 1
    return last, places


@internal
def list_runs(row, last, places):  # type: ignore[no-untyped-def]
    """List the last pixel of every run of a row of labels; returns how many there are."""
    for k in range(row.size - 1):
        last[k] = row[k] != row[k + 1]
    return list_marked(last, places)


@in_order
def count_labels(labels, p, lines, edge, slots, around, label, times):  # type: ignore[no-untyped-def]
    """Count with which neighbours labels come, where these have not all the same label.

    labels (H, W) uint16; p (H, W) float32, 0 without a reading. lines (2, W + 2) uint16 and edge
    (W + 7 or less, a multiple of 8) uint8 are zeros to work in, slots (2^m,) int32 is -1. Writes
    around (n,) uint64: labels left, above, above right and above left; label (n,) uint16; times
    (n,) int64. Returns how many different ones there are, or more than n if they are too many.

    Most pixels have the label of all their neighbours.
    """
    width = labels.shape[1]
    keys, raws = np.empty(width, np.uint64), np.empty(width, np.uint16)
    places = np.empty(width + 8, np.uintp)
    seen = np.empty(width + 1, np.uint16)  # labels in a row, one column of margin
    return _count_rows(
        labels, p, lines, edge, slots, around, label, times, keys, raws, places, seen
    )


@called
def _count_rows(  # type: ignore[no-untyped-def]
    labels, p, lines, edge, slots, around, label, times, keys, raws, places, seen
):
    """`count_labels`, with room for a row."""
    height, width = labels.shape
    seen[0] = NOWHERE
    found = 0
    for y in range(height):
        row, weight = labels[y], p[y]
        # The last label of each column, here and in the row above, one column of margin.
        upper, lower = lines[y % 2], lines[1 - y % 2]
        # Unconditional loads and few arrays a loop: each of these is one vector expression.
        for x in range(width):
            coded = row[x]
            seen[x + 1] = coded if weight[x] > 0.0 else NOWHERE
        for x in range(width):
            kept, coded = upper[x + 1], seen[x + 1]
            lower[x + 1] = coded if coded != NOWHERE else kept
        for x in range(width):
            coded = lower[x + 1]
            apart = (coded != upper[x + 1]) | (coded != upper[x + 2]) | (coded != upper[x])
            edge[x] = apart | (seen[x + 1] != seen[x])
        # Listed first, looked at next, counted last: short loops are faster than one long one.
        size = 0
        for n in range(list_marked(edge, places)):
            x = places[n]
            last = np.intp(x)
            while last > 0 and seen[last] == NOWHERE:
                last -= 1
            above, right, corner = upper[x + _1], upper[x + _2], upper[x]
            raw, beside = seen[x + _1], seen[last] if last > 0 else upper[1]
            key = (np.uint64(beside) << _16) | np.uint64(above)
            key = (((key << _16) | np.uint64(right)) << _16) | np.uint64(corner)
            keys[size], raws[size] = key, raw
            alike = (beside == raw) & (above == raw) & (right == raw) & (corner == raw)
            size += (raw != NOWHERE) & (not alike)
        found = _count_keys(keys, raws, size, slots, around, label, times, found)
        if found > times.size:
            break
    return found


@in_order
def mask_lengths(around, label, times, readings, place, changes, lengths):  # type: ignore[no-untyped-def]
    """Nats of a label image if only the first 0 ... N planes were there, labels of others 0.

    around, label, times (n,): `count_labels`; readings (L,) int64: of every label; place (L,)
    uint16: 1 ... N of every label in that order, 0 for none; changes (N + 1, CODES)
    int64: zeros to work in. Writes lengths (N + 1,).

    What a pixel adds depends on its own label and its neighbours', at most five, so it changes at
    most five times while planes are added.
    """
    for k in range(times.size):
        key, raw = around[k], label[k]
        add_change(
            changes,
            np.int64(place[key >> _48]),
            np.int64(place[(key >> _32) & _LOW]),
            np.int64(place[(key >> _16) & _LOW]),
            np.int64(place[key & _LOW]),
            np.int64(place[raw]),
            times[k],
        )
        # Not one of those that have the label of all their neighbours.
        changes[0, 0] -= times[k]
        if place[raw] > 0:
            changes[place[raw], 0] += times[k]
            changes[place[raw], ALIKE] -= times[k]
    write_lengths(readings, place, changes, lengths)
