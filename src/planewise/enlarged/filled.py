"""Depth that was registered to a larger picture, every reading as a block of its pixels.

A driver that moves readings to a colour camera (`align` of librealsense, `register` of ROS where it
fills holes) paints each over all pixels of the larger picture that its own one covers, and where
blocks overlap the nearer stays. Along a row readings then change at even distances, never from one
pixel to the next and again to that behind; but not in the same columns all over the image.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.camera import PinholeCamera
from planewise.density import has_reading, spread_rows
from planewise.enlarged.scattered import Scattered, ScatteredCamera

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Image = NDArray[Any]

_ROWS = 24  # rows, and columns, that are looked at
_AT_ONCE = 0.08  # of the changes are followed by another at once, at most: blocks twice as wide
_WINDOW = 64  # pixels of a row in which changes come at even distances
_FEWEST = 8  # windows without a missing reading
_MOST = 8.0  # pixels from one change to the next, on the mean
_REGULAR = 2.5  # power of that period against the median: 2 of steps of depth
_ALIKE = 0.25  # how much it may differ between rows and columns


def filled(image: Image, camera: PinholeCamera) -> Scattered | None:
    """A coarser image with one pixel for a block of one whose readings are blocks; else None.

    Raises
    ------
    ValueError
        If they are, and the image cannot have been taken by the camera.
    """
    across = _block_size(image)  # rows first, which lie in memory one after another
    down = None if across is None else _block_size(image.T)
    if across is None or down is None or abs(math.log(across / down)) > _ALIKE:
        return None
    camera.check((image.shape[0], image.shape[1]))
    times = math.sqrt(across * down)
    row, column = (
        np.minimum(((np.arange(math.ceil(n / times)) + 0.5) * times).astype(np.intp), n - 1)
        for n in image.shape
    )
    most = math.ceil(times)
    x = column + _to_middle(image[row], column, most)
    y = row[:, None] + _to_middle(image[:, column].T, row, most).T
    own = ScatteredCamera.of(camera, times, x, y)
    if own is None:
        return None
    there = has_reading(image)
    i, j = ((np.arange(n) / times).astype(np.intp) for n in image.shape)
    of_pixel = i[:, None] * len(column) + j
    depth = image[np.ix_(row, column)]
    return Scattered(there=there, of_reading=of_pixel[there], depth=depth, camera=own)


def _block_size(image: Image) -> float | None:
    """How far readings of rows change from each other, in pixels; None if they are no blocks."""
    rows = spread_rows(image, _ROWS)
    there = has_reading(rows)
    known = there[:, 1:] & there[:, :-1]
    change = known & (rows[:, 1:] != rows[:, :-1])
    if change.shape[1] < _WINDOW:
        return None
    followed = known[:, 1:] & change[:, :-1]
    if np.count_nonzero(followed & change[:, 1:]) > _AT_ONCE * np.count_nonzero(followed):
        return None
    windows = np.lib.stride_tricks.sliding_window_view(change, _WINDOW, axis=1)
    whole = np.lib.stride_tricks.sliding_window_view(known, _WINDOW, axis=1)
    half = _WINDOW // 2
    windows = windows[:, ::half][whole[:, ::half].all(axis=2)]
    if len(windows) < _FEWEST:
        return None
    signals = windows - windows.mean(axis=1, keepdims=True)
    waves = np.fft.rfft(signals * np.hanning(_WINDOW))
    power = (waves.real**2 + waves.imag**2).sum(axis=0)
    first = math.ceil(_WINDOW / _MOST)
    best = first + int(power[first:].argmax())
    regular = power[best] > _REGULAR * np.median(power[first // 2 :])
    return _WINDOW / best if regular else None


def _to_middle(rows: Image, column: Index, most: int) -> Array:
    """How far the middle of its block is from each of these pixels of rows, shape (h, w).

    0 where so many pixels and more are alike: there blocks are, that say the same.
    """
    of_pixel, last = rows[:, column], rows.shape[1] - 1
    counts = np.zeros((2, *of_pixel.shape))
    for count, way in zip(counts, (1, -1), strict=True):
        alike = np.ones(of_pixel.shape, np.bool_)
        for step in range(1, most + 1):
            place = column + way * step
            alike &= (rows[:, np.clip(place, 0, last)] == of_pixel) & (place >= 0) & (place <= last)
            count += alike
    return np.where(counts.sum(axis=0) <= most, 0.5 * (counts[0] - counts[1]), 0.0)
