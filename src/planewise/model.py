"""Results: a plane, a ranked model of planes, and the curve that fixed their number."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import checked_count
from planewise.wording import counted

Array = NDArray[np.float64]

MAX_PLANES = 65_535
"""As many as labels of 16 bits can name."""

NOTHING_PAYS = "no plane saves more than it costs"
"""Why there is none, where a search looked at some."""


def limited_to(max_planes: int) -> str:
    """Why there are no more, where the limit was reached."""
    return f"reached max_planes = {max_planes}"


def reason_of(planes: int, significance: float) -> str:
    """Why a search that merges stopped, with so many planes."""
    if planes:
        return "no merge saves anything"
    more = f" by more than significance = {significance:g} nats" if significance else ""
    return f"{NOTHING_PAYS}{more}; flat pieces of curved surfaces are none"


def assumed_noise(settings: Mapping[str, object]) -> str:
    """What noise was assumed where it could not be estimated, and why; else empty."""
    noise = settings.get("noise")
    return str(noise["note"]) if isinstance(noise, Mapping) else ""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)  # arrays do not compare to one bool
class Plane:
    """One detected plane: normal . x + distance = 0 in the frame of the input.

    Attributes
    ----------
    normal : ndarray, shape (n,)
        Unit normal. It faces the origin (the sensor): distance is never negative.
    distance : float
        Metres from the origin.
    information : float
        Nats that its readings save against being outliers, ln(R / eps) each on a ray, n ln(R / eps)
        in n dimensions; negative, the lower the better.
    count : int
        Readings on it; of points their copies, too, which all else knows nothing of.
    rms : float
        Root mean square residual in metres: along the ray for depth images, across the plane for
        range images and points.
    centroid : ndarray, shape (n,)
        Mean of its readings in space, metres.
    covariance : ndarray, shape (n + 1, n + 1)
        Of (normal, distance): the inverse Fisher information under the error model, and how far an
        error that drifts moves and tilts a plane of a depth image as a whole (spatial objective;
        under the paper's only white noise counts, a hundredth of what a Kinect's plane is off). NaN
        where the readings do not determine it, such as points about a line, in a strip hardly wider
        than their noise. For points in space with independent errors it is too large by a factor of
        1 + 0.09 n for n points a cell (about two at n = 10, far more in dense clouds), because
        points of one cell are taken to share part of their error. It knows
        no bias: under the paper's objective noise that goes with z^p brings planes nearer, by some
        2 p (sigma / z)^2 of their distance, and tilts planes that meet, by up to several standard
        deviations, for readings near the crease choose the nearer one; a wall that is most of the
        view may be two planes there, 0.8 sigma before and behind it, which is many deviations. Nor
        does it know that readings round alike where depth hardly changes along rows or columns,
        which noise below a third of a step does not even out, or of a drift that is too small to be
        told from white noise.
    significance : float
        Nats the plane saves against a smooth surface after paying for its parameters and its
        border, by the prices of the search: a score to cut by, not what Phi would be without it
        (spatial objective; NaN under the paper's; in images of fewer than 2^17 pixels a small face
        may have paid for a part of its parameters alone). In a cloud of at most 4,096 points it is
        what Phi says of its points, without a border: several times as much as in larger ones, so
        that scores of the two do not compare.
    residual_correlation : float
        Correlation of the residuals of neighbouring cells: 0 where they are white, towards 1 where
        the surface bends or the error drifts (spatial objective; NaN with too few cells).
    area : float
        Area its readings cover, in square metres; of points in space that of its cells, up to
        two fifths too large where noise is as thick as these, and up to twice where the plane lies
        along sides of cells. Of a cloud of at most 4,096 points it is that of a rectangle which
        scatters as its points do, or of cells that hold them, whichever is smaller: some two fifths
        too large where the surface is a few points wide. NaN of points in other dimensions, and of
        points under the paper's objective.
    bounding_box : tuple of int
        (top, left, bottom, right) in pixels, the last two exclusive; empty for free points. In an
        image all the way round, the shortest run of columns that holds the plane: across the end of
        the image, right is more than its width, and columns count on from there.
    """

    normal: Array
    distance: float
    information: float
    count: int
    rms: float
    centroid: Array
    covariance: Array
    significance: float = float("nan")
    residual_correlation: float = float("nan")
    area: float = float("nan")
    bounding_box: tuple[int, ...] = ()

    @property
    def coefficients(self) -> Array:
        """(normal, distance) as one row."""
        return np.append(self.normal, self.distance)

    @property
    def mean_information(self) -> float:
        """Nats saved per reading."""
        return self.information / self.count if self.count else 0.0

    def __repr__(self) -> str:
        normal = ", ".join(f"{part:.4f}" for part in self.normal)
        return (
            f"<Plane: normal ({normal}), distance {self.distance:.4f} m, "
            f"{counted(self.count, 'reading')}, "
            f"{self.information:,.0f} nats>"
        )


@dataclass(frozen=True, kw_only=True)
class Move:
    """A step of a search: what it did, how many planes there were after it, and Phi then.

    Attributes
    ----------
    kind : str
        What it did, a word such as "add", "cut", "merge", "refit" or "reassign".
    planes : int
        Number of planes after it.
    information : float
        Phi in nats after it.
    """

    kind: str
    planes: int
    information: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """Information against the number of planes; indexing gives Phi after so many planes.

    Attributes
    ----------
    information : ndarray, shape (M + 1,)
        Phi in nats after 0, 1 ... M planes. M may exceed the chosen number, to show what one more
        plane would have cost. Where planes merged after the search, those that were left. What
        `reassign` adds afterwards is among the moves alone.
    chosen : int
        Number of planes at the minimum; of the default search among models in which every plane
        describes its own readings in fewer nats than no plane would: Phi may be lower in others
        (`moves`). With `max_planes` that many at most: Phi may be lower with fewer.
    reason : str
        Why the search stopped.
    moves : tuple of Move
        What the search did, in order.
    """

    information: Array
    chosen: int
    reason: str
    moves: tuple[Move, ...] = ()

    def __len__(self) -> int:
        return len(self.information)

    def __getitem__(self, planes: int) -> float:
        return float(self.information[planes])

    def __iter__(self) -> Iterator[float]:
        return map(float, self.information)

    def then(self, kind: str, planes: int, information: float) -> Curve:
        """The same curve, and one more move that came after the search."""
        move = Move(kind=kind, planes=planes, information=information)
        return replace(self, moves=(*self.moves, move))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PlaneModel:
    """Planes of an observation, best first, and which reading belongs to which.

    Models, curves and planes are equal where they are the same object, and hashable.

    Attributes
    ----------
    labels : ndarray of uint16
        Of the shape of the input: 0 for no plane, j for ``planes[j - 1]``.
    planes : tuple of Plane
        Ranked by information, most negative first.
    information : float
        Phi of the whole model in nats.
    curve : Curve
        Phi against the number of planes, and why the search stopped.
    readings : int
        Valid readings, k; copies of points are among them, but not in Phi.
    prefix : tuple of float
        Phi of the models of the best 0, 1 ... N planes.
    search, objective : str
        What found it and what it minimises.
    note : str
        Why there is no plane, where there is none; what noise was assumed, where "auto" could not
        tell it; and whether readings look like something else than they are taken for: depth,
        distances or disparity; or planes as if bent by a lens. Else empty.
    settings : Mapping
        Options the model was made with, in plain types, for result files.
    """

    labels: NDArray[np.uint16]
    planes: tuple[Plane, ...]
    information: float
    curve: Curve
    readings: int
    prefix: tuple[float, ...]
    search: str
    objective: str
    note: str = ""
    settings: Mapping[str, object] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.planes)

    def with_note(self, said: str) -> PlaneModel:
        """Return the same model with this in its note, too."""
        if not said or said in self.note:
            return self
        return replace(self, note="; ".join(filter(None, (self.note, said))))

    def __repr__(self) -> str:
        phi = f"Phi = {self.information:,.0f} nats"
        planes, readings = counted(len(self), "plane"), counted(self.readings, "reading")
        return f"<PlaneModel: {planes}, {phi}, {readings}>"

    @property
    def coefficients(self) -> Array:
        """Rows (normal, distance) of all planes, shape (N, n + 1); (0, 4) where there is none."""
        if not self.planes:
            return np.empty((0, 4))
        return np.array([plane.coefficients for plane in self.planes])

    def top(self, k: int) -> PlaneModel:
        """Keep the `k` best planes; readings of the others become label 0.

        Parameters
        ----------
        k : int
            Planes to keep; at least 0.

        Returns
        -------
        PlaneModel
            Its `information` is Phi of the smaller model with these labels.
        """
        k = checked_count("k", k, 0)
        if k >= len(self.planes):
            return self
        return replace(
            self,
            labels=np.where(self.labels <= k, self.labels, 0).astype(np.uint16),
            planes=self.planes[:k],
            information=self.prefix[k],
            prefix=self.prefix[: k + 1],
            note=self.note if k else "none of the planes was kept",
        )


def checked_model(model: object) -> PlaneModel:
    """Refuse what is no model.

    Raises
    ------
    ValueError
        If it is not a `PlaneModel`.
    """
    if not isinstance(model, PlaneModel):
        raise ValueError(
            "model must be a PlaneModel, such as detect_planes returns, "
            f"got a {type(model).__name__}"
        )
    return model
