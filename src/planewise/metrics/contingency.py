"""Two label images as one table of counts, and how well the two partitions agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import unmasked

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

_MOST_CELLS = 50_000_000  # a depth image taken for labels would ask for more


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
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
    pixels : int
        How many these are; fewer than two say nothing of a partition.
    """

    variation_of_information: float
    rand_index: float
    covering: float
    pixels: int


def contingency_table(
    predicted: ArrayLike, truth: ArrayLike, *, valid: ArrayLike | None = None
) -> ContingencyTable:
    """Count the pixels of every pair of a true and a predicted label.

    Parameters
    ----------
    predicted, truth : array_like of int, same shape
        Labels, at least 0; 0 is no plane, and so is what is masked in a masked array.
    valid : array_like of bool, same shape, optional
        Pixels to count, what is masked not among them; ``None`` means all.

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
    found, true = checked_labels("predicted", predicted), checked_labels("truth", truth)
    if found.shape != true.shape:
        raise ValueError(f"predicted must have the shape of truth {true.shape}, got {found.shape}")
    if valid is not None:
        mask = unmasked("valid", valid)
        if mask.shape != true.shape or mask.dtype != np.bool_:
            raise ValueError(
                f"valid must be bool of shape {true.shape}, got {mask.dtype} of {mask.shape}"
            )
        found, true = found[mask], true[mask]
    columns, column = _numbered(found)
    rows, row = _numbered(true)
    if len(rows) * len(columns) > _MOST_CELLS:
        raise ValueError(
            f"predicted and truth have {len(columns):,} and {len(rows):,} different values: as "
            f"labels, at most {_MOST_CELLS:,} pairs of them are compared"
        )
    counts = np.bincount(row * len(columns) + column, minlength=len(rows) * len(columns))
    return ContingencyTable(
        counts=counts.reshape(len(rows), len(columns)).astype(np.int64),
        truth_labels=rows,
        predicted_labels=columns,
    )


def checked_labels(name: str, image: ArrayLike) -> NDArray[np.integer]:
    """Label image: whole numbers that are not negative.

    Raises
    ------
    ValueError
        If it holds anything else.
    """
    labels = unmasked(name, image)
    if labels.dtype.kind not in "iub":
        raise ValueError(f"{name} must hold integer labels, got {labels.dtype}")
    if labels.dtype.kind == "b":
        labels = labels.astype(np.uint8)
    if labels.size and int(labels.min()) < 0:
        raise ValueError(f"{name} must hold labels of at least 0, got {labels.min()}")
    if labels.size and int(labels.max()) > np.iinfo(np.int64).max:
        raise ValueError(f"{name} must hold labels below 2^63, got {labels.max()}")
    # NumPy takes unsigned and signed integers of 64 bits together for floats.
    return labels.astype(np.int64) if labels.dtype == np.uint64 else labels


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
    numbers = table.ndim == 2 and table.dtype.kind in "iuf"
    if not (numbers and (np.isfinite(table) & (table >= 0)).all()):
        raise ValueError(
            "counts must be finite numbers of at least 0 of shape (G, P), "
            f"got {table.dtype} of shape {table.shape}"
        )
    common = table.astype(np.float64)
    common = common[common.sum(axis=1) > 0][:, common.sum(axis=0) > 0]
    rows, columns, total = common.sum(axis=1), common.sum(axis=0), float(common.sum())
    if total < 2:
        return Clustering(
            variation_of_information=0.0, rand_index=1.0, covering=1.0, pixels=int(total)
        )
    information = 2 * _entropy(common / total) - _entropy(rows / total) - _entropy(columns / total)
    # Ordered pairs together in one partition only, of all ordered pairs of two pixels.
    apart = (rows**2).sum() + (columns**2).sum() - 2 * (common**2).sum()
    overlap = common / (rows[:, None] + columns - common)
    covered = overlap.max(axis=1) @ rows + overlap.max(axis=0) @ columns
    return Clustering(
        variation_of_information=max(information, 0.0),
        rand_index=float(1 - apart / (total * (total - 1))),
        covering=float(covered / (2 * total)),
        pixels=int(total),
    )


def _entropy(share: Array) -> float:
    """Bits of a distribution."""
    share = share[share > 0]
    return float(-(share @ np.log2(share)))
