"""Regions of a frame as one label image, from labels or from masks that may overlap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import unmasked

Regions = NDArray[np.int32]
"""Shape (H, W): 0 for the remainder, j for region j; every number up to the largest occurs."""


def regions_of_labels(labels: ArrayLike, shape: tuple[int, int]) -> Regions:
    """Regions of a label image.

    Parameters
    ----------
    labels : array_like of int, shape (H, W)
        0 for the remainder, as what is masked. Equal labels are one region, wherever they are.
    shape : (int, int)
        Of the depth image.

    Returns
    -------
    Regions
        Numbered in the order of the labels.

    Raises
    ------
    ValueError
        If the shape is another, or the labels are not whole numbers of at least 0.
    """
    image = unmasked("partition", labels)
    if image.shape != shape:
        raise ValueError(
            f"partition must have the depth image's shape {shape}, got a label image of shape "
            f"{image.shape}"
        )
    if image.dtype.kind not in "biu":
        raise ValueError(f"partition must hold whole numbers as labels, got {image.dtype}")
    if image.size and image.min() < 0:
        raise ValueError(
            f"partition must not hold negative labels, got {image.min()}; 0 is the remainder"
        )
    found, number = np.unique(image, return_inverse=True)
    first = 0 if found.size and found[0] == 0 else 1
    return np.asarray(number.reshape(shape) + first, np.int32)


def regions_of_masks(masks: ArrayLike | Sequence[ArrayLike], shape: tuple[int, int]) -> Regions:
    """Regions of masks that may overlap.

    A pixel belongs to the smallest mask that holds it (of equal ones the first), so that parts of
    objects survive in the object about them. What is in none is the remainder.

    Parameters
    ----------
    masks : sequence of array_like, shape (H, W) each
        Boolean, or numbers where 0 is outside, as what is masked. Empty ones, and ones that
        smaller ones cover, are no region.
    shape : (int, int)
        Of the depth image.

    Returns
    -------
    Regions
        In the order of the masks.

    Raises
    ------
    ValueError
        If a mask has another shape, or is not of booleans or whole numbers.
    """
    checked = [_mask(mask, i, shape) for i, mask in enumerate(masks)]  # type: ignore[arg-type]
    sizes = np.array([np.count_nonzero(mask) for mask in checked])
    owner = np.zeros(shape, np.int32)
    # The smallest is painted last; of equal ones the first is.
    for i in np.argsort(-sizes[::-1], kind="stable"):
        pick = len(checked) - 1 - int(i)
        owner[checked[pick]] = pick + 1
    return regions_of_labels(owner, shape)


def _mask(mask: ArrayLike, number: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    image: NDArray[Any] = unmasked("partition", mask)
    if image.shape != shape:
        raise ValueError(
            f"partition must have masks of the depth image's shape {shape}, got mask {number} of "
            f"shape {image.shape}"
        )
    if image.dtype.kind not in "biu":
        raise ValueError(f"partition must have boolean masks, got mask {number} of {image.dtype}")
    return np.asarray(image != 0)
