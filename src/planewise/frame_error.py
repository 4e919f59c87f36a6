"""What a frame says about its own error: white noise, steep surfaces, drift, what neighbours share.

A sensor's description gives the error's shape over depth; the frame gives its size. Each number is
the one at which most cells, or neighbours, or cells in a row, lie as far from planes as chi^2 says
they should: quantiles, for edges and clutter only make them lie farther.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.cells import COUNT, PLANE_BEND, PLANE_OFFSET, UNIT

Array = NDArray[np.float64]
Grid = NDArray[np.int32]

_MEDIAN_CHI2_1 = 0.4549  # of one degree of freedom
_QUARTILE_CHI2_1 = 0.1015
_FEWEST = 100  # cells, pairs or triples that can tell
_WHITE_LIMIT = 25.0  # five times the described standard deviation
_STEEPNESS = (0.25, 0.75, 1.25, 1.75, 2.25)  # bins of slope per pixel in standard deviations
_STEEPEST = 3.0  # beyond it, a cell lies across an edge
_LATERAL_LIMIT = 1.5  # pixels^2
_LAGS = (2, 4)  # cells between the middle of three in a row and the others
_BISECTIONS = 12
_BISECTED = (1e-3, 400.0)


@dataclass(frozen=True, kw_only=True)
class FrameError:
    """Sizes of the parts of a frame's error against its sensor's description, as variances.

    Attributes
    ----------
    white : float
        Of the white part, at least 1.
    lateral : float
        Error across the image in pixels^2: a surface of slope s per pixel errs by lateral s^2 more,
        in all parts alike.
    drift : float
        Of the drift between segments.
    near, bent : float
        Of the shared part: as offsets and as slopes of cells.
    """

    white: float = 1.0
    lateral: float = 0.0
    drift: float = 1.0
    near: float = 1.0
    bent: float = 1.0


@dataclass(frozen=True)
class CellPlanes:
    """The plane of every cell at its centroid, with variances of w and of its slopes."""

    x: Array
    y: Array
    w: Array
    slope_x: Array
    slope_y: Array
    variance: Array
    variance_x: Array
    variance_y: Array
    misfit: Array

    @classmethod
    def of(cls, moments: Array) -> CellPlanes:
        """From rows of moments or segments (`kernels.cells`)."""
        m = moments.T
        x, y, w = m[1] / m[0], m[2] / m[0], m[6] / m[0]
        xx, xy, yy = m[3] - x * m[1], m[4] - x * m[2], m[5] - y * m[2]
        xw, yw = m[7] - x * m[6], m[8] - y * m[6]
        determinant = xx * yy - xy * xy
        tx, ty = (yy * xw - xy * yw) / determinant, (xx * yw - xy * xw) / determinant
        misfit = np.maximum(m[9] - w * m[6] - tx * xw - ty * yw, 0.0)
        return cls(x, y, w, tx, ty, 1 / m[0], yy / determinant, xx / determinant, misfit)


def white_factor(misfits: Array, freedom: int) -> float:
    """White variance against the description: the median whole cell about its own plane says it.

    A frame whose cells are farther from planes than a sensor can err has no such noise, but no
    planes: then the description stands.
    """
    if not misfits.size:
        return 1.0
    median = freedom * (1 - 2 / (9 * freedom)) ** 3  # of chi^2 (Wilson and Hilferty)
    factor = max(1.0, float(np.median(misfits)) / median)
    return factor if factor <= _WHITE_LIMIT else 1.0


def lateral_variance(units: Array, whole: NDArray[np.bool_]) -> tuple[float, Array]:
    """Error across the image in pixels^2, and what it multiplies every unit's error by.

    Cells on steep surfaces lie farther from their planes: chi^2 = a + b q with q = (slope per pixel
    / sigma)^2 is a line through medians, and lateral = b / a.
    """
    planes = CellPlanes.of(units)
    per_pixel = units[:, 0] / (units[:, COUNT] * UNIT**2)
    steep = (planes.slope_x**2 + planes.slope_y**2) * per_pixel
    steep -= np.minimum((planes.variance_x + planes.variance_y) * per_pixel, steep)  # by noise
    chi2 = planes.misfit / (units[:, COUNT] - 3)
    points = []
    for low, high in pairwise(_STEEPNESS):
        here = whole & (steep >= low**2) & (steep < high**2)
        if here.sum() >= _FEWEST:
            points.append((np.median(steep[here]), np.median(chi2[here]), np.sqrt(here.sum())))
    lateral = 0.0
    if len(points) > 1:
        q, level, weight = np.array(points).T
        slope, base = np.polyfit(q, level, 1, w=np.sqrt(weight))
        lateral = float(np.clip(slope / max(base, 0.1), 0.0, _LATERAL_LIMIT))
    return lateral, 1.0 + lateral * np.minimum(steep, _STEEPEST**2)


def drift_factor(grid: Grid, whole: NDArray[np.bool_], planes: CellPlanes, drift: Array) -> float:
    """Drift against its description, as a variance: from three cells in a row.

    w_middle - t w_left - (1 - t) w_right has the variance of the cells' own errors and, for a
    distance r between middle and ends, D r / 2. The smaller of two distances counts: more is shape.
    """
    found = []
    for lag in _LAGS:
        triples = []
        for cells, there, position in (
            (grid, whole, planes.x),
            (grid.T, whole.T, planes.y),
        ):
            a, b, c = cells[:, : -2 * lag], cells[:, lag:-lag], cells[:, 2 * lag :]
            ok = there[:, : -2 * lag] & there[:, lag:-lag] & there[:, 2 * lag :]
            a, b, c = a[ok], b[ok], c[ok]
            t = (position[c] - position[b]) / (position[c] - position[a])
            off = planes.w[b] - t * planes.w[a] - (1 - t) * planes.w[c]
            v = planes.variance
            own = v[b] + t**2 * v[a] + (1 - t) ** 2 * v[c]
            reach = 0.5 * np.abs(position[c] - position[a])
            triples.append((off**2, own, 0.5 * drift[b] * reach))
        square, own, slow = (np.concatenate(part) for part in zip(*triples, strict=True))
        if square.size >= _FEWEST and slow.any():
            found.append(_bisect(square, own, slow, 0.25, _QUARTILE_CHI2_1))
    return min(found) if found else 1.0


def shared_factors(
    grid: Grid,
    whole: NDArray[np.bool_],
    planes: CellPlanes,
    drift: Array,
    shared: Array,
    tilt: Array,
) -> tuple[float, float]:
    """How far neighbours disagree beyond white noise and drift, where they meet and in slope.

    Factors on the variances `shared` of a cell's offset and `tilt` of its slopes, per unit.
    """
    slopes, offsets, turned = [], [], []
    for a, b in _neighbours(grid, whole):
        x, y = 0.5 * (planes.x[b] - planes.x[a]), 0.5 * (planes.y[b] - planes.y[a])
        slow = np.sqrt(drift[a] * drift[b])
        extent = 2 * np.hypot(x, y)
        bend = sum(PLANE_BEND) * slow / extent
        vx, vy = (v[a] + v[b] for v in (planes.variance_x, planes.variance_y))
        tilted = tilt[a] + tilt[b]
        for slope, variance in ((planes.slope_x, vx), (planes.slope_y, vy)):
            slopes.append(((slope[a] - slope[b]) ** 2, variance + bend, tilted))
        # Where the two meet, half-way between their centroids.
        gap = planes.w[a] - planes.w[b]
        gap = gap + x * (planes.slope_x[a] + planes.slope_x[b])
        gap = gap + y * (planes.slope_y[a] + planes.slope_y[b])
        own = planes.variance[a] + planes.variance[b] + x**2 * vx + y**2 * vy
        offsets.append((gap**2, own + PLANE_OFFSET * slow * extent, shared[a] + shared[b]))
        turned.append((x**2 + y**2) * tilted)
    square, own, tilted = (np.concatenate(part) for part in zip(*slopes, strict=True))
    if square.size < _FEWEST or not tilted.any():
        return 1.0, 1.0
    bent = _bisect(square, own, tilted, 0.5, _MEDIAN_CHI2_1)
    square, own, common = (np.concatenate(part) for part in zip(*offsets, strict=True))
    near = _bisect(square, own + bent * np.concatenate(turned), common, 0.5, _MEDIAN_CHI2_1)
    return near, bent


def _neighbours(grid: Grid, whole: NDArray[np.bool_]) -> Iterator[tuple[Grid, Grid]]:
    """Units of whole cells side by side, then one below the other."""
    for cells, there in ((grid, whole), (grid.T, whole.T)):
        both = there[:, :-1] & there[:, 1:]
        yield cells[:, :-1][both], cells[:, 1:][both]


def _bisect(square: Array, own: Array, added: Array, share: float, reference: float) -> float:
    """The factor at which a quantile of square / (own + factor added) is that of chi^2, or 0."""
    low, high = _BISECTED
    rank = int(share * square.size)

    def excess(factor: float) -> bool:
        return bool(np.partition(square / (own + factor * added), rank)[rank] > reference)

    if not excess(low):
        return 0.0
    for _ in range(_BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if excess(middle) else (low, middle)
    return float(np.sqrt(low * high))
