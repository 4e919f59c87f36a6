"""Loops over points: each one's plane, of those that its surroundings are on, and what that makes.

Points are in the order of their keys, relative to the middle of their least cube; labels are 0 for
none and j for row j - 1 of the planes, (normal, distance) relative to the centre of the cloud.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cloud_cells import beside
from planewise.kernels.cloud_keys import LEVELS, gather
from planewise.kernels.cloud_rows import (
    COUNT,
    CX,
    CY,
    CZ,
    ROW,
    WEIGHT,
    XX,
    XY,
    XZ,
    YY,
    YZ,
    ZZ,
)
from planewise.kernels.jit import compiled, in_order, inlined

MOST = 12  # planes that the points of a cube may be on
_ALPHA = 0.5  # added to every count of points
_HIGHER = 3  # levels up to which the surroundings of a lonely cube are looked at


@inlined
def middle_of(key, shift, side, turn, out):  # type: ignore[no-untyped-def]
    """Write the middle of a cube, relative to the centre of the cloud; key: of its first point."""
    half, middle = 0.5 * (1 << (shift // 3)), float(1 << (LEVELS - 1))
    low = (key >> np.uint64(shift)) << np.uint64(shift)
    u = (gather(low) + half - middle) * side
    v = (gather(low >> np.uint64(1)) + half - middle) * side
    w = (gather(low >> np.uint64(2)) + half - middle) * side
    for e in range(3):
        out[e] = turn[0, e] * u + turn[1, e] * v + turn[2, e] * w


@compiled
def label_points(  # type: ignore[no-untyped-def]
    local, keys, starts, shift, side, turn, cubes, about, label_of, variance, extra, planes, null,
    resolution, first, last, labels,
):  # fmt: skip
    """Label the points of cubes[first:last].

    local (k, 3), keys (k,): of points; starts (n + 1,), cubes (n,): where cubes begin, and their
    keys; about (n, 27): `cubes_about`; label_of (n,): of the cell that each is part of; variance
    (n,): of their points; extra (N + 1,): what a point of each plane errs more; planes (N, 4);
    null: nats of a point on none.

    A point costs what its residual says, less the logarithm of the share that the label has of the
    points in the cube and the 26 about it.
    """
    wide, at = np.empty(27, np.int32), np.empty(3)
    found, offset = np.empty(MOST, np.int64), np.empty(MOST)
    share, scale, rest = np.empty(MOST), np.empty(MOST), np.empty(MOST)
    for cube in range(first, last):
        count, none = 0, _ALPHA
        for level in range(_HIGHER):
            near = about[cube]
            if level > 0:
                beside(cubes, cubes[cube] >> np.uint64(3 * level), level, cube, wide)
                near = wide
            for direction in range(27):
                other = near[direction]
                if other < 0:
                    continue
                if direction == 13:
                    other = cube
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
                    found[slot], share[slot] = label, _ALPHA
                    count += 1
                share[slot] += points
            if count > 0:
                break
        if count == 0:
            for i in range(starts[cube], starts[cube + 1]):
                labels[i] = 0
            continue
        middle_of(keys[starts[cube]], shift, side, turn, at)
        total = none
        for slot in range(count):
            total += share[slot]
        for slot in range(count):
            row = planes[found[slot] - 1]
            offset[slot] = row[0] * at[0] + row[1] * at[1] + row[2] * at[2] + row[3]
            spread = variance[cube] + extra[found[slot]]
            scale[slot] = 0.5 / spread
            rest[slot] = 0.5 * math.log(2.0 * math.pi * spread) - math.log(
                resolution * share[slot] / total
            )
        nothing = null - math.log(none / total)
        for i in range(starts[cube], starts[cube + 1]):
            x, y, z = local[i, 0], local[i, 1], local[i, 2]
            least, best = nothing, 0
            for slot in range(count):
                row = planes[found[slot] - 1]
                delta = row[0] * x + row[1] * y + row[2] * z + offset[slot]
                nats = delta * delta * scale[slot] + rest[slot]
                if nats < least:
                    least, best = nats, found[slot]
            labels[i] = best


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
    local, labels, keys, starts, shift, side, turn, variance, places, first, last, groups, label_of
):  # fmt: skip
    """Moments of the points of one label in one cube.

    places (n + 1,): where the groups of each cube begin. Writes groups (m, 18), their weights the
    points over the variance, and label_of (m,).
    """
    at = np.empty(3)
    for cube in range(first, last):
        middle_of(keys[starts[cube]], shift, side, turn, at)
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
            x, y, z = local[i, 0], local[i, 1], local[i, 2]
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
            out[CX], out[CY], out[CZ] = at[0] + cx, at[1] + cy, at[2] + cz
            out[WEIGHT] = count * weight
