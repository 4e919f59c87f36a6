"""Codes for the labels of an image: the nats that say which reading is on which plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.masks import mask_length


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
    return float(mask_length(np.ascontiguousarray(labels), np.ascontiguousarray(there), planes))
