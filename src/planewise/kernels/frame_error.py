"""Loops over neighbouring cells: how far their planes disagree, and quantiles of it.

Planes of cells are columns as `kernels.cells.merge_quarters` writes them; inflation (n,) is what
the variances of each have to be multiplied by. Grids (rows, columns) hold the index of the cell,
-1 where there is none.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cells import SIDE, UNIT
from planewise.kernels.elementary import exponential, logarithm
from planewise.kernels.jit import in_order, internal
from planewise.kernels.tables import between, row_and_stretch, squared_stretch
from planewise.kernels.walk import PLANE_BEND, PLANE_OFFSET

TILT = 10.0  # slope per offset of the shared error: its correlation length is 10 pixels
STEEPEST = 3.0  # slope per pixel in standard deviations: beyond it, a cell lies across an edge
MEAN_DISTANCE = 0.5214  # of two points of a square of side 1
SQUARE = 12  # times the lag, cells to a side of squares in which curved surfaces bend alike
_BEND = PLANE_BEND[0] + PLANE_BEND[1]  # of two cells of one size
_ASIDE = 0.1 / UNIT  # from the line of a row: nearer is none


@in_order
def steepness(planes, count, whole, edges, steep, sizes, samples):  # type: ignore[no-untyped-def]
    """chi^2 per degree of freedom by steepness.

    Steepness is the squared slope per pixel in standard deviations, noise taken off; edges (b + 1,)
    are those of its bins in rising order. count (n,): readings; whole (n,): those that matter.
    Writes steep (n,); sizes (b,) of the bins; and samples (b, 2, most): steepness and chi^2 of
    units of each, evenly spread, as many as there is room for or there are.
    """
    sizes[:] = 0
    bins = sizes.size
    of_unit = np.empty(steep.size, np.int8)
    for k in range(steep.size):
        per_pixel = planes[6, k] / (count[k] * UNIT * UNIT)
        slope = planes[3, k] * planes[3, k] + planes[4, k] * planes[4, k]
        steep[k] = max(slope - planes[7, k] - planes[9, k], 0.0) * per_pixel
        below = 0
        for b in range(bins + 1):
            below += edges[b] <= steep[k]
        of_unit[k] = below - 1 if whole[k] and below <= bins else -1
        if of_unit[k] >= 0:
            sizes[of_unit[k]] += 1
    strides, wait, taken = (
        np.empty(bins, np.int64),
        np.empty(bins, np.int64),
        np.empty(bins, np.int64),
    )
    for b in range(bins):
        wait[b] = taken[b] = 0
        strides[b] = (sizes[b] - 1) // samples.shape[2] + 1
    for k in range(steep.size):
        b = of_unit[k]
        if b < 0:
            continue
        if wait[b] == 0:
            samples[b, 0, taken[b]] = steep[k]
            samples[b, 1, taken[b]] = planes[5, k] / (count[k] - 3.0)
            taken[b] += 1
            wait[b] = strides[b]
        wait[b] -= 1


@in_order
def unit_errors(  # type: ignore[no-untyped-def]
    planes, count, size, white_part, shared, drift, step, ranging, white, lateral, steep, out
):
    """Variances of w that the error leaves in every unit, at its mean depth.

    white_part, shared, drift, step (L,), ranging: of `spatial.frame.ErrorTable`, the first two as
    told; white: size of the white part in this frame; lateral: error across the image in pixels^2,
    steep (n,): `steepness`; size (n,): 2 of a square of cells, 1 of a cell. Writes out (6, n): of
    the offset by what near readings share; of a slope by it; of the drift over 100 pixels; of the
    quantisation that near readings share; the factor by which readings lie farther from the unit's
    plane than noise would have them; and of quantisation as far as they lie nearer.

    White noise of standard deviation s dithers steps of q: the mean error of readings keeps
    exp(-2 pi^2 s^2 / q^2) of its amplitude.
    """
    last = float(step.size - 2)
    common, slow, coarse, larger = out[0], out[2], out[3], out[4]
    for k in range(count.size):
        row, stretch = row_and_stretch(ranging, planes[2, k], planes[0, k], planes[1, k])
        common[k] = stretch * between(shared, row, last)
        slow[k] = stretch * between(drift, row, last)
        new = stretch * between(white_part, row, last)
        square = stretch * between(step, row, last)  # q^2 / 12
        noise = max(white * (new + square) - square, 0.0)
        coarse[k] = -4 * np.pi * np.pi * noise / (12 * square) if square > 0.0 else 0.0
        larger[k] = square  # for as long as it takes
    for k in range(count.size):
        coarse[k] = exponential(coarse[k]) * larger[k]
    for k in range(count.size):
        half = 0.5 * size[k] * SIDE / UNIT
        larger[k] = 1.0 + lateral * min(steep[k], STEEPEST * STEEPEST)
        out[1, k] = larger[k] * (TILT * TILT * common[k] + coarse[k] / (half * half))
        common[k] = larger[k] * (common[k] + coarse[k])
        slow[k] *= larger[k]
    for k in range(count.size):
        farther = planes[5, k] / (count[k] - 3.0)
        out[4, k] = max(1.0, farther)
        out[5, k] = max(0.0, 1.0 - farther) * coarse[k]


@in_order
def wandering(planes, errors, factor, resolution, ranging, out):  # type: ignore[no-untyped-def]
    """Variance of w by which the error of every unit drifts over 100 pixels.

    No plane is known better than readings are resolved. errors (5, n), ranging: `unit_errors`;
    factor: size of its drift.
    """
    for k in range(out.size):
        w = planes[2, k]
        stretch = squared_stretch(ranging, planes[0, k], planes[1, k])
        resolved = w * w * w * w * resolution * resolution / (12.0 * stretch)
        out[k] = factor * errors[2, k] + errors[3, k] + resolved


@internal
def _offset_variances(planes, inflation):  # type: ignore[no-untyped-def]
    """Variances of w of cells at their centroids by what is new in every reading."""
    out = np.empty(inflation.size)
    for k in range(out.size):
        out[k] = inflation[k] / planes[6, k]
    return out


def most_squares(shape: tuple[int, ...]) -> int:
    """Squares of `cells_in_a_row`, at most, of a grid of such a shape."""
    return 2 * math.prod(-(-n // SQUARE) for n in shape)


@in_order
def cells_in_a_row(grid, planes, inflation, drift, lag, off, own, slow, ends):  # type: ignore[no-untyped-def]
    """How far cells in a row, `lag` cells apart, are from a line: s = w_2 - t w_1 - (1 - t) w_3.

    Writes it, its variance by the cells' own errors, and that by the drift, along rows and along
    columns, one square of `SQUARE` lags to a side after another, and where each of these ends;
    returns how many there are, and how many squares. Where cells of a row are not in one line, as
    those of a distorted image are not, the slope across is taken off. Of a random walk, D |r| the
    variance of a difference, the s of means over squares has the variance

        D (d(r) - d(2 r) / 4 - 3 d(0) / 4),

    d(r) = r + side^2 / (12 r), d(0) = 0.52 side the mean distance of points of two squares.
    """
    rows, columns = grid.shape
    side = 2.0 * SIDE / UNIT
    white = _offset_variances(planes, inflation)
    found = squares = 0
    extent = SQUARE * lag
    for axis in range(2):
        down, across = (lag, 0) if axis else (0, lag)
        position, other = planes[axis], planes[1 - axis]
        slope, uncertain = planes[4 - axis], planes[9 - 2 * axis]
        for top in range(down, rows - down, extent):
            for left in range(across, columns - across, extent):
                for i in range(top, min(top + extent, rows - down)):
                    for j in range(left, min(left + extent, columns - across)):
                        a, b = grid[i - down, j - across], grid[i, j]
                        c = grid[i + down, j + across]
                        if a < 0 or b < 0 or c < 0:
                            continue
                        scale = 1.0 / (position[c] - position[a])  # the one division
                        reach = abs(position[c] - position[a])
                        t = (position[c] - position[b]) * scale
                        wide = side * side / 12.0 * abs(scale)
                        apart = planes[2, b] - t * planes[2, a] - (1 - t) * planes[2, c]
                        variance = white[b] + t * t * white[a] + (1 - t) * (1 - t) * white[c]
                        aside = other[b] - t * other[a] - (1 - t) * other[c]
                        if abs(aside) > _ASIDE:
                            apart -= slope[b] * aside
                            variance += aside * aside * inflation[b] * uncertain[b]
                        walk = 0.5 * reach + 2.0 * wide - 0.25 * (reach + wide)
                        off[found], own[found] = apart, variance
                        slow[found] = drift[b] * (walk - 0.75 * MEAN_DISTANCE * side)
                        found += 1
                ends[squares] = found
                squares += 1
    return found, squares


@in_order
def bent_alike(off, own, slow, ends, factor, widest):  # type: ignore[no-untyped-def]
    """How far cells in a row are off a line by a bend that is the same all over a square of cells.

    off, own, slow (n,), ends (squares,): `cells_in_a_row`. Of those that are not off by more than
    `widest` times the variance own + factor slow, what the cells' own errors make of it taken off:
    the squared mean of each square of cells, as often as there are any, added up; and all squared.
    """
    alike = excess = 0.0
    start = 0
    for k in range(ends.size):
        total = noise = 0.0
        count = 0
        for n in range(start, ends[k]):
            if off[n] * off[n] <= widest * (own[n] + factor * slow[n]):
                total += off[n]
                noise += own[n]
                excess += off[n] * off[n] - own[n]
                count += 1
        if count:
            alike += (total * total - noise) / count
        start = ends[k]
    return alike, excess


@in_order
def neighbours(grid, planes, inflation, drift, shared, tilt, slopes, offsets):  # type: ignore[no-untyped-def]
    """Disagreement of cells side by side: in slope, and where they meet, half-way between them.

    Writes slopes (3, 2 n): squares of the difference along x and along y, the variance by noise and
    drift, and what `tilt` would add; offsets (4, n): the same of w with `shared`, and what the tilt
    adds to w there. Returns n.
    """
    rows, columns = grid.shape
    white = _offset_variances(planes, inflation)
    found = 0
    for axis in range(2):
        down, across = axis == 1, axis == 0
        for i in range(rows - down):
            for j in range(columns - across):
                a, b = grid[i, j], grid[i + down, j + across]
                if a < 0 or b < 0:
                    continue
                x, y = 0.5 * (planes[0, b] - planes[0, a]), 0.5 * (planes[1, b] - planes[1, a])
                slow = np.sqrt(drift[a] * drift[b])
                extent = 2.0 * np.sqrt(x * x + y * y)
                vx = inflation[a] * planes[7, a] + inflation[b] * planes[7, b]
                vy = inflation[a] * planes[9, a] + inflation[b] * planes[9, b]
                tilted = tilt[a] + tilt[b]
                for k in range(2):
                    turn = planes[3 + k, a] - planes[3 + k, b]
                    slopes[0, 2 * found + k] = turn * turn
                    slopes[1, 2 * found + k] = (vx if k == 0 else vy) + _BEND * slow / extent
                    slopes[2, 2 * found + k] = tilted
                gap = planes[2, a] - planes[2, b]
                gap += x * (planes[3, a] + planes[3, b]) + y * (planes[4, a] + planes[4, b])
                offsets[0, found] = gap * gap
                offsets[1, found] = (
                    white[a] + white[b] + x * x * vx + y * y * vy + PLANE_OFFSET * slow * extent
                )
                offsets[2, found] = shared[a] + shared[b]
                offsets[3, found] = (x * x + y * y) * tilted
                found += 1
    return found


@in_order
def bisect(square, own, added, share, reference, widest, least, low, high, steps):  # type: ignore[no-untyped-def]
    """The factor at which a quantile of square / (own + factor added) is the reference.

    `share` says which quantile, of those that are not above `widest`; a factor at which these are
    a smaller share of all than `least` is too small. 0 where the quantile is smaller even at `low`.
    """
    for step in range(steps + 1):
        factor = np.sqrt(low * high) if step else low
        below, among = 0, 0
        for i in range(square.size):
            variance = own[i] + factor * added[i]
            below += square[i] <= reference * variance
            among += square[i] <= widest * variance
        if among < least * square.size or below <= int(share * among):
            low = factor
        elif step == 0:
            return 0.0
        else:
            high = factor
    return np.sqrt(low * high)


@in_order
def reading_variances(white, shared, drift, step, sizes, variance):  # type: ignore[no-untyped-def]
    """Variance of a reading about its plane by depth: writes variance (L,).

    white, shared, drift, step (L,): `frame.ErrorTable`; sizes: of the white, the shared and the
    drifting part.
    """
    new, common, wander = sizes
    for k in range(variance.size):
        slow = common * (shared[k] + step[k]) + wander * drift[k]
        variance[k] = new * (white[k] + step[k]) + slow


@in_order
def noise_bias(white, per_metre, first, span, w, out):  # type: ignore[no-untyped-def]
    """`frame.ErrorTable.noise_bias` of w > 0 (n,): writes out (n,).

    white (L,): variance by depth, per_metre rows a metre, the first that occurs; span: of depth, to
    either side, over which its course is read.
    """
    last = np.float64(white.size - 2)
    for k in range(w.size):
        row = per_metre / w[k]
        near = min(max((1.0 - span) * row, first), last)
        far = max(min(max((1.0 + span) * row, first), last), near + 1e-3)
        here = between(white, row, last)
        fall = logarithm(between(white, near, last) / between(white, far, last))
        fall /= logarithm(far / near)
        out[k] = here / (w[k] * w[k]) * (fall - 1.0)
