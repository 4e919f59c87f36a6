"""Symmetric 3 x 3 matrices C by their six numbers: c00, c01, c02, c11, c12, c22."""

from __future__ import annotations

from planewise.kernels.jit import inlined


@inlined
def determinant(c00, c01, c02, c11, c12, c22):  # type: ignore[no-untyped-def]
    """det C."""
    near = c00 * (c11 * c22 - c12 * c12) + c01 * (c02 * c12 - c01 * c22)
    return near + c02 * (c01 * c12 - c02 * c11)


@inlined
def quadratic_form(x, y, z, c00, c01, c02, c11, c12, c22):  # type: ignore[no-untyped-def]
    """(x y z) C^-1 (x y z)' det C."""
    p, q, r = c11 * c22 - c12 * c12, c02 * c12 - c01 * c22, c01 * c12 - c02 * c11
    s, t, u = c00 * c22 - c02 * c02, c01 * c02 - c00 * c12, c00 * c11 - c01 * c01
    return p * x * x + s * y * y + u * z * z + 2.0 * (q * x * y + r * x * z + t * y * z)
