"""How to search: the options of every door, checked once."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Literal, TypedDict

import numpy as np

from planewise.arguments import (
    checked_seed,
    is_finite,
    is_whole,
    make_counts,
    make_plain,
    make_shares,
)
from planewise.model import MAX_PLANES
from planewise.objective import SPATIAL, Objective, as_objective
from planewise.paper.reassign import NormalReassignment, as_reassignment
from planewise.paper.sequential import trial_count
from planewise.partition import (
    Partition,
    Partitioner,
    PartitionOptions,
    as_partitioner,
    describe,
)

Search = Literal["joint", "sequential"]
Seed = int | np.random.Generator


class GivenOptions(TypedDict, total=False):
    """Some fields of `Options`, for those who check types."""

    search: Search
    objective: Objective | str | None
    instances: bool
    significance: float
    confidence: float
    inlier_ratio: float
    max_planes: int | None
    reassign: NormalReassignment | Literal["normals"] | None
    partition: Partition | None
    partition_options: PartitionOptions
    rng: Seed
    threads: int | None


_MAX_PLANES = {"joint": 64, "sequential": 8}


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to search.

    Parameters
    ----------
    search : {"joint", "sequential"}
        All planes together, or the paper's one after the other.
    objective : {"spatial", "paper"} or Objective, optional
        What is minimised: a spatial mask code with correlated error and a smooth null (depth
        images and points in space, joint search), or the paper's objective. ``None`` means the
        first where it can be had, else the second.
    instances : bool
        Tell surfaces of one plane that do not touch apart (spatial objective): each is a plane of
        its own, with the parameters that they share.
    significance : float
        Nats that a plane has to save beyond its parameters and its border (spatial objective), and
        each of its pieces, where it is seen in several: the larger, the fewer planes. Readings of a
        plane that fails this are labelled 0, or go to a neighbouring plane. Clouds of at most 4,096
        points count otherwise (`Plane.significance`).
    confidence : float
        c of the paper: probability that a plane's sample is drawn from it alone (sequential without
        a partition; other searches ignore it and the next).
    inlier_ratio : float
        r of the paper: share of the readings on the smallest plane sought (sequential). Samples go
        with 1 / r^n: at the default every further dimension of points takes ten times as many, six
        of them minutes for 2,000 points, and from seven on a larger share has to be given.
    max_planes : int, optional
        Largest number of planes; under the spatial objective the best of all that there are, as
        `PlaneModel.top` gives them. Under the paper's a search goes no further than that, and may
        then drop some. ``None`` means 8 for the sequential search, as in the paper, and 64 for the
        joint one under the paper's objective. There is no limit under the spatial objective, nor
        for the sequential search with a partition.
    reassign : {"normals"} or NormalReassignment, optional
        The paper's step after the search: readings that fit several planes go to the one whose
        normal and distance are most like those of the surface around them. For depth images under
        the paper's objective; the planes stay and Phi, exact for the new labels, may rise.
    partition : str, callable or array_like, optional
        Regions of a depth image, in which the sequential search looks for planes and the joint one
        for further candidates, which cannot raise Phi: "graph" or "auto", "blocks", "sam", a label
        image (H, W), masks (N, H, W), or a function (`planewise.partition`).
    partition_options : PartitionOptions
        How the paper's search goes through the regions.
    rng : int or numpy.random.Generator
        Seed. With an int every call gives the same answer for the same input.
    threads : int, optional
        Threads for the compiled loops; ``None`` means one per processor. No result depends on it.

    Raises
    ------
    ValueError
        If an option is malformed, or does not go with the search or the objective.
    """

    search: Search = "joint"
    objective: Objective | str | None = None
    instances: bool = False
    significance: float = 0.0
    confidence: float = 0.99
    inlier_ratio: float = 0.1
    max_planes: int | None = None
    reassign: NormalReassignment | Literal["normals"] | None = None
    partition: Partition | None = None
    partition_options: PartitionOptions = field(default_factory=PartitionOptions)
    rng: Seed = 0
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.partition is not None:
            object.__setattr__(self, "partition", as_partitioner(self.partition))
        if not isinstance(self.search, str) or self.search not in _MAX_PLANES:
            raise ValueError(f"search must be 'joint' or 'sequential', got {self.search!r}")
        if not (is_finite(self.significance) and self.significance >= 0):
            raise ValueError(
                f"significance must be a number of nats, not negative, got {self.significance!r}"
            )
        if not isinstance(self.partition_options, PartitionOptions):
            raise ValueError(
                "partition_options must be a planewise.partition.PartitionOptions, got "
                f"{self.partition_options!r}"
            )
        if not isinstance(self.instances, bool | np.bool_):
            raise ValueError(f"instances must be True or False, got {self.instances!r}")
        given = next((name for name in ("instances", "significance") if getattr(self, name)), None)
        if self.objective not in (None, SPATIAL):
            as_objective(self.objective)
            if given:
                raise ValueError(f"{given} needs objective='spatial', got another objective")
        elif self.search != "joint" and self.objective == SPATIAL:
            raise ValueError("objective='spatial' needs search='joint', got another search")
        elif self.search != "joint" and given:
            raise ValueError(f"{given} needs search='joint', got another search")
        make_shares(self, "confidence", "inlier_ratio")
        as_reassignment(self.reassign)
        if self.reassign is not None and self._spatial:
            raise ValueError(
                "reassign needs objective='paper' or search='sequential', got objective='spatial', "
                "whose mask code sees to neighbours itself"
            )
        most = self.max_planes
        if most is not None and not (is_whole(most) and 1 <= most <= MAX_PLANES):
            raise ValueError(
                f"max_planes must lie in 1 ... {MAX_PLANES}, a whole number, got {most!r}"
            )
        if self.threads is not None:
            make_counts(self, "threads")
        make_plain(self, float, "significance")
        make_plain(self, int, "max_planes")
        make_plain(self, bool, "instances")
        object.__setattr__(self, "rng", checked_seed("rng", self.rng))

    def resolved(self, spatial: bool) -> Options:
        """These options with an objective; spatial: whether the observation may have that one."""
        if self.objective is not None:
            return self
        return replace(self, objective=SPATIAL if spatial and self.search == "joint" else "paper")

    def check_samples(self, dimension: int) -> None:
        """Refuse a search whose samples in so many dimensions would take too long.

        Raises
        ------
        ValueError
            Which says what share of the readings is large enough.
        """
        how = self.partition_options
        if self.partition is not None and self.objective != SPATIAL:
            for name in ("region_inlier_ratio", "remainder_inlier_ratio"):
                trial_count(how.confidence, getattr(how, name), dimension, name)
        elif self.search == "sequential":
            trial_count(self.confidence, self.inlier_ratio, dimension)

    def describe(self) -> dict[str, object]:
        """Say in plain types what was asked for, for result files."""
        out: dict[str, object] = {
            "search": self.search,
            "objective": "custom" if isinstance(self.objective, Objective) else self.objective,
            "max_planes": self.most_planes if self.most_planes < MAX_PLANES else None,
            "instances": self.instances,
            "significance": self.significance,
            "rng": self.rng if isinstance(self.rng, int) else "generator",
        }
        if self.search == "sequential" and self.partition is None:
            out |= {"confidence": self.confidence, "inlier_ratio": self.inlier_ratio}
        if reassign := as_reassignment(self.reassign):
            out["reassign"] = {"normals": asdict(reassign)}
        if self.partitioner is not None:
            out |= {
                "partition": describe(self.partitioner),
                "partition_options": asdict(self.partition_options),
            }
        return out

    @property
    def partitioner(self) -> Partitioner | None:
        """What makes the regions, if any."""
        return None if self.partition is None else as_partitioner(self.partition)

    @property
    def most_planes(self) -> int:
        """Largest number of planes; where there is no limit, as many as labels tell apart."""
        regions = self.search == "sequential" and self.partition is not None
        unlimited = self._spatial or regions
        return self.max_planes or (MAX_PLANES if unlimited else _MAX_PLANES[self.search])

    @property
    def _spatial(self) -> bool:
        return self.objective == SPATIAL or (self.objective is None and self.search == "joint")
