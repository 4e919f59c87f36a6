"""Segments as they are compared, and whether two of them are one plane.

A form holds what a comparison needs of a segment row (`kernels.cells`): its centroid, inverse depth
and slopes there, their variances (about the centroid the offset's is independent of the slopes'),
its extent, the root of its area, and one over it, the root of its drift, and the standard deviation
of the slopes by which pieces of one surface lean against each other (`planewise.flatness`).

The formulas are written once, for numbers instead of rows, and always inlined: so the same lines
are a vector loop over a grid of squares and a fast comparison of any two.
"""

from __future__ import annotations

import numpy as np

from planewise.kernels.cells import COUNT, UNIT
from planewise.kernels.elementary import logarithm
from planewise.kernels.jit import compiled, inlined, internal
from planewise.kernels.symmetric import determinant, quadratic_form
from planewise.kernels.walk import CHORD, MEET, PLANE_BEND, PLANE_OFFSET, TOUCHING

FORM = 13
X, Y, W, TX, TY, V, VXX, VXY, VYY, EXTENT, INVERSE, SLOW, LEANING = range(FORM)

_BEND_SMALL, _BEND_LARGE = PLANE_BEND
# Unsigned indices spare the check for negative ones.
_0, _1 = np.uintp(0), np.uintp(1)


@compiled
def write_form(s, drift, lean, form):  # type: ignore[no-untyped-def]
    """Write the form of a segment row; lean: of its slopes against those of others (`Sectors`)."""
    scale = 1.0 / s[0]
    cx, cy = s[1] * scale, s[2] * scale
    xx, xy, yy = s[3] - cx * s[1], s[4] - cx * s[2], s[5] - cy * s[2]
    qx, qy = s[7] - cx * s[6], s[8] - cy * s[6]
    scale_slopes = 1.0 / (xx * yy - xy * xy)
    vxx, vxy, vyy = yy * scale_slopes, -xy * scale_slopes, xx * scale_slopes
    form[X], form[Y], form[W] = cx, cy, s[6] * scale
    form[TX], form[TY] = vxx * qx + vxy * qy, vxy * qx + vyy * qy
    form[V], form[VXX], form[VXY], form[VYY] = scale, vxx, vxy, vyy
    extent = np.sqrt(s[COUNT]) / UNIT
    form[EXTENT], form[INVERSE] = extent, 1.0 / extent
    form[SLOW], form[LEANING] = np.sqrt(drift), lean * form[W]


@compiled
def write_forms(segments, drift, lean, forms):  # type: ignore[no-untyped-def]
    """Write the forms (n, 13) of segment rows (n, 13) (`write_form`)."""
    for k in range(segments.shape[0]):
        write_form(segments[k], drift[k], lean, forms[k])


@inlined
def _difference(  # type: ignore[no-untyped-def]
    x0, y0, w0, tx0, ty0, v0, vxx0, vxy0, vyy0, extent0, inverse0, slow0, leaning0,
    x1, y1, w1, tx1, ty1, v1, vxx1, vxy1, vyy1, extent1, inverse1, slow1, leaning1,
):  # fmt: skip
    """Difference delta of the planes of two forms where they meet, and its covariance C.

    They meet near the smaller one. C = P_0^-1 + P_1^-1 + Sigma_d, where Sigma_d is what an error
    that wanders like a random walk makes of the planes of two squares side by side, and of those
    farther apart by a gap (`spatial.frame_error`), and surfaces that are not quite flat
    (`planewise.flatness`).
    """
    first = extent0 <= extent1  # is the smaller one
    extent, reach = min(extent0, extent1), max(extent0, extent1)
    # From the centroid of the larger to that of the smaller; and from both to where they meet.
    sign = 1.0 if first else -1.0
    dx, dy = sign * (x0 - x1), sign * (y0 - y1)
    apart = np.sqrt(dx * dx + dy * dy)
    share = MEET * min(extent, apart) / (apart + 1e-12)
    sx, sy = -share * dx, -share * dy
    dx, dy = dx + sx, dy + sy
    ax, ay = sx if first else dx, sy if first else dy
    bx, by = dx if first else sx, dy if first else sy
    gap = max(apart - TOUCHING * (extent + reach), 0.0)
    drift, lean = slow0 * slow1, leaning0 * leaning1
    bend = lean + drift * (
        _BEND_SMALL * (inverse0 if first else inverse1)
        + _BEND_LARGE * (inverse1 if first else inverse0)
    )
    delta = w0 + ax * tx0 + ay * ty0 - w1 - bx * tx1 - by * ty1
    c00 = v0 + v1 + drift * (PLANE_OFFSET * reach + gap) + lean * (CHORD * reach) * (CHORD * reach)
    c00 += ax * ax * vxx0 + 2.0 * ax * ay * vxy0 + ay * ay * vyy0
    c00 += bx * bx * vxx1 + 2.0 * bx * by * vxy1 + by * by * vyy1
    c01 = ax * vxx0 + ay * vxy0 + bx * vxx1 + by * vxy1
    c02 = ax * vxy0 + ay * vyy0 + bx * vxy1 + by * vyy1
    c11, c12, c22 = vxx0 + vxx1 + bend, vxy0 + vxy1, vyy0 + vyy1 + bend
    return delta, tx0 - tx1, ty0 - ty1, c00, c01, c02, c11, c12, c22


@inlined
def _difference_of(a, b):  # type: ignore[no-untyped-def]
    """`_difference` of two forms, each a row."""
    return _difference(
        a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8], a[9], a[10], a[11], a[12],
        b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7], b[8], b[9], b[10], b[11], b[12],
    )  # fmt: skip


@compiled
def compare_forms(a, b, offset_prior, slope_prior):  # type: ignore[no-untyped-def]
    """Are two segments one plane? Their discord, and the evidence that it would be a coincidence.

    discord = delta' C^-1 delta with delta the difference of their planes where they meet.
    evidence = 1/2 ln det(C + S0) / det C, S0 the prior of a plane that has nothing to do with the
    other.
    """
    x, y, z, c00, c01, c02, c11, c12, c22 = _difference_of(a, b)
    near = determinant(c00, c01, c02, c11, c12, c22)
    discord = quadratic_form(x, y, z, c00, c01, c02, c11, c12, c22) / near
    c00, c11, c22 = c00 + offset_prior, c11 + slope_prior, c22 + slope_prior
    return discord, 0.5 * logarithm(determinant(c00, c01, c02, c11, c12, c22) / near)


@compiled
def discord_of(a, b):  # type: ignore[no-untyped-def]
    """The first of what `compare_forms` tells, without the second's logarithm."""
    x, y, z, c00, c01, c02, c11, c12, c22 = _difference_of(a, b)
    square = quadratic_form(x, y, z, c00, c01, c02, c11, c12, c22)
    return square / determinant(c00, c01, c02, c11, c12, c22)


@compiled
def discords_of(a, b, out):  # type: ignore[no-untyped-def]
    """The same of forms (n, 13) and (n, 13), pair by pair: writes out (n,)."""
    for k in range(out.size):
        out[k] = discord_of(a[k], b[k])


@inlined
def compare_parallel(a, b, spread):  # type: ignore[no-untyped-def]
    """Nats by which two segments are more likely one plane than two that are parallel.

    w of parallel planes is proportional: their difference where they meet is drawn from
    N(0, C + spread^2 v v') in place of N(0, C), v = (w, slopes) of the first.

        1/2 ln(1 + s) - 1/2 spread^2 (v' C^-1 delta)^2 / (1 + s),    s = spread^2 v' C^-1 v
    """
    x, y, z, c00, c01, c02, c11, c12, c22 = _difference_of(a, b)
    near = determinant(c00, c01, c02, c11, c12, c22)
    w, tx, ty = a[W], a[TX], a[TY]
    shift = quadratic_form(w, tx, ty, c00, c01, c02, c11, c12, c22)
    both = quadratic_form(w + x, tx + y, ty + z, c00, c01, c02, c11, c12, c22)
    discord = quadratic_form(x, y, z, c00, c01, c02, c11, c12, c22)
    along = 0.5 * (both - shift - discord) / near  # v' C^-1 delta
    wide = 1.0 + spread * spread * shift / near
    return 0.5 * (np.log(wide) - spread * spread * along * along / wide)


@internal
def _take(chosen, forms, out):  # type: ignore[no-untyped-def]
    """Forms by column (13, n) of the chosen ones; of none (-1), something without meaning."""
    for j in range(chosen.size):
        k = chosen[j]
        for e in range(FORM):
            out[e, j] = forms[k, e] if k >= 0 else 1.0


@internal
def _compare_columns(a, b, shift, offset_prior, slope_prior, discord, evidence):  # type: ignore[no-untyped-def]
    """`compare_forms` of columns of forms (13, .), the second `shift` farther on."""
    for n in range(discord.size):
        j = np.uintp(n)
        k = j + shift
        x, y, z, c00, c01, c02, c11, c12, c22 = _difference(
            a[0, j], a[1, j], a[2, j], a[3, j], a[4, j], a[5, j],
            a[6, j], a[7, j], a[8, j], a[9, j], a[10, j], a[11, j], a[12, j],
            b[0, k], b[1, k], b[2, k], b[3, k], b[4, k], b[5, k],
            b[6, k], b[7, k], b[8, k], b[9, k], b[10, k], b[11, k], b[12, k],
        )  # fmt: skip
        near = determinant(c00, c01, c02, c11, c12, c22)
        discord[j] = quadratic_form(x, y, z, c00, c01, c02, c11, c12, c22) / near
        c00, c11, c22 = c00 + offset_prior[j], c11 + slope_prior[j], c22 + slope_prior[j]
        evidence[j] = 0.5 * logarithm(determinant(c00, c01, c02, c11, c12, c22) / near)


@inlined
def compare_pairs(forms, pairs, offset_prior, slope_prior, discord, evidence):  # type: ignore[no-untyped-def]
    """`compare_forms` of pairs (n, 2) of forms: writes discord and evidence (n,)."""
    a, b = np.empty((FORM, discord.size)), np.empty((FORM, discord.size))
    _take(pairs[:, 0], forms, a)
    _take(pairs[:, 1], forms, b)
    _compare_columns(a, b, _0, offset_prior, slope_prior, discord, evidence)


@compiled
def square_discords(squares, forms, right, below):  # type: ignore[no-untyped-def]
    """Discords of squares side by side, and one below the other.

    squares (rows, columns): form of each, or -1. Writes right and below (rows, columns), without
    meaning where there is no pair.
    """
    rows, columns = squares.shape
    upper, lower = np.empty((FORM, columns)), np.empty((FORM, columns))
    prior, evidence = np.empty(columns), np.empty(columns)  # which nobody asks for
    for j in range(columns):
        prior[j] = 0.0
    _take(squares[0], forms, upper)
    for i in range(rows):
        _compare_columns(upper, upper, _1, prior, prior, right[i, :-1], evidence)
        if i + 1 < rows:
            _take(squares[i + 1], forms, lower)
            _compare_columns(upper, lower, _0, prior, prior, below[i], evidence)
            upper, lower = lower, upper


@compiled
def free_prices(forms, offset_prior, slope_prior, readings, fitted, share, out):  # type: ignore[no-untyped-def]
    """Nats for a plane of its own in every unit of a smooth surface.

    1/2 ln det(C + S0) / det C + fitted, times share[readings]: what a unit of so many is worth. C
    is what the unit would be compared with beside a plane of 100 x 100 pixels, whose own error is
    small beside the unit's.
    """
    for k in range(forms.shape[0]):
        form = forms[k]
        drift = form[SLOW] * form[SLOW]
        bend = _BEND_SMALL * drift * form[INVERSE]
        vxx, vxy, vyy = form[VXX] + bend, form[VXY], form[VYY] + bend
        near = vxx * vyy - vxy * vxy
        far = (vxx + slope_prior[k]) * (vyy + slope_prior[k]) - vxy * vxy
        level = form[V] + PLANE_OFFSET * drift
        out[k] = 0.5 * logarithm((1.0 + offset_prior[k] / level) * far / near) + fitted
    for k in range(forms.shape[0]):
        out[k] *= share[np.intp(readings[k])]
