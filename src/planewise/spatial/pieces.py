"""Whether planes of one solution are in pieces in another, as a drift of the error has them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.spatial.faces import TURN
from planewise.spatial.frame import Frame

Array = NDArray[np.float64]
Planes = tuple[NDArray[np.uint16], Array]

_MANY = 0.01  # of the readings
_EVERY = 2  # rows and columns of which one tells


def in_pieces(frame: Frame, whole: Planes, parts: Planes) -> bool:
    """Whether a fair share of the readings are on pieces of a plane that hardly turn.

    Each plane of `parts` is of that one of `whole` on which most of it lies; all but the largest of
    one are pieces if they turn against that by less than faces do, and lie off it in their
    middle by no more than such a turn about their border makes: else they are faces, or steps.

    Parameters
    ----------
    frame : Frame
        The readings; of one sector.
    whole, parts : (ndarray of uint16, shape (H, W), ndarray, shape (N, 3))
        Labels, 0 for none and j for row j - 1 of the planes (t0, t1, t2) of w = t0 + t1 x + t2 y.
    """
    some = slice(None, None, _EVERY)
    one, other = (labels[some, some].reshape(-1) for labels, _ in (whole, parts))
    planes, size = parts[1], (len(whole[1]) + 1, len(parts[1]) + 1)
    both = np.bincount(one.astype(np.intp) * size[1] + other, minlength=size[0] * size[1])
    both = both.reshape(size)
    both[:, 0] = 0
    owner, count = both.argmax(axis=0), both.sum(axis=0)
    mine = np.where(owner == np.arange(size[0])[:, None], both, 0)
    largest = mine.argmax(axis=1)[owner]
    pieces = np.flatnonzero((owner > 0) & (count > 0) & (largest != np.arange(size[1])))
    if not pieces.size:
        return False
    count = np.bincount(other, minlength=size[1])
    x, y = (np.broadcast_to(each, frame.w.shape)[some, some] for each in (frame.x, frame.y))
    centre = np.ones((len(pieces), 3))
    for column, place in ((1, x), (2, y)):
        sums = np.bincount(other, place.reshape(-1), size[1])
        centre[:, column] = sums[pieces] / count[pieces]
    own, main = planes[pieces - 1], planes[largest[pieces] - 1]
    w = np.einsum("pe,pe->p", own, centre)
    off = np.abs(np.einsum("pe,pe->p", main, centre) / w - 1.0)
    half = 0.5 * _EVERY * np.sqrt(count[pieces]) / frame.sectors.mean_focal
    normals = [each @ frame.sectors.turn[0].T for each in (own, main)]
    along = np.einsum("pe,pe->p", *normals)
    cosine = along / np.prod([np.linalg.norm(each, axis=1) for each in normals], axis=0)
    hardly = (cosine > np.cos(TURN)) & (off < np.tan(TURN) * half)
    readings = _EVERY**2 * count[pieces[hardly]].sum()
    return bool(readings >= _MANY * np.count_nonzero(frame.p))
