"""Colour pictures, from files or from the bytes that a recording holds."""

from __future__ import annotations

from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from planewise.errors import PlanewiseError, SetupError
from planewise.files.depth import opened_picture

FORMATS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".ppm": "PPM",
    ".bmp": "BMP",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".webp": "WEBP",
    ".gif": "GIF",
}


def is_picture(path: Path) -> bool:
    """Whether the name is that of a colour picture."""
    return path.suffix.lower() in FORMATS


def read_colour(source: Path | IO[bytes]) -> NDArray[np.uint8]:
    """Read a picture, shape (h, w, 3), of the formats above and no other.

    Raises
    ------
    PlanewiseError
        If it is missing, damaged or too large.
    """
    name = f" {source.name}" if isinstance(source, Path) else ""
    if isinstance(source, Path) and not source.is_file():
        raise PlanewiseError(f"the picture{name} is missing")
    try:
        with opened_picture(source, tuple(set(FORMATS.values())), "reading pictures") as image:
            return np.array(image.convert("RGB"))
    except SetupError:
        raise
    except Exception as error:  # decoders of foreign bytes may raise anything
        detail = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise PlanewiseError(f"the picture{name} cannot be read ({detail})") from error
