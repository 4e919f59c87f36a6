"""The code of the labels of clouds of thick sheets, against one written out cube by cube."""

import math
from itertools import pairwise

import numpy as np
import pytest

from planewise.kernels import cloud_masks as kernels
from planewise.kernels.cloud_rows import COUNT, ROW
from planewise.kernels.cubes import cubes_about

BEFORE = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
N = 4


def key(place):
    return sum(
        ((int(e) >> bit) & 1) << (3 * bit + k) for k, e in enumerate(place) for bit in (0, 1, 2)
    )


@pytest.fixture(scope="module")
def made():
    """Cubes of a grid of 5^3, the labels in them, and points of each."""
    rng = np.random.default_rng(0)
    grid = np.array(np.unravel_index(rng.choice(125, 80, replace=False), (5, 5, 5))).T
    keys = np.array([key(place) for place in grid], np.uint64)
    order = np.argsort(keys)
    grid, keys = grid[order], keys[order]
    sets = [sorted(rng.choice(N + 1, rng.integers(1, 4), replace=False)) for _ in grid]
    for cube in range(0, 80, 2):  # half of them alike
        sets[cube] = [1]
    label = np.concatenate(sets).astype(np.int64)
    places = np.concatenate(([0], np.cumsum([len(each) for each in sets])))
    rows = np.zeros((len(label), ROW))
    rows[:, COUNT] = rng.integers(1, 30, len(label))
    about = np.empty((80, 27), np.int32)
    cubes_about(keys, 0, 80, about)
    return grid, keys, label, places, rows, about


def visible(labels, place, n):
    """Labels as places, if only the first n planes are there."""
    return {int(place[j]) if place[j] <= n else 0 for j in labels}


def sets_coded(made, place, n):
    """Nats of the sets, counts learned on the way."""
    grid, _, label, places, _, _ = made
    sets = [visible(label[first:last], place, n) for first, last in pairwise(places)]
    at = {tuple(where): own for where, own in zip(grid, sets, strict=True)}
    seen, nats = {}, 0.0

    def say(context, symbol):
        nonlocal nats
        counts = seen.setdefault(context, [0.5, 0.5])
        nats -= math.log(counts[symbol] / sum(counts))
        counts[symbol] += 1

    for where, own in zip(grid, sets, strict=True):
        near = [at.get(tuple(np.subtract(where, step))) for step in BEFORE]
        near = [other for other in near if other is not None]
        known = set().union(*near)
        for each in sorted(known):
            say(("have", len(near), sum(each in other for other in near)), each in own)
        new = sorted(own - known)
        for k, each in enumerate(new):
            if k or own & known:  # a cube is never empty
                say("more", True)
            say("kind", each == 0)
            nats += math.log(n) if each else 0.0
        say("more", False)
    return nats


@pytest.mark.parametrize("place", [[0, 1, 2, 3, 4], [0, 3, 1, 4, 2]])
def test_sets_are_coded_in_order_for_every_number_of_planes(made, place):
    _, _, label, places, _, about = made
    place = np.array(place)
    changes, lengths = np.zeros((N + 1, kernels.CODES), np.int64), np.empty(N + 1)
    for part in ((0, 30), (30, 80)):
        kernels.count_sets(label, places, about, *part, place, changes)
    kernels.set_lengths(changes, lengths)
    for n in range(N + 1):
        assert lengths[n] == pytest.approx(sets_coded(made, place, n), rel=1e-9)


def choose(n, k):
    return math.log(math.comb(int(n), int(k)))


def lines(n):
    return math.log(n * (n - 1) / 2 + 1)


def names_of(labels, counts, place, n):
    """Nats to tell apart the points of a cube if only the first n planes are there."""
    there = [c for j, c in zip(labels, counts, strict=True) if 0 < place[j] <= n]
    points, none = sum(there), sum(counts) - sum(there)
    if not there:
        return 0.0
    nats = (len(there) - 1) * lines(points)
    if none:
        total = points + none
        nats += min(math.log(total - 1) + choose(total, none), lines(total))
    return nats


def test_names_with_all_planes_and_as_they_go(made):
    _, _, label, places, rows, _ = made
    place = np.array([0, 3, 1, 4, 2])
    names, left = np.empty(80), np.empty(len(label))
    for part in ((0, 50), (50, 80)):
        kernels.name_points(rows, label, places, place, *part, names, left)
    drawn = 0
    for cube, (first, last) in enumerate(pairwise(places)):
        mine = label[first:last], rows[first:last, COUNT]
        nats = [names_of(*mine, place, n) for n in range(N + 1)]
        assert names[cube] == pytest.approx(nats[N], rel=1e-9, abs=1e-9)
        gone = {place[j]: left[first + k] for k, j in enumerate(mine[0]) if j}
        for n in range(N):
            more = sum(nat for rank, nat in gone.items() if rank > n)
            assert names[cube] + more == pytest.approx(nats[n], rel=1e-9, abs=1e-9)
        drawn += len(mine[0]) > 1 and 0 in mine[0]
    assert drawn > 5
