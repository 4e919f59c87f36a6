"""Loop over groups: the planes that their readings are best described by."""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.cells import COUNT, UNIT
from planewise.kernels.jit import compiled
from planewise.kernels.mixture import CERTAIN, OWN
from planewise.kernels.tables import between, row_and_stretch

_CAPPED = 1e-9  # relative: nats of a group that are those of anything at all


@compiled
def refit_sums(  # type: ignore[no-untyped-def]
    moments, label, planes, shared, step, drift, ranging, error, anything, alone, white, data,
    sums,
):  # fmt: skip
    """Information of the groups of every label on its plane, random effects integrated out.

    All as `kernels.group_data` takes and writes it, but that surfaces do not lean; anything: nats
    of any reading. Writes sums (N + 1, 9): the information P and P t as rows of segments have them
    (`kernels.cells`). A group counts with the probability, given all, that it is not a surface of
    its own, and not at all where it is described as anything at all.
    """
    near, slow, bent, bend, lateral, _ = error
    last = np.float64(shared.size - 2)
    sums[:] = 0.0
    for g in range(label.size):
        j, count = label[g], moments[COUNT, g]
        if j == 0 or not count > 0.0:
            continue
        longer = alone[g] - data[g]
        weight = 1.0 - OWN * math.exp(-longer) if longer < CERTAIN else 1.0
        if alone[g] > count * anything - CERTAIN:
            most = (1.0 - OWN) * math.exp(alone[g] - math.log(2.0) - count * anything) + OWN
            if data[g] >= (alone[g] - math.log(most)) * (1.0 - _CAPPED):
                continue
        if weight <= 0.0:
            continue
        m0 = moments[0, g]
        scale = 1.0 / m0
        cx, cy, mean = scale * moments[1, g], scale * moments[2, g], scale * moments[6, g]
        xx, xy = moments[3, g] - cx * moments[1, g], moments[4, g] - cx * moments[2, g]
        yy = moments[5, g] - cy * moments[2, g]
        xw, yw = moments[7, g] - cx * moments[6, g], moments[8, g] - cy * moments[6, g]
        row, stretch = row_and_stretch(ranging, mean, cx, cy)
        common, fine = stretch * between(shared, row, last), stretch * between(step, row, last)
        wander = stretch * between(drift, row, last)
        slope = planes[1, j] * planes[1, j] + planes[2, j] * planes[2, j]
        steep = 1.0 + lateral * slope / (UNIT * UNIT) * m0 / count
        offset = steep * (near * (common + fine) + slow * planes[3, j] * wander)
        tilt = steep * (bent * common + bend * wander)
        own = white[g]
        m0, xx, xy, yy, xw, yw = own * m0, own * xx, own * xy, own * yy, own * xw, own * yw
        level = weight * m0 / (1.0 + offset * m0)
        # (A^-1 + tilt)^-1 = (1 + tilt A)^-1 A, with A the moments about the centroid
        a, b, c = 1.0 + tilt * xx, tilt * xy, 1.0 + tilt * yy
        scale = weight / (a * c - b * b)
        pxx, pxy, pyy = (
            scale * (c * xx - b * xy),
            scale * (c * xy - b * yy),
            scale * (a * yy - b * xy),
        )
        qx, qy = scale * (c * xw - b * yw), scale * (a * yw - b * xw)
        out = sums[j]
        out[0] += level
        out[1] += level * cx
        out[2] += level * cy
        out[3] += level * cx * cx + pxx
        out[4] += level * cx * cy + pxy
        out[5] += level * cy * cy + pyy
        out[6] += level * mean
        out[7] += level * mean * cx + qx
        out[8] += level * mean * cy + qy
