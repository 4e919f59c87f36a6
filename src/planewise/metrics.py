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
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.confidence import Interval, mean_interval, student_t
from planewise.hoover import HooverCounts, hoover_counts

__all__ = [
    "Clustering",
    "ContingencyTable",
    "Detection",
    "FrameScores",
    "HooverCounts",
    "Interval",
    "PlaneErrors",
    "clustering",
    "contingency_table",
    "detection",
    "evaluate",
    "hoover_counts",
    "mean_interval",
    "plane_errors",
    "student_t",
    "summarise",
]

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

MINIMUM_PIXELS = 400
"""True planes smaller than this are neither hit nor miss, unless asked for otherwise."""

_MOST_CELLS = 50_000_000


@dataclass(frozen=True, kw_only=True)
class ContingencyTable:
    """Pixels that two label images have in common, label by label.

    Attributes
    ----------
    counts : ndarray of int64, shape (G + 1, P + 1)
        Row g: true label, column p: predicted label; row 0 and column 0 are label 0, always there.
    truth_labels, predicted_labels : ndarray of int64, shapes (G + 1,) and (P + 1,)
        Label of every row and column, ascending from 0.
    """

    counts: Counts
    truth_labels: Counts
    predicted_labels: Counts

    @property
    def truth_sizes(self) -> Counts:
        """Pixels of every true label, shape (G + 1,)."""
        return np.asarray(self.counts.sum(axis=1))

    @property
    def predicted_sizes(self) -> Counts:
        """Pixels of every predicted label, shape (P + 1,)."""
        return np.asarray(self.counts.sum(axis=0))

    def overlaps(self) -> Array:
        """Intersection over union of all pairs of planes, shape (G, P)."""
        common = self.counts[1:, 1:]
        union = self.truth_sizes[1:, None] + self.predicted_sizes[1:] - common
        return np.asarray(common / union)

    def k_best(self) -> Counts:
        """Counts after all but the G largest predicted planes became label 0."""
        order = np.argsort(-self.predicted_sizes[1:], kind="stable") + 1
        kept, lost = np.split(order, [len(self.truth_labels) - 1])
        rest = self.counts[:, np.append(lost, 0)].sum(axis=1, keepdims=True)
        return np.hstack((rest, self.counts[:, kept]))


@dataclass(frozen=True, kw_only=True)
class Clustering:
    """Agreement of two partitions of the same pixels.

    Attributes
    ----------
    variation_of_information : float
        H(truth | predicted) + H(predicted | truth) in bits (Meila 2007); 0 is perfect.
    rand_index : float
        Share of the pairs of pixels on which both agree: together, or apart.
    covering : float
        Segmentation covering: every segment's best intersection over union with one of the other
        side, weighted by size, mean of both directions.
    """

    variation_of_information: float
    rand_index: float
    covering: float


@dataclass(frozen=True, kw_only=True)
class Detection:
    """Planes found at an intersection over union (IoU).

    Attributes
    ----------
    iou : float
        A pair of planes matches when its IoU over the whole frame is larger.
    hits : int
        True planes, large enough to count, that are matched.
    precision : float
        Hits among the predictions that count; 0 where there is none.
    recall : float
        Hits among the true planes that count; NaN where there is none.
    f1 : float
        Harmonic mean of both, 0 where both are; NaN where the recall is.
    """

    iou: float
    hits: int
    precision: float
    recall: float
    f1: float


@dataclass(frozen=True, kw_only=True)
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
        """All numbers by name, for tables and files; NaN is "not defined"."""
        out: dict[str, float] = {
            "planes_predicted": self.predicted_planes,
            "planes_true": self.true_planes,
            "planes_counted": self.counted_planes,
        }
        undefined = Clustering(
            variation_of_information=math.nan, rand_index=math.nan, covering=math.nan
        )
        for policy in ("labelled", "k_best", "frame", "valid"):
            each = getattr(self, policy) or undefined
            out[f"voi_{policy}"] = each.variation_of_information
            out[f"ri_{policy}"] = each.rand_index
            out[f"sc_{policy}"] = each.covering
        for found in self.detections:
            out[f"precision@{found.iou:g}"] = found.precision
            out[f"recall@{found.iou:g}"] = found.recall
            out[f"f1@{found.iou:g}"] = found.f1
        for kind in ("correct", "over", "under", "missed", "noise"):
            out[f"hoover_{kind}"] = getattr(self.hoover, kind)
        out["normal_error_deg"] = self.errors.mean_normal if self.errors else math.nan
        out["distance_error_m"] = self.errors.mean_distance if self.errors else math.nan
        return out


def contingency_table(
    predicted: ArrayLike, truth: ArrayLike, *, valid: ArrayLike | None = None
) -> ContingencyTable:
    """Count the pixels of every pair of a true and a predicted label.

    Parameters
    ----------
    predicted, truth : array_like of int, same shape
        Labels, at least 0; 0 is no plane.
    valid : array_like of bool, same shape, optional
        Pixels to count; ``None`` means all.

    Returns
    -------
    ContingencyTable
        Counts and the labels of its rows and columns.

    Raises
    ------
    ValueError
        If an image does not hold labels, or shapes differ.

    Examples
    --------
    >>> contingency_table([[1, 1, 0]], [[3, 3, 3]]).counts
    array([[0, 0],
           [1, 2]])
    """
    found, true = _labels("predicted", predicted), _labels("truth", truth)
    if found.shape != true.shape:
        raise ValueError(f"predicted must have the shape of truth {true.shape}, got {found.shape}")
    if valid is not None:
        mask = np.asarray(valid)
        if mask.shape != true.shape or mask.dtype != np.bool_:
            raise ValueError(
                f"valid must be bool of shape {true.shape}, got {mask.dtype} of {mask.shape}"
            )
        found, true = found[mask], true[mask]
    columns, column = _numbered(found)
    rows, row = _numbered(true)
    if len(rows) * len(columns) > _MOST_CELLS:
        raise ValueError(
            "predicted and truth must be label images, got images of "
            f"{len(columns)} and {len(rows)} different values"
        )
    counts = np.bincount(row * len(columns) + column, minlength=len(rows) * len(columns))
    return ContingencyTable(
        counts=counts.reshape(len(rows), len(columns)).astype(np.int64),
        truth_labels=rows,
        predicted_labels=columns,
    )


def _labels(name: str, image: ArrayLike) -> NDArray[np.integer]:
    labels = np.asarray(image)
    if labels.dtype.kind not in "iub":
        raise ValueError(f"{name} must hold integer labels, got {labels.dtype}")
    if labels.dtype.kind == "b":
        labels = labels.astype(np.uint8)
    if labels.size and int(labels.min()) < 0:
        raise ValueError(f"{name} must hold labels of at least 0, got {labels.min()}")
    if labels.size and int(labels.max()) > np.iinfo(np.int64).max:
        raise ValueError(f"{name} must hold labels below 2^63, got {labels.max()}")
    return labels


def _numbered(labels: NDArray[np.integer]) -> tuple[Counts, Counts]:
    """Labels that occur, and 0; and for each pixel which of them it has."""
    flat = labels.ravel()
    if flat.size and int(flat.max()) <= np.iinfo(np.uint16).max:  # a lookup is faster than sorting
        there = np.bincount(flat, minlength=1) > 0
        there[0] = True
        return np.flatnonzero(there).astype(np.int64), (np.cumsum(there) - 1)[flat]
    values, place = np.unique(np.append(flat, 0), return_inverse=True)
    return values.astype(np.int64), place[:-1].astype(np.int64)


def clustering(counts: ArrayLike) -> Clustering:
    """Variation of information, Rand index and covering of two partitions.

    Parameters
    ----------
    counts : array_like, shape (G, P)
        Pixels that segment g of one and segment p of the other share; empty segments are allowed.

    Returns
    -------
    Clustering
        Perfect where there are fewer than two pixels.

    Raises
    ------
    ValueError
        If `counts` is no table of counts.

    Examples
    --------
    >>> clustering([[50, 50], [0, 100]]).variation_of_information
    1.188...
    """
    table = np.asarray(counts)
    if table.ndim != 2 or table.dtype.kind not in "iuf" or not (table >= 0).all():
        raise ValueError(
            "counts must be numbers of at least 0 of shape (G, P), "
            f"got {table.dtype} of shape {table.shape}"
        )
    common = table.astype(np.float64)
    common = common[common.sum(axis=1) > 0][:, common.sum(axis=0) > 0]
    rows, columns, total = common.sum(axis=1), common.sum(axis=0), float(common.sum())
    if total < 2:
        return Clustering(variation_of_information=0.0, rand_index=1.0, covering=1.0)
    information = 2 * _entropy(common / total) - _entropy(rows / total) - _entropy(columns / total)
    # Ordered pairs together in one partition only, of all ordered pairs of two pixels.
    apart = (rows**2).sum() + (columns**2).sum() - 2 * (common**2).sum()
    overlap = common / (rows[:, None] + columns - common)
    covered = overlap.max(axis=1) @ rows + overlap.max(axis=0) @ columns
    return Clustering(
        variation_of_information=max(information, 0.0),
        rand_index=float(1 - apart / (total * (total - 1))),
        covering=float(covered / (2 * total)),
    )


def _entropy(share: Array) -> float:
    """Bits of a distribution."""
    share = share[share > 0]
    return float(-(share @ np.log2(share)))


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
    if not 0.5 <= iou < 1:
        raise ValueError(f"iou must be at least 0.5 and below 1, got {iou}")
    matched = table.overlaps() > iou
    counted = table.truth_sizes[1:] >= _at_least_zero(minimum_pixels)
    hits = int(matched[counted].sum())
    alarms = matched.shape[1] - int(matched[~counted].sum())
    precision = hits / alarms if alarms else 0.0
    recall = hits / int(counted.sum()) if counted.any() else math.nan
    both = precision + recall
    f1 = 0.0 if both == 0 else 2 * precision * recall / both
    return Detection(iou=iou, hits=hits, precision=precision, recall=recall, f1=f1)


def _at_least_zero(minimum_pixels: int) -> int:
    if minimum_pixels < 0:
        raise ValueError(f"minimum_pixels must not be negative, got {minimum_pixels}")
    return minimum_pixels


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
    predicted_planes, truth_planes : array_like, shape (N, 4)
        Rows (normal, distance) of any scale and sign; row j - 1 belongs to label j.
    iou, minimum_pixels
        Which planes match, as in `detection`.

    Raises
    ------
    ValueError
        If the parameters of a label are missing or no plane.
    """
    matched = table.overlaps() > detection(table, iou=iou, minimum_pixels=minimum_pixels).iou
    matched[table.truth_sizes[1:] < minimum_pixels] = False
    row, column = np.nonzero(matched)
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
    rows = np.asarray(planes, np.float64)
    if rows.ndim != 2 or rows.shape[1] != 4 or len(rows) < labels[-1]:
        raise ValueError(f"{name} must have shape ({labels[-1]}, 4), got {rows.shape}")
    length = np.linalg.norm(rows[:, :3], axis=1)
    if not (np.isfinite(rows).all() and (length > 0).all()):
        raise ValueError(f"{name} must be finite, with normals other than 0")
    return rows / length[:, None]


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
        Labels, at least 0; 0 is no plane.
    valid : array_like of bool, same shape, optional
        Pixels with a reading.
    predicted_planes, truth_planes : array_like, shape (N, 4), optional
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
    if not len(iou):
        raise ValueError("iou must hold at least one number")
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
    """Mean and confidence interval of every number over frames.

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
    return {
        name: mean_interval([frame.get(name, math.nan) for frame in frames], coverage=coverage)
        for name in names
    }
