"""An error that wanders like a random walk, and what it makes of planes.

D |r| is the variance of its difference over a distance r. Of squares side by side, in pixels or in
metres (docs/frame-error.md derives it).
"""

from __future__ import annotations

PLANE_OFFSET = 0.13  # variance of the offset of two planes where they meet: D times the larger side
PLANE_BEND = (0.9, 0.3)  # of their slopes: D over the smaller and the larger side
PLANE_SLOPE = 0.89  # variance of the slope of a plane: D over the side
FIELD = 0.26  # mean variance of the error itself about its mean in a square of side 1
PLANE_RESIDUAL = 0.113  # mean variance about the plane of a square of side 1
SATURATION = 0.33  # of the drift of near cells: its share between segments, for it levels off

MEET = 0.5  # of the smaller extent: from its centroid towards the other, to where they meet
TOUCHING = 0.75  # of their extents: centroids closer than that have no gap between them
CHORD = 1.0 / 12.0  # of its side and the angle by which the next one leans: how far the fit of a
# piece of a parabola is off where they meet
