"""Loops over segments: are two of them one plane, and merging neighbours while that saves nats.

A segment is a row as `kernels.cells` lays it out; joining segments is adding rows.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planewise.kernels.cells import COUNT, MISFIT, PLANE_BEND, PLANE_OFFSET, UNIT

_FAST = {"reassoc", "contract", "arcp", "nsz"}
_HALF = 0.5  # of the smaller extent: from its centroid towards the other, to where they meet
_TAILS = 4.0  # degrees of freedom of the error of one cell of 6 x 6 pixels
_CELL = 36.0
_TOUCHING = 0.75  # of their extents: centroids closer than that have no gap between them
_BEND_SMALL, _BEND_LARGE = PLANE_BEND
_compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)


@_compiled
def _at_centroid(s):  # type: ignore[no-untyped-def]
    """Centroid of a segment, its plane there, and the covariance of its slopes."""
    cx, cy = s[1] / s[0], s[2] / s[0]
    xx, xy, yy = s[3] - cx * s[1], s[4] - cx * s[2], s[5] - cy * s[2]
    qx, qy = s[7] - cx * s[6], s[8] - cy * s[6]
    determinant = xx * yy - xy * xy
    vxx, vxy, vyy = yy / determinant, -xy / determinant, xx / determinant
    return cx, cy, s[6] / s[0], vxx * qx + vxy * qy, vxy * qx + vyy * qy, vxx, vxy, vyy


@_compiled
def _quadratic_form(a, b, c, d, e, f, x, y, z):  # type: ignore[no-untyped-def]
    """(x y z) M^-1 (x y z)' and det M of M = [[a b c] [b d e] [c e f]]."""
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * p + b * q + c * r
    s, t, u = a * f - c * c, b * c - a * e, a * d - b * b
    form = p * x * x + s * y * y + u * z * z + 2.0 * (q * x * y + r * x * z + t * y * z)
    return form / determinant, determinant


@_compiled
def compare(a, b, drift, offset_prior, slope_prior):  # type: ignore[no-untyped-def]
    """Are two segments one plane? Their discord, and the evidence that it would be a coincidence.

    discord = delta' C^-1 delta with delta the difference of their planes where they meet, near the
    smaller one, and C = P_a^-1 + P_b^-1 + Sigma_d. Sigma_d is what an error that wanders like a
    random walk makes of the planes of two squares side by side, and of those farther apart by a
    gap (`frame_error`). evidence = 1/2 ln det(C + S0) / det C, S0 the prior of a plane that has
    nothing to do with the other.
    """
    small, large = (b, a) if a[COUNT] > b[COUNT] else (a, b)
    x0, y0, w0, tx, ty, vxx, vxy, vyy = _at_centroid(small)
    x1, y1, w1, ux, uy, uxx, uxy, uyy = _at_centroid(large)
    extent, reach = np.sqrt(small[COUNT]) / UNIT, np.sqrt(large[COUNT]) / UNIT
    # They meet s from the centroid of the small one, d from that of the other.
    dx, dy = x0 - x1, y0 - y1
    apart = np.sqrt(dx * dx + dy * dy)
    share = _HALF * min(extent, apart) / (apart + 1e-12)
    sx, sy = -share * dx, -share * dy
    dx, dy = dx + sx, dy + sy
    d0 = w0 + sx * tx + sy * ty - (w1 + dx * ux + dy * uy)
    d1, d2 = tx - ux, ty - uy
    gap = max(apart - _TOUCHING * (extent + reach), 0.0)
    bend = drift * (_BEND_SMALL / extent + _BEND_LARGE / reach)
    c00 = 1.0 / small[0] + 1.0 / large[0] + drift * (PLANE_OFFSET * reach + gap)
    c00 += dx * dx * uxx + 2.0 * dx * dy * uxy + dy * dy * uyy
    c00 += sx * sx * vxx + 2.0 * sx * sy * vxy + sy * sy * vyy
    c01 = dx * uxx + dy * uxy + sx * vxx + sy * vxy
    c02 = dx * uxy + dy * uyy + sx * vxy + sy * vyy
    c11, c12, c22 = vxx + uxx + bend, vxy + uxy, vyy + uyy + bend
    discord, near = _quadratic_form(c00, c01, c02, c11, c12, c22, d0, d1, d2)
    c00, c11, c22 = c00 + offset_prior, c11 + slope_prior, c22 + slope_prior
    _, far = _quadratic_form(c00, c01, c02, c11, c12, c22, d0, d1, d2)
    return discord, 0.5 * np.log(far / near)


@_compiled
def free_prices(segments, drift, offset_prior, slope_prior, out):  # type: ignore[no-untyped-def]
    """1/2 ln det(C + S0) / det C: nats for a plane of its own in every unit of a smooth surface.

    C is what the unit would be compared with beside a plane of 100 x 100 pixels, whose own error is
    small beside the unit's.
    """
    for k in range(segments.shape[0]):
        _, _, _, _, _, vxx, vxy, vyy = _at_centroid(segments[k])
        bend = _BEND_SMALL * drift[k] / (np.sqrt(segments[k, COUNT]) / UNIT)
        vxx, vyy = vxx + bend, vyy + bend
        near = vxx * vyy - vxy * vxy
        far = (vxx + slope_prior[k]) * (vyy + slope_prior[k]) - vxy * vxy
        level = 1.0 / segments[k, 0] + PLANE_OFFSET * drift[k]
        out[k] = 0.5 * np.log(1.0 + offset_prior[k] / level) + 0.5 * np.log(far / near)


@_compiled
def border_discords(unit, rows, columns, segments, drift, out):  # type: ignore[no-untyped-def]
    """Discord across every side shared by two units: out[0] to the right, out[1] below; else -1."""
    out[:] = -1.0
    for i in range(rows):
        for j in range(columns):
            u = unit[i * columns + j]
            if u < 0:
                continue
            for k in range(2):
                row, column = i + k, j + 1 - k
                if row < rows and column < columns:
                    v = unit[row * columns + column]
                    if v >= 0 and v != u:
                        slow = np.sqrt(drift[u] * drift[v])
                        out[k, i, j] = compare(segments[u], segments[v], slow, 0.0, 0.0)[0]


@_compiled
def _push(keys, items, size, key, item):  # type: ignore[no-untyped-def]
    """Enter an item into a heap whose top is the largest key; returns the new size."""
    i = size
    while i > 0 and keys[(i - 1) >> 1] < key:
        keys[i], items[i] = keys[(i - 1) >> 1], items[(i - 1) >> 1]
        i = (i - 1) >> 1
    keys[i], items[i] = key, item
    return size + 1


@_compiled
def _pop(keys, items, size):  # type: ignore[no-untyped-def]
    """Take the top off a heap; returns the new size."""
    size -= 1
    key, item = keys[size], items[size]
    i = 0
    while 2 * i + 1 < size:
        child = 2 * i + 1
        if child + 1 < size and keys[child + 1] > keys[child]:
            child += 1
        if keys[child] <= key:
            break
        keys[i], items[i] = keys[child], items[child]
        i = child
    keys[i], items[i] = key, item
    return size


@_compiled
def _tempered(discord, count):  # type: ignore[no-untyped-def]
    """Discord with the tails of Student's t: (nu + 3) ln(1 + discord / nu), nu growing with pixels.

    The size of a cell's error is uncertain, so that a cell on a rounded edge costs little; an
    average over many cells is normal.
    """
    nu = _TAILS * max(1.0, count / _CELL)
    return (nu + 3.0) * np.log(1.0 + discord / nu)


@_compiled
def _merge_gain(segments, u, v, boundary, drift, offset_prior, slope_prior, most):  # type: ignore[no-untyped-def]
    """Nats saved by joining two segments: evidence, at most a plane's parameters, and boundary."""
    small = u if segments[u, COUNT] < segments[v, COUNT] else v
    slow = np.sqrt(drift[u] * drift[v])
    discord, evidence = compare(
        segments[u], segments[v], slow, offset_prior[small], slope_prior[small]
    )
    return min(evidence, most) - 0.5 * _tempered(discord, segments[small, COUNT]) + boundary


@_compiled
def agglomerate(unit, rows, columns, border, segments, drift, offset_prior, slope_prior, most):  # type: ignore[no-untyped-def]
    """Merge neighbouring segments, what saves most first, while a merge saves anything.

    border (2, rows, columns): nats of each side shared with the unit to the right and below.
    segments and drift are changed in place: the row of a root holds its whole segment. Returns the
    root of every unit.

    Gains are valued lazily: a popped edge whose segments have changed since is valued again; one
    whose gain has risen meanwhile comes up late. The edges of a segment are a linked list of
    half-edges, 2 e and 2 e + 1.
    """
    count = segments.shape[0]
    ends = np.empty((2 * rows * columns, 2), np.int32)
    boundary = np.empty(2 * rows * columns)
    head, tail = np.full(count, -1, np.int32), np.full(count, -1, np.int32)
    edges = 0
    for i in range(rows):
        for j in range(columns):
            u = unit[i * columns + j]
            for k in range(2):
                row, column = i + k, j + 1 - k
                if u >= 0 and row < rows and column < columns:
                    v = unit[row * columns + column]
                    if v >= 0 and v != u:
                        ends[edges, 0], ends[edges, 1] = u, v
                        boundary[edges] = border[k, i, j]
                        edges += 1
    following = np.full(2 * edges, -1, np.int32)
    for half in range(2 * edges):
        u = ends[half >> 1, half & 1]
        if head[u] < 0:
            head[u] = half
        else:
            following[tail[u]] = half
        tail[u] = half
    alive = np.ones(edges, np.bool_)
    seen = np.full(count, -1, np.int32)  # edge to each neighbour, while one segment is looked at
    for u in range(count):
        # Two units may share two sides: one edge is enough.
        half = head[u]
        while half >= 0:
            edge = half >> 1
            other = ends[edge, 1 - (half & 1)]
            if alive[edge]:
                if seen[other] >= 0:
                    boundary[seen[other]] += boundary[edge]
                    alive[edge] = False
                else:
                    seen[other] = edge
            half = following[half]
        half = head[u]
        while half >= 0:
            seen[ends[half >> 1, 1 - (half & 1)]] = -1
            half = following[half]

    root = np.arange(count).astype(np.int32)
    version = np.zeros(count, np.int64)
    valued = np.zeros(edges, np.int64)  # versions of both ends when an edge was last valued
    current = np.zeros(edges)  # its only valid key in the heap
    keys, items = np.empty(4 * edges + 16), np.empty(4 * edges + 16, np.int32)
    size = 0
    for edge in range(edges):
        if alive[edge]:
            u, v = ends[edge, 0], ends[edge, 1]
            current[edge] = _merge_gain(
                segments, u, v, boundary[edge], drift, offset_prior, slope_prior, most
            )
            if current[edge] > 0.0:
                size = _push(keys, items, size, current[edge], edge)
    while size > 0:
        key, edge = keys[0], items[0]
        size = _pop(keys, items, size)
        if not alive[edge] or key != current[edge]:
            continue
        u, v = ends[edge, 0], ends[edge, 1]
        if valued[edge] != version[u] + version[v]:
            valued[edge] = version[u] + version[v]
            current[edge] = _merge_gain(
                segments, u, v, boundary[edge], drift, offset_prior, slope_prior, most
            )
            if current[edge] > 0.0:
                size = _push(keys, items, size, current[edge], edge)
            continue
        if segments[u, COUNT] < segments[v, COUNT]:
            u, v = v, u
        slow = np.sqrt(drift[u] * drift[v])
        discord = compare(segments[u], segments[v], slow, 0.0, 0.0)[0]
        segments[u, MISFIT] += _tempered(discord, segments[v, COUNT])
        share = segments[v, COUNT] / (segments[u, COUNT] + segments[v, COUNT])
        drift[u] += share * (drift[v] - drift[u])
        segments[u] += segments[v]
        version[u] += version[v] + 1
        root[v] = u
        alive[edge] = False
        # The edges of v become u's; where both had one to the same neighbour they become one.
        half, before = head[u], -1
        while half >= 0:
            if alive[half >> 1]:
                seen[ends[half >> 1, 1 - (half & 1)]] = half >> 1
                before = half
            elif before < 0:
                head[u] = following[half]
            else:
                following[before] = following[half]
            half = following[half]
        tail[u] = before
        half = head[v]
        while half >= 0:
            after, moved = following[half], half >> 1
            other = ends[moved, 1 - (half & 1)]
            if alive[moved]:
                if seen[other] >= 0:
                    kept = seen[other]
                    boundary[kept] += boundary[moved]
                    alive[moved] = False
                    # Its gain has risen: it must come up before anything it may now beat.
                    valued[kept], current[kept] = -1, np.inf
                    size = _push(keys, items, size, np.inf, kept)
                else:
                    ends[moved, half & 1] = u
                    following[half] = -1
                    if tail[u] < 0:
                        head[u] = half
                    else:
                        following[tail[u]] = half
                    tail[u] = half
            half = after
        half = head[u]
        while half >= 0:
            seen[ends[half >> 1, 1 - (half & 1)]] = -1
            half = following[half]
        if size > 3 * edges:  # full of old copies
            size = 0
            for other_edge in range(edges):
                if alive[other_edge] and current[other_edge] > 0.0:
                    size = _push(keys, items, size, current[other_edge], other_edge)
    for u in range(count):
        top = root[u]
        while root[top] != top:
            top = root[top]
        root[u] = top
    return root
