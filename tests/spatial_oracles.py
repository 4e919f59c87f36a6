"""Plain NumPy versions of the kernels of the spatial search: dense matrices and brute force.

A plane is w = t0 + t1 x + t2 y. Where a kernel takes moments these take the readings themselves.
"""

import itertools
import math

import numpy as np

UNIT = 100.0  # pixels per unit of x and y


def design(x, y):
    return np.column_stack((np.ones(x.size), x, y))


def moments(w, p, x, y):
    """Row of some readings: normal equations of their plane, their square, their number."""
    J = design(x, y)
    normal = J.T @ (p[:, None] * J)
    square = (p * w**2).sum()
    return np.array([*normal[np.triu_indices(3)], *(J.T @ (p * w)), square, w.size])


def misfit(w, p, x, y):
    """chi^2 of the best plane."""
    root = np.sqrt(p)
    J = root[:, None] * design(x, y)
    t = np.linalg.lstsq(J, root * w, rcond=None)[0]
    return float(((root * w - J @ t) ** 2).sum())


def unit(w, p, x, y, white=1.0):
    """Plane of some readings, all that is told of it, and their number; white: size of noise."""
    cx, cy = np.average(x, weights=p), np.average(y, weights=p)
    J = design(x - cx, y - cy)
    normal = J.T @ (p[:, None] * J) / white
    t, covariance = np.linalg.solve(normal, J.T @ (p * w)) / white, np.linalg.inv(normal)
    chi2 = (p * (w - J @ t) ** 2).sum() / white
    slopes = covariance[[1, 1, 2], [1, 2, 2]]
    return np.array([cx, cy, *t, chi2, p.sum() / white, *slopes, w.size])


def block(images, top, left, side):
    """Readings of one square of an image: w, p, x, y."""
    part = [image[top : top + side, left : left + side].ravel() for image in images]
    return [values[part[1] > 0] for values in part]


def cell_moments(w, p, x, y, side):
    rows, columns = -(-w.shape[0] // side), -(-w.shape[1] // side)
    cells = itertools.product(range(rows), range(columns))
    return np.array([moments(*block((w, p, x, y), i * side, j * side, side)) for i, j in cells])


def merge_quarters(images, side, white, split, hopeless, filled):
    """Unit of every cell (-1: none), what is told of the units, and their sizes."""
    rows, columns = (-(-n // side) for n in images[0].shape)
    of_cell, units, size = np.full((rows, columns), -1), [], []
    for i, j in itertools.product(range(0, rows, 2), range(0, columns, 2)):
        whole = block(images, i * side, j * side, 2 * side)
        places = [(a, b) for a in (i, i + 1) for b in (j, j + 1) if a < rows and b < columns]
        quarters = {(a, b): block(images, a * side, b * side, side) for a, b in places}
        if whole[0].size >= 4 * filled * side**2 and one_plane(
            whole, quarters.values(), white, split, hopeless
        ):
            for place, readings in quarters.items():
                if readings[0].size:
                    of_cell[place] = len(units)
            units.append(unit(*whole, white))
            size.append(2)
            continue
        for place, readings in quarters.items():
            count = readings[0].size
            if count < max(8, filled * side**2):
                continue
            if misfit(*readings) <= hopeless * white * (count - 3):
                of_cell[place] = len(units)
                units.append(unit(*readings, white))
                size.append(1)
    return of_cell, np.array(units).reshape(-1, 11).T, np.array(size)


def one_plane(whole, quarters, white, split, hopeless):
    """F test of four planes (nine further parameters) against one."""
    freedom = whole[0].size - 3
    together = misfit(*whole)
    if together <= white * freedom:
        return True
    apart = sum(misfit(*q) for q in quarters if q[0].size)
    apart = max(apart, 0.5 * white * (freedom - 9))
    F = ((together - apart) / 9) / (apart / (freedom - 9))
    return together <= hopeless * white * freedom and split >= F


def marginalise(w, p, x, y, offset, tilt):
    """J' V^-1 J, J' V^-1 w and t' J' V^-1 J t with V the dense covariance of the readings.

    The random effect is an offset and two slopes about the centroid.
    """
    inflation = max(1.0, misfit(w, p, x, y) / (w.size - 3))
    effect = design(x - np.average(x, weights=p), y - np.average(y, weights=p))
    V = np.diag(inflation / p) + effect @ np.diag([offset, tilt, tilt]) @ effect.T
    J = design(x, y)
    P, Pt = J.T @ np.linalg.solve(V, J), J.T @ np.linalg.solve(V, w)
    return P, Pt, Pt @ np.linalg.solve(P, Pt)


def information(row):
    P = np.empty((3, 3))
    P[np.triu_indices(3)] = row[:6]
    return np.triu(P) + np.triu(P, 1).T


def plane_at(row, point):
    """Mean and covariance of (w, dw/dx, dw/dy) of a segment at a point."""
    covariance = np.linalg.inv(information(row))
    T = np.array([[1.0, *point], [0, 1, 0], [0, 0, 1]])
    return T @ covariance @ row[6:9], T @ covariance @ T.T


def difference(a, b, drift, lean=0.0):
    """Difference of the planes of two segments where they meet, and its covariance C."""
    small, large = sorted((a, b), key=lambda row: row[10])
    extent, reach = np.sqrt(small[10]) / UNIT, np.sqrt(large[10]) / UNIT
    here, there = small[1:3] / small[0], large[1:3] / large[0]
    apart = np.linalg.norm(there - here)
    forward = (there - here) / (apart + 1e-12)
    point = here + forward * min(0.5 * extent, 0.5 * apart)
    gap = max(0.0, apart - 0.75 * (extent + reach))
    bend = 0.9 / extent + 0.3 / reach
    sigma_d = drift * np.diag([0.13 * reach + gap, bend, bend])
    leaning = lean**2 * a[6] / a[0] * b[6] / b[0]
    sigma_d += leaning * np.diag([(reach / 12) ** 2, 1, 1])
    (s, S), (t, T) = plane_at(small, point), plane_at(large, point)
    return s - t, S + T + sigma_d


def evidence_of(C, offset_prior, slope_prior):
    wide = C + np.diag([offset_prior, slope_prior, slope_prior])
    return 0.5 * math.log(np.linalg.det(wide) / np.linalg.det(C))


def compare(a, b, drift, offset_prior, slope_prior, lean=0.0):
    delta, C = difference(a, b, drift, lean)
    return delta @ np.linalg.solve(C, delta), evidence_of(C, offset_prior, slope_prior)


def more_than_parallel(a, b, drift, spread):
    """ln of the density of the difference of one plane over that of two parallel ones."""
    delta, C = difference(a, b, drift)
    v = spread * plane_at(a, a[1:3] / a[0])[0]

    def log_density(covariance):
        square = delta @ np.linalg.solve(covariance, delta)
        return -0.5 * (square + np.log(np.linalg.det(covariance)))

    return log_density(C) - log_density(C + np.outer(v, v))


def free_price(row, drift, offset_prior, slope_prior):
    """Evidence at the unit's centroid, beside a known plane 100 pixels wide."""
    _, C = plane_at(row, row[1:3] / row[0])
    bend = 0.9 * drift / (np.sqrt(row[10]) / UNIT)
    return evidence_of(C + np.diag([0.13 * drift, bend, bend]), offset_prior, slope_prior)


def sides(grid, outside=False):
    """(axis, i, j, u, v) of every side of a cell that two units share, or one has alone."""
    for axis, i, j in itertools.product((0, 1), range(grid.shape[0]), range(grid.shape[1])):
        row, column = (i, j + 1) if axis == 0 else (i + 1, j)
        if row < grid.shape[0] and column < grid.shape[1]:
            u, v = grid[i, j], grid[row, column]
            if u != v and (outside or min(u, v) >= 0):
                yield axis, i, j, u, v


def border_discords(grid, rows, drift, lean):
    out = np.full((2, *grid.shape), -1.0)
    for axis, i, j, u, v in sides(grid):
        slow = math.sqrt(drift[u] * drift[v])
        out[axis, i, j] = compare(rows[u], rows[v], slow, 0, 0, lean)[0]
    return out


def join_blocks(grid, whole, rows, drift, lean, limit, levels, tails):
    """Root of every unit, and the rows of the segments."""
    rows, drift, root = rows.copy(), drift.copy(), np.arange(len(rows))
    level = np.where(whole, 1, 0)

    def between(a, b, *drift):
        return compare(a, b, math.sqrt(math.prod(drift)), 0, 0, lean)[0]

    for step in range(1, levels + 1):
        side = 2**step
        for i, j in itertools.product(*(range(0, n - side, 2 * side) for n in grid.shape)):
            square = grid[i : i + side + 1 : side, j : j + side + 1 : side]
            if (square < 0).any() or (level[square] != step).any():
                continue
            (a, b), (c, d) = square
            upper = between(rows[a], rows[b], drift[a], drift[b])
            lower = between(rows[c], rows[d], drift[c], drift[d])
            halves = (drift[a] + drift[b]) / 2, (drift[c] + drift[d]) / 2
            both = between(rows[a] + rows[b], rows[c] + rows[d], *halves)
            if max(upper, lower, both) > limit:
                continue
            misfit = tempered(upper, rows[b, 10], tails) + tempered(lower, rows[d, 10], tails)
            misfit += tempered(both, rows[c, 10] + rows[d, 10], tails)
            members = [a, b, c, d]
            drift[a] = np.average(drift[members], weights=rows[members, 10])
            rows[a] = rows[members].sum(axis=0)
            rows[a, 11] += misfit
            root[np.isin(root, members)] = a
            level[a] = step + 1
    return root, rows


def saved_by_joining(rows, drift, slope_prior, gap_offset, naming, i, j):
    """Nats saved by making two segments that do not touch one plane, and their discord."""
    small = min(i, j, key=lambda n: rows[n, 10])
    offset = (gap_offset * rows[small, 6] / rows[small, 0]) ** 2
    slow = math.sqrt(drift[i] * drift[j])
    discord, evidence = compare(rows[i], rows[j], slow, offset, slope_prior[small])
    parallel = more_than_parallel(rows[small], rows[i + j - small], slow, gap_offset)
    return min(evidence - 0.5 * discord - naming, parallel), discord


def join_through_gaps(rows, drift, slope_prior, gap_offset):
    """Owner of every segment, and the rows of the planes."""
    rows, owner = rows.copy(), np.arange(len(rows))
    naming = math.log(len(rows))
    while True:
        best = (0.0, None)
        for i, j in itertools.combinations(np.unique(owner), 2):
            saved, discord = saved_by_joining(rows, drift, slope_prior, gap_offset, naming, i, j)
            best = max(best, (saved, (i, j, discord)))
        if best[1] is None:
            return owner, rows
        i, j, discord = best[1]
        rows[i] += rows[j]
        rows[i, 11] += discord
        owner[owner == j] = i


def find_planes(rows, drift, slope_prior, gap_offset, planes):
    """Plane that each further segment saves most as part of, -1 where none saves anything."""
    out, priors = [], (slope_prior, gap_offset, math.log(planes))
    for j in range(planes, len(rows)):
        saved = [saved_by_joining(rows, drift, *priors, i, j)[0] for i in range(planes)]
        out.append(int(np.argmax(saved)) if max(saved) > 0 else -1)
    return out


def tempered(discord, count, tails):
    nu = tails * max(1.0, count / 36)
    return (nu + 3) * math.log(1 + discord / nu)


def agglomerate(
    grid, border, rows, drift, offset_prior, slope_prior, lean, most, longest=np.inf, tails=4,
    lazy=False,
):  # fmt: skip
    """Merge the pair of neighbours whose misfit takes the least share of what it saves.

    Until none saves anything.

    lazy: only the pair about to be merged is valued again after its segments have changed, and a
    pair that gains nothing is forgotten until it gains a border, or none gains anything. Returns
    the root of every unit and the rows of the segments.
    """
    rows, drift = rows.copy(), drift.copy()
    root = np.arange(len(rows))
    boundary, gain, stale = {}, {}, set()
    for axis, i, j, u, v in sides(grid):
        pair = frozenset((u, v))
        boundary[pair] = boundary.get(pair, 0) + border[axis, i, j]

    def value(pair):
        small, large = sorted(pair, key=lambda n: rows[n, 10])
        slow = math.sqrt(drift[small] * drift[large])
        discord, evidence = compare(
            rows[small], rows[large], slow, offset_prior[small], slope_prior[small], lean
        )
        cost = tempered(discord, rows[small, 10], tails)
        saved = min(evidence, most) + min(boundary[pair], longest)
        gain = saved - 0.5 * cost
        return (gain / saved if gain > 0 else gain), cost

    for pair in boundary:
        gain[pair] = value(pair)[0]
    while gain:
        best = max(gain, key=gain.get)
        if gain[best] <= 0:
            for pair in stale & gain.keys():
                gain[pair] = value(pair)[0]
            stale.clear()
            if max(gain.values()) <= 0:
                break
            continue
        if best in stale:
            stale.remove(best)
            gain[best] = value(best)[0]
            continue
        gone, kept = sorted(best, key=lambda n: rows[n, 10])
        cost = value(best)[1]
        share = rows[gone, 10] / (rows[gone, 10] + rows[kept, 10])
        rows[kept] += rows[gone]
        rows[kept, 11] += cost
        drift[kept] = (1 - share) * drift[kept] + share * drift[gone]
        root[root == gone] = kept
        del boundary[best], gain[best]
        for pair in [pair for pair in boundary if gone in pair]:
            moved = (pair - {gone}) | {kept}
            joined = moved in boundary
            boundary[moved] = boundary.get(moved, 0) + boundary.pop(pair)
            gain[moved] = math.inf if joined else gain[pair]
            del gain[pair]
            stale.discard(pair)
        for pair in [pair for pair in boundary if kept in pair]:
            if lazy:
                stale.add(pair)
            else:
                gain[pair] = value(pair)[0]
    return root, rows
