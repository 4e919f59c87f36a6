"""Quantiles without sorting: a radix selection, which has no branch that is hard to foresee."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import in_order

OF_CHI2 = 0.4549  # the median with one degree of freedom
_PARTS = 1 << 11  # of the numbers between least and most, that one pass counts
_FEW = 16  # numbers that are put in order at once
_NOT_SIGN = np.int64((1 << 63) - 1)  # bits of a float64, for 0 may have one


@in_order
def smallest(values, rank, work):  # type: ignore[no-untyped-def]
    """The number of a rank, from 0, among n, none of them negative or NaN; n > rank.

    The bits of such numbers are in their order. work (n,): room for as many.
    """
    bits, kept = values.view(np.int64), work.view(np.int64)
    size, least, most = values.size, _NOT_SIGN, np.int64(0)
    for k in range(size):
        number = bits[k] & _NOT_SIGN
        kept[k] = number
        least, most = min(least, number), max(most, number)
    counts = np.empty(_PARTS + 1, np.int64)
    while size > _FEW and least < most:
        shift = np.int64(0)
        while (most - least) >> shift >= _PARTS:
            shift += 1
        counts[:] = 0
        for k in range(size):
            counts[(kept[k] - least) >> shift] += 1
        part = np.int64(0)
        while rank >= counts[part]:
            rank -= counts[part]
            part += 1
        found = 0
        for k in range(size):
            kept[found] = kept[k]
            found += (kept[k] - least) >> shift == part
        size = found
        least += part << shift
        most = min(most, least + (np.int64(1) << shift) - 1)
    for k in range(1, size):  # those that are left, by insertion
        number, place = kept[k], k
        while place > 0 and kept[place - 1] > number:
            kept[place] = kept[place - 1]
            place -= 1
        kept[place] = number
    return work[rank] if size <= _FEW else work[0]
