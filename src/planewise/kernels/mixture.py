"""A group labelled with a plane: on it, or with a small probability a surface of its own."""

from __future__ import annotations

import math

from planewise.kernels.elementary import exponential, logarithm
from planewise.kernels.jit import inlined

OWN = 0.05  # that probability
CERTAIN = 40.0  # nats by which one of two is so much shorter that a float64 has no room for both
_ON_ITS_OWN, _IN_COMMON = math.log(OWN), math.log(1.0 - OWN)


@inlined
def of_either(on, alone):  # type: ignore[no-untyped-def]
    """-ln(0.95 exp(-on) + 0.05 exp(-alone))."""
    odds = (_ON_ITS_OWN - alone) - (_IN_COMMON - on)
    nats = alone - _ON_ITS_OWN if odds > 0.0 else on - _IN_COMMON
    return nats - logarithm(1.0 + exponential(-abs(odds)))
