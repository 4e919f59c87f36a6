"""Labels of planes, where some are left out or all are put in order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def ranks(kept: NDArray[np.integer] | Sequence[int], count: int) -> NDArray[np.uint16]:
    """New label of every old one.

    Parameters
    ----------
    kept : sequence of int
        Planes 0 ... that stay, in their new order.
    count : int
        Planes there were, which had the labels 1 ... count.

    Returns
    -------
    ndarray of uint16, shape (count + 1,)
        0 for no plane, and for those that do not stay.

    Examples
    --------
    >>> ranks([3, 0], 4)
    array([0, 2, 0, 0, 1], dtype=uint16)
    """
    out = np.zeros(count + 1, np.uint16)
    out[1:][np.asarray(kept, np.intp)] = np.arange(1, len(kept) + 1)
    return out
