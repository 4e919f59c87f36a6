"""Codes for the labels of an image: the nats that say which reading is on which plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.masks import CONTEXTS, SYMBOLS, mask_lengths


def spatial_mask_information(
    labels: NDArray[np.integer], there: NDArray[np.bool_], planes: int
) -> float:
    """Length of a label image in the adaptive spatial code.

    A mask of connected surfaces costs little but along its boundaries. The code has no parameter:
    an arithmetic coder that follows it needs this many nats and a few bits (`kernels.masks`).

    Parameters
    ----------
    labels : ndarray of int, shape (H, W)
        0 for no plane, j for the j-th.
    there : ndarray of bool, shape (H, W)
        Where there is a reading; other pixels are known to have no label and cost nothing.
    planes : int
        N, the largest label there may be; larger ones count as 0.

    Returns
    -------
    float
        Nats.

    Examples
    --------
    >>> halves = np.zeros((100, 100), int)
    >>> halves[:, 50:] = 1
    >>> there = np.ones((100, 100), bool)
    >>> round(spatial_mask_information(halves, there, 1)), round(1e4 * np.log(2))
    (30, 6931)
    """
    kept = np.where(there & (labels <= planes), labels, 0).astype(np.uint16)
    readings = np.bincount(kept[there], minlength=planes + 1)
    place = np.arange(planes + 1, dtype=np.uint16)
    return float(prefix_mask_information(kept, there.astype(np.float32), place, readings)[-1])


def prefix_mask_information(
    labels: NDArray[np.uint16],
    p: NDArray[np.float32],
    place: NDArray[np.uint16],
    readings: NDArray[np.int64],
) -> NDArray[np.float64]:
    """`spatial_mask_information` with only the first 0 ... N planes, labels of the others 0.

    Parameters
    ----------
    labels : ndarray of uint16, shape (H, W)
        0 for no plane, j for the j-th.
    p : ndarray of float32, shape (H, W)
        More than 0 where there is a reading.
    place : ndarray of uint16, shape (N + 1,)
        Rank 1 ... N of every label, 0 of 0.
    readings : ndarray of int, shape (N + 1,)
        Their number with every label.

    Returns
    -------
    ndarray, shape (N + 1,)
        Nats.
    """
    width, lengths = labels.shape[1], np.empty(len(place))
    upper, edge = np.zeros(width + 2, np.uint16), np.zeros(-(-width // 8) * 8, np.uint8)
    changes = np.zeros((len(place), SYMBOLS * CONTEXTS), np.int64)
    mask_lengths(labels, p, place, readings.copy(), upper, edge, changes, lengths)
    return lengths
