"""Loops over groups: their nats on planes and on none, as closed forms of their moments.

The white variance of a group is its own: 2^k times the frame's, k = 0 ... 20, which takes
(k + 1) ln 2 nats. k is the best for a smooth surface, whatever the label says.

So are, where there are levels of them, the variances of what the groups of a plane share: 4^k times
the frame's. A sensor errs more on some surfaces.

Where steps are coarser than the noise readings only tell which one a surface is in: chi^2 about any
is not below what undithered quantisation makes of it. Else terraces, which it makes of a plane,
would be shorter as surfaces of their own.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cells import COUNT, UNIT
from planewise.kernels.elementary import exponent, logarithm, power_of_two
from planewise.kernels.groups import NORM
from planewise.kernels.jit import compiled, inlined, internal
from planewise.kernels.mixture import of_either
from planewise.kernels.tables import between, row_and_stretch
from planewise.kernels.walk import PLANE_RESIDUAL

_LOUDEST = 2.0**20  # white variance of a group, times the frame's
_LN2 = math.log(2.0)
_BATCH = 120  # groups at once: all fit the fastest cache, where powers of 2 share lines


@inlined
def _level(misfit, count):  # type: ignore[no-untyped-def]
    """k that makes n / 2 ln 2^k + chi^2 / 2^(k + 1) + k ln 2 least."""
    best = misfit / (_LN2 * (count + 2.0))
    return exponent(min(best, _LOUDEST) if best > 1.0 else 1.0)


@inlined
def _level_nats(level, count):  # type: ignore[no-untyped-def]
    """Nats of a level, and of readings whose density is so much lower."""
    return _LN2 * (0.5 * count * level + level + 1.0)


@inlined
def _undithered(steps, count):  # type: ignore[no-untyped-def]
    """Least chi^2 of readings to which quantisation adds `steps`; 0 where noise adds as much."""
    return max(2.0 * min(steps, count) - count, 0.0)


@inlined
def _without_slopes(variance, square, xx, xy, yy, xw, yw):  # type: ignore[no-untyped-def]
    """chi^2 with random slopes of a variance integrated out, and det(I + variance A)."""
    a, b, c = 1.0 + variance * xx, variance * xy, 1.0 + variance * yy
    determinant = max(a * c - b * b, 1.0)  # which rounding may hide
    explained = c * xw * xw - 2.0 * b * xw * yw + a * yw * yw
    return square - variance * explained / determinant, determinant


@inlined
def _about_surface(slopes, square, xx, xy, yy, xw, yw, count):  # type: ignore[no-untyped-def]
    """Level k of a group, chi^2 about a smooth surface under it, and the determinant of slopes."""
    misfit, _ = _without_slopes(slopes, square, xx, xy, yy, xw, yw)
    level = _level(misfit, count)
    own = power_of_two(-level)
    chi2, determinant = _without_slopes(
        slopes, own * square, own * xx, own * xy, own * yy, own * xw, own * yw
    )
    return level, chi2, determinant


@internal
def _on_none(smooth, count, prior):  # type: ignore[no-untyped-def]
    """Nats of a group on none: a smooth surface or anything at all, whichever is shorter.

    smooth: nats about a surface of known depth; prior: variance of its slopes at w = 1, nats of its
    depth, and of any reading's.
    """
    return _LN2 + min(prior[1] + smooth, count * prior[2])


@compiled
def group_data(  # type: ignore[no-untyped-def]
    moments, label, first, planes, shared, step, drift, ranging, error, prior, alone, white,
    data, worth, saved, leaving,
):  # fmt: skip
    """Nats of every group on none, and as labelled at levels k = 0, 1 ... of its plane.

    moments (12, .), label (.), first (.): `kernels.groups`; planes (5, N + 1): t0, t1, t2 of every
    label, the side of a square as large as the plane, in units of 100 pixels, longer by distortion,
    and as it is; shared, step, drift (L,), linear between, and ranging: `spatial.frame.ErrorTable`.
    error: factors of shared and of slow variance of a group's offset, of both of its tilt, the
    lateral variance, and slopes by which surfaces lean, at w = 1. prior: `_on_none`.

    Writes alone (.), white (.): its readings' precision, times the frame's, and data (levels, .).
    Adds to worth (levels, N + 1) data - alone and, of the first level, to saved (N + 1,) data less
    what readings take that may be anything at all, and to leaving (N + 1,) what blocks that are all
    on a plane have more without it. Returns the sum of data of the first level.
    """
    blocks, groups, levels = first[0], first[-1], data.shape[0]
    near, slow, bent, bend, lateral, lean = error
    last, total = np.float64(shared.size - 2), 0.0
    # One piece of memory: then no row of it can hide behind another, and loops are vector code.
    work = np.empty((26, _BATCH))
    m0, m1, m2, m3, m4, m5 = work[0], work[1], work[2], work[3], work[4], work[5]
    m6, m7, m8, m9, count, norm = work[6], work[7], work[8], work[9], work[10], work[11]
    t0, t1, t2, extent, common, fine = work[12], work[13], work[14], work[15], work[16], work[17]
    wander, smooth, spread, fitted, precision = work[18], work[19], work[20], work[21], work[22]
    side, flat, least = work[23], work[24], work[25]
    for start in range(0, groups, _BATCH):
        stop = min(start + _BATCH, groups)
        n = stop - start
        for e in range(moments.shape[0]):
            row = moments[e, start:stop]
            for k in range(n):
                work[e, k] = row[k]
        for k in range(n):
            j = label[start + k]
            t0[k], t1[k], t2[k] = planes[0, j], planes[1, j], planes[2, j]
            extent[k], side[k] = planes[3, j], planes[4, j]
            if count[k] > 0.0:
                scale = 1.0 / m0[k]
                row, stretch = row_and_stretch(ranging, scale * m6[k], scale * m1[k], scale * m2[k])
                common[k], fine[k] = (
                    stretch * between(shared, row, last),
                    stretch * between(step, row, last),
                )
                wander[k] = stretch * between(drift, row, last)
        for k in range(n):
            scale = 1.0 / m0[k]
            cx, cy, mean = scale * m1[k], scale * m2[k], scale * m6[k]
            xx, xy, yy = m3[k] - cx * m1[k], m4[k] - cx * m2[k], m5[k] - cy * m2[k]
            xw, yw = m7[k] - cx * m6[k], m8[k] - cy * m6[k]
            square = m9[k] - mean * m6[k]
            slopes = prior[0] * mean * mean
            loud, smooth[k], spread[k] = _about_surface(
                slopes, square, xx, xy, yy, xw, yw, count[k]
            )
            precision[k] = own = power_of_two(-loud)
            least[k] = own * _undithered(m0[k] * fine[k], count[k])
            smooth[k] = max(smooth[k], least[k])
            norm[k] += _level_nats(loud, count[k])

            # About the plane: variances of offset and tilt, and moments, in place of what they are
            # made of.
            a, b = t1[k], t2[k]
            off = mean - (t0[k] + a * cx + b * cy)
            steep = 1.0 + lateral * (a * a + b * b) / (UNIT * UNIT) * m0[k] / count[k]
            leaning = lean * lean * mean * mean
            offset = steep * (near * (common[k] + fine[k]) + slow * extent[k] * wander[k])
            tilt = steep * (bent * common[k] + bend * wander[k])
            common[k], wander[k], flat[k] = offset, tilt, leaning
            side[k] = PLANE_RESIDUAL * leaning * side[k] * side[k]
            square += a * a * xx + 2.0 * a * b * xy + b * b * yy - 2.0 * (a * xw + b * yw)
            m7[k], m8[k] = own * (xw - a * xx - b * xy), own * (yw - a * xy - b * yy)
            m9[k], m3[k], m4[k], m5[k] = own * square, own * xx, own * xy, own * yy
            m0[k] *= own
            m6[k] = m0[k] * off * off
        for k in range(n):
            g = start + k
            white[g] = precision[k]
            smooth[k] = 0.5 * (smooth[k] + logarithm(spread[k])) + norm[k]
            alone[g] = _on_none(smooth[k], count[k], prior) if count[k] > 0.0 else 0.0
        for v in range(levels):
            wavy = power_of_two(np.int64(2 * v))
            for k in range(n):
                # chi^2 about the plane: the part that an offset explains apart
                chi2, determinant = _without_slopes(
                    wavy * wander[k] + flat[k], m9[k], m3[k], m4[k], m5[k], m7[k], m8[k]
                )
                wide = 1.0 + (wavy * common[k] + side[k]) * m0[k]
                chi2 = max(chi2 + m6[k] / wide, least[k])
                fitted[k] = 0.5 * (chi2 + logarithm(determinant * wide)) + norm[k]
            on_none = alone[start:stop]
            for k in range(n):
                either = of_either(_LN2 + min(fitted[k], count[k] * prior[2]), on_none[k])
                fitted[k] = either if count[k] > 0.0 else 0.0
            for k in range(n):
                g, j = start + k, label[start + k]
                nats = alone[g]
                if j > 0:
                    nats = fitted[k]
                    worth[v, j] += nats - alone[g]
                    if v == 0:
                        saved[j] += nats - count[k] * prior[2]
                        if g < blocks:
                            leaving[j] += alone[g] - nats
                data[v, g] = nats
                if v == 0:
                    total += nats
    return total


@compiled
def groups_left(  # type: ignore[no-untyped-def]
    moments, label, first, place, step, ranging, prior, data, leaving
):
    """Add what blocks with several labels have more when a plane goes, after those behind it.

    Readings of a plane that is gone join those on none in their block, so place (N + 1,), 1 ... N
    of every plane, says in which order; all else as of `group_data`. Adds to leaving (N + 1,), of
    every label.
    """
    m = np.empty(NORM + 1)
    last = np.float64(step.size - 2)
    for b in range(first.size - 1):
        for e in range(NORM + 1):
            m[e] = 0.0
        paid = 0.0
        behind = np.int64(place.size)
        for g in range(first[b], first[b + 1]):
            if label[g] == 0:
                for e in range(NORM + 1):
                    m[e] = moments[e, g]
                paid = data[g]
        while True:
            gone, at = np.int64(0), 0
            for g in range(first[b], first[b + 1]):
                rank = np.int64(place[label[g]])
                if gone < rank < behind:
                    gone, at = rank, g
            if gone == 0:
                break
            for e in range(NORM + 1):
                m[e] += moments[e, at]
            cx, cy, mean = m[1] / m[0], m[2] / m[0], m[6] / m[0]
            slopes, square = prior[0] * mean * mean, m[9] - mean * m[6]
            xx, xy, yy = m[3] - cx * m[1], m[4] - cx * m[2], m[5] - cy * m[2]
            xw, yw = m[7] - cx * m[6], m[8] - cy * m[6]
            level, misfit, determinant = _about_surface(
                slopes, square, xx, xy, yy, xw, yw, m[COUNT]
            )
            row, stretch = row_and_stretch(ranging, mean, cx, cy)
            fine = stretch * between(step, row, last)
            misfit = max(misfit, power_of_two(-level) * _undithered(m[0] * fine, m[COUNT]))
            smooth = 0.5 * (misfit + math.log(determinant)) + m[NORM]
            now = _on_none(smooth + _level_nats(level, m[COUNT]), m[COUNT], prior)
            leaving[label[at]] += now - paid - data[at]
            paid, behind = now, gone
