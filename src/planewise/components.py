"""Connected components."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def components(size: int, pairs: NDArray[np.integer]) -> NDArray[np.intp]:
    """First of those that each of so many hangs together with by pairs (m, 2), shape (size,).

    Examples
    --------
    >>> components(5, np.array([[3, 1], [4, 3]])).tolist()
    [0, 1, 2, 1, 1]
    """
    root, (u, v) = np.arange(size), pairs.T
    while (root[u] != root[v]).any():
        first = np.minimum(root[u], root[v])
        np.minimum.at(root, root[u], first)
        np.minimum.at(root, root[v], first)
        root = root[root]
    return root
