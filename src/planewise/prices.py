"""What a plane has to save, by how many readings could see it.

What only looks like a plane saves nats in proportion to the readings that see it, as planes do: so
does what a plane has to save beyond its parameters.
"""

from __future__ import annotations

LEAST = 5.0  # times its parameters: what the readings of a plane have to be shorter by
FAR = 40.0  # times its parameters, by the information on it: no plane is another that is so far
_FULL = 1 << 17  # readings from which on planes cost the same


def fineness(readings: int) -> float:
    """Pixels of an image, or points of a cloud, against those of a fine one, at most 1."""
    return min(1.0, readings / _FULL)


def price(factor: float, parameters: float, fine: float) -> float:
    """Nats that a plane has to save: `factor` times its parameters where `fineness` is 1.

    Examples
    --------
    >>> price(5.0, 30.0, 1.0), price(5.0, 30.0, 0.5), price(5.0, 30.0, 0.01)
    (150.0, 75.0, 30.0)
    """
    return max(1.0, factor * fine) * parameters
