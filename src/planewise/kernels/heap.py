"""A heap of items whose top has the largest key, and which knows where each of its items is.

keys (n + SPARE,) and items (n + SPARE,), keys behind the last one -inf; place (n,): where each of
the n items is, -1 outside. Four children to a parent make fewer levels, and keys of
brothers share a line of the cache. Unsigned indices spare the check for negative ones.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import internal

SPARE = 4  # every parent has four children
_0, _1, _2, _3 = np.uintp(0), np.uintp(1), np.uintp(2), np.uintp(3)


@internal
def clear(keys, place):  # type: ignore[no-untyped-def]
    """Empty a heap; its size is 0."""
    for k in range(keys.size):
        keys[k] = -np.inf
    for k in range(place.size):
        place[k] = -1


@internal
def update(keys, items, place, size, item, key):  # type: ignore[no-untyped-def]
    """Enter an item, or give it another key; one of 0 or less takes it out. Returns the new size.

    A place is made free, at the end or where the item was, and filled again from above or below.
    """
    at = place[item]
    if at < 0:
        if not key > 0.0:
            return size
        at, size = size, size + 1
    elif not key > 0.0:
        # The last one takes its place.
        size -= 1
        place[item] = -1
        item, key = items[size], keys[size]
        keys[size] = -np.inf
        if at == size:
            return size
    i, end = np.uintp(at), np.uintp(size)
    while i > _0:
        parent = (i - _1) >> _2
        if keys[parent] >= key:
            break
        keys[i], items[i] = keys[parent], items[parent]
        place[np.uintp(items[i])] = i
        i = parent
    while True:
        child = (i << _2) + _1
        if child >= end:
            break
        left = child + np.uintp(keys[child + _1] > keys[child])
        right = child + _2 + np.uintp(keys[child + _3] > keys[child + _2])
        child = right if keys[right] > keys[left] else left
        if keys[child] <= key:
            break
        keys[i], items[i] = keys[child], items[child]
        place[np.uintp(items[i])] = i
        i = child
    keys[i], items[i], place[np.uintp(item)] = key, item, i
    return size
