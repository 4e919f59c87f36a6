"""Loops over groups: their nats on planes and on none, as closed forms of their moments.

The white variance of a group is its own: 2^k times the frame's, k = 0 ... 20, which takes
(k + 1) ln 2 nats. k is the best for a smooth surface, whatever the label says.

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
from planewise.kernels.tables import between
from planewise.kernels.walk import PLANE_RESIDUAL

_LOUDEST = 2.0**20  # white variance of a group, times the frame's
_LN2 = math.log(2.0)
_BATCH = 200  # groups at once; columns a power of 2 apart share lines of the cache


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
    moments, label, first, planes, shared, step, drift, per_metre, error, prior, alone, data,
    white, worth, saved, leaving,
):  # fmt: skip
    """Nats of every group on none and as labelled.

    moments (12, .), label (.), first (.): `kernels.groups`; planes (5, N + 1): t0, t1, t2 of every
    label, the side of a square as large as the plane, in units of 100 pixels, longer by distortion,
    and as it is; shared, step, drift (L,): variances by depth, per_metre rows a metre, linear
    between. error: factors of shared and of slow variance of a group's offset, of both of its tilt,
    the lateral variance, and slopes by which surfaces lean, at w = 1. prior: `_on_none`.

    Writes alone and data (.), and white (.): its readings' precision, times the frame's. Adds to
    worth (N + 1,) data - alone, to saved (N + 1,) data less what readings take that may be anything
    at all, and to leaving (N + 1,) what blocks that are all on a plane have more without it.
    Returns the sum of data.
    """
    blocks, groups = first[0], first[-1]
    near, slow, bent, bend, lateral, lean = error
    last = np.float64(shared.size - 2)
    # One piece of memory: then no row of it can hide behind another, and loops are vector code.
    work = np.empty((25, _BATCH))
    m0, m1, m2, m3, m4, m5 = work[0], work[1], work[2], work[3], work[4], work[5]
    m6, m7, m8, m9, count, norm = work[6], work[7], work[8], work[9], work[10], work[11]
    t0, t1, t2, extent, common, fine = work[12], work[13], work[14], work[15], work[16], work[17]
    wander, smooth, spread, fitted, turned = work[18], work[19], work[20], work[21], work[22]
    precision, side = work[23], work[24]
    total = 0.0
    for start in range(0, groups, _BATCH):
        stop = min(start + _BATCH, groups)
        n = stop - start
        for e in range(NORM + 1):
            row = moments[e, start:stop]
            for k in range(n):
                work[e, k] = row[k]
        for k in range(n):
            j = label[start + k]
            t0[k], t1[k], t2[k] = planes[0, j], planes[1, j], planes[2, j]
            extent[k], side[k] = planes[3, j], planes[4, j]
            if count[k] > 0.0:
                row = per_metre * m0[k] / m6[k]
                common[k], fine[k] = between(shared, row, last), between(step, row, last)
                wander[k] = between(drift, row, last)
        for k in range(n):
            scale = 1.0 / m0[k]
            cx, cy, mean = scale * m1[k], scale * m2[k], scale * m6[k]
            xx, xy, yy = m3[k] - cx * m1[k], m4[k] - cx * m2[k], m5[k] - cy * m2[k]
            xw, yw = m7[k] - cx * m6[k], m8[k] - cy * m6[k]
            square = m9[k] - mean * m6[k]
            slopes = prior[0] * mean * mean
            level, smooth[k], spread[k] = _about_surface(
                slopes, square, xx, xy, yy, xw, yw, count[k]
            )
            precision[k] = own = power_of_two(-level)
            least = own * _undithered(m0[k] * fine[k], count[k])
            smooth[k] = max(smooth[k], least)
            norm[k] += _level_nats(level, count[k])

            a, b = t1[k], t2[k]
            off = mean - (t0[k] + a * cx + b * cy)
            steep = 1.0 + lateral * (a * a + b * b) / (UNIT * UNIT) * m0[k] / count[k]
            leaning = lean * lean * mean * mean
            offset = steep * (near * (common[k] + fine[k]) + slow * extent[k] * wander[k])
            offset += PLANE_RESIDUAL * leaning * side[k] * side[k]
            tilt = steep * (bent * common[k] + bend * wander[k]) + leaning
            # chi^2 about the plane: the part that an offset explains apart
            square += a * a * xx + 2.0 * a * b * xy + b * b * yy - 2.0 * (a * xw + b * yw)
            xw, yw = own * (xw - a * xx - b * xy), own * (yw - a * xy - b * yy)
            square, xx, xy, yy = own * square, own * xx, own * xy, own * yy
            chi2, determinant = _without_slopes(tilt, square, xx, xy, yy, xw, yw)
            wide = 1.0 + offset * own * m0[k]
            fitted[k] = max(chi2 + own * m0[k] * off * off / wide, least)
            turned[k] = determinant * wide
        for k in range(n):
            smooth[k] = 0.5 * (smooth[k] + logarithm(spread[k])) + norm[k]
            fitted[k] = 0.5 * (fitted[k] + logarithm(turned[k])) + norm[k]
        for k in range(n):
            g, j = start + k, label[start + k]
            white[g] = precision[k]
            if not count[k] > 0.0:
                alone[g] = data[g] = 0.0
                continue
            nats = _on_none(smooth[k], count[k], prior)
            alone[g] = nats
            if j > 0:
                nats = of_either(_LN2 + min(fitted[k], count[k] * prior[2]), nats)
                worth[j] += nats - alone[g]
                saved[j] += nats - count[k] * prior[2]
                if g < blocks:
                    leaving[j] += alone[g] - nats
            data[g] = nats
            total += nats
    return total


@compiled
def groups_left(  # type: ignore[no-untyped-def]
    moments, label, first, place, step, per_metre, prior, data, leaving
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
            fine = between(step, per_metre / mean, last)
            misfit = max(misfit, power_of_two(-level) * _undithered(m[0] * fine, m[COUNT]))
            smooth = 0.5 * (misfit + math.log(determinant)) + m[NORM]
            now = _on_none(smooth + _level_nats(level, m[COUNT]), m[COUNT], prior)
            leaving[label[at]] += now - paid - data[at]
            paid, behind = now, gone
