"""How flat surfaces are that people call planes.

Walls bulge and floors sag: building tolerances allow a finished wall 5 mm in a metre and 10 mm in
four (DIN 18202), so that one half of it may lean against the other by 0.01. Readings of a scanner
tell a tenth of that, and such a wall would be several planes, or a curved surface. So pieces of one
surface that touch may lean against each other, by an angle that is the same for pieces of any size.
"""

from __future__ import annotations

LEAN = 0.0007
"""Standard deviation of that angle in radians: with more, planes that meet at 2 degrees are one."""
