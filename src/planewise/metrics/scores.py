"""How well a plane segmentation agrees with a true one.

Two label images are compared: 0 is no plane, every other value is one plane; labels need not be
consecutive. All numbers follow from their contingency table. Which pixels count, and what becomes
of label 0, is a policy:

``labelled``
    Pixels with a true plane; predicted 0 is one more segment. What the literature on plane
    segmentation reports. It can reward losing a plane: whatever is lost is still a segment.
``k_best``
    The same after all but the n largest predicted planes became 0, n the number of true planes
    (sizes over the whole frame, the lower label first where two are equal).
``frame``
    All pixels; label 0 is a region like any other on both sides.
``valid``
    As ``frame``, but only pixels with a reading.

>>> import numpy as np
>>> truth = np.repeat([[1, 2]], 4, axis=0).repeat(4, axis=1)
>>> predicted = np.where(truth == 2, 7, 0)
>>> scores = evaluate(predicted, truth, minimum_pixels=1)
>>> scores.labelled.variation_of_information, scores.detections[0].recall, scores.hoover.missed
(0.0, 0.5, 1)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import is_finite, plane_rows
from planewise.metrics.confidence import Interval, mean_interval
from planewise.metrics.contingency import (
    Clustering,
    ContingencyTable,
    clustering,
    contingency_table,
)
from planewise.metrics.hoover import HooverCounts, hoover_counts

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

MINIMUM_PIXELS = 400
"""True planes smaller than this are neither hit nor miss, unless asked for otherwise."""

_SHARES = "ri_", "sc_", "precision@", "recall@", "f1@"
"""Names of scores that cannot be above 1; none can be below 0."""


@dataclass(frozen=True, kw_only=True)
class Detection:
    """Planes found at an intersection over union (IoU).

    Attributes
    ----------
    iou : float
        A pair of planes matches when its IoU over the whole frame is larger.
    hits : int
        True planes, large enough to count, that are matched.
    predictions : int
        Predictions that count: all but those that match a true plane too small to.
    precision : float
        Hits among the predictions that count; 0 where there is none.
    recall : float
        Hits among the true planes that count; NaN where there is none.
    f1 : float
        Harmonic mean of both, 0 where both are; NaN where the recall is.
    """

    iou: float
    hits: int
    predictions: int
    precision: float
    recall: float
    f1: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneErrors:
    """Errors of the planes that were found.

    Attributes
    ----------
    truth_labels, predicted_labels : ndarray of int64, shape (n,)
        The matched pairs.
    normals : ndarray, shape (n,)
        Angle between the normals in degrees, 0 ... 90.
    distances : ndarray, shape (n,)
        Difference of the distances to the origin in metres, at least 0.
    """

    truth_labels: Counts
    predicted_labels: Counts
    normals: Array
    distances: Array

    @property
    def mean_normal(self) -> float:
        """Mean angle in degrees; NaN where nothing matched."""
        return float(self.normals.mean()) if self.normals.size else math.nan

    @property
    def mean_distance(self) -> float:
        """Mean difference in metres; NaN where nothing matched."""
        return float(self.distances.mean()) if self.distances.size else math.nan


@dataclass(frozen=True, kw_only=True)
class FrameScores:
    """Everything about one frame.

    Attributes
    ----------
    predicted_planes, true_planes, counted_planes : int
        Planes predicted, true ones, and true ones that are large enough to count.
    labelled, k_best, frame : Clustering
        Under these policies; see the module.
    valid : Clustering, optional
        Over the pixels with a reading, where it is known which have one.
    detections : tuple of Detection
        At each IoU asked for.
    hoover : HooverCounts
        The five counts of Hoover et al.
    errors : PlaneErrors, optional
        Of the planes matched at the first IoU, where the parameters of both sides are given.
    """

    predicted_planes: int
    true_planes: int
    counted_planes: int
    labelled: Clustering
    k_best: Clustering
    frame: Clustering
    valid: Clustering | None
    detections: tuple[Detection, ...]
    hoover: HooverCounts
    errors: PlaneErrors | None

    def row(self) -> dict[str, float]:
        """All numbers by name, for tables, files and means; NaN is "not defined".

        A clustering of fewer than two pixels is not, though it is a perfect one by itself, nor is
        the precision where no plane is predicted or true, which is 0 by itself.
        """
        out: dict[str, float] = {
            "planes_predicted": self.predicted_planes,
            "planes_true": self.true_planes,
            "planes_counted": self.counted_planes,
        }
        undefined = Clustering(
            variation_of_information=math.nan, rand_index=math.nan, covering=math.nan, pixels=0
        )
        for policy in ("labelled", "k_best", "frame", "valid"):
            each = getattr(self, policy)
            if each is None or each.pixels < 2:
                each = undefined
            out[f"voi_{policy}"] = each.variation_of_information
            out[f"ri_{policy}"] = each.rand_index
            out[f"sc_{policy}"] = each.covering
        for found in self.detections:
            planes = found.predictions or self.counted_planes
            out[f"precision@{found.iou:g}"] = found.precision if planes else math.nan
            out[f"recall@{found.iou:g}"] = found.recall
            out[f"f1@{found.iou:g}"] = found.f1
        for kind in ("correct", "over", "under", "missed", "noise"):
            out[f"hoover_{kind}"] = getattr(self.hoover, kind)
        out["normal_error_deg"] = self.errors.mean_normal if self.errors else math.nan
        out["distance_error_m"] = self.errors.mean_distance if self.errors else math.nan
        return out


def detection(
    table: ContingencyTable, *, iou: float = 0.5, minimum_pixels: int = MINIMUM_PIXELS
) -> Detection:
    """Precision, recall and F1 of planes.

    Parameters
    ----------
    table : ContingencyTable
        Of the whole frame.
    iou : float
        A pair matches above it; at least 0.5, so that no plane matches twice.
    minimum_pixels : int
        True planes smaller than this are neither hit nor miss, and predictions that match one are
        neither hit nor false alarm.

    Raises
    ------
    ValueError
        If a setting is out of range.
    """
    matched, counted = _matches(table, iou, minimum_pixels)
    hits = int(matched[counted].sum())
    predictions = matched.shape[1] - int(matched[~counted].sum())
    precision = hits / predictions if predictions else 0.0
    recall = hits / int(counted.sum()) if counted.any() else math.nan
    both = precision + recall
    f1 = 0.0 if both == 0 else 2 * precision * recall / both
    return Detection(
        iou=iou, hits=hits, predictions=predictions, precision=precision, recall=recall, f1=f1
    )


def _matches(
    table: ContingencyTable, iou: float, minimum_pixels: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which pairs of planes match, shape (G, P), and which true planes count, shape (G,)."""
    if not (is_finite(iou) and 0.5 <= iou < 1):
        raise ValueError(f"iou must be at least 0.5 and below 1, got {iou!r}")
    if not (is_finite(minimum_pixels) and minimum_pixels >= 0):
        raise ValueError(f"minimum_pixels must be a number, not negative, got {minimum_pixels!r}")
    return table.overlaps() > iou, table.truth_sizes[1:] >= minimum_pixels


def plane_errors(
    table: ContingencyTable,
    predicted_planes: ArrayLike,
    truth_planes: ArrayLike,
    *,
    iou: float = 0.5,
    minimum_pixels: int = MINIMUM_PIXELS,
) -> PlaneErrors:
    """Normal and distance errors of the planes that match.

    Parameters
    ----------
    table : ContingencyTable
        Of the whole frame.
    predicted_planes, truth_planes : array_like, shape (N, 4), or sequence of Plane
        Rows (normal, distance) of any scale and sign; row j - 1 belongs to label j.
    iou, minimum_pixels
        Which planes match, as in `detection`.

    Raises
    ------
    ValueError
        If the parameters of a label are missing or no plane.
    """
    matched, counted = _matches(table, iou, minimum_pixels)
    row, column = np.nonzero(matched & counted[:, None])
    true, found = table.truth_labels[1:][row], table.predicted_labels[1:][column]
    a = _coefficients("truth_planes", truth_planes, table.truth_labels)[true - 1]
    b = _coefficients("predicted_planes", predicted_planes, table.predicted_labels)[found - 1]
    cosine = np.einsum("ij,ij->i", a[:, :3], b[:, :3])
    sine = np.linalg.norm(np.cross(a[:, :3], b[:, :3]), axis=1)
    sign = np.where(cosine < 0, -1.0, 1.0)
    return PlaneErrors(
        truth_labels=true,
        predicted_labels=found,
        normals=np.degrees(np.arctan2(sine, np.abs(cosine))),
        distances=np.abs(a[:, 3] - sign * b[:, 3]),
    )


def _coefficients(name: str, planes: ArrayLike, labels: Counts) -> Array:
    rows = plane_rows(name, planes, 4)
    if len(rows) < labels[-1]:
        raise ValueError(f"{name} must have shape ({labels[-1]}, 4), got {rows.shape}")
    length = np.linalg.norm(rows[:, :3], axis=1)
    if not (np.isfinite(rows).all() and (length > 0).all()):
        raise ValueError(f"{name} must be finite, with normals other than 0")
    return np.asarray(rows / length[:, None])


def evaluate(
    predicted: ArrayLike,
    truth: ArrayLike,
    *,
    valid: ArrayLike | None = None,
    predicted_planes: ArrayLike | None = None,
    truth_planes: ArrayLike | None = None,
    iou: Sequence[float] = (0.5, 0.8),
    minimum_pixels: int = MINIMUM_PIXELS,
    tolerance: float = 0.8,
) -> FrameScores:
    """Score one frame in every way.

    Parameters
    ----------
    predicted, truth : array_like of int, same shape
        Labels, at least 0; 0 is no plane, and so is what is masked in a masked array.
    valid : array_like of bool, same shape, optional
        Pixels with a reading, what is masked not among them.
    predicted_planes, truth_planes : array_like, shape (N, 4), or sequence of Plane, optional
        Parameters of both, for their errors; see `plane_errors`.
    iou : sequence of float
        Where to count planes as found; see `detection`.
    minimum_pixels : int
        Smallest true plane that counts; see `detection`.
    tolerance : float
        Of the five counts; see `hoover_counts`.

    Returns
    -------
    FrameScores
        All numbers.

    Raises
    ------
    ValueError
        If an argument is malformed; the message names it and says what was expected.
    """
    if np.ndim(iou) != 1 or not len(iou):
        raise ValueError(f"iou must be a sequence of at least one number, got {iou!r}")
    if (predicted_planes is None) != (truth_planes is None):
        missing = "predicted_planes" if predicted_planes is None else "truth_planes"
        raise ValueError(f"{missing} must be given where the parameters of the other side are")
    table = contingency_table(predicted, truth)
    detections = tuple(detection(table, iou=at, minimum_pixels=minimum_pixels) for at in iou)
    errors, over_valid = None, None
    if predicted_planes is not None and truth_planes is not None:
        errors = plane_errors(
            table, predicted_planes, truth_planes, iou=iou[0], minimum_pixels=minimum_pixels
        )
    if valid is not None:
        over_valid = clustering(contingency_table(predicted, truth, valid=valid).counts)
    return FrameScores(
        predicted_planes=len(table.predicted_labels) - 1,
        true_planes=len(table.truth_labels) - 1,
        counted_planes=int((table.truth_sizes[1:] >= minimum_pixels).sum()),
        labelled=clustering(table.counts[1:]),
        k_best=clustering(table.k_best()[1:]),
        frame=clustering(table.counts),
        valid=over_valid,
        detections=detections,
        hoover=hoover_counts(table.counts, tolerance=tolerance),
        errors=errors,
    )


def summarise(rows: Iterable[dict[str, float]], *, coverage: float = 0.95) -> dict[str, Interval]:
    """Mean and confidence interval of every number over frames, cut to what the number can be.

    Parameters
    ----------
    rows : iterable of dict
        `FrameScores.row` of every frame.
    coverage : float
        See `mean_interval`.

    Returns
    -------
    dict of Interval
        In the order of the first frame's names.
    """
    frames = list(rows)
    names = list(dict.fromkeys(name for frame in frames for name in frame))
    out = {}
    for name in names:
        found = mean_interval([frame.get(name, math.nan) for frame in frames], coverage=coverage)
        most = 1.0 if name.startswith(_SHARES) else math.inf
        out[name] = replace(found, low=max(found.low, 0.0), high=min(found.high, most))
    return out
