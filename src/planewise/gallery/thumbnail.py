"""Small picture of a frame: its planes over picture or depth, or alone where neither is left."""

from __future__ import annotations

import io
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from planewise.batch.store import StoredFrame
from planewise.batch.stored_source import StoredSource, camera_of, metres
from planewise.drawing.overlay import draw_small
from planewise.errors import PlanewiseError, SetupError

HEIGHT = 240
"""Pixels that pictures are high, or nearly."""

_QUALITY = 70


@dataclass(frozen=True, kw_only=True)
class Thumbnail:
    """A picture of a frame.

    Attributes
    ----------
    webp : bytes
        The file; empty if there is none.
    over : str
        What the planes are drawn over; empty where they are alone.
    reason : str
        Why they are drawn alone, or not at all.
    """

    webp: bytes = b""
    over: str = ""
    reason: str = ""


def thumbnail_of(frame: StoredFrame, source: StoredSource) -> Thumbnail:
    """Draw a frame; a damaged label file is a `reason`, no error."""
    try:
        labels = frame.labels
    except SetupError:
        raise
    except PlanewiseError as error:
        return Thumbnail(reason=str(error))
    try:
        seen = source[frame]
    except SetupError:
        raise
    except (ValueError, OSError) as error:
        return Thumbnail(webp=_webp(draw_small(labels, HEIGHT)), reason=str(error))
    under: dict[str, Any] = {"depth": metres(frame, seen), "camera": camera_of(frame)}
    if seen.rgb is not None and source.registered:
        with suppress(PlanewiseError):  # of other proportions: a picture of another view
            picture = draw_small(labels, HEIGHT, **under, rgb=seen.rgb)
            return Thumbnail(webp=_webp(picture), over="its picture")
    return Thumbnail(webp=_webp(draw_small(labels, HEIGHT, **under)), over="its depth")


def _webp(picture: object) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).save(file, "WEBP", quality=_QUALITY, method=3)  # type: ignore[arg-type]
    return file.getvalue()
