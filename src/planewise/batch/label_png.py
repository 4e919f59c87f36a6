"""Label images as 16-bit grey PNG, written some ten times as fast as by general encoders.

Rows are written as differences from the row above: where planes are, these are zeros.
"""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_MAGIC = b"\x89PNG\r\n\x1a\n"
_BITS, _GREY, _UP = 16, 0, 2
_LEVEL = 1  # of zlib; the next ones save a tenth of the size for a multiple of the time


def png_of_labels(labels: NDArray[np.uint16]) -> bytes:
    """PNG file of a label image.

    Parameters
    ----------
    labels : ndarray of uint16, shape (H, W)
        Neither H nor W may be 0.
    """
    height, width = labels.shape
    image = labels.astype(">u2").view(np.uint8).reshape(height, 2 * width)
    rows = np.empty((height, 2 * width + 1), np.uint8)
    rows[:, 0] = _UP
    rows[0, 1:] = image[0]
    np.subtract(image[1:], image[:-1], out=rows[1:, 1:])
    header = struct.pack(">IIBBBBB", width, height, _BITS, _GREY, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.data, _LEVEL)))
    return _MAGIC + b"".join(_chunk(kind, data) for kind, data in chunks) + _END


def _chunk(kind: bytes, data: bytes) -> bytes:
    body = kind + data
    return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))


_END = _chunk(b"IEND", b"")


def has_its_end(path: Path) -> bool:
    """Whether a label image is there and not cut short; it is not decoded, for there are many."""
    try:
        with path.open("rb") as stream:
            stream.seek(-len(_END), os.SEEK_END)
            return stream.read() == _END
    except OSError:  # also of what is shorter than its end
        return False
