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

import numpy as np
from numba import njit

NEIGHBOURS = 4
SYMBOLS = NEIGHBOURS + 1  # the last one: none of the neighbours
CONTEXTS = 64 * 2
PRIOR = 0.5  # of each symbol's count: Krichevsky and Trofimov's estimate

_compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})


@_compiled
def context_of(left, above, right, corner, order):  # type: ignore[no-untyped-def]
    """Context of a pixel, and its distinct neighbours in `order`; returns both numbers."""
    pattern = np.int64(left == above)
    pattern += 2 * (right == above) + 4 * (corner == above) + 8 * (left == corner)
    pattern += 16 * (left == right) + 32 * (right == corner)
    order[0] = left
    distinct = 1
    for label in (above, right, corner):
        known = False
        for i in range(distinct):
            known = known or order[i] == label
        if not known:
            order[distinct] = label
            distinct += 1
    return 2 * pattern + (left > 0), distinct


@_compiled
def mask_length(labels, there, planes):  # type: ignore[no-untyped-def]
    """Nats of a label image.

    labels (H, W) integer in 0 ... planes; there (H, W) bool: where there is a reading.
    """
    height, width = labels.shape
    counts = np.full((CONTEXTS, SYMBOLS), PRIOR)
    upper = np.zeros(width + 2, np.int64)  # last label of each column, one column of margin
    order = np.empty(NEIGHBOURS, np.int64)
    total = 0.0
    for y in range(height):
        left, corner = upper[1], upper[0]
        for x in range(width):
            above, right = upper[x + 1], upper[x + 2]
            if there[y, x]:
                label = np.int64(labels[y, x])
                context, distinct = context_of(left, above, right, corner, order)
                others = planes + 1 - distinct
                symbol = NEIGHBOURS
                for i in range(distinct):
                    if order[i] == label:
                        symbol = i
                row = counts[context]
                mass = row[NEIGHBOURS] if others > 0 else 0.0
                for i in range(distinct):
                    mass += row[i]
                total -= np.log(row[symbol] / mass)
                if symbol == NEIGHBOURS:
                    total += np.log(others)
                row[symbol] += 1.0
                upper[x + 1] = label
                left = label
            corner = above
    return total
