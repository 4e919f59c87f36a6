"""Plain NumPy versions of the kernels of the labels: every pixel looked at, nothing kept in lists.

A plane is w = t0 + t1 x + t2 y; variance (H, W) is that of every reading.
"""

import itertools

import numpy as np
from scipy import ndimage

UNIT = 100.0  # pixels per unit of x and y
CLEAR = 4.0  # nats that a stray's own reading may say against changing sides
BINS = 10  # places per pixel at which a crease may lie


def cells_of(image, side):
    """Pixels of every cell: (row, column, pixels)."""
    rows, columns = -(-image.shape[0] // side), -(-image.shape[1] // side)
    for r, c in itertools.product(range(rows), range(columns)):
        yield r, c, image[r * side : (r + 1) * side, c * side : (c + 1) * side]


def lay_out(grid, number, p, side):
    """Labels of pixels (-1 without a reading), which are fixed, and cells beside another label."""
    coarse = np.where(grid >= 0, number[grid], 0)
    padded = np.pad(coarse, 1, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    apart = (windows != coarse[:, :, None, None]).any((2, 3))

    def spread(of_cells):
        return of_cells.repeat(side, 0).repeat(side, 1)[: p.shape[0], : p.shape[1]]

    label = np.where(p > 0, spread(coarse), -1)
    return label, (p <= 0) | spread(~apart & (coarse > 0)), apart


def waiting(grid, number, fixed, w, p, x, y, planes, bound, side):
    """Pixels beside a cell of another label, or off their plane."""
    cell = np.where(grid >= 0, number[grid], 0)
    mine = cell.repeat(side, 0).repeat(side, 1)[: p.shape[0], : p.shape[1]]
    padded = np.pad(mine, 1, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    beside = (windows != mine[:, :, None, None]).any((2, 3))
    t = planes[mine]
    e = w - t[..., 0] - t[..., 1] * x - t[..., 2] * y
    return ~fixed & (beside | ((mine > 0) & (0.5 * e**2 * p > bound)))


def units_inside(label, grid, side, units):
    """Label of every unit whose pixels all have it but for those of -1, 0 of the others."""
    found = [set() for _ in range(units)]
    for r, c, pixels in cells_of(label, side):
        if grid[r, c] >= 0:
            found[grid[r, c]] |= set(pixels.ravel().tolist()) - {-1}
    return np.array([labels.pop() if len(labels) == 1 else 0 for labels in found])


def correlation_sums(grid, rows, inside, planes):
    """Of units side by side inside the same label: product and mean square of residuals, pairs."""
    t = planes[inside]
    off = (rows[:, 6] - (t * rows[:, :3]).sum(1)) / np.sqrt(rows[:, 0])
    sums = np.zeros((len(planes), 3))
    for a, b in ((grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])):
        side = (a >= 0) & (b >= 0) & (a != b)
        a, b = a[side], b[side]
        on = (inside[a] > 0) & (inside[a] == inside[b])
        a, b = a[on], b[on]
        each = np.column_stack(
            (off[a] * off[b], 0.5 * (off[a] ** 2 + off[b] ** 2), np.ones(len(a)))
        )
        np.add.at(sums, inside[a], each)
    return sums


def costs(w, x, y, variance, planes, lateral, null):
    """Data cost (labels, H, W) of every label at every pixel."""
    model = planes[:, :1, None] + planes[:, 1:2, None] * x + planes[:, 2:, None] * y
    cost = 0.5 * (w - model) ** 2 / (variance + lateral[:, None, None])
    cost[0] = null
    return cost


def neighbours(there, i, j):
    """Readings about a pixel, and what a differing label costs there."""
    for a, b in itertools.product((i - 1, i, i + 1), (j - 1, j, j + 1)):
        if (a, b) != (i, j) and 0 <= a < there.shape[0] and 0 <= b < there.shape[1] and there[a, b]:
            yield a, b, 1.0 if a == i or b == j else 0.7


def sweep_labels(label, free, cost, there, differing, backwards=False):
    """One sweep in raster order: every free pixel takes the best label about it, or none."""
    out = label.copy()
    for i, j in np.argwhere(there & free)[:: -1 if backwards else 1]:
        around = [(out[a, b], share) for a, b, share in neighbours(there, i, j)]

        def total(n, here=cost[:, i, j], around=around):
            return here[n] + differing * sum(share for other, share in around if other != n)

        out[i, j] = min([out[i, j], *(other for other, _ in around), 0], key=total)
    return out


def energy(label, cost, there, differing):
    """What the sweeps lower: data of every reading and every pair of unlike neighbours."""
    total = np.take_along_axis(cost, label[None].astype(int), 0)[0][there].sum()
    for (a, b), share in (
        ((np.s_[:, 1:], np.s_[:, :-1]), 1.0),
        ((np.s_[1:], np.s_[:-1]), 1.0),
        ((np.s_[1:, 1:], np.s_[:-1, :-1]), 0.7),
        ((np.s_[1:, :-1], np.s_[:-1, 1:]), 0.7),
    ):
        unlike = (label[a] != label[b]) & there[a] & there[b]
        total += differing * share * unlike.sum()
    return total


def borders(label):
    """(i, j, k, here, there): pixel, and the other plane to its right (k = 0) or below (k = 1)."""
    height, width = label.shape
    for k, i, j in itertools.product((0, 1), range(height), range(width)):
        row, column = i + k, j + 1 - k
        if row < height and column < width and 0 < label[i, j] != label[row, column] > 0:
            yield i, j, k, label[i, j], label[row, column]


def plane_value(t, x, y):
    return t[0] + t[1] * x + t[2] * y


def crease_kinds(label, planes, x, y, reach):
    """Majority of the border's pixels, most of at least eight: nearer on its own side, or farther.

    Votes are those of the farthest pixels of both labels, `reach` of their border at most.
    """

    def farthest(start, step):
        """The farthest pixel of the same label within reach of one in a direction."""
        steps = np.array(start) + np.arange(reach, -1, -1)[:, None] * step
        inside = (steps >= 0).all(1) & (steps < label.shape).all(1)
        return next(tuple(at) for at in steps[inside] if label[tuple(at)] == label[tuple(start)])

    votes = {}
    for i, j, k, here, there in borders(label):
        step = np.array((k, 1 - k))
        mine = farthest((i, j), -step)
        other = farthest(np.add((i, j), step), step)
        nearer = [
            plane_value(planes[own], x[at], y[at]) > plane_value(planes[alien], x[at], y[at])
            for own, alien, at in ((here, there, mine), (there, here, other))
        ]
        vote = {2: 1, 1: 0, 0: -1}[sum(nearer)]
        votes.setdefault((min(here, there), max(here, there)), []).append(vote)
    kinds = np.zeros((len(planes), len(planes)), int)
    for (a, b), cast in votes.items():
        if len(cast) >= 8 and abs(np.mean(cast)) > 0.4:
            kinds[a, b] = kinds[b, a] = np.sign(sum(cast))
    return kinds


def crease_distance(planes, kinds, a, b, x, y):
    """Pixels to the line of intersection, positive on the side of a < b."""
    delta = planes[a] - planes[b]
    slope = np.hypot(delta[1], delta[2]) / UNIT
    return kinds[a, b] * plane_value(delta, x, y) / slope


def crease_costs(label, planes, kinds, w, x, y, variance, lateral, reach, sigma, apart, pair):
    """Places t at which the border of a pair may lie, and what each costs.

    From every pixel of the border the readings are those straight across it, `reach` + 2 to either
    side, as far as they belong to the pair.
    """
    a, b = pair
    distance, excess = [], []
    for i, j, k, here, there in borders(label):
        if {here, there} != {a, b}:
            continue
        for steps in (range(0, -reach - 2, -1), range(1, reach + 3)):
            for m in steps:
                at = i + k * m, j + (1 - k) * m
                inside = 0 <= at[0] < label.shape[0] and 0 <= at[1] < label.shape[1]
                if not inside or label[at] not in pair:
                    break
                model = plane_value(planes[list(pair)].T, x[at], y[at])
                error = 2 * (variance[at] + lateral[list(pair)])
                cost = np.minimum((w[at] - model) ** 2 / error, 8)
                distance.append(crease_distance(planes, kinds, a, b, x[at], y[at]))
                excess.append(cost[0] - cost[1])
    distance, excess = np.array(distance), np.array(excess)
    places = (np.arange(-reach * BINS, reach * BINS + 1) + 0.5) / BINS
    beyond = distance > places[:, None]
    return places, beyond @ excess + np.minimum(places**2 / (2 * sigma**2), apart)


def strays(label, planes, kinds, offset, x, y, step):
    """Pixels beside borders, then of a lattice, on the other's side of a crease: (i, j, other)."""

    def ahead(here, there):
        a, b = sorted((here, there))
        distance = crease_distance(planes, kinds, a, b, x, y) - offset[a, b]
        return distance if there == a else -distance

    out = []
    for i, j, k, here, there in sorted(borders(label)):
        if kinds[here, there]:
            beside = ((i, j, here, there), (i + k, j + 1 - k, there, here))
            out += [(r, c, other) for r, c, own, other in beside if ahead(own, other)[r, c] > 0]
    for i in range(step // 2, label.shape[0], step):
        for j in range(step // 2, label.shape[1], step):
            here = label[i, j]
            for there in np.flatnonzero(kinds[here]):
                if ahead(here, there)[i, j] > 0:
                    out.append((i, j, there))
    return np.reshape(out, (-1, 3))


def put_creases(label, strays, cost, planes, kinds, offset, x, y, price):
    """Change sides of the lines in which planes meet where that costs less, stray by stray.

    cost (planes, H, W): of a reading on each plane. Returns labels, and how often it paid and not.
    """
    out, paid = label.copy(), [0, 0]
    tried = np.zeros_like(label)
    places = np.arange(label.size).reshape(label.shape)
    for i, j, there in strays:
        here = out[i, j]
        if here == there or not kinds[here, there] or tried[i, j] == there:
            continue
        a, b = sorted((here, there))
        ahead = crease_distance(planes, kinds, a, b, x, y) - offset[a, b]
        ahead *= 1 if there == a else -1
        wanted = (out == here) & (ahead > 0)
        told = cost[there] - cost[here]
        if not wanted[i, j]:
            continue
        if told[i, j] > CLEAR:
            tried[i, j] = there
            continue
        parts = ndimage.label(wanted)[0]
        part = parts == parts[i, j]
        excess = told[part].sum()
        for one, other in ((places[:, 1:], places[:, :-1]), (places[1:], places[:-1])):
            for inner, outer in ((one, other), (other, one)):
                at = part.flat[inner] & ~part.flat[outer]
                then, beside = out.flat[outer[at]], ahead.flat[outer[at]]
                excess -= price * np.count_nonzero(then == there)
                excess += price * np.count_nonzero((then == here) & (beside > 0))
        paid[int(excess >= 0)] += 1
        tried[part] = there
        if excess < 0:
            out[part], tried[part] = there, 0
    return out, paid
