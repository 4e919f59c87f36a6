"""Loops over the pixels of planes that may be two faces (`spatial.faces`).

label (H, W) uint16: 0 for no plane and where there is no reading; w, p, x, y, planes as in
`kernels.labels`. Pixels are places in the flattened image.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cells import add_reading, own_plane
from planewise.kernels.jit import called, compiled, inlined
from planewise.kernels.labels import CHUNK, NONE, WAITING
from planewise.kernels.masks import list_runs, room_for_runs
from planewise.kernels.splits import SUMS, halve, sum_side

_QUADRIC, _CUBIC = 2, 3  # degrees of polynomials
_TERMS = 10  # of a cubic
_BENT = 1.4  # times the misfit of a quadric: what that of the smaller face is at most
_OFF = 9.0  # squared residual in variances of a reading that is on neither of two planes
_ROUNDS = 3  # of leaving these out
_SINGULAR = 1e-9  # of its square: what is left of a term that the others make up


@compiled
def label_misfits(label, w, p, x, y, planes, every, most, out):  # type: ignore[no-untyped-def]
    """How far readings lie off the plane of their label: writes out (labels, 2).

    Sum of (w - plane)^2 p, each `most` at most, and readings; of every so many rows one counts.
    """
    out[:] = 0.0
    alike, line = x.shape[0] == 1, np.empty(label.shape[1], y.dtype)
    last, places = room_for_runs(line.size)
    for i in range(every // 2, label.shape[0], every):
        row, stop = label[i], 0
        line[:] = y[i, 0]
        for n in range(list_runs(row, last, places)):
            start, stop = stop, int(places[n]) + 1
            mine = row[start]
            if mine == 0:
                continue
            t0, t1, t2 = planes[mine, 0], planes[mine, 1], planes[mine, 2]
            v, weight, a = w[i, start:stop], p[i, start:stop], x[0 if alike else i, start:stop]
            b = line[start:stop] if alike else y[i, start:stop]
            square = 0.0
            for k in range(v.size):
                e = v[k] - t0 - t1 * a[k] - t2 * b[k]
                square += min(e * e * weight[k], most)
            out[mine, 0] += square
            out[mine, 1] += v.size


@compiled
def list_pixels(label, slot, first, stop, pixels):  # type: ignore[no-untyped-def]
    """List the pixels of some labels in raster order.

    slot (labels,): number of each that is listed, -1 of the others; first, stop (n,): where there
    is room for the pixels of each in pixels. Writes them, and where they end to stop. Returns
    whether there was room.
    """
    height, width = label.shape
    last, places = room_for_runs(width)
    room = np.empty(stop.size, np.int64)
    for s in range(stop.size):
        room[s], stop[s] = stop[s], first[s]
    for i in range(height):
        row, end = label[i], 0
        for n in range(list_runs(row, last, places)):
            start, end = end, int(places[n]) + 1
            s = slot[row[start]]
            if s >= 0:
                at = stop[s]
                if at + end - start > room[s]:
                    return False
                for j in range(start, end):
                    pixels[at + j - start] = i * width + j
                stop[s] = at + end - start
    return True


@inlined
def place_of(pixel, columns):  # type: ignore[no-untyped-def]
    """Row and column of a pixel; halves are safe from rounding, and whole numbers divide slowly."""
    i = np.intp((pixel + 0.5) / columns)
    return i, pixel - i * columns


@called
def smooth_misfit(points, degree):  # type: ignore[no-untyped-def]
    """chi^2 of the best polynomial of such a degree through points (n, 4) (`kernels.splits`).

    Its normal equations are sums of q a^i b^j and of q a^i b^j h over points (a, b, h, q).
    """
    size, extent = points.shape[0], 0.0
    for k in range(size):
        extent = max(extent, abs(points[k, 0]), abs(points[k, 1]))
    work, square = np.empty((5, size)), 0.0
    a, b, h, column, here = work[0], work[1], work[2], work[3], work[4]
    for k in range(size):
        a[k], b[k], h[k] = points[k, 0] / extent, points[k, 1] / extent, points[k, 2]
        column[k] = points[k, 3]
        square += column[k] * h[k] * h[k]
    of_powers = np.empty((2 * _CUBIC + 1, 2 * _CUBIC + 1))
    of_heights = np.empty((_CUBIC + 1, _CUBIC + 1))
    powers, terms = np.empty((_TERMS, 2), np.intp), 0
    for j in range(2 * degree + 1):
        for k in range(size):
            here[k] = column[k]
            column[k] *= b[k]
        for i in range(2 * degree + 1 - j):
            every = high = 0.0
            for k in range(size):
                every += here[k]
                high += here[k] * h[k]
                here[k] *= a[k]
            of_powers[i, j] = every
            if i + j <= degree:
                of_heights[i, j] = high
                powers[terms, 0], powers[terms, 1] = i, j
                terms += 1
    table, row = np.empty((_TERMS + 1, _TERMS + 1)), np.empty(_TERMS)
    for e in range(terms):
        i, j = powers[e, 0], powers[e, 1]
        table[e, terms] = of_heights[i, j]
        for f in range(e, terms):
            table[e, f] = of_powers[i + powers[f, 0], j + powers[f, 1]]
        row[e] = table[e, e]
    table[terms, terms] = square
    # Gauss: what is left of the last square once all terms are eliminated.
    for e in range(terms):
        if table[e, e] > _SINGULAR * row[e]:
            for f in range(e + 1, terms + 1):
                share = table[e, f] / table[e, e]
                for g in range(f, terms + 1):
                    table[f, g] -= share * table[e, g]
    return table[terms, terms]


@called
def _misfit(sums):  # type: ignore[no-untyped-def]
    """chi^2 of the best plane of sums (SUMS,)."""
    return own_plane(sums)[8]


@called
def _sum_up(sums, points, side):  # type: ignore[no-untyped-def]
    """Sums (3, SUMS) over the points (n, 4) of either side, and of both; n on the second."""
    few = 0
    for n in range(2):
        few = sum_side(points, side, np.bool_(n == 1), sums[n])
    for e in range(SUMS):
        sums[2, e] = sums[0, e] + sums[1, e]
    return few


@called
def _drop(sums, points, side, index):  # type: ignore[no-untyped-def]
    """Drop points that lie off the plane of their side; how many are left, in the same order."""
    left = 0
    ax, ay, ah, a1, a2, _, _, _, first = own_plane(sums[0])
    bx, by, bh, b1, b2, _, _, _, second = own_plane(sums[1])
    most = _OFF * max(1.0, (first + second) / side.size)
    for k in range(side.size):
        x, y, h, q = points[k, 0], points[k, 1], points[k, 2], points[k, 3]
        if side[k]:
            e = h - bh - b1 * (x - bx) - b2 * (y - by)
        else:
            e = h - ah - a1 * (x - ax) - a2 * (y - ay)
        if e * e * q < most:
            points[left, 0], points[left, 1], points[left, 2], points[left, 3] = x, y, h, q
            side[left], index[left] = side[k], index[k]
            left += 1
    return left


@called
def _is_narrow(sums, narrowest):  # type: ignore[no-untyped-def]
    """Whether points are less wide than that in the narrow direction, as if in a rectangle."""
    cx, cy = sums[1] / sums[0], sums[2] / sums[0]
    xx, xy, yy = (
        sums[3] / sums[0] - cx * cx,
        sums[4] / sums[0] - cx * cy,
        sums[5] / sums[0] - cy * cy,
    )
    narrow = 0.5 * (xx + yy - math.hypot(xx - yy, 2.0 * xy))
    return 12.0 * narrow < narrowest * narrowest


@called
def _list_side(points, side, chosen, here):  # type: ignore[no-untyped-def]
    """Write the points (n, 4) of one side to here (n, 4); returns how many there are."""
    count = 0
    for k in range(side.size):
        if side[k] == chosen:
            for e in range(4):
                here[count, e] = points[k, e]
            count += 1
    return count


@inlined
def _of_a_third(points, side, clear, fewest, many, here):  # type: ignore[no-untyped-def]
    """What a third plane saves in chi^2, on a part of either side; 0 if less than `clear`."""
    saved, sums = 0.0, np.empty((3, SUMS))
    half = np.empty(side.size, np.bool_)
    for n in range(2):
        count = _list_side(points, side, n == 1, here)
        if count >= 2 * fewest and halve(here[:count], fewest, many, half[:count]):
            _sum_up(sums, here[:count], half[:count])
            saved = max(saved, _misfit(sums[2]) - _misfit(sums[0]) - _misfit(sums[1]))
    return saved if saved >= clear else 0.0


@inlined
def _parted(  # type: ignore[no-untyped-def]
    points, index, side, sums, clear, worse, rough, fewest, narrowest, many
):
    """Part points (n, 4) as `two_faces` does; what is on neither plane is dropped.

    Writes points, index and side (n,), those that are left first, and sums (3, SUMS). Returns how
    many are left, how many of them on the second side, and what is saved in chi^2: 0 if they are
    not two faces.
    """
    count = side.size
    if not halve(points, fewest, many, side):
        return count, 0, 0.0
    few = _sum_up(sums, points, side)
    for _ in range(_ROUNDS):
        before, count = count, _drop(sums, points[:count], side[:count], index)
        if count == before:
            break
        few = _sum_up(sums, points[:count], side[:count])
    first, second = _misfit(sums[0]), _misfit(sums[1])
    both = first + second
    saved = _misfit(sums[2]) - both
    if min(few, count - few) < fewest or saved < clear or saved < (worse - 1.0) * both:
        return count, few, 0.0
    if first > rough * (count - few) or second > rough * few:
        return count, few, 0.0
    if _is_narrow(sums[0], narrowest) or _is_narrow(sums[1], narrowest):
        return count, few, 0.0
    here, small = np.empty((count, 4)), 2 * few <= count
    less = _list_side(points, side[:count], small, here)
    bent = _BENT * max(less, smooth_misfit(here[:less], np.intp(_QUADRIC)))
    if (second if small else first) > bent:
        return count, few, 0.0
    smooth = smooth_misfit(points[:count], np.intp(_CUBIC))
    if smooth <= both:
        both -= _of_a_third(points[:count], side[:count], clear, fewest, many, here)
    return count, few, saved if smooth > both else 0.0


@called
def _meet(planes, turn, straight):  # type: ignore[no-untyped-def]
    """Whether two planes meet in an edge, the cosine of whose angle is less than `straight`.

    turn (3, 3): from (t0, t1, t2) to space.
    """
    both = one = other = 0.0
    for i in range(3):
        a = turn[i, 0] * planes[0, 0] + turn[i, 1] * planes[0, 1] + turn[i, 2] * planes[0, 2]
        b = turn[i, 0] * planes[1, 0] + turn[i, 1] * planes[1, 1] + turn[i, 2] * planes[1, 2]
        both += a * b
        one += a * a
        other += b * b
    return both < straight * math.sqrt(one * other)


@compiled
def two_faces(  # type: ignore[no-untyped-def]
    pixels, w, p, x, y, white, clear, worse, rough, fewest, narrowest, many, most, turn, straight,
    by_face, planes, information,
):  # fmt: skip
    """Whether readings of pixels (n,) lie on two planes, on either side of a line.

    They meet in an edge (`_meet`). On each there are `fewest` of them, and none is narrower than
    `narrowest`; chi^2 of both is less by `clear`, and by a factor of `worse`, than that of one
    plane, and of either no more than `rough` times its readings, of the smaller one not much more
    than that of a quadric; that of both, or of three where one of both is two once more, is less
    than that of a polynomial of the third degree. What lies off the one by more than `most`
    variances, times the mean square, has no say, nor what is on neither of the two. many: as in
    `splits.halve`. Writes by_face (n,): pixels of the larger face and then of the smaller; planes
    (2, 3) of both, and information (2, 9), P and P t as rows of segments have them. Returns what
    they save in chi^2, 0 if there are no two, and how many are on the larger face.
    """
    size, width, alike = pixels.size, w.shape[1], x.shape[0] == 1
    points, tame = np.empty((size, 4)), np.empty((size, 4))
    sums, index = np.empty((3, SUMS)), np.empty(size, np.int32)
    side = np.empty(size, np.bool_)
    for k in range(size):
        i, j = place_of(pixels[k], width)
        points[k, 0], points[k, 1] = x[0 if alike else i, j], y[i, 0 if alike else j]
        points[k, 2], points[k, 3] = w[i, j], p[i, j] / white
        side[k] = False
    _sum_up(sums, points, side)
    cx, cy, mean, tx, ty, _, _, _, _ = own_plane(sums[0])
    square = capped = 0.0
    for k in range(size):
        points[k, 0] -= cx
        points[k, 1] -= cy
        points[k, 2] -= mean + tx * points[k, 0] + ty * points[k, 1]
        e = points[k, 2] * points[k, 2] * points[k, 3]
        square += e
        capped += min(e, most)
    if capped - size < clear:
        return 0.0, size
    limit, count = most * max(square / size, 1.0), 0
    for k in range(size):
        if points[k, 2] * points[k, 2] * points[k, 3] < limit:
            for e in range(4):
                tame[count, e] = points[k, e]
            index[count], side[count] = k, False
            count += 1
    _sum_up(sums, tame[:count], side[:count])
    if count < 2 * fewest or _misfit(sums[2]) - count < clear:
        return 0.0, size
    count, few, saved = _parted(
        tame[:count], index, side[:count], sums, clear, worse, rough, fewest, narrowest, many
    )
    if saved == 0.0:
        return 0.0, size
    chosen = 2 * few <= count  # the smaller face
    for n in range(2):
        s = sums[n if chosen else 1 - n]
        ax, ay, height, t1, t2, _, _, _, _ = own_plane(s)
        planes[n, 1], planes[n, 2] = tx + t1, ty + t2
        planes[n, 0] = mean - tx * cx - ty * cy + height - t1 * (ax + cx) - t2 * (ay + cy)
        out = information[n]
        out[0], out[1], out[2] = s[0], s[1] + cx * s[0], s[2] + cy * s[0]
        out[3] = s[3] + cx * (2 * s[1] + cx * s[0])
        out[4] = s[4] + cx * s[2] + cy * s[1] + cx * cy * s[0]
        out[5] = s[5] + cy * (2 * s[2] + cy * s[0])
        t = planes[n]
        out[6] = out[0] * t[0] + out[1] * t[1] + out[2] * t[2]
        out[7] = out[1] * t[0] + out[3] * t[1] + out[4] * t[2]
        out[8] = out[2] * t[0] + out[4] * t[1] + out[5] * t[2]
    if not _meet(planes, turn, straight):
        return 0.0, size
    second = np.empty(size, np.bool_)
    for k in range(size):
        a, b = points[k, 0] + cx, points[k, 1] + cy
        value = points[k, 2] + mean + tx * points[k, 0] + ty * points[k, 1]
        here = abs(value - planes[0, 0] - planes[0, 1] * a - planes[0, 2] * b)
        second[k] = abs(value - planes[1, 0] - planes[1, 1] * a - planes[1, 2] * b) < here
    for k in range(count):
        second[index[k]] = side[k] == chosen
    larger = 0
    for k in range(size):
        if not second[k]:
            by_face[larger] = pixels[k]
            larger += 1
    end = larger
    for k in range(size):
        if second[k]:
            by_face[end] = pixels[k]
            end += 1
    return saved, larger


@compiled
def wait_about(pixels, named, mine, label, state, busy, seen):  # type: ignore[no-untyped-def]
    """Write new labels of pixels, and let them wait for a look with what is about them.

    named (H, W): their labels, among others; mine (labels,): those of these pixels, and 0: what
    else is about them does not wait. label, state, busy and seen as in `kernels.labels`.
    """
    width = named.shape[1]
    for k in range(pixels.size):
        i, j = place_of(pixels[k], width)
        label[i + 1, j + 1] = named[i, j]
    for k in range(pixels.size):
        i, j = place_of(pixels[k], width)
        for r in range(i, i + 3):
            for c in range(j, j + 3):
                if label[r, c] != NONE and mine[label[r, c]]:
                    state[r, c] = WAITING
                    busy[r, c // CHUNK] = seen[r, c // CHUNK] = True


@compiled
def give_back(named, label, seen, mine, w, p, x, y, most):  # type: ignore[no-untyped-def]
    """Take labels back from pixels that had none and lie off the planes of the new ones.

    named (H, W): labels before; label, seen as in `kernels.labels`; mine (labels,): those that may
    be taken back, in which this remains written; most: chi^2 that a reading taken in adds to that
    of the label's best plane, on average, at most.
    """
    height, width = named.shape
    alike = x.shape[0] == 1
    sums, taken = np.empty((mine.size, 2, SUMS)), np.empty(mine.size)
    sums[:] = 0.0
    taken[:] = 0.0
    for i in range(height):
        for c in range(seen.shape[1]):
            if not seen[i + 1, c]:
                continue
            for j in range(max(c * CHUNK - 1, 0), min((c + 1) * CHUNK - 1, width)):
                number = label[i + 1, j + 1]
                if number > 0 and mine[number]:
                    new = 1 if named[i, j] == 0 else 0
                    taken[number] += new
                    a, b = x[0 if alike else i, j], y[i, 0 if alike else j]
                    add_reading(sums[number, new], p[i, j], a, b, w[i, j])
    some = False
    for number in range(mine.size):
        if taken[number] > 0.0:
            before = _misfit(sums[number, 0]) if sums[number, 0, 0] > 0.0 else 0.0
            for e in range(SUMS):
                sums[number, 1, e] += sums[number, 0, e]
            mine[number] = _misfit(sums[number, 1]) - before > most * taken[number]
            some |= mine[number]
        else:
            mine[number] = False
    if not some:
        return
    for i in range(height):
        for c in range(seen.shape[1]):
            if seen[i + 1, c]:
                for j in range(max(c * CHUNK - 1, 0), min((c + 1) * CHUNK - 1, width)):
                    number = label[i + 1, j + 1]
                    if number > 0 and mine[number] and named[i, j] == 0:
                        label[i + 1, j + 1] = 0
