"""OpenEXR: the channel of depth of a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError, needs
from planewise.files.depth import COLOUR, MAX_PIXELS, check_size

_MAGIC = b"\x76\x2f\x31\x01"
_IMAGES = 4  # largest images that a file may hold as channels, of which one is used


def depth_channel(path: Path) -> NDArray[np.float32]:
    """Channel ``Z`` or ``depth``, or the only one but transparency, on the whole picture.

    The picture is the file's display window, of which intrinsics are; pixels are there for its data
    window alone. Elsewhere it is 0, no reading.

    Raises
    ------
    PlanewiseError
        If it is no OpenEXR file, damaged, too large, deep, or has no such channel.
    """
    with needs("openexr", "reading .exr files"):
        import OpenEXR  # type: ignore[import-not-found, unused-ignore]
    with path.open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise PlanewiseError("is not an OpenEXR file")
    with OpenEXR.File(str(path), separate_channels=True, header_only=True) as header:
        sizes = []
        for number, _ in enumerate(header.parts):
            part = header.header(number)
            if part["type"] not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
                raise PlanewiseError("is a deep OpenEXR file, with any number of samples a pixel")
            first, last = np.moveaxis(_windows(part), 1, 0)
            pixels, shown = np.prod(last - first + 1, axis=1).tolist()
            check_size(max(pixels, shown))
            sizes.append(pixels * len(part["channels"]))
        # All are unpacked, for the library cannot leave one out.
        check_size(sum(sizes), _IMAGES * MAX_PIXELS)
    with OpenEXR.File(str(path), separate_channels=True) as image:
        if not image.parts:  # the library has printed why
            raise PlanewiseError("is damaged or cut short: its pixels cannot be unpacked")
        channels = image.channels()
        names = [each for each in ("Z", "depth") if each in channels]
        names = names[:1] or [each for each in channels if each not in ("A", "alpha")]
        if {"R", "G", "B"} <= set(names):
            raise PlanewiseError(COLOUR)
        if len(names) != 1:
            found = ", ".join(channels)
            raise PlanewiseError(f"must hold a channel 'Z' or 'depth', or one only; it has {found}")
        (name,) = names
        depth = np.asarray(channels[name].pixels).astype(np.float32)
        data, display = _windows(image.header(0))
    return _displayed(depth, data, display)


def _windows(part: dict[str, Any]) -> NDArray[np.int64]:
    """Data and display window of a part, each its first and last pixel, (x, y)."""
    return np.array((part["dataWindow"], part["displayWindow"]), np.int64)


def _displayed(
    depth: NDArray[np.float32], data: NDArray[np.int64], display: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Readings of the data window on the pixels of the display window."""
    if (data == display).all():
        return depth
    (width, height), shift = display[1] - display[0] + 1, data[0] - display[0]
    out = np.zeros((height, width), np.float32)
    column, row = np.maximum(shift, 0)
    left, top = np.maximum(-shift, 0)
    seen = depth[top : top + max(height - row, 0), left : left + max(width - column, 0)]
    out[row : row + seen.shape[0], column : column + seen.shape[1]] = seen
    return out
