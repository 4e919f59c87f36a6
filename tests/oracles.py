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
