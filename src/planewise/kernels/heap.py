"""A heap of items whose top has the largest key."""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import internal


@internal
def push(keys, items, size, key, item):  # type: ignore[no-untyped-def]
    """Enter an item into a heap whose top is the largest key; returns the new size."""
    i = size
    while i > 0 and keys[(i - 1) >> 1] < key:
        keys[i], items[i] = keys[(i - 1) >> 1], items[(i - 1) >> 1]
        i = (i - 1) >> 1
    keys[i], items[i] = key, item
    return size + 1


@internal
def pop(keys, items, size):  # type: ignore[no-untyped-def]
    """Take the top off a heap; returns the new size."""
    replace(keys, items, size - 1, keys[size - 1], items[size - 1])
    return size - 1


@internal
def replace(keys, items, size, key, item):  # type: ignore[no-untyped-def]
    """Put another item in place of the top of a heap."""
    i = 0
    keys[size] = -np.inf  # there is room: then every child has a brother
    while 2 * i + 1 < size:
        child = 2 * i + 1
        child += keys[child + 1] > keys[child]
        if keys[child] <= key:
            break
        keys[i], items[i] = keys[child], items[child]
        i = child
    keys[i], items[i] = key, item
