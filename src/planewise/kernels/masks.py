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
from numba import njit

NEIGHBOURS = 4
SYMBOLS = NEIGHBOURS + 1  # the last one: none of the neighbours
CONTEXTS = 128  # six equalities among the neighbours, and whether the left one is on a plane
PRIOR = 0.5  # of each symbol's count: Krichevsky and Trofimov's estimate

_compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})


@_compiled
def mask_length(labels, there, planes):  # type: ignore[no-untyped-def]
    """Nats of a label image.

    labels (H, W) integer, those above planes taken as 0; there (H, W) bool: where there is a
    reading. The order in which a context's symbols came does not change the length of an adaptive
    code, so they are counted first and paid for at the end.
    """
    height, width = labels.shape
    counts = np.zeros((CONTEXTS, SYMBOLS), np.int64)
    distinct_of = np.ones(CONTEXTS, np.int64)
    upper = np.zeros(width + 2, np.int64)  # last label of each column, one column of margin
    total = 0.0
    for y in range(height):
        left, corner = upper[1], upper[0]
        for x in range(width):
            above, right = upper[x + 1], upper[x + 2]
            if there[y, x]:
                label = np.int64(labels[y, x]) if labels[y, x] <= planes else np.int64(0)
                if left == above and above == right and right == corner:
                    context, distinct = 126 + int(left > 0), 1
                    symbol = 0 if label == left else NEIGHBOURS
                else:
                    context = int(left > 0) + 2 * int(left == above) + 4 * int(right == above)
                    context += 8 * int(corner == above) + 16 * int(left == corner)
                    context += 32 * int(left == right) + 64 * int(right == corner)
                    # The place of each neighbour among the distinct ones.
                    second = above != left
                    third = right not in (left, above)
                    fourth = corner not in (left, above, right)
                    distinct = 1 + int(second) + int(third) + int(fourth)
                    if label == left:
                        symbol = 0
                    elif label == above:
                        symbol = 1
                    elif label == right:
                        symbol = 1 + int(second)
                    elif label == corner:
                        symbol = distinct - 1
                    else:
                        symbol = NEIGHBOURS
                counts[context, symbol] += 1
                distinct_of[context] = distinct
                if symbol == NEIGHBOURS:
                    total += np.log(planes + 1 - distinct)
                upper[x + 1] = label
                left = label
            corner = above
    for context in range(CONTEXTS):
        row, symbols = counts[context], distinct_of[context] + (planes >= distinct_of[context])
        # product over the symbols of (count so far + 1/2) / (all so far + symbols / 2)
        total += math.lgamma(row.sum() + PRIOR * symbols) - math.lgamma(PRIOR * symbols)
        for symbol in range(SYMBOLS):
            if row[symbol] > 0:
                total -= math.lgamma(row[symbol] + PRIOR) - math.lgamma(PRIOR)
    return total
