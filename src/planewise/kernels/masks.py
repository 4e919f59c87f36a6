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

from planewise.kernels.jit import in_order, inlined

NONE = 4  # symbol of a label that none of the neighbours has
SYMBOLS = 5
CONTEXTS = 48  # places of three neighbours among the distinct ones, and whether left is on a plane
ALIKE = SYMBOLS  # code of a label on a plane whose neighbours all have it; 0 on none
PRIOR = 0.5  # of each symbol's count: Krichevsky and Trofimov's estimate


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
def _add_change(changes, left, above, right, corner, label, times):  # type: ignore[no-untyped-def]
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
        total += math.lgamma(seen + PRIOR * symbols) - math.lgamma(PRIOR * symbols)
        for symbol in range(SYMBOLS):
            if row[symbol] > 0:
                total -= math.lgamma(row[symbol] + PRIOR) - math.lgamma(PRIOR)
        if row[NONE] > 0:
            total += row[NONE] * math.log(planes + 1.0 - distinct)
    return total


@in_order
def mask_lengths(labels, p, place, alike, upper, edge, changes, lengths):  # type: ignore[no-untyped-def]
    """Nats of a label image if only the first 0 ... N planes were there, labels of others 0.

    labels (H, W) uint16; p (H, W) float32, 0 without a reading; place (L,) uint16: 1 ... N of every
    label in that order, 0 for none; alike (L,) int64: readings of every label. upper (W + 2,)
    uint16, edge (W + 7 or less, a multiple of 8) uint8 and changes (N + 1, SYMBOLS * CONTEXTS)
    int64 are zeros to work in. Writes lengths (N + 1,).

    What a pixel adds depends on its own label and its neighbours', at most five, so it changes at
    most five times while planes are added. Most pixels have the label of all their neighbours.
    """
    height, width = labels.shape
    # upper is the last label of each column, one column of margin
    above, right = upper[1 : width + 1], upper[2:]
    for y in range(height):
        row, weight = labels[y], p[y]
        # Unconditional loads and few arrays a loop: each of these is one vector expression.
        for x in range(width):
            edge[x] = (row[x] != above[x]) | (row[x] != right[x]) | (row[x] != upper[x])
        this, before, mark, started = row[1:], row[: width - 1], edge[1:], weight[: width - 1]
        for x in range(width - 1):
            mark[x] |= (this[x] != before[x]) | (started[x] <= 0.0)
        for x in range(width):
            marked = edge[x]
            edge[x] = marked if weight[x] > 0.0 else 0
        for eight in range(edge.size // 8):
            bits = 0
            for x in range(8 * eight, 8 * eight + 8):
                bits |= edge[x]
            if bits == 0:
                continue
            for x in range(8 * eight, 8 * eight + 8):
                if edge[x] == 0:
                    continue
                last = x - 1
                while last >= 0 and not weight[last] > 0.0:
                    last -= 1
                raw = row[x]
                beside = row[last] if last >= 0 else above[0]
                if beside == raw == above[x] == right[x] == upper[x]:
                    continue
                alike[raw] -= 1
                _add_change(
                    changes,
                    np.int64(place[beside]),
                    np.int64(place[above[x]]),
                    np.int64(place[right[x]]),
                    np.int64(place[upper[x]]),
                    np.int64(place[raw]),
                    1,
                )
        for x in range(width):
            kept, coded = above[x], row[x]
            above[x] = coded if weight[x] > 0.0 else kept
    for label in range(alike.size):
        changes[0, 0] += alike[label]
        if place[label] > 0:
            changes[place[label], 0] -= alike[label]
            changes[place[label], ALIKE] += alike[label]
    for n in range(lengths.size):
        if n > 0:
            for k in range(changes.shape[1]):
                changes[n, k] += changes[n - 1, k]
        lengths[n] = _length(changes[n], n)
