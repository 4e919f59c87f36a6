"""The heap of merges against a dictionary."""

import numpy as np

from planewise.kernels import heap


def test_largest_key_of_items_entered_moved_and_taken_out():
    rng, count = np.random.default_rng(0), 60
    keys, items = np.empty(count + heap.SPARE), np.empty(count + heap.SPARE, np.int32)
    place = np.empty(count, np.int32)
    heap.clear.py_func(keys, place)
    size, known = 0, {}
    for _ in range(2000):
        item, key = int(rng.integers(count)), float(rng.integers(-10, 40))  # many are equal
        size = heap.update.py_func(keys, items, place, size, item, key)
        known[item] = key
        known = {each: nats for each, nats in known.items() if nats > 0}
        assert size == len(known)
        assert {each: keys[place[each]] for each in known} == known
        assert (place >= 0).sum() == size
        assert (items[place[place >= 0]] == np.flatnonzero(place >= 0)).all()
        assert keys[0] == max(known.values(), default=-np.inf)
        assert (keys[size:] == -np.inf).all()
