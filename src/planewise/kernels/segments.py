"""Loops over segments: are two of them one plane, and merging neighbours while that saves nats.

A segment is a row as `kernels.cells` lays it out; joining segments is adding rows.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planewise.kernels.cells import (
    COUNT,
    MISFIT,
    PLANE_BEND,
    PLANE_OFFSET,
    SEGMENT,
    SIDE,
    UNIT,
)

_FAST = {"reassoc", "contract", "arcp", "nsz"}
_HALF = 0.5  # of the smaller extent: from its centroid towards the other, to where they meet
_TAILS = 4.0  # degrees of freedom of the error of one cell of 6 x 6 pixels
_CELL = 36.0
_TOUCHING = 0.75  # of their extents: centroids closer than that have no gap between them
_BEND_SMALL, _BEND_LARGE = PLANE_BEND
_compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)

# A segment as it is compared: its centroid, inverse depth and slopes there, their variances (the
# offset's is independent of the slopes' about the centroid), its extent (the root of its area) and
# one over it, and the root of its drift.
FORM = 12
_X, _Y, _W, _TX, _TY, _V, _VXX, _VXY, _VYY, _EXTENT, _INVERSE, _SLOW = range(FORM)


@_compiled
def write_form(s, drift, form):  # type: ignore[no-untyped-def]
    """Write the form of a segment row."""
    scale = 1.0 / s[0]
    cx, cy = s[1] * scale, s[2] * scale
    xx, xy, yy = s[3] - cx * s[1], s[4] - cx * s[2], s[5] - cy * s[2]
    qx, qy = s[7] - cx * s[6], s[8] - cy * s[6]
    scale_slopes = 1.0 / (xx * yy - xy * xy)
    vxx, vxy, vyy = yy * scale_slopes, -xy * scale_slopes, xx * scale_slopes
    form[_X], form[_Y], form[_W] = cx, cy, s[6] * scale
    form[_TX], form[_TY] = vxx * qx + vxy * qy, vxy * qx + vyy * qy
    form[_V], form[_VXX], form[_VXY], form[_VYY] = scale, vxx, vxy, vyy
    extent = np.sqrt(s[COUNT]) / UNIT
    form[_EXTENT], form[_INVERSE], form[_SLOW] = extent, 1.0 / extent, np.sqrt(drift)


@_compiled
def write_forms(segments, drift, forms):  # type: ignore[no-untyped-def]
    """Write the forms (n, 12) of segment rows (n, 13)."""
    for k in range(segments.shape[0]):
        write_form(segments[k], drift[k], forms[k])


@_compiled
def _difference(a, b):  # type: ignore[no-untyped-def]
    """Difference of the planes of two forms where they meet, and its covariance C.

    They meet near the smaller one. C = P_a^-1 + P_b^-1 + Sigma_d, where Sigma_d is what an error
    that wanders like a random walk makes of the planes of two squares side by side, and of those
    farther apart by a gap (`frame_error`).
    """
    small, large = (b, a) if a[_EXTENT] > b[_EXTENT] else (a, b)
    extent, reach, drift = small[_EXTENT], large[_EXTENT], small[_SLOW] * large[_SLOW]
    # They meet s from the centroid of the small one, d from that of the other.
    dx, dy = small[_X] - large[_X], small[_Y] - large[_Y]
    apart = np.sqrt(dx * dx + dy * dy)
    share = _HALF * min(extent, apart) / (apart + 1e-12)
    sx, sy = -share * dx, -share * dy
    dx, dy = dx + sx, dy + sy
    d0 = small[_W] + sx * small[_TX] + sy * small[_TY]
    d0 -= large[_W] + dx * large[_TX] + dy * large[_TY]
    gap = max(apart - _TOUCHING * (extent + reach), 0.0)
    bend = drift * (_BEND_SMALL * small[_INVERSE] + _BEND_LARGE * large[_INVERSE])
    vxx, vxy, vyy = small[_VXX], small[_VXY], small[_VYY]
    uxx, uxy, uyy = large[_VXX], large[_VXY], large[_VYY]
    c00 = small[_V] + large[_V] + drift * (PLANE_OFFSET * reach + gap)
    c00 += dx * dx * uxx + 2.0 * dx * dy * uxy + dy * dy * uyy
    c00 += sx * sx * vxx + 2.0 * sx * sy * vxy + sy * sy * vyy
    c01 = dx * uxx + dy * uxy + sx * vxx + sy * vxy
    c02 = dx * uxy + dy * uyy + sx * vxy + sy * vyy
    c11, c12, c22 = vxx + uxx + bend, vxy + uxy, vyy + uyy + bend
    return d0, small[_TX] - large[_TX], small[_TY] - large[_TY], c00, c01, c02, c11, c12, c22


@_compiled
def _discord(a, b):  # type: ignore[no-untyped-def]
    """delta' C^-1 delta of two forms, and det C with C itself (`_difference`)."""
    x, y, z, c00, c01, c02, c11, c12, c22 = _difference(a, b)
    p, q, r = c11 * c22 - c12 * c12, c02 * c12 - c01 * c22, c01 * c12 - c02 * c11
    determinant = c00 * p + c01 * q + c02 * r
    s, t, u = c00 * c22 - c02 * c02, c01 * c02 - c00 * c12, c00 * c11 - c01 * c01
    form = p * x * x + s * y * y + u * z * z + 2.0 * (q * x * y + r * x * z + t * y * z)
    return form / determinant, determinant, c00, c01, c02, c11, c12, c22


@_compiled
def compare_forms(a, b, offset_prior, slope_prior):  # type: ignore[no-untyped-def]
    """Are two segments one plane? Their discord, and the evidence that it would be a coincidence.

    discord = delta' C^-1 delta with delta the difference of their planes where they meet.
    evidence = 1/2 ln det(C + S0) / det C, S0 the prior of a plane that has nothing to do with the
    other.
    """
    discord, near, c00, c01, c02, c11, c12, c22 = _discord(a, b)
    c00, c11, c22 = c00 + offset_prior, c11 + slope_prior, c22 + slope_prior
    far = c00 * (c11 * c22 - c12 * c12)
    far += c01 * (c02 * c12 - c01 * c22) + c02 * (c01 * c12 - c02 * c11)
    return discord, 0.5 * np.log(far / near)


@_compiled
def compare(a, b, drift, offset_prior, slope_prior):  # type: ignore[no-untyped-def]
    """`compare_forms` of two segment rows whose drift is the same."""
    forms = np.empty((2, FORM))
    write_form(a, drift, forms[0])
    write_form(b, drift, forms[1])
    return compare_forms(forms[0], forms[1], offset_prior, slope_prior)


@_compiled
def free_prices(forms, offset_prior, slope_prior, out):  # type: ignore[no-untyped-def]
    """1/2 ln det(C + S0) / det C: nats for a plane of its own in every unit of a smooth surface.

    C is what the unit would be compared with beside a plane of 100 x 100 pixels, whose own error is
    small beside the unit's.
    """
    for k in range(forms.shape[0]):
        form = forms[k]
        drift = form[_SLOW] * form[_SLOW]
        bend = _BEND_SMALL * drift * form[_INVERSE]
        vxx, vxy, vyy = form[_VXX] + bend, form[_VXY], form[_VYY] + bend
        near = vxx * vyy - vxy * vxy
        far = (vxx + slope_prior[k]) * (vyy + slope_prior[k]) - vxy * vxy
        level = form[_V] + PLANE_OFFSET * drift
        out[k] = 0.5 * np.log((1.0 + offset_prior[k] / level) * far / near)


@_compiled
def border_price(discord, price):  # type: ignore[no-untyped-def]
    """Nats of a side of a cell: SIDE pixels of low + (high - low) / (1 + (discord / knee)^2).

    price: (low, high, knee). Of low alone where there is no discord (-1).
    """
    low, high, knee = price
    if discord < 0.0:
        return SIDE * low
    return SIDE * (low + (high - low) / (1.0 + (discord / knee) ** 2))


@_compiled
def border_discords(unit, segment, forms, out):  # type: ignore[no-untyped-def]
    """Discord across every side shared by two units: out[0] to the right, out[1] below; else -1.

    unit (rows, columns): of every cell, or -1; sides within a segment (units,) are left out. forms
    of the units; out (2, rows, columns). Returns how many sides are not -1.
    """
    rows, columns = unit.shape
    found = 0
    for i in range(rows):
        for j in range(columns):
            u = unit[i, j]
            for k in range(2):
                out[k, i, j] = -1.0
                row, column = i + k, j + 1 - k
                if u < 0 or row >= rows or column >= columns:
                    continue
                v = unit[row, column]
                if v < 0 or segment[v] == segment[u]:
                    continue
                found += 1
                # Units of 2 x 2 cells share two sides.
                if k == 0 and i > 0 and unit[i - 1, j] == u and unit[i - 1, column] == v:
                    out[k, i, j] = out[k, i - 1, j]
                elif k == 1 and j > 0 and unit[i, j - 1] == u and unit[row, j - 1] == v:
                    out[k, i, j] = out[k, i, j - 1]
                else:
                    out[k, i, j] = _discord(forms[u], forms[v])[0]
    return found


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
def _merge_gain(segments, forms, u, v, boundary, offset_prior, slope_prior, most):  # type: ignore[no-untyped-def]
    """Nats saved by joining two segments: evidence, at most a plane's parameters, and boundary.

    Returns the misfit of the join, too, of which half counts.
    """
    small = u if segments[u, COUNT] < segments[v, COUNT] else v
    discord, evidence = compare_forms(forms[u], forms[v], offset_prior[small], slope_prior[small])
    misfit = _tempered(discord, segments[small, COUNT])
    return min(evidence, most) - 0.5 * misfit + boundary, misfit


@_compiled
def _join(segments, forms, drift, u, v, misfit):  # type: ignore[no-untyped-def]
    """Make segment v part of segment u."""
    share = segments[v, COUNT] / (segments[u, COUNT] + segments[v, COUNT])
    drift[u] += share * (drift[v] - drift[u])
    for e in range(SEGMENT):
        segments[u, e] += segments[v, e]
    segments[u, MISFIT] += misfit
    write_form(segments[u], drift[u], forms[u])


@_compiled
def join_blocks(unit, whole, segments, forms, drift, limit, levels, root):  # type: ignore[no-untyped-def]
    """Join 2 x 2 squares of cells that are clearly one plane, and again 2 x 2 of those.

    unit (rows, columns): segment of every cell, or -1; whole (n,): those of 2 x 2 cells, which the
    first level joins. The squares are joined where no discord (left and right, then upper and lower
    half) is above `limit`. segments, forms and drift are changed in place; root (n,): the segment
    that each is part of, the upper left one of its square.
    """
    level = np.zeros(root.size, np.int8)
    for k in range(root.size):
        root[k] = k
        level[k] = 1 if whole[k] else 0
    halves, shape = np.empty((2, SEGMENT)), np.empty((2, FORM))
    side = 2
    for step in range(1, levels + 1):
        for i in range(0, unit.shape[0] - side, 2 * side):
            for j in range(0, unit.shape[1] - side, 2 * side):
                a, b = unit[i, j], unit[i, j + side]
                c, d = unit[i + side, j], unit[i + side, j + side]
                if min(a, b, c, d) < 0:
                    continue
                if level[a] != step or level[b] != step or level[c] != step or level[d] != step:
                    continue
                upper, lower = _discord(forms[a], forms[b])[0], _discord(forms[c], forms[d])[0]
                if upper > limit or lower > limit:
                    continue
                for e in range(SEGMENT):
                    halves[0, e] = segments[a, e] + segments[b, e]
                    halves[1, e] = segments[c, e] + segments[d, e]
                write_form(halves[0], 0.5 * (drift[a] + drift[b]), shape[0])
                write_form(halves[1], 0.5 * (drift[c] + drift[d]), shape[1])
                both = _discord(shape[0], shape[1])[0]
                if both > limit:
                    continue
                misfit = _tempered(both, halves[1, COUNT])
                misfit += _tempered(upper, segments[b, COUNT])
                misfit += _tempered(lower, segments[d, COUNT])
                _join(segments, forms, drift, c, d, 0.0)
                _join(segments, forms, drift, a, b, 0.0)
                _join(segments, forms, drift, a, c, misfit)
                root[b] = root[c] = root[d] = a
                level[a] = step + 1
        side *= 2
    for k in range(root.size):
        top = root[k]
        while root[top] != top:
            top = root[top]
        root[k] = top


@_compiled
def keep_roots(root, segments, forms, drift, offset_prior, slope_prior):  # type: ignore[no-untyped-def]
    """Move the rows of roots to the front, and say in root (n,) where. Returns how many."""
    found = 0
    place = np.empty(root.size, np.int32)
    for k in range(root.size):
        if root[k] == k:
            place[k] = found
            segments[found] = segments[k]
            forms[found] = forms[k]
            drift[found] = drift[k]
            offset_prior[found] = offset_prior[k]
            slope_prior[found] = slope_prior[k]
            found += 1
    for k in range(root.size):
        root[k] = place[root[k]]
    return found


def room(sides: int, segments: int) -> tuple[int, int]:
    """Sizes of the integers and floating-point numbers that `agglomerate` works in."""
    return 10 * sides + 16 + 5 * segments, 7 * sides + 16


@_compiled
def agglomerate(  # type: ignore[no-untyped-def]
    unit,
    discords,
    price,
    segments,
    forms,
    drift,
    offset_prior,
    slope_prior,
    most,
    root,
    ints,
    floats,
):
    """Merge neighbouring segments, what saves most first, while a merge saves anything.

    unit (rows, columns): segment of every cell, or -1; discords (2, rows, columns): across each
    side shared with the cell to the right and below, which `price` (`border_price`) turns into the
    nats that a merge saves there. segments, their forms and drift are changed in place: the row of
    a root holds its whole segment. Writes the root of every segment. ints, floats: room to work in,
    `room` of so many sides and segments.

    Gains are valued lazily: a popped edge whose segments have changed since is valued again; one
    whose gain has risen meanwhile comes up late. The edges of a segment are a linked list of
    half-edges, 2 e and 2 e + 1.
    """
    count = segments.shape[0]
    rows, columns = unit.shape
    most_edges = (ints.size - 5 * count - 16) // 10
    ends = ints[: 2 * most_edges].reshape((most_edges, 2))
    following = ints[2 * most_edges : 4 * most_edges]
    alive, valued = ints[4 * most_edges : 5 * most_edges], ints[5 * most_edges : 6 * most_edges]
    items = ints[6 * most_edges : 10 * most_edges + 16]
    head, tail, degree, seen, version = ints[10 * most_edges + 16 :].reshape((5, count))
    boundary, current = floats[:most_edges], floats[most_edges : 2 * most_edges]
    misfit, keys = floats[2 * most_edges : 3 * most_edges], floats[3 * most_edges :]
    head[:] = tail[:] = seen[:] = -1
    degree[:] = version[:] = 0
    edges = 0
    for i in range(rows):
        for j in range(columns):
            u = unit[i, j]
            for k in range(2):
                row, column = i + k, j + 1 - k
                if u >= 0 and row < rows and column < columns:
                    v = unit[row, column]
                    if v >= 0 and v != u:
                        ends[edges, 0], ends[edges, 1] = u, v
                        boundary[edges] = border_price(discords[k, i, j], price)
                        # Never valued: the versions of the ends are not negative.
                        alive[edges], valued[edges], current[edges] = 1, -1, 0.0
                        edges += 1
    following[: 2 * edges] = -1
    for half in range(2 * edges):
        u = ends[half >> 1, half & 1]
        if head[u] < 0:
            head[u] = half
        else:
            following[tail[u]] = half
        tail[u] = half
    for u in range(count):
        # Two units may share two sides: one edge is enough. seen: the edge to each neighbour.
        half = head[u]
        while half >= 0:
            edge = half >> 1
            other = ends[edge, 1 - (half & 1)]
            if alive[edge]:
                if seen[other] >= 0:
                    boundary[seen[other]] += boundary[edge]
                    alive[edge] = 0
                else:
                    seen[other] = edge
            half = following[half]
        half = head[u]
        while half >= 0:
            seen[ends[half >> 1, 1 - (half & 1)]] = -1
            half = following[half]

    # valued: versions of both ends when an edge was last valued; current: its only valid key in the
    # heap; misfit: of the two segments then.
    for u in range(count):
        root[u] = u
    size = 0
    for edge in range(edges):
        if alive[edge]:
            u, v = ends[edge, 0], ends[edge, 1]
            degree[u] += 1
            degree[v] += 1
            valued[edge] = 0
            current[edge], misfit[edge] = _merge_gain(
                segments, forms, u, v, boundary[edge], offset_prior, slope_prior, most
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
            current[edge], misfit[edge] = _merge_gain(
                segments, forms, u, v, boundary[edge], offset_prior, slope_prior, most
            )
            if current[edge] > 0.0:
                size = _push(keys, items, size, current[edge], edge)
            continue
        if segments[u, COUNT] < segments[v, COUNT]:
            u, v = v, u
        _join(segments, forms, drift, u, v, misfit[edge])
        version[u] += version[v] + 1
        root[v] = u
        alive[edge] = 0
        degree[u] -= 1
        # The edges of v become u's; where both had one to the same neighbour they become one.
        half = head[v]
        while half >= 0:
            after, moved = following[half], half >> 1
            other = ends[moved, 1 - (half & 1)]
            if alive[moved]:
                # An edge between u and the neighbour is in both lists: look into the shorter one.
                walked, wanted = (other, u) if degree[other] < degree[u] else (u, other)
                kept = -1
                link, before = head[walked], -1
                while link >= 0 and kept < 0:
                    if not alive[link >> 1]:
                        if before < 0:
                            head[walked] = following[link]
                        else:
                            following[before] = following[link]
                        if tail[walked] == link:
                            tail[walked] = before
                    else:
                        before = link
                        if ends[link >> 1, 1 - (link & 1)] == wanted:
                            kept = link >> 1
                    link = following[link]
                if kept >= 0:
                    boundary[kept] += boundary[moved]
                    alive[moved] = 0
                    degree[other] -= 1
                    # Its gain has risen: it must come up before anything it may now beat.
                    valued[kept], current[kept] = -1, np.inf
                    size = _push(keys, items, size, np.inf, kept)
                else:
                    ends[moved, half & 1] = u
                    degree[u] += 1
                    following[half] = -1
                    if tail[u] < 0:
                        head[u] = half
                    else:
                        following[tail[u]] = half
                    tail[u] = half
            half = after
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


@_compiled
def segment_borders(of_cell, discords, price, border, ends, nats):  # type: ignore[no-untyped-def]
    """Nats of the borders of every segment: dear where the surface goes on, else cheap.

    of_cell (rows, columns): segment of every cell, or -1; price as `border_price` takes it. Writes
    border (n,): all sides of each; and for each side between two segments ends (., 2) and nats (.);
    returns how many of these there are.
    """
    rows, columns = of_cell.shape
    border[:] = 0.0
    found = 0
    for i in range(rows):
        for j in range(columns):
            u = of_cell[i, j]
            for k in range(2):
                row, column = i + k, j + 1 - k
                if row >= rows or column >= columns or of_cell[row, column] == u:
                    continue
                v, cost = of_cell[row, column], border_price(discords[k, i, j], price)
                if u >= 0:
                    border[u] += cost
                if v >= 0:
                    border[v] += cost
                if u >= 0 and v >= 0:
                    ends[found, 0], ends[found, 1], nats[found] = u, v, cost
                    found += 1
    return found


@_compiled
def accept(worth, ends, price, least, accepted):  # type: ignore[no-untyped-def]
    """Accept the segments that are worth more than `least` nats; a border is paid for once.

    worth (n,): with all borders paid for; what accepted neighbours pay is added to it. Every
    accepted segment makes its neighbours cheaper, so adding those that pay, until no more do, ends
    at the same ones in any order.
    """
    alone = worth.copy()
    for k in range(worth.size):
        accepted[k] = worth[k] > least
    more = True
    while more:
        worth[:] = alone
        for e in range(price.size):
            u, v = ends[e, 0], ends[e, 1]
            if accepted[v]:
                worth[u] += price[e]
            if accepted[u]:
                worth[v] += price[e]
        more = False
        for k in range(worth.size):
            if worth[k] > least and not accepted[k]:
                accepted[k] = more = True


@_compiled
def _saved(segments, forms, slope_prior, gap_offset, naming, i, j):  # type: ignore[no-untyped-def]
    """Nats saved by making two segments that do not touch one plane."""
    small = i if segments[i, COUNT] < segments[j, COUNT] else j
    offset = (gap_offset * forms[small, _W]) ** 2
    discord, evidence = compare_forms(forms[i], forms[j], offset, slope_prior[small])
    return evidence - 0.5 * discord - naming, discord


@_compiled
def join_through_gaps(segments, forms, drift, slope_prior, gap_offset, owner):  # type: ignore[no-untyped-def]
    """Join segments of one plane that do not touch, what saves most first.

    gap_offset: of its depth, where an unrelated plane seen through a gap may lie. segments and
    forms are changed in place; owner (n,): the segment that each becomes part of.
    """
    n = segments.shape[0]
    naming = np.log(n)  # nats to say which other segment it is
    gain, discord = np.full((n, n), -np.inf), np.zeros((n, n))
    for i in range(n):
        owner[i] = i
        for j in range(i + 1, n):
            gain[i, j], discord[i, j] = _saved(
                segments, forms, slope_prior, gap_offset, naming, i, j
            )
    while n > 1:
        best = np.argmax(gain)
        i, j = best // n, best % n
        if gain[i, j] <= 0.0:
            break
        segments[i, MISFIT] += discord[i, j]
        for e in range(SEGMENT):
            segments[i, e] += segments[j, e]
        write_form(segments[i], drift[i], forms[i])
        gain[j] = gain[:, j] = -np.inf
        for k in range(n):
            if owner[k] == j:
                owner[k] = i
        for k in range(n):
            if owner[k] == k and k != i:
                a, b = min(i, k), max(i, k)
                gain[a, b], discord[a, b] = _saved(
                    segments, forms, slope_prior, gap_offset, naming, a, b
                )
