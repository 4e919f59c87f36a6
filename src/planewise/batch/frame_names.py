"""File names for ids that others chose: never outside the store, never two ids with one name."""

from __future__ import annotations

import hashlib
import re

_PLAIN = re.compile(r"[^A-Za-z0-9._\-]")
_LONGEST = 120  # bytes of a name; file systems take 255, with room for a partial's ending
_HASH = 16


def safe_name(frame: str, ending: str) -> str:
    """Relative path of a frame's file.

    Slashes make folders. Whatever is not a letter, digit, dot, dash or underscore of ASCII is
    written as %XX, and so are dots of folders and at the beginning: ``..`` and hidden files cannot
    arise, and no folder has the name of a file. What is too long is cut and ends in a hash.

    Parameters
    ----------
    frame : str
        Id.
    ending : str
        Of the file, such as ".png".

    Examples
    --------
    >>> safe_name("scene0000_00/frame 7", ".png")
    'scene0000_00/frame%207.png'
    >>> safe_name("../../etc/passwd", ".png")
    '%2E%2E/%2E%2E/etc/passwd.png'
    """
    *folders, name = frame.split("/")
    parts = [_escaped(folder).replace(".", "%2E") or "%" for folder in folders]
    name = _escaped(name)
    if not name or name.startswith("."):
        name = "%2E" + name[1:] if name else "%"
    return "/".join([*map(_short, parts), _short(name) + ending])


def label_path(frame: str) -> str:
    """Path of a frame's label image, relative to the store."""
    return f"labels/{safe_name(frame, '.png')}"


def _escaped(part: str) -> str:
    return _PLAIN.sub(lambda found: "".join(f"%{byte:02X}" for byte in _bytes(found[0])), part)


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def _short(part: str) -> str:
    if len(part) <= _LONGEST:
        return part
    return f"{part[:_LONGEST]}%{hashlib.sha256(part.encode()).hexdigest()[:_HASH]}"
