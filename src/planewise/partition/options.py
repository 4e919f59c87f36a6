"""How the planes of regions are sought."""

from __future__ import annotations

from dataclasses import dataclass

from planewise.arguments import make_counts, make_shares


@dataclass(frozen=True, kw_only=True)
class PartitionOptions:
    """How the paper's search goes through the regions of a partition; defaults as in the paper.

    Parameters
    ----------
    confidence : float
        c: probability that a plane's sample is drawn from it alone.
    region_planes : int
        N: most planes of one region.
    region_inlier_ratio : float
        r: share of a region's readings on the smallest plane sought there.
    remainder_planes, remainder_inlier_ratio
        The same of what is in no region.
    """

    confidence: float = 0.99
    region_planes: int = 4
    region_inlier_ratio: float = 0.2
    remainder_planes: int = 8
    remainder_inlier_ratio: float = 0.1

    def __post_init__(self) -> None:
        make_shares(self, "confidence", "region_inlier_ratio", "remainder_inlier_ratio")
        make_counts(self, "region_planes", "remainder_planes")
