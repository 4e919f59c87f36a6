"""Quantiles without sorting: a radix selection, which has no branch that is hard to foresee."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import in_order

OF_CHI2 = 0.4549  # the median with one degree of freedom
_DIGIT = 11  # bits of a number that one pass looks at
_SHIFTS = (52, 41, 30, 19, 8, 0)  # of the exponent, and of what is behind it


@in_order
def smallest(values, rank, work):  # type: ignore[no-untyped-def]
    """The number of a rank, from 0, among n, none of them negative or NaN; n > rank.

    The bits of such numbers are in their order. work (n,): room for as many.
    """
    bits, kept = values.view(np.int64), work.view(np.int64)
    size = values.size
    counts = np.empty((1 << _DIGIT) + 1, np.int64)
    for k in range(size):
        kept[k] = bits[k]
    for shift in _SHIFTS:
        counts[:] = 0
        for k in range(size):
            counts[(kept[k] >> shift) & ((1 << _DIGIT) - 1)] += 1
        digit = 0
        while rank >= counts[digit]:
            rank -= counts[digit]
            digit += 1
        found = 0
        for k in range(size):
            kept[found] = kept[k]
            found += (kept[k] >> shift) & ((1 << _DIGIT) - 1) == digit
        size = found
        if size == 1:
            break
    return work[0]
