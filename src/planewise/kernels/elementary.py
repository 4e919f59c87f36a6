"""Logarithms and powers written out, so that loops which take many are vector code.

A call of the C library's ends a vector loop; these few multiplications are part of one.
"""

from __future__ import annotations

import math

import numpy as np

from planewise.kernels.jit import inlined

_LN2 = math.log(2.0)
_LN2_HIGH, _LN2_LOW = 0.693145751953125, 1.42860682030941723e-6  # exact, times whole numbers
_LEAST = -700.0  # whose power of e is 1e-304
_FRACTION = np.int64((1 << 52) - 1)  # bits of a float64 that are not its exponent
_BIAS = np.int64(1023)  # what exponents are written with
_ROOT_HALF = np.int64(np.float64(math.sqrt(0.5)).view(np.int64))


@inlined
def logarithm(x):  # type: ignore[no-untyped-def]
    """ln x of a normal number x > 0, off by two units in the last place at most.

    x = 2^e m with m from sqrt(1/2) to sqrt(2), and ln m = 2 artanh((m - 1) / (m + 1)), whose series
    in at most 0.172 is taken as far as a float64 can tell. Of 0 and less it is without meaning.
    """
    shifted = np.float64(x).view(np.int64) - _ROOT_HALF
    m = np.int64((shifted & _FRACTION) + _ROOT_HALF).view(np.float64)
    s = (m - 1.0) / (m + 1.0)
    # In pairs (Estrin): one after the other, terms would wait for each other.
    q = s * s
    q2 = q * q
    q4 = q2 * q2
    low = (1 / 3 + q * (1 / 5)) + q2 * (1 / 7 + q * (1 / 9))
    high = (1 / 11 + q * (1 / 13)) + q2 * (1 / 15 + q * (1 / 17))
    tail = q * ((low + q4 * high) + q4 * q4 * (1 / 19 + q * (1 / 21)))
    return (shifted >> 52) * _LN2 + (2.0 * s + 2.0 * s * tail)


@inlined
def exponent(x):  # type: ignore[no-untyped-def]
    """k with 2^k <= x < 2^(k + 1) of a normal number x > 0."""
    return (np.float64(x).view(np.int64) >> 52) - _BIAS


@inlined
def power_of_two(k):  # type: ignore[no-untyped-def]
    """2^k."""
    return np.int64((np.int64(k) + _BIAS) << 52).view(np.float64)


@inlined
def exponential(x):  # type: ignore[no-untyped-def]
    """e^x of x <= 0, off by two units in the last place at most (`jit.in_order`); e^-700 below.

    x = n ln 2 + r with r to either side of 0, and e^r by its series.
    """
    x = max(x, _LEAST)
    n = np.int64(x / _LN2 - 0.5)
    r = (x - n * _LN2_HIGH) - n * _LN2_LOW
    tail = 1 / 40320 + r * (1 / 362880 + r * (1 / 3628800 + r * (1 / 39916800 + r / 479001600)))
    tail = 1 / 6 + r * (1 / 24 + r * (1 / 120 + r * (1 / 720 + r * (1 / 5040 + r * tail))))
    return (1.0 + (r + r * r * (0.5 + r * tail))) * power_of_two(n)
