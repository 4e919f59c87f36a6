"""Loops over segments that do not touch: which of them are one plane, seen through gaps."""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import COUNT, MISFIT, SEGMENT
from planewise.kernels.forms import W, compare_forms, compare_parallel, write_form
from planewise.kernels.jit import compiled, internal


@internal
def _saved(segments, forms, slope_prior, gap_offset, naming, i, j):  # type: ignore[no-untyped-def]
    """Nats saved by making two segments that do not touch one plane, seen from the smaller one.

    They are compared in the sector that faces it (`kernels.segments`). It has to be more likely
    than two that have nothing to do with each other, and than two that are parallel: shelves, or
    the fronts of two cupboards. To say which other segment it is costs `naming` nats, but so does
    to which it is parallel. Returns the discord, too.
    """
    small = i if segments[0, i, COUNT] < segments[0, j, COUNT] else j
    facing = np.intp(0)
    for k in range(1, segments.shape[0]):  # np.argmax takes a third of a second to compile
        if segments[k, small, 6] > segments[facing, small, 6]:
            facing = np.intp(k)
    here = forms[facing]
    offset = gap_offset * gap_offset * here[small, W] * here[small, W]
    discord, evidence = compare_forms(here[i], here[j], offset, slope_prior[small])
    saved = evidence - 0.5 * discord - naming
    if saved <= 0.0:  # as of most pairs
        return saved, discord
    parallel = compare_parallel(here[small], here[i + j - small], gap_offset)
    return min(saved, parallel), discord


@compiled
def join_through_gaps(segments, forms, drift, slope_prior, gap_offset, owner):  # type: ignore[no-untyped-def]
    """Join segments of one plane that do not touch, what saves most first.

    segments (K, ., 13), forms (K, ., 13): in the coordinates of every sector; gap_offset: of its
    depth, where an unrelated plane seen through a gap may lie. segments and forms are changed in
    place. Writes owner (n,): the segment that each of the first n becomes part of.
    """
    sectors, n = segments.shape[0], owner.size
    naming = np.log(n)  # nats to say which other segment it is
    # Of every segment the partner behind it that saves most, and their discord. Where that partner
    # has changed since, it is -1, and gain what it saved at most: looked for again if that is best.
    partner, gain, discord = np.empty(n, np.intp), np.empty(n), np.empty(n)
    for i in range(n):
        owner[i] = i
        partner[i], gain[i] = -1, 0.0
    first, last, start = 0, n, n  # these are compared with what is behind them, or at `start`
    while True:
        for i in range(first, last):
            for k in range(min(start, i + 1), n):
                if owner[k] == k and k != i:
                    a, b = min(i, k), max(i, k)
                    saved, differs = _saved(segments, forms, slope_prior, gap_offset, naming, a, b)
                    if saved > gain[a] or (saved == gain[a] and b <= partner[a]):
                        partner[a], gain[a], discord[a] = b, saved, differs
                    elif b == partner[a]:
                        partner[a] = -1
        best, i = 0.0, -1
        for a in range(n):
            if gain[a] > best:
                best, i = gain[a], a
        if i < 0:
            break
        first, last, start, j = i, i + 1, n, partner[i]
        gain[i], partner[i] = 0.0, -1
        if j < 0:
            continue
        for sector in range(sectors):
            segments[sector, i, MISFIT] += discord[i]
            for e in range(SEGMENT):
                segments[sector, i, e] += segments[sector, j, e]
            write_form(segments[sector, i], drift[i], 0.0, forms[sector, i])
        gain[j], start = 0.0, 0
        for k in range(n):
            if partner[k] == j:
                partner[k] = -1
            if owner[k] == j:
                owner[k] = i


@compiled
def find_planes(segments, forms, slope_prior, gap_offset, owner, plane, first):  # type: ignore[no-untyped-def]
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
            gain, _ = _saved(segments, forms, slope_prior, gap_offset, naming, first[j], n + k)
            if gain > most:
                most, plane[k] = gain, j
    for j in range(planes):
        for i in range(first[j] + 1, n):
            if owner[i] == first[j]:
                owner[i] = j
        owner[first[j]] = j
    return planes
