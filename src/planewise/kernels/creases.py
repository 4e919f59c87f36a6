"""Loops over the borders between two planes: whether they meet, and where.

A border is a row (i, j, k): pixel (i, j) and the one to its right (k = 0) or below it (k = 1) are
on different planes. label (H, W): 0 for no plane. Planes, w, x, y and variances by depth are
those of `kernels.labels`. A line is a row (d0, d1, d2): d0 + d1 x + d2 y is the distance in pixels
to where planes a < b intersect, positive on a's side. crease (planes, planes): row of the line in
which two planes meet, -1 where they do not. Unsigned indices spare the check for negative ones.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.jit import compiled, inlined
from planewise.kernels.labels import CHUNK
from planewise.kernels.tables import reading_variance

BINS = 10  # places per pixel at which a crease may lie

_IN_PART = np.uint8(255)  # state of pixels that may change sides; others: which side was tried
_TRIED = 254  # sides that are told apart
_0, _1, _CHUNK = np.uintp(0), np.uintp(1), np.uintp(CHUNK)
_FEWEST = 8  # pixels of border between planes that meet
_MAJORITY = 0.4  # of them that must agree
_MOST = 8.0  # nats that a reading may say against a plane
_CLEAR = 4.0  # nats that a stray's own reading may say against changing sides


@compiled
def find_borders(label, seen, margin, borders):  # type: ignore[no-untyped-def]
    """List the borders between two planes in raster order; returns how many there are.

    label and seen are flattened images as `kernels.labels.label_pixels` has them, with a margin:
    rows of `margin` labels. There are borders only in chunks that were seen.
    """
    stride, chunks = np.uintp(margin), margin // CHUNK
    found = 0
    for i in range(label.size // margin - 1):
        start = np.uintp(i) * stride
        for chunk in range(chunks):
            if not seen[np.uintp(i * chunks + chunk)]:
                continue
            at, unlike = start + np.uintp(chunk) * _CHUNK, False
            for n in range(CHUNK):
                k = at + np.uintp(n)
                unlike |= (label[k] != label[k + _1]) | (label[k] != label[k + stride])
            if not unlike:
                continue
            for n in range(CHUNK):
                k = at + np.uintp(n)
                here, right, below = label[k], label[k + _1], label[k + stride]
                if here <= 0 or ((right == here) & (below == here)):
                    continue
                for down in range(2):
                    there = below if down == 1 else right
                    if there > 0 and there != here:
                        border = borders[found]
                        border[0], border[1] = i - 1, chunk * CHUNK + n - 1
                        border[2] = down
                        found += 1
    return found


@compiled
def find_creases(borders, label, planes, x, y, reach, unit, crease, lines):  # type: ignore[no-untyped-def]
    """Find pairs of planes that meet in the image, and the lines in which they do.

    On either side of their border, on a convex edge each side's plane is the nearer of the two, on
    a concave one the farther; where one surface passes in front of the other, neither. They are
    compared `reach` pixels from it, or at the farthest pixel within that has their label: a border
    is hardly farther from the line. unit: pixels per unit of x and y. Writes crease and lines;
    returns the number of lines.
    """
    height, width, most = np.uintp(label.shape[0]), np.uintp(label.shape[1]), np.uintp(reach)
    count, own = planes.shape[0], _1 if x.shape[0] > 1 else _0
    votes, touching = np.empty((2, count, count), np.int32)
    for a in range(count):
        for b in range(count):
            votes[a, b] = touching[a, b] = 0
    for n in range(borders.shape[0]):
        i, j, down = np.uintp(borders[n, 0]), np.uintp(borders[n, 1]), np.uintp(borders[n, 2])
        right = _1 - down
        row, column = i + down, j + right
        here, there = label[i, j], label[row, column]
        s, t = planes[here], planes[there]
        d0, d1, d2 = s[0] - t[0], s[1] - t[1], s[2] - t[2]
        back = min(most, i if down == _1 else j)
        while label[i - down * back, j - right * back] != here:
            back -= _1
        on = min(most, height - _1 - row if down == _1 else width - _1 - column)
        while label[row + down * on, column + right * on] != there:
            on -= _1
        # Differences of the two planes on this side and on the other.
        ia, ja = i - down * back, j - right * back
        ib, jb = row + down * on, column + right * on
        near = d0 + d1 * x[own * ia, ja] + d2 * y[ia, own * ja]
        far = -d0 - d1 * x[own * ib, jb] - d2 * y[ib, own * jb]
        a, b = min(here, there), max(here, there)
        touching[a, b] += 1
        if near > 0.0 and far > 0.0:
            votes[a, b] += 1
        elif near < 0.0 and far < 0.0:
            votes[a, b] -= 1
    found = 0
    for a in range(count):
        for b in range(a, count):
            crease[a, b] = crease[b, a] = -1
            if touching[a, b] >= _FEWEST and abs(votes[a, b]) > _MAJORITY * touching[a, b]:
                s, t = planes[a], planes[b]
                d1, d2 = s[1] - t[1], s[2] - t[2]
                slope = np.sqrt(d1 * d1 + d2 * d2) / unit  # of their difference, per pixel
                scale = (1.0 if votes[a, b] > 0 else -1.0) / slope
                line = lines[found]
                line[0], line[1], line[2] = scale * (s[0] - t[0]), scale * d1, scale * d2
                crease[a, b] = crease[b, a] = found
                found += 1
    return found


@compiled
def crease_offsets(  # type: ignore[no-untyped-def]
    borders, label, crease, lines, planes, w, x, y, variance, ranging, lateral,
    reach, sigma, apart, offset,
):  # fmt: skip
    """Where along its normal the border between two planes that meet most likely lies, in pixels.

    offset = argmin over t of sum_{s > t} (cost_a - cost_b) + min(t^2 / (2 sigma^2), apart), s the
    distance to the line of intersection: slow errors of the planes move the line, and where the
    readings say `apart` nats against it, one surface passes in front of the other. Costs are those
    of the readings straight across the border, `reach` + 2 to either side as far as they belong to
    the pair. Writes offset (lines,).
    """
    height, width = np.uintp(label.shape[0]), np.uintp(label.shape[1])
    own = _1 if x.shape[0] > 1 else _0
    middle = reach * BINS
    histogram = np.empty((offset.size, 2 * middle + 1))
    for number in range(offset.size):
        for place in range(2 * middle + 1):
            histogram[number, place] = 0.0
    for n in range(borders.shape[0]):
        i, j, k = np.uintp(borders[n, 0]), np.uintp(borders[n, 1]), np.uintp(borders[n, 2])
        here, there = label[i, j], label[i + k, j + _1 - k]
        number = crease[here, there]
        if number < 0:
            continue
        a, b = min(here, there), max(here, there)
        a0, a1, a2, va = planes[a, 0], planes[a, 1], planes[a, 2], lateral[a]
        b0, b1, b2, vb = planes[b, 0], planes[b, 1], planes[b, 2], lateral[b]
        d0, d1, d2 = lines[number, 0], lines[number, 1], lines[number, 2]
        places = histogram[number]
        for direction in (_0, _1):
            r, c = i + k * direction, j + (_1 - k) * direction
            down, right = (k, _1 - k) if direction == _1 else (_0 - k, k - _1)
            for _ in range(reach + 2):
                if r >= height or c >= width:  # or less than 0, for they wrap around
                    break
                if label[r, c] != a and label[r, c] != b:
                    break
                value = np.float64(w[r, c])
                xr, yr = np.float64(x[own * r, c]), np.float64(y[r, own * c])
                place = int(np.rint((d0 + d1 * xr + d2 * yr) * BINS)) + middle
                if 0 <= place < places.size:
                    v = reading_variance(variance, ranging, value, xr, yr)
                    ea, eb = value - a0 - a1 * xr - a2 * yr, value - b0 - b1 * xr - b2 * yr
                    cost_a = min(0.5 * ea * ea / (v + va), _MOST)
                    places[place] += cost_a - min(0.5 * eb * eb / (v + vb), _MOST)
                r, c = r + down, c + right
    for number in range(offset.size):
        offset[number] = 0.0
        cost, lowest = 0.0, np.inf
        for place in range(2 * middle, -1, -1):
            shift = (place + 0.5 - middle) / BINS
            total = cost + min(0.5 * shift * shift / (sigma * sigma), apart)
            if total < lowest:
                lowest, offset[number] = total, shift
            cost += histogram[number, place]


@compiled
def find_strays(borders, label, crease, lines, offset, x, y, step, strays):  # type: ignore[no-untyped-def]
    """List pixels that lie on the other's side of a line in which their plane meets another.

    All that are beside a border of the two, and of the others one in `step` rows and columns: a
    wall seen past a cupboard may touch its own plane nowhere. Writes rows (i, j, label of the
    other) as far as there is room; returns how many.
    """
    count, alike = crease.shape[0], x.shape[0] == 1
    found = 0
    for n in range(borders.shape[0]):
        i, j, k = np.uintp(borders[n, 0]), np.uintp(borders[n, 1]), np.uintp(borders[n, 2])
        r, c = i + k, j + _1 - k
        here, there = label[i, j], label[r, c]
        number = crease[here, there]
        if number < 0:
            continue
        for _ in range(2):
            place = _place(lines[number], offset[number], x, y, i, j, alike)
            place *= 1.0 if there < here else -1.0
            if place > 0.0 and found < strays.shape[0]:
                strays[found, 0], strays[found, 1], strays[found, 2] = i, j, there
                found += 1
            i, j, r, c = r, c, i, j
            here, there = there, here
    # Partners of every plane, one after the other.
    meets, partners = np.empty(count + 1, np.int64), np.empty(count * count, np.int64)
    meets[0] = 0
    for a in range(count):
        last = meets[a]
        for b in range(count):
            partners[last] = b
            last += a > 0 and b > 0 and crease[a, b] >= 0
        meets[a + 1] = last
    for row in range(step // 2, label.shape[0], step):
        for column in range(step // 2, label.shape[1], step):
            i, j = np.uintp(row), np.uintp(column)
            here = label[i, j]
            for m in range(meets[here], meets[here + 1]):
                there = partners[m]
                number = crease[here, there]
                place = _place(lines[number], offset[number], x, y, i, j, alike)
                place *= 1.0 if there < here else -1.0
                if place > 0.0 and found < strays.shape[0]:
                    strays[found, 0], strays[found, 1], strays[found, 2] = i, j, there
                    found += 1
    return found


@compiled
def put_creases(  # type: ignore[no-untyped-def]
    strays, label, crease, lines, offset, planes, lateral, w, x, y, variance, ranging,
    price, apart, state, part,
):  # fmt: skip
    """Where two planes meet, make their line of intersection the border if that costs less.

    A stray and all pixels of its plane that are connected with it on the other's side of the line
    change sides together, unless readings say `apart` nats against it, or its own a few, if it
    lowers the sum of

        (w - plane)^2 / (2 (variance + lateral)), `_MOST` at most,
        + price * (borders between pixels that the line does not part).

    label has a margin and is changed in place; state: zeros of its shape; part: room for as many
    rows as pixels may change sides together.
    """
    alike = x.shape[0] == 1
    own = _0 if alike else _1
    for n in range(strays.shape[0]):
        i, j = np.uintp(strays[n, 0]) + _1, np.uintp(strays[n, 1]) + _1
        here, there = label[i, j], strays[n, 2]
        tried = np.uint8(1 + there % _TRIED)
        if here <= 0 or here == there or crease[here, there] < 0 or state[i, j] == tried:
            continue
        number = crease[here, there]
        line, shift, side = lines[number], offset[number], 1.0 if there < here else -1.0
        if side * _place(line, shift, x, y, i - _1, j - _1, alike) <= 0.0:
            continue
        s, t, vs, vt = planes[here], planes[there], lateral[here], lateral[there]
        part[0, 0], part[0, 1], state[i, j] = i, j, _IN_PART
        size, done, excess, told = 1, 0, 0.0, 0.0
        while done < size and told < apart:
            i, j = np.uintp(part[done, 0]), np.uintp(part[done, 1])
            done += 1
            value = np.float64(w[i - _1, j - _1])
            xj, yj = x[own * (i - _1), j - _1], y[i - _1, own * (j - _1)]
            v = reading_variance(variance, ranging, value, xj, yj)
            es, et = value - s[0] - s[1] * xj - s[2] * yj, value - t[0] - t[1] * xj - t[2] * yj
            told += min(0.5 * et * et / (v + vt), _MOST) - min(0.5 * es * es / (v + vs), _MOST)
            if done == 1 and told > _CLEAR:
                told = apart
                break
            for down, right in ((_0, _1), (_0, ~_0), (_1, _0), (~_0, _0)):  # they wrap around
                r, c = i + down, j + right
                if label[r, c] == there:
                    excess -= price
                elif label[r, c] == here and state[r, c] != _IN_PART:
                    place = side * _place(line, shift, x, y, r - _1, c - _1, alike)
                    if place > 0.0 and size < part.shape[0]:
                        part[size, 0], part[size, 1], state[r, c] = r, c, _IN_PART
                        size += 1
                    elif place > 0.0:
                        excess += price
        excess += told
        for m in range(size):
            i, j = np.uintp(part[m, 0]), np.uintp(part[m, 1])
            state[i, j] = tried
            if excess < 0.0 and told < apart:
                label[i, j], state[i, j] = there, 0


@inlined
def _place(line, offset, x, y, i, j, alike):  # type: ignore[no-untyped-def]
    """Distance of a pixel from the border along a line, positive on the side of the lower label."""
    own = _0 if alike else _1
    return line[0] - offset + line[1] * x[own * i, j] + line[2] * y[i, own * j]
