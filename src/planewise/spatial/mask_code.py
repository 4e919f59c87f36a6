"""Codes for the labels of an image: the nats that say which reading is on which plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels.masks import CODES, NOWHERE, count_labels, mask_lengths

_ROOM = 2048  # different ones that a frame has, as a rule fewer


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
        N < 65,535, the largest label there may be; larger ones count as 0.

    Returns
    -------
    float
        Nats.

    Raises
    ------
    ValueError
        If there are too many planes.

    Examples
    --------
    >>> halves = np.zeros((100, 100), int)
    >>> halves[:, 50:] = 1
    >>> there = np.ones((100, 100), bool)
    >>> round(spatial_mask_information(halves, there, 1)), round(1e4 * np.log(2))
    (30, 6931)
    """
    if planes >= NOWHERE:
        raise ValueError(f"planes: fewer than {NOWHERE} are told apart, got {planes}")
    kept = np.where(there & (labels <= planes), labels, 0).astype(np.uint16)
    readings = np.bincount(kept[there], minlength=planes + 1)
    place = np.arange(planes + 1, dtype=np.uint16)
    return float(MaskCounts.of(kept, there.astype(np.float32)).lengths(readings, place)[-1])


@dataclass(frozen=True)
class MaskCounts:
    """How often each label comes with which neighbours: all that its code's length depends on.

    Attributes
    ----------
    around : ndarray of uint64, shape (n,)
        Labels left, above, above right and above left, 16 bits each, that are not all the label's.
    label : ndarray of uint16, shape (n,)
        Whose neighbours they are.
    times : ndarray of int64, shape (n,)
        How often.
    """

    around: NDArray[np.uint64]
    label: NDArray[np.uint16]
    times: NDArray[np.int64]

    @classmethod
    def of(cls, labels: NDArray[np.uint16], p: NDArray[np.float32]) -> MaskCounts:
        """Count in a label image.

        Parameters
        ----------
        labels : ndarray of uint16, shape (H, W)
            0 for no plane, j < 65,535 for the j-th.
        p : ndarray of float32, shape (H, W)
            More than 0 where there is a reading.
        """
        width, room = labels.shape[1], _ROOM
        while True:
            lines = np.zeros((2, width + 2), np.uint16)
            edge = np.zeros(-(-width // 8) * 8, np.uint8)
            slots = np.full(2 * room, -1, np.int32)
            around, label = np.empty(room, np.uint64), np.empty(room, np.uint16)
            times = np.empty(room, np.int64)
            found = count_labels(labels, p, lines, edge, slots, around, label, times)
            if found <= room:
                return cls(around[:found], label[:found], times[:found])
            room *= 8

    def renamed(self, place: NDArray[np.uint16]) -> MaskCounts:
        """Counts of the same image with label `place[j]` in place of j; it may be that of several.

        Neighbours may then have all the label, which adds nothing, and rows may be alike.
        """
        around = place.take(self.around.view(np.uint16)).view(np.uint64)
        return MaskCounts(around, place.take(self.label), self.times)

    def lengths(
        self, readings: NDArray[np.int64], place: NDArray[np.uint16]
    ) -> NDArray[np.float64]:
        """`spatial_mask_information` with only the first 0 ... N planes, labels of the others 0.

        Parameters
        ----------
        readings : ndarray of int, shape (N + 1,)
            Their number with every label.
        place : ndarray of uint16, shape (N + 1,)
            Rank 1 ... N of every label, 0 of 0.

        Returns
        -------
        ndarray, shape (N + 1,)
            Nats.
        """
        changes, lengths = (
            np.zeros((len(place), CODES), np.int64),
            np.empty(len(place)),
        )
        mask_lengths(self.around, self.label, self.times, readings, place, changes, lengths)
        return lengths
