"""Loops that tell whether the readings of a strip bend across it."""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.faces import place_of
from planewise.kernels.jit import called, compiled

_TERMS = 4  # of a cubic
_SINGULAR = 1e-9  # of its square: what is left of a term that the others make up


@compiled
def profiles(  # type: ignore[no-untyped-def]
    pixels, first, stop, w, p, x, y, white, planes, many, beside, wide, longer, out, sides
):
    """Fit straight lines and cubics to what lies off the planes of strips, across them.

    Of strip s, pixels[first[s]:stop[s]] and planes (n, 3), (t0, t1, t2): to every so many of its
    pixels that about `many` count, and then without those less than `beside` from either side of a
    rectangle with its scatter. p / white are precisions of w. Writes sides (n, 2): width and
    length; and out (n, 2, 3): chi^2 of the line, that of the cubic, and readings, 0 of what is not
    less wide than `wide` and `longer` times as long as that.
    """
    columns, alike = w.shape[1], x.shape[0] == 1
    for s in range(first.size):
        size, t0, t1, t2 = stop[s] - first[s], planes[s, 0], planes[s, 1], planes[s, 2]
        step = (size // many) | 1
        count = (size + step - 1) // step
        points = np.empty((4, count))
        u, v, h, q = points[0], points[1], points[2], points[3]
        mx = my = xx = xy = yy = 0.0
        for k in range(count):
            i, j = place_of(pixels[first[s] + k * step], columns)
            a, b = x[0 if alike else i, j], y[i, 0 if alike else j]
            u[k], v[k], h[k], q[k] = a, b, w[i, j] - t0 - t1 * a - t2 * b, p[i, j] / white
            mx += a
            my += b
        mx /= count
        my /= count
        for k in range(count):
            u[k] -= mx
            v[k] -= my
            xx += u[k] * u[k]
            xy += u[k] * v[k]
            yy += v[k] * v[k]
        half, apart = 0.5 * (xx + yy) / count, math.hypot(0.5 * (xx - yy), xy) / count
        # A side of a rectangle is sqrt(12) times the standard deviation along it.
        width, length = math.sqrt(12.0 * max(half - apart, 0.0)), math.sqrt(12.0 * (half + apart))
        sides[s, 0], sides[s, 1] = width, length
        if not (width < wide and longer * width < length):
            out[s] = 0.0
            continue
        along = 0.5 * math.atan2(2.0 * xy, xx - yy)
        scale = 2.0 / max(width, 1e-12)
        cos, sin = -math.sin(along) * scale, math.cos(along) * scale
        for k in range(count):
            u[k] = cos * u[k] + sin * v[k]
        _fit(u, h, q, np.inf, out[s, 0])
        _fit(u, h, q, 1.0 - beside * scale, out[s, 1])


@called
def _fit(across, heights, precisions, reach, out):  # type: ignore[no-untyped-def]
    """Write chi^2 (3,) of a line, of a cubic, and how many points across lie within reach."""
    m0 = m1 = m2 = m3 = m4 = m5 = m6 = h0 = h1 = h2 = h3 = square = 0.0
    count = 0
    for k in range(across.size):  # without a branch: vector code
        u, h, q = across[k], heights[k], precisions[k]
        inside = abs(u) < reach
        q = q if inside else 0.0
        count += inside
        qu, quu, quuu = q * u, q * u * u, q * u * u * u
        m0 += q
        m1 += qu
        m2 += quu
        m3 += quuu
        m4 += quuu * u
        m5 += quuu * u * u
        m6 += quuu * u * u * u
        h0 += q * h
        h1 += qu * h
        h2 += quu * h
        h3 += quuu * h
        square += q * h * h
    m, high = (m0, m1, m2, m3, m4, m5, m6), (h0, h1, h2, h3)
    table = np.empty((_TERMS + 1, _TERMS + 1))
    for e in range(_TERMS):
        table[e, _TERMS] = high[e]
        for f in range(_TERMS):
            table[e, f] = m[e + f]
    table[_TERMS, _TERMS] = square
    # Gauss: what is left of the last square once the terms are eliminated.
    for e in range(_TERMS):
        if e == 2:
            out[0] = table[_TERMS, _TERMS]
        if table[e, e] > _SINGULAR * m[2 * e]:
            for f in range(e + 1, _TERMS + 1):
                share = table[e, f] / table[e, e]
                for g in range(f, _TERMS + 1):
                    table[f, g] -= share * table[e, g]
    out[1], out[2] = table[_TERMS, _TERMS], count
