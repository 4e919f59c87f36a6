"""How flat surfaces are that people call planes.

Walls bulge and floors sag: building tolerances allow a finished wall 5 mm in a metre and 10 mm in
four (DIN 18202), so that one half of it may lean against the other by 0.01. Readings of a scanner
tell a tenth of that, and such a wall would be several planes, or a curved surface. So pieces of one
surface that touch may lean against each other, by an angle that is the same for pieces of any size.
What bulges by more comes in pieces; in a cloud they are one plane if they are nearly flat together.
"""

from __future__ import annotations

LEAN = 0.0007
"""Standard deviation of that angle in radians: with more, planes that meet at 2 degrees are one."""

WARP = 0.01
"""Standard deviation from its plane of a surface that bends and yet is one, against that of its
points in the direction in which they lie closest: that of a strip of a cylinder that turns by 4.4
degrees, and of a wall of 4 m that bulges by 37 mm."""

EDGE = 0.015, 0.002
"""Radians by which surfaces that bend turn where they meet in an edge, and step, against the mean
of their extents: hardly less than a degree, at which flat walls are told apart."""
