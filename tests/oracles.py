"""Plain NumPy versions of the compiled kernels and of Phi: slow, readable, independent."""

import math

import numpy as np


def score_rays(theta, a, s, ceiling):
    q = theta @ a
    gain = (s - 1 / q) ** 2 - ceiling
    return np.minimum(gain, 0).sum(axis=1)


def score_points(h, x, ceiling):
    return np.minimum((h @ x) ** 2 - ceiling, 0).sum(axis=1)


def assign(square, tau):
    """square (N, k): delta^2 / (2 sigma^2)."""
    gains = np.vstack((np.zeros_like(tau), square - tau))
    # Who loses its plane falls back to the next, or to none, which gains zero.
    ordered = np.sort(np.vstack((np.zeros_like(tau), gains)), axis=0)
    cumulative = np.minimum.accumulate(gains, axis=0).sum(axis=1)
    return ordered[0], ordered[1], gains.argmin(axis=0), cumulative


def gauss_newton(theta, a, s, labels):
    matrix, moved = np.zeros((len(theta), 3, 3)), np.full(theta.shape, np.nan)
    for j, row in enumerate(theta):
        mine = labels == j + 1
        q = row @ a[:, mine]
        jacobian = a[:, mine] / q**2
        matrix[j] = jacobian @ jacobian.T
        moved[j] = row - np.linalg.lstsq(jacobian.T, s[mine] - 1 / q, rcond=None)[0]
    return matrix, moved


def scatter(x, labels, planes):
    return np.array([x[:, labels == j + 1] @ x[:, labels == j + 1].T for j in range(planes)])


def phi(depth, rays, labels, planes, sigma, R, eps):
    """Equation 10 of the paper for a depth image, reading by reading."""
    valid = [
        (i, j) for i in range(depth.shape[0]) for j in range(depth.shape[1]) if depth[i, j] > 0
    ]
    total = len(valid) * math.log(len(planes) + 1) + len(planes) * 3 * math.log(R / eps)
    for i, j in valid:
        if labels[i, j] == 0:
            total += math.log(R / eps)
            continue
        n, d = planes[labels[i, j] - 1][:3], planes[labels[i, j] - 1][3]
        delta = depth[i, j] + d / float(n @ rays[i, j])
        total += delta**2 / (2 * sigma[i, j] ** 2)
        total += 0.5 * math.log(2 * math.pi * sigma[i, j] ** 2 / eps**2)
    return total


LEVELS = np.arange(21)


def group_level(misfit, count):
    """k of every group's white variance, 2^k: of all that there are the shortest for a surface."""
    nats = 0.5 * np.multiply.outer(count, LEVELS) * math.log(2)
    nats += 0.5 * np.multiply.outer(misfit, 0.5**LEVELS) + LEVELS * math.log(2)
    return LEVELS[nats.argmin(axis=-1)]


def group_level_nats(level):
    """(k + 1) ln 2: the probability of k is 2^-(k + 1), their sum less than one."""
    return (level + 1) * math.log(2)


def undithered(steps, count, level):
    """Least chi^2 of readings under a level: what quantisation adds beyond noise of that size."""
    return 0.5**level * np.clip(2 * np.minimum(steps, count) - count, 0, None)


def group_data(m, planes, shared, step, drift, ranging, error, prior, wavy=1.0):
    """Nats of groups on none and on a plane each: columns of moments and of planes with extents.

    wavy: what the variances that a group shares are times those of the frame.
    """
    near, slow, bent, bend, lateral, lean = error
    slope_prior, surface, coordinate = prior
    t0, t1, t2, extent, side = planes
    count, norm, mean = m[10], m[11], m[6] / m[0]
    cx, cy = m[1] / m[0], m[2] / m[0]
    xx, xy, yy = m[3] - cx * m[1], m[4] - cx * m[2], m[5] - cy * m[2]
    xw, yw, square = m[7] - cx * m[6], m[8] - cy * m[6], m[9] - mean * m[6]

    def integrated_slopes(variance, xw, yw):
        """What random slopes explain of chi^2, and ln det(I + variance A)."""
        A = np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1)
        matrix = np.eye(2) + variance[:, None, None] * A
        b = np.column_stack((xw, yw))
        explained = variance * np.einsum(
            "gi,gi->g", b, np.linalg.solve(matrix, b[..., None])[..., 0]
        )
        return explained, np.linalg.slogdet(matrix)[1]

    misfit = square - integrated_slopes(slope_prior * mean**2, xw, yw)[0]
    level = group_level(misfit, count)
    norm = norm + 0.5 * count * level * math.log(2) + group_level_nats(level)
    p, own = m[0] / count, 0.5**level
    weight, xx, xy, yy, xw, yw, square = own * np.array([m[0], xx, xy, yy, xw, yw, square])
    rows = np.arange(shared.size)
    stretch = 1 + ranging[1] * cx**2 + ranging[2] * cy**2  # (range / z)^2
    row = ranging[0] * np.sqrt(stretch) / mean
    shared, step, drift = (stretch * np.interp(row, rows, v) for v in (shared, step, drift))
    least = undithered(m[0] * step, count, level)
    explained, determinant = integrated_slopes(slope_prior * mean**2, xw, yw)
    smooth = surface + 0.5 * (np.maximum(square - explained, least) + determinant) + norm
    alone = math.log(2) + np.minimum(smooth, count * coordinate)
    off = mean - (t0 + t1 * cx + t2 * cy)
    chi2 = square + weight * off**2 - 2 * (t1 * xw + t2 * yw)
    chi2 += t1**2 * xx + 2 * t1 * t2 * xy + t2**2 * yy
    steep = wavy * (1 + lateral * (t1**2 + t2**2) / 100**2 * p)
    offset = steep * (near * (shared + step) + slow * extent * drift)
    tilt = steep * (bent * shared + bend * drift) + (lean * mean) ** 2
    offset += 0.113 * (lean * mean * side) ** 2
    explained, determinant = integrated_slopes(tilt, xw - t1 * xx - t2 * xy, yw - t1 * xy - t2 * yy)
    spread = 1 + offset * weight
    chi2 -= offset * (weight * off) ** 2 / spread + explained
    on = math.log(2) + np.minimum(
        0.5 * (np.maximum(chi2, least) + np.log(spread) + determinant) + norm, count * coordinate
    )
    return alone, -np.logaddexp(math.log(0.95) - on, math.log(0.05) - alone)
