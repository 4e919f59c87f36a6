"""Masks as COCO writes them: run lengths down the columns, in a compact text.

The text is that of the COCO dataset's tools: lengths of runs of 0 and 1 by turns, from the top left
down the columns, each but the first three less the one two before it; in groups of five bits, the
lowest first, 32 added where more follow, 48 to all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError

_GROUP, _MORE, _SIGN, _FIRST = 5, 32, 16, 48
_MOST_GROUPS = 12  # of five bits; no image has more pixels


def encode_labels(labels: NDArray[np.integer], count: int) -> list[str]:
    """Text of the mask of each label 1 ... `count`.

    Parameters
    ----------
    labels : ndarray of int, shape (H, W)
        Label image, 0 for none.
    count : int
        Largest label.
    """
    flat = np.asarray(labels).ravel(order="F")
    ends = np.append(np.flatnonzero(flat[1:] != flat[:-1]) + 1, flat.size)
    starts = np.concatenate(([0], ends[:-1]))
    of_run = flat[starts]
    order = np.argsort(of_run, kind="stable")
    first = np.searchsorted(of_run[order], np.arange(1, count + 2))
    texts = []
    for label in range(count):
        runs = order[first[label] : first[label + 1]]
        edges = np.empty(2 * runs.size + 2, np.int64)
        edges[0], edges[-1] = 0, flat.size
        edges[1:-1:2], edges[2:-1:2] = starts[runs], ends[runs]
        lengths = np.diff(edges)
        texts.append(_text(lengths[:-1] if lengths[-1] == 0 else lengths))
    return texts


def decode_mask(text: str, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Mask of a text.

    Parameters
    ----------
    text : str
        As `encode_labels` or COCO's tools write it.
    shape : tuple of int
        (H, W).

    Returns
    -------
    ndarray of bool, shape (H, W)

    Raises
    ------
    PlanewiseError
        If the text is damaged, or of a mask of another size.
    """
    lengths = _lengths(text)
    if min(lengths, default=0) < 0 or sum(lengths) != shape[0] * shape[1]:
        raise PlanewiseError(f"run lengths do not make a mask of shape {shape}")
    return np.repeat(np.arange(len(lengths)) % 2 == 1, lengths).reshape(shape, order="F")


def _text(lengths: NDArray[np.int64]) -> str:
    rest = lengths.copy()
    rest[3:] -= lengths[1:-2]
    groups = np.zeros((rest.size, _MOST_GROUPS), np.uint8)
    used = np.zeros(groups.shape, np.bool_)
    going = np.ones(rest.size, np.bool_)
    for k in range(_MOST_GROUPS):
        low = rest & (_MORE - 1)
        rest >>= _GROUP
        used[:, k] = going
        more = np.where(low & _SIGN, rest != -1, rest != 0)
        groups[:, k] = low + _MORE * more + _FIRST
        going = going & more
        if not going.any():
            break
    return groups[used].tobytes().decode("ascii")


def _lengths(text: str) -> list[int]:
    lengths: list[int] = []
    value = shift = 0
    for byte in text.encode("ascii", "replace"):
        low = byte - _FIRST
        value |= (low & (_MORE - 1)) << shift
        shift += _GROUP
        if low & _MORE and shift < _MOST_GROUPS * _GROUP:
            continue
        if low & _SIGN:
            value |= -1 << shift
        lengths.append(value + (lengths[-2] if len(lengths) > 2 else 0))
        value = shift = 0
    if shift:
        raise PlanewiseError("run lengths are cut short")
    return lengths
