"""Planes that are strips of something that bends: folds of cloth, rods that few cells see.

Strips two or three cells wide are too narrow for cells to tell that a surface bends. Their readings
tell: across a strip they lie on a cubic, clearly closer than on its plane. Those of a strip that
is two faces lie off the cubic, too; those beside edges, which are blurred or have the wrong label,
bend there alone. Hence most of the strips side by side have to lie on a cubic but for noise, and
to bend without the pixels beside their borders.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.components import components
from planewise.kernels import folds as kernels
from planewise.kernels.cells import SIDE, UNIT
from planewise.spatial.faces import LabelPixels
from planewise.spatial.frame import Frame
from planewise.spatial.segments import affine_planes, narrow_sides

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Labels = NDArray[np.uint16]

_FEWEST = 5  # strips side by side that bend: rounded edges have one or two, and two faces
_MOST = 0.5  # of the pixels of strips side by side: of faces with wrong labels it is up to 0.4
_BENT = 0.05  # of what noise leaves off a cubic: what a plane leaves beyond it
_SMOOTH = 1.15  # times what noise leaves off a cubic, at most: two faces leave more
_CLEARLY = 30.0  # the same as chi^2 of two degrees of freedom: 3e-7 by chance
_WIDE = 14.0 * SIDE / UNIT  # cells tell of wider ones
_LONG = 3.0  # times as long as wide
_BLURRED = 1.0 / UNIT  # beside a border: mixed of both sides
_BESIDE = 2 * SIDE  # pixels from a strip to what touches it
_REACH = 3 * _BESIDE  # to the next that bends: between them are crests, on no plane or a small one
_MANY = 1000  # pixels of a strip that count
_ALONG = 0.3  # of the length of the shorter strip: both are side by side
_AMID = 0.5  # of the border of what is no larger than they: it is a piece of what bends


def may_be_strips(rows: Array) -> Bools:
    """Which labels' planes, of rows (N, 13), are as narrow as strips, going by cells: (N + 1,).

    None where these are too few.
    """
    narrow = np.append(False, narrow_sides(rows) < _WIDE)
    return narrow if np.count_nonzero(narrow) >= _FEWEST else np.zeros_like(narrow)


def are_folds(
    frame: Frame, white: float, rows: Array, labels: Labels, narrow: LabelPixels
) -> Bools:
    """Which planes of a frame whose error is all but white are strips of what bends, shape (N,).

    Parameters
    ----------
    frame : Frame
        The readings; of one sector.
    white : float
        Size of their white error (`spatial.frame_error.FrameError`).
    rows : ndarray, shape (N, 13)
        Of the planes (`kernels.cells`).
    labels : ndarray of uint16, shape (H, W)
        0 for none, j for row j - 1.
    narrow : LabelPixels
        Pixels of those that are looked at (`may_be_strips`).
    """
    none = np.zeros(len(rows), np.bool_)
    if len(narrow.labels) < _FEWEST:
        return none
    strips = _strips(frame, white, rows, narrow)
    if np.count_nonzero(strips.inside) < _FEWEST:
        return none
    pixels = np.sort(np.concatenate([each for j, each in narrow if strips.there[j]]))
    shared = _borders(labels, pixels, len(rows), _REACH)
    shorter = np.minimum(strips.length[:, None], strips.length)
    beside = np.argwhere(shared > _ALONG * UNIT * shorter)
    group = components(len(shared), beside)
    size = np.bincount(labels.reshape(-1), minlength=len(group))
    enough = np.bincount(group, strips.inside) >= _FEWEST
    bent, every = (np.bincount(group, size * each) for each in (strips.inside, strips.there))
    enough &= bent > _MOST * every
    folds = strips.bent & enough[group]
    if not folds.any():
        return none
    shared = _borders(labels, np.flatnonzero(labels), len(rows), _BESIDE)
    return _with_pieces(folds, size, shared)[1:]


@dataclass(frozen=True)
class _Strips:
    """What readings say of every label, shape (N + 1,).

    Attributes
    ----------
    there, bent, inside : ndarray of bool
        Whether it is a strip, one that bends, and without the pixels beside its border, too.
    length : ndarray
        In units of x and y.
    """

    there: Bools
    bent: Bools
    inside: Bools
    length: Array


def _strips(frame: Frame, white: float, rows: Array, listed: LabelPixels) -> _Strips:
    """What readings say of some planes, of rows (N, 13)."""
    chi2, sides = np.empty((len(listed.labels), 2, 3)), np.empty((len(listed.labels), 2))
    kernels.profiles(
        listed.pixels, listed.first, listed.stop, frame.w, frame.p, *frame.sectors.coordinates,
        white, affine_planes(rows[listed.labels - 1]), _MANY, _BLURRED, _WIDE, _LONG, chi2, sides,
    )  # fmt: skip
    (width, long), (line, cubic, size) = sides.T, chi2.T
    ratio = (line - cubic) / np.maximum(np.maximum(cubic, size), 1.0)
    narrow = width < np.minimum(_WIDE, long / _LONG)
    bends = narrow & (ratio > np.maximum(_BENT, _CLEARLY / np.maximum(size, 1.0)))
    bends[1] &= bends[0] & (cubic[1] < _SMOOTH * size[1])
    there, bent, inside = np.zeros((3, len(rows) + 1), np.bool_)
    length = np.zeros(len(rows) + 1)
    there[listed.labels], bent[listed.labels], inside[listed.labels] = narrow, *bends
    length[listed.labels] = long
    return _Strips(there, bent, inside, length)


def _borders(
    labels: Labels, pixels: NDArray[np.integer], most: int, reach: int
) -> NDArray[np.int64]:
    """Rows and columns in which a label is next to another within `reach` pixels.

    Of some pixels, in raster order. Shape (most + 1, most + 1), symmetric.
    """
    shared = np.zeros((most + 1, most + 1), np.int64)
    label, (row, column) = labels.reshape(-1)[pixels], np.divmod(pixels, labels.shape[1])
    by_column = np.argsort(column, kind="stable")
    for line, place, mine in (
        (row, column, label),
        (column[by_column], row[by_column], label[by_column]),
    ):
        next_to = (np.diff(place) <= reach) & (line[1:] == line[:-1]) & (mine[1:] != mine[:-1])
        np.add.at(shared, (mine[:-1][next_to], mine[1:][next_to]), 1)
    return shared + shared.T


def _with_pieces(folds: Bools, size: NDArray[np.intp], shared: NDArray[np.int64]) -> Bools:
    """With what lies amid folds: smaller than the largest, most of its border with them."""
    small, every = size < size[folds].max(), shared.sum(axis=1)
    while True:
        amid = small & ~folds & (shared[:, folds].sum(axis=1) > _AMID * every)
        if not amid.any():
            return folds
        folds = folds | amid
