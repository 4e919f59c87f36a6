"""Loops over segments that do not touch: which of them are one plane, seen through gaps."""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import COUNT, MISFIT, SEGMENT
from planewise.kernels.forms import W, compare_forms, compare_parallel, write_form
from planewise.kernels.jit import compiled, internal


@internal
def _saved(segments, forms, home, slope_prior, gap_offset, naming, i, j):  # type: ignore[no-untyped-def]
    """Nats saved by making two segments that do not touch one plane, seen from the smaller one.

    It has to be more likely than two that have nothing to do with each other, and than two that are
    parallel: shelves, or the fronts of two cupboards. To say which other segment it is costs
    `naming` nats, but so does to which it is parallel. Returns the discord, too.
    """
    small = i if segments[0, i, COUNT] < segments[0, j, COUNT] else j
    here = forms[home[small]]
    offset = gap_offset * gap_offset * here[small, W] * here[small, W]
    discord, evidence = compare_forms(here[i], here[j], offset, slope_prior[small])
    parallel = compare_parallel(here[small], here[i + j - small], gap_offset)
    return min(evidence - 0.5 * discord - naming, parallel), discord


@compiled
def join_through_gaps(segments, forms, home, drift, slope_prior, gap_offset, owner):  # type: ignore[no-untyped-def]
    """Join segments of one plane that do not touch, what saves most first.

    segments (K, ., 13), forms (K, ., 13): in the coordinates of every sector; home (.): sector of
    each; gap_offset: of its depth, where an unrelated plane seen through a gap may lie. segments,
    forms and home are changed in place. Writes owner (n,): the segment that each of the first n
    becomes part of.
    """
    sectors, n = segments.shape[0], owner.size
    naming = np.log(n)  # nats to say which other segment it is
    gain, discord = np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        owner[i] = i
        for j in range(n):
            gain[i, j] = -np.inf
    changed = -1  # at first, all are compared with all
    while True:
        for one in range(n if changed < 0 else 1):
            i = max(one, changed)
            for k in range(0 if changed >= 0 else i + 1, n):
                if owner[k] == k and k != i:
                    a, b = min(i, k), max(i, k)
                    gain[a, b], discord[a, b] = _saved(
                        segments, forms, home, slope_prior, gap_offset, naming, a, b
                    )
        best, i, j = 0.0, 0, 0
        for a in range(n):
            for b in range(a + 1, n):
                if gain[a, b] > best:
                    best, i, j = gain[a, b], a, b
        if best <= 0.0:
            break
        if segments[0, i, COUNT] < segments[0, j, COUNT]:
            home[i] = home[j]
        for sector in range(sectors):
            segments[sector, i, MISFIT] += discord[i, j]
            for e in range(SEGMENT):
                segments[sector, i, e] += segments[sector, j, e]
            write_form(segments[sector, i], drift[i], 0.0, forms[sector, i])
        for k in range(n):
            gain[j, k] = gain[k, j] = -np.inf
            if owner[k] == j:
                owner[k] = i
        changed = i


@compiled
def find_planes(segments, forms, home, slope_prior, gap_offset, owner, plane, first):  # type: ignore[no-untyped-def]
    """Plane that each segment is part of which is on none yet.

    As `join_through_gaps`, which wrote owner (n,): planes are those of the first n segments that
    own themselves. What is joined changes neither the planes nor what else joins them. Writes plane
    (m,): the one that saves most for each of the other m segments, -1 where none saves anything;
    and first (n,): the segment that is each plane. There and in owner, which becomes the plane of
    each, they are numbered. Returns how many there are.
    """
    n, planes = owner.size, 0
    for i in range(n):
        if owner[i] == i:
            first[planes] = i
            planes += 1
    naming = np.log(planes)
    for k in range(plane.size):
        plane[k] = -1
        most = 0.0
        for j in range(planes):
            gain, _ = _saved(
                segments, forms, home, slope_prior, gap_offset, naming, first[j], n + k
            )
            if gain > most:
                most, plane[k] = gain, j
    for j in range(planes):
        for i in range(first[j] + 1, n):
            if owner[i] == first[j]:
                owner[i] = j
        owner[first[j]] = j
    return planes
