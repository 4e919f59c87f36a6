"""Planes that turn out to be two faces, on either side of an edge between them.

Of a face that is but two or three cells wide most cells lie across its edge. They are no plane, or
one that is trusted little, and join the face beside it. Pixels tell: readings of both faces lie off
any one plane by more than noise has them, off a plane on either side of a line by no more, and off
a smooth surface through all by more than off those two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import faces as kernels
from planewise.kernels.cells import COUNT, UNIT
from planewise.runtime.workspace import Workspace
from planewise.spatial.frame import Frame
from planewise.spatial.segments import planes_by_label

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.int32]

TURN = 0.2
"""Radians between faces: walls bulge by less."""

_CLEAR = 4.0  # times the price: what two planes have to save
_WORSE = 1.15  # times the misfit of two planes: what that of one has to be
ROUGH = 2.0  # times what noise makes it: misfit of either at most, or it is no plane itself
_FEWEST = 64  # readings of a face
_NARROWEST = 2.0  # pixels: two columns beside a jump of depth may be mixed of both sides
_MOST = 16.0  # squared residual in variances of a reading that says nothing about planes
_SAMPLE = 8000  # of its readings that tell whether to look at more
_LEAST = 12  # of these on a face
_MANY = 300  # of its readings, by which a line between two is looked for first
_MOST_PLANES = np.iinfo(np.int16).max  # of a label while pixels are labelled
_EVERY = 5  # rows of which one tells whether to look closer


def may_be_two(white: float, misfits: Array, price: float, significance: float) -> Bools:
    """Which labels' planes (N + 1,) may be two faces, by `misfits_of` them; rest as of `parted`."""
    chi2, count = misfits.T
    out = np.asarray(_EVERY * (chi2 - white * count) > _least(price, significance) * white)
    out &= chi2 > 0.5 * (1.0 + _WORSE) * white * count
    out[0] = False
    return out


def parted(
    frame: Frame,
    white: float,
    rows: Array,
    labels: NDArray[np.uint16],
    doubtful: LabelPixels,
    price: float,
    significance: float,
) -> tuple[Array, Array, Index]:
    """Part planes that are two faces, in a frame whose error is all but white.

    Parameters
    ----------
    frame : Frame
        The readings; of one sector.
    white : float
        Size of their white error (`spatial.frame_error.FrameError`).
    rows : ndarray, shape (N, 13)
        Of the planes (`kernels.cells`).
    labels : ndarray of uint16, shape (H, W)
        0 for none, j for row j - 1. Pixels of a second face are given its label.
    doubtful : LabelPixels
        Pixels of those that are looked at (`may_be_two`).
    price : float
        Nats that a plane takes.
    significance : float
        Nats that it has to save beyond.

    Returns
    -------
    rows : ndarray, shape (N + M, 13)
        The same with second faces behind them.
    saved : ndarray, shape (M,)
        Nats that each second face saves, its price paid.
    pixels : ndarray of int
        Those of second faces, as places in the flattened image.
    """
    least, images = _least(price, significance), (frame.w, frame.p, *frame.sectors.coordinates)
    flat, out, saved, changed = labels.reshape(-1), list(rows.copy()), [], []

    planes, information = np.empty((2, 3)), np.empty((2, 9))

    def told(pixels: Index, part: int = 1) -> tuple[float, list[Index]]:
        """What two faces save in chi^2, and the pixels of both; part: of how many one is given."""
        by_face = np.empty_like(pixels)
        less, larger = kernels.two_faces(
            pixels, *images, white, 2 * least / part, _WORSE, ROUGH, max(_FEWEST // part, _LEAST),
            _NARROWEST / UNIT, _MANY, _MOST, frame.sectors.turn[0], math.cos(TURN), by_face,
            planes, information,
        )  # fmt: skip
        return less, [by_face[:larger], by_face[larger:]]

    waiting = list(doubtful)
    while waiting and len(out) < _MOST_PLANES:
        label, pixels = waiting.pop()
        part = len(pixels) // _SAMPLE | 1  # odd: an even one may have a factor in common with rows
        if part > 1 and not told(pixels[::part].copy(), part)[0]:
            continue
        less, faces = told(pixels)
        if not less:
            continue
        out.append(out[label - 1].copy())
        for row, sums, face in zip((out[label - 1], out[-1]), information, faces, strict=True):
            row[:9], row[COUNT] = sums, len(face)  # as if its readings erred apart
        flat[faces[1]] = len(out)
        saved.append(0.5 * less - price)
        changed.append(faces[1])
        waiting += zip((label, len(out)), faces, strict=True)
    if not saved:
        return rows, np.empty(0), np.empty(0, np.int32)
    return np.array(out), np.array(saved), np.concatenate(changed)


def _least(price: float, significance: float) -> float:
    """Nats that two faces have to save."""
    return max(_CLEAR * price, price + significance)


def misfits_of(frame: Frame, white: float, rows: Array, labels: NDArray[np.uint16]) -> Array:
    """By label, shape (N + 1, 2): chi^2 of some of the readings on its plane, and how many.

    Wild ones count for no more than 16; `white`, the size of the error, is not divided by.
    """
    out = np.empty((len(rows) + 1, 2))
    images = frame.w, frame.p, *frame.sectors.coordinates
    kernels.label_misfits(labels, *images, planes_by_label(rows), _EVERY, _MOST * white, out)
    return out


@dataclass(frozen=True)
class LabelPixels:
    """Pixels of some labels, as places in the flattened image, in raster order.

    Attributes
    ----------
    labels : ndarray of int, shape (n,)
        Those listed, in ascending order.
    first, stop : ndarray of int, shape (n,)
        Where the pixels of each are in `pixels`.
    pixels : ndarray of int32
    """

    labels: NDArray[np.intp]
    first: NDArray[np.int64]
    stop: NDArray[np.int64]
    pixels: Index

    @classmethod
    def of(
        cls, image: NDArray[np.uint16], chosen: Bools, count: Array, workspace: Workspace
    ) -> LabelPixels:
        """Those of chosen labels; count (labels,): readings of each (`misfits_of`)."""
        (labels,), width = chosen.nonzero(), image.shape[1]
        if not len(labels):
            none = np.empty(0, np.int64)
            return cls(labels, none, none, np.empty(0, np.int32))
        slot = np.full(len(chosen), -1)
        slot[labels] = np.arange(len(labels))
        room = (1.1 * _EVERY * count[labels]).astype(np.int64) + 4 * width
        while True:
            stop = np.cumsum(room)
            first, pixels = stop - room, workspace.empty(int(stop[-1]), np.int32)
            if kernels.list_pixels(image, slot, first, stop, pixels):
                return cls(labels, first, stop, pixels)
            room *= 2

    def only(self, chosen: Bools) -> LabelPixels:
        """Those of chosen ones of these labels; chosen (labels,): of all."""
        some = chosen[self.labels]
        return LabelPixels(self.labels[some], self.first[some], self.stop[some], self.pixels)

    def __iter__(self) -> Iterator[tuple[int, Index]]:
        """Each label and its pixels."""
        ends = self.labels.tolist(), self.first.tolist(), self.stop.tolist()
        for label, first, stop in zip(*ends, strict=True):
            yield label, self.pixels[first:stop]
