"""Loops that look at how flat the points of cubes are."""

from __future__ import annotations

import numpy as np

from planewise.kernels.cloud_rows import COUNT, CX, CY, CZ, NX, NY, NZ, ROW, write_normal
from planewise.kernels.jit import compiled

VARIANCE, FREEDOM, RANGE = 0, 1, 2


@compiled
def flat_cubes(nodes, origins, limits, out):  # type: ignore[no-untyped-def]
    """Variance of the points about the plane of every cube that tells one.

    nodes (n, 18), weights of 1; origins (0, 1 or n, 3): where the rays of their points begin;
    limits: fewest points; least ratio of the two variances in the plane, for points of one line of
    a scanner lie in a plane that is no surface; largest variance of a slope; least cos^2 between
    ray and normal. Writes out (n, 3): variance across the plane, along the rays where these are
    known; degrees of freedom; range of the middle. Returns how many there are.
    """
    fewest, wide, tilt, grazing = limits
    found = 0
    row = np.empty(ROW)
    for node in range(nodes.shape[0]):
        count = nodes[node, COUNT]
        if count < fewest:
            continue
        for e in range(ROW):
            row[e] = nodes[node, e]
        chi2, largest, middle = write_normal(row)
        variance = chi2 / (count - 3.0)
        if not middle > wide * largest or variance > tilt * middle:
            continue
        reach = 0.0
        if origins.shape[0] > 0:
            origin = origins[min(node, origins.shape[0] - 1)]
            x, y, z = row[CX] - origin[0], row[CY] - origin[1], row[CZ] - origin[2]
            across = x * row[NX] + y * row[NY] + z * row[NZ]
            square = x * x + y * y + z * z
            if not across * across > grazing * square:
                continue
            variance *= square / (across * across)
            reach = np.sqrt(square)
        out[found, VARIANCE], out[found, FREEDOM] = variance, count - 3.0
        out[found, RANGE] = reach
        found += 1
    return found
