"""Loops over points: each one's plane, of those that its surroundings are on, and what that makes.

Points are in the order of their keys, relative to the middle of their least cube; labels are 0 for
none and j for row j - 1 of the planes, (normal, distance) relative to the centre of the cloud.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cloud_keys import middle_of
from planewise.kernels.cloud_rows import (
    COUNT,
    CX,
    CY,
    CZ,
    NX,
    NY,
    NZ,
    ROW,
    WEIGHT,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
)
from planewise.kernels.cubes import beside
from planewise.kernels.jit import compiled, in_order, internal

MOST = 12  # planes that the points of a cube may be on
_ROUNDS = 2  # in which shares follow the labels
_ALPHA = 0.5  # added to every count of points
_LEVELS = 3  # at which the surroundings of a cube are looked at, until there is a plane


@internal
def _cheapest(point, plane, none, null, nats):  # type: ignore[no-untyped-def]
    """Slot of the fewest nats, `none` for no plane, besides those of the slots themselves."""
    x, y, z = point[0], point[1], point[2]
    least, best = null + nats[none], np.int64(none)
    for slot in range(none):
        delta = plane[slot, 0] * x + plane[slot, 1] * y + plane[slot, 2] * z + plane[slot, 3]
        cost = delta * delta * plane[slot, 4] + plane[slot, 5] + nats[slot]
        if cost < least:
            least, best = cost, np.int64(slot)
    return best


@internal
def _eighth(point, turn):  # type: ignore[no-untyped-def]
    """Number of the eighth of its cube that a point lies in."""
    number = 0
    for axis in range(3):
        along = turn[axis, 0] * point[0] + turn[axis, 1] * point[1] + turn[axis, 2] * point[2]
        number = 2 * number + (along > 0.0)
    return number


@internal
def _over_cell(cells, cell, planes, j, x, y, z):  # type: ignore[no-untyped-def]
    """How far a place lies over the plane of a cell, the side being that of planes[j]."""
    nx, ny, nz = cells[cell, NX], cells[cell, NY], cells[cell, NZ]
    over = nx * (x - cells[cell, CX]) + ny * (y - cells[cell, CY]) + nz * (z - cells[cell, CZ])
    alike = nx * planes[j, 0] + ny * planes[j, 1] + nz * planes[j, 2] > 0.0
    return over if alike else -over


@compiled
def label_points(  # type: ignore[no-untyped-def]
    local, starts, cubes, side, middle, turn, about, label_of, cells, owner, follow, variance,
    extra, planes, null, resolution, thick, first, last, labels,
):  # fmt: skip
    """Label the points of cubes[first:last].

    local (k, 3): of points; starts (n + 1,), cubes (n,): where cubes begin, and their keys; side,
    middle: of their grid (`middle_of`); about (n, 27): `cubes_about`; label_of (n,): of the cell
    that each is part of, owner (n,), of cells (m, 18); follow (N + 1,): by how much of the height
    of its cells over it, in the cube and about it, each plane is moved to them; variance (n,): of
    the points of cubes; extra (N + 1,): what a point of each plane errs more; planes (N, 4); null:
    nats of a point on none; thick: variance of points whose sheets are about as thick as cubes.

    A point costs what its residual says, less the logarithm of the share that the label has of the
    points in the cube and the 26 about it. Where sheets are thick they would so be a mix of labels
    where they meet, and the mask would pay for every point of it. There points are looked at again
    if their cube has several labels, the shares of planes being those of the other points in their
    eighth of the cube, and of one point more with the shares of before.
    """
    near, there = np.empty(27, np.int32), np.empty(28, np.int64)
    found, share = np.empty(MOST, np.int64), np.empty(MOST + 1)
    plane, held = np.empty((MOST, 6)), np.empty((8, MOST + 1))
    nats, over_cells = np.empty(MOST + 1), np.empty(MOST)
    most = 0
    for cube in range(first, last):
        most = max(most, starts[cube + 1] - starts[cube])
    eighth_of, slot_of = np.empty(most, np.int64), np.empty(most, np.int64)
    for cube in range(first, last):
        count = 0
        x0, y0, z0 = middle_of(cubes[cube], side, middle, turn)
        for level in range(_LEVELS):
            none = _ALPHA
            if level > 0:
                beside(cubes, cubes[cube] >> np.uint64(3 * level), level, cube, near)
            size = 0  # of what there is, listed without a branch that nobody could foresee
            for direction in range(27):
                other = near[direction] if level > 0 else about[cube, direction]
                there[size] = other if direction != 13 else cube
                size += other >= 0
            for k in range(size):
                other = there[k]
                points = float(starts[other + 1] - starts[other])
                label = label_of[other]
                if label == 0:
                    none += points
                    continue
                slot = 0
                while slot < count and found[slot] != label:
                    slot += 1
                if slot == count:
                    if count == MOST:
                        continue
                    found[slot], share[slot], over_cells[slot] = label, _ALPHA, 0.0
                    count += 1
                share[slot] += points
                if follow[label] > 0.0:
                    over = _over_cell(cells, owner[other], planes, label - 1, x0, y0, z0)
                    over_cells[slot] += points * over
            if count > 0:
                break
        if count == 0:
            for i in range(starts[cube], starts[cube + 1]):
                labels[i] = 0
            continue
        share[count], total = none, none
        for slot in range(count):
            total += share[slot]
            j = found[slot] - 1
            a, b, c = planes[j, 0], planes[j, 1], planes[j, 2]
            spread = variance[cube] + extra[j + 1]
            plane[slot, 0], plane[slot, 1], plane[slot, 2] = a, b, c
            over, moved = a * x0 + b * y0 + c * z0 + planes[j, 3], follow[j + 1]
            if moved > 0.0:
                over += moved * (over_cells[slot] / (share[slot] - _ALPHA) - over)
            plane[slot, 3] = over
            plane[slot, 4] = 0.5 / spread
            # -ln of the density at the plane, a cell of the resolution.
            plane[slot, 5] = 0.5 * math.log(2.0 * math.pi * spread / (resolution * resolution))
        for slot in range(count + 1):
            share[slot] /= total
            nats[slot] = -math.log(share[slot])
        begin, end = starts[cube], starts[cube + 1]
        mixed = False
        for i in range(begin, end):
            slot_of[i - begin] = _cheapest(local[i], plane, count, null, nats)
            mixed |= slot_of[i - begin] != slot_of[0]
        if mixed and variance[cube] > thick:
            for i in range(begin, end):
                eighth_of[i - begin] = _eighth(local[i], turn)
            for _ in range(_ROUNDS):
                held[:, : count + 1] = 0.0
                for i in range(begin, end):
                    held[eighth_of[i - begin], slot_of[i - begin]] += 1.0
                for i in range(begin, end):
                    others, mine = held[eighth_of[i - begin]], slot_of[i - begin]
                    on_any = 1.0 - share[count]
                    total = on_any
                    for slot in range(count):
                        total += others[slot] - (slot == mine)
                    for slot in range(count):
                        drawn = (others[slot] - (slot == mine) + share[slot]) / total
                        nats[slot] = -math.log(on_any * drawn)
                    slot_of[i - begin] = _cheapest(local[i], plane, count, null, nats)
        for i in range(begin, end):
            labels[i] = found[slot_of[i - begin]] if slot_of[i - begin] < count else 0


@in_order
def count_lost(labels, starts, label_of, first, last, points):  # type: ignore[no-untyped-def]
    """Add up how many points the cells of every plane have, and how many of them are on others.

    label_of (n,): of the cell that each of the cubes is part of; points (N + 1, 2).
    """
    for cube in range(first, last):
        mine = label_of[cube]
        if mine == 0:
            continue
        points[mine, 0] += starts[cube + 1] - starts[cube]
        for i in range(starts[cube], starts[cube + 1]):
            points[mine, 1] += labels[i] != 0 and labels[i] != mine


@in_order
def count_groups(labels, starts, first, last, counts):  # type: ignore[no-untyped-def]
    """Labels that the points of each of cubes[first:last] have."""
    for cube in range(first, last):
        counts[cube] = 0
        for i in range(starts[cube], starts[cube + 1]):
            new = 1
            for j in range(i - 1, starts[cube] - 1, -1):
                if labels[j] == labels[i]:
                    new = 0
                    break
            counts[cube] += new


@compiled
def sum_groups(  # type: ignore[no-untyped-def]
    local, labels, starts, cubes, side, middle, turn, variance, places, first, last, groups,
    label_of,
):  # fmt: skip
    """Moments of the points of one label in one cube.

    places (n + 1,): where the groups of each cube begin. Writes groups (m, 18), their weights the
    points over the variance, and label_of (m,).
    """
    for cube in range(first, last):
        x0, y0, z0 = middle_of(cubes[cube], side, middle, turn)
        begin, end = places[cube], places[cube]
        for i in range(starts[cube], starts[cube + 1]):
            group = begin
            while group < end and label_of[group] != labels[i]:
                group += 1
            if group == end:
                label_of[group] = labels[i]
                for e in range(ROW):
                    groups[group, e] = 0.0
                end += 1
            out = groups[group]
            # Products of single precision are off by more than exact readings are from a plane.
            x, y, z = np.float64(local[i, 0]), np.float64(local[i, 1]), np.float64(local[i, 2])
            out[COUNT] += 1.0
            out[CX] += x
            out[CY] += y
            out[CZ] += z
            out[XX] += x * x
            out[XY] += x * y
            out[XZ] += x * z
            out[YY] += y * y
            out[YZ] += y * z
            out[ZZ] += z * z
        for group in range(begin, end):
            out = groups[group]
            count, weight = out[COUNT], 1.0 / variance[cube]
            sx, sy, sz = out[CX], out[CY], out[CZ]
            cx, cy, cz = sx / count, sy / count, sz / count
            out[XX] = (out[XX] - sx * cx) * weight
            out[XY] = (out[XY] - sx * cy) * weight
            out[XZ] = (out[XZ] - sx * cz) * weight
            out[YY] = (out[YY] - sy * cy) * weight
            out[YZ] = (out[YZ] - sy * cz) * weight
            out[ZZ] = (out[ZZ] - sz * cz) * weight
            out[CX], out[CY], out[CZ] = x0 + cx, y0 + cy, z0 + cz
            out[WEIGHT] = count * weight
