"""Waves: errors that come again along range, depth or disparity, and how frames show them."""

from planewise.waves.waves import ALONG, Along, Wave, Waves

__all__ = ["ALONG", "Along", "Wave", "Waves"]
